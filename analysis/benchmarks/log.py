"""Benchmark of the log: recording, reading and size, compared with other libraries in the same run.

Contenders take turns, and medians over the rounds are compared, so that a busy machine is as
hard on one as on the other.
"""

from __future__ import annotations

import io
import statistics
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import zstandard

from mapreplay.analysis.benchmarks.log_peers import (
    Recorder,
    Run,
    read_metrics_with_mcap,
    read_with_mcap,
    recorders,
    write_ours,
)
from mapreplay.config import EpisodeConfig
from mapreplay.episode import prepare_episode, run_episode
from mapreplay.errors import UsageError
from mapreplay.floorplan import FloorPlan
from mapreplay.grid import Grid
from mapreplay.predictors import Predictor, load_predictor
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.step import PredictorIdentity

BLUR = "blur"


@dataclass(frozen=True)
class BlurPredictor:
    """Walls are where walls are near: a cheap, deterministic substitute for a network."""

    identity: PredictorIdentity = PredictorIdentity(BLUR, "")

    def predict(self, observed: Grid) -> npt.NDArray[np.float32]:
        """Predict P(occupied)."""
        p = np.select([observed == -1, observed == 0], [0.5, 0.0], 1.0).astype(np.float32)
        return np.asarray(cv2.blur(p, (7, 7)), np.float32)


@dataclass(frozen=True)
class Measurement:
    """One line of the benchmark."""

    what: str
    how: str
    value: float | None
    """None if the contender is not installed."""
    unit: str
    ours: float | None
    """Our value divided by this one: below 1 we are better."""


def simulate(floor_plan: FloorPlan, predictor: str, steps: int) -> Run:
    """At most `steps` steps of Nearest Frontier on fused/fused with fail-safe.

    Args:
        floor_plan: Where.
        predictor: "blur", or what `load_predictor` takes.
        steps: How many Steps, the first look included.

    Raises:
        UsageError: fewer than two steps are asked for.
        PluginError, WeightsError: there is no such predictor.
    """
    if steps < 2:
        raise UsageError("the benchmark needs at least 2 steps")
    loaded: Predictor = BlurPredictor() if predictor == BLUR else load_predictor(predictor)
    config = EpisodeConfig(
        planner="nearest", predictor=predictor, fail_safe=True, max_steps=steps - 1
    )
    episode = prepare_episode(config, floor_plan, predictor=loaded)
    return Run(episode.header, list(run_episode(episode)))


def four_in_a_square(plans: Sequence[FloorPlan]) -> FloorPlan:
    """Four floor plans of one size in a square, with doors between neighbours."""
    a, b, c, d = (plan.cells for plan in plans)
    cells = np.block([[a, b], [c, d]])
    height, width = a.shape
    for row in (height // 3, height + height // 3):
        cells[row : row + 4, width - 6 : width + 6] = 0
    for col in (width // 3, width + width // 3):
        cells[height - 6 : height + 6, col : col + 4] = 0
    return FloorPlan("four-plans", cells, plans[0].resolution, plans[0].origin)


def measure_log(run: Run, rounds: int, folder: Path | None = None) -> Iterator[Measurement]:
    """Recording, reading and size of one run; the first round is a warm-up and does not count.

    Args:
        run: The episode.
        rounds: Over which medians are taken.
        folder: Where files are written; None is the system's place for temporary ones. We
            alone push our file to the disk, which costs nothing in a folder in memory.
    """
    with TemporaryDirectory(dir=folder) as name:
        path = Path(name) / "ours.mcap"
        write_ours(run, path)
        yield from _measure_recording(run, path.parent, rounds)
        yield from _measure_reading(path, len(run.steps), rounds)
        yield from _measure_size(run, path)


def _measure_recording(run: Run, folder: Path, rounds: int) -> Iterator[Measurement]:
    contenders = recorders()
    installed = {how: recorder for how, recorder in contenders.items() if recorder is not None}

    def seconds(recorder: Recorder) -> float:
        with TemporaryDirectory(dir=folder) as name:
            return recorder(run, Path(name) / "log.mcap")

    turns = {how: partial(seconds, recorder) for how, recorder in installed.items()}
    taken = _take_turns(turns, rounds)
    values = {how: 1e3 * taken[how] / len(run.steps) if how in taken else None
              for how in contenders}  # fmt: skip
    yield from _compared("record", "ms per step", values)


def _measure_reading(path: Path, steps: int, rounds: int) -> Iterator[Measurement]:
    def ours() -> None:
        for _ in EpisodeLog(path).maps("observed", "p_wall", "fused"):
            pass

    def theirs(*, checked: bool) -> None:
        for _ in read_with_mcap(path, checked=checked):
            pass

    def whole() -> None:
        for _ in EpisodeLog(path):
            pass

    maps = _take_turns(
        {
            "mapreplay, EpisodeLog.maps": lambda: _timed(ours),
            "make_reader + rosbags": lambda: _timed(lambda: theirs(checked=False)),
            "make_reader + rosbags, CRCs checked": lambda: _timed(lambda: theirs(checked=True)),
            "mapreplay, whole Steps": lambda: _timed(whole),
        },
        rounds,
    )
    values = {how: 1e3 * seconds / steps for how, seconds in maps.items()}
    yield from _compared("read all maps", "ms per step", values)
    scalars = _take_turns(
        {
            "mapreplay, EpisodeLog.table": lambda: _timed(lambda: EpisodeLog(path).table()),
            "make_reader + rosbags, /metrics": lambda: _timed(lambda: read_metrics_with_mcap(path)),
        },
        rounds,
    )
    yield from _compared(
        "read all scalars", "ms per episode", {how: 1e3 * s for how, s in scalars.items()}
    )


def _measure_size(run: Run, path: Path) -> Iterator[Measurement]:
    arrays = step_arrays(run)
    single = {
        f"{name}_{step.index}": value
        for step in run.steps
        for name in ("observed", "p_wall", "fused")
        if (value := getattr(step, name)) is not None
    }
    raw = b"".join(array.tobytes() for array in arrays.values())
    sizes: dict[str, int] = {
        "mapreplay, the finished file": path.stat().st_size,
        "np.savez_compressed, an array a step": _savez(single),
        "np.savez_compressed, stacked at the end": _savez(arrays),
        "zstd -19 of the raw bytes": len(zstandard.compress(raw, 19)),
    }
    yield from _compared(
        "size", "bytes per step", {how: size / len(run.steps) for how, size in sizes.items()}
    )


def step_arrays(run: Run) -> dict[str, npt.NDArray[Any]]:
    """All that the Steps of a run hold, as few arrays: maps stacked, lists one after another."""
    steps = run.steps
    decisions = [step.decision for step in steps if step.decision is not None]
    rated = [candidate for d in decisions for candidate in (d.chosen, *d.rivals)]
    arrays: dict[str, npt.NDArray[Any]] = {
        "truth": run.header.floor_plan.cells,
        "observed": np.stack([step.observed for step in steps]),
        "fused": np.stack([step.fused for step in steps]),
        "agent": np.array([step.agent for step in steps], np.int32),
        "hits": np.stack([step.hits for step in steps]),
        "frontier": np.concatenate([step.frontier for step in steps]),
        "frontier_length": np.array([len(step.frontier) for step in steps], np.int32),
        "path": np.concatenate([d.path for d in decisions]),
        "path_length": np.array([len(d.path) for d in decisions], np.int32),
        "candidates": np.array(
            [(*c.cell, c.utility, c.reward, c.straight, c.diagonal) for c in rated]
        ),
        "candidates_length": np.array([1 + len(d.rivals) for d in decisions], np.int32),
        "metrics": np.array(
            [[getattr(step.metrics, n) for n in step.metrics.names()] for step in steps]
        ),
    }
    predictions = [step.p_wall for step in steps if step.p_wall is not None]
    return arrays | ({"p_wall": np.stack(predictions)} if predictions else {})


def _savez(arrays: Mapping[str, npt.NDArray[Any]]) -> int:
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
    return len(file.getvalue())


def _timed(action: Callable[[], object]) -> float:
    began = perf_counter()
    action()
    return perf_counter() - began


def _take_turns(contenders: Mapping[str, Callable[[], float]], rounds: int) -> dict[str, float]:
    """Median seconds of each; they take turns, after a round of warm-up."""
    taken: dict[str, list[float]] = {how: [] for how in contenders}
    for number in range(rounds + 1):
        for how, contender in contenders.items():
            seconds = contender()
            if number > 0:
                taken[how].append(seconds)
    return {how: statistics.median(seconds) for how, seconds in taken.items()}


def _compared(what: str, unit: str, values: Mapping[str, float | None]) -> Iterator[Measurement]:
    """Lines in which the first contender is ours."""
    ours = next(iter(values.values()))
    for how, value in values.items():
        ratio = None if ours is None or value is None else ours / value
        yield Measurement(what, how, value, unit, ratio)
