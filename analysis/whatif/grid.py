"""The fused maps that other thresholds would have made of the logged predictions.

Open loop: the trajectory, the observations and the predictions stay as they were logged; only
the fused map is recomputed. So a threshold that looks better here may lead an agent elsewhere
(`branch` continues the episode with it).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
import numpy.typing as npt
import polars as pl

from mapreplay import scores
from mapreplay.analysis.episodes.curves import first_reached
from mapreplay.analysis.metrics import kernels
from mapreplay.errors import LogError, UsageError
from mapreplay.grid import FREE, OCCUPIED, UNKNOWN, Grid, Mask, Quantized
from mapreplay.mapping import Thresholds, sure_levels
from mapreplay.recorders.log.reader import EpisodeLog

Reals = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class WhatIf:
    """Fused maps at every step for every pair of thresholds; see the module on what it means."""

    delta_free: tuple[float, ...]
    """m, rising."""
    delta_occupied: tuple[float, ...]
    """n, rising."""
    target: float
    """Coverage at which the episode would have ended."""
    f1: Reals
    """float64[steps, m, n], like the next two; NaN without a true map."""
    coverage: Reals
    correct: Reals
    sealed: npt.NDArray[np.bool_]
    """bool[steps, m, n]: the agent would have had no frontier within reach, planning on the
    fused map and building it, and the target was not reached by then."""
    steps: npt.NDArray[np.int64]
    """int64[k]: the steps that the log has. At others, which a recovered log misses, the scores
    are NaN."""

    def course(self, i: int, j: int) -> Course:
        """The pair delta_free[i], delta_occupied[j]."""
        sealed = np.flatnonzero(self.sealed[:, i, j])
        first = int(sealed[0]) if sealed.size else None
        freed = None
        if first is not None:
            free = self.steps[(self.steps > first) & ~self.sealed[self.steps, i, j]]
            freed = int(free[0]) if free.size else None
        return Course(
            delta_free=self.delta_free[i],
            delta_occupied=self.delta_occupied[j],
            reached=first_reached(self.coverage[:, i, j], self.target),
            sealed=first,
            freed=freed,
            sealed_steps=int(sealed.size),
        )


@dataclass(frozen=True)
class Course:
    """What one pair of thresholds would have meant; a step is None where that never happened."""

    delta_free: float
    delta_occupied: float
    reached: int | None
    """The first step at which the fused map reached the target coverage."""
    sealed: int | None
    """The first step at which the agent would have been sealed in."""
    freed: int | None
    """The first step after that at which it would have a frontier again."""
    sealed_steps: int


def what_if(
    log: EpisodeLog, delta_free: Sequence[float], delta_occupied: Sequence[float]
) -> WhatIf:
    """Fuse every step of a log again with every pair of thresholds.

    Args:
        log: With predictions; read once.
        delta_free: Confidence thresholds of free cells, each in (0, 1], without repetitions.
        delta_occupied: Those of occupied cells, likewise.

    Raises:
        UsageError: a threshold is not in (0, 1], or is repeated.
        LogError: the log cannot be read, or has no prediction.
    """
    grid = _Grid(tuple(sorted(delta_free)), tuple(sorted(delta_occupied)))
    header, truth = log.header, log.header.floor_plan.cells
    agents = log.table().select("step", "row", "col").rows()
    shape = (log.last + 1, len(grid.delta_free), len(grid.delta_occupied))
    f1, coverage, correct = (np.full(shape, np.nan) for _ in range(3))
    sealed = np.zeros(shape, np.bool_)
    reached = np.zeros(shape[1:], np.bool_)
    # A step without a prediction has p = .5 everywhere, which no threshold above 0 decides.
    nothing, some = np.full(truth.shape, 0.5, np.float32), False
    for maps, (k, row, col) in zip(log.maps("observed", "p_wall"), agents, strict=True):
        observed, predicted = cast("tuple[Grid, Quantized | None]", maps)
        some |= predicted is not None
        p_wall = nothing if predicted is None else predicted
        free, occupied = grid.levels(p_wall)
        of_step = _scores(observed, p_wall, truth, log.header.explorable, free, occupied)
        f1[k], coverage[k], correct[k] = of_step
        kernels.sealed_thresholds(p_wall, observed, row, col, free, occupied, sealed[k])
        reached |= coverage[k] >= header.config.coverage
        sealed[k] &= ~reached  # an episode that has reached its target has ended
    if not some:
        raise LogError(f"{log.path}: no step has a prediction to threshold")
    return WhatIf(
        grid.delta_free,
        grid.delta_occupied,
        header.config.coverage,
        f1,
        coverage,
        correct,
        sealed,
        np.array(log.indices, np.int64),
    )


@dataclass(frozen=True)
class _Grid:
    """Pairs of thresholds."""

    delta_free: tuple[float, ...]
    delta_occupied: tuple[float, ...]

    def __post_init__(self) -> None:
        for name, values in (("free", self.delta_free), ("occupied", self.delta_occupied)):
            if not values or not all(0 < value <= 1 for value in values):
                raise UsageError(f"delta-{name}: thresholds must be above 0 and at most 1")
            if len(set(values)) < len(values):
                raise UsageError(f"delta-{name}: a threshold is repeated")

    def levels(self, p_wall: Quantized) -> tuple[Reals, Reals]:
        """float64[m] and float64[n]: what each threshold means as a value of the prediction."""
        some = self.delta_occupied[0], self.delta_free[0]
        free = [sure_levels(p_wall, Thresholds(value, some[0]))[0] for value in self.delta_free]
        occupied = [
            sure_levels(p_wall, Thresholds(some[1], value))[1] for value in self.delta_occupied
        ]
        return np.array(free, np.float64), np.array(occupied, np.float64)


def _scores(
    observed: Grid, p_wall: Quantized, truth: Grid, region: Mask, free: Reals, occupied: Reals
) -> tuple[Reals, Reals, Reals]:
    """float64[m, n] each: F1, coverage and correct coverage of the fused maps of a step."""
    seen = scores.tally(observed, truth, region)
    hidden = region & (observed == UNKNOWN)
    counted = {}
    for kind in (FREE, OCCUPIED):
        levels = np.sort(p_wall[hidden & (truth == kind)])
        as_free = np.searchsorted(levels, free, side="right")[:, None]
        below = np.searchsorted(levels, occupied, side="left")[None, :]
        counted[kind] = as_free, levels.size - np.maximum(as_free, below)  # free wins a tie
    (free_right, walls_wrong), (free_wrong, walls_right) = counted[FREE], counted[OCCUPIED]
    hits = seen[2, 2] + walls_right
    predicted_walls = hits + seen[2, 1] + walls_wrong
    known = seen[1:].sum() + free_right + walls_wrong + free_wrong + walls_right
    right = seen[1, 1] + seen[2, 2] + free_right + walls_right
    with np.errstate(divide="ignore", invalid="ignore"):
        total = np.float64(seen.sum())
        return 2 * hits / (predicted_walls + seen[:, 2].sum()), known / total, right / total


def what_if_frame(result: WhatIf, step: int = -1) -> pl.DataFrame:
    """A row per pair of thresholds: its scores at `step`, and its `Course`.

    delta_free, delta_occupied, f1, coverage, correct_coverage, mean_f1 and mean_coverage (over
    all steps), and reached, sealed, freed, sealed_steps; null where that never happened.
    """
    rows = []
    for i, delta_free in enumerate(result.delta_free):
        for j, delta_occupied in enumerate(result.delta_occupied):
            course = result.course(i, j)
            rows.append(
                {
                    "delta_free": delta_free,
                    "delta_occupied": delta_occupied,
                    "f1": float(result.f1[step, i, j]),
                    "coverage": float(result.coverage[step, i, j]),
                    "correct_coverage": float(result.correct[step, i, j]),
                    "mean_f1": float(result.f1[result.steps, i, j].mean()),
                    "mean_coverage": float(result.coverage[result.steps, i, j].mean()),
                    "reached": course.reached,
                    "sealed": course.sealed,
                    "freed": course.freed,
                    "sealed_steps": course.sealed_steps,
                }
            )
    counts = ("reached", "sealed", "freed", "sealed_steps")
    overrides = dict.fromkeys(counts, pl.Int64)
    return pl.DataFrame(rows, schema_overrides=overrides).with_columns(
        pl.col(pl.Float64).fill_nan(None)
    )


@dataclass(frozen=True)
class SufficientThresholds:
    """Thresholds that would have left a frontier at a step; None if no value of the grid does."""

    step: int
    delta_free: float | None
    """The smallest, with delta_occupied as logged."""
    delta_occupied: float | None
    """The smallest, with delta_free as logged."""


def sufficient_thresholds(
    log: EpisodeLog, step: int, deltas: Sequence[float]
) -> SufficientThresholds:
    """Which of the thresholds `deltas` would have left a frontier at `step`, one changed at a time.

    Raises:
        UsageError, LogError: see `what_if`.
    """
    config, at, p_wall = log.header.at(step).config, log[step], log[step].p_wall
    if p_wall is None:
        raise LogError(f"{log.path}: step {step} has no prediction to threshold")
    rising = sorted({float(delta) for delta in deltas if delta > 0})

    def first(pairs: Sequence[Thresholds]) -> int | None:
        for k, pair in enumerate(pairs):
            free, occupied = (np.array([level]) for level in sure_levels(p_wall, pair))
            sealed = np.empty((1, 1), np.bool_)
            kernels.sealed_thresholds(
                p_wall, at.observed, at.agent.row, at.agent.col, free, occupied, sealed
            )
            if not sealed[0, 0]:
                return k
        return None

    free_first = first([Thresholds(d, config.delta_occupied) for d in rising])
    occupied_first = first([Thresholds(config.delta_free, d) for d in rising])
    return SufficientThresholds(
        step,
        None if free_first is None else rising[free_first],
        None if occupied_first is None else rising[occupied_first],
    )
