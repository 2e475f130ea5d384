"""Identifies files of unexpected types: the cause behind "not a PNG image"."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from mapreplay.files.whole import open_regular

SAFETENSORS: Final = "a safetensors file (weights)"

_HEAD_BYTES: Final = 512

_STARTS: Final[tuple[tuple[bytes, str], ...]] = (
    (
        b"version https://git-lfs.github.com/spec/",
        "a Git LFS pointer, not the file itself; run git lfs pull",
    ),
    (b"/annex/objects/", "a git-annex pointer, not the file itself; run git annex get"),
    (b"outs:\n- ", "a DVC pointer, not the file itself; run dvc pull"),
    (b"SQLite format 3\x00", "a SQLite database (a ROS 2 bag, .db3?)"),
    (b"#ROSBAG V", "a ROS 1 bag"),
    (b"\x89MCAP0\r\n", "an MCAP file (a log or a ROS 2 bag; see mapreplay ls)"),
    (b"\x89MCAP0\n", "an MCAP file that was changed when it was copied as text; copy it as binary"),
    (b"\x89PNG\r\n\x1a\n", "a PNG image"),
    (
        b"\x89PNG\n\x1a\n",
        "a PNG image that was changed when it was copied as text; copy it as binary",
    ),
    (b"\xff\xd8\xff", "a JPEG image; convert it to PNG"),
    (b"GIF87a", "a GIF image; convert it to PNG"),
    (b"GIF89a", "a GIF image; convert it to PNG"),
    (b"II*\x00", "a TIFF image; convert it to PNG"),
    (b"MM\x00*", "a TIFF image; convert it to PNG"),
    (b"8BPS", "a Photoshop image; convert it to PNG"),
    (b"gimp xcf", "a GIMP image; export it as PNG"),
    (b"%PDF-", "a PDF document; export the page as PNG"),
    (b"%!PS", "a PostScript document; export the page as PNG"),
    (b"AC10", "a DWG drawing; export it as PNG"),
    (b"\x1f\x8b", "gzip-compressed; unpack it with gunzip"),
    (b"\x28\xb5\x2f\xfd", "zstd-compressed; unpack it with unzstd"),
    (b"\xfd7zXZ\x00", "xz-compressed; unpack it with unxz"),
    (b"BZh", "bzip2-compressed; unpack it with bunzip2"),
    (b"\x04\x22\x4d\x18", "lz4-compressed; unpack it with unlz4"),
    (b"7z\xbc\xaf\x27\x1c", "a 7z archive; unpack it"),
    (b"Rar!\x1a\x07", "a RAR archive; unpack it"),
    (b"PAR1", "a Parquet table"),
    (b"\x93NUMPY", "a NumPy array (.npy)"),
    (b"\x89HDF\r\n\x1a\n", "an HDF5 file"),
    (b"RRF2", "a recording of Rerun; open it with rerun"),
    (b"\x00\x05\x16\x07", "a Mac's resource fork (._ file), not the file itself"),
    (b"\x00\x05\x16\x00", "a Mac's AppleSingle file; save the file itself again"),
    (b"\xff\xfe", "UTF-16 text; save it as UTF-8"),
    (b"\xfe\xff", "UTF-16 text; save it as UTF-8"),
    (b"\x80\x02", "a Python pickle, which is never read; save weights as safetensors"),
)
_NETPBM: Final = {
    b"P1": "a PBM image; convert it to PNG",
    b"P2": "a PGM image",
    b"P3": "a PPM image; convert it to PNG",
    b"P4": "a PBM image; convert it to PNG",
    b"P5": "a PGM image",
    b"P6": "a PPM image; convert it to PNG",
    b"P7": "a PAM image; convert it to PNG",
}


def identify(content: bytes) -> str | None:
    """The type of the file that starts with `content`, and what to do; None if unknown.

    Args:
        content: The file, or its first 512 bytes.
    """
    if not content:
        return "an empty file; copy it again"
    content = content[:_HEAD_BYTES]
    for start, what in _STARTS:
        if content.startswith(start):
            return what
    if content.startswith(b"PK\x03\x04"):
        return _zip(content)
    if content[:2] in _NETPBM and content[2:3].isspace():
        return _NETPBM[content[:2]]
    if content.startswith(b"RIFF") and content[8:12] == b"WEBP":
        return "a WebP image; convert it to PNG"
    if content.startswith(b"BM") and content[6:10] == bytes(4):
        return "a BMP image; convert it to PNG"
    if content[4:8] == b"ftyp":
        return "an AVIF, HEIF or MP4 file; convert an image to PNG"
    if content[257:262] == b"ustar":
        return "a tar archive"
    if content[8:9] == b"{" and content[4:8] == bytes(4):
        return SAFETENSORS
    if not content.strip(b"\x00"):
        return "zero bytes, as after a broken copy; copy it again"
    return _text(content.removeprefix(b"\xef\xbb\xbf").lstrip().lower())


def _zip(content: bytes) -> str:
    """By the name of the first member."""
    name = content[30 : 30 + int.from_bytes(content[26:28], "little")]
    if name.endswith(b"data.pkl"):
        return "a PyTorch checkpoint, a pickle, which is never read; save weights as safetensors"
    if name.endswith(b".npy"):
        return "a NumPy archive (.npz)"
    return "a zip archive; unpack it"


def _text(head: bytes) -> str | None:
    if head.startswith((b"<!doctype html", b"<html")):
        return "a web page, perhaps of a download that failed; download the file itself"
    if head.startswith(b"<svg") or (head.startswith(b"<?xml") and b"<svg" in head):
        return "an SVG drawing; export it as PNG"
    if head.startswith(b"<?xml"):
        return "an XML file, perhaps of a download that failed; download the file itself"
    return None


def identify_file(path: Path) -> str | None:
    """`identify` of the file at `path`; None if it cannot be read."""
    try:
        with open_regular(path) as file:
            return identify(file.read(_HEAD_BYTES))
    except (OSError, ValueError):
        return None


def unlike(path: Path, expected: str, content: bytes | None = None) -> str:
    """The message that `path` is not `expected`, with its type if known.

    Args:
        path: The file.
        expected: The expected type, with its article: "a PNG or PGM image".
        content: The file or its first 512 bytes, if they have been read.
    """
    what = identify_file(path) if content is None else identify(content)
    return f"{path}: not {expected}" + (f": {what}" if what else "")
