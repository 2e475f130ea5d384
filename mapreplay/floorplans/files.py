"""Reading files that a user names: with limits, and with errors of one line."""

from __future__ import annotations

import re
import reprlib
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from mapreplay.errors import FloorPlanError, UsageError

_ILLEGAL_IN_ID: Final = re.compile(r"[^A-Za-z0-9._+-]+")
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
        raise FloorPlanError(f"{rest}: no such file or folder")
    return path


def exists(path: Path) -> bool:
    """Whether there is such a file or folder; a name that cannot be one is not there."""
    try:
        return path.exists()
    except (OSError, ValueError):
        return False


def read_limited(path: Path, limit: int) -> bytes:
    """The bytes of a regular file of at most `limit` bytes.

    Raises:
        FloorPlanError: there is no such file, it is larger, or it cannot be read.
    """
    try:
        if not path.is_file():  # a folder, or a device that never ends
            problem = "is a folder" if path.is_dir() else "no such file"
            raise FloorPlanError(f"{path}: {problem}")
        with path.open("rb") as file:
            content = file.read(limit + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise FloorPlanError(f"{path}: cannot be read ({reason})") from None
    if len(content) > limit:
        raise FloorPlanError(f"{path}: larger than {_human_size(limit)}")
    return content


def _human_size(size: int) -> str:
    return f"{size >> 20} MiB" if size >= 1 << 20 else f"{size >> 10} KiB"


def brief(value: object) -> str:
    """`value` as an error shows it, in at most 60 characters.

    A small file with references can hold a value that prints as gigabytes, or a number that
    Python refuses to print.
    """
    try:
        text = reprlib.repr(value)
    except ValueError:
        return "a huge number"
    return text if len(text) <= 60 else f"{text[:57]}..."


def unique_ids(names: Iterable[str]) -> list[str]:
    """A legal id of a floor plan for each name, in order; no two are equal.

    What an id may not hold becomes ``-``; the second of two equal ids gets ``-2``, and so on.
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
