"""The input of planners: shortest paths, the frontier, and the situation."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from mapreplay import kernels
from mapreplay.grid import UNKNOWN, Cell, Grid, Quantized
from mapreplay.mapping import doubt
from mapreplay.randomness import Draws
from mapreplay.sensor import Sensor
from mapreplay.step import Cells

Float64s = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Paths:
    """Shortest paths from one cell to all reachable free cells (8-connected).

    A cost is the integer pair (straight, diagonal) for straight + diagonal * sqrt 2, so
    that equal costs are equal.
    """

    straight: npt.NDArray[np.int32]
    """int32[H, W], -1 where there is no path."""
    diagonal: npt.NDArray[np.int32]

    def reaches(self, cell: Cell) -> bool:
        """Whether there is a path to `cell`."""
        return bool(self.straight[cell] >= 0)

    def costs(self, cells: Cells) -> Float64s:
        """float64[n]: the length of the shortest path to each cell, in cells."""
        costs: Float64s = kernels.costs_at(self.straight, self.diagonal, cells)
        return costs

    def to(self, cell: Cell) -> Cells:
        """int32[n, 2]: the shortest path to a cell that can be reached, both ends included.

        Of several, going back from the target, the one whose last moves come first in the
        order E, N, W, S, NE, NW, SW, SE.
        """
        path: Cells = kernels.walk_back(
            self.straight, self.diagonal, cell.row, cell.col, kernels.MOVES
        )
        return path


def shortest_paths(plan_map: Grid, agent: Cell) -> Paths:
    """All shortest paths from `agent` over the free cells of `plan_map` (int8[H, W])."""
    straight = np.empty(plan_map.shape, np.int32)
    diagonal = np.empty(plan_map.shape, np.int32)
    kernels.shortest_paths(plan_map, agent.row, agent.col, straight, diagonal)
    return Paths(straight, diagonal)


def frontier(paths: Paths, build_map: Grid) -> Cells:
    """int32[n, 2], row-major: reachable cells adjacent to an unknown cell of `build_map`.

    `paths` are over the free cells of the planning map (E); `build_map` is the target map (U).
    Adjacent means the 4-neighbourhood; if there is no such cell, the 8-neighbourhood, so that
    corners can be finished.
    """
    for neighbours in (4, 8):
        cells: Cells = kernels.touching_unknown(
            paths.straight, build_map, neighbours, kernels.MOVES
        )
        if len(cells):
            break
    return cells


@dataclass(frozen=True, eq=False)
class Situation:
    """Everything that a planner may use: maps, pose, the last target, random numbers. No truth."""

    agent: Cell
    plan_map: Grid
    """int8[H, W], E: the planning map."""
    build_map: Grid
    """int8[H, W], U: the target map, whose unknown cells define the frontier."""
    observed: Grid
    """int8[H, W]."""
    prediction: Quantized | None
    """The quantized prediction when planning on the fused map, else None."""
    frontier: Cells
    """int32[n, 2], n >= 1, row-major."""
    paths: Paths
    previous_target: Cell | None
    draws: Draws
    """This step's random numbers."""
    sensor: Sensor

    @cached_property
    def costs(self) -> Float64s:
        """float64[n]: length of the shortest path to each frontier cell, in cells."""
        return self.paths.costs(self.frontier)

    @property
    def previous_index(self) -> int | None:
        """The index of the last target in the frontier; None if it is no longer a frontier cell."""
        if self.previous_target is None:
            return None
        same = np.flatnonzero((self.frontier == self.previous_target).all(axis=1))
        return int(same[0]) if len(same) else None

    @cached_property
    def uncertainty(self) -> Float64s:
        """float64[H, W]: 1 - c, the gain of observing a cell, in [0, 1].

        c is 1 where a cell was observed, else |2 p - 1| when planning on the fused map and
        0 when planning on observations.
        """
        levels, top = self._doubt
        return levels / top

    @cached_property
    def _doubt(self) -> tuple[Float64s, int]:
        """`uncertainty` in whole numbers, and what stands for 1; see `mapping.doubt`."""
        unseen = self.observed == UNKNOWN
        if self.prediction is None:
            return np.asarray(unseen, np.float64), 1
        levels, top = doubt(self.prediction)
        return np.where(unseen, levels, 0.0), top

    def gains(self) -> Float64s:
        """float64[n]: the sum of `uncertainty` over the cells that the sensor would mark from
        each frontier cell on `plan_map`, where unknown cells are transparent.

        Equal sums are equal in any order of the rays.
        """
        levels, top = self._doubt
        return self.sums_in_view(levels) / top

    def sums_in_view(self, values: Float64s) -> Float64s:
        """float64[n]: the sum of `values` (float64[H, W]) over what `gains` sums over, in the
        order of the rays.
        """
        sums = np.empty(len(self.frontier), np.float64)
        seen = np.zeros(self.plan_map.shape, np.int64)
        kernels.view_gains(self.plan_map, values, self.frontier, self.sensor.offsets, seen, sums)
        return sums
