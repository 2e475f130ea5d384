"""Blocking cells: the fewest false walls that have to be corrected to give the agent a way out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy import ndimage

from mapreplay.analysis.diagnosis.kernels import fewest_moves, zero_one
from mapreplay.analysis.diagnosis.reach import EIGHT, false_walls, grown
from mapreplay.grid import FREE, UNKNOWN, Cell, Grid, Mask
from mapreplay.step import Cells

_NO_PASSING: Final = 2


@dataclass(frozen=True, eq=False)
class BlockingCells:
    """A smallest set of false walls to correct, and all others of its size."""

    cells: Cells
    """int32[n, 2], n >= 1, along the way out: one smallest set, that of a way with the fewest
    moves."""
    tied: Cells
    """int32[m, 2], row-major: all false walls that are in some smallest set, m >= n."""
    exits: int
    """In how many places the agent could break out at this price: the separate groups
    (8-connected) of the tied cells where such a way leaves what it can reach now."""
    way: Cells
    """int32[k, 2]: from the agent to the frontier cell that it would have."""

    @property
    def unique(self) -> bool:
        """Whether there is no other set of this size."""
        return len(self.cells) == len(self.tied)


def find_blocking_cells(
    truth: Grid, observed: Grid, fused: Grid, agent: Cell
) -> BlockingCells | None:
    """The fewest false walls of `fused` that give `agent` a frontier when they are corrected.

    A way out runs over free cells of the fused map and false walls to a cell with an unknown
    neighbour, and costs one for each false wall that it enters; the last one may be the
    frontier cell itself. So the cheapest way, a 0-1 shortest path, names a smallest set.

    Args:
        truth: int8[H, W].
        observed: int8[H, W].
        fused: int8[H, W], the map that is planned on and built.
        agent: Where it is, without a frontier.

    Returns:
        None if there is no such set: correcting predicted walls does not help.
    """
    wrong = false_walls(truth, observed, fused)
    cost = np.where(wrong, np.int8(1), np.int8(_NO_PASSING))
    cost[fused == FREE] = 0
    cost[agent] = 0
    goals = grown(fused == UNKNOWN) & (cost < _NO_PASSING)
    from_agent = np.empty(fused.shape, np.int32)
    to_goal = np.empty(fused.shape, np.int32)
    zero_one(cost, np.array([agent], np.int32), from_agent)
    ends = goals & (from_agent >= 0)
    if not ends.any():
        return None
    fewest = int(from_agent[ends].min())
    if fewest == 0:
        raise ValueError("the agent has a frontier")
    zero_one(cost, np.argwhere(goals).astype(np.int32), to_goal)
    on_way = (from_agent >= 0) & (to_goal >= 0) & (from_agent + to_goal - cost == fewest)
    best = goals & (from_agent == fewest)
    way = fewest_moves(on_way, cost, from_agent, agent.row, agent.col, best)
    tied = on_way & wrong
    first = tied & (from_agent == 1)
    return BlockingCells(
        cells=way[wrong[way[:, 0], way[:, 1]]],
        tied=np.argwhere(tied).astype(np.int32),
        exits=int(ndimage.label(first, EIGHT)[1]),
        way=way,
    )


def as_mask(cells: Cells, shape: tuple[int, int]) -> Mask:
    """bool[H, W]: the cells (int32[n, 2]) as a mask."""
    mask = np.zeros(shape, np.bool_)
    mask[cells[:, 0], cells[:, 1]] = True
    return mask
