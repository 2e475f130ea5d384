"""The table of an experiment: what each planner in each configuration was worth.

Runs of one floor plan are averaged first. A target that was not reached takes the whole budget.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Final

import numpy as np
import polars as pl

from mapreplay.analysis.experiment.controls import CONTROLS
from mapreplay.analysis.experiment.rows import Row
from mapreplay.analysis.reporting.wording import MULTIPLE, change
from mapreplay.analysis.stats.estimates import (
    Estimate,
    align,
    average_runs,
    mean_interval,
    paired_reduction,
    proportion,
    reductions,
)
from mapreplay.analysis.stats.significance import holm, signed_rank

PLANNERS: Final = ("random", "nearest", "cost-utility", "informative-path")
PAPER: Final = {
    ("D1", "nearest"): 0.68, ("D2", "nearest"): 0.55,
    ("D1", "cost-utility"): 0.80, ("D2", "cost-utility"): 0.65,
}  # fmt: skip
"""What the paper reports for fused/fused on its own data: reduction of mapping time."""
MAPPED: Final = "mapped"


@dataclass(frozen=True)
class Arm:
    """What is compared: a planner in a configuration, with a predictor, on a dataset."""

    dataset: str
    planner: str
    plan_on: str
    build: str
    fail_safe: bool
    predictor: str

    @classmethod
    def of(cls, row: Row) -> Arm:
        """That of an episode."""
        return cls(*(getattr(row, f.name) for f in fields(cls)))

    @property
    def is_reference(self) -> bool:
        """Whether it is the baseline of its dataset: Nearest Frontier on observations."""
        return (self.planner, self.plan_on, self.build) == ("nearest", "observed", "observed")

    @property
    def maps(self) -> str:
        """Planned on, built: fused/fused and the like."""
        return f"{self.plan_on}/{self.build}"


def reading_order(arm: Arm) -> tuple[object, ...]:
    """Sorts arms: observations first, controls last, planners as in the paper."""
    planner = PLANNERS.index(arm.planner) if arm.planner in PLANNERS else len(PLANNERS)
    fused = 2 * (arm.build == "fused") + (arm.plan_on == "fused")
    kind = (arm.predictor != "none") + (arm.predictor in CONTROLS)
    return arm.dataset, kind, arm.predictor, planner, arm.planner, fused, arm.fail_safe


@dataclass(frozen=True)
class Summary:
    """An arm over its floor plans; every estimate has a 95 % interval over floor plans."""

    arm: Arm
    plans: int
    runs: int
    """Episodes."""
    mapping_time: Estimate
    """Steps, restricted to the budget."""
    reduction: Estimate
    """Of mapping time against the reference, paired."""
    reduction_finished: Estimate
    """The same over the floor plans on which both reached the target in every run."""
    correct_time: Estimate
    """Steps to 95 % correct coverage, restricted to the budget."""
    correct_reduction: Estimate
    """Of that time against the reference, paired."""
    path_length: Estimate
    """Metres until the end of the episode."""
    f1: Estimate
    correct: Estimate
    """Correct coverage of the built map at the end."""
    success: Estimate
    """Share of episodes that reached the target coverage."""
    sealed_in: Estimate
    """Share of episodes in which the agent was sealed in at some step."""
    p: float
    """Wilcoxon signed-rank of the reductions, Holm-corrected over the arms of the dataset."""


def summarize(rows: Iterable[Row]) -> list[Summary]:
    """All arms of an experiment, by dataset, predictor, planner and configuration.

    The same rows give the same numbers in whatever order they come: which worker ended first is in
    no interval and in no p-value.
    """
    arms: dict[Arm, list[Row]] = {}
    for row in sorted(rows, key=lambda row: row.key):
        arms.setdefault(Arm.of(row), []).append(row)
    ordered = sorted(arms, key=reading_order)
    summaries = []
    for dataset in dict.fromkeys(arm.dataset for arm in ordered):
        here = [arm for arm in ordered if arm.dataset == dataset]
        reference = [row for arm in here if arm.is_reference for row in arms[arm]]
        tested = [arm for arm in here if not arm.is_reference]
        effects = [plan_reductions(arms[arm], reference) for arm in tested]
        p_values = holm([signed_rank(list(effect.values())).p for effect in effects])
        p = dict(zip(tested, p_values, strict=True))
        summaries += [_summary(arm, arms[arm], reference, p.get(arm, math.nan)) for arm in here]
    return summaries


def mapping_time(row: Row) -> float:
    """Steps to the target coverage; the budget if it was not reached."""
    return float(row.budget if row.mapping_time is None else row.mapping_time)


def correct_time(row: Row) -> float:
    """Steps to 95 % correct coverage; the budget if that was not reached."""
    return float(row.budget if row.correct_time is None else row.correct_time)


def by_plan(rows: Iterable[Row], value: Callable[[Row], float]) -> dict[str, float]:
    """A value of each floor plan, averaged over its runs."""
    return average_runs((row.floor_plan, value(row)) for row in rows)


def plan_reductions(
    rows: Iterable[Row],
    reference: Iterable[Row],
    time: Callable[[Row], float] = mapping_time,
) -> dict[str, float]:
    """Relative reduction of a time on each floor plan that both have; NaN where undefined."""
    ours, theirs = by_plan(rows, time), by_plan(reference, time)
    plans = [plan for plan in theirs if plan in ours]
    values = reductions(*align(ours, theirs))
    return dict(zip(plans, values.tolist(), strict=True))


def _summary(arm: Arm, rows: Sequence[Row], reference: Sequence[Row], p: float) -> Summary:
    def mean(value: Callable[[Row], float]) -> Estimate:
        return mean_interval(list(by_plan(rows, value).values()))

    def reduction(time: Callable[[Row], float]) -> Estimate:
        return mean_interval(list(plan_reductions(rows, reference, time).values()))

    ended = _finished(rows) & _finished(reference)
    finished = paired_reduction(
        *align(
            _only(by_plan(rows, mapping_time), ended),
            _only(by_plan(reference, mapping_time), ended),
        )
    )
    return Summary(
        arm=arm,
        plans=len({row.floor_plan for row in rows}),
        runs=len(rows),
        mapping_time=mean(mapping_time),
        reduction=reduction(mapping_time),
        reduction_finished=finished,
        correct_time=mean(correct_time),
        correct_reduction=reduction(correct_time),
        path_length=mean(lambda row: row.path_length),
        f1=mean(lambda row: row.f1),
        correct=mean(lambda row: row.correct),
        success=_share(by_plan(rows, lambda row: row.outcome == MAPPED)),
        sealed_in=_share(by_plan(rows, lambda row: row.sealed_step is not None)),
        p=p,
    )


def _share(values: Mapping[str, float]) -> Estimate:
    """Of one episode a floor plan with Wilson's interval, which is right also at 0 and 1; of
    several runs a floor plan by bootstrap over these.
    """
    shares = np.array(list(values.values()))
    if not np.isin(shares, (0.0, 1.0)).all():
        return mean_interval(shares)
    wilson = proportion(int(shares.sum()), shares.size)
    return Estimate(wilson.share, wilson.low, wilson.high, wilson.of)


def _finished(rows: Iterable[Row]) -> frozenset[str]:
    """The floor plans on which every run reached its target."""
    shares = by_plan(rows, lambda row: row.mapping_time is not None)
    return frozenset(plan for plan, share in shares.items() if share == 1)


def _only(values: Mapping[str, float], plans: frozenset[str]) -> dict[str, float]:
    return {plan: value for plan, value in values.items() if plan in plans}


def summary_frame(summaries: Sequence[Summary]) -> pl.DataFrame:
    """One row an arm; an estimate is three columns: its name, ``_low`` and ``_high``."""
    records = []
    for summary in summaries:
        record: dict[str, object] = {f.name: getattr(summary.arm, f.name) for f in fields(Arm)}
        for f in fields(Summary)[1:]:
            value = getattr(summary, f.name)
            if isinstance(value, Estimate):
                record |= {
                    f.name: value.mean, f"{f.name}_low": value.low, f"{f.name}_high": value.high
                }  # fmt: skip
            else:
                record[f.name] = value
        record["finished_plans"] = summary.reduction_finished.plans
        records.append(record)
    return pl.DataFrame(records, infer_schema_length=None).fill_nan(None)


def brief_frame(summaries: Sequence[Summary]) -> pl.DataFrame:
    """What a person wants to see of it, narrow enough for a terminal."""
    return pl.DataFrame(
        [
            {
                "dataset": s.arm.dataset,
                "planner": s.arm.planner,
                "maps": s.arm.maps + (" safe" if s.arm.fail_safe else ""),
                "predictor": s.arm.predictor,
                "steps": round(s.mapping_time.mean),
                "saved": _percent(s.reduction),
                "correct": s.correct.mean,
                "f1": s.f1.mean,
                "sealed": s.sealed_in.mean,
            }
            for s in summaries
        ]
    )


def _percent(estimate: Estimate) -> str:
    if math.isnan(estimate.mean):
        return "-"
    if estimate.mean < MULTIPLE:
        return change(estimate.mean)
    low, high = (
        "?" if math.isnan(bound) else f"{100 * bound:.0f}"
        for bound in (estimate.low, estimate.high)
    )
    return f"{100 * estimate.mean:.0f}% [{low}, {high}]"
