"""Floor plans of neither kind, which the predictor `auto` must not classify as D1 or D2.

D1 plans at another scale than the predictors were trained at, and drawings that are no rooms
at all. Every plan follows from its number alone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

import cv2
import numpy as np

from mapreplay.floorplan import FloorPlan
from mapreplay.floorplans.procedural import Style, generate
from mapreplay.grid import FREE, OCCUPIED, Grid

SIDE: Final = 96
"""Cells along a side of a drawing."""


def doubled(number: int) -> FloorPlan:
    """A D1 plan with every cell made 2 x 2: walls of two cells."""
    plan = generate(number)
    cells = plan.cells.repeat(2, axis=0).repeat(2, axis=1)
    return FloorPlan(f"doubled-{number}", cells, plan.resolution / 2)


def fine(number: int) -> FloorPlan:
    """Rooms and doors twice those of D1, walls of one cell."""
    plan = generate(number, Style(128, 128, min_room=20, door=8, corner=2, shift=10))
    return FloorPlan(f"fine-{number}", plan.cells, plan.resolution / 2)


def clutter(number: int) -> FloorPlan:
    """Boxes of 1 to 6 cells, anywhere."""
    rng = np.random.default_rng([number, 1])
    cells = np.full((SIDE, SIDE), FREE, np.int8)
    for _ in range(int(rng.integers(20, 120))):
        row, col = rng.integers(0, SIDE, 2)
        height, width = rng.integers(1, 7, 2)
        cells[row : row + height, col : col + width] = OCCUPIED
    return FloorPlan(f"clutter-{number}", cells, 0.2)


def maze(number: int) -> FloorPlan:
    """A spanning tree of corridors of 1 to 12 cells, with walls of 1 to 3."""
    rng = np.random.default_rng([number, 2])
    corridor, wall = int(rng.integers(1, 13)), int(rng.integers(1, 4))
    pitch = corridor + wall
    count = (SIDE - wall) // pitch
    cells = np.full((SIDE, SIDE), OCCUPIED, np.int8)

    def carve(a: tuple[int, int], b: tuple[int, int]) -> None:
        (top, bottom), (left, right) = sorted((a[0], b[0])), sorted((a[1], b[1]))
        rows = slice(wall + top * pitch, wall + bottom * pitch + corridor)
        cells[rows, wall + left * pitch : wall + right * pitch + corridor] = FREE

    trail, seen = [(0, 0)], {(0, 0)}
    carve((0, 0), (0, 0))
    while trail:
        row, col = trail[-1]
        around = ((row, col + 1), (row + 1, col), (row, col - 1), (row - 1, col))
        near = [n for n in around if min(n) >= 0 and max(n) < count and n not in seen]
        if not near:
            trail.pop()
            continue
        chosen = near[int(rng.integers(len(near)))]
        carve((row, col), chosen)
        seen.add(chosen)
        trail.append(chosen)
    return FloorPlan(f"maze-{number}", cells, 0.2)


def cave(number: int) -> FloorPlan:
    """Smoothed noise, a third of it rock."""
    rng = np.random.default_rng([number, 3])
    noise = rng.standard_normal((SIDE, SIDE))
    smooth = cv2.GaussianBlur(noise, (0, 0), float(rng.uniform(1, 4)))
    cells = np.where(smooth > np.quantile(smooth, 0.65), OCCUPIED, FREE).astype(np.int8)
    return FloorPlan(f"cave-{number}", cells, 0.2)


def hall(number: int) -> FloorPlan:
    """Open space with at most a wall around it, and a few pillars."""
    rng = np.random.default_rng([number, 4])
    cells: Grid = np.full((SIDE, SIDE), FREE, np.int8)
    if rng.integers(2):
        cells[[0, -1]] = OCCUPIED
        cells[:, [0, -1]] = OCCUPIED
    for _ in range(int(rng.integers(0, 6))):
        row, col = rng.integers(8, SIDE - 8, 2)
        cells[row : row + 2, col : col + 2] = OCCUPIED
    return FloorPlan(f"hall-{number}", cells, 0.2)


DRAWN: Final[Mapping[str, Callable[[int], FloorPlan]]] = {
    function.__name__: function for function in (doubled, fine, clutter, maze, cave, hall)
}
"""Each by its name; all take the number of the plan."""
