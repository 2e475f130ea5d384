"""From what is named on a command line to logs. Imports nothing slow: a mistyped name is told
at once.
"""

from __future__ import annotations

import glob
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from mapreplay.errors import LogError

SUFFIXES: Final = (".mcap", ".mcap.part")

_BESIDE: Final = {
    ".diagnosis.json": "a diagnosis, not a log; name the .mcap file that it is of",
    ".zip": "a zip archive, not a log; unpack it, and name the .mcap file in it",
}
"""What lies beside logs and is called like them, so that a pattern of the shell has it too."""


def find_logs(paths: Sequence[Path]) -> list[Path]:
    """The logs that files, folders (searched through) and glob patterns stand for, sorted.

    Diagnoses and bundles that are named beside logs are left out.

    Raises:
        LogError: a path does not exist, there is no log in it, or there are no logs at all.
    """
    return sorted({log for logs in find_each(paths) for log in logs})


def find_each(paths: Sequence[Path]) -> list[list[Path]]:
    """Like `find_logs`, the logs of each path in the order of the paths.

    Raises:
        LogError: see `find_logs`.
    """
    found, beside = [], list[Path]()
    for path in paths:
        matches = _matches(path)
        others = [match for match in matches if _what_else(match)]
        beside += others
        logs = [log for match in matches if match not in others for log in _logs_in(match)]
        if not logs and not others:
            raise LogError(f"{path}: no .mcap or .mcap.part file in it")
        found.append(sorted(logs))
    if beside and not any(found):
        raise LogError(f"{beside[0]}: {_what_else(beside[0])}")
    return found


def _matches(path: Path) -> list[Path]:
    if path.exists():
        return [path]
    # Path.glob takes no absolute patterns.
    matches = [Path(p) for p in glob.glob(str(path), recursive=True)]  # noqa: PTH207
    if not matches:
        pattern = glob.has_magic(str(path))
        raise LogError(f"{path}: {'matches nothing' if pattern else 'no such file or folder'}")
    return matches


def _what_else(path: Path) -> str | None:
    """What a file is that is no log, or None where it may be one."""
    if path.is_dir():
        return None
    return next((what for end, what in _BESIDE.items() if path.name.endswith(end)), None)


def _logs_in(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path]
    return [log for suffix in SUFFIXES for log in path.rglob(f"*{suffix}") if log.is_file()]
