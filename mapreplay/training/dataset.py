"""Training data: floor plans in memory, and batches of simulated observations of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from mapreplay.errors import FloorPlanError
from mapreplay.floorplan import FloorPlan, explorable
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
"""Observed maps of a logged episode that are trained on; neighbouring steps are much alike."""


@dataclass(frozen=True, eq=False)
class TrainingPlan:
    """A floor plan, its explorable cells, and whence it came in the list of plans."""

    number: int
    truth: Grid
    explorable: Mask
    logged: tuple[Grid, ...] = ()
    """What an agent had observed of it at some steps, each of the shape of `truth`. Where there
    is none, observations are simulated."""

    @property
    def runs(self) -> int:
        """How many observed maps there are of it."""
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
    return TrainingPlan(number, cells, explorable(cells, start), maps)


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


def make_batch(
    plans: Sequence[TrainingPlan], runs: Sequence[int], seed: int, padding: int
) -> Batch:
    """One observed map of each plan; all plans have one padded shape."""
    observed = [plan.observe(run, seed) for plan, run in zip(plans, runs, strict=True)]
    shape = padded_shape(plans[0])
    region = np.zeros((len(plans), *shape), np.bool_)
    for mask, plan in zip(region, plans, strict=True):
        mask[: plan.truth.shape[0], : plan.truth.shape[1]] = plan.explorable
    return Batch(
        np.stack([pad_to_multiple(cells, padding) for cells in observed]),
        np.stack([pad_to_multiple(plan.truth, UNKNOWN) for plan in plans]),
        region,
    )


@dataclass(frozen=True)
class Epoch:
    """One pass over all observed maps, in random order, grouped by shape.

    Where some are of logs and others are simulated, the pass has all of the logs' and as many
    of the simulated ones, drawn anew for every epoch.
    """

    plans: Sequence[TrainingPlan]
    cells_per_batch: int
    seed: int
    number: int
    padding: int

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
        rest = [group for _, group in sorted(waiting.items())]
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
        return make_batch(
            [self.plans[plan] for plan, _ in group],
            [run for _, run in group],
            self.seed,
            self.padding,
        )
