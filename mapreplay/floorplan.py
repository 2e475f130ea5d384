"""A floor plan: the true map of a building, the default start, and the explorable cells."""

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
"""Pattern of floor-plan IDs, which become file names."""


@dataclass(frozen=True)
class Doubt:
    """A reason why a floor plan may have been read wrongly."""

    kind: str
    """A few words, the same for all doubts of its kind: "no wall"."""
    text: str
    """One line with the numbers and what to do."""


@dataclass(frozen=True, eq=False)
class FloorPlan:
    """The true map. Cells are -1 (unknown, as in a real robot's map), 0 or 100."""

    id: str
    cells: Grid
    """int8[H, W], read-only."""
    resolution: float
    """Metres per cell."""
    origin: Origin = Origin(0.0, 0.0)
    has_truth: bool = True
    """False if the true map is unknown, as for a robot; then all cells are unknown."""
    file: str = ""
    """The file that it was read from, for messages; empty if the ID says it."""
    doubts: tuple[Doubt, ...] = ()
    """Doubts of its source about the file; see `mapreplay.floorplans.plausibility`."""

    def __post_init__(self) -> None:
        """Check and freeze.

        Raises:
            FloorPlanError: cells have a wrong type, are too many, or none of them is free.
        """
        if not ID_PATTERN.fullmatch(self.id):
            raise FloorPlanError(
                f"floor plan {self.id[:40]!r}: an id is 1 to 128 letters, digits and . _ + -"
            )
        problem = check_grid(self.cells)
        if problem is None and not 1 <= max(self.cells.shape) <= MAX_SIDE:
            problem = f"{self.cells.shape} cells; at most {MAX_SIDE} along a side are allowed"
        if problem is None and not (np.isfinite(self.resolution) and self.resolution > 0):
            problem = f"resolution {self.resolution} must be a positive number of metres per cell"
        if problem is None and not np.isfinite(self.origin).all():
            problem = f"origin {tuple(self.origin)} is not finite"
        if problem is None and not self.has_truth and (self.cells != UNKNOWN).any():
            problem = "some cells are known although the true map is unknown"
        if problem is None and self.has_truth and not (self.cells == FREE).any():
            problem = "no free cell"
        if problem is not None:
            raise FloorPlanError(f"floor plan {self.id}: {problem}")
        self.cells.setflags(write=False)

    @property
    def where(self) -> str:
        """Its name in messages."""
        return self.file or f"floor plan {self.id}"

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width) in cells."""
        return self.cells.shape[0], self.cells.shape[1]

    @cached_property
    def sha256(self) -> str:
        """Hex digest of shape, cells, resolution and origin, on which the simulation depends."""
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

        Of two regions of the same size, the one with the topmost, then leftmost cell is taken.

        Raises:
            FloorPlanError: the true map is unknown.
        """
        if not self.has_truth:
            raise FloorPlanError(f"floor plan {self.id}: its true map is unknown")
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
    """bool[H, W]: the cells that an agent at `start` (a free cell) can observe.

    The reachable free cells (8-connected) and the occupied cells adjacent to one of them
    (8-neighbourhood). Unknown cells, closed rooms, the outside and the inside of thick walls
    are not explorable and not scored.
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
