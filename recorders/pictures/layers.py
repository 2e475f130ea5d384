"""The layers of a step that are shown: maps, errors, rays, states; `painter` draws them."""

from __future__ import annotations

from enum import StrEnum
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from mapreplay.grid import FREE, OCCUPIED, Grid, Mask, Quantized
from mapreplay.mapping import dequantize
from mapreplay.predictors import NoPredictor
from mapreplay.recorders.pictures.palette import CellClass, Curve, State
from mapreplay.step import Cells, EpisodeHeader, Mode, Outcome, Step


class MapView(StrEnum):
    """A map that is shown of each step."""

    OBSERVED = "observed"
    PREDICTED = "predicted"
    FUSED = "fused"
    ERROR = "error"
    TRUTH = "truth"

    @property
    def heading(self) -> str:
        """Its heading."""
        return _TITLES[self]


_TITLES: Final[dict[MapView, str]] = {
    MapView.OBSERVED: "Observed",
    MapView.PREDICTED: "Predicted P(wall)",
    MapView.FUSED: "Fused",
    MapView.ERROR: "Error of fused",
    MapView.TRUTH: "Truth",
}


def has_prediction(header: EpisodeHeader) -> bool:
    """Whether there is a prediction to show."""
    return header.predictor != NoPredictor.identity


def has_truth(header: EpisodeHeader) -> bool:
    """Whether the true map is known."""
    return header.floor_plan.has_truth


def map_views(header: EpisodeHeader) -> tuple[MapView, ...]:
    """The maps that have content, in their order from left to right."""
    views = [MapView.OBSERVED]
    if has_prediction(header):
        views.append(MapView.PREDICTED)
    views.append(MapView.FUSED)
    if has_truth(header):
        views.append(MapView.ERROR)
    return tuple(views)


def curves(header: EpisodeHeader) -> tuple[Curve, ...]:
    """The curves that differ: without a prediction, fused is observed."""
    if not has_truth(header):
        return ()
    if has_prediction(header):
        return tuple(Curve)
    return (Curve.F1, Curve.PRECISION, Curve.RECALL, Curve.COVERAGE_OBSERVED)


COMPARED: Final = (Curve.F1, Curve.CORRECT_COVERAGE)
"""The curves of episodes that are shown together."""


def cell_classes(cells: Grid) -> npt.NDArray[np.uint8]:
    """uint8[H, W] of `CellClass`: unknown, free or occupied."""
    classes = np.full(cells.shape, CellClass.UNKNOWN, np.uint8)
    classes[cells == FREE] = CellClass.FREE
    classes[cells == OCCUPIED] = CellClass.OCCUPIED
    return classes


def error_classes(cells: Grid, truth: Grid, region: Mask) -> npt.NDArray[np.uint8]:
    """uint8[H, W] of `CellClass`: `cells` with its errors marked.

    Cells that are right or still unknown keep their class. Cells outside of `region` (bool[H, W],
    the explorable ones) are a class of their own: they are neither right nor wrong.
    """
    classes = cell_classes(cells)
    classes[(cells == OCCUPIED) & (truth == FREE)] = CellClass.FALSE_WALL
    classes[(cells == FREE) & (truth == OCCUPIED)] = CellClass.FALSE_FREE
    classes[~region] = CellClass.NOT_EXPLORABLE
    return classes


def display_probability(p_wall: Quantized) -> npt.NDArray[np.uint8]:
    """uint8[H, W]: P(occupied) of 0..1 as 0..255, rounded, for display only."""
    if p_wall.dtype == np.uint8:
        return p_wall.astype(np.uint8, copy=False)
    return np.rint(dequantize(p_wall) * 255).astype(np.uint8)


class Rays(NamedTuple):
    """The rays of a step, from the agent."""

    ends: Cells
    """int32[rays, 2]: the last cell that each ray marked; the agent's where it marked none."""
    hit: npt.NDArray[np.bool_]
    """bool[rays]: whether a wall stopped the ray there."""


def rays_of(step: Step, header: EpisodeHeader) -> Rays:
    """The rays of a step: each ends where it hit, or at the end of its range or of the grid.

    A step without a scan has none.
    """
    if not len(step.hits):
        return Rays(np.empty((0, 2), np.int32), np.empty(0, np.bool_))
    height, width = header.floor_plan.shape
    sensor = header.sensor
    cells = np.asarray(step.agent) + sensor.offsets
    inside = ((cells >= 0) & (cells < (height, width))).all(axis=2)
    reached = np.where(step.hits > 0, step.hits, inside.sum(axis=1))
    ends = cells[np.arange(sensor.rays), reached - 1]
    ends[reached == 0] = step.agent
    return Rays(ends.astype(np.int32), step.hits > 0)


def state_of(step: Step) -> State:
    """The state of the agent: its mode, and at the last step the outcome."""
    if step.outcome is not None:
        return _ENDINGS[step.outcome]
    return State.FAIL_SAFE if step.mode is Mode.FAIL_SAFE else State.EXPLORING


_ENDINGS: Final = {
    Outcome.MAPPED: State.DONE,
    Outcome.SEALED_IN: State.SEALED_IN,
    Outcome.OUT_OF_STEPS: State.OUT_OF_STEPS,
}
