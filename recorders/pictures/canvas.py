"""Text, boxes and lines on pictures, in the font that comes with matplotlib.

A `Sheet` is measured in points: `unit` pixels each, so that a picture of twice the size has
the same layout.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Final, Literal, NamedTuple

import cv2
import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw, ImageFont

from mapreplay.pictures import Picture
from mapreplay.recorders.pictures.palette import Colour
from mapreplay.text import printable

_FONTS: Final = Path(mpl.get_data_path()) / "fonts" / "ttf"
_SHIFT: Final = 4


@lru_cache(maxsize=64)
def font(pixels: int, *, bold: bool = False) -> ImageFont.FreeTypeFont:
    """DejaVu Sans with this height in pixels."""
    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    # The layout without libraqm: it is the same on every machine.
    return ImageFont.truetype(_FONTS / name, pixels, layout_engine=ImageFont.Layout.BASIC)


class Area(NamedTuple):
    """A part of a sheet, in points."""

    x: float
    y: float
    width: float
    height: float


class Sheet:
    """A picture to draw on; all numbers are points, from the top left."""

    def __init__(self, width: float, height: float, unit: float, paper: Colour) -> None:
        self.unit: Final = unit
        size = (round(height * unit), round(width * unit))
        self._pixels: Final[Picture] = np.full((*size, 3), paper, np.uint8)
        self._texts: Final[list[Callable[[ImageDraw.ImageDraw], None]]] = []

    @property
    def picture(self) -> Picture:
        """uint8[h, w, 3]: all that was drawn, the text on top."""
        # Text comes last, because Pillow and OpenCV do not share memory: a copy each way per
        # line of text would take 230 instead of 15 ms per frame.
        image = Image.fromarray(self._pixels)
        draw = ImageDraw.Draw(image)
        for write in self._texts:
            write(draw)
        return np.array(image)

    def px(self, points: float) -> int:
        """Points in pixels, rounded."""
        return round(points * self.unit)

    def width_of(self, text: str, size: float, *, bold: bool = False) -> float:
        """The width of a line of text, in points."""
        return float(font(self.px(size), bold=bold).getlength(printable(text))) / self.unit

    def text(
        self,
        x: float,
        y: float,
        text: str,
        size: float,
        colour: Colour,
        *,
        bold: bool = False,
        align: Literal["l", "m", "r"] = "l",
    ) -> None:
        """A line of text, vertically centred at `y`; it starts, is centred or ends at `x`."""
        if not text:
            return
        face = font(self.px(size), bold=bold)
        at, shown = (self.px(x), self.px(y)), printable(text)
        self._texts.append(lambda draw: draw.text(at, shown, colour, face, f"{align}m"))

    def box(self, x: float, y: float, width: float, height: float, colour: Colour) -> None:
        """A filled box."""
        self._pixels[self.px(y) : self.px(y + height), self.px(x) : self.px(x + width)] = colour

    def frame(self, x: float, y: float, width: float, height: float, colour: Colour) -> None:
        """The edge of a box."""
        low, high = (self.px(x), self.px(y)), (self.px(x + width) - 1, self.px(y + height) - 1)
        cv2.rectangle(self._pixels, low, high, colour, max(1, int(self.unit)))

    def disc(self, x: float, y: float, radius: float, colour: Colour) -> None:
        """A filled disc around (x, y)."""
        centre, fixed = (self._fixed(x), self._fixed(y)), self._fixed(radius)
        cv2.circle(self._pixels, centre, fixed, colour, cv2.FILLED, cv2.LINE_AA, _SHIFT)

    def line(self, points: npt.NDArray[np.float64], colour: Colour, width: float) -> None:
        """A line through float64[n, 2] points; it is broken where one is not finite."""
        thick = max(1, self.px(width))
        finite = np.isfinite(points.sum(axis=1))
        fixed = np.rint(np.nan_to_num(points) * self.unit * (1 << _SHIFT)).astype(np.int32)
        for run in np.split(np.arange(len(points)), np.flatnonzero(~finite)):
            kept = fixed[run[finite[run]]]
            for start, end in zip(kept[:-1].tolist(), kept[1:].tolist(), strict=True):
                cv2.line(self._pixels, start, end, colour, thick, cv2.LINE_AA, _SHIFT)

    def paste(self, x: float, y: float, picture: Picture) -> None:
        """A picture, in its own pixels, with its top left at (x, y)."""
        top, left = self.px(y), self.px(x)
        height, width = picture.shape[:2]
        self._pixels[top : top + height, left : left + width] = picture

    def wrapped(self, text: str, size: float, width: float) -> list[str]:
        """The text in lines of at most `width` points; words that are wider are cut."""
        lines = [""]
        for word in text.split():
            longer = f"{lines[-1]} {word}".strip()
            if self.width_of(longer, size) <= width:
                lines[-1] = longer
            else:
                lines.append(self.shortened(word, size, width))
        return [line for line in lines if line]

    def shortened(self, text: str, size: float, width: float) -> str:
        """The text, its end cut off where it does not fit into `width` points."""
        # No letter is narrower than a point: the rest of a longer text is not even measured.
        text = printable(text)[: max(0, int(width)) + 1]
        if self.width_of(text, size) <= width:
            return text
        while text and self.width_of(f"{text}…", size) > width:
            text = text[:-1]
        return f"{text}…" if text else ""

    def _fixed(self, points: float) -> int:
        """OpenCV's fixed-point pixels."""
        return round(points * self.unit * (1 << _SHIFT))
