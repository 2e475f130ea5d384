"""What the agent believes it can reach, and what it could truly reach."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from mapreplay import kernels
from mapreplay.analysis.diagnosis.kernels import has_two_ways, nearest_edge
from mapreplay.floorplan import explorable
from mapreplay.grid import FREE, OCCUPIED, UNKNOWN, Cell, Grid, Mask

EIGHT = np.ones((3, 3), np.bool_)
"""The neighbourhood of moves and of adjacency."""


class Scratch:
    """Buffers for searches on maps of one shape, which need not be cleared."""

    def __init__(self, shape: tuple[int, int]) -> None:
        self._seen = np.zeros(shape, np.int32)
        self._before = np.empty(shape[0] * shape[1], np.int32)
        self._queue = np.empty(shape[0] * shape[1], np.int32)
        self._mark = 0

    def has_way_out(self, built: Grid, agent: Cell) -> bool:
        """Whether an agent that plans on `built` (int8[H, W]) and builds it has a frontier.

        That is: over its free cells it can reach one with an unknown cell among its eight
        neighbours, which is when `mapreplay.planning.frontier` is not empty.
        """
        self._mark += 1
        edge = nearest_edge(
            built, agent.row, agent.col, self._seen, self._mark, self._before, self._queue
        )
        return int(edge) >= 0


def has_two_ways_out(built: Grid, agent: Cell) -> bool:
    """Whether no single cell closes all ways from `agent` to the frontier of `built`.

    The agent's own cell closes none; if it is a frontier cell itself, nothing does. False also
    if there is no way at all.
    """
    return bool(has_two_ways(built, agent.row, agent.col))


def reached(cells: Grid, start: Cell) -> Mask:
    """bool[H, W]: the free cells of `cells` that are 8-connected to `start`, and `start`."""
    mask = np.zeros(cells.shape, np.bool_)
    if cells[start] != FREE:
        cells = cells.copy()
        cells[start] = FREE
    stack = np.empty(cells.size, np.int32)
    kernels.flood(cells, start.row, start.col, mask, stack, kernels.MOVES)
    return mask


def grown(mask: Mask) -> Mask:
    """bool[H, W]: `mask` and the eight neighbours of its cells."""
    return np.asarray(ndimage.binary_dilation(mask, EIGHT), np.bool_)


def hidden(truth: Grid, built: Grid, agent: Cell) -> Mask:
    """bool[H, W]: the cells that the agent could still come to know, and that its map does not.

    They are unknown in `built` and explorable from where it is. If there is none, it has seen
    all there is, and an empty frontier is no failure.
    """
    mask: Mask = explorable(truth, agent) & (built == UNKNOWN)
    return mask


def false_walls(truth: Grid, observed: Grid, fused: Grid) -> Mask:
    """bool[H, W]: cells that are walls in the fused map, were not observed, and are free."""
    mask: Mask = (fused == OCCUPIED) & (observed == UNKNOWN) & (truth == FREE)
    return mask


def corrected(fused: Grid, cells: Mask, truth: Grid) -> Grid:
    """`fused` with `cells` (bool[H, W]) corrected with the ground truth."""
    return np.where(cells, truth, fused)
