"""Limits of hand-drawn floor plans that a reader can check: bound <= exact <= tour."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drawing import find, plan
from exact_tour import shortest
from mapreplay.analysis.limits.bound import lower_bound, potential_bound, reach_bound
from mapreplay.analysis.limits.measure import fused_knowledge
from mapreplay.analysis.limits.predicted import predicted_tour
from mapreplay.analysis.limits.task import CoverageTask, Ints, needed_cells, task_of
from mapreplay.analysis.limits.tour import Tour, short_tour
from mapreplay.errors import FloorPlanError
from mapreplay.floorplan import FloorPlan, explorable
from mapreplay.grid import FREE, OCCUPIED, UNKNOWN, Cell
from mapreplay.mapping import Thresholds
from mapreplay.scores import coverage, tally
from mapreplay.sensor import Sensor, accumulate, sense
from mapreplay.step import PredictorIdentity

SHORT_SIGHT = Sensor(rays=8, reach=1)
"""Sees the eight neighbours only, so that a reader can tell what is seen from where."""

CORRIDOR = """
    ############
    #S.........#
    ############
"""
FORK = """
    #############
    #.....S.....#
    #############
"""
STAR = """
    #########
    ####.####
    ####.####
    ####.####
    #...S...#
    #########
"""


def drawn(
    picture: str, target: float = 1.0, sensor: Sensor = SHORT_SIGHT, within: int = 0
) -> CoverageTask:
    return task_of(plan(picture), Cell(*find(picture, "S")), target, sensor, within)


@pytest.mark.parametrize(
    ("picture", "moves"),
    [
        # To see the wall at its end, the agent must stand on the last cell of the corridor.
        (CORRIDOR, 9),
        # 5 cells to one side, back, and 5 to the other side.
        (FORK, 5 + 5 + 5),
        # To the end of one arm, and twice to that of the next, around the corner diagonally.
        (STAR, 3 + 5 + 5),
    ],
)
def test_what_a_reader_can_count(picture: str, moves: int) -> None:
    task = drawn(picture)
    assert shortest(task) == moves
    assert short_tour(task).moves == moves
    assert lower_bound(task) == moves


def test_what_may_be_left_out_shortens_all_three() -> None:
    # FORK has 11 free and 28 occupied cells. The 3 occupied ones at the end of an arm may be left
    # out: there the agent turns a cell before its end, and goes to that side first.
    task = drawn(FORK, target=(39 - 3) / 39)
    assert len(task.cells) == 39
    assert task.spare == 3
    assert shortest(task) == short_tour(task).moves == 4 + 4 + 5
    assert lower_bound(task) <= 13


def test_an_infill_oracle_need_not_go_there() -> None:
    near = drawn(CORRIDOR, within=3)
    assert shortest(near) == short_tour(near).moves == lower_bound(near) == 9 - 3


def test_nothing_is_needed_that_is_seen_from_the_start() -> None:
    task = drawn("###\n#S#\n###")
    assert shortest(task) == short_tour(task).moves == lower_bound(task) == 0


def test_the_needed_cells_are_the_simulators() -> None:
    for cells in range(1, 300):
        for target in (0.9, 0.95, 0.98, 1.0):
            counts = np.zeros((3, 3), np.int64)
            needed = needed_cells(cells, target)
            counts[1, 1], counts[0, 1] = needed, cells - needed
            assert coverage(counts).known >= target
            counts[1, 1], counts[0, 1] = needed - 1, cells - needed + 1
            assert coverage(counts).known < target


def test_unknown_cells_of_a_robots_map_are_never_needed() -> None:
    task = drawn("????\n?S.?\n????")
    assert len(task.cells) == 2
    assert shortest(task) == 0


def observed_after(floor_plan: FloorPlan, task: CoverageTask, tour: Tour, sensor: Sensor) -> float:
    """The simulator's coverage of the observed map after a tour, each step of it a move."""
    observed = np.full(floor_plan.shape, UNKNOWN, np.int8)
    path = task.places[tour.path]
    assert (np.abs(np.diff(path, axis=0)).max(axis=1) == 1).all()
    for row, col in path.tolist():
        cell = Cell(row, col)
        assert floor_plan.cells[cell] == FREE
        observed = accumulate(observed, cell, sense(floor_plan.cells, cell, sensor), sensor)
    start = Cell(*task.places[task.start].tolist())
    region = explorable(floor_plan.cells, start)
    return coverage(tally(observed, floor_plan.cells, region)).known


def scattered(seed: int) -> FloorPlan:
    """A small plan with random walls."""
    random = np.random.default_rng(seed)
    height, width = random.integers(2, 6, 2)
    cells = np.where(random.random((height, width)) < 0.35, OCCUPIED, FREE).astype(np.int8)
    cells = np.pad(cells, 1, constant_values=OCCUPIED)
    cells[1, 1] = FREE
    return FloorPlan(f"scattered-{seed}", cells, 0.1)


small_plans = st.integers(0, 2**32 - 1).map(scattered)


@settings(max_examples=40, deadline=None)
@given(small_plans, st.sampled_from([0.9, 0.98, 1.0]), st.sampled_from([1, 3, 20]))
def test_bound_exact_and_tour_are_in_order(
    floor_plan: FloorPlan, target: float, reach: int
) -> None:
    sensor = Sensor(reach=reach)
    task = task_of(floor_plan, target=target, sensor=sensor)
    tour = short_tour(task, rounds=40)
    exact = shortest(task)
    assert tour.path[0] == task.start
    assert observed_after(floor_plan, task, tour, sensor) >= target
    assert lower_bound(task) <= exact <= tour.moves
    # Each proof for itself, too.
    if exact > 0:
        assert reach_bound(task) <= exact
        assert potential_bound(task) <= exact + 1e-6


@settings(max_examples=15, deadline=None)
@given(small_plans, st.sampled_from([1, 2, 8]))
def test_to_know_more_from_afar_is_never_slower(floor_plan: FloorPlan, within: int) -> None:
    exact = shortest(task_of(floor_plan, target=0.98))
    near = task_of(floor_plan, target=0.98, within=within)
    assert lower_bound(near) <= shortest(near) <= exact


@settings(max_examples=15, deadline=None)
@given(small_plans)
def test_the_same_task_gives_the_same_tour(floor_plan: FloorPlan) -> None:
    one, other = (short_tour(task_of(floor_plan), rounds=20) for _ in range(2))
    np.testing.assert_array_equal(one.path, other.path)


def test_a_predictor_that_knows_nothing_saves_nothing_and_one_that_knows_all_everything() -> None:
    task = drawn(STAR)
    tour = short_tour(task)

    def nothing(places: Ints) -> np.ndarray:
        return task.seen_along(places)

    assert predicted_tour(task, nothing, tour).moves == 13
    assert predicted_tour(task, lambda _: np.ones(len(task.cells), np.bool_), tour).moves == 0


def test_it_goes_where_the_predictor_is_not_sure() -> None:
    task = drawn(STAR)
    arm = np.array([row >= 2 for row, _ in task.cells.tolist()])

    def sure_of_the_upper_arm(places: Ints) -> np.ndarray:
        return task.seen_along(places) | arm

    # Left, back and right remain.
    assert predicted_tour(task, sure_of_the_upper_arm, short_tour(task)).moves == 3 + 3 + 3


class NearTheSeen:
    """Right and sure of what touches an observed cell, and of nothing else."""

    identity = PredictorIdentity("near", "")

    def __init__(self, floor_plan: FloorPlan) -> None:
        self._truth = floor_plan.cells

    def predict(self, observed: np.ndarray) -> np.ndarray:
        known = np.pad(observed != UNKNOWN, 1)
        height, width = observed.shape
        near = np.zeros(observed.shape, np.bool_)
        for r in range(3):
            for c in range(3):
                near |= known[r : r + height, c : c + width]
        return np.where(near, self._truth == OCCUPIED, 0.5).astype(np.float32)


@settings(max_examples=15, deadline=None)
@given(small_plans)
def test_the_real_predictor_is_asked_and_the_tour_is_proved_by_it(floor_plan: FloorPlan) -> None:
    observing = task_of(floor_plan, target=0.98)
    ask = fused_knowledge(floor_plan, observing, NearTheSeen(floor_plan), Thresholds())
    tour = predicted_tour(observing, ask, short_tour(observing))
    assert ask(tour.path).sum() >= observing.needed
    # That predictor is the in-fill oracle of radius 1, for which there is a task of its own.
    near = task_of(floor_plan, target=0.98, within=1)
    assert near.seen_along(tour.path).sum() == ask(tour.path).sum()
    assert lower_bound(near) <= shortest(near) <= tour.moves <= short_tour(observing).moves


def test_what_is_too_large_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(FloorPlanError, match="more than 1 states: too large"):
        shortest(drawn(STAR), max_states=1)
    monkeypatch.setattr("mapreplay.analysis.limits.tour.MAX_PLACES", 5)
    with pytest.raises(FloorPlanError, match=r"10 free cells can be reached; .* at most 5"):
        short_tour(drawn(CORRIDOR))
