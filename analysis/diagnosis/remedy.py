"""What would have helped: other thresholds, an informative viewpoint, the fail-safe."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from mapreplay.analysis.diagnosis.blocking import BlockingCells, as_mask
from mapreplay.analysis.diagnosis.detect import SealedSpan
from mapreplay.analysis.diagnosis.kernels import first_viewpoint
from mapreplay.analysis.diagnosis.reach import Scratch, grown
from mapreplay.episode import Episode, run_episode
from mapreplay.grid import FREE, OCCUPIED, UNKNOWN, Cell, Grid, Mask, Quantized
from mapreplay.kernels import SQRT2
from mapreplay.mapping import dequantize, overlay
from mapreplay.planners import Planner
from mapreplay.planning import shortest_paths
from mapreplay.sensor import Sensor, accumulate, sense
from mapreplay.step import EpisodeHeader, PredictorIdentity, Step


@dataclass(frozen=True, eq=False)
class Viewpoint:
    """The nearest cell from which a blocking cell would have been observed."""

    cell: Cell
    moves: int
    """To get there, over cells that the agent believes to be free and that are."""
    metres: float
    sees: int
    """How many false walls of a smallest set are seen to be free from there."""
    suffices: bool
    """Whether the agent then has a way out, with the prediction unchanged."""


@dataclass(frozen=True, eq=False)
class Remedy:
    """What would have prevented or undone a sealing; None where it would not have helped."""

    delta_occupied_above: float | None
    """With any higher confidence threshold for occupied cells it would not have been sealed in at
    this step (open loop: the steps before stay as they were)."""
    delta_free_above: float | None
    """The same for free cells."""
    viewpoint: Viewpoint | None
    fail_safe_moves: int | None
    """Moves that the fail-safe makes until there is a frontier again, with the same planner
    and the prediction of this step (an upper estimate; `branch` runs it with the network). None
    if that never happens, or cannot be tried."""


def threshold_of_walls(
    observed: Grid, fused: Grid, p_wall: Quantized, inside: Mask
) -> float | None:
    """The delta_occupied above which the agent would not have been sealed in at this step.

    A higher threshold makes the least certain predicted walls unknown first; there is a
    frontier as soon as one of those adjacent to what the agent can reach (`inside`, bool[H, W])
    is among them. With p that one's probability, that is where (1 + delta) / 2 > p.

    Returns:
        2 p - 1 in [0, 1), or None if no threshold up to 1 would do.
    """
    walls = grown(inside) & (fused == OCCUPIED) & (observed == UNKNOWN)
    if not walls.any():
        return None
    delta = 2 * float(dequantize(p_wall)[walls].min()) - 1
    return max(delta, 0.0) if delta < 1 else None


def threshold_of_free(observed: Grid, fused: Grid, p_wall: Quantized, inside: Mask) -> float | None:
    """The delta_free above which the agent would not have been sealed in at this step.

    A higher threshold makes the least certain predicted free cells unknown first; those on
    the way to such a cell are more certain, so that it is seen from one that can be reached.

    Returns:
        1 - 2 p in [0, 1) for the largest p of a predicted cell of `inside` (bool[H, W]), or
        None if no threshold up to 1 would do.
    """
    free = inside & (fused == FREE) & (observed == UNKNOWN)
    if not free.any():
        return None
    delta = 1 - 2 * float(dequantize(p_wall)[free].max())
    return max(delta, 0.0) if delta < 1 else None


def informative_viewpoint(
    truth: Grid,
    step: Step,
    inside: Mask,
    blocking: BlockingCells,
    sensor: Sensor,
    resolution: float,
    scratch: Scratch,
) -> Viewpoint | None:
    """The nearest cell of `inside` from which the sensor would have seen a blocking cell.

    `inside` (bool[H, W]) are the truly free cells that the agent can get to. Any false wall
    that is in a smallest set counts as a blocking cell. Of two cells at one cost, the first by row
    and column.
    """
    ground = np.where(inside, np.int8(FREE), np.int8(OCCUPIED))
    paths = shortest_paths(ground, step.agent)
    cells = np.argwhere(paths.straight >= 0).astype(np.int32)
    cells = cells[np.argsort(paths.costs(cells), kind="stable")]
    wanted = as_mask(blocking.tied, truth.shape)
    number = int(first_viewpoint(truth, cells, sensor.offsets, wanted))
    if number < 0:
        return None
    cell = Cell(*cells[number].tolist())
    straight, diagonal = int(paths.straight[cell]), int(paths.diagonal[cell])
    seen = accumulate(step.observed, cell, sense(truth, cell, sensor), sensor)
    return Viewpoint(
        cell=cell,
        moves=straight + diagonal,
        metres=(straight + diagonal * SQRT2) * resolution,
        sees=int((wanted & (seen == FREE)).sum()),
        suffices=scratch.has_way_out(overlay(seen, step.fused), cell),
    )


@dataclass(frozen=True, eq=False)
class _Frozen:
    """Predicts what was predicted at one step, whatever is observed."""

    p_wall: npt.NDArray[np.float64]
    identity: PredictorIdentity = PredictorIdentity("as it was", "")

    def predict(self, observed: Grid) -> npt.NDArray[np.float32]:  # noqa: ARG002
        """See `mapreplay.predictors.Predictor`."""
        return self.p_wall.astype(np.float32)


def fail_safe_moves(
    header: EpisodeHeader, planner: Planner, span: SealedSpan, scratch: Scratch
) -> int | None:
    """Moves that the fail-safe would make until the agent has a frontier again.

    The episode is continued from the sealing with the fail-safe and with the prediction of that
    step, so that only observations free it. None if it runs out of steps.

    Args:
        header: Of the step.
        planner: Of the episode.
        span: The sealing.
        scratch: For maps of this shape.
    """
    if span.first.p_wall is None:
        return None
    config = header.config.model_copy(update={"fail_safe": True})
    frozen = _Frozen(dequantize(span.first.p_wall))
    episode = Episode(replace(header, config=config), planner, frozen)
    for step in run_episode(episode, span.past):
        out = scratch.has_way_out(step.fused, step.agent)
        if out or step.outcome is not None:
            return step.index - span.first.index if out else None
    return None
