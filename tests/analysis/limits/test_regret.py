"""Regret of made-up episodes in corridors, whose reference a reader can count."""

import math

import pytest

from episodes import floor_plan, made_up
from mapreplay.analysis.comparison.compare import MEASURES, compare, comparison_frame
from mapreplay.analysis.comparison.groups import group_episodes
from mapreplay.analysis.comparison.page import comparison_page
from mapreplay.analysis.limits.regret import REGRET, reference_time, reference_times


def test_the_reference_walks_down_the_corridor() -> None:
    # 104 cells, of which 3 x 104 = 312 are explorable and 6 may be left out. The agent starts at
    # one end and sees 20 cells ahead, but of the walls beside it only those near to it.
    episode = made_up(100, 200)
    assert floor_plan(100).cells.shape == (3, 104)
    moves = reference_time(episode, 0.98)
    assert 100 - 20 <= moves <= 100
    assert reference_time(episode, 0.5) < moves
    assert list(reference_times([episode, made_up(100, 150, seed=2)], 0.98)) == [moves]


def test_regret_is_the_share_that_it_took_longer() -> None:
    slow = [made_up(n, 300) for n in (50, 60, 70)]
    fast = [made_up(n, 100, planner="cost-utility") for n in (50, 60, 70)]
    grouping = group_episodes([*slow, *fast], ["planner"])
    result = compare(grouping, "nearest", measures=(*MEASURES, REGRET))
    reference = [reference_time(episode, 0.98) for episode in slow]
    by_name = {group.name: group.values["regret"].tolist() for group in result.groups}
    assert by_name["nearest"] == pytest.approx([300 / t - 1 for t in reference])
    assert by_name["cost-utility"] == pytest.approx([100 / t - 1 for t in reference])
    frame = comparison_frame(result)
    assert frame.filter(of="mean", what="regret").height == 2
    difference = frame.filter(of="difference", what="regret")["value"].item()
    assert difference == pytest.approx(sum(-200 / t for t in reference) / 3)
    assert "regret" in comparison_page(compare(group_episodes(slow, ["planner"]),
                                               measures=(*MEASURES, REGRET))).html()  # fmt: skip


def test_another_simulators_steps_have_no_regret() -> None:
    from dataclasses import replace

    episode = made_up(50, 300)
    external = replace(episode, header=replace(episode.header, simulator="ROS"))
    assert math.isnan(reference_time(external, 0.98))
