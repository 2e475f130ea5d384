"""Informative path: where it goes elsewhere than Cost-Utility, and its gains against slow ones."""

import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drawing import draw, find, plan
from mapreplay.analysis.verification import verify
from mapreplay.config import EpisodeConfig
from mapreplay.episode import prepare_episode, run_episode
from mapreplay.floorplans.procedural import Style, generate
from mapreplay.grid import FREE, UNKNOWN, Cell, Grid
from mapreplay.mapping import PredictionDtype, quantize
from mapreplay.planners import Planner, kernels, load_planner
from mapreplay.planners.cost_utility import CostUtility
from mapreplay.planners.informative_path import InformativePath, expectations
from mapreplay.planning import Situation, frontier, shortest_paths
from mapreplay.randomness import Draws, Purpose
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.recorders.log.writer import EpisodeWriter
from mapreplay.sensor import Sensor
from mapreplay.step import Mode, PredictorIdentity, Step, differences
from recordings import THREE_ROOMS, BlurPredictor

SENSOR = Sensor(rays=8, reach=3)


def situation(picture: str, chances: str = "") -> Situation:
    """A drawn map that is planned on and built; `chances` are P(occupied) of its unknown cells."""
    grid, agent = draw(picture), Cell(*find(picture, "A"))
    paths = shortest_paths(grid, agent)
    prediction = None
    if chances:
        p_wall = (grid > 0).astype(np.float32)
        p_wall[grid == UNKNOWN] = [float(chance) for chance in chances.split()]
        prediction = quantize(p_wall, PredictionDtype.FLOAT32)
    return Situation(
        agent=agent,
        plan_map=grid,
        build_map=grid,
        observed=grid,
        prediction=prediction,
        frontier=frontier(paths, grid),
        paths=paths,
        previous_target=None,
        draws=Draws(1, Purpose.PLANNER),
        sensor=SENSOR,
    )


def column(planner: Planner, here: Situation) -> int:
    """The column that the planner goes for."""
    return int(here.frontier[planner.choose(here).index, 1])


NICHE = """
    ###########?######
    ???......A.....??#
    ##################
"""
"""On the left 3 cells to be seen, 6 moves away; on the right 2, 5 moves away, and 1 before."""


def test_what_lies_along_the_way_counts() -> None:
    here = situation(NICHE)
    assert here.frontier[:, 1].tolist() == [3, 11, 14]
    assert CostUtility().choose(here).reward.tolist() == [3, 1, 2]
    assert column(CostUtility(), here) == 3  # 3 in 7 is more than 2 in 6 and 1 in 3
    assert InformativePath().choose(here).reward.tolist() == [3, 1, 3]
    assert column(InformativePath(), here) == 14
    assert column(InformativePath(ways=0), here) == 3


def test_the_last_target_keeps_what_lies_on_its_way() -> None:
    # Else it is worth less as soon as others are among the best, and the agent turns round; and
    # when it has turned round it is worth more again.
    here = situation(NICHE)
    assert InformativePath(ways=1).choose(here).reward.tolist() == [3, 1, 2]
    row = int(here.frontier[2, 0])
    going = replace(here, previous_target=Cell(row, 14))
    assert InformativePath(ways=1).choose(going).reward.tolist() == [3, 1, 3]
    assert column(InformativePath(ways=1), going) == 14
    gone = replace(here, previous_target=Cell(row, 15))  # it is no frontier cell any more
    assert InformativePath(ways=1).choose(gone).reward.tolist() == [3, 1, 2]


def test_nothing_is_expected_behind_a_wall_that_is_likely() -> None:
    # Left: likely a wall, and beyond it cells of which nothing is known. Right: likely free.
    here = situation("???..A..??#", chances=".5 .5 .9 .3 .3")
    assert here.frontier[:, 1].tolist() == [3, 7]
    assert column(CostUtility(), here) == 3
    assert column(InformativePath(), here) == 7
    # The first unknown cell is next to a free one, and so explorable; the next one is if it or a
    # neighbour is free, and is seen if the first is.
    gains = InformativePath(ways=0).choose(here).reward
    assert gains.tolist() == pytest.approx([1 + 0.1 * 0.5 + 0.1 * 0.5 * 0.5, 1 + 0.7 * 0.7])


def test_a_cell_is_worth_going_for_as_far_as_it_is_likely_explorable() -> None:
    here = situation(
        """
        ????#
        A.#?#
        """,
        chances=".8 .6 .6 .6 .6",
    )
    worth, transparency = expectations(here)
    # Row 0: known cells are worth nothing; the last one touches no cell that is likelier free.
    assert worth[0].tolist() == pytest.approx([0, 0, 0, 0.4, 0])
    # Row 1: the first three touch an observed free cell, however likely they are walls.
    assert worth[1].tolist() == pytest.approx([1, 1, 1, 0.4, 0])
    assert transparency[0].tolist() == pytest.approx([1, 1, 0, 0.2, 0])


def test_equal_ways_go_to_the_first_cell() -> None:
    assert column(InformativePath(), situation("???..A..???")) == 3


def test_without_a_prediction_the_end_of_a_way_shows_what_cost_utility_counts() -> None:
    here = situation(NICHE)
    assert InformativePath(ways=0).choose(here).utility.tolist() == pytest.approx(
        CostUtility().choose(here).utility.tolist()
    )


@st.composite
def rooms(draw_from: st.DrawFn) -> Situation:
    """A random map of free, occupied and unknown cells with a frontier."""
    height, width = draw_from(st.integers(3, 9)), draw_from(st.integers(3, 12))
    seed = draw_from(st.integers(0, 2**32 - 1))
    rng = np.random.default_rng(seed)
    grid = rng.choice(np.array([-1, 0, 0, 0, 100], np.int8), (height, width))
    grid[0, 0], grid[0, 1] = FREE, UNKNOWN
    paths = shortest_paths(grid, Cell(0, 0))
    p_wall = np.where(grid == UNKNOWN, rng.random(grid.shape), grid > 0).astype(np.float32)
    return Situation(
        agent=Cell(0, 0),
        plan_map=grid,
        build_map=grid,
        observed=grid,
        prediction=quantize(p_wall, PredictionDtype.UINT8),
        frontier=frontier(paths, grid),
        paths=paths,
        previous_target=None,
        draws=Draws(1, Purpose.PLANNER),
        sensor=SENSOR,
    )


@settings(deadline=None)  # the first example compiles
@given(rooms())
def test_the_same_situation_gives_the_same_choice(here: Situation) -> None:
    one, other = (load_planner("informative-path").choose(here) for _ in range(2))
    assert one.index == other.index
    assert one.utility.tobytes() == other.utility.tobytes()
    assert one.utility[one.index] == one.utility.max()
    assert np.isfinite(one.utility).all()


@settings(deadline=None)  # the first example compiles
@given(rooms())
def test_a_way_shows_what_one_look_after_the_other_does(here: Situation) -> None:
    worth, transparency = expectations(here)
    gains = InformativePath(ways=len(here.frontier)).choose(here).reward
    for i, (row, col) in enumerate(here.frontier.tolist()):
        missed = np.ones_like(worth)  # P(not seen from any cell of the way)
        for cell in here.paths.to(Cell(row, col))[1:].tolist():
            missed *= 1 - visibility(transparency, cell)
        assert gains[i] == pytest.approx((worth * (1 - missed)).sum())


def visibility(transparency: np.ndarray, cell: list[int]) -> np.ndarray:
    """P(each cell is seen from `cell`): of the most probable ray."""
    seen = np.zeros_like(transparency)
    seen[tuple(cell)] = 1
    for ray in SENSOR.offsets:
        through = 1.0
        for r, c in ray + cell:
            if not (0 <= r < seen.shape[0] and 0 <= c < seen.shape[1]) or through < kernels.FAINT:
                break
            seen[r, c] = max(seen[r, c], through)
            through *= transparency[r, c]
    return seen


def test_a_log_of_it_verifies_and_the_same_seed_gives_the_same_steps(tmp_path: Path) -> None:
    def record(path: Path) -> list[Step]:
        predictor = BlurPredictor()
        config = EpisodeConfig(
            planner="informative-path", predictor=predictor.identity.name, reach=6, fail_safe=True
        )
        episode = prepare_episode(config, plan(THREE_ROOMS, "rooms", 0.2), predictor=predictor)
        with EpisodeWriter(path, episode.header) as writer:
            steps = list(run_episode(episode))
            for step in steps:
                writer.add(step)
        return steps

    one, other = record(tmp_path / "one.mcap"), record(tmp_path / "other.mcap")
    assert [differences(a, b) for a, b in zip(one, other, strict=True)] == [["profile"]] * len(one)
    assert one[-1].outcome == "mapped"
    assert verify(EpisodeLog(tmp_path / "one.mcap")).differences == ()


class Fickle:
    """Says something else about every map, and the same about the same map."""

    identity = PredictorIdentity("fickle", "0" * 64)

    def predict(self, observed: Grid) -> npt.NDArray[np.float32]:
        seed = zlib.crc32(observed.tobytes())
        return np.random.default_rng(seed).random(observed.shape, np.float32) ** 2


@settings(max_examples=15)
@given(st.integers(0, 999), st.integers(1, 8))
def test_it_never_goes_in_circles_while_it_sees_nothing_new(seed: int, ways: int) -> None:
    style = Style(height=24, width=24, min_room=4, door=2, shift=1)
    config = EpisodeConfig(planner="informative-path", fail_safe=True, seed=1, reach=6)
    episode = prepare_episode(
        config, generate(seed, style), InformativePath(ways=ways), predictor=Fickle()
    )
    observed, been = b"", set[tuple[Cell, Cell]]()
    for step in run_episode(episode):
        assert step.observed is not None
        if step.observed.tobytes() != observed or step.mode is not Mode.NORMAL:
            observed = step.observed.tobytes()
            been.clear()
        if step.decision is not None and step.mode is Mode.NORMAL:
            here = step.agent, step.decision.target
            assert here not in been
            been.add(here)
