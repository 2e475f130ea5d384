"""Benchmarks of the simulator: how fast it is, and how much time a predictor saves in it."""

from __future__ import annotations

import statistics
import time
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

from mapreplay.analysis.experiment.curve import measure_plan
from mapreplay.analysis.metrics.calibration import (
    PredictionCounts,
    calibration_scores,
    decided,
    score_interval,
)
from mapreplay.analysis.stats.estimates import Estimate, mean_interval
from mapreplay.config import EpisodeConfig, MapKind
from mapreplay.episode import prepare_episode, run_episode
from mapreplay.floorplan import FloorPlan
from mapreplay.mapping import Thresholds
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
class Saving:
    """The mapping time that a predictor saved on one floor plan, and how well it predicted."""

    floor_plan: str
    reference_time: int
    """Mapping time of observed/observed; the budget if it never got there."""
    time: int
    """The same of fused/fused with fail-safe."""
    outcome: Outcome | None
    correct: float
    """Correct coverage of the fused map at its end."""
    f1: float
    counts: PredictionCounts = field(repr=False)
    """The predictions of what was unobserved on the same walk for every predictor: see
    `mapreplay.analysis.experiment.curve`."""

    @property
    def reduction(self) -> float:
        """1 - time / reference_time."""
        return 1 - self.time / self.reference_time


def measure_savings(
    plans: Iterable[FloorPlan], planner: str, predictor: Predictor, reference: str = "nearest"
) -> Iterator[Saving]:
    """`planner` on fused/fused with fail-safe against `reference` on observed/observed."""
    baseline = EpisodeConfig(planner=reference, plan_on=MapKind.OBSERVED, build=MapKind.OBSERVED)
    proposal = EpisodeConfig(planner=planner, predictor=predictor.identity.name, fail_safe=True)
    for plan in plans:
        expected = _last(run_episode(prepare_episode(baseline, plan)))
        episode = prepare_episode(proposal, plan, predictor=predictor)
        got = _last(run_episode(episode))
        yield Saving(
            plan.id,
            max(expected.index, 1),
            max(got.index, 1),
            got.outcome,
            got.metrics.correct_coverage_fused,
            got.metrics.f1,
            measure_plan(plan, predictor, episode.header.thresholds).counts,
        )


def _last(steps: Iterator[Step]) -> Step:
    # With fail-safe or on observations an episode ends mapped or at its budget, so that the
    # last index is the mapping time or the budget.
    return deque(steps, maxlen=1)[0]


@dataclass(frozen=True)
class MeanSaving:
    """Over floor plans, with 95 % BCa bootstrap intervals over them."""

    reduction: Estimate
    correct: Estimate
    f1: Estimate
    ece: Estimate
    """Of the predictions of unobserved cells, pooled; so are the next two."""
    log_loss: Estimate
    decided: Estimate
    """Share of them that both thresholds take for known."""


def mean_saving(rows: Sequence[Saving]) -> MeanSaving:
    """Means over the floor plans, at least one."""
    counts, config = [row.counts for row in rows], EpisodeConfig()
    thresholds = Thresholds(config.delta_free, config.delta_occupied)
    return MeanSaving(
        reduction=mean_interval([row.reduction for row in rows]),
        correct=mean_interval([row.correct for row in rows]),
        f1=mean_interval([row.f1 for row in rows]),
        ece=score_interval(counts, lambda c: calibration_scores(c).ece),
        log_loss=score_interval(counts, lambda c: calibration_scores(c).log_loss),
        decided=score_interval(counts, lambda c: decided(c, thresholds).share),
    )
