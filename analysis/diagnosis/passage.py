"""The passage of the floor plan at a cell: its width, its length, and the false wall in it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from mapreplay.analysis.diagnosis.blocking import BlockingCells
from mapreplay.analysis.diagnosis.reach import EIGHT, false_walls
from mapreplay.grid import FREE, Cell, Grid
from mapreplay.step import Step


@dataclass(frozen=True)
class Passage:
    """The passage at the first blocking cell on the way out."""

    gap: int
    """Width of the passage in cells: the shorter of the true free runs through the cell along
    its row and its column."""
    length: int
    """Of the passage: cells in a row, across the gap, at which it is at most one cell wider."""
    false_wall: int
    """Cells of the false wall that the blocking cell belongs to (8-connected)."""
    span: int
    """The longer side of its bounding box."""
    thickness: int
    """The shorter side."""
    distance: float
    """Cells (Euclidean) from the agent."""


def passage_at(truth: Grid, step: Step, blocking: BlockingCells) -> Passage:
    """Measure the true map and the false wall at the first of `blocking.cells`."""
    cell = Cell(*blocking.cells[0].tolist())
    wrong = false_walls(truth, step.observed, step.fused)
    labels, _ = ndimage.label(wrong, EIGHT)
    rows, cols = np.nonzero(labels == labels[cell])
    sides = sorted((int(np.ptp(rows)) + 1, int(np.ptp(cols)) + 1))
    gap, length = passage_size(truth, cell)
    return Passage(
        gap=gap,
        length=length,
        false_wall=len(rows),
        span=sides[1],
        thickness=sides[0],
        distance=float(np.hypot(cell.row - step.agent.row, cell.col - step.agent.col)),
    )


def runs_through(truth: Grid) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """int64[H, W] each: free cells in a row through each free cell, along its row and its
    column; 0 where it is not free.
    """
    free = truth == FREE
    along_row = _run_lengths(free)
    along_col = _run_lengths(free.T).T
    return along_row, along_col


def widths(truth: Grid) -> npt.NDArray[np.int64]:
    """int64[H, W]: the shorter of the two free runs through each cell; 0 where it is not free."""
    along_row, along_col = runs_through(truth)
    return np.minimum(along_row, along_col)


def passage_size(truth: Grid, cell: Cell) -> tuple[int, int]:
    """Width and length of the passage at a free `cell`, in cells; see `Passage`."""
    along_row, along_col = runs_through(truth)
    across = along_row if along_row[cell] <= along_col[cell] else along_col
    gap = int(across[cell])
    line = across[:, cell.col] if across is along_row else across[cell.row]
    at = cell.row if across is along_row else cell.col
    narrow = (line > 0) & (line <= gap + 1)
    first = last = at
    while first > 0 and narrow[first - 1]:
        first -= 1
    while last + 1 < len(line) and narrow[last + 1]:
        last += 1
    return gap, last - first + 1


def _run_lengths(free: npt.NDArray[np.bool_]) -> npt.NDArray[np.int64]:
    """int64[H, W]: the length of the run of True along its row that each cell is in."""
    height, width = free.shape
    padded = np.zeros((height, width + 2), np.int8)
    padded[:, 1:-1] = free
    change = np.diff(padded, axis=1)
    starts, ends = np.nonzero(change == 1), np.nonzero(change == -1)
    lengths = ends[1] - starts[1]
    result = np.zeros((height, width), np.int64)
    result[free] = np.repeat(lengths, lengths)
    return result
