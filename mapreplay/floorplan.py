"""A floor plan: the true map of a building, where an agent starts, and what it could explore."""

from __future__ import annotations

import hashlib
import re
import struct
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import ndimage

from mapreplay import kernels
from mapreplay.errors import FloorPlanError
from mapreplay.grid import FREE, OCCUPIED, UNKNOWN, Cell, Grid, Mask, Origin, check_grid

MAX_SIDE = 4096
"""Cells along the longer side above which a floor plan is refused (16.7 million cells)."""

ID_PATTERN = re.compile(r"[A-Za-z0-9][A-Za-z0-9._+-]{0,127}")
"""What a floor plan may be called, because ids become names of files."""


@dataclass(frozen=True)
class Doubt:
    """Why a floor plan may not be what was meant."""

    kind: str
    """In a few words, the same for all of its kind: "no wall"."""
    text: str
    """One line with the numbers and what to do about it."""


@dataclass(frozen=True, eq=False)
class FloorPlan:
    """The true map. Cells are -1 (unknown, as in a real robot's map), 0 or 100."""

    id: str
    cells: Grid
    """int8[H, W], read-only."""
    resolution: float
    """Metres a cell."""
    origin: Origin = Origin(0.0, 0.0)
    has_truth: bool = True
    """False for the log of a robot whose true map nobody knows; then all cells are unknown."""
    file: str = ""
    """What it was read from, for messages; empty where the id says it."""
    doubts: tuple[Doubt, ...] = ()
    """What its source found odd in the file; see `mapreplay.floorplans.plausibility`."""

    def __post_init__(self) -> None:
        """Check and freeze.

        Raises:
            FloorPlanError: cells of another type, too many, or none of them free.
        """
        if not ID_PATTERN.fullmatch(self.id):
            raise FloorPlanError(
                f"floor plan {self.id[:40]!r}: an id is 1 to 128 letters, digits and . _ + -"
            )
        problem = check_grid(self.cells)
        if problem is None and not 1 <= max(self.cells.shape) <= MAX_SIDE:
            problem = f"{self.cells.shape} cells; at most {MAX_SIDE} along a side are allowed"
        if problem is None and not (np.isfinite(self.resolution) and self.resolution > 0):
            problem = f"resolution {self.resolution} must be a positive number of metres a cell"
        if problem is None and not np.isfinite(self.origin).all():
            problem = f"origin {tuple(self.origin)} is not finite"
        if problem is None and not self.has_truth and (self.cells != UNKNOWN).any():
            problem = "cells are known of a true map that is not known"
        if problem is None and self.has_truth and not (self.cells == FREE).any():
            problem = "no free cell"
        if problem is not None:
            raise FloorPlanError(f"floor plan {self.id}: {problem}")
        self.cells.setflags(write=False)

    @property
    def where(self) -> str:
        """What a message calls it."""
        return self.file or f"floor plan {self.id}"

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width) in cells."""
        return self.cells.shape[0], self.cells.shape[1]

    @cached_property
    def sha256(self) -> str:
        """Hex digest of shape, cells, resolution and origin: what the simulation depends on."""
        digest = hashlib.sha256(struct.pack("<qqddd", *self.shape, self.resolution, *self.origin))
        digest.update(np.ascontiguousarray(self.cells).tobytes())
        return digest.hexdigest()

    @cached_property
    def wall_share(self) -> float:
        """Occupied share of the cells that are explorable from the default start, 0 to 1."""
        cells = self.cells[explorable(self.cells, self.default_start)]
        return float((cells == OCCUPIED).mean())

    @cached_property
    def default_start(self) -> Cell:
        """The top-left free cell (largest y, then smallest x) of the largest free region.

        Of two regions of one size, the one with the topmost, then leftmost cell.

        Raises:
            FloorPlanError: the true map is not known.
        """
        if not self.has_truth:
            raise FloorPlanError(f"floor plan {self.id}: its true map is not known")
        labels, _ = ndimage.label(self.cells == FREE, structure=np.ones((3, 3)))
        sizes = np.bincount(labels.ravel())[1:]
        largest = np.flatnonzero(sizes == sizes.max()) + 1
        from_top = np.isin(labels, largest)[::-1]
        row, col = divmod(int(np.argmax(from_top)), self.shape[1])
        return Cell(self.shape[0] - 1 - row, col)

    def check_start(self, start: Cell | None) -> Cell:
        """`start`, or the default one.

        Raises:
            FloorPlanError: `start` lies outside of the map or is not free.
        """
        if start is None:
            return self.default_start
        height, width = self.shape
        if not (0 <= start.row < height and 0 <= start.col < width):
            raise FloorPlanError(
                f"floor plan {self.id}: start {tuple(start)} lies outside of {height} x {width}"
            )
        if self.has_truth and self.cells[start] != FREE:
            raise FloorPlanError(f"floor plan {self.id}: start {tuple(start)} is not a free cell")
        return start


def explorable(cells: Grid, start: Cell) -> Mask:
    """bool[H, W]: what an agent at `start` (a free cell) could ever come to know.

    The free cells that can be reached (8-connected) and the occupied cells that touch one of
    them (8-neighbourhood). Unknown cells, closed rooms, the outside and the inside of thick
    walls are not explorable and count nowhere.
    """
    reached = np.zeros(cells.shape, np.bool_)
    stack = np.empty(cells.size, np.int32)
    kernels.flood(cells, start.row, start.col, reached, stack, kernels.MOVES)
    padded = np.pad(reached, 1)
    height, width = cells.shape
    near = np.zeros(cells.shape, np.bool_)
    for dr in (0, 1, 2):
        for dc in (0, 1, 2):
            near |= padded[dr : dr + height, dc : dc + width]
    near &= cells == OCCUPIED
    return np.logical_or(reached, near)
