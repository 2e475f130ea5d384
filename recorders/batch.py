"""Recording many episodes, one after the other or in several processes."""

from __future__ import annotations

import time
from collections.abc import Generator, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Final, TypeAlias

from mapreplay.config import EpisodeConfig
from mapreplay.episode import prepare_episode, recorded
from mapreplay.errors import MapreplayError
from mapreplay.floorplan import FloorPlan
from mapreplay.predictors import kept_predictor
from mapreplay.processes.workers import Died, Yielded, run_each
from mapreplay.recorders.log.writer import EpisodeWriter
from mapreplay.step import log_name

REPORT_SECONDS: Final = 0.1


@dataclass(frozen=True, eq=False)
class Task:
    """One episode to record."""

    config: EpisodeConfig
    floor_plan: FloorPlan
    folder: Path
    device: str
    profile: bool
    force: bool
    weights: Path | None = None
    """The file of the predictor's weights, where the user gave one; else it is a registered one."""

    @property
    def predictor(self) -> str:
        """What to load, see `mapreplay.predictors.load_predictor`."""
        return str(self.weights or self.config.predictor)

    @property
    def path(self) -> Path:
        """Where its log goes."""
        return self.folder / log_name(self.floor_plan.id, self.config)


@dataclass(frozen=True)
class Progress:
    """How far an episode is."""

    task: int
    step: int
    coverage: float
    """Of the map under construction, 0 to 1."""


@dataclass(frozen=True)
class Done:
    """An episode is finished, and its log is at `path`."""

    task: int
    path: Path


@dataclass(frozen=True)
class Failed:
    """An episode could not be recorded; `reason` is one line."""

    task: int
    reason: str


Report: TypeAlias = Progress | Done | Failed


def record_task(number: int, task: Task) -> Iterator[Report]:
    """Simulate and record one episode; closing the generator leaves a readable ``.part``."""
    try:
        predictor = kept_predictor(task.predictor, task.device)
        episode = prepare_episode(task.config, task.floor_plan, predictor=predictor)
        path = task.path
        with EpisodeWriter(path, episode.header, profile=task.profile, force=task.force) as writer:
            reported = 0.0
            for step in recorded(episode, writer):
                if time.monotonic() - reported > REPORT_SECONDS:
                    reported = time.monotonic()
                    covered = step.metrics.coverage(task.config.build)
                    yield Progress(number, step.index, covered)
        yield Done(number, path)
    except MapreplayError as error:
        yield Failed(number, str(error))


def record_all(tasks: Sequence[Task], jobs: int) -> Generator[Report, None, None]:
    """Record all tasks with `jobs` processes; reports come as they happen.

    The death of a worker costs its episode only. Closing the generator stops the workers;
    what they were recording stays as readable ``.part`` files.
    """
    if jobs == 1 or len(tasks) == 1:
        for number, task in enumerate(tasks):
            yield from record_task(number, task)
        return
    with closing(run_each(_record, list(enumerate(tasks)), jobs)) as events:
        for event in events:
            if isinstance(event, Yielded):
                yield event.what
            elif isinstance(event, Died):
                yield Failed(event.item, f"its worker process died ({event.how})")


def _record(numbered: tuple[int, Task]) -> Iterator[Report]:
    return record_task(*numbered)
