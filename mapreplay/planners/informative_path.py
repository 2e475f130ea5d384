"""Informative path: the expected gain along the whole path, per distance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from mapreplay.grid import FREE, UNKNOWN
from mapreplay.mapping import dequantize
from mapreplay.planners import Choice, best, kernels
from mapreplay.planning import Float64s, Situation

_GRAIN: Final = 2**20
"""Unit of the gains: this fraction of a cell."""


@dataclass(frozen=True)
class InformativePath:
    """Chooses the greatest expected gain along the path, per distance.

    utility = gain / (1 + distance). The gain counts the unknown cells of the target
    map, each times P(it is explorable) times P(it is seen), where a ray passes an
    unknown cell with 1 - P(occupied). It is that of the frontier cell's own view, and for the
    `ways` best by that, and for the last target, of all views on the shortest path.
    docs/planners.md has the equations, and why this never goes in circles.
    """

    ways: int = 8
    """Number of frontier cells whose whole path counts; with 0 only the views at the targets."""

    def choose(self, situation: Situation) -> Choice:
        """See `mapreplay.planners.Planner`."""
        worth, transparency = expectations(situation)
        frontier, offsets = situation.frontier, situation.sensor.offsets
        gains = np.empty(len(frontier), np.float64)
        kernels.view_gains(transparency, worth, frontier, offsets, gains)
        gains = self.settled(gains)
        utility = gains / (1 + situation.costs)
        first = np.argsort(-utility, kind="stable")[: self.ways]
        if len(first):
            if (going := situation.previous_index) is not None:
                first = np.union1d(first, going)
            along = np.empty(len(first), np.float64)
            paths = situation.paths
            kernels.way_gains(
                transparency, worth, paths.straight, paths.diagonal, frontier[first], offsets, along
            )
            along = self.settled(along)
            gains[first] = along
            # A way shows at least what its end does, so that none of the others is overrated.
            utility[first] = along / (1 + situation.costs[first])
        return Choice(best(utility, situation.costs), utility, gains)

    @staticmethod
    def settled(gains: Float64s) -> Float64s:
        """Gains rounded to 2^-20 cells, so that equal gains are equal in any order of the rays."""
        return np.rint(gains * _GRAIN) / _GRAIN


def expectations(situation: Situation) -> tuple[Float64s, Float64s]:
    """The gain of observing each cell, and the probability that a ray passes it.

    Both float64[H, W] in [0, 1]. Without a prediction, unknown cells count as free:
    explorable and transparent, as for Cost-Utility.
    """
    observed = situation.observed
    if situation.prediction is None:
        p_wall = np.zeros(observed.shape, np.float64)
    else:
        p_wall = dequantize(situation.prediction)
    worth = np.empty(observed.shape, np.float64)
    kernels.explorable_chance(situation.build_map, observed, p_wall, worth)
    # Also where the fused map takes the cell for known: a wall that is likely may be a door.
    transparency = np.where(observed == UNKNOWN, 1 - p_wall, observed == FREE)
    return worth, transparency
