"""Simulated observations to train on: the paper's random tree of observations.

The paper: "selecting an initial location within the empty occupancy grid at random and
accumulating observations randomly in a tree-like fashion to a certain depth which was
random as well. The simulation was run 5 times on each floorplan". Ours: the tree grows by
walks along a random ray for a random length; three of four start where the last one ended,
the others branch off at a random cell visited before; and the agent observes at every cell
that it passes, as it does when it explores. The number of walks is drawn log-uniformly
from one to twice the number of free cells, so that few and many observations are equally
common.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from mapreplay import kernels
from mapreplay.grid import FREE, UNKNOWN, Grid, Mask
from mapreplay.randomness import Draws, Purpose
from mapreplay.sensor import Sensor

RUNS_PER_PLAN: Final = 5


def simulate_observations(truth: Grid, explorable: Mask, sensor: Sensor, draws: Draws) -> Grid:
    """int8[H, W]: what a random tree of walks over `truth` has seen.

    `explorable` (bool[H, W]) says where the tree may start.
    """
    starts = np.flatnonzero(explorable & (truth == FREE))
    row, col = divmod(int(starts[draws.below(len(starts))]), truth.shape[1])
    branches = int((2 * len(starts)) ** (draws.below(1 << 20) / (1 << 20)))
    observed = np.full(truth.shape, UNKNOWN, np.int8)
    kernels.wander(truth, row, col, sensor.offsets, draws.raws(3 * branches), observed)
    return observed


def observation_draws(seed: int, plan: int, run: int) -> Draws:
    """The random numbers of run number `run` on plan number `plan`."""
    return Draws(seed, Purpose.OBSERVATIONS, index=plan, run=run)
