"""PNG and PGM files as arrays; large ones are refused by their header, before decoding.

Whatever the file holds (colours, a palette, 1 to 16 bits, any maxval of a PGM) comes out as 8-bit
greys, rounded as ImageMagick does it for Nav2's ``map_server``.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from mapreplay.errors import FloorPlanError
from mapreplay.files.identify import unlike
from mapreplay.floorplan import MAX_SIDE
from mapreplay.floorplans.files import read_limited

MAX_IMAGE_BYTES: Final = 192 << 20
"""A PNG of 4096 x 4096 pixels with four incompressible channels of 16 bits is 128 MiB."""

OPAQUE: Final = 255
"""Alpha of an opaque pixel."""

_PNG_SIGNATURE: Final = b"\x89PNG\r\n\x1a\n"
_PNG_HEADER: Final = struct.Struct(">4sIIBB")  # name of the chunk, width, height, depth, colours
_GREY: Final = 0
"""PNG's colour type of a single grey channel."""
_PGM_HEADER: Final = re.compile(rb"P[25]" + rb"(?:\s|#[^\n]*\n)+(\d{1,9})" * 3 + rb"\s")
_LUMA_BGR: Final = (0.072186, 0.715158, 0.212656)
"""Luminance weights (Rec. 709), in OpenCV's order."""


@dataclass(frozen=True, eq=False)
class Pixels:
    """An image with row 0 at the bottom, as in a grid."""

    grey: npt.NDArray[np.uint8]
    """uint8[H, W]."""
    alpha: npt.NDArray[np.uint8] | None
    """uint8[H, W]: 0 is transparent, 255 opaque; None if the file has no transparency."""


def read_pixels(path: Path) -> Pixels:
    """Read a PNG or PGM (binary or ASCII) of at most 4096 pixels along a side.

    Raises:
        FloorPlanError: there is no such file, or it is too large, damaged or of another type.
    """
    content = read_limited(path, MAX_IMAGE_BYTES)
    if content.startswith(_PNG_SIGNATURE):
        grey, alpha = _decode_png(content, path)
    elif content.startswith((b"P2", b"P5")):
        grey, alpha = _decode_pgm(content, path), None
    else:
        raise FloorPlanError(unlike(path, "a PNG or PGM image", content))
    upright = np.ascontiguousarray(grey[::-1])
    return Pixels(upright, None if alpha is None else np.ascontiguousarray(alpha[::-1]))


def _greys(values: npt.NDArray[np.uint16], white: int, path: Path) -> npt.NDArray[np.uint8]:
    """`values` of 0 to `white` as greys of 0 to 255.

    Raises:
        FloorPlanError: they are values of 8 bits in a file of 16: all would be black.
    """
    if white > 255 and values.max() <= 255:
        raise FloorPlanError(
            f"{path}: white is {white}, and no pixel is over {values.max()}: values of 8 bits in "
            "a file of 16; save it as an 8-bit image"
        )
    return _eight_bits(values, white)


def _eight_bits(values: npt.NDArray[np.uint16], white: int) -> npt.NDArray[np.uint8]:
    """`values` of 0 to `white` as 0 to 255, rounded."""
    table = (np.arange(white + 1) * 510 + white) // (2 * white)
    scaled: npt.NDArray[np.uint8] = table.astype(np.uint8)[values]
    return scaled


def _check_size(width: int, height: int, path: Path) -> None:
    if not (1 <= width <= MAX_SIDE and 1 <= height <= MAX_SIDE):
        raise FloorPlanError(
            f"{path}: {width} x {height} pixels; 1 to {MAX_SIDE} along a side are allowed, "
            "crop or shrink it"
        )


def _decode_png(
    content: bytes, path: Path
) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint8] | None]:
    """Greys and alpha (None without transparency), uint8[H, W] each, the top row first."""
    header = content[12 : 12 + _PNG_HEADER.size]
    if len(header) < _PNG_HEADER.size or not header.startswith(b"IHDR"):
        raise FloorPlanError(f"{path}: a damaged PNG image (no header)")
    _, width, height, depth, colours = _PNG_HEADER.unpack(header)
    _check_size(width, height, path)
    if not _png_is_whole(content):
        raise FloorPlanError(f"{path}: a damaged or truncated PNG image")
    try:
        image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        image = None
    kind = np.uint16 if depth == 16 else np.uint8
    if image is None or image.shape[:2] != (height, width) or image.dtype != kind:
        raise FloorPlanError(f"{path}: a damaged PNG image")
    channels: npt.NDArray[np.uint16] = image.reshape(height, width, -1).astype(np.uint16)
    white = int(np.iinfo(kind).max)
    if channels.shape[2] == 1:
        grey = channels[..., 0]
        alpha = _clear_grey(content, grey, depth, colours)
    else:
        luma = sum(channels[..., i] * weight for i, weight in enumerate(_LUMA_BGR))
        grey = np.rint(luma).astype(np.uint16)
        alpha = channels[..., 3] if channels.shape[2] == 4 else None
    return _greys(grey, white, path), None if alpha is None else _eight_bits(alpha, white)


def _clear_grey(
    content: bytes, grey: npt.NDArray[np.uint16], depth: int, colours: int
) -> npt.NDArray[np.uint16] | None:
    """The alpha of a grey PNG with one transparent grey (tRNS), which OpenCV ignores."""
    sample = dict(_png_chunks(content)).get(b"tRNS", b"")
    if colours != _GREY or len(sample) != 2:
        return None
    # OpenCV spreads 1, 2 and 4 bits over 8.
    scale = 1 if depth >= 8 else 255 // ((1 << depth) - 1)
    clear = int.from_bytes(sample) * scale
    white = 65535 if depth == 16 else 255
    return np.where(grey == clear, np.uint16(0), np.uint16(white))


def _png_is_whole(content: bytes) -> bool:
    """Whether all chunks are present, with valid checksums.

    OpenCV returns parts of some damaged images, and prints warnings about others.
    """
    return any(name == b"IEND" for name, _ in _png_chunks(content))


def _png_chunks(content: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Names and contents of the chunks up to the first one that is damaged or cut off."""
    at = len(_PNG_SIGNATURE)
    while at + 12 <= len(content):
        (length,) = struct.unpack_from(">I", content, at)
        end = at + 8 + length
        if end + 4 > len(content):
            return
        if zlib.crc32(content[at + 4 : end]) != struct.unpack_from(">I", content, end)[0]:
            return
        yield content[at + 4 : at + 8], content[at + 8 : end]
        at = end + 4


def _decode_pgm(content: bytes, path: Path) -> npt.NDArray[np.uint8]:
    """uint8[H, W], the top row first."""
    header = _PGM_HEADER.match(content)
    if header is None:
        raise FloorPlanError(f"{path}: a damaged PGM image (no header)")
    width, height, white = map(int, header.groups())
    _check_size(width, height, path)
    if not 1 <= white <= 65535:
        raise FloorPlanError(f"{path}: a damaged PGM image (its white is {white}, not 1 to 65535)")
    body = memoryview(content)[header.end() :]
    if content.startswith(b"P5"):
        kind = np.dtype(np.uint8 if white < 256 else ">u2")
        there = min(len(body) // kind.itemsize, width * height)
        values = np.frombuffer(body, kind, there).astype(np.uint16)
    else:
        values = _ascii_values(bytes(body), width * height, white, path)
    if values.size < width * height:
        raise FloorPlanError(
            f"{path}: truncated, {values.size} of {width} x {height} pixels are there"
        )
    if values.max() > white:
        raise FloorPlanError(
            f"{path}: a damaged PGM image (a pixel is {values.max()}, its white is {white})"
        )
    return _greys(values, white, path).reshape(height, width)


def _ascii_values(body: bytes, count: int, white: int, path: Path) -> npt.NDArray[np.uint16]:
    words = body.split(maxsplit=count)[:count]
    legal = {str(value).encode(): value for value in range(white + 1)}
    try:
        return np.fromiter((legal[word] for word in words), np.uint16, len(words))
    except KeyError as error:
        word = error.args[0][:20]
        raise FloorPlanError(f"{path}: {word!r} is not a grey value 0..{white}") from None
