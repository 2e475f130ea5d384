"""From what is named on a command line to logs. Imports nothing slow: a mistyped name is told
at once.
"""

from __future__ import annotations

import glob
import os
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Final

from mapreplay.errors import LogError
from mapreplay.files.identify import identify_file
from mapreplay.files.whole import open_regular

SUFFIXES: Final = (".mcap", ".mcap.part")

_BESIDE: Final = {
    ".diagnosis.json": "a diagnosis, not a log; name the .mcap file that it is of",
    ".zip": "a zip archive, not a log; unpack it, and name the .mcap file in it",
}
"""What lies beside logs and is called like them, so that a pattern of the shell has it too."""
_FORK: Final = "a Mac's resource fork (._ file), not the log; name the file without ._"
_BAGS: Final = (".db3", ".bag")


def find_logs(paths: Sequence[Path]) -> list[Path]:
    """The logs that files, folders (searched through) and glob patterns stand for, sorted.

    Diagnoses and bundles that are named beside logs are left out. In folders, names that begin
    with a dot are passed over, as the shell does it, and links to folders are not followed. What
    is there and cannot be read, such as a link without a target or a folder without permission,
    is among what is returned: whoever opens it is told why.

    Raises:
        LogError: a path does not exist, there is no log in it, or there are no logs at all.
    """
    return _once({log for logs in find_each(paths) for log in logs})


def _once(logs: set[Path]) -> list[Path]:
    """Sorted, without those that were found a second time, through a link to a folder."""
    folders = {folder: Path(os.path.realpath(folder)) for folder in {log.parent for log in logs}}
    by_place: dict[Path, list[Path]] = {}
    for log in sorted(logs):
        by_place.setdefault(folders[log.parent] / log.name, []).append(log)
    kept = list[Path]()
    for names in by_place.values():
        links = [sum(map(_is_link, log.parents)) if len(names) > 1 else 0 for log in names]
        kept += [log for log, count in zip(names, links, strict=True) if count == min(links)]
    return sorted(kept)


def _is_link(path: Path) -> bool:
    try:
        return path.is_symlink()
    except OSError:
        return False


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
        logs = {log for match in matches if match not in others for log in _logs_in(match)}
        # A folder that is called like a log is in a shell's list of logs.
        listed = len(paths) > 1 and path.name.endswith(SUFFIXES)
        if not logs and not others and not listed:
            raise LogError(f"{path}: no .mcap or .mcap.part file in it{_bag_in(path)}")
        found.append(sorted(logs))
    if not any(found):
        if beside:
            raise LogError(f"{beside[0]}: {_what_else(beside[0])}")
        raise LogError(f"{paths[0]}: no .mcap or .mcap.part file in it")
    return found


def whereabouts(path: Path) -> Path:
    """`path`, or for an unfinished log that was finished meanwhile the name that it has now."""
    if path.suffix == ".part" and not _is_there(path):
        finished = path.with_suffix("")
        if _is_there(finished):
            return finished
    return path


def find_same(logs: Sequence[Path]) -> dict[Path, Path]:
    """Which of the logs are the same file as one before them: by other names of it, or copies.

    Where a file cannot be read it is like no other.
    """
    by_size: dict[int, list[Path]] = {}
    for log in logs:
        with suppress(OSError):
            by_size.setdefault(log.stat().st_size, []).append(log)
    same: dict[Path, Path] = {}
    for alike in by_size.values():
        firsts: list[Path] = []
        for log in alike:
            first = next((other for other in firsts if _is_same(log, other)), None)
            if first is None:
                firsts.append(log)
            else:
                same[log] = first
    return same


def _is_same(a: Path, b: Path) -> bool:
    with suppress(OSError):
        if a.samefile(b):
            return True
        with open_regular(a) as one, open_regular(b) as other:
            while block := one.read(_BLOCK):
                if block != other.read(_BLOCK):
                    return False
            return True
    return False


_BLOCK: Final = 1 << 16


def _is_there(path: Path) -> bool:
    """Whether there is something of that name, if only a link without a target."""
    try:
        path.lstat()
    except (FileNotFoundError, NotADirectoryError, ValueError):
        return False
    except OSError:  # whoever opens it is told
        return True
    return True


def _is_folder(path: Path) -> bool:
    try:
        return path.is_dir()
    except OSError:
        return False


def _matches(path: Path) -> list[Path]:
    if _is_there(path):
        return [path]
    if _is_there(now := whereabouts(path)):
        return [now]
    matches = list(_glob(path))
    if not matches:
        pattern = glob.has_magic(str(path))
        raise LogError(f"{path}: {'matches nothing' if pattern else 'no such file or folder'}")
    return matches


def _glob(pattern: Path) -> Iterator[Path]:
    if "**" not in pattern.parts:
        # Path.glob takes no absolute patterns.
        yield from map(Path, glob.glob(str(pattern)))  # noqa: PTH207
        return
    # glob.glob would follow links to folders, also to one that it is in.
    fixed = next(i for i, part in enumerate(pattern.parts) if glob.has_magic(part))
    wanted = pattern.parts[fixed:]
    hidden = any(part.startswith(".") for part in wanted)
    base = Path(*pattern.parts[:fixed])
    for match in base.glob(str(Path(*wanted))):
        if hidden or not any(p.startswith(".") for p in match.relative_to(base).parts):
            yield match


def _what_else(path: Path) -> str | None:
    """What a file is that is no log, or None where it may be one."""
    if _is_folder(path):
        return None
    if path.name.startswith("._"):
        return _FORK
    return next((what for end, what in _BESIDE.items() if path.name.endswith(end)), None)


def _logs_in(path: Path) -> set[Path]:
    if not _is_folder(path):
        return {path}
    # Twice: a log that is finished while a folder is listed may be in the list under neither name.
    found = _listed(path) | _listed(path)
    return {log for log in found if whereabouts(log) not in found or whereabouts(log) == log}


def _listed(folder: Path) -> set[Path]:
    found, waiting = set(), [folder]
    while waiting:
        at = waiting.pop()
        try:
            with os.scandir(at) as entries:
                for entry in entries:
                    if entry.name.startswith("."):
                        continue
                    if entry.is_dir(follow_symlinks=False):
                        waiting.append(at / entry.name)
                    elif entry.name.endswith(SUFFIXES) and not _is_folder(at / entry.name):
                        found.add(at / entry.name)
        except FileNotFoundError:  # removed meanwhile
            continue
        except OSError:  # whoever opens it is told
            found.add(at)
    return found


def _bag_in(path: Path) -> str:
    """What else is in a folder without logs, if that is known."""
    with suppress(OSError):
        for file in sorted(path.iterdir()):
            if file.suffix in _BAGS and (what := identify_file(file)):
                return f"; {file.name} is {what}"
    return ""
