"""Pictures of floor plans: a contact sheet of many."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

import cv2
import numpy as np

from mapreplay.errors import UsageError
from mapreplay.floorplan import FloorPlan, explorable
from mapreplay.grid import FREE, OCCUPIED, Mask
from mapreplay.pictures import Picture

Scale: TypeAlias = Literal["fit", "same"]
"""``fit``: each map fills its tile; ``same``: all have the same pixels per metre."""

MAX_PICTURE_PIXELS: Final = 100_000_000

_PAPER: Final = (240, 242, 244)
_INK: Final = (34, 40, 48)
_FAINT_INK: Final = (110, 116, 124)
_WALL: Final = (38, 48, 62)
_SOLID: Final = (202, 210, 220)
_FREE: Final = (255, 255, 255)
_CLOSED: Final = (250, 246, 240)
_UNKNOWN: Final = (178, 178, 178)
_START: Final = (226, 72, 52)

_FONT: Final = cv2.FONT_HERSHEY_SIMPLEX
_GAP: Final = 16
_DOT: Final = 4
_LINE: Final = 17
_THINNEST_WALL: Final = 0.6
"""Pixels."""
_TEXT_SIZE: Final = 0.42


@dataclass(frozen=True)
class _Crop:
    """The part of a map that is shown; bottom and right excluded, row 0 at the bottom."""

    low_row: int
    low_col: int
    high_row: int
    high_col: int

    @property
    def side(self) -> int:
        return max(self.high_row - self.low_row, self.high_col - self.low_col)


def contact_sheet(
    plans: Sequence[FloorPlan],
    columns: int | None = None,
    tile_pixels: int = 240,
    scale: Scale = "fit",
) -> Picture:
    """Draw `plans` in a grid, each with its id, size and share of walls below.

    Walls are dark, what is occupied and cannot be explored is pale, unknown cells are grey,
    and the default start is a red dot. Margins without anything to explore are left out.

    Args:
        plans: at least one.
        columns: tiles in a row; None chooses a sheet that is slightly wider than high.
        tile_pixels: side of the square that each map is drawn in, 32 to 2048.
        scale: ``fit`` or ``same``.

    Returns:
        The sheet, uint8[h, w, 3].

    Raises:
        UsageError: no plans, sizes out of range, or a picture of over 100 megapixels.
    """
    if not plans:
        raise UsageError("a contact sheet needs at least one floor plan")
    if not 32 <= tile_pixels <= 2048:
        raise UsageError(f"tiles of {tile_pixels} pixels; 32 to 2048 are allowed")
    across = _columns(len(plans)) if columns is None else columns
    if across < 1:
        raise UsageError(f"{across} columns; at least 1 is needed")
    across = min(across, len(plans))
    down = math.ceil(len(plans) / across)
    step_x, step_y = tile_pixels + _GAP, tile_pixels + _GAP + 2 * _LINE
    if across * step_x * down * step_y > MAX_PICTURE_PIXELS:
        raise UsageError(
            f"a contact sheet of {len(plans)} floor plans has over "
            f"{MAX_PICTURE_PIXELS // 1_000_000} megapixels; choose fewer, or smaller tiles"
        )
    masks = [explorable(plan.cells, plan.default_start) for plan in plans]
    crops = [_crop(mask) for mask in masks]
    metres = [crop.side * plan.resolution for crop, plan in zip(crops, plans, strict=True)]
    sheet = np.full((down * step_y + _GAP, across * step_x + _GAP, 3), _PAPER, np.uint8)
    for i, (plan, mask, crop) in enumerate(zip(plans, masks, crops, strict=True)):
        top, left = _GAP + i // across * step_y, _GAP + i % across * step_x
        shown = metres[i] if scale == "fit" else max(metres)
        pixels_per_cell = tile_pixels * plan.resolution / shown
        picture = _draw(plan, mask, crop, pixels_per_cell)
        height, width = picture.shape[:2]
        y, x = top + (tile_pixels - height) // 2, left + (tile_pixels - width) // 2
        sheet[y : y + height, x : x + width] = picture
        centre = (
            x + int((plan.default_start.col - crop.low_col + 0.5) * pixels_per_cell),
            y + int((crop.high_row - plan.default_start.row - 0.5) * pixels_per_cell),
        )
        cv2.circle(sheet, centre, _DOT, _START, cv2.FILLED, cv2.LINE_AA)
        _caption(sheet, plan, top + tile_pixels, left, tile_pixels)
    return sheet


def _columns(tiles: int) -> int:
    """About 1.4 times as many columns as rows, or one off that if it fills the last row."""
    usual = math.ceil(math.sqrt(1.4 * tiles))
    return min(range(usual - 1, usual + 2), key=lambda n: (-tiles % n, abs(n - usual)))


def _crop(mask: Mask) -> _Crop:
    """The bounding box of what is explorable."""
    rows, cols = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    return _Crop(int(rows[0]), int(cols[0]), int(rows[-1]) + 1, int(cols[-1]) + 1)


def _draw(plan: FloorPlan, mask: Mask, crop: _Crop, pixels_per_cell: float) -> Picture:
    colours = np.full((*plan.shape, 3), _UNKNOWN, np.uint8)
    colours[plan.cells == FREE] = _CLOSED
    colours[plan.cells == OCCUPIED] = _SOLID
    colours[mask & (plan.cells == FREE)] = _FREE
    walls = (mask & (plan.cells == OCCUPIED)).astype(np.uint8)
    thickness = round(_THINNEST_WALL / pixels_per_cell)
    if thickness > 1:  # otherwise the walls of a large map would fade
        walls = np.asarray(cv2.dilate(walls, np.ones((thickness, thickness), np.uint8)), np.uint8)
    colours[walls > 0] = _WALL
    cut = colours[crop.low_row : crop.high_row, crop.low_col : crop.high_col][::-1]
    height, width = (max(1, int(n * pixels_per_cell)) for n in cut.shape[:2])
    # Whole pixels per cell first, then an average: all cells look equally large.
    factor = max(1, math.ceil(pixels_per_cell))
    fine = cut.repeat(factor, axis=0).repeat(factor, axis=1)
    return np.asarray(cv2.resize(fine, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


def _caption(sheet: Picture, plan: FloorPlan, top: int, left: int, room: int) -> None:
    height, width = plan.shape
    size = (
        f"{width * plan.resolution:.1f} x {height * plan.resolution:.1f} m, "
        f"{width} x {height} cells, {plan.wall_share:.0%} walls"
    )
    for line, (text, ink) in enumerate(((plan.id, _INK), (size, _FAINT_INK)), start=1):
        at = (left, top + line * _LINE)
        cv2.putText(sheet, _shorten(text, room), at, _FONT, _TEXT_SIZE, ink, 1, cv2.LINE_AA)


def _shorten(text: str, room: int) -> str:
    """`text`, cut with two dots to what fits into `room` pixels."""
    cut = text
    while cut and cv2.getTextSize(cut, _FONT, _TEXT_SIZE, 1)[0][0] > room:
        cut = cut.removesuffix("..")[:-1] + ".." if len(cut) > 3 else ""
    return cut
