"""Shortest paths, frontiers and gains on maps that a reader can check."""

import heapq
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drawing import draw, find
from mapreplay.grid import FREE, OCCUPIED, UNKNOWN, Cell, Grid
from mapreplay.mapping import PredictionDtype, quantize
from mapreplay.planning import Situation, frontier, shortest_paths
from mapreplay.randomness import Draws, Purpose
from mapreplay.sensor import Sensor


def cells_from(picture: str, build: str | None = None) -> set[tuple[int, int]]:
    """The frontier of one drawn map (or of two) for the agent at A."""
    paths = shortest_paths(draw(picture), Cell(*find(picture, "A")))
    return {(r, c) for r, c in frontier(paths, draw(build or picture)).tolist()}


def marked(picture: str, mark: str) -> set[tuple[int, int]]:
    lines = [line.strip() for line in picture.strip().splitlines()][::-1]
    return {(r, c) for r, line in enumerate(lines) for c, m in enumerate(line) if m == mark}


def test_the_frontier_is_the_free_cells_that_touch_the_unknown_by_a_side() -> None:
    picture = """
        ??????
        #F??##
        #.FF?#
        #A..F?
        ######
    """
    assert cells_from(picture) == marked(picture, "F")


def test_what_cannot_be_reached_is_no_frontier() -> None:
    picture = """
        #####?
        #A.#.?
        #F.#.?
        #?####
    """
    assert cells_from(picture) == marked(picture, "F")


def test_an_agent_passes_between_two_walls_that_touch_diagonally() -> None:
    picture = """
        ####
        ##F?
        #A##
        ####
    """
    assert cells_from(picture) == marked(picture, "F")


def test_corners_count_only_where_no_side_does() -> None:
    only_a_corner = """
        ##?
        .F#
        A.#
    """
    assert cells_from(only_a_corner) == marked(only_a_corner, "F")
    # F touches the unknown by a side, so C, which touches it only by a corner, does not count.
    both = """
        C##
        .#?
        A.F
    """
    assert cells_from(both) == marked(both, "F")


def test_the_frontier_lies_on_one_map_and_looks_at_the_other() -> None:
    plan_on = """
        ####
        A.FF
        ####
    """
    build = """
        ####
        ..??
        ####
    """
    # Free and reachable in the first, beside what the second does not know.
    assert cells_from(plan_on, build) == marked(plan_on, "F") | {(1, 1)}


def test_a_complete_map_has_no_frontier() -> None:
    assert (
        cells_from("""
        ###
        #A#
        ###
    """)
        == set()
    )


def test_the_frontier_is_in_row_major_order() -> None:
    picture = """
        ???
        ?A?
        ???
    """
    grid = draw(picture)
    grid[:] = np.where(grid == UNKNOWN, UNKNOWN, FREE)
    wide = np.pad(np.zeros((2, 3), np.int8), 1, constant_values=UNKNOWN)
    cells = frontier(shortest_paths(wide, Cell(1, 1)), wide).tolist()
    assert cells == sorted(cells)
    assert len(cells) == 6


def test_a_cost_is_a_pair_of_integers() -> None:
    picture = """
        #######
        #A....#
        #.###.#
        #....B#
        #######
    """
    paths = shortest_paths(draw(picture), Cell(*find(picture, "A")))
    target = Cell(*find(picture, "B"))
    # Right three, one diagonal around each... both ways round cost the same pair.
    assert (paths.straight[target], paths.diagonal[target]) == (4, 1)
    assert paths.costs(np.array([target], np.int32)).tolist() == [4 + math.sqrt(2)]


def test_of_two_shortest_paths_the_rule_of_moves_takes_one() -> None:
    # (+2, +1) can be walked straight-then-diagonal or diagonal-then-straight. Going back from
    # the target, straight moves are tried first, so the diagonal one comes first on the way.
    open_space = np.zeros((5, 5), np.int8)
    path = shortest_paths(open_space, Cell(0, 0)).to(Cell(1, 2)).tolist()
    assert path == [[0, 0], [1, 1], [1, 2]]


def reference_costs(grid: Grid, start: tuple[int, int]) -> dict[tuple[int, int], tuple[int, int]]:
    """Dijkstra with a heap, as in a textbook."""
    best = {start: (0, 0)}
    heap = [(0.0, start)]
    while heap:
        cost, (r, c) = heapq.heappop(heap)
        s, d = best[r, c]
        if cost > s + d * math.sqrt(2):
            continue
        for dr in (-1, 0, 1):
            for dc in (-1, 0, 1):
                cell = (r + dr, c + dc)
                inside = 0 <= cell[0] < grid.shape[0] and 0 <= cell[1] < grid.shape[1]
                if cell == (r, c) or not inside or grid[cell] != FREE:
                    continue
                pair = (s + 1, d) if dr * dc == 0 else (s, d + 1)
                value = pair[0] + pair[1] * math.sqrt(2)
                old = best.get(cell)
                if old is None or value < old[0] + old[1] * math.sqrt(2):
                    best[cell] = pair
                    heapq.heappush(heap, (value, cell))
    return best


@given(st.lists(st.sampled_from([0, 0, 0, 100, -1]), min_size=13 * 11, max_size=13 * 11))
def test_two_queues_find_what_a_heap_finds(values: list[int]) -> None:
    grid = np.array(values, np.int8).reshape(13, 11)
    grid[6, 5] = FREE
    paths = shortest_paths(grid, Cell(6, 5))
    reached = {
        (r, c): (int(paths.straight[r, c]), int(paths.diagonal[r, c]))
        for r, c in np.argwhere(paths.straight >= 0).tolist()
    }
    assert reached == reference_costs(grid, (6, 5))
    for cell, (straight, diagonal) in reached.items():
        path = paths.to(Cell(*cell))
        moves = np.abs(np.diff(path, axis=0)).sum(axis=1)
        assert path[0].tolist() == [6, 5]
        assert path[-1].tolist() == list(cell)
        assert ((moves == 1).sum(), (moves == 2).sum()) == (straight, diagonal)
        assert (grid[path[:, 0], path[:, 1]] == FREE).all()


def situation(picture: str, observed: Grid | None = None, p_wall: float | None = None) -> Situation:
    plan_map = draw(picture)
    agent = Cell(*find(picture, "A"))
    paths = shortest_paths(plan_map, agent)
    prediction = None
    if p_wall is not None:
        full = np.full(plan_map.shape, p_wall, np.float32)
        prediction = quantize(full, PredictionDtype.FLOAT32)
    return Situation(
        agent=agent,
        plan_map=plan_map,
        build_map=plan_map if observed is None else observed,
        observed=plan_map if observed is None else observed,
        prediction=prediction,
        frontier=frontier(paths, plan_map if observed is None else observed),
        paths=paths,
        previous_target=None,
        draws=Draws(1, Purpose.PLANNER),
        sensor=Sensor(rays=8, reach=2),
    )


def test_the_gain_on_observations_is_the_number_of_new_cells_in_view() -> None:
    # From F two cells of each ray that is not blocked: up, up-right, right and their ends.
    here = situation("""
        ?????
        ?????
        #F#??
        #A#??
        ####?
    """)
    assert here.frontier.tolist() == [[2, 1]]
    # North and its next; north-east (one cell, twice) and its end (two to the right, two up);
    # north-west likewise leaves the grid after one cell.
    assert here.gains().tolist() == [5.0 - 1.0]


def test_unknown_cells_are_transparent_and_occupied_ones_end_a_ray() -> None:
    here = situation("A.?#?")
    assert here.frontier.tolist() == [[0, 1]]
    assert here.gains().tolist() == [1.0]  # the unknown cell; behind the wall nothing is seen


def test_the_gain_on_the_fused_map_counts_doubt() -> None:
    observed = draw("A???")
    here = situation("A.?.", observed=observed, p_wall=0.25)
    # 1 - |2 * .25 - 1| = .5 for each cell that was not observed and is in view: two to the
    # right of each frontier cell, and itself.
    assert here.frontier.tolist() == [[0, 0], [0, 1]]
    assert here.gains().tolist() == pytest.approx([1.0, 1.5])


def test_each_cell_in_view_counts_once() -> None:
    # With sixteen rays the eight neighbours are each on more than one ray.
    grid = np.full((7, 7), UNKNOWN, np.int8)
    grid[3, 3] = FREE
    paths = shortest_paths(grid, Cell(3, 3))
    sensor = Sensor(rays=16, reach=1)
    here = Situation(
        Cell(3, 3), grid, grid, grid, None, np.array([[3, 3]], np.int32), paths, None,
        Draws(1, Purpose.PLANNER), sensor,
    )  # fmt: skip
    assert here.gains().tolist() == [8.0]


def test_walls_that_are_seen_are_gained_too() -> None:
    grid = draw("A.#")
    observed = np.full(grid.shape, UNKNOWN, np.int8)
    observed[0, :2] = FREE
    here = situation("A.#", observed=observed, p_wall=0.5)
    assert grid[0, 2] == OCCUPIED
    assert here.frontier.tolist() == [[0, 1]]
    assert here.gains().tolist() == [1.0]
