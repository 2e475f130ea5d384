"""Plausibility of floor plans of all sources, checked after reading.

A file that can be parsed may still be read wrongly: a map with grey levels between the thresholds
has no wall, and is mapped perfectly in a few steps. Plans that cannot be explored are refused;
doubtful plans give a warning with numbers and a remedy.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
from scipy import ndimage

from mapreplay.errors import FloorPlanError
from mapreplay.floorplan import Doubt, FloorPlan
from mapreplay.grid import FREE, OCCUPIED, Cell, Mask

FEW_CELLS: Final = 20
"""Minimum number of free cells for a meaningful exploration."""
ALMOST_ALL_UNKNOWN: Final = 0.97
ALMOST_ALL_WALL: Final = 0.98
OUTSIDE_BORDER: Final = 0.05
"""Share of the map's border in the free region from which it is probably the outside."""
ENCLOSED: Final = 0.1
"""Share of free cells enclosed by the free region from which they are the building."""
SMALLEST_CELL: Final = 0.01
LARGEST_CELL: Final = 1.0
LARGEST_SIDE: Final = 5000.0
"""Metres."""
THIN: Final = 4
"""Cells from the nearest wall: all that is free is so near where white is wall, as in a drawing;
or farther in a large image, if hardly anything is free and what is wall is much thicker."""
LINES: Final = 5
"""Maximum number of doubtful plans that are listed one by one; more are summarized."""

_EIGHT: Final = np.ones((3, 3), np.int8)


def check_explorable(plan: FloorPlan, start: Cell | None = None) -> Mask:
    """bool[H, W]: the free cells that can be reached from `start` (default: the plan's own).

    Raises:
        FloorPlanError: there is at most one such cell, or `start` is not free.
    """
    start = plan.check_start(start)
    labels, _ = ndimage.label(plan.cells == FREE, structure=_EIGHT)
    region: Mask = labels == labels[start]
    if region.sum() <= 1:
        alone = f"no cell can be reached from the start {start.row},{start.col}"
        why = [f"{plan.where}: nothing to explore, {alone}", *(d.text for d in plan.doubts)]
        raise FloorPlanError("; ".join(why))
    return region


def examine(plan: FloorPlan, start: Cell | None = None) -> tuple[Doubt, ...]:
    """Reasons why `plan`, explored from `start` (default: its own), may be read wrongly.

    Raises:
        FloorPlanError: see `check_explorable`.
    """
    region = check_explorable(plan, start)
    told = {doubt.kind for doubt in plan.doubts}
    found = _of_cells(plan, plan.check_start(start), region)
    return (*plan.doubts, *(doubt for doubt in found if doubt.kind not in told))


def _of_cells(plan: FloorPlan, start: Cell, region: Mask) -> Iterator[Doubt]:
    cells = plan.cells
    size = int(region.sum())
    walls = int((cells == OCCUPIED).sum())
    free = int((cells == FREE).sum())
    unknown = cells.size - walls - free
    near = int((ndimage.binary_dilation(region, _EIGHT) & (cells == OCCUPIED)).sum())
    if not walls:
        yield Doubt("no wall", f"none of the {cells.size} cells is a wall")
    elif near < math.sqrt(size):  # a quarter of what it takes to enclose a square room
        around = f"next to the {size} free cells that can be reached"
        yield Doubt("no wall", f"of {walls} cells that are walls {near} are {around}")
    if walls >= ALMOST_ALL_WALL * cells.size:
        text = f"{walls} of {cells.size} cells are walls; check what black and white mean (negate)"
        yield Doubt("almost all wall", text)
    elif _is_inverted(plan, walls, free):
        yield Doubt(
            "perhaps inverted",
            f"{walls} cells are walls and the {free} free ones are thin lines; if black and white "
            "are the wrong way round, change negate (in the YAML file, or as in PATH:negate=1)",
        )
    if unknown >= ALMOST_ALL_UNKNOWN * cells.size:
        yield Doubt("almost all unknown", f"{unknown} of {cells.size} cells are unknown")
    if walls:
        yield from _of_the_start(plan, start, region, free)
    if size < FEW_CELLS:
        yield Doubt("few cells", f"only {size} free cells can be reached from the start")
    elif 2 * size < free:
        yield Doubt("closed off", f"only {size} of {free} free cells can be reached from the start")
    yield from _of_the_size(plan)


def _of_the_start(plan: FloorPlan, start: Cell, region: Mask, free: int) -> Iterator[Doubt]:
    """Whether the region of the start is the outside of the building."""
    border = np.ones(region.shape, np.bool_)
    border[1:-1, 1:-1] = False
    touched, around = int((region & border).sum()), int(border.sum())
    cure = "choose another with run --start ROW,COL"
    if touched >= OUTSIDE_BORDER * around:
        yield Doubt(
            "start outside",
            f"the start {start.row},{start.col} is probably outside of the building: its free "
            f"region touches the border of the map at {touched} of {around} cells; {cure}",
        )
        return
    gaps, _ = ndimage.label(~region)  # 4-connected, as the region is 8-connected
    open_gaps = np.unique(gaps[border])
    enclosed = int((~np.isin(gaps, open_gaps) & ~region & (plan.cells == FREE)).sum())
    if enclosed >= ENCLOSED * free:
        yield Doubt(
            "start outside",
            f"the start {start.row},{start.col} may be outside of the building: its free region "
            f"encloses {enclosed} of {free} free cells; {cure}",
        )


def _of_the_size(plan: FloorPlan) -> Iterator[Doubt]:
    side = max(plan.shape) * plan.resolution
    if not (SMALLEST_CELL <= plan.resolution <= LARGEST_CELL and side <= LARGEST_SIDE):
        height, width = (n * plan.resolution for n in plan.shape)
        yield Doubt(
            "cell size",
            f"a cell has {plan.resolution:g} m, and the map {height:g} x {width:g} m; check the "
            "resolution (in metres per cell)",
        )


def _is_inverted(plan: FloorPlan, walls: int, free: int) -> bool:
    """Whether the free space is thin lines and the walls are thick and much more."""
    if walls < 3 * free:
        return False

    def thickness(cell: int) -> float:
        there = np.pad(plan.cells == cell, 1)
        depth = ndimage.distance_transform_cdt(there, "chessboard")
        return float(np.quantile(depth[there], 0.99))

    thin, thick = thickness(FREE), thickness(OCCUPIED)
    return (thin <= THIN and thick >= 5 * thin) or (walls >= 6 * free and thick >= 10 * thin)


def warning_lines(names: Sequence[str], doubts: Sequence[Sequence[Doubt]]) -> list[str]:
    """One warning per doubtful floor plan, or one summary if there are many.

    Args:
        names: Name of each floor plan in messages, see `FloorPlan.where`.
        doubts: Doubts about each, in the same order; possibly empty.
    """
    doubtful = [(name, found) for name, found in zip(names, doubts, strict=True) if found]
    if len(doubtful) <= LINES:
        return [f"warning: {name}: {'; '.join(d.text for d in found)}" for name, found in doubtful]
    kinds: dict[str, list[str]] = {}
    for name, found in doubtful:
        for kind in dict.fromkeys(doubt.kind for doubt in found):
            kinds.setdefault(kind, []).append(name)
    counted = ", ".join(
        f"{kind} ({len(of)}, such as {of[0]})"
        for kind, of in sorted(kinds.items(), key=lambda item: -len(item[1]))
    )
    odd = f"{len(doubtful)} of {len(names)} floor plans may be read wrongly: {counted}"
    return [f"warning: {odd}; `mapreplay floorplans SPEC --format json` has details on each"]
