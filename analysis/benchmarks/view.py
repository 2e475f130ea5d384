"""Benchmark of the view: from a log to an .rrd, compared with the importer of Rerun's own viewer.

Time is that of the processor, all threads together, so that a busy machine is measured like an
idle one; the least of the rounds counts.
"""

from __future__ import annotations

import resource
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from typing import Final

from mapreplay.analysis.benchmarks.log import four_in_a_square
from mapreplay.config import EpisodeConfig, MapKind
from mapreplay.episode import prepare_episode, run_episode
from mapreplay.errors import MapreplayError, UsageError
from mapreplay.floorplan import FloorPlan
from mapreplay.floorplans import open_source
from mapreplay.predictors import Predictor
from mapreplay.processes.workers import Program
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.recorders.log.writer import EpisodeWriter
from mapreplay.recorders.pictures.replay import Replay
from mapreplay.recorders.viewer.recording import save_rrd
from mapreplay.recorders.viewer.servers import viewer_program

_SMALLEST: Final = 64
"""Cells per side of a procedural floor plan."""


@dataclass(frozen=True)
class ViewMeasurement:
    """One way from a log to what the viewer opens."""

    how: str
    seconds: float
    """Of processor time, the minimum of the rounds."""
    megabytes: float
    """Of the .rrd."""
    share_of_raw: float
    """Of the bytes that the three grids of every step have as uint8."""


def floor_plan_of(side: int) -> FloorPlan:
    """Procedural floor plans in a square of `side` cells: 64, 128, 256 or 512.

    Raises:
        UsageError: another size.
    """
    if side not in (_SMALLEST, 128, 256, 512):
        raise UsageError(f"{side} cells a side; 64, 128, 256 or 512 are possible")
    source = open_source("procedural:50000-50063")
    plans = [source.load(f"procedural-{50000 + i}") for i in range((side // _SMALLEST) ** 2)]
    while len(plans) > 1:
        plans = [four_in_a_square(plans[i : i + 4]) for i in range(0, len(plans), 4)]
    return plans[0]


def record_long(path: Path, plan: FloorPlan, steps: int, predictor: Predictor) -> int:
    """Record the first `steps` steps of an exploration that observes everything; how many it has.

    Nearest Frontier goes on until each cell is observed, with a prediction at every step.
    """
    config = EpisodeConfig(
        planner="nearest",
        predictor=predictor.identity.name,
        plan_on=MapKind.OBSERVED,
        build=MapKind.OBSERVED,
        coverage=1.0,
        max_steps=max(1, steps - 1),
    )
    episode = prepare_episode(config, plan, predictor=predictor)
    count = 0
    with EpisodeWriter(path, episode.header) as writer:
        for step in islice(run_episode(episode), steps):
            writer.add(step)
            count += 1
    return count


def measure_view(log: Path, rounds: int) -> Iterator[ViewMeasurement]:
    """Our .rrd of a log, and that of ``rerun mcap convert``.

    Raises:
        LogError: the log cannot be read.
        MapreplayError: Rerun's program fails.
    """
    with TemporaryDirectory() as folder:
        ours, theirs = Path(folder) / "ours.rrd", Path(folder) / "theirs.rrd"

        def convert() -> None:
            save_rrd(ours, [Replay.of(EpisodeLog(log))], force=True)

        def importer() -> None:
            command = [str(viewer_program()), "mcap", "convert", str(log), "-o", str(theirs)]
            with Program(command) as program:
                code = program.wait()
            if code:
                raise MapreplayError(f"rerun mcap convert failed on {log}")

        opened = EpisodeLog(log)
        raw = 3 * len(opened) * opened.header.floor_plan.cells.size
        for how, work, result in (
            ("mapreplay view --save", convert, ours),
            ("rerun mcap convert", importer, theirs),
        ):
            seconds = min(_timed(work) for _ in range(rounds))
            size = result.stat().st_size
            yield ViewMeasurement(how, seconds, size / 1e6, size / raw)


def _timed(work: Callable[[], None]) -> float:
    """Processor seconds of this process and of its children that have ended."""
    before = process_time() + _of_children()
    work()
    return process_time() + _of_children() - before


def _of_children() -> float:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime
