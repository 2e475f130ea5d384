"""A step's maps as pictures, without a viewer: the same cells and colours as in Rerun.

painter = MapPainter(log.header)
rgb = painter.draw(MapView.FUSED, log[60], 480, 480, track=track, marks=marks)
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np
import numpy.typing as npt

from mapreplay.pictures import Picture, png_of
from mapreplay.recorders.pictures.annotations import Mark, mark_colours, shown_at
from mapreplay.recorders.pictures.layers import (
    MapView,
    cell_classes,
    display_probability,
    error_classes,
    rays_of,
)
from mapreplay.recorders.pictures.palette import (
    AGENT_COLOUR,
    CELL_COLOURS,
    FRONTIER_COLOUR,
    HITS_COLOUR,
    PLAN_COLOUR,
    RAYS_COLOUR,
    RIVALS_COLOUR,
    CellClass,
    Colour,
    class_colours,
    viridis,
)
from mapreplay.step import Cells, EpisodeHeader, Step

if TYPE_CHECKING:
    from mapreplay.recorders.log.reader import EpisodeLog

_SHIFT: Final = 4
"""OpenCV's coordinates are fixed-point numbers with this many fractional bits."""
_WHOLE_FROM: Final = 12.0
"""Cells of at least this many pixels are drawn with a whole number of them."""


@dataclass(frozen=True, eq=False)
class MapPainter:
    """Draws the maps of one episode."""

    header: EpisodeHeader

    def cells(self, view: MapView, step: Step) -> Picture:
        """uint8[H, W, 3]: one pixel per cell, row 0 on top, nothing drawn over it.

        A prediction is viridis, the others have the colours of `CellClass`; a missing
        prediction is unknown everywhere.
        """
        plan = self.header.floor_plan
        if view is MapView.PREDICTED:
            if step.p_wall is None:
                return np.full((*plan.shape, 3), CELL_COLOURS[CellClass.UNKNOWN], np.uint8)
            levels = display_probability(step.p_wall)
            return np.asarray(viridis()[levels[::-1]], np.uint8)
        if view is MapView.ERROR:
            classes = error_classes(step.fused, plan.cells, self.header.explorable)
        else:
            maps = {
                MapView.OBSERVED: step.observed,
                MapView.FUSED: step.fused,
                MapView.TRUTH: plan.cells,
            }
            classes = cell_classes(maps[view])
        return np.asarray(class_colours()[classes[::-1]], np.uint8)

    def draw(
        self,
        view: MapView,
        step: Step,
        width: int,
        height: int,
        *,
        track: Cells | None = None,
        marks: Sequence[Mark] = (),
    ) -> Picture:
        """The map, as large as fits into `width` x `height` pixels, with what is drawn over it.

        Every map has the agent and its trail; the observed one also the rays, the fused one
        frontier, path, target and its rivals; the fused, error and truth maps the marks.

        Args:
            view: which map.
            step: of which step.
            width: of the box, in pixels; the picture may be narrower.
            height: of the box; the picture may be lower.
            track: int32[n, 2], the cells of the agent up to this step; None draws no trail.
            marks: those of other steps are left out.

        Returns:
            uint8[h, w, 3], h <= height, w <= width.
        """
        rows, cols = self.header.floor_plan.shape
        scale = min(width / cols, height / rows)
        if scale >= _WHOLE_FROM:
            scale = float(int(scale))
        canvas = _Canvas(enlarge(self.cells(view, step), scale), scale, rows)
        if view is MapView.OBSERVED:
            self._draw_rays(canvas, step)
        if view is MapView.FUSED:
            canvas.discs(step.frontier, 0.4, FRONTIER_COLOUR)
        if view in (MapView.FUSED, MapView.ERROR, MapView.TRUTH):
            self._draw_marks(canvas, step, marks)
        if track is not None:
            canvas.line(track, AGENT_COLOUR, 1.8)
        if view is MapView.FUSED:
            self._draw_plan(canvas, step)
        canvas.dot(step.agent, AGENT_COLOUR, 4.0)
        return canvas.picture

    def _draw_rays(self, canvas: _Canvas, step: Step) -> None:
        rays = rays_of(step, self.header)
        for end in rays.ends:
            canvas.line(np.array([step.agent, end], np.int32), RAYS_COLOUR, 0.6)
        canvas.discs(rays.ends[rays.hit], 0.3, HITS_COLOUR)

    @staticmethod
    def _draw_plan(canvas: _Canvas, step: Step) -> None:
        decision = step.decision
        if decision is None:
            return
        canvas.line(decision.path, PLAN_COLOUR, 1.8)
        rivals = np.array([rival.cell for rival in decision.rivals], np.int32).reshape(-1, 2)
        canvas.discs(rivals, 0.45, RIVALS_COLOUR)
        canvas.dot(decision.target, PLAN_COLOUR, 4.0)

    @staticmethod
    def _draw_marks(canvas: _Canvas, step: Step, marks: Sequence[Mark]) -> None:
        colours = mark_colours(marks)
        for mark in shown_at(marks, step.index):
            canvas.boxes(mark.cells, colours[mark.name])


def map_pngs(
    log: EpisodeLog, step: Step, views: Iterable[MapView], side: int, marks: Sequence[Mark] = ()
) -> list[bytes]:
    """Maps of a step as PNG files, at most `side` pixels wide and high, with the trail so far.

    Raises:
        LogError: the log is damaged.
    """
    table, painter = log.table(), MapPainter(log.header)
    walked = table.filter(table["step"] <= step.index).select("row", "col")
    track = walked.to_numpy().astype(np.int32)
    return [
        png_of(painter.draw(view, step, side, side, track=track, marks=marks)) for view in views
    ]


def enlarge(picture: Picture, scale: float) -> Picture:
    """The picture with `scale` pixels for each of its own, all equally large; below 1, averages."""
    height, width = (max(1, round(n * scale)) for n in picture.shape[:2])
    if scale == int(scale):
        whole = int(scale)
        return picture.repeat(whole, axis=0).repeat(whole, axis=1)
    # Whole pixels per cell first, then an average.
    factor = max(1, int(scale) + 1)
    fine = picture.repeat(factor, axis=0).repeat(factor, axis=1)
    return np.asarray(cv2.resize(fine, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


class _Canvas:
    """A map to draw on, in cells of the grid."""

    def __init__(self, picture: Picture, scale: float, rows: int) -> None:
        self.picture: Final = np.ascontiguousarray(picture)
        self._scale = scale
        self._rows = rows
        # Fixed lines would hide the cells of a small picture, and be lost on a large one.
        self._unit = min(3.0, max(0.8, max(picture.shape[:2]) / 340))

    def _points(self, cells: npt.NDArray[np.integer]) -> npt.NDArray[np.int32]:
        """Where the centres of cells lie, in OpenCV's fixed-point pixels."""
        x = (cells[:, 1] + 0.5) * self._scale - 0.5
        y = (self._rows - 0.5 - cells[:, 0]) * self._scale - 0.5
        fixed = np.rint(np.stack([x, y], axis=1) * (1 << _SHIFT))
        return np.asarray(fixed, np.int32)

    def line(self, cells: Cells, colour: Colour, thickness: float) -> None:
        width = max(1, round(thickness * self._unit))
        points = self._points(cells)
        for start, end in zip(points[:-1].tolist(), points[1:].tolist(), strict=True):
            cv2.line(self.picture, start, end, colour, width, cv2.LINE_AA, _SHIFT)

    def discs(self, cells: Cells, radius: float, colour: Colour) -> None:
        """Discs of `radius` cells, at least of one pixel."""
        pixels = max(0.7, radius * self._scale)
        for x, y in self._points(cells).tolist():
            self._circle((x, y), pixels, colour, cv2.FILLED)

    def dot(self, cell: Sequence[int], colour: Colour, radius: float) -> None:
        """A disc with a white rim, `radius` units of the screen, so that it is always visible."""
        ((x, y),) = self._points(np.array([cell])).tolist()
        self._circle((x, y), (radius + 1.0) * self._unit, (255, 255, 255), cv2.FILLED)
        self._circle((x, y), radius * self._unit, colour, cv2.FILLED)

    def boxes(self, cells: Cells, colour: Colour) -> None:
        """The cells filled, with a dark edge, and no smaller than a dot."""
        half = max(0.5 * self._scale, 2.0 * self._unit)
        for x, y in (self._points(cells) / (1 << _SHIFT)).tolist():
            low = (round(x - half + 0.5), round(y - half + 0.5))
            high = (round(x + half - 0.5), round(y + half - 0.5))
            cv2.rectangle(self.picture, low, high, colour, cv2.FILLED)
            cv2.rectangle(self.picture, low, high, (0, 0, 0), max(1, round(0.6 * self._unit)))

    def _circle(self, at: tuple[int, int], radius: float, colour: Colour, thickness: int) -> None:
        fixed = round(radius * (1 << _SHIFT))
        cv2.circle(self.picture, at, fixed, colour, thickness, cv2.LINE_AA, _SHIFT)
