"""Going on with a run that was stopped: which of its episodes are recorded already."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from mapreplay.episode import prepare_episode
from mapreplay.errors import LogError
from mapreplay.predictors import Predictor
from mapreplay.recorders.batch import Task
from mapreplay.recorders.log.facts import header_differences
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.step import EpisodeHeader


@dataclass(frozen=True)
class Resumption:
    """What is left of a run."""

    finished: list[Path]
    """The logs that are there."""
    tasks: list[Task]
    """The episodes that are not; they overwrite what was left of them as ``.part``."""


def resume(tasks: Sequence[Task], predictor: Predictor) -> Resumption:
    """Find the episodes of `tasks` that are finished.

    An episode is finished if its log is there and its header says what this run would write:
    configuration, floor plan, start, budget, predictor and weights, and the versions of what the
    result depends on. Tasks that may overwrite (`Task.force`) do so with logs that say otherwise.

    Raises:
        LogError: a log of that name is of another episode, unfinished or damaged, and may not
            be overwritten.
    """
    finished, left = [], []
    for task in tasks:
        header = prepare_episode(task.config, task.floor_plan, predictor=predictor).header
        if task.path.exists() and _is_finished(task.path, header, force=task.force):
            finished.append(task.path)
        else:
            left.append(replace(task, force=True))
    return Resumption(finished, left)


def _is_finished(path: Path, header: EpisodeHeader, *, force: bool) -> bool:
    try:
        log = EpisodeLog(path)
        if not log.finished:
            raise LogError(f"{path}: {log.state}")
        others = header_differences(log.header, header)
        if others:
            said = "; ".join(f"{fact.what} {fact.a}, here {fact.b}" for fact in others)
            raise LogError(f"{path}: a log of another episode ({said})")
    except LogError as error:
        if force:
            return False
        raise LogError(
            f"{error}; choose another --out, move it away, or overwrite it with --force"
        ) from None
    return True
