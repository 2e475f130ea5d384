"""Going on with a run that was stopped: which of its episodes are recorded already."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from mapreplay.episode import prepare_episode
from mapreplay.errors import LogError
from mapreplay.predictors import Predictor
from mapreplay.recorders.batch import Task
from mapreplay.recorders.log.header import episode_pairs
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
            raise LogError(f"{path}: a log of another episode ({'; '.join(others)})")
    except LogError as error:
        if force:
            return False
        raise LogError(
            f"{error}; choose another --out, move it away, or overwrite it with --force"
        ) from None
    return True


def header_differences(there: EpisodeHeader, here: EpisodeHeader) -> list[str]:
    """In what a log differs from the one that would be written, each in a few words."""
    then, now = _facts(there), _facts(here)
    return [
        f"{name} {then.get(name, 'none')}, here {now.get(name, 'none')}"
        for name in (then | now)
        if then.get(name) != now.get(name)
    ]


def _facts(header: EpisodeHeader) -> dict[str, str]:
    """Everything that a header says, by a name for people."""
    config = {
        key.replace("_", "-"): str(value)
        for key, value in header.config.model_dump(mode="json").items()
    }
    pairs = episode_pairs(header)
    said_otherwise = {
        "config", "versions", "crc32", "seed", "start", "max_steps", "predictor",
        "predictor_sha256",
    }  # fmt: skip
    return {
        **config,
        **{key.replace("_", " "): pairs[key] for key in pairs if key not in said_otherwise},
        "start cell": pairs["start"],
        "budget": str(header.max_steps),
        "predictor": header.predictor.name,
        "weights": header.predictor.sha256[:12] or "none",
        **{f"version of {name}": version for name, version in header.versions},
    }
