"""Limits of floor plans: the baseline, an oracle planner that knows the plan, a lower bound."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from typing import Final

import numpy as np
import polars as pl

from mapreplay import kernels as simulator
from mapreplay import mapping
from mapreplay.analysis.experiment.markdown import number, saved, table
from mapreplay.analysis.limits.bound import lower_bound
from mapreplay.analysis.limits.cache import remembered
from mapreplay.analysis.limits.predicted import Known, predicted_tour
from mapreplay.analysis.limits.task import CoverageTask, Ints, task_of
from mapreplay.analysis.limits.tour import Tour, short_tour
from mapreplay.analysis.pool import map_unordered
from mapreplay.analysis.stats.estimates import Estimate, mean_interval, paired_reduction
from mapreplay.config import EpisodeConfig, MapKind, PredictionDtype
from mapreplay.episode import prepare_episode, run_episode
from mapreplay.errors import MapreplayError
from mapreplay.floorplan import FloorPlan
from mapreplay.grid import UNKNOWN, Cell, Grid
from mapreplay.mapping import Thresholds
from mapreplay.predictors import Predictor, kept_predictor
from mapreplay.sensor import Sensor


class Limit(StrEnum):
    """A mapping time of a floor plan."""

    NEAREST = "nearest"
    """That of Nearest Frontier on observed/observed, which knows nothing."""
    TOUR = "tour"
    """That of a short tour of a planner that knows the floor plan: it can be reached."""
    BOUND = "bound"
    """Moves that are proved to be necessary: no planner is faster."""


LIMITS: Final = {
    Limit.NEAREST: "Nearest Frontier, knows nothing",
    Limit.TOUR: "a tour that knows the floor plan",
    Limit.BOUND: "proved lower bound",
}
OBSERVED: Final = "observed"
"""Only what was observed counts as known."""
INFILL: Final = "infill-"
"""And what lies within this many cells of it (chessboard distance)."""


@dataclass(frozen=True)
class Question:
    """What is measured of each floor plan."""

    target: float = 0.98
    thresholds: Thresholds = Thresholds()
    predictors: tuple[str, ...] = ()
    """Names or files, see `mapreplay.predictors.load_predictor`."""
    infill: tuple[int, ...] = ()
    """Radii of in-fill oracles."""


@dataclass(frozen=True)
class PlanLimit:
    """A number of moves on one floor plan."""

    floor_plan: str
    known: str
    """`OBSERVED`, the name of a predictor, or `INFILL` and a radius."""
    limit: Limit
    moves: int
    nearest: int
    """Of Nearest Frontier on observed/observed, at least 1."""

    @property
    def reduction(self) -> float:
        """1 - moves / nearest."""
        return 1 - self.moves / self.nearest


def limits_of(floor_plan: FloorPlan, question: Question) -> list[PlanLimit]:
    """The limits of a floor plan from its default start.

    Raises:
        FloorPlanError: it is too large, or its true map is not known.
        PluginError, WeightsError: a predictor cannot be loaded.
    """
    target, sha256 = question.target, floor_plan.sha256
    start = floor_plan.check_start(None)
    nearest = max(1, remembered(("nearest", sha256, target), lambda: _nearest(floor_plan, target)))
    found = [(OBSERVED, Limit.NEAREST, nearest)]

    for within in (0, *question.infill):
        work = _Work(floor_plan, start, target, within)
        known = f"{INFILL}{within}" if within else OBSERVED
        key = (sha256, target, within)
        tour = remembered(("tour", *key), work.moves_found)
        bound = remembered(("bound", *key), work.moves_needed)
        found += [(known, Limit.TOUR, tour), (known, Limit.BOUND, bound)]
        if within == 0:
            for name in question.predictors:
                predictor = kept_predictor(name)
                moves = _with_predictor(work, question.thresholds, predictor)
                found.append((predictor.identity.name, Limit.TOUR, moves))
    return [PlanLimit(floor_plan.id, known, limit, moves, nearest) for known, limit, moves in found]


@dataclass(frozen=True, eq=False)
class _Work:
    """What takes long, computed when it is first needed."""

    floor_plan: FloorPlan
    start: Cell
    target: float
    within: int

    @cached_property
    def task(self) -> CoverageTask:
        return task_of(self.floor_plan, self.start, self.target, within=self.within)

    @cached_property
    def tour(self) -> Tour:
        return short_tour(self.task)

    def moves_found(self) -> int:
        return self.tour.moves

    def moves_needed(self) -> int:
        return lower_bound(self.task)


def reference_moves(floor_plan: FloorPlan, start: Cell, target: float, sensor: Sensor) -> int:
    """Mapping time of the reference of `regret`: a short tour that observes enough.

    Raises:
        FloorPlanError: the floor plan is too large, or its true map is not known.
    """
    key = ("reference", floor_plan.sha256, tuple(start), target, sensor)
    return remembered(key, lambda: short_tour(task_of(floor_plan, start, target, sensor)).moves)


def _nearest(floor_plan: FloorPlan, target: float) -> int:
    config = EpisodeConfig(
        planner="nearest", plan_on=MapKind.OBSERVED, build=MapKind.OBSERVED, coverage=target
    )
    return deque(run_episode(prepare_episode(config, floor_plan)), maxlen=1)[0].index


def _with_predictor(work: _Work, thresholds: Thresholds, predictor: Predictor) -> int:
    def compute() -> int:
        ask = fused_knowledge(work.floor_plan, work.task, predictor, thresholds)
        return predicted_tour(work.task, ask, work.tour).moves

    identity = predictor.identity
    ours = type(predictor).__module__.partition(".")[0] == "mapreplay"
    # Otherwise it may be another one next time, without a sign of it.
    if not ours or not identity.sha256:
        return compute()
    key = ("predicted", work.floor_plan.sha256, work.target, thresholds, identity)
    return remembered(key, compute)


def fused_knowledge(
    floor_plan: FloorPlan, task: CoverageTask, predictor: Predictor, thresholds: Thresholds
) -> Callable[[Ints], Known]:
    """What the fused map knows after looking from some places: for `predicted.predicted_tour`."""
    offsets = Sensor().offsets
    hits = np.empty(len(offsets), np.int16)

    def ask(places: Ints) -> Known:
        observed: Grid = np.full(floor_plan.shape, UNKNOWN, np.int8)
        for row, col in task.places[places].tolist():
            simulator.cast_rays(floor_plan.cells, row, col, offsets, hits)
            simulator.mark_rays(observed, row, col, offsets, hits)
        raw = predictor.predict(observed)
        quantized = None if raw is None else mapping.quantize(raw, PredictionDtype.UINT8)
        fused = mapping.fuse(observed, quantized, thresholds)
        return np.asarray(fused[task.cells[:, 0], task.cells[:, 1]] != UNKNOWN)

    return ask


def measure_limits(
    floor_plans: Sequence[FloorPlan], question: Question, jobs: int = 1
) -> Iterator[list[PlanLimit] | MapreplayError]:
    """The limits of each floor plan, as they are finished; an error is a result, too."""
    return map_unordered(
        _measured,
        [(plan, question) for plan in floor_plans],
        jobs,
        lost=lambda _, error: error,
        name=lambda work: work[0].id,
    )


def _measured(work: tuple[FloorPlan, Question]) -> list[PlanLimit] | MapreplayError:
    try:
        return limits_of(*work)
    except MapreplayError as error:
        return error


@dataclass(frozen=True)
class MeanLimit:
    """A limit over floor plans."""

    known: str
    limit: Limit
    moves: Estimate
    reduction: Estimate
    """Against Nearest Frontier on observed/observed: mean of 1 - T / T_nearest."""


def mean_limits(rows: Iterable[PlanLimit]) -> list[MeanLimit]:
    """Means over floor plans with 95 % intervals, in order of appearance."""
    groups: dict[tuple[str, Limit], list[PlanLimit]] = {}
    for row in rows:
        groups.setdefault((row.known, row.limit), []).append(row)
    return [
        MeanLimit(
            known,
            limit,
            mean_interval([row.moves for row in group]),
            paired_reduction([row.moves for row in group], [row.nearest for row in group]),
        )
        for (known, limit), group in groups.items()
    ]


def limits_summary(rows: Sequence[PlanLimit]) -> pl.DataFrame:
    """The means as a table for 80 columns; reductions in percent."""
    return pl.DataFrame(
        [
            {
                "known": s.known,
                "limit": s.limit.value,
                "moves": s.moves.mean,
                "from": s.moves.low,
                "to": s.moves.high,
                "saved, %": 100 * s.reduction.mean,
                "from, %": 100 * s.reduction.low,
                "to, %": 100 * s.reduction.high,
                "plans": s.moves.plans,
            }
            for s in mean_limits(rows)
        ]
    ).with_columns(pl.col(pl.Float64).fill_nan(None))


def limits_markdown(rows: Sequence[PlanLimit]) -> str:
    """The means as a table in Markdown."""
    lines = [
        [s.known, LIMITS[s.limit], number(s.moves), saved(s.reduction), str(s.moves.plans)]
        for s in mean_limits(rows)
    ]
    head = ["counts as known", "limit", "moves", "reduction, %", "plans"]
    return table(head, lines) + "\n"


def limits_frame(rows: Sequence[PlanLimit]) -> pl.DataFrame:
    """All numbers as one table: of ("mean" or "plan"), floor_plan, known, limit, moves, reduction,
    with intervals of the means, and plans.
    """
    means = [
        {
            "of": "mean", "floor_plan": None, "known": s.known, "limit": s.limit.value,
            "moves": s.moves.mean, "moves_low": s.moves.low, "moves_high": s.moves.high,
            "reduction": s.reduction.mean, "reduction_low": s.reduction.low,
            "reduction_high": s.reduction.high, "plans": s.moves.plans,
        }
        for s in mean_limits(rows)
    ]  # fmt: skip
    each = [
        {
            "of": "plan", "floor_plan": row.floor_plan, "known": row.known,
            "limit": row.limit.value, "moves": float(row.moves), "reduction": row.reduction,
            "plans": 1,
        }
        for row in rows
    ]  # fmt: skip
    schema = {
        "of": pl.String, "floor_plan": pl.String, "known": pl.String, "limit": pl.String,
        "moves": pl.Float64, "moves_low": pl.Float64, "moves_high": pl.Float64,
        "reduction": pl.Float64, "reduction_low": pl.Float64, "reduction_high": pl.Float64,
        "plans": pl.Int64,
    }  # fmt: skip
    return pl.DataFrame([*means, *each], schema=schema).with_columns(
        pl.col(pl.Float64).fill_nan(None)
    )
