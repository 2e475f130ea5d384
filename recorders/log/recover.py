"""Finishing a log that nobody finished, or that was damaged: the steps that can be read.

If all steps are among them, the new file is, byte for byte, the one that an undisturbed recording
leaves. Otherwise it has an index, checksums and the table of its steps, which keep their numbers,
and its record ``mapreplay.outcome`` says what is lost: the outcome is empty where the end is, and
steps in the middle are listed. ``EpisodeLog.finished`` is False, and its `state` says why.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from mapreplay.errors import LogError, WriteError
from mapreplay.files.whole import check_new, whole_path
from mapreplay.recorders.log.find import whereabouts
from mapreplay.recorders.log.lock import is_locked
from mapreplay.recorders.log.mcap.index import Tail
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.recorders.log.salvage import SalvagedLog
from mapreplay.recorders.log.state import Condition, gaps_in
from mapreplay.recorders.log.writer import EpisodeWriter
from mapreplay.step import Outcome


@dataclass(frozen=True)
class Recovered:
    """What was saved of a log, and what was not."""

    path: Path
    """The finished file."""
    steps: int
    """How many steps are in it, the one at the start included."""
    last: int
    """The number of the last of them."""
    outcome: Outcome | None
    """How the episode ended; None if its end is lost."""
    missing: tuple[range, ...]
    """The steps before the last that are lost."""
    damages: tuple[str, ...]
    """What could not be read of the source and why, a line each."""
    tail: Tail | None
    """What follows the end of the log in the source."""

    @property
    def whole(self) -> bool:
        """Whether the episode's last step is in it, and all before."""
        return self.outcome is not None and not self.missing


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
        LogError: another process is writing `source`, or not even a step can be read.
        ExistsError: the new file is there already.
        WriteError: it cannot be written.
    """
    source = whereabouts(source)
    if is_locked(source):
        raise LogError(f"{source}: another process is writing it; wait until it is done")
    if source.suffix == ".mcap" and _is_intact(source):
        return None
    path = recovered_path(source)
    if path.suffix != ".mcap":
        raise LogError(f"{source}: the name of a log ends in .mcap or .mcap.part")
    check_new(path, force=force)
    log = SalvagedLog(source)
    with whole_path(path, force=force) as draft:
        try:
            numbers, outcome = _write(log, draft)
        except WriteError as error:  # nobody has heard of the draft
            raise WriteError(str(error).replace(f"{draft}.part", str(path))) from None
    return Recovered(
        path=path,
        steps=len(numbers),
        last=numbers[-1],
        outcome=outcome,
        missing=gaps_in(numbers, numbers[-1]),
        damages=tuple(log.damages),
        tail=log.tail,
    )


def _write(log: SalvagedLog, path: Path) -> tuple[list[int], Outcome | None]:
    """Write the steps that can be read; their numbers, and how the episode ended."""
    writer = EpisodeWriter(path, log.header, profile=True, force=True)  # the draft is there
    numbers: list[int] = []
    outcome = None
    try:
        with writer:
            for step in log.readable_steps():
                writer.skip_to(step.index)
                writer.add(step)
                numbers.append(step.index)
                outcome = step.outcome
                if outcome is not None:
                    break
            if not numbers:
                reason = log.damages[0] if log.damages else "cut off before its first step"
                raise LogError(f"{log.path}: no step of it can be read ({reason})")
            writer.close_recovered()
    finally:
        with suppress(OSError):
            writer.part.unlink(missing_ok=True)
    return numbers, outcome


def _is_intact(source: Path) -> bool:
    with suppress(LogError):
        log = EpisodeLog(source)
        if log.repacked and not log.state.whole:  # another tool left steps out
            return False
        log.table()  # which is written anew if it is damaged
        for _ in log:  # checksums may be right where a message is not
            pass
        return log.state.tail is None and log.state.condition in _WHOLE_FILES
    return False


_WHOLE_FILES = {Condition.FINISHED, Condition.SCALARS_ONLY, Condition.RECOVERED}
