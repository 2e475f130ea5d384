from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drawing import draw
from mapreplay.episode import Episode, run_episode
from mapreplay.pictures import Picture
from mapreplay.recorders.pictures.annotations import Mark, mark_colours, shown_at
from mapreplay.recorders.pictures.layers import MapView
from mapreplay.recorders.pictures.painter import MapPainter, enlarge
from mapreplay.recorders.pictures.palette import (
    AGENT_COLOUR,
    CELL_COLOURS,
    FRONTIER_COLOUR,
    MARK_COLOURS,
    PLAN_COLOUR,
    CellClass,
    viridis,
)
from mapreplay.step import Step
from recordings import two_rooms


@pytest.fixture(scope="module")
def episode() -> Episode:
    return two_rooms()


@pytest.fixture(scope="module")
def steps(episode: Episode) -> list[Step]:
    return list(run_episode(episode))


@pytest.fixture
def painter(episode: Episode) -> MapPainter:
    return MapPainter(episode.header)


def drawn(picture: Picture) -> str:
    """The picture of one pixel a cell as a drawing, the top row first."""
    letters = {
        CellClass.UNKNOWN: "?", CellClass.FREE: ".", CellClass.OCCUPIED: "#",
        CellClass.FALSE_WALL: "W", CellClass.FALSE_FREE: "f", CellClass.NOT_EXPLORABLE: "-",
    }  # fmt: skip
    of_colour = {CELL_COLOURS[c]: letter for c, letter in letters.items()}
    rows = [[tuple(pixel) for pixel in row] for row in picture.tolist()]
    return "\n".join("".join(of_colour[pixel] for pixel in row) for row in rows)


def mark(name: str, *cells: tuple[int, int], first: int = 0, last: int = 99) -> Mark:
    return Mark(name, first, last, np.array(cells, np.int32).reshape(-1, 2), "because")


def is_at(picture: Picture, cell: tuple[int, int], colour: tuple[int, int, int]) -> bool:
    """Whether the centre of `cell` has that colour, on a map of 12 x 12 cells."""
    pixels = picture.shape[0] // 12
    row, col = ((11 - cell[0]) * pixels + pixels // 2, cell[1] * pixels + pixels // 2)
    return bool(np.abs(picture[row, col].astype(int) - colour).max() <= 30)


def test_a_map_is_drawn_with_row_0_at_the_bottom(painter: MapPainter, steps: list[Step]) -> None:
    seen = """
        ????????????
        ????????????
        ????????????
        ????????????
        ????????????
        ????????????
        ????????????
        ????????????
        ????????????
        ##??????????
        #..?????????
        ###?????????
    """
    step = replace(steps[0], observed=draw(seen))
    shown = drawn(painter.cells(MapView.OBSERVED, step))
    assert shown == "\n".join(line.strip() for line in seen.strip().splitlines())


def test_the_error_shows_right_wrong_and_unknown(painter: MapPainter, steps: list[Step]) -> None:
    fused = painter.header.floor_plan.cells.copy()
    fused[1, 1], fused[0, 1], fused[1, 2] = 100, 0, -1
    bottom = drawn(painter.cells(MapView.ERROR, replace(steps[0], fused=fused))).splitlines()[-2:]
    assert bottom == [
        "#W?........#",
        "#f##########",
    ]


def test_a_prediction_is_viridis(painter: MapPainter, steps: list[Step]) -> None:
    p_wall = np.arange(144, dtype=np.uint8).reshape(12, 12)
    shown = painter.cells(MapView.PREDICTED, replace(steps[0], p_wall=p_wall))
    assert (shown == viridis()[p_wall[::-1]]).all()
    nothing = painter.cells(MapView.PREDICTED, replace(steps[0], p_wall=None))
    assert set(drawn(nothing)) == {"?", "\n"}


def test_the_agent_its_plan_and_the_frontier_are_on_their_cells(
    painter: MapPainter, steps: list[Step]
) -> None:
    step = steps[3]
    assert step.decision is not None
    picture = painter.draw(MapView.FUSED, step, 480, 480)
    assert is_at(picture, step.agent, AGENT_COLOUR)
    assert is_at(picture, step.decision.target, PLAN_COLOUR)
    covered = {tuple(cell) for cell in step.decision.path.tolist()}
    covered |= {rival.cell for rival in step.decision.rivals}
    frontier = {(r, c) for r, c in step.frontier.tolist()} - covered
    for cell in frontier:
        assert is_at(picture, cell, FRONTIER_COLOUR)
    observed = painter.draw(MapView.OBSERVED, step, 480, 480)
    assert not any(is_at(observed, cell, FRONTIER_COLOUR) for cell in frontier)


@pytest.mark.parametrize("view", MapView)
def test_marks_are_drawn_at_their_steps_where_they_can_be_judged(
    painter: MapPainter, steps: list[Step], view: MapView
) -> None:
    marks = [
        mark("blocking cell", (9, 9), first=2, last=3),
        mark("doorway", (2, 9), first=3, last=5),
    ]
    first, second = MARK_COLOURS[:2]
    for step in steps[:7]:
        picture = painter.draw(view, step, 480, 480, marks=marks)
        judged = view in (MapView.FUSED, MapView.ERROR, MapView.TRUTH)
        assert is_at(picture, (9, 9), first) == (judged and step.index in (2, 3))
        assert is_at(picture, (2, 9), second) == (judged and step.index in (3, 4, 5))


def test_marks_of_a_name_share_a_colour() -> None:
    marks = [mark("a", (0, 0)), mark("b", (0, 1), last=0), mark("a", (0, 2))]
    assert mark_colours(marks) == {"a": MARK_COLOURS[0], "b": MARK_COLOURS[1]}
    assert shown_at(marks, 1) == [marks[0], marks[2]]


@given(st.integers(1, 40), st.integers(1, 40), st.floats(0.1, 12))
def test_a_picture_is_enlarged_evenly(height: int, width: int, scale: float) -> None:
    rng = np.random.default_rng(height * 41 + width)
    picture = rng.integers(0, 255, (height, width, 3)).astype(np.uint8)
    large = enlarge(picture, scale)
    assert large.shape == (max(1, round(height * scale)), max(1, round(width * scale)), 3)
    if scale >= 3:
        rows = ((np.arange(height) + 0.5) * large.shape[0] / height).astype(int)
        cols = ((np.arange(width) + 0.5) * large.shape[1] / width).astype(int)
        assert (large[np.ix_(rows, cols)] == picture).all(), "the middle of each cell is its own"


@pytest.mark.parametrize("box", [(480, 480), (100, 300), (30, 30), (7, 9)])
def test_a_map_fits_into_its_box(
    painter: MapPainter, steps: list[Step], box: tuple[int, int]
) -> None:
    for view in MapView:
        height, width, _ = painter.draw(view, steps[2], *box).shape
        assert width <= box[0]
        assert height <= box[1]
        assert max(height, width) > 0.8 * min(box)
