"""Comparisons whose answer is known: by hand, by going through all signs, and by simulation."""

import dataclasses
import itertools
import math
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from episodes import floor_plan, made_up
from mapreplay.analysis.comparison.compare import TIME, Comparison, compare, comparison_frame
from mapreplay.analysis.comparison.figures import MOST_ROWS, Overview, PairsFigure
from mapreplay.analysis.comparison.groups import group_episodes
from mapreplay.analysis.episodes.corpus import LoggedEpisode, pair
from mapreplay.analysis.reporting.figures import render
from mapreplay.errors import MapreplayError, UsageError
from mapreplay.step import Branch

REFERENCE = [100, 200, 300, 400]
FASTER = [50, 100, 300, 300]


def nearest(times: Sequence[int | None], **options: object) -> list[LoggedEpisode]:
    return [made_up(k, t, **options) for k, t in enumerate(times)]  # type: ignore[arg-type]


def utility(times: Sequence[int | None], **options: object) -> list[LoggedEpisode]:
    fused = {"planner": "cost-utility", "plan_on": "fused", "build": "fused"}
    return nearest(times, **fused, **options)


def of(episodes: list[LoggedEpisode], *by: str, **options: object) -> Comparison:
    return compare(group_episodes(episodes, by or ["planner"]), **options)  # type: ignore[arg-type]


def test_reduction_and_difference_by_hand() -> None:
    result = of(nearest(REFERENCE) + utility(FASTER), baseline="nearest")
    assert result.baseline == "nearest"
    (saving,) = result.savings
    assert saving.group == "cost-utility"
    assert saving.reduction.mean == pytest.approx((0.5 + 0.5 + 0.0 + 0.25) / 4)
    time = next(e for e in result.effects if e.measure == TIME)
    assert time.difference.mean == (-50 - 100 + 0 - 100) / 4
    # Signs of -50, -100, -100 may flip: only all alike reach a mean of 250 / 4; 2 of 8 do.
    flips = [abs(50 * a + 100 * b + 100 * c) for a, b, c in itertools.product((-1, 1), repeat=3)]
    assert time.test.p == sum(f >= 250 for f in flips) / 8
    assert result.groups[0].estimates[TIME].mean == 250
    assert dict(result.groups[0].outcomes) == {"mapped": 4, "sealed_in": 0, "out_of_steps": 0}


def test_a_failure_takes_the_whole_budget_and_is_never_dropped() -> None:
    sealed = made_up(0, None, steps=7, planner="cost-utility")
    others = [made_up(k, t, planner="cost-utility") for k, t in enumerate(FASTER) if k]
    result = of([*nearest(REFERENCE), sealed, *others], baseline="nearest")
    (saving,) = result.savings
    assert saving.reduction.mean == pytest.approx(((1 - 400 / 100) + 0.5 + 0.0 + 0.25) / 4)
    assert saving.both.mean == pytest.approx((0.5 + 0.0 + 0.25) / 3)
    assert saving.both.plans == 3
    assert (saving.success.only_candidate, saving.success.only_reference) == (0, 1)
    group = result.groups[1]
    assert group.success.count == 3
    assert math.isinf(group.times[0])
    path = group.estimates["path to target"]
    assert (path.plans, path.undefined) == (3, 1)
    assert "path to target of cost-utility is undefined on 1 floor plan" in result.notes
    assert [p.share for p in result.incidence(group, [99, 100, 400])] == [0.0, 0.25, 0.75]


def test_only_what_all_groups_have_is_compared_and_the_rest_is_told() -> None:
    only_there = utility([*FASTER, 5])[-1]
    result = of([*nearest(REFERENCE), *utility(FASTER)[:2], only_there])
    assert result.floor_plans == ("plan-0", "plan-1")
    assert "not in all groups, left out of nearest: 2 (plan-2, plan-3)" in result.notes
    assert "not in all groups, left out of cost-utility: 1 (plan-4)" in result.notes


def test_branches_are_compared_only_where_that_is_asked_for() -> None:
    """They share their first steps with their parents, so they are no runs like the others."""

    def branched(parent: LoggedEpisode, time: int, *changes: str) -> LoggedEpisode:
        header = dataclasses.replace(parent.header, branch=Branch("", 9, changes, parent.header))
        made = made_up(int(parent.header.floor_plan.id[-1]), time)
        return dataclasses.replace(made, header=header)

    parents = nearest(REFERENCE)
    helped = [branched(parents[0], 50, "truth"), branched(parents[1], 60, "truth")]
    twice = branched(helped[0], 40, "fail-safe=on", "seed=2")
    among = of([*parents, *helped])
    assert [(g.name, g.episodes) for g in among.groups] == [("nearest", 4)]
    assert "2 branched episodes left out; --by branch compares them" in among.notes
    asked = of([*parents, *helped], "branch")
    assert [(g.name, g.episodes) for g in asked.groups] == [
        ("branch with truth", 2),
        ("no branch", 2),  # on the floor plans that both have
    ]
    alone = of([*helped, twice])
    assert [g.name for g in alone.groups] == [
        "branch with truth",
        "branch with truth, then fail-safe=on, seed=2",
    ]


def test_a_floor_plan_of_the_same_name_with_other_cells_is_another() -> None:
    renamed = dataclasses.replace(floor_plan(7), id="plan-0")
    other = made_up(0, 50, plan=renamed, planner="cost-utility")
    with pytest.raises(MapreplayError, match="no floor plan and start is in all groups"):
        of([made_up(0, 100), other])
    assert pair([made_up(0, 100)], [other]).pairs == []


def test_runs_of_a_floor_plan_are_averaged_first() -> None:
    random = [
        made_up(k, t, planner="random", seed=seed)
        for seed in (1, 2)
        for k, t in enumerate((100 * seed, 300))
    ]
    result = of([*nearest((100, 200)), *random], baseline="random")
    assert result.groups[0].values[TIME].tolist() == [150, 300]
    assert result.savings[0].reduction.mean == pytest.approx(
        ((1 - 100 / 150) + (1 - 200 / 300)) / 2
    )
    assert any("runs of a floor plan are averaged first" in line for line in result.notes)


def test_what_would_be_mixed_is_kept_apart_and_said() -> None:
    strict = nearest(REFERENCE, delta_free=0.99, seed=1)
    result = of([*nearest(REFERENCE), *strict, *utility(FASTER)])
    assert [g.name for g in result.groups] == [
        "nearest delta-free 0.93", "cost-utility delta-free 0.93", "nearest delta-free 0.99",
    ]  # fmt: skip
    assert "kept apart, because one group would mix them: delta_free" in result.notes
    also = of([*nearest(REFERENCE), *utility(FASTER, fail_safe=True)])
    assert "the groups also differ in plan_on, build, fail_safe" in also.notes


def test_unfinished_double_and_other_versions_are_told() -> None:
    cut = made_up(1, None, steps=3, outcome="unfinished")
    twice = made_up(0, 100)
    result = of([*nearest(REFERENCE), twice, cut, *utility(FASTER, version="2")])
    assert "1 unfinished episode left out" in result.notes
    assert sum(line.startswith("left out, a duplicate of") for line in result.notes) == 1
    assert "recorded with mapreplay 1, 2" in result.notes
    assert result.groups[0].episodes == 4
    with pytest.raises(MapreplayError, match="no finished episode"):
        of([cut])


def test_budgets_and_targets_are_made_common() -> None:
    short = utility([50, None, 100, 100], max_steps=120)
    result = of(nearest(REFERENCE) + short)
    assert result.budgets == (120,) * 4
    assert result.groups[0].values[TIME].tolist() == [100, 120, 120, 120]
    assert result.groups[0].success.count == 1
    assert "budgets differ: each floor plan counts with its smallest" in result.notes
    easy = of(nearest(REFERENCE) + utility(FASTER, coverage=0.49))
    assert easy.target == 0.49
    assert easy.groups[0].values[TIME].tolist() == pytest.approx(
        [50, 100, 150, 200], abs=1
    )  # half way to .98
    with pytest.raises(UsageError, match=r"--target 0\.99: should be above 0 and at most 0\.98"):
        of(nearest(REFERENCE), target=0.99)
    with pytest.raises(UsageError, match="some episodes had a budget of only 120 steps"):
        of(nearest(REFERENCE) + short, budget=130)


def test_what_the_data_cannot_tell_is_said() -> None:
    few = of(nearest([100] * 5) + utility([50, 60, 70, 80, 90]))
    assert "5 floor plans: p cannot fall below 0.062" in few.notes
    one = of(nearest([100]) + utility([50]))
    assert "1 floor plan: no interval and no test" in one.notes
    assert math.isnan(one.savings[0].reduction.low)
    assert one.savings[0].reduction.mean == 0.5
    alone = of([made_up(0, 100)])
    assert alone.baseline is None
    assert alone.effects == ()
    assert "one group: there is nothing to compare it with" in alone.notes


def test_all_failures_and_undefined_scores_get_an_answer() -> None:
    failures = of(nearest([None] * 4) + utility([None] * 4, f1=math.nan))
    assert failures.savings[0].reduction.mean == 0
    assert math.isnan(failures.savings[0].both.mean)
    assert "nearest never reached the target: its time is the budget" in failures.notes
    assert "F1 of cost-utility is undefined on 4 floor plans" in failures.notes
    f1 = next(e for e in failures.effects if e.measure == "F1")
    assert math.isnan(f1.difference.mean)
    assert math.isnan(f1.p_holm)
    assert render(Overview(failures), (9, 4), form="png").startswith(b"\x89PNG")


def test_all_p_values_are_corrected_together() -> None:
    times = [100 + 10 * k for k in range(12)]
    result = of(nearest(times) + utility([t - 40 - k for k, t in enumerate(times)]))
    raw = [e.test.p for e in result.effects] + [s.success.p for s in result.savings]
    tested = [p for p in raw if not math.isnan(p)]
    time = next(e for e in result.effects if e.measure == TIME)
    assert time.test.p == 2 / 2**12
    assert time.p_holm == pytest.approx(min(tested) * len(tested))


def test_three_groups_have_friedmans_test_and_each_its_comparison() -> None:
    third = nearest([t + 20 for t in REFERENCE], planner="random")
    result = of([*nearest(REFERENCE), *utility(FASTER), *third], baseline="random")
    assert [s.group for s in result.savings] == ["cost-utility", "nearest"]
    assert result.all_alike is not None
    assert result.all_alike.p < 0.1
    assert len(result.effects) == 2 * 5


def test_by_many_keys() -> None:
    episodes = nearest(REFERENCE) + nearest(FASTER, delta_free=0.5)
    assert [g.name for g in of(episodes, "thresholds").groups] == [
        "delta-free 0.5", "delta-free 0.93",
    ]  # fmt: skip
    assert len(of(episodes, "configuration").groups) == 2
    with pytest.raises(UsageError, match="--by colour: there is maps, thresholds, configuration"):
        group_episodes(episodes, ["colour"])
    with pytest.raises(UsageError, match="--baseline x is not a group: there is 'nearest'"):
        of(nearest(REFERENCE), baseline="x")
    with pytest.raises(UsageError, match="--test t: should be sign-flip or wilcoxon"):
        of(nearest(REFERENCE), test="t")


def test_who_only_observes_is_the_baseline_unless_another_is_named() -> None:
    assert of([*utility(FASTER), *nearest(REFERENCE)]).baseline == "nearest"


def test_the_table_has_every_number() -> None:
    result = of(nearest(REFERENCE) + utility(FASTER))
    frame = comparison_frame(result)
    assert frame.filter(of="difference", what="mapping time")["value"].to_list() == [-62.5]
    assert frame.filter(of="mean", group="nearest").height == 5
    assert frame.filter(of="note").height == len(result.notes)
    assert frame["p"].null_count() < len(frame)


def test_many_floor_plans_become_a_scatter_plot() -> None:
    count = MOST_ROWS + 1
    result = of(nearest([100 + k for k in range(count)]) + utility([60] * count))
    picture = render(PairsFigure(result), (5, 4))
    assert b"<svg" in picture
    few = of(nearest(REFERENCE) + utility([*FASTER[:3], None]))
    assert render(PairsFigure(few), (5, 4)) != picture


@pytest.mark.slow
def test_intervals_cover_and_tests_keep_their_level() -> None:
    rng = np.random.default_rng(5)
    rejected = covered = 0
    rounds = 200
    for _ in range(rounds):
        size = rng.integers(60, 200, 20)
        noise = rng.normal(0, 12, (2, 20)).round().astype(int)
        result = of(nearest((size + noise[0]).tolist()) + utility((size + noise[1]).tolist()))
        time = next(e for e in result.effects if e.measure == TIME)
        covered += time.difference.low <= 0 <= time.difference.high
        rejected += time.test.p <= 0.05
    assert 0.90 * rounds <= covered <= 0.98 * rounds
    assert rejected <= 0.09 * rounds


@given(st.permutations(range(30)))
@settings(max_examples=5, deadline=None)
def test_the_order_of_the_episodes_is_in_no_number(order: list[int]) -> None:
    draw = np.random.default_rng(0)
    times = draw.integers(20, 300, 30).tolist()
    episodes = nearest(times[:15]) + utility(times[15:])
    shuffled = of([episodes[k] for k in order], baseline="nearest")
    assert comparison_frame(shuffled).equals(
        comparison_frame(of(episodes, baseline="nearest")), null_equal=True
    )
