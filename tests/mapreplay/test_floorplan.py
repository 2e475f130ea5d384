"""What a floor plan is, where an agent starts, and what it could explore."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as st_numpy

from drawing import draw, find, plan
from mapreplay.errors import FloorPlanError
from mapreplay.floorplan import MAX_SIDE, FloorPlan, explorable
from mapreplay.grid import FREE, OCCUPIED, UNKNOWN, Cell, Grid, Origin

GRIDS = st_numpy.arrays(
    np.int8,
    st_numpy.array_shapes(min_dims=2, max_dims=2, max_side=9),
    elements=st.sampled_from((UNKNOWN, FREE, OCCUPIED)),
).filter(lambda cells: bool((cells == FREE).any()))


def marked(picture: str) -> str:
    """The picture with `+` on all that is explorable from the cell ``S``."""
    known = explorable(draw(picture), Cell(*find(picture, "S")))
    lines = [line.strip() for line in picture.strip().splitlines()][::-1]
    rows = [
        "".join("+" if known[r, c] else mark for c, mark in enumerate(line))
        for r, line in enumerate(lines)
    ]
    return "\n".join(rows[::-1])


def picture(text: str) -> str:
    return "\n".join(line.strip() for line in text.strip().splitlines())


@pytest.mark.parametrize(
    ("before", "after"),
    [
        pytest.param(
            """
            ######
            #S...#
            ######
            """,
            """
            ++++++
            ++++++
            ++++++
            """,
            id="walls and their corners touch a free cell",
        ),
        pytest.param(
            """
            #####...
            #S..####
            #...####
            ####..##
            #####.##
            """,
            """
            +++++...
            +++++###
            +++++++#
            +++++++#
            ###++++#
            """,
            id="the diagonal gap is a way, the other side of a wall is not",
        ),
        pytest.param(
            """
            #########
            #S.##...#
            #..##...#
            #########
            """,
            """
            ++++#####
            ++++#...#
            ++++#...#
            ++++#####
            """,
            id="a closed room does not count, nor the inside of a thick wall",
        ),
        pytest.param(
            """
            #######
            #S.?..#
            #######
            """,
            """
            ++++###
            +++?..#
            ++++###
            """,
            id="unknown cells stop the agent and never count",
        ),
        pytest.param(
            """
            ....
            .S..
            """,
            """
            ++++
            ++++
            """,
            id="the border of the grid needs no wall",
        ),
    ],
)
def test_explorable(before: str, after: str) -> None:
    assert marked(before) == picture(after)


@given(GRIDS)
def test_what_is_explorable_is_free_or_a_wall_that_touches_it(cells: Grid) -> None:
    start = FloorPlan("any", cells, 1.0).default_start
    known = explorable(cells, start)
    assert known[start]
    assert not known[cells == UNKNOWN].any()
    for row, col in np.argwhere(known & (cells == OCCUPIED)):
        around = np.s_[max(row - 1, 0) : row + 2, max(col - 1, 0) : col + 2]
        assert (known[around] & (cells[around] == FREE)).any()
    # A free neighbour of a free explorable cell is explorable too.
    for row, col in np.argwhere(known & (cells == FREE)):
        around = np.s_[max(row - 1, 0) : row + 2, max(col - 1, 0) : col + 2]
        assert known[around][cells[around] == FREE].all()


@pytest.mark.parametrize(
    "drawn",
    [
        pytest.param(
            """
            ######
            #S...#
            #....#
            ######
            """,
            id="top row, then leftmost",
        ),
        pytest.param(
            """
            ###S.#
            #....#
            ######
            """,
            id="the top row counts before the left column",
        ),
        pytest.param(
            """
            ..####
            ..####
            ######
            ###S..
            ###...
            """,
            id="the largest region counts before the topmost",
        ),
        pytest.param(
            """
            ######
            S#.#.#
            #.#.##
            ######
            ....##
            """,
            id="cells that touch diagonally are one region",
        ),
        pytest.param(
            """
            ##S.
            ####
            ..##
            """,
            id="of two equal regions the topmost",
        ),
        pytest.param(
            """
            S.#..
            ..#..
            """,
            id="of two equal regions in the same row the leftmost",
        ),
        pytest.param(
            """
            .?S.
            .?..
            """,
            id="unknown cells divide regions",
        ),
    ],
)
def test_default_start(drawn: str) -> None:
    assert plan(drawn).default_start == find(drawn, "S")


def test_wall_share_counts_only_what_is_explorable() -> None:
    closed_room = plan("""
        ########
        #..##..#
        #..##.##
        ########
        """)
    # 4 free cells in the room on the left, and the 12 wall cells around them.
    assert closed_room.wall_share == 12 / 16


def test_a_chosen_start_is_checked() -> None:
    room = plan("""
        ####
        #..#
        ####
        """)
    assert room.check_start(None) == (1, 1)
    assert room.check_start(Cell(1, 2)) == (1, 2)
    with pytest.raises(FloorPlanError, match=r"start \(0, 2\) is not a free cell"):
        room.check_start(Cell(0, 2))
    for outside in (Cell(-1, 1), Cell(1, -1), Cell(3, 1), Cell(1, 4)):
        with pytest.raises(FloorPlanError, match="outside of 3 x 4"):
            room.check_start(outside)


def test_the_cells_cannot_be_changed() -> None:
    room = plan("..")
    with pytest.raises(ValueError, match="read-only"):
        room.cells[0, 0] = OCCUPIED


def test_the_digest_depends_on_all_that_matters_and_on_nothing_else() -> None:
    cells = draw("#..")
    same = FloorPlan("b", cells, 0.2).sha256
    assert FloorPlan("a", cells, 0.2).sha256 == same
    others = [
        FloorPlan("a", draw("..#"), 0.2),
        FloorPlan("a", cells.T.copy(), 0.2),
        FloorPlan("a", cells, 0.1),
        FloorPlan("a", cells, 0.2, Origin(1.0, 0.0)),
        FloorPlan("a", cells, 0.2, Origin(0.0, 1.0)),
    ]
    assert len({same, *(other.sha256 for other in others)}) == 6


def test_the_digest_does_not_depend_on_the_memory_layout() -> None:
    cells = draw("#..\n...")
    assert FloorPlan("a", np.asfortranarray(cells), 1.0).sha256 == FloorPlan("a", cells, 1.0).sha256


@pytest.mark.parametrize("name", ["", ".", "..", "a/b", "a b", "-a", "a\n", "ä", "a" * 129])
def test_an_id_must_be_a_name_of_a_file(name: str) -> None:
    with pytest.raises(FloorPlanError, match="an id is 1 to 128 letters"):
        FloorPlan(name, draw("."), 1.0)


@pytest.mark.parametrize(
    ("cells", "resolution", "origin", "reason"),
    [
        (np.zeros((2, 2), np.uint8), 1.0, Origin(0, 0), "expected int8"),
        (np.zeros(4, np.int8), 1.0, Origin(0, 0), "expected int8"),
        (np.full((2, 2), 50, np.int8), 1.0, Origin(0, 0), "must be -1, 0 or 100, found \\[50\\]"),
        (np.full((2, 2), OCCUPIED, np.int8), 1.0, Origin(0, 0), "no free cell"),
        (np.full((2, 2), UNKNOWN, np.int8), 1.0, Origin(0, 0), "no free cell"),
        (np.zeros((0, 0), np.int8), 1.0, Origin(0, 0), "at most"),
        (np.zeros((1, MAX_SIDE + 1), np.int8), 1.0, Origin(0, 0), f"at most {MAX_SIDE}"),
        (np.zeros((2, 2), np.int8), 0.0, Origin(0, 0), "positive number of metres"),
        (np.zeros((2, 2), np.int8), float("nan"), Origin(0, 0), "positive number of metres"),
        (np.zeros((2, 2), np.int8), 1.0, Origin(0, float("inf")), "not finite"),
    ],
)
def test_what_is_not_a_floor_plan_is_refused(
    cells: Grid, resolution: float, origin: Origin, reason: str
) -> None:
    with pytest.raises(FloorPlanError, match=f"floor plan odd: .*{reason}"):
        FloorPlan("odd", cells, resolution, origin)
