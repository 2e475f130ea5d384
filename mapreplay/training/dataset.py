"""Training data: floor plans in memory, and batches of simulated observations of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from mapreplay.errors import FloorPlanError
from mapreplay.floorplan import FloorPlan, explorable
from mapreplay.grid import Grid, Mask
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


@dataclass(frozen=True, eq=False)
class TrainingPlan:
    """A floor plan, its explorable cells, and whence it came in the list of plans."""

    number: int
    truth: Grid
    explorable: Mask


@dataclass(frozen=True, eq=False)
class Batch:
    """Observed and true maps of one padded size."""

    observed: npt.NDArray[np.int8]
    """int8[B, H, W], padded with unknown."""
    truth: npt.NDArray[np.int8]
    """int8[B, H, W], padded with unknown, which counts in no loss."""
    explorable: npt.NDArray[np.bool_]
    """bool[B, H, W], False in the padding."""


def prepare_plan(number: int, plan: FloorPlan) -> TrainingPlan:
    """Cut a large plan to a window around its default start, and find what is explorable."""
    start = plan.default_start
    height, width = plan.shape
    top = min(max(0, start.row - MAX_SIDE // 2), max(0, height - MAX_SIDE))
    left = min(max(0, start.col - MAX_SIDE // 2), max(0, width - MAX_SIDE))
    cells = np.ascontiguousarray(plan.cells[top : top + MAX_SIDE, left : left + MAX_SIDE])
    start = start._replace(row=start.row - top, col=start.col - left)
    return TrainingPlan(number, cells, explorable(cells, start))


def load_plans(
    ids: Sequence[str], load: Callable[[str], FloorPlan]
) -> Iterator[TrainingPlan | FloorPlanError]:
    """Each plan, or why it was refused: one bad house does not end the training."""
    for number, floor_plan_id in enumerate(ids):
        try:
            plan = load(floor_plan_id)
            if min(plan.shape) < MIN_SIDE:
                raise FloorPlanError(f"floor plan {plan.id}: under {MIN_SIDE} cells along a side")
            yield prepare_plan(number, plan)
        except FloorPlanError as error:
            yield error


def padded_shape(plan: TrainingPlan) -> tuple[int, int]:
    """The plan's shape, rounded up to what the network takes."""
    height, width = plan.truth.shape
    return height + -height % STRIDE_MULTIPLE, width + -width % STRIDE_MULTIPLE


def make_batch(plans: Sequence[TrainingPlan], runs: Sequence[int], seed: int) -> Batch:
    """One simulated observation run of each plan; all plans have one padded shape."""
    sensor = Sensor()
    observed = [
        simulate_observations(
            plan.truth, plan.explorable, sensor, observation_draws(seed, plan.number, run)
        )
        for plan, run in zip(plans, runs, strict=True)
    ]
    shape = padded_shape(plans[0])
    region = np.zeros((len(plans), *shape), np.bool_)
    for mask, plan in zip(region, plans, strict=True):
        mask[: plan.truth.shape[0], : plan.truth.shape[1]] = plan.explorable
    return Batch(
        np.stack([pad_to_multiple(cells) for cells in observed]),
        np.stack([pad_to_multiple(plan.truth) for plan in plans]),
        region,
    )


@dataclass(frozen=True)
class Epoch:
    """One pass over all plans and all their runs, in random order, grouped by shape."""

    plans: Sequence[TrainingPlan]
    cells_per_batch: int
    seed: int
    number: int

    def batches(self) -> list[list[tuple[int, int]]]:
        """(index of plan, run) of each batch: the same list for the same seed and number."""
        pairs = len(self.plans) * RUNS_PER_PLAN
        order = Draws(self.seed, Purpose.SHUFFLE, index=self.number).permutation(pairs)
        waiting: dict[tuple[int, int], list[tuple[int, int]]] = {}
        full: list[list[tuple[int, int]]] = []
        for item in order.tolist():
            plan, run = divmod(item, RUNS_PER_PLAN)
            shape = padded_shape(self.plans[plan])
            group = waiting.setdefault(shape, [])
            group.append((plan, run))
            if len(group) * shape[0] * shape[1] >= self.cells_per_batch:
                full.append(waiting.pop(shape))
        rest = [group for _, group in sorted(waiting.items())]
        positions = Draws(self.seed, Purpose.SHUFFLE, index=self.number, run=1)
        for group in rest:
            full.insert(positions.below(len(full) + 1), group)
        return full

    def batch(self, group: Sequence[tuple[int, int]]) -> Batch:
        """Simulate the observations of one batch."""
        return make_batch(
            [self.plans[plan] for plan, _ in group], [run for _, run in group], self.seed
        )
