"""Reading files and folders given by the user, with size limits and one-line errors."""

from __future__ import annotations

import re
import reprlib
from collections.abc import Collection, Iterable
from contextlib import suppress
from pathlib import Path, PurePath
from typing import Final

from mapreplay.errors import FloorPlanError, UsageError

_ILLEGAL_IN_ID: Final = re.compile(r"[^A-Za-z0-9._+-]+")
_MAX_INNER: Final = 100
_MAX_ID: Final = 120
"""Leaves room for a number within the 128 characters of an id."""


def existing_path(source: str, rest: str) -> Path:
    """The file or folder of the specification ``source:rest``.

    Raises:
        UsageError: `rest` is empty.
        FloorPlanError: there is no such file or folder.
    """
    if not rest:
        raise UsageError(f"{source}: which file or folder? Say {source}:PATH")
    path = Path(rest)
    if not exists(path):
        raise FloorPlanError(missing(path))
    return path


def missing(path: Path) -> str:
    """The message that `path` does not exist, with similar names in its folder."""
    if is_link(path):
        return f"{path}: a broken link, to {path.readlink()}"
    line = f"{path}: no such file or folder"
    try:
        there = files_in(path.parent)
    except (FloorPlanError, ValueError):
        return line
    alike = [file for file in there if file.name.lower() == path.name.lower()]
    alike += [file for file in there if file.stem.lower() == path.stem.lower()]
    return f"{line}; is it {alike[0]}?" if alike else line


def exists(path: Path) -> bool:
    """Whether the file or folder exists; False for impossible names."""
    try:
        return path.exists()
    except (OSError, ValueError):
        return False


def is_link(path: Path) -> bool:
    """Whether there is a link of that name, broken or not."""
    try:
        return path.is_symlink()
    except (OSError, ValueError):
        return False


def files_in(folder: Path, endings: Collection[str] = (), *, below: bool = False) -> list[Path]:
    """The entries of `folder` (and `below` it) with one of `endings` in any case, sorted.

    Without `endings` all files are listed. Folders are not listed.

    Junk of other programs is skipped, see `is_junk`.

    Raises:
        FloorPlanError: the folder cannot be read.
    """
    try:
        found = sorted(folder.rglob("*") if below else folder.iterdir())
    except OSError as error:
        raise FloorPlanError(f"{folder}: cannot be read ({error.strerror or error})") from None
    return [
        path
        for path in found
        if (path.suffix.lower() in endings or not endings)
        and not is_junk(path.relative_to(folder))
        and not path.is_dir()
    ]


def folders_in(folder: Path) -> list[Path]:
    """The folders in `folder`, sorted, without hidden ones; only the first of very many."""
    with suppress(OSError):
        inner = sorted(path for path in folder.iterdir() if path.is_dir())
        return [path for path in inner if not is_junk(path.relative_to(folder))][:_MAX_INNER]
    return []


def is_junk(inner: PurePath) -> bool:
    """Whether a path inside a folder or archive is hidden, or junk of macOS.

    A Mac writes ``._x.png`` next to ``x.png`` on many disks and into every archive, and a folder
    ``__MACOSX`` into zips; its ``._`` files have the ending of the file next to them.
    """
    return any(part.startswith(".") or part == "__MACOSX" for part in inner.parts if part != ".")


def read_limited(path: Path, limit: int) -> bytes:
    """The bytes of a regular file of at most `limit` bytes.

    Raises:
        FloorPlanError: there is no such file, it is larger, or it cannot be read.
    """
    try:
        if not path.is_file():  # a folder, or a device that never ends
            raise FloorPlanError(f"{path}: {_why_no_file(path)}")
        with path.open("rb") as file:
            content = file.read(limit + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise FloorPlanError(f"{path}: cannot be read ({reason})") from None
    if len(content) > limit:
        raise FloorPlanError(f"{path}: larger than {_human_size(limit)}")
    return content


def _why_no_file(path: Path) -> str:
    if path.is_dir():
        return "is a folder"
    if is_link(path):
        return f"is a broken link, to {path.readlink()}"
    return "is not a regular file" if path.exists() else "no such file"


def _human_size(size: int) -> str:
    return f"{size >> 20} MiB" if size >= 1 << 20 else f"{size >> 10} KiB"


def brief(value: object) -> str:
    """`value` for an error message, in at most 60 characters.

    A small file with references can contain a value that prints as gigabytes, or a number that
    Python refuses to print.
    """
    try:
        text = reprlib.repr(value)
    except ValueError:
        return "a huge number"
    return text if len(text) <= 60 else f"{text[:57]}..."


def unique_ids(names: Iterable[str]) -> list[str]:
    """A valid, unique floor-plan ID for each name, in order.

    Invalid characters become ``-``; the second of two equal IDs gets ``-2``, and so on.
    """
    ids: dict[str, None] = {}
    for name in names:
        legal = _ILLEGAL_IN_ID.sub("-", name).strip("._+-")[:_MAX_ID] or "map"
        candidate, count = legal, 1
        while candidate in ids:
            count += 1
            candidate = f"{legal}-{count}"
        ids[candidate] = None
    return list(ids)
