"""PNG and PGM files as arrays: refused by their header before anything large is decoded."""

from __future__ import annotations

import re
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from mapreplay.errors import FloorPlanError
from mapreplay.floorplan import MAX_SIDE
from mapreplay.floorplans.files import read_limited

MAX_IMAGE_BYTES: Final = 96 << 20
"""A PNG of 4096 x 4096 pixels with four incompressible channels is 64 MiB."""

OPAQUE: Final = 255

_PNG_SIGNATURE: Final = b"\x89PNG\r\n\x1a\n"
_PNG_HEADER: Final = struct.Struct(">4sIIB")  # name of the chunk, width, height, bit depth
_PGM_HEADER: Final = re.compile(rb"P[25]" + rb"(?:\s|#[^\n]*\n)+(\d{1,9})" * 3 + rb"\s")


@dataclass(frozen=True, eq=False)
class Pixels:
    """An image with row 0 at the bottom, as in a grid."""

    colour: npt.NDArray[np.uint8]
    """uint8[H, W, C]: one grey channel, or three colours."""
    alpha: npt.NDArray[np.uint8] | None
    """uint8[H, W]: 0 is transparent, 255 opaque; None if the file has no such channel."""


def read_pixels(path: Path) -> Pixels:
    """Read an 8-bit PNG or PGM (binary or ASCII) of at most 4096 pixels along a side.

    Raises:
        FloorPlanError: there is no such file, or it is too large, damaged or something else.
    """
    content = read_limited(path, MAX_IMAGE_BYTES)
    if content.startswith(_PNG_SIGNATURE):
        image = _decode_png(content, path)
    elif content.startswith((b"P2", b"P5")):
        image = _decode_pgm(content, path)
    else:
        raise FloorPlanError(f"{path}: not a PNG or PGM image")
    upright = np.ascontiguousarray(image[::-1])
    if upright.shape[2] == 4:
        return Pixels(upright[..., :3], upright[..., 3])
    return Pixels(upright, None)


def _check_size(width: int, height: int, path: Path) -> None:
    if not (1 <= width <= MAX_SIDE and 1 <= height <= MAX_SIDE):
        raise FloorPlanError(
            f"{path}: {width} x {height} pixels; 1 to {MAX_SIDE} along a side are allowed"
        )


def _decode_png(content: bytes, path: Path) -> npt.NDArray[np.uint8]:
    header = content[12 : 12 + _PNG_HEADER.size]
    if len(header) < _PNG_HEADER.size or not header.startswith(b"IHDR"):
        raise FloorPlanError(f"{path}: a damaged PNG image (no header)")
    _, width, height, depth = _PNG_HEADER.unpack(header)
    _check_size(width, height, path)
    if depth > 8:
        raise FloorPlanError(f"{path}: {depth} bits a channel; save it as an 8-bit PNG")
    if not _png_is_whole(content):
        raise FloorPlanError(f"{path}: a damaged or truncated PNG image")
    try:
        image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        image = None
    if image is None or image.shape[:2] != (height, width) or image.dtype != np.uint8:
        raise FloorPlanError(f"{path}: a damaged PNG image")
    return np.asarray(image, np.uint8).reshape(height, width, -1)


def _png_is_whole(content: bytes) -> bool:
    """Whether all chunks up to the last one are there, with right checksums.

    OpenCV returns what it has of some damaged images, and prints about others.
    """
    at = len(_PNG_SIGNATURE)
    while at + 12 <= len(content):
        (length,) = struct.unpack_from(">I", content, at)
        end = at + 8 + length
        if end + 4 > len(content):
            return False
        if zlib.crc32(content[at + 4 : end]) != struct.unpack_from(">I", content, end)[0]:
            return False
        if content[at + 4 : at + 8] == b"IEND":
            return True
        at = end + 4
    return False


def _decode_pgm(content: bytes, path: Path) -> npt.NDArray[np.uint8]:
    header = _PGM_HEADER.match(content)
    if header is None:
        raise FloorPlanError(f"{path}: a damaged PGM image (no header)")
    width, height, brightest = map(int, header.groups())
    _check_size(width, height, path)
    if brightest != 255:
        raise FloorPlanError(f"{path}: its white is {brightest}; save it as an 8-bit PGM (255)")
    body = memoryview(content)[header.end() :]
    if content.startswith(b"P5"):
        values = np.frombuffer(body, np.uint8)[: width * height]
    else:
        values = _ascii_values(bytes(body), width * height, path)
    if values.size < width * height:
        raise FloorPlanError(
            f"{path}: truncated, {values.size} of {width} x {height} pixels are there"
        )
    return values[: width * height].reshape(height, width, 1)


def _ascii_values(body: bytes, count: int, path: Path) -> npt.NDArray[np.uint8]:
    words = body.split(maxsplit=count)[:count]
    legal = {str(value).encode(): value for value in range(256)}
    try:
        return np.fromiter((legal[word] for word in words), np.uint8, len(words))
    except KeyError as error:
        raise FloorPlanError(f"{path}: {error.args[0][:20]!r} is not a grey value 0..255") from None
