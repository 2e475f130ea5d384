"""What `mapreplay train` provides to a training: processes, logs, and output on stderr."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from mapreplay.analysis.pool import map_unordered
from mapreplay.cli.output import note
from mapreplay.cli.progress import progress_bar
from mapreplay.errors import LogError
from mapreplay.recorders.log.blame import blaming
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.recorders.sampled import observed_maps
from mapreplay.training.dataset import MAPS_PER_LOG, TrainingPlan, prepare_plan
from mapreplay.training.job import Environment


def environment() -> Environment:
    """The environment of a training on the command line."""
    return Environment(map_unordered, _read_log, note, _progress)


@contextmanager
def _progress(what: str, total: int) -> Iterator[Callable[[int], None]]:
    with progress_bar() as bar:
        task = bar.add_task(what, total=total)
        yield lambda completed: bar.update(task, completed=completed)


def _read_log(numbered: tuple[int, Path]) -> tuple[str, TrainingPlan] | LogError:
    number, path = numbered
    try:
        with blaming(path):
            log = EpisodeLog(path)
            plan, start = log.header.floor_plan, log.header.start
            return plan.id, prepare_plan(number, plan, start, observed_maps(log, MAPS_PER_LOG))
    except LogError as error:
        return error
