"""The planners: what they choose, and how ties are broken."""

import numpy as np
import pytest

from drawing import draw, find
from mapreplay.errors import PluginError
from mapreplay.grid import Cell
from mapreplay.planners import Choice, Planner, best, load_planner
from mapreplay.planners.cost_utility import CostUtility
from mapreplay.planners.nearest import NearestFrontier
from mapreplay.planners.random import RandomExploration
from mapreplay.planning import Situation, frontier, shortest_paths
from mapreplay.randomness import Draws, Purpose
from mapreplay.sensor import Sensor


def situation(
    picture: str, previous: tuple[int, int] | None = None, step: int = 0, seed: int = 1
) -> Situation:
    grid, agent = draw(picture), Cell(*find(picture, "A"))
    paths = shortest_paths(grid, agent)
    return Situation(
        agent=agent,
        plan_map=grid,
        build_map=grid,
        observed=grid,
        prediction=None,
        frontier=frontier(paths, grid),
        paths=paths,
        previous_target=Cell(*previous) if previous else None,
        draws=Draws(seed, Purpose.PLANNER, step),
        sensor=Sensor(rays=8, reach=3),
    )


def target(planner: Planner, here: Situation) -> tuple[int, int]:
    row, col = here.frontier[planner.choose(here).index].tolist()
    return row, col


CORRIDOR = """
    ############
    ?.....A...?#
    ############
"""


def test_nearest_goes_to_the_nearest() -> None:
    assert target(NearestFrontier(), situation(CORRIDOR)) == (1, 9)


def test_nearest_rates_by_one_over_one_plus_distance() -> None:
    choice = NearestFrontier().choose(situation(CORRIDOR))
    assert choice.utility.tolist() == [1 / 6, 1 / 4]
    assert choice.reward.tolist() == [1, 1]


def test_equal_utility_and_cost_go_to_the_lower_row_then_column() -> None:
    # Two frontier cells at distance 2, one above and one below: row 0 is at the bottom.
    assert target(NearestFrontier(), situation("""
        #?#
        #.#
        #.#
        #A#
        #.#
        #.#
        #?#
    """)) == (1, 1)  # fmt: skip
    assert target(NearestFrontier(), situation("?..A..?")) == (0, 1)


def test_equal_utility_goes_to_the_lower_cost_first() -> None:
    assert best(np.array([2.0, 2.0, 1.0]), np.array([5.0, 4.0, 1.0])) == 1


def test_cost_utility_prefers_a_wide_view_to_a_near_one() -> None:
    here = situation("""
        ##?????
        ##?????
        ##....?
        ##.####
        ?.A.###
        #######
    """)
    left = here.frontier.tolist().index([1, 1])
    choice = CostUtility().choose(here)
    assert here.costs[left] == here.costs.min()  # the nearest shows a single cell
    assert choice.reward[left] == 1
    assert choice.index != left
    assert choice.utility.tolist() == (choice.reward / (1 + here.costs)).tolist()
    assert choice.utility[choice.index] == choice.utility.max()


def test_random_keeps_its_target_while_it_is_a_frontier_cell() -> None:
    kept = RandomExploration().choose(situation(CORRIDOR, previous=(1, 1)))
    assert (kept.index, kept.random_draw) == (0, None)


def test_random_draws_anew_when_its_target_is_none_any_more() -> None:
    choice = RandomExploration().choose(situation(CORRIDOR, previous=(1, 5)))
    assert choice.random_draw is not None
    assert choice.index == (choice.random_draw * 2) >> 64


def test_random_draws_uniformly_and_reproducibly() -> None:
    def draws(seed: int) -> list[int]:
        planner = RandomExploration()
        return [planner.choose(situation(CORRIDOR, step=k, seed=seed)).index for k in range(400)]

    assert draws(1) == draws(1)
    assert draws(1) != draws(2)
    assert 150 < sum(draws(1)) < 250


@pytest.mark.parametrize("name", ["random", "nearest", "cost-utility", "informative-path"])
def test_built_in_planners_come_through_the_entry_points(name: str) -> None:
    choice = load_planner(name).choose(situation(CORRIDOR))
    assert isinstance(choice, Choice)
    assert choice.utility.shape == choice.reward.shape == (2,)


def test_an_unknown_planner_is_named_with_those_that_there_are() -> None:
    known = "unknown planner 'nearby'; known: cost-utility, informative-path, nearest"
    with pytest.raises(PluginError, match=known):
        load_planner("nearby")
