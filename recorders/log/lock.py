"""An advisory lock on a file that is being written; it is gone when its process is."""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

from mapreplay.files.whole import open_regular


def lock(file: BinaryIO) -> bool:
    """Lock `file` until it is closed; False if another writer has it.

    True also where there are no such locks: on Windows, and on some network file systems.
    """
    if sys.platform != "win32":
        import fcntl

        try:
            fcntl.flock(file.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        except OSError:
            pass
    return True


def move(file: BinaryIO, source: Path, target: Path) -> None:
    """Rename `file`, which is at `source`, while it is locked, and close it."""
    if sys.platform == "win32":  # where an open file cannot be renamed
        file.close()
    source.replace(target)
    file.close()


def is_locked(path: Path) -> bool:
    """Whether somebody writes the file at `path` now; False where that cannot be known."""
    with suppress(OSError), open_regular(path) as file:
        return not lock(file)
    return False


def is_at(file: BinaryIO, path: Path) -> bool:
    """Whether the open `file` is what is at `path`: not moved, removed, replaced or linked."""
    try:
        return os.path.samestat(os.fstat(file.fileno()), path.lstat())
    except FileNotFoundError:
        return False
