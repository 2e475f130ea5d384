"""From an image to a floor plan, with doubts about its grey levels."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from mapreplay.errors import FloorPlanError
from mapreplay.floorplan import Doubt, FloorPlan
from mapreplay.floorplans.greys import GreyRule, GreyThresholds
from mapreplay.floorplans.pixels import OPAQUE, Pixels
from mapreplay.grid import FREE, OCCUPIED, UNKNOWN, Grid, Origin

NOT_UNDERSTOOD: Final = ("transparent", "mode raw", "greys between the thresholds")
"""Kinds of doubts about pixels that are neither free nor occupied."""
CORNER: Final = Origin(0.0, 0.0)
SAVED_UNKNOWN: Final = 205
"""The grey level that map savers write for unknown."""
_MIDDLE: Final = range(127, 130)
"""Grey levels that some programs write for unknown."""
_PEAK: Final = 0.01
"""Minimum share of the pixels for a grey level to be one of the main levels of an image."""
_EVEN: Final = 0.6
"""Smaller gap between three levels, to the larger one, from which on the middle one is unknown."""
_FEW: Final = 0.001
_APART: Final = 9
"""Among grey levels that are closer than about half of this, the most common counts."""


def to_cells(pixels: Pixels, rule: GreyRule) -> Grid:
    """int8[H, W] of -1, 0 and 100. Pixels that are not opaque are unknown, except in mode raw."""
    cells: Grid = rule.table()[pixels.grey]
    if pixels.alpha is not None and rule.mode != "raw":
        cells[pixels.alpha != OPAQUE] = UNKNOWN
    return cells


@dataclass(frozen=True)
class Where:
    """Where a floor plan was read from."""

    file: Path
    """For messages: the YAML file, or an image without one."""
    spec: str
    """The opened path, to which options can be added."""

    def repeated(self, options: str) -> str:
        """The specification with other options, to be copied into a shell."""
        return shlex.quote(f"{self.spec}:{options}")


def plan_of(
    floor_plan_id: str,
    pixels: Pixels,
    rule: GreyRule,
    resolution: float,
    where: Where,
    *,
    origin: Origin = CORNER,
    doubts: Sequence[Doubt] = (),
) -> FloorPlan:
    """The floor plan of an image, with doubts about its grey levels.

    Args:
        floor_plan_id: Its ID.
        pixels: The image.
        rule: How its grey levels become cells.
        resolution: Metres per cell.
        where: Where it was read from.
        origin: Origin of its bottom left corner.
        doubts: Other doubts.

    Raises:
        FloorPlanError: no cell is free, or none is a wall and most pixels were not understood,
            or the resolution is invalid; names the file.
    """
    cells = to_cells(pixels, rule)
    doubts = (*doubts, *grey_doubts(pixels, rule, where))
    problem = None
    if not (cells == FREE).any():
        problem = "no free cell"
    elif not (cells == OCCUPIED).any() and 2 * int((cells == FREE).sum()) < cells.size:
        # What is free may be a mark in a map of which nothing else was understood.
        problem = "no wall" if any(doubt.kind in NOT_UNDERSTOOD for doubt in doubts) else None
    if problem is not None:
        raise FloorPlanError("; ".join([f"{where.file}: {problem}", *(d.text for d in doubts)]))
    try:
        return FloorPlan(
            floor_plan_id, cells, resolution, origin, file=str(where.file), doubts=doubts
        )
    except FloorPlanError as error:
        raise FloorPlanError(f"{where.file}: {error}") from None


def grey_doubts(pixels: Pixels, rule: GreyRule, where: Where) -> tuple[Doubt, ...]:
    """Reasons why `rule` may not fit the grey levels of an image."""
    opaque = pixels.grey
    if pixels.alpha is not None and rule.mode != "raw":
        opaque = pixels.grey[pixels.alpha == OPAQUE]
    counts = np.bincount(opaque.ravel(), minlength=256)
    if not counts.any():
        text = f"all of the {pixels.grey.size} pixels are transparent, which is unknown"
        return (Doubt("transparent", text),)
    seen = _Greys(counts, rule, pixels.grey.size, where)
    lost = [d for d in (seen.transparent(), seen.over_hundred(), seen.between()) if d is not None]
    others = (None if lost else seen.one_sided(), seen.saved_unknown())
    return (*lost, *(d for d in others if d is not None))


@dataclass(frozen=True, eq=False)
class _Greys:
    """The histogram of grey levels, and checks of it."""

    counts: npt.NDArray[np.int64]
    """int64[256], of opaque pixels."""
    rule: GreyRule
    pixels: int
    where: Where

    def count(self, cell: int) -> int:
        """Opaque pixels that become `cell`."""
        return int(self.counts[self.rule.table() == cell].sum())

    def transparent(self) -> Doubt | None:
        """Most pixels are clear."""
        clear = self.pixels - int(self.counts.sum())
        if 2 * clear <= self.pixels and (not clear or self.count(FREE)):
            return None
        return Doubt(
            "transparent",
            f"{clear} of {self.pixels} pixels are transparent, which is unknown; where that means "
            "free, fill the background of the image with white",
        )

    def over_hundred(self) -> Doubt | None:
        """Grey levels that are read as percentages."""
        over = int(self.counts[101:255].sum())
        if self.rule.mode != "raw" or over <= _PEAK * self.pixels:
            return None
        return Doubt(
            "mode raw",
            f"{over} of {self.pixels} pixels are over 100, which is not a percentage and "
            "unknown in mode raw; if they are grey levels, set mode: trinary",
        )

    def between(self) -> Doubt | None:
        """Most pixels are neither dark nor light enough, or nothing else is dark or light."""
        table = self.rule.table()
        inner = np.where(table == UNKNOWN, self.counts, 0)
        inner[SAVED_UNKNOWN] = 0
        if self.rule.mode == "raw":
            inner[101:] = 0
        total, rest = int(inner.sum()), self.pixels - int(self.counts[SAVED_UNKNOWN])
        walls, free = self.count(OCCUPIED), self.count(FREE)
        top = int(inner.argmax())
        usual = (
            top in _MIDDLE and inner[top] >= 0.95 * total and walls and free >= _PEAK * self.pixels
        )
        if usual or not (
            2 * total > rest or (not (walls and free) and total >= _PEAK * self.pixels)
        ):
            return None
        return Doubt(
            "greys between the thresholds",
            f"{total} of {self.pixels} pixels have {_list(inner)}, between {self._limits()}, and "
            f"count as unknown; {self._cure()}",
        )

    def one_sided(self) -> Doubt | None:
        """Everything is dark, or everything is light."""
        if self.count(FREE) and self.count(OCCUPIED):
            return None
        lacking = "free" if not self.count(FREE) else "occupied"
        greys = np.flatnonzero(self.counts)
        there = f"the greys go from {greys[0]} to {greys[-1]}"
        if len(greys) == 1:
            there = f"the only grey is {greys[0]}"
        return Doubt(
            "no free pixel" if lacking == "free" else "no wall",
            f"no pixel is {lacking}: {there}, with {self._limits()}; {self._cure()}",
        )

    def saved_unknown(self) -> Doubt | None:
        """The grey level for unknown of map savers is free or occupied here."""
        cell = int(self.rule.table()[SAVED_UNKNOWN])
        there = int(self.counts[SAVED_UNKNOWN])
        near = self.counts[SAVED_UNKNOWN - 1] + self.counts[SAVED_UNKNOWN + 1]
        if self.rule.mode == "raw" or cell == UNKNOWN:
            return None
        if there <= near or there < _FEW * self.pixels:
            return None
        thresholds = self.rule.thresholds
        if cell == OCCUPIED:
            why = "negate: 1" if self.rule.negate else f"occupied_thresh {thresholds.occupied:g}"
            cure = "negate: 0 keeps them unknown" if self.rule.negate else "0.65 keeps them unknown"
        elif thresholds.free > GreyThresholds.free:
            why = f"free_thresh {thresholds.free:g}"
            cure = f"{GreyThresholds.free} keeps them unknown"
            if self.rule.mode == "trinary":
                cure += f", as in {self.where.repeated(f'free={GreyThresholds.free}')}"
            else:
                cure += " in mode trinary"
        else:
            why, cure = f"mode {self.rule.mode}", "mode trinary keeps them unknown"
        return Doubt(
            f"unknown read as {'free' if cell == FREE else 'occupied'}",
            f"{there} of {self.pixels} pixels have the grey {SAVED_UNKNOWN}, which map savers "
            f"write for unknown, and count as {'free' if cell == FREE else 'occupied'} by {why}; "
            f"{cure}",
        )

    def _limits(self) -> str:
        """The free and the occupied grey levels, in words."""
        table = self.rule.table()
        words = []
        for name, cell in (("free", FREE), ("occupied", OCCUPIED)):
            greys = np.flatnonzero(table == cell)
            if not len(greys):
                words.append(f"{name} (no grey)")
            elif greys[0] == 0:
                words.append(f"{name} (below {greys[-1] + 1})")
            else:
                words.append(f"{name} (above {greys[0] - 1})")
        return " and ".join(words)

    def _cure(self) -> str:
        """How to choose thresholds, with numbers that separate the grey levels of this image."""
        p = self.rule.p_occupied()
        smooth = ndimage.maximum_filter1d(self.counts, _APART, mode="constant")
        peaks = (self.counts >= _PEAK * self.pixels) & (self.counts == smooth) & (p <= 1)
        peaks[SAVED_UNKNOWN] = False
        levels = np.unique(p[peaks])
        if len(levels) < 2:
            return "there are no two greys that could be free and occupied"
        gaps = np.diff(levels)
        if len(levels) == 3 and gaps.min() >= _EVEN * gaps.max():  # free, unknown and occupied
            free, occupied = levels[:2].mean(), levels[1:].mean()
        else:
            free = occupied = levels[gaps.argmax() :][:2].mean()
        option = self.where.repeated(f"free={free:.2f},occupied={occupied:.2f}")
        return f"if that is not what is meant, choose thresholds, such as {option}"


def _list(counts: npt.NDArray[np.int64]) -> str:
    """The three most common grey levels in words, such as "the grey 127 or 195"."""
    common = [int(grey) for grey in np.argsort(-counts, kind="stable")[:3] if counts[grey]]
    *most, last = map(str, sorted(common))
    text = f"{', '.join(most)} or {last}" if most else last
    return f"greys such as {text}" if np.count_nonzero(counts) > 3 else f"the grey {text}"
