"""Frames as files: one picture, or all of an episode as GIF or MP4."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache
from itertools import chain
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from PIL import Image

from mapreplay.errors import LogError
from mapreplay.recorders.pictures.dashboard import Film
from mapreplay.recorders.pictures.painter import Picture
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
"""How long a film rests on its last frame before it begins again."""


def png_bytes(picture: Picture) -> bytes:
    """The picture as a PNG file."""
    _, data = cv2.imencode(".png", picture[..., ::-1])
    return data.tobytes()


def save_png(path: Path, film: Film, step: int, *, force: bool = False) -> None:
    """Write one step as PNG.

    Raises:
        LogError: a log is damaged, or `path` is there and `force` is not given, or it cannot
            be written.
    """
    _write(path, lambda part: _bytes(part, png_bytes(film.frame(step))), force=force)


def save_gif(path: Path, film: Film, every: int = 1, *, force: bool = False) -> None:
    """Write every so many-th step as an endless GIF.

    Raises:
        LogError: as `save_png`.
    """

    def write(part: Path) -> None:
        frames = film.frames(every)
        first = next(frames)
        tick = 1000 / FRAMES_PER_SECOND
        count = _count(film, every)
        durations = [tick] * (count - 1) + [_LAST_SECONDS * 1000]
        few_colours(first).save(
            part,
            format="GIF",
            save_all=True,
            append_images=(few_colours(frame) for frame in frames),
            duration=[round(d) for d in durations],
            loop=0,
            optimize=False,
        )

    _write(path, write, force=force)


def save_mp4(path: Path, film: Film, every: int = 1, *, force: bool = False) -> None:
    """Write every so many-th step as MP4 (VP9, which browsers and players show).

    Raises:
        LogError: as `save_png`, or this build of OpenCV cannot encode VP9.
    """

    def write(part: Path) -> None:
        frames = film.frames(every)
        first = next(frames)
        height, width = first.shape[:2]
        # An encoder needs even numbers.
        size = (width - width % 2, height - height % 2)
        code = cv2.VideoWriter.fourcc(*"vp09")
        writer = cv2.VideoWriter(str(part), cv2.CAP_FFMPEG, code, FRAMES_PER_SECOND, size)
        if not writer.isOpened():
            raise LogError(f"{path}: OpenCV cannot write MP4 here; use --gif")
        try:
            last: Picture = first
            for frame in chain([first], frames):
                last = frame
                writer.write(_cropped(frame, size))
            for _ in range(round(_LAST_SECONDS * FRAMES_PER_SECOND)):
                writer.write(_cropped(last, size))
        finally:
            writer.release()

    _write(path, write, force=force)


def few_colours(picture: Picture) -> Image.Image:
    """The picture in 255 fixed colours, ours among them: nothing flickers in a film, and what
    has a meaning keeps its colour.
    """
    return Image.fromarray(picture).quantize(palette=_palette(), dither=Image.Dither.NONE)


@lru_cache(maxsize=1)
def _palette() -> Image.Image:
    named = [*CELL_COLOURS.values(), *CURVE_COLOURS.values(), *STATE_COLOURS.values(), YELLOW]
    for theme in THEMES.values():
        named += [theme.paper, theme.ink, theme.faint, theme.line]
    distinct = np.array(list(dict.fromkeys(named)), np.float64)
    # Edges of lines and of letters are half of them.
    light = np.rint((distinct + LIGHT.paper) / 2)
    dark = np.rint((distinct + DARK.paper) / 2)
    greys = np.linspace(0, 255, 40).repeat(3).reshape(-1, 3)
    fixed = np.concatenate([distinct, light, dark, greys])
    ramp = viridis()[np.linspace(0, 255, 255 - len(fixed)).astype(int)]
    image = Image.new("P", (1, 1))
    image.putpalette(np.concatenate([fixed, ramp]).astype(np.uint8).tobytes())
    return image


def _cropped(picture: Picture, size: tuple[int, int]) -> Picture:
    """The picture as OpenCV takes it: blue, green, red, of that width and height."""
    return np.ascontiguousarray(picture[: size[1], : size[0], ::-1])


def _count(film: Film, every: int) -> int:
    return len({*range(0, film.last + 1, every), film.last})


def _bytes(path: Path, data: bytes) -> None:
    path.write_bytes(data)


def _write(path: Path, write: Callable[[Path], None], *, force: bool) -> None:
    """Let `write` make a file, which is at `path` when it is whole."""
    if path.exists() and not force:
        raise LogError(f"{path}: already there; use --force to overwrite it")
    part = path.with_name(f".{path.stem}.part{path.suffix}")  # encoders look at the suffix
    try:
        part.write_bytes(b"")  # before all the work
        write(part)
        part.replace(path)
    except OSError as error:
        raise LogError(f"{path}: cannot be written ({error.strerror or error})") from None
    finally:
        with suppress(OSError):
            part.unlink()
