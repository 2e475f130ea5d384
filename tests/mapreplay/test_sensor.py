"""The sensor: where rays go, what they mark, and that a scan can be read back."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drawing import draw, find, show
from mapreplay.grid import UNKNOWN, Cell
from mapreplay.sensor import Sensor, accumulate, hits_from_ranges, ranges, sense

ROOM = """
    #########
    #.......#
    #.......#
    #...A...#
    #.......#
    #.......#
    #########
"""


def look(picture: str, sensor: Sensor = Sensor()) -> str:
    truth, agent = draw(picture), Cell(*find(picture, "A"))
    nothing = np.full(truth.shape, UNKNOWN, np.int8)
    return show(accumulate(nothing, agent, sense(truth, agent, sensor), sensor))


def test_ray_zero_points_east_and_angles_are_counter_clockwise() -> None:
    offsets = Sensor(rays=8, reach=3).offsets
    assert offsets[0].tolist() == [[0, 1], [0, 2], [0, 3]]  # +x is +col
    assert offsets[2].tolist() == [[1, 0], [2, 0], [3, 0]]  # +y is +row
    assert offsets[1].tolist() == [[1, 1], [1, 1], [2, 2]]  # round(k sin 45 deg)


def test_cell_k_of_a_ray_is_the_rounded_point_at_distance_k() -> None:
    offsets = Sensor().offsets
    for ray, angle in enumerate(Sensor().angles()):
        for k in range(1, 21):
            assert offsets[ray, k - 1].tolist() == [
                round(k * np.sin(angle)),
                round(k * np.cos(angle)),
            ]


@pytest.mark.parametrize("rays", [8, 16, 24, 48])
def test_opposite_rays_are_mirror_images(rays: int) -> None:
    offsets = Sensor(rays=rays, reach=30).offsets
    assert (offsets[rays // 2 :] == -offsets[: rays // 2]).all()


def test_eight_rays_see_a_star() -> None:
    assert look(ROOM, Sensor(rays=8)) == show(
        draw("""
        ?#??#??#?
        ??.?.?.??
        ???...???
        #...A...#
        ???...???
        ??.?.?.??
        ?#??#??#?
        """)
    )


def test_a_ray_ends_with_the_first_occupied_cell() -> None:
    assert look("#A.#.#", Sensor(rays=8)) == "#..#??"


def test_a_ray_ends_at_its_reach_and_at_the_edge_of_the_grid() -> None:
    assert look("A......", Sensor(rays=8, reach=3)) == "....???"
    assert look("A..", Sensor(rays=8, reach=20)) == "..."


def test_unknown_cells_of_a_real_map_stop_rays_and_are_sensed_as_occupied() -> None:
    assert look("A.?..", Sensor(rays=8)) == "..#??"


def test_a_gap_between_two_diagonal_walls_lets_rays_through() -> None:
    assert look(
        """
        #.
        A#
        """,
        Sensor(rays=8),
    ) == show(
        draw("""
        #.
        .#
        """)
    )


@given(
    walls=st.lists(st.booleans(), min_size=20 * 20, max_size=20 * 20),
    row=st.integers(0, 19),
    col=st.integers(0, 19),
    rays=st.sampled_from([8, 16, 32]),
)
def test_what_is_seen_is_true_and_all_neighbours_are_seen(
    walls: list[bool], row: int, col: int, rays: int
) -> None:
    truth = np.where(np.reshape(walls, (20, 20)), 100, 0).astype(np.int8)
    truth[row, col] = 0
    sensor = Sensor(rays=rays)
    nothing = np.full(truth.shape, UNKNOWN, np.int8)
    observed = accumulate(nothing, Cell(row, col), sense(truth, Cell(row, col), sensor), sensor)
    seen = observed != UNKNOWN
    assert (observed[seen] == truth[seen]).all()
    assert seen[max(row - 1, 0) : row + 2, max(col - 1, 0) : col + 2].all()


@given(
    hits=st.lists(st.integers(0, 20), min_size=16, max_size=16),
    resolution=st.sampled_from([0.05, 0.2, 1.0]),
)
def test_a_laser_scan_gives_back_the_cell_that_was_hit(hits: list[int], resolution: float) -> None:
    sensor = Sensor()
    # The same cell can be number k and k + 1 of a ray; a hit is always the first of them.
    first = [
        next(
            k
            for k in range(1, 21)
            if (sensor.offsets[i, k - 1] == sensor.offsets[i, hit - 1]).all()
        )
        if hit
        else 0
        for i, hit in enumerate(hits)
    ]
    metres = ranges(np.array(first, np.int16), sensor, resolution)
    assert np.isinf(metres[np.array(first) == 0]).all()
    assert hits_from_ranges(metres, sensor, resolution).tolist() == first
