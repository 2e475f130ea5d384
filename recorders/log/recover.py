"""Finishing a log that nobody finished: the steps that can be read, as a whole file.

A log is recovered up to its first damaged or missing step. If its last step is among what was
read, the new file is, byte for byte, the one that an undisturbed recording leaves. Otherwise
the outcome in its record ``mapreplay.outcome`` is empty: such a file has an index, checksums
and the table of its steps, but ``EpisodeLog.finished`` is False, and every verb that says how
an episode ended calls it unfinished.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from mapreplay.errors import LogError
from mapreplay.recorders.log.lock import is_locked
from mapreplay.recorders.log.reader import EpisodeLog, SalvagedLog
from mapreplay.recorders.log.writer import EpisodeWriter
from mapreplay.step import Step


@dataclass(frozen=True)
class Recovered:
    """What was saved of a log, and what was not."""

    path: Path
    """The finished file."""
    steps: int
    """How many steps are in it, the one at the start included."""
    whole: bool
    """Whether the episode's last step is among them, so that nothing is missing."""
    damage: str | None
    """Where the reading stopped and why, as a line; None if the source just ends there."""


def recovered_path(source: Path) -> Path:
    """``x.mcap`` for ``x.mcap.part``, otherwise ``x.recovered.mcap`` for ``x.mcap``."""
    if source.suffix == ".part":
        return source.with_suffix("")
    return source.with_suffix(".recovered.mcap")


def recover(source: Path, *, force: bool = False) -> Recovered | None:
    """Write what can be read of `source` to `recovered_path(source)`; `source` stays.

    Returns None where nothing is to be done: `source` has its name and is intact.

    Args:
        source: An unfinished, cut or damaged log.
        force: Overwrite the file of that name.

    Raises:
        LogError: another process is writing `source`, not even its first step can be read, or
            the new file is there already or cannot be written.
    """
    if is_locked(source):
        raise LogError(f"{source}: another process is writing it; wait until it is done")
    if source.suffix == ".mcap" and _is_intact(source):
        return None
    path = recovered_path(source)
    if path.suffix != ".mcap":
        raise LogError(f"{source}: the name of a log ends in .mcap or .mcap.part")
    if path.exists() and not force:
        raise LogError(f"{path}: exists; move it away, or overwrite it with --force")
    log = SalvagedLog(source)
    # `source` may be the .part of `path`: the writer needs another one.
    draft = path.with_suffix(".recovering.mcap")
    writer = EpisodeWriter(draft, log.header, profile=True, force=True)
    damage: list[str] = []
    last: Step | None = None
    try:
        with writer:
            for last in _until_damage(log.steps(), damage):
                writer.write(last)
                if last.outcome is not None:
                    break
            if last is None:
                raise LogError(next(iter(damage), f"{source}: cut off before its first step"))
            writer.close_recovered()
        draft.replace(path)
    except OSError as error:
        raise LogError(f"{path}: cannot be written ({error.strerror or error})") from None
    finally:
        for left in (draft, writer.part):
            with suppress(OSError):
                left.unlink(missing_ok=True)
    return Recovered(path, last.index + 1, last.outcome is not None, damage[0] if damage else None)


def _is_intact(source: Path) -> bool:
    with suppress(LogError):
        return EpisodeLog(source).summary is not None
    return False


def _until_damage(steps: Iterator[Step], damage: list[str]) -> Iterator[Step]:
    """The steps before the first error, which goes to `damage`."""
    try:
        yield from steps
    except LogError as error:
        damage.append(str(error))
