"""One house for every name of the taxonomy: what is true, and what was predicted of it.

The sensor reaches one cell, so nearly all that the agent believes is what is drawn as predicted.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pytest

from mapreplay.analysis.diagnosis.diagnosis import diagnose
from mapreplay.analysis.diagnosis.taxonomy import KINDS, UNCLASSIFIED, words
from sealing import LEFT_ROOM, TWO_ROOMS, always, episode, recorded


@dataclass(frozen=True)
class Drawn:
    """A house and its prediction, in which the agent starts at `start`."""

    truth: str
    predicted: str
    start: tuple[int, int]


HOUSES = {
    "corner_leak": Drawn(  # a niche of two cells is all that is left
        """
        ########
        #....###
        #.....##
        #....###
        ########
        """,
        """
        ######??
        #....#??
        #....#??
        #....#??
        ######??
        """,
        (2, 2),
    ),
    "closed_doors": Drawn(  # a hall between two rooms
        """
        ###############
        #...#.....#...#
        #.............#
        #...#.....#...#
        ###############
        """,
        """
        ????#######????
        ????#.....#????
        ????#.....#????
        ????#.....#????
        ????#######????
        """,
        (2, 7),
    ),
    "closed_door": Drawn(TWO_ROOMS, LEFT_ROOM, (3, 2)),
    "corridor_cut": Drawn(  # two cells wide, eleven long, cut in its middle
        """
        ###############
        #.............#
        #.............#
        ###############
        """,
        """
        #######????????
        #.....#????????
        #.....#????????
        #######????????
        """,
        (1, 2),
    ),
    "phantom_wall": Drawn(  # from side to side of a square room
        """
        ##########
        #........#
        #........#
        #........#
        #........#
        #........#
        #........#
        #........#
        #........#
        ##########
        """,
        """
        #####?????
        #...#?????
        #...#?????
        #...#?????
        #...#?????
        #...#?????
        #...#?????
        #...#?????
        #...#?????
        #####?????
        """,
        (4, 2),
    ),
    UNCLASSIFIED: Drawn(  # five cells in a wide room, right behind the open way into it
        """
        ##################
        ####.............#
        ####.............#
        ####.............#
        ####.............#
        #................#
        #................#
        #................#
        ####.............#
        ####.............#
        ####.............#
        ####.............#
        ##################
        """,
        """
        ??????????????????
        ??????????????????
        ??????????????????
        ??????????????????
        #####?????????????
        #...#?????????????
        #...#?????????????
        #...#?????????????
        #####?????????????
        ??????????????????
        ??????????????????
        ??????????????????
        ??????????????????
        """,
        (6, 1),
    ),
}


@pytest.mark.parametrize("kind", HOUSES)
def test_every_kind_has_a_house(kind: str, tmp_path: Path) -> None:
    house = HOUSES[kind]
    made = episode(always(house.predicted), house.truth, start=house.start)
    sealing = diagnose(recorded(tmp_path / "a.mcap", made)).sealings[0]
    assert sealing.kind == kind


def test_no_kind_is_without_one() -> None:
    assert [*(kind.name for kind in KINDS), UNCLASSIFIED] == list(HOUSES)


def test_of_the_kinds_that_hold_the_first_is_taken(tmp_path: Path) -> None:
    """A door to a closet: also a closed door, but there is not more than a corner behind it."""
    truth = """
        ########
        #....#.#
        #......#
        #....#.#
        ########
    """
    house = HOUSES["corner_leak"]
    made = episode(always(house.predicted), truth, start=house.start)
    (sealing,) = diagnose(recorded(tmp_path / "a.mcap", made)).sealings
    assert sealing.passage is not None
    assert (sealing.passage.gap, sealing.kind) == (1, "corner_leak")


def test_only_what_has_a_name_is_told() -> None:
    assert all(words(kind.name) for kind in KINDS)
    assert words(UNCLASSIFIED) == ""
