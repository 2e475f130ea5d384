"""Frames as files: one as PNG, or all of an episode as GIF or MP4."""

from __future__ import annotations

import os
from functools import lru_cache
from itertools import chain
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from PIL import Image

from mapreplay.errors import LogError, WriteError
from mapreplay.files.whole import whole_path
from mapreplay.pictures import Picture, png_of
from mapreplay.recorders.pictures.dashboard import Film
from mapreplay.recorders.pictures.palette import (
    CELL_COLOURS,
    CURVE_COLOURS,
    DARK,
    LIGHT,
    STATE_COLOURS,
    THEMES,
    YELLOW,
    viridis,
)

FRAMES_PER_SECOND: Final = 10.0
_LAST_SECONDS: Final = 2.0
"""How long a film stays at its last frame before it starts again."""


def save_png(path: Path, film: Film, step: int, *, force: bool = False) -> None:
    """Write one step as PNG.

    Raises:
        LogError: a log is damaged.
        ExistsError, WriteError: see `mapreplay.files.whole_path`.
    """
    with whole_path(path, force=force) as draft:
        draft.write_bytes(png_of(film.frame(step)))


def save_gif(path: Path, film: Film, every: int = 1, *, force: bool = False) -> None:
    """Write every Nth step as an endless GIF.

    Raises:
        LogError, ExistsError, WriteError: as `save_png`.
    """
    with whole_path(path, force=force) as draft:
        frames = film.frames(every)
        first = next(frames)
        tick = 1000 / FRAMES_PER_SECOND
        count = _count(film, every)
        durations = [tick] * (count - 1) + [_LAST_SECONDS * 1000]
        few_colours(first).save(
            draft,
            format="GIF",
            save_all=True,
            append_images=(few_colours(frame) for frame in frames),
            duration=[round(d) for d in durations],
            loop=0,
            optimize=False,
        )


def save_mp4(path: Path, film: Film, every: int = 1, *, force: bool = False) -> None:
    """Write every Nth step as MP4 (VP9, which browsers and players support).

    Raises:
        LogError: as `save_png`, or this build of OpenCV cannot encode VP9.
        ExistsError, WriteError: as `save_png`.
    """
    try:
        str(path.parent).encode()
    except UnicodeEncodeError:
        raise LogError(
            f"{path}: OpenCV cannot write to names that are not UTF-8; use --gif"
        ) from None
    with whole_path(path, force=force) as draft:
        frames = film.frames(every)
        first = next(frames)
        height, width = first.shape[:2]
        # An encoder needs even numbers.
        size = (width - width % 2, height - height % 2)
        # FFmpeg writes to stderr by itself; -8 is its level "quiet".
        os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
        code = cv2.VideoWriter.fourcc(*"vp09")
        writer = cv2.VideoWriter(str(draft), cv2.CAP_FFMPEG, code, FRAMES_PER_SECOND, size)
        if not writer.isOpened():
            raise LogError(f"{path}: OpenCV cannot write MP4 here; use --gif")
        written = 0
        # Of a full disk it would say so for every frame; see below.
        level = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
        try:
            last: Picture = first
            for frame in chain([first], frames):
                last = frame
                writer.write(_cropped(frame, size))
                written += 1
            for _ in range(round(_LAST_SECONDS * FRAMES_PER_SECOND)):
                writer.write(_cropped(last, size))
                written += 1
        finally:
            writer.release()
            cv2.utils.logging.setLogLevel(level)
        if _frames_in(draft) != written:  # the writer does not report a full disk
            raise WriteError(f"{path}: cannot be written (no more than a part of it; a full disk?)")


def _frames_in(path: Path) -> int:
    """How many frames of a film can be read back."""
    level = cv2.utils.logging.setLogLevel(
        cv2.utils.logging.LOG_LEVEL_SILENT
    )  # or it reports by itself that it cannot be read
    reader = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    try:
        count = 0
        while reader.isOpened() and reader.grab():
            count += 1
        return count
    finally:
        reader.release()
        cv2.utils.logging.setLogLevel(level)


def few_colours(picture: Picture) -> Image.Image:
    """The picture in 255 fixed colours, with those of the palette: a film does not flicker, and
    a colour keeps its meaning.
    """
    return Image.fromarray(picture).quantize(palette=_palette(), dither=Image.Dither.NONE)


@lru_cache(maxsize=1)
def _palette() -> Image.Image:
    named = [*CELL_COLOURS.values(), *CURVE_COLOURS.values(), *STATE_COLOURS.values(), YELLOW]
    for theme in THEMES.values():
        named += [theme.paper, theme.ink, theme.faint, theme.line]
    distinct = np.array(list(dict.fromkeys(named)), np.float64)
    # Edges of lines and letters are half of each.
    light = np.rint((distinct + LIGHT.paper) / 2)
    dark = np.rint((distinct + DARK.paper) / 2)
    greys = np.linspace(0, 255, 40).repeat(3).reshape(-1, 3)
    fixed = np.concatenate([distinct, light, dark, greys])
    ramp = viridis()[np.linspace(0, 255, 255 - len(fixed)).astype(int)]
    image = Image.new("P", (1, 1))
    image.putpalette(np.concatenate([fixed, ramp]).astype(np.uint8).tobytes())
    return image


def _cropped(picture: Picture, size: tuple[int, int]) -> Picture:
    """The picture as OpenCV's writer takes it: blue, green, red, of that width and height."""
    return np.ascontiguousarray(picture[: size[1], : size[0], ::-1])


def _count(film: Film, every: int) -> int:
    return len({*range(0, film.last + 1, every), film.last})
