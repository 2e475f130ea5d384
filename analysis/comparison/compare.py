"""Which group is better on the same floor plans, by how much, and how certain that is.

Only floor plans and starts that every group has are compared; the runs of one (several seeds)
are averaged first. A failure takes the whole budget that all have in common: being sealed in is
a competing event, and is never dropped (see `mapreplay.analysis.stats`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
import polars as pl

from mapreplay.analysis.comparison.groups import Group, Grouping
from mapreplay.analysis.episodes import curves
from mapreplay.analysis.episodes.corpus import LoggedEpisode, Start
from mapreplay.analysis.episodes.curves import area
from mapreplay.analysis.reporting.wording import counted
from mapreplay.analysis.stats.estimates import (
    NEVER,
    Estimate,
    Proportion,
    average_runs,
    cumulative_incidence,
    mean_interval,
    paired_difference,
    paired_reduction,
    proportion,
)
from mapreplay.analysis.stats.significance import (
    McNemar,
    TestResult,
    friedman,
    holm,
    mcnemar,
    sign_flip,
    signed_rank,
)
from mapreplay.config import MapKind
from mapreplay.errors import MapreplayError, UsageError
from mapreplay.step import NO_BUDGET, Outcome

Values = npt.NDArray[np.float64]
"""float64[plans]: one per floor plan, in the order of `Comparison.places`."""

TESTS: Final = {"sign-flip": sign_flip, "wilcoxon": signed_rank}
FEW: Final = 10
"""Floor plans below which a bootstrap interval is too narrow."""


@dataclass(frozen=True)
class Terms:
    """The target and the budget that all episodes are compared with."""

    target: float
    """Coverage of the built map."""
    budget: int | None
    """Steps; None: the least that the groups had on a floor plan."""


@dataclass(frozen=True)
class Measure:
    """A number per episode that groups are compared by."""

    name: str
    unit: str
    digits: int
    of: Callable[[LoggedEpisode, Terms, int], float]
    """The last argument is the budget on the episode's floor plan."""


def _time(episode: LoggedEpisode, terms: Terms, budget: int) -> float:
    """Undefined where the target was not reached and nothing limited the steps."""
    time = mapping_time(episode, terms.target)
    return math.nan if time == NEVER and budget >= NO_BUDGET else min(time, float(budget))


def mapping_time(episode: LoggedEpisode, target: float) -> float:
    """When the target coverage was reached; `NEVER` if it was not."""
    time = curves.mapping_time(episode.coverage, target, episode.row.outcome)
    return NEVER if time is None else float(time)


def _path(episode: LoggedEpisode, terms: Terms, budget: int) -> float:
    """Metres until the target was reached; undefined where it was not."""
    time = mapping_time(episode, terms.target)
    return float(episode.metres[int(time)]) if time <= budget else math.nan


def _at_end(curve: npt.NDArray[np.float64], budget: int) -> float:
    return float(curve[min(budget, curve.size - 1)]) if curve.size else math.nan


def _area(episode: LoggedEpisode, _terms: Terms, budget: int) -> float:
    """Over the whole budget; undefined without one."""
    return math.nan if budget >= NO_BUDGET else area(episode.coverage, budget)


MEASURES: Final = (
    Measure("mapping time", "steps", 1, _time),
    Measure("path to target", "m", 1, _path),
    Measure("F1", "1", 3, lambda e, _, budget: _at_end(e.f1, budget)),
    Measure("correct coverage", "1", 3, lambda e, _, budget: _at_end(e.correct, budget)),
    Measure("coverage area", "1", 3, _area),
)
"""Maps are those at the end of the episode, or of the budget if that comes first."""
TIME: Final = MEASURES[0].name


@dataclass(frozen=True, eq=False)
class GroupResult:
    """A group on the floor plans that all groups have."""

    name: str
    episodes: int
    outcomes: tuple[tuple[str, int], ...]
    """(outcome, episodes), all outcomes."""
    success: Proportion
    """Floor plans that were mapped in every run, within the common budget."""
    values: Mapping[str, Values]
    """Of each measure."""
    times: Values
    """Mapping times, `NEVER` where a run of the floor plan did not reach the target."""
    estimates: Mapping[str, Estimate]
    """Means over floor plans; that of the mapping time is restricted to the budget."""


@dataclass(frozen=True, eq=False)
class Effect:
    """A group against the baseline in one measure, floor plan by floor plan."""

    group: str
    measure: str
    difference: Estimate
    """Group minus baseline."""
    test: TestResult
    p_holm: float
    """Corrected for all tests of the comparison."""


@dataclass(frozen=True, eq=False)
class GroupSaving:
    """How much less mapping time a group took than the baseline: mean of 1 - T / T_baseline."""

    group: str
    reduction: Estimate
    """With the whole budget where the target was not reached."""
    both: Estimate
    """On the floor plans that both mapped."""
    success: McNemar
    success_p_holm: float


@dataclass(frozen=True, eq=False)
class Comparison:
    """The whole result of `compare`."""

    by: tuple[str, ...]
    baseline: str | None
    """None if there is only one group."""
    target: float
    budgets: tuple[int, ...]
    """Of each place."""
    places: tuple[Start, ...]
    floor_plans: tuple[str, ...]
    """The id of each place's floor plan, with its start where one plan has several."""
    groups: tuple[GroupResult, ...]
    effects: tuple[Effect, ...]
    savings: tuple[GroupSaving, ...]
    measures: tuple[Measure, ...]
    """What is compared."""
    all_alike: TestResult | None
    """Friedman's test of the mapping times, with three groups or more."""
    notes: tuple[str, ...]
    """What was left out, what else differs, and what the data cannot tell."""
    episodes: Mapping[str, Mapping[Start, list[LoggedEpisode]]]
    """By group and place."""

    def incidence(self, group: GroupResult, at: Sequence[float]) -> list[Proportion]:
        """The share of floor plans that `group` had mapped by each of the steps `at`."""
        return cumulative_incidence(group.times, np.asarray(at, np.float64))


def compare(
    grouping: Grouping,
    baseline: str | None = None,
    *,
    budget: int | None = None,
    target: float | None = None,
    test: str = "sign-flip",
    measures: Sequence[Measure] = MEASURES,
) -> Comparison:
    """Compare groups on the floor plans and starts that all of them have.

    Args:
        grouping: the groups, see `groups.group_episodes`.
        baseline: the name of a group, or a word of it; by default one that only observes, or the
            first.
        budget: steps; by default the least that the groups had on a floor plan.
        target: coverage; by default the least that was asked for.
        test: "sign-flip" or "wilcoxon".
        measures: what is compared; the mapping time is the first.

    Raises:
        UsageError: there is no such group or test, or a budget or target makes no sense.
        MapreplayError: the groups have no floor plan and start in common.
    """
    if test not in TESTS:
        raise UsageError(f"--test {test}: should be {' or '.join(TESTS)}")
    if budget is not None and budget < 1:
        raise UsageError(f"--budget {budget}: should be at least 1")
    groups, notes = list(grouping.groups), list(grouping.notes)
    chosen = _choose_baseline(groups, baseline)
    by_place = {group.name: group.places for group in groups}
    shared = [p for p in by_place[chosen] if all(p in places for places in by_place.values())]
    notes += _unpaired(groups, set(shared))
    if not shared:
        raise MapreplayError("no floor plan and start is in all groups: there is nothing to pair")
    used = {name: {p: places[p] for p in shared} for name, places in by_place.items()}
    terms = Terms(_target(used, target, notes), budget)
    budgets = [_budget(used, place, terms, notes) for place in shared]
    notes += _seeds(used)
    results = [_result(name, runs, terms, budgets, measures) for name, runs in used.items()]
    reference = next(r for r in results if r.name == chosen)
    others = [r for r in results if r is not reference]
    effects, savings = _effects(reference, others, TESTS[test], measures)
    notes += _limits(len(shared), results, effects)
    return Comparison(
        by=grouping.by,
        baseline=chosen if others else None,
        target=terms.target,
        budgets=tuple(budgets),
        places=tuple(shared),
        floor_plans=tuple(_place_names(used[chosen])),
        groups=(reference, *others),
        effects=tuple(effects),
        savings=tuple(savings),
        measures=tuple(measures),
        all_alike=friedman([r.values[TIME] for r in results]) if len(results) > 2 else None,
        notes=tuple(dict.fromkeys(notes)),
        episodes=used,
    )


def _choose_baseline(groups: Sequence[Group], baseline: str | None) -> str:
    names = [group.name for group in groups]
    if baseline is None:  # as in the paper: plan on observations and build them
        return next((g.name for g in groups if _observes_only(g)), names[0])
    fitting = [n for n in names if n == baseline] or [n for n in names if baseline in n.split()]
    if len(fitting) != 1:
        said = "matches several groups" if fitting else "is not a group"
        raise UsageError(f"--baseline {baseline} {said}: there is {', '.join(map(repr, names))}")
    return fitting[0]


def _observes_only(group: Group) -> bool:
    config = group.episodes[0].header.config
    return config.plan_on is config.build is MapKind.OBSERVED


def _unpaired(groups: Sequence[Group], shared: set[Start]) -> list[str]:
    notes = []
    for group in groups:
        left = [runs[0].row.floor_plan for p, runs in group.places.items() if p not in shared]
        if left:
            some = ", ".join(sorted(left)[:3]) + (", ..." if len(left) > 3 else "")
            notes.append(f"not in all groups, left out of {group.name}: {len(left)} ({some})")
    return notes


_Runs = Mapping[Start, list[LoggedEpisode]]


def _target(used: Mapping[str, _Runs], asked: float | None, notes: list[str]) -> float:
    """A coverage that was the target of all episodes, or less."""
    targets = {
        e.header.config.coverage for runs in used.values() for es in runs.values() for e in es
    }
    least = min(targets)
    if asked is not None:
        if not 0 < asked <= least:
            raise UsageError(f"--target {asked}: should be above 0 and at most {least}")
        return asked
    if len(targets) > 1:
        notes.append(
            f"target coverages differ ({', '.join(map(str, sorted(targets)))}): "
            f"all are compared at {least}; F1 and correct coverage are those at different ends"
        )
    return least


def _budget(used: Mapping[str, _Runs], place: Start, terms: Terms, notes: list[str]) -> int:
    budgets = {e.header.max_steps for runs in used.values() for e in runs[place]}
    least = min(budgets)
    if terms.budget is not None:
        if terms.budget > least:
            raise UsageError(
                f"--budget {terms.budget}: some episodes had a budget of only {least} steps"
            )
        return terms.budget
    if len(budgets) > 1:
        notes.append("budgets differ: each floor plan counts with its smallest")
    return max(least, 1)


def _seeds(used: Mapping[str, _Runs]) -> list[str]:
    seeds = {
        name: {e.header.config.seed for es in runs.values() for e in es}
        for name, runs in used.items()
    }
    if all(found == next(iter(seeds.values())) for found in seeds.values()):
        return []
    counts = ", ".join(f"{name} {len(found)}" for name, found in seeds.items())
    return [f"the groups have different seeds ({counts}): runs of a floor plan are averaged first"]


def _result(
    name: str,
    runs: _Runs,
    terms: Terms,
    budgets: Sequence[int],
    measures: Sequence[Measure],
) -> GroupResult:
    episodes = [(p, e, b) for (p, es), b in zip(runs.items(), budgets, strict=True) for e in es]
    values = {}
    for measure in measures:
        averaged = average_runs((p, measure.of(e, terms, b)) for p, e, b in episodes)
        values[measure.name] = np.array([averaged[p] for p in runs], np.float64)
    reached = average_runs(
        (p, t if (t := mapping_time(e, terms.target)) <= b else NEVER) for p, e, b in episodes
    )
    times = np.array([reached[p] for p in runs], np.float64)
    outcomes = [e.row.outcome for _, e, _ in episodes]
    return GroupResult(
        name=name,
        episodes=len(episodes),
        outcomes=tuple((o.value, outcomes.count(o.value)) for o in Outcome),
        success=proportion(int((times < NEVER).sum()), times.size),
        values=values,
        times=times,
        estimates={key: mean_interval(column) for key, column in values.items()},
    )


def _effects(
    reference: GroupResult,
    others: Sequence[GroupResult],
    test: Callable[[Values], TestResult],
    measures: Sequence[Measure],
) -> tuple[list[Effect], list[GroupSaving]]:
    """All groups against the baseline, with one correction for all p-values."""
    plain, matched, both_mapped = [], [], []
    for group in others:
        for measure in measures:
            a, b = group.values[measure.name], reference.values[measure.name]
            plain.append((group.name, measure.name, paired_difference(a, b), test(a - b)))
        matched.append(mcnemar(list(group.times < NEVER), list(reference.times < NEVER)))
        both = (group.times < NEVER) & (reference.times < NEVER)
        both_mapped.append(
            paired_reduction(group.times[both], np.maximum(reference.times[both], 1))
        )
    corrected = holm([result.p for *_, result in plain] + [m.p for m in matched])
    effects = [Effect(*found, p) for found, p in zip(plain, corrected, strict=False)]
    savings = [
        GroupSaving(
            group.name,
            # A floor plan that is mapped from the start counts as one step, so that the ratio
            # is defined.
            paired_reduction(group.values[TIME], np.maximum(reference.values[TIME], 1)),
            both,
            success,
            p,
        )
        for group, both, success, p in zip(
            others, both_mapped, matched, corrected[len(plain) :], strict=True
        )
    ]
    return effects, savings


def _limits(plans: int, results: Sequence[GroupResult], effects: Sequence[Effect]) -> list[str]:
    """What the data cannot show."""
    notes = []
    if plans == 1:
        notes.append("1 floor plan: no interval and no test")
    elif effects:
        smallest = min(e.test.smallest_p for e in effects)
        if smallest > 0.05 / len(effects):
            notes.append(f"{plans} floor plans: p cannot fall below {smallest:.2g}")
    if 1 < plans < FEW:
        notes.append(f"{plans} floor plans: the intervals are too narrow")
    for result in results:
        if not (result.times < NEVER).any():
            # The note that it is undefined follows from the estimate.
            time = ": its time is the budget" if not np.isnan(result.values[TIME]).all() else ""
            notes.append(f"{result.name} never reached the target{time}")
        undefined = {m: e.undefined for m, e in result.estimates.items() if e.undefined}
        for measure, number in undefined.items():
            notes.append(
                f"{measure} of {result.name} is undefined on {counted(number, 'floor plan')}"
            )
    if len(results) == 1:
        notes.append("one group: there is nothing to compare it with")
    return notes


def _place_names(runs: _Runs) -> list[str]:
    ids = [episodes[0].row.floor_plan for episodes in runs.values()]
    return [
        name if ids.count(name) == 1 else f"{name} from ({place.row}, {place.col})"
        for name, place in zip(ids, runs, strict=True)
    ]


def comparison_frame(comparison: Comparison) -> pl.DataFrame:
    """All numbers as one table: of, group, what, value, low, high, plans, undefined, p, p_holm,
    smallest_p.

    ``of`` is "outcome" (episodes), "success" (share of floor plans), "mean", "difference" (from
    the baseline), "reduction" (of mapping time), or "note" (what: the sentence).
    """
    rows: list[dict[str, object]] = []

    def add(of: str, group: str | None, what: str, **numbers: object) -> None:
        rows.append({"of": of, "group": group, "what": what, **numbers})

    def estimate(e: Estimate) -> dict[str, object]:
        return {"value": e.mean, "low": e.low, "high": e.high, "plans": e.plans,
                "undefined": e.undefined}  # fmt: skip

    for group in comparison.groups:
        for outcome, number in group.outcomes:
            add("outcome", group.name, outcome, value=float(number))
        s = group.success
        add("success", group.name, "mapped", value=s.share, low=s.low, high=s.high, plans=s.of)
        for measure, mean in group.estimates.items():
            add("mean", group.name, measure, **estimate(mean))
    for e in comparison.effects:
        add("difference", e.group, e.measure, **estimate(e.difference), p=e.test.p,
            p_holm=e.p_holm, smallest_p=e.test.smallest_p)  # fmt: skip
    for saving in comparison.savings:
        add("reduction", saving.group, "mapping time", **estimate(saving.reduction))
        add("reduction", saving.group, "mapping time where both mapped", **estimate(saving.both))
        m = saving.success
        add("difference", saving.group, "mapped", p=m.p, p_holm=saving.success_p_holm,
            value=(m.only_candidate - m.only_reference) / len(comparison.places),
            plans=len(comparison.places), smallest_p=m.smallest_p)  # fmt: skip
    for note in comparison.notes:
        add("note", None, note)
    schema = {
        "of": pl.String, "group": pl.String, "what": pl.String, "value": pl.Float64,
        "low": pl.Float64, "high": pl.Float64, "plans": pl.Int64, "undefined": pl.Int64,
        "p": pl.Float64, "p_holm": pl.Float64, "smallest_p": pl.Float64,
    }  # fmt: skip
    return pl.DataFrame(rows, schema=schema).with_columns(pl.col(pl.Float64).fill_nan(None))
