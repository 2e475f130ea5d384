"""Benchmarks of the simulator: how fast it is, and what a predictor is worth in it."""

from __future__ import annotations

import statistics
import time
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from mapreplay.analysis.statistics import Estimate, mean_interval
from mapreplay.config import EpisodeConfig, MapKind
from mapreplay.episode import prepare_episode, run_episode
from mapreplay.floorplan import FloorPlan
from mapreplay.predictors import Predictor
from mapreplay.step import Outcome, Step


@dataclass(frozen=True)
class Timing:
    """One timed episode."""

    floor_plan: str
    outcome: Outcome | None
    steps: int
    """Steps simulated: moves and the first look."""
    seconds: float

    @property
    def steps_per_second(self) -> float:
        """Whole loop: sensing, mapping, scores and planning; recording off."""
        return self.steps / self.seconds


def time_simulation(plans: Iterable[FloorPlan]) -> Iterator[Timing]:
    """Run Nearest Frontier, observed/observed, once on each plan."""
    config = EpisodeConfig(planner="nearest", plan_on=MapKind.OBSERVED, build=MapKind.OBSERVED)
    warm = False
    for plan in plans:
        episode = prepare_episode(config, plan)
        if not warm:  # kernels are compiled or loaded at their first call
            _last(run_episode(episode))
            warm = True
        began = time.perf_counter()
        last = _last(run_episode(episode))
        seconds = time.perf_counter() - began
        yield Timing(plan.id, last.outcome, last.index + 1, seconds)


def median_rate(timings: Iterable[Timing]) -> float:
    """Median steps per second over the episodes."""
    return statistics.median(timing.steps_per_second for timing in timings)


@dataclass(frozen=True)
class Worth:
    """What a predictor was worth on one floor plan."""

    floor_plan: str
    reference_time: int
    """Mapping time of observed/observed; the budget if it never got there."""
    time: int
    """The same of fused/fused with fail-safe."""
    outcome: Outcome | None
    correct: float
    """Correct coverage of the fused map at its end."""
    f1: float

    @property
    def reduction(self) -> float:
        """1 - time / reference_time."""
        return 1 - self.time / self.reference_time


def measure_worth(
    plans: Iterable[FloorPlan], planner: str, predictor: Predictor, reference: str = "nearest"
) -> Iterator[Worth]:
    """`planner` on fused/fused with fail-safe against `reference` on observed/observed."""
    baseline = EpisodeConfig(planner=reference, plan_on=MapKind.OBSERVED, build=MapKind.OBSERVED)
    proposal = EpisodeConfig(planner=planner, predictor=predictor.identity.name, fail_safe=True)
    for plan in plans:
        expected = _last(run_episode(prepare_episode(baseline, plan)))
        got = _last(run_episode(prepare_episode(proposal, plan, predictor=predictor)))
        yield Worth(
            plan.id,
            max(expected.index, 1),
            max(got.index, 1),
            got.outcome,
            got.metrics.correct_coverage_fused,
            got.metrics.f1,
        )


def _last(steps: Iterator[Step]) -> Step:
    # With fail-safe or on observations an episode ends mapped or at its budget, so that the
    # last index is the mapping time or the budget.
    return deque(steps, maxlen=1)[0]


def mean_worth(rows: Iterable[Worth]) -> Estimate:
    """Mean reduction over the plans, with a 95 % BCa interval."""
    return mean_interval([row.reduction for row in rows])
