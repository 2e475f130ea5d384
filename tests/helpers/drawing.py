"""Hand-drawn maps: ``#`` occupied, ``.`` free, ``?`` unknown; drawn as seen, top row first."""

from __future__ import annotations

import numpy as np

from mapreplay.floorplan import FloorPlan
from mapreplay.grid import FREE, OCCUPIED, UNKNOWN, Grid

_CELLS = {"#": OCCUPIED, ".": FREE, "?": UNKNOWN}
_MARKS = {value: mark for mark, value in _CELLS.items()}


def draw(picture: str) -> Grid:
    """The drawn map: the last line is row 0. Letters other than the marks are free cells."""
    lines = [line.strip() for line in picture.strip().splitlines()][::-1]
    return np.array([[_CELLS.get(mark, FREE) for mark in line] for line in lines], np.int8)


def find(picture: str, mark: str) -> tuple[int, int]:
    """(row, col) of the only `mark` in the picture."""
    lines = [line.strip() for line in picture.strip().splitlines()][::-1]
    places = [(r, line.index(mark)) for r, line in enumerate(lines) if mark in line]
    assert len(places) == 1
    return places[0]


def show(cells: Grid) -> str:
    """The picture of a map."""
    return "\n".join("".join(_MARKS[int(cell)] for cell in row) for row in cells[::-1])


def plan(picture: str, name: str = "drawn", resolution: float = 1.0) -> FloorPlan:
    """A floor plan from a picture."""
    return FloorPlan(name, draw(picture), resolution)
