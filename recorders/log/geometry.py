"""Cells of a floor plan and where they are: metres in frame ``map``, at the cells' centres."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from mapreplay.errors import LogError
from mapreplay.floorplan import FloorPlan
from mapreplay.grid import Cell
from mapreplay.recorders.log.limits import check_count
from mapreplay.step import Cells

Points: TypeAlias = npt.NDArray[np.float64]
"""float64[n, 3]: x, y, z in metres."""


def centre(cell: Cell, plan: FloorPlan) -> tuple[float, float]:
    """The x and y of a cell."""
    (x, y), resolution = plan.origin, plan.resolution
    return x + (cell.col + 0.5) * resolution, y + (cell.row + 0.5) * resolution


def centres(cells: Cells, plan: FloorPlan) -> Points:
    """The points of cells; z is 0."""
    points = np.zeros((len(cells), 3))
    points[:, 0] = plan.origin.x + (cells[:, 1] + 0.5) * plan.resolution
    points[:, 1] = plan.origin.y + (cells[:, 0] + 0.5) * plan.resolution
    return points


def cell_at(x: float, y: float, plan: FloorPlan) -> Cell:
    """The cell whose centre is at (x, y); see `cells_at`, which takes longer for one.

    Raises:
        ValueError: it is not in the map.
    """
    row = (y - plan.origin.y) / plan.resolution - 0.5
    col = (x - plan.origin.x) / plan.resolution - 0.5
    height, width = plan.shape
    # Rounded to even, like all of `cells_at`. The comparisons are false of what is not a number.
    if -1 < row < height and -1 < col < width:
        cell = Cell(round(row), round(col))
        if 0 <= cell.row < height and 0 <= cell.col < width:
            return cell
    raise ValueError("a cell outside of the map")


def cells_at(points: Points, plan: FloorPlan) -> Cells:
    """int32[n, 2]: the cells whose centres are at `points`.

    Raises:
        ValueError: they are not in the map, or are more than it has cells.
    """
    check_count(f"cells in a map of {plan.cells.size}", len(points), plan.cells.size)
    with np.errstate(invalid="ignore", over="ignore"):
        cells = _rounded(points, plan)
    if not ((cells >= 0) & (cells < plan.shape)).all():  # also if one is not a number
        raise ValueError("a cell outside of the map")
    return cells.astype(np.int32)


def check_geometry(plan: FloorPlan) -> None:
    """Make sure that every cell of `plan` can be told from its metres.

    Raises:
        LogError: cells are too small for the distance of the origin, or absurdly large.
    """
    side = np.arange(max(plan.shape), dtype=np.int32)
    cells = np.stack([side, side], axis=1)
    if not 1e-6 <= plan.resolution <= 1e6 or not np.array_equal(
        _rounded(centres(cells, plan), plan), cells
    ):
        raise LogError(
            f"floor plan {plan.id}: cells of {plan.resolution} m at {tuple(plan.origin)} cannot "
            "be logged in metres; choose another origin or resolution"
        )


def _rounded(points: Points, plan: FloorPlan) -> npt.NDArray[np.float64]:
    """float64[n, 2]: the cells whose centres are at `points`, wherever that is."""
    metres = points[:, 1::-1] - (plan.origin.y, plan.origin.x)
    cells: npt.NDArray[np.float64] = np.rint(metres / plan.resolution - 0.5)
    return cells
