"""Occupancy grids: the values of a cell, and the types that all modules share.

Arrays are ``[row, col]``; row 0 is the smallest y. The centre of a cell is at
``x = origin.x + (col + .5) * resolution`` and likewise for y: the convention of
``nav_msgs/OccupancyGrid``. Pictures have row 0 on top and are flipped once, where an
image is read or shown.
"""

from __future__ import annotations

from typing import Final, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

UNKNOWN: Final = -1
FREE: Final = 0
OCCUPIED: Final = 100

Grid: TypeAlias = npt.NDArray[np.int8]
"""int8[H, W] of UNKNOWN, FREE and OCCUPIED."""

Mask: TypeAlias = npt.NDArray[np.bool_]
"""bool[H, W]."""

Quantized: TypeAlias = npt.NDArray[np.uint8] | npt.NDArray[np.uint16] | npt.NDArray[np.float32]
"""P(occupied) as it is logged: uint8[H, W] of 0..255, uint16[H, W] of 0..65535 or float32[H, W]
of 0..1."""


class Cell(NamedTuple):
    """A cell of a grid."""

    row: int
    col: int


class Origin(NamedTuple):
    """The lower left corner of cell (0, 0), metres in the ``map`` frame."""

    x: float
    y: float


def check_grid(cells: npt.NDArray[np.generic]) -> str | None:
    """The problem of `cells` as an occupancy grid, in words, or None."""
    if cells.ndim != 2 or cells.dtype != np.int8:
        return f"expected int8[H, W], got {cells.dtype}{list(cells.shape)}"
    values = np.unique(cells)
    alien = [int(v) for v in values if v not in (UNKNOWN, FREE, OCCUPIED)]
    if alien:
        return f"cells must be -1, 0 or 100, found {alien[:3]}"
    return None
