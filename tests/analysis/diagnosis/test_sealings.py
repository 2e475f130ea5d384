"""Sealings whose blocking cells and opening a reader can see.

In `answer`, `C` is a blocking cell, `D` a cell of the opening, `B` both. Where several sets are
smallest, all of their cells are drawn.
"""

from __future__ import annotations

from dataclasses import dataclass

import pytest

from beliefs import Belief, belief, marked
from mapreplay.analysis.diagnosis.reach import Scratch, has_two_ways_out
from mapreplay.grid import FREE, OCCUPIED


@dataclass(frozen=True)
class Drawn:
    """A sealing and its answer."""

    truth: str
    believed: str
    answer: str
    fewest: int = 1
    """False walls to correct."""
    exits: int = 1
    parts: int = 1
    """Of the opening."""


SEALINGS = {
    "a closed door": Drawn(
        """
        ###########
        #....#....#
        #.........#
        #....#....#
        ###########
        """,
        """
        ######?????
        #....#?????
        #.A..W?????
        #....#?????
        ######?????
        """,
        """
        ...........
        ...........
        .....B.....
        ...........
        ...........
        """,
    ),
    "a wide door: any of its cells is a way out, all of them are the opening": Drawn(
        """
        #########
        #...#...#
        #.......#
        #.......#
        #.......#
        #...#...#
        #########
        """,
        """
        #####????
        #...#????
        #...W????
        #A..W????
        #...W????
        #...#????
        #####????
        """,
        """
        .........
        .........
        ....B....
        ....B....
        ....B....
        .........
        .........
        """,
    ),
    "a phantom wall across a room, with the true door behind it": Drawn(
        """
        ###########
        #......#..#
        #......#..#
        #.........#
        #......#..#
        #......#..#
        ###########
        """,
        """
        ####ffff???
        #..Wffff???
        #..Wffff???
        #A.Wffff???
        #..Wffff???
        #..Wffff???
        ####ffff???
        """,
        """
        ...........
        ...C.......
        ...C.......
        ...C...D...
        ...C.......
        ...C.......
        ...........
        """,
    ),
    "a corridor that is cut": Drawn(
        """
        ############
        #..........#
        ############
        """,
        """
        #####???????
        #A..W???????
        #####???????
        """,
        """
        ............
        ....B.......
        ............
        """,
    ),
    "a wall two cells thick: two blocking cells in a row, a opening of one": Drawn(
        """
        ############
        #..........#
        ############
        """,
        """
        ######??????
        #A..WW??????
        ######??????
        """,
        """
        ............
        ....BC......
        ............
        """,
        fewest=2,
    ),
    "a leak at a corner: diagonally between two walls": Drawn(
        """
        ########
        #..#...#
        #..#...#
        ###....#
        #......#
        ########
        """,
        """
        ####????
        #.A#????
        #..#????
        ###W????
        ????????
        ????????
        """,
        """
        ........
        ........
        ........
        ...B....
        ........
        ........
        """,
    ),
    "two exits": Drawn(
        """
        #############
        #....#.#....#
        #...........#
        #....#.#....#
        #############
        """,
        """
        ?????###?????
        ?????#.#?????
        ?????WAW?????
        ?????#.#?????
        ?????###?????
        """,
        """
        .............
        .............
        .....B.B.....
        .............
        .............
        """,
        exits=2,
        parts=2,
    ),
    "a blocking cell that is itself the frontier": Drawn(
        """
        ######
        #....#
        ######
        """,
        """
        ####??
        #A.W??
        ####??
        """,
        """
        ......
        ...B..
        ......
        """,
    ),
    "the way out leads over predicted free cells": Drawn(
        """
        ##########
        #........#
        ##########
        """,
        """
        ######????
        #A.Wff????
        ######????
        """,
        """
        ..........
        ...B......
        ..........
        """,
    ),
    "two phantom walls one behind the other": Drawn(
        """
        ############
        #..........#
        ############
        """,
        """
        ########????
        #A.WffWf????
        ########????
        """,
        """
        ............
        ...B..C.....
        ............
        """,
        fewest=2,
    ),
    "a thin wall beats a thick one, but both were the opening": Drawn(
        """
        ###########
        #.........#
        ###########
        """,
        """
        ??######???
        ??WW.A.W???
        ??######???
        """,
        """
        ...........
        ...D...B...
        ...........
        """,
        parts=2,
    ),
    "a room that is predicted solid, but for one cell": Drawn(
        """
        #######
        #.....#
        #.....#
        #.....#
        #######
        """,
        """
        #####??
        #WWWW??
        #AWWW??
        #WWWW??
        #####??
        """,
        """
        .......
        .......
        .......
        .......
        .......
        """,
        fewest=3,
    ),
    "the walls that are right stay": Drawn(
        """
        #########
        #...#...#
        #...#...#
        #...#...#
        #.......#
        #########
        """,
        """
        #####????
        #..AW????
        #...W????
        #...W????
        #...W????
        #####????
        """,
        """
        .........
        .........
        .........
        .........
        ....B....
        .........
        """,
    ),
}
NOT_DRAWN = {"a room that is predicted solid, but for one cell"}
"""Where too many sets are smallest to be drawn."""


def situation(drawn: Drawn) -> Belief:
    return belief(drawn.truth, drawn.believed)


@pytest.mark.parametrize("name", SEALINGS)
def test_the_agent_is_sealed_in(name: str) -> None:
    b = situation(SEALINGS[name])
    assert not Scratch(b.fused.shape).has_way_out(b.fused, b.agent)
    assert not has_two_ways_out(b.fused, b.agent)


@pytest.mark.parametrize("name", SEALINGS)
def test_correcting_the_blocking_cells_frees_it(name: str) -> None:
    drawn = SEALINGS[name]
    b = situation(drawn)
    blocking = b.blocking()
    assert blocking is not None
    assert (len(blocking.cells), blocking.exits) == (drawn.fewest, drawn.exits)
    fused = b.fused.copy()
    for row, col in blocking.cells.tolist():
        assert (fused[row, col], b.truth[row, col]) == (OCCUPIED, FREE)
        assert not Scratch(fused.shape).has_way_out(fused, b.agent)
        fused[row, col] = FREE
    assert Scratch(fused.shape).has_way_out(fused, b.agent)


@pytest.mark.parametrize("name", [name for name in SEALINGS if name not in NOT_DRAWN])
def test_blocking_cells_and_opening_are_where_they_are_drawn(name: str) -> None:
    drawn = SEALINGS[name]
    b = situation(drawn)
    blocking, opening = b.blocking(), b.opening()
    assert blocking is not None
    assert opening is not None
    both = marked(drawn.answer, "B")
    assert {tuple(cell) for cell in blocking.tied.tolist()} == marked(drawn.answer, "C") | both
    assert {tuple(cell) for cell in opening.cells.tolist()} == marked(drawn.answer, "D") | both
    assert opening.parts == drawn.parts


def test_ties_are_reported() -> None:
    wide = situation(
        SEALINGS["a wide door: any of its cells is a way out, all of them are the opening"]
    )
    blocking = wide.blocking()
    assert blocking is not None
    assert not blocking.unique
    closed = situation(SEALINGS["a closed door"]).blocking()
    assert closed is not None
    assert closed.unique


def test_of_two_openings_of_one_size_the_nearest_is_taken() -> None:
    cut = situation(SEALINGS["a corridor that is cut"]).opening()
    assert cut is not None
    assert cut.unique  # the next cell is where something is seen
    far = belief(
        """
        ############
        #..........#
        ############
        """,
        """
        ########????
        #A.WfffW????
        ########????
        """,
    )
    opening = far.opening()
    assert opening is not None
    assert opening.cells.tolist() == [[1, 3]]
    assert not opening.unique


def test_observed_walls_are_never_blocking_cells() -> None:
    b = belief(
        """
        #######
        #..#..#
        #.....#
        #######
        """,
        """
        ####???
        #.A#???
        #..W???
        ####???
        """,
    )
    blocking = b.blocking()
    assert blocking is not None
    assert blocking.tied.tolist() == [[1, 3]]


def test_without_a_false_wall_there_is_no_blocking_cell() -> None:
    b = belief(
        """
        #####
        #.#.#
        #####
        """,
        """
        ##W??
        #AW??
        ##W??
        """,
    )
    assert b.blocking() is None
    assert b.opening() is None


def test_the_way_out_is_the_shortest_of_the_cheapest() -> None:
    b = situation(
        SEALINGS["a wide door: any of its cells is a way out, all of them are the opening"]
    )
    blocking = b.blocking()
    assert blocking is not None
    assert len(blocking.way) == 4
    assert blocking.way[0].tolist() == list(b.agent)
    assert blocking.way[-1].tolist() == blocking.cells[0].tolist()
