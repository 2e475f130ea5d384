"""What a file is that is not what it was taken for: the cause behind "not a PNG image"."""

from __future__ import annotations

from pathlib import Path
from typing import Final

_HEAD_BYTES: Final = 512

_STARTS: Final[tuple[tuple[bytes, str], ...]] = (
    (
        b"version https://git-lfs.github.com/spec/",
        "a Git LFS pointer, not the file itself; run git lfs pull",
    ),
    (b"SQLite format 3\x00", "a SQLite database (a ROS 2 bag, .db3?)"),
    (b"#ROSBAG V", "a ROS 1 bag"),
    (b"\x89MCAP0\r\n", "an MCAP file"),
    (b"\x89PNG\r\n\x1a\n", "a PNG image"),
    (b"P5", "a PGM image"),
    (b"P2", "a PGM image"),
    (b"\xff\xd8\xff", "a JPEG image"),
    (b"\x1f\x8b", "gzip-compressed; unpack it with gunzip"),
    (b"\x28\xb5\x2f\xfd", "zstd-compressed; unpack it with unzstd"),
    (b"PK\x03\x04", "a zip archive; unpack it"),
    (b"PAR1", "a Parquet table"),
    (b"RRF2", "a recording of Rerun; open it with rerun"),
    (b"\x00\x05\x16\x07", "a Mac's resource fork (._ file), not the file itself"),
)


def identify(content: bytes) -> str | None:
    """What the file that starts with `content` is, and what to do about it; None if unknown.

    Args:
        content: The file, or its first 512 bytes.
    """
    if not content:
        return "an empty file; copy it again"
    for start, what in _STARTS:
        if content.startswith(start):
            return what
    head = content[:_HEAD_BYTES].lstrip().lower()
    if head.startswith((b"<!doctype html", b"<html")):
        return "a web page, perhaps of a download that failed; download the file itself"
    if not content[:_HEAD_BYTES].strip(b"\x00"):
        return "nothing but zero bytes; copy it again"
    return None


def identify_file(path: Path) -> str | None:
    """`identify` of the file at `path`; None if it cannot be read."""
    try:
        with path.open("rb") as file:
            return identify(file.read(_HEAD_BYTES))
    except (OSError, ValueError):
        return None
