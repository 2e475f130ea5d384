"""What has to be known of a floor plan, from where it is seen, and the moves between."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
import numpy.typing as npt
from scipy import sparse

from mapreplay import kernels as simulator
from mapreplay.analysis.limits import kernels
from mapreplay.floorplan import FloorPlan, explorable
from mapreplay.grid import FREE, Cell
from mapreplay.sensor import Sensor

Ints: TypeAlias = npt.NDArray[np.int32]
Longs: TypeAlias = npt.NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class CoverageTask:
    """Coverage of a floor plan, as a planner that knows it would see the task.

    Places are the free cells that can be reached, numbered in row-major order; cells are the
    explorable ones, numbered likewise.
    """

    start: int
    """The place where it begins."""
    needed: int
    """Cells that must be known: the fewest whose share reaches the target."""
    places: Ints
    """int32[F, 2]: row and column."""
    cells: Ints
    """int32[N, 2]."""
    moves: Ints
    """int32[F, 8]: the places that a move leads to, in the order of `kernels.MOVES`, or -1."""
    view_start: Longs
    """int64[F + 1]; what is known after looking from place i is
    ``view[view_start[i] : view_start[i + 1]]``."""
    view: Ints

    @cached_property
    def seers(self) -> tuple[Longs, Ints]:
        """The inverse: (start int64[N + 1], places from which a cell is seen)."""
        data = np.ones(self.view.size, np.int8)
        shape = (len(self.places), len(self.cells))
        columns = sparse.csr_array((data, self.view, self.view_start), shape=shape).tocsc()
        return columns.indptr.astype(np.int64), columns.indices.astype(np.int32)

    @property
    def spare(self) -> int:
        """Cells that may be left out."""
        return len(self.cells) - self.needed

    def seen_from(self, place: int) -> Ints:
        """The cells that are known after looking from a place."""
        return self.view[self.view_start[place] : self.view_start[place + 1]]

    def seen_along(self, path: Ints) -> npt.NDArray[np.bool_]:
        """bool[N]: what is known after looking from every place of a path."""
        known = np.zeros(len(self.cells), np.bool_)
        for place in set(path.tolist()):
            known[self.seen_from(place)] = True
        return known


def task_of(
    floor_plan: FloorPlan,
    start: Cell | None = None,
    target: float = 0.98,
    sensor: Sensor | None = None,
    within: int = 0,
) -> CoverageTask:
    """The task of knowing a share `target` of the explorable cells of a floor plan.

    Args:
        floor_plan: with its true map.
        start: a free cell, or None for the default one.
        target: coverage, above 0 and at most 1.
        sensor: the paper's by default.
        within: what lies so near (chessboard distance, cells) to something that was seen is
            known, too: the in-fill oracle. 0 is to observe.

    Raises:
        FloorPlanError: the start is not a free cell, or the true map is not known.
    """
    start = floor_plan.check_start(start)
    grid, sensor = floor_plan.cells, sensor or Sensor()
    region = explorable(grid, start)
    free = region & (grid == FREE)
    places = np.argwhere(free).astype(np.int32)
    cells = np.argwhere(region).astype(np.int32)
    place_number = _numbered(free)
    cell_number = _numbered(region)
    around = np.pad(place_number, 1, constant_values=-1)
    moves = np.stack(
        [around[places[:, 0] + 1 + r, places[:, 1] + 1 + c] for r, c in simulator.MOVES], axis=1
    )
    view_start = np.empty(len(places) + 1, np.int64)
    arguments = (grid, places, cell_number, sensor.offsets, within, view_start)
    view = np.empty(kernels.find_views(*arguments, np.empty(0, np.int32)), np.int32)
    kernels.find_views(*arguments, view)
    return CoverageTask(
        start=int(place_number[start]),
        needed=needed_cells(len(cells), target),
        places=places,
        cells=cells,
        moves=np.ascontiguousarray(moves),
        view_start=view_start,
        view=view,
    )


def _numbered(mask: npt.NDArray[np.bool_]) -> Ints:
    numbers = np.full(mask.shape, -1, np.int32)
    numbers[mask] = np.arange(mask.sum(), dtype=np.int32)
    return numbers


def needed_cells(cells: int, target: float) -> int:
    """The fewest of `cells` whose share, as the simulator computes it, reaches `target`."""
    needed = int(target * cells)
    while needed / cells < target:
        needed += 1
    while needed > 0 and (needed - 1) / cells >= target:
        needed -= 1
    return needed
