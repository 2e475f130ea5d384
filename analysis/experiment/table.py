"""The table of an experiment: what each planner in each configuration was worth.

Each arm is compared with the reference by `mapreplay.analysis.comparison.compare`: runs of one
floor plan are averaged first, and a target that was not reached takes the whole budget.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Final

import numpy as np
import polars as pl

from mapreplay.analysis.comparison.compare import (
    MEASURES,
    TIME,
    GroupResult,
    Measure,
    Values,
    compare,
)
from mapreplay.analysis.comparison.groups import Group, Grouping
from mapreplay.analysis.episodes.corpus import LoggedEpisode, Unreadable, read_corpus
from mapreplay.analysis.experiment.controls import CONTROLS
from mapreplay.analysis.experiment.jobs import LOGS
from mapreplay.analysis.pool import default_jobs
from mapreplay.analysis.stats.estimates import (
    NEVER,
    Estimate,
    mean_interval,
    paired_reduction,
    proportion,
    reductions,
)
from mapreplay.analysis.stats.significance import holm, signed_rank
from mapreplay.step import Outcome

Episodes = Mapping[str, Sequence[LoggedEpisode]]
"""By dataset."""

PLANNERS: Final = ("random", "nearest", "cost-utility", "informative-path")
PAPER: Final = {
    ("D1", "nearest"): 0.68, ("D2", "nearest"): 0.55,
    ("D1", "cost-utility"): 0.80, ("D2", "cost-utility"): 0.65,
}  # fmt: skip
"""What the paper reports for fused/fused on its own data: reduction of mapping time."""
_LOGS_A_PROCESS: Final = 16
"""Logs that are read in the time of a usual piece of work."""


def read_episodes(folder: Path) -> dict[str, list[LoggedEpisode]]:
    """The episodes of an experiment that are finished, by dataset.

    Raises:
        LogError: a log cannot be read.
    """
    paths = sorted((folder / LOGS).glob("*/*/*.mcap"))
    found: dict[str, list[LoggedEpisode]] = {}
    for episode in read_corpus(paths, default_jobs(len(paths) // _LOGS_A_PROCESS)):
        if isinstance(episode, Unreadable):
            raise episode.error
        found.setdefault(episode.path.parts[-3], []).append(episode)
    return found


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
    def of(cls, dataset: str, episode: LoggedEpisode) -> Arm:
        """That of an episode."""
        row = episode.row
        return cls(
            dataset, row.planner, str(row.plan_on), str(row.build), row.fail_safe, row.predictor
        )

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
class ArmResult:
    """An arm over its floor plans; every estimate has a 95 % interval over floor plans."""

    arm: Arm
    plans: int
    runs: int
    """Episodes."""
    mapping_time: Estimate
    """Steps, restricted to the budget."""
    reduction: Estimate
    """Of mapping time against the reference, paired."""
    reductions: tuple[float, ...]
    """That of each floor plan."""
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


def compare_arms(episodes: Episodes) -> list[ArmResult]:
    """All arms of an experiment, by dataset, predictor, planner and configuration.

    The same episodes give the same numbers in whatever order they come: which worker ended first
    is in no interval and in no p-value.
    """
    summaries = []
    for dataset in sorted(episodes):
        arms = by_arm(dataset, episodes[dataset])
        reference = [e for arm, found in arms.items() if arm.is_reference for e in found]
        results = {arm: _against(found, reference) for arm, found in arms.items()}
        effects = {arm: _reductions(*result, TIME) for arm, result in results.items()}
        tested = [arm for arm in arms if not arm.is_reference]
        p_values = holm([signed_rank(effects[arm]).p for arm in tested])
        p = dict(zip(tested, p_values, strict=True))
        summaries += [
            _summary(arm, *result, p.get(arm, math.nan)) for arm, result in results.items()
        ]
    return summaries


def by_arm(dataset: str, episodes: Iterable[LoggedEpisode]) -> dict[Arm, list[LoggedEpisode]]:
    """The episodes of each arm, both in order."""
    arms: dict[Arm, list[LoggedEpisode]] = {}
    for episode in sorted(episodes, key=lambda e: (e.row.floor_plan, e.key)):
        arms.setdefault(Arm.of(dataset, episode), []).append(episode)
    return {arm: arms[arm] for arm in sorted(arms, key=reading_order)}


_CORRECT: Final = "correct time"
_MEASURES: Final = (
    MEASURES[0],
    Measure(
        _CORRECT, "steps", 1,
        lambda e, _, budget: float(budget if e.row.correct_time is None else e.row.correct_time),
    ),
    Measure("path", "m", 1, lambda e, _terms, _budget: e.row.path_length),
    Measure("F1", "1", 3, lambda e, _terms, _budget: e.row.f1),
    Measure("correct", "1", 3, lambda e, _terms, _budget: e.row.correct),
    Measure("mapped", "1", 2, lambda e, _terms, _budget: e.row.outcome == Outcome.MAPPED),
    Measure(
        "sealed in", "1", 2,
        lambda e, _terms, _budget: e.row.outcome == Outcome.SEALED_IN or bool(e.fail_safe.any()),
    ),
)  # fmt: skip
"""All but the times are of the end of the episode; the budget is that of the episode."""


def _against(
    episodes: Sequence[LoggedEpisode], reference: Sequence[LoggedEpisode]
) -> tuple[GroupResult, GroupResult | None]:
    """An arm and the reference on the floor plans that they share; None without any."""
    places = {episode.start for episode in reference}
    groups = [Group("arm", tuple(episodes))]
    if any(episode.start in places for episode in episodes):
        groups.append(Group("reference", tuple(reference)))
    found = compare(Grouping(tuple(groups), (), ()), "arm", measures=_MEASURES).groups
    return found[0], found[1] if len(found) > 1 else None


def _reductions(ours: GroupResult, theirs: GroupResult | None, time: str) -> tuple[float, ...]:
    """1 - T / T_reference of each floor plan; NaN where undefined."""
    if theirs is None:
        return ()
    return tuple(reductions(ours.values[time], theirs.values[time]).tolist())


def _summary(arm: Arm, ours: GroupResult, theirs: GroupResult | None, p: float) -> ArmResult:
    effects = _reductions(ours, theirs, TIME)
    finished = mean_interval([])
    if theirs is not None:
        both = (ours.times < NEVER) & (theirs.times < NEVER)
        finished = paired_reduction(ours.times[both], theirs.times[both])
    return ArmResult(
        arm=arm,
        plans=ours.times.size,
        runs=ours.episodes,
        mapping_time=ours.estimates[TIME],
        reduction=mean_interval(effects),
        reductions=effects,
        reduction_finished=finished,
        correct_time=ours.estimates[_CORRECT],
        correct_reduction=mean_interval(_reductions(ours, theirs, _CORRECT)),
        path_length=ours.estimates["path"],
        f1=ours.estimates["F1"],
        correct=ours.estimates["correct"],
        success=_share(ours.values["mapped"]),
        sealed_in=_share(ours.values["sealed in"]),
        p=p,
    )


def _share(shares: Values) -> Estimate:
    """Of one episode a floor plan with Wilson's interval, which is right also at 0 and 1; of
    several runs a floor plan by bootstrap over these.
    """
    if not np.isin(shares, (0.0, 1.0)).all():
        return mean_interval(shares)
    wilson = proportion(int(shares.sum()), shares.size)
    return Estimate(wilson.share, wilson.low, wilson.high, wilson.of)


def summary_frame(summaries: Sequence[ArmResult]) -> pl.DataFrame:
    """One row an arm; an estimate is three columns: its name, ``_low`` and ``_high``."""
    records = []
    for summary in summaries:
        record: dict[str, object] = {f.name: getattr(summary.arm, f.name) for f in fields(Arm)}
        for f in fields(ArmResult)[1:]:
            value = getattr(summary, f.name)
            if isinstance(value, Estimate):
                record |= {
                    f.name: value.mean, f"{f.name}_low": value.low, f"{f.name}_high": value.high
                }  # fmt: skip
            elif f.name != "reductions":
                record[f.name] = value
        record["finished_plans"] = summary.reduction_finished.plans
        records.append(record)
    return pl.DataFrame(records, infer_schema_length=None).fill_nan(None)
