"""Training data: floor plans in memory, and batches of simulated observations of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from mapreplay.errors import FloorPlanError
from mapreplay.floorplan import Doubt, FloorPlan, explorable
from mapreplay.floorplans import FloorPlanSource, load_each
from mapreplay.floorplans.plausibility import examine
from mapreplay.grid import UNKNOWN, Cell, Grid, Mask
from mapreplay.predictors.network import STRIDE_MULTIPLE, pad_to_multiple
from mapreplay.randomness import Draws, Purpose
from mapreplay.sensor import Sensor
from mapreplay.training.observations import (
    RUNS_PER_PLAN,
    observation_draws,
    simulate_observations,
)

MAX_SIDE: Final = 160
"""Larger plans are cut to a window of this many cells along a side."""
MIN_SIDE: Final = 8
MAPS_PER_LOG: Final = 24
"""Observed maps per logged episode, because neighbouring steps are similar."""
ORIENTATIONS: Final = 8
"""Ways to turn and mirror a map."""


class LossRegion(StrEnum):
    """Which cells of a map count in the loss."""

    ALL = "all"
    """The paper's: every cell, also those that no agent could ever see."""
    EXPLORABLE = "explorable"
    """Those that coverage counts. So p_wall is the probability of a wall *given that the cell
    can be mapped at all*: what is confident about it is confident about what is to be mapped."""
    NEARBY = "nearby"
    """Those of them that were not observed, with the weight 1 / (1 + d / 4) at a distance of d
    cells (chessboard) from an observed one: far away there are many and nothing can be told.
    The weight depends on what the network is given, so that its probabilities are the same."""


@dataclass(frozen=True, eq=False)
class TrainingPlan:
    """A floor plan, its explorable cells, and its number in the list of plans."""

    number: int
    truth: Grid
    explorable: Mask
    logged: tuple[Grid, ...] = ()
    """Observed maps of an agent at some steps, each of the shape of `truth`. If empty, observations
    are simulated."""
    id: str = ""
    """ID of the floor plan, for messages."""
    where: str = ""
    """Name of the floor plan in messages."""
    doubts: tuple[Doubt, ...] = ()
    """Doubts about the floor plan."""

    @property
    def runs(self) -> int:
        """Number of its observed maps."""
        return len(self.logged) or RUNS_PER_PLAN

    def observe(self, run: int, seed: int) -> Grid:
        """int8[H, W]: observed map number `run`; `seed` is that of simulated observations."""
        if self.logged:
            return self.logged[run]
        draws = observation_draws(seed, self.number, run)
        return simulate_observations(self.truth, self.explorable, Sensor(), draws)


@dataclass(frozen=True, eq=False)
class Batch:
    """Observed and true maps of one padded size."""

    observed: npt.NDArray[np.int8]
    """int8[B, H, W], padded with what the network's architecture says."""
    truth: npt.NDArray[np.int8]
    """int8[B, H, W], padded with unknown, which counts in no loss."""
    explorable: npt.NDArray[np.bool_]
    """bool[B, H, W], False in the padding."""
    weights: npt.NDArray[np.float32]
    """float32[B, H, W]: how much each cell counts in the loss, 0 in the padding."""


@dataclass(frozen=True)
class Layout:
    """How maps are made into batches."""

    padding: int
    """Cells that pad a map to a size that the network accepts."""
    loss_region: LossRegion
    fewest_left_over: int = 1
    """Minimum number of remaining maps of one shape at the end of an epoch; fewer are dropped."""


def prepare_plan(
    number: int, plan: FloorPlan, start: Cell | None = None, logged: Sequence[Grid] = ()
) -> TrainingPlan:
    """Cut a large plan to a window around its start, and find what is explorable.

    `logged` (int8[H, W] each) are maps of it that an agent had observed.
    """
    start = start or plan.default_start
    height, width = plan.shape
    top = min(max(0, start.row - MAX_SIDE // 2), max(0, height - MAX_SIDE))
    left = min(max(0, start.col - MAX_SIDE // 2), max(0, width - MAX_SIDE))
    window = slice(top, top + MAX_SIDE), slice(left, left + MAX_SIDE)
    cells = np.ascontiguousarray(plan.cells[window])
    start = start._replace(row=start.row - top, col=start.col - left)
    maps = tuple(np.ascontiguousarray(observed[window]) for observed in logged)
    return TrainingPlan(number, cells, explorable(cells, start), maps, plan.id)


def load_plans(
    numbers: Mapping[str, int], source: FloorPlanSource
) -> Iterator[TrainingPlan | FloorPlanError]:
    """Each plan, or its error: one invalid house does not end the training.

    `numbers` is the position of each ID in the list of plans.
    """
    for floor_plan_id, plan in load_each(source, list(numbers)):
        if isinstance(plan, FloorPlanError):
            yield plan
        elif min(plan.shape) < MIN_SIDE:
            yield FloorPlanError(f"floor plan {plan.id}: under {MIN_SIDE} cells along a side")
        else:
            prepared = prepare_plan(numbers[floor_plan_id], plan)
            yield replace(prepared, where=plan.where, doubts=examine(plan))


def padded_shape(plan: TrainingPlan) -> tuple[int, int]:
    """The plan's shape, rounded up to a size that the network accepts."""
    height, width = plan.truth.shape
    return height + -height % STRIDE_MULTIPLE, width + -width % STRIDE_MULTIPLE


def make_batch(
    plans: Sequence[TrainingPlan],
    runs: Sequence[int],
    seed: int,
    layout: Layout,
    orientation: int = 0,
) -> Batch:
    """One observed map of each plan; all plans have one padded shape.

    `orientation` (0 to 7) is the rotation and reflection of all of them; 0 is the identity.
    """

    def padded(cells: npt.NDArray[np.int8], padding: int) -> npt.NDArray[np.int8]:
        return pad_to_multiple(turned(cells, orientation), padding)

    observed = [plan.observe(run, seed) for plan, run in zip(plans, runs, strict=True)]
    seen = np.stack([padded(cells, layout.padding) for cells in observed])
    truth = np.stack([padded(plan.truth, UNKNOWN) for plan in plans])
    region = np.stack([padded(plan.explorable.view(np.int8), 0) for plan in plans]).view(np.bool_)
    return Batch(seen, truth, region, loss_weights(seen, truth, region, layout.loss_region))


def turned(cells: npt.NDArray[np.int8], orientation: int) -> npt.NDArray[np.int8]:
    """int8[H, W] `cells`, or int8[W, H], in one of the 8 ways to turn and mirror them."""
    if orientation & 4:
        cells = cells.T
    if orientation & 2:
        cells = cells[::-1]
    return cells[:, ::-1] if orientation & 1 else cells


def loss_weights(
    observed: npt.NDArray[np.int8],
    truth: npt.NDArray[np.int8],
    explorable: npt.NDArray[np.bool_],
    region: LossRegion,
) -> npt.NDArray[np.float32]:
    """float32[B, H, W]: how much each cell of maps [B, H, W] counts in the loss."""
    match region:
        case LossRegion.ALL:
            return np.asarray(truth != UNKNOWN, np.float32)
        case LossRegion.EXPLORABLE:
            return np.asarray(explorable, np.float32)
        case LossRegion.NEARBY:
            unseen = observed < 0
            distances = [
                cv2.distanceTransform(cells, cv2.DIST_C, 3) for cells in unseen.astype(np.uint8)
            ]
            near = 1 / (1 + np.stack(distances) / 4)
            return np.asarray(np.where(explorable & unseen, near, 0), np.float32)


@dataclass(frozen=True)
class Epoch:
    """One pass over all observed maps, in random order, grouped by shape.

    If some are logged and others simulated, the pass has all logged ones and the same number of
    simulated ones, drawn again for every epoch.
    """

    plans: Sequence[TrainingPlan]
    cells_per_batch: int
    seed: int
    number: int
    layout: Layout
    augment: bool = False
    """Turn and mirror every batch at random."""

    def batches(self) -> list[list[tuple[int, int]]]:
        """(index of plan, run) of each batch: the same list for the same seed and number."""
        pairs = self._pairs()
        order = Draws(self.seed, Purpose.SHUFFLE, index=self.number).permutation(len(pairs))
        waiting: dict[tuple[int, int], list[tuple[int, int]]] = {}
        full: list[list[tuple[int, int]]] = []
        for item in order.tolist():
            plan, run = pairs[item]
            shape = padded_shape(self.plans[plan])
            group = waiting.setdefault(shape, [])
            group.append((plan, run))
            if len(group) * shape[0] * shape[1] >= self.cells_per_batch:
                full.append(waiting.pop(shape))
        fewest = self.layout.fewest_left_over
        rest = [group for _, group in sorted(waiting.items()) if len(group) >= fewest]
        positions = Draws(self.seed, Purpose.SHUFFLE, index=self.number, run=1)
        for group in rest:
            full.insert(positions.below(len(full) + 1), group)
        return full

    def _pairs(self) -> list[tuple[int, int]]:
        logged = [(i, run) for i, p in enumerate(self.plans) if p.logged for run in range(p.runs)]
        simulated = [
            (i, run) for i, p in enumerate(self.plans) if not p.logged for run in range(p.runs)
        ]
        if logged and len(simulated) > len(logged):
            draws = Draws(self.seed, Purpose.SHUFFLE, index=self.number, run=2)
            chosen = draws.permutation(len(simulated))[: len(logged)]
            simulated = [simulated[i] for i in sorted(chosen.tolist())]
        return simulated + logged

    def batch(self, group: Sequence[tuple[int, int]]) -> Batch:
        """The observed maps of one batch, and their truth."""
        orientation = 0
        if self.augment:
            plan, run = group[0]
            draws = Draws(self.seed, Purpose.ORIENTATION, index=plan, run=self.number << 16 | run)
            orientation = draws.below(ORIENTATIONS)
        return make_batch(
            [self.plans[plan] for plan, _ in group],
            [run for _, run in group],
            self.seed,
            self.layout,
            orientation,
        )
