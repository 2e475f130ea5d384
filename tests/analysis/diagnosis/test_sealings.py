"""Sealings whose culprits and doorway a reader can see.

In `answer`, `C` is a culprit, `D` a cell of the doorway, `B` both. Where several sets are
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
    """False walls to set right."""
    exits: int = 1
    parts: int = 1
    """Of the doorway."""


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
    "a wide door: any of its cells lets out, all of them are the doorway": Drawn(
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
    "a wall two cells thick: two culprits in a row, a doorway of one": Drawn(
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
    "a culprit that is itself the frontier": Drawn(
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
    "a thin wall beats a thick one, but both were the doorway": Drawn(
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
def test_setting_the_culprits_right_lets_it_out(name: str) -> None:
    drawn = SEALINGS[name]
    b = situation(drawn)
    culprits = b.culprits()
    assert culprits is not None
    assert (len(culprits.cells), culprits.exits) == (drawn.fewest, drawn.exits)
    fused = b.fused.copy()
    for row, col in culprits.cells.tolist():
        assert (fused[row, col], b.truth[row, col]) == (OCCUPIED, FREE)
        assert not Scratch(fused.shape).has_way_out(fused, b.agent)
        fused[row, col] = FREE
    assert Scratch(fused.shape).has_way_out(fused, b.agent)


@pytest.mark.parametrize("name", [name for name in SEALINGS if name not in NOT_DRAWN])
def test_culprits_and_doorway_are_where_they_are_drawn(name: str) -> None:
    drawn = SEALINGS[name]
    b = situation(drawn)
    culprits, doorway = b.culprits(), b.doorway()
    assert culprits is not None
    assert doorway is not None
    both = marked(drawn.answer, "B")
    assert {tuple(cell) for cell in culprits.tied.tolist()} == marked(drawn.answer, "C") | both
    assert {tuple(cell) for cell in doorway.cells.tolist()} == marked(drawn.answer, "D") | both
    assert doorway.parts == drawn.parts


def test_ties_are_reported() -> None:
    wide = situation(
        SEALINGS["a wide door: any of its cells lets out, all of them are the doorway"]
    )
    culprits = wide.culprits()
    assert culprits is not None
    assert not culprits.unique
    closed = situation(SEALINGS["a closed door"]).culprits()
    assert closed is not None
    assert closed.unique


def test_of_two_doorways_of_one_size_the_nearest_is_taken() -> None:
    cut = situation(SEALINGS["a corridor that is cut"]).doorway()
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
    doorway = far.doorway()
    assert doorway is not None
    assert doorway.cells.tolist() == [[1, 3]]
    assert not doorway.unique


def test_observed_walls_are_never_culprits() -> None:
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
    culprits = b.culprits()
    assert culprits is not None
    assert culprits.tied.tolist() == [[1, 3]]


def test_without_a_false_wall_there_is_no_culprit() -> None:
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
    assert b.culprits() is None
    assert b.doorway() is None


def test_the_way_out_is_the_shortest_of_the_cheapest() -> None:
    b = situation(SEALINGS["a wide door: any of its cells lets out, all of them are the doorway"])
    culprits = b.culprits()
    assert culprits is not None
    assert len(culprits.way) == 4
    assert culprits.way[0].tolist() == list(b.agent)
    assert culprits.way[-1].tolist() == culprits.cells[0].tolist()
