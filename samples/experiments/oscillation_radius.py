"""How near an observation must be to change what a target is worth: for the rule of oscillation.

    python samples/experiments/oscillation_radius.py FOLDER...

A folder a data set, of validation plans. For every target that is still a frontier cell some steps
later: by how much its reward changes if only what was observed meanwhile is taken from then, and
the prediction stays as it was; and how far from it (chessboard distance) the nearest cell is that
was observed meanwhile. The radius is the smallest within which, on every data set, 95 % of the
rewards that changed by more than 10 % had something observed.
"""

import sys
from collections import deque
from pathlib import Path

import numpy as np

from mapreplay import kernels
from mapreplay.analysis.diagnosis.harms import SOON
from mapreplay.grid import UNKNOWN, Cell, Grid, Quantized
from mapreplay.mapping import dequantize, fuse
from mapreplay.recorders.log.find import find_logs
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.step import EpisodeHeader, Step

LATER = (1, 2, 5, 10, SOON)
"""Steps."""
MATTERS, MOST = 0.10, 0.95
FARTHEST = 12


def reward(header: EpisodeHeader, observed: Grid, p_wall: Quantized, target: Cell) -> float:
    """Of one target, as Cost-Utility computes it."""
    confidence = np.abs(2 * dequantize(p_wall) - 1)
    gains = np.empty(1)
    kernels.view_gains(
        fuse(observed, p_wall, header.thresholds),
        np.where(observed == UNKNOWN, 1 - confidence, 0.0),
        np.array([target], np.int32),
        header.sensor.offsets,
        np.zeros(observed.shape, np.int64),
        gains,
    )
    return float(gains[0])


def changes(log: EpisodeLog) -> list[tuple[int, float]]:
    """Distance of the nearest observation, and relative change, of each target that was left."""
    found = []
    recent = deque[Step](maxlen=SOON)
    for step in log.steps():
        for before in [recent[-later] for later in LATER if later <= len(recent)]:
            if before.decision is None or before.p_wall is None:
                continue
            target = before.decision.target
            new = np.argwhere(step.observed != before.observed)
            if len(new) == 0 or not (step.frontier == np.array(target)).all(axis=1).any():
                continue
            then = reward(log.header, before.observed, before.p_wall, target)
            now = reward(log.header, step.observed, before.p_wall, target)
            nearest = int(np.abs(new - np.array(target)).max(axis=1).min())
            found.append((nearest, abs(now - then) / then if then else float(now > 0)))
        recent.append(step)
    return found


radii = []
for folder in sys.argv[1:]:
    logs = find_logs([Path(folder)])
    found = [change for path in logs for change in changes(EpisodeLog(path))]
    near = np.array([distance for distance, change in found if change > MATTERS])
    share = f"{len(near)} of {len(found)} rewards changed by more than {MATTERS:.0%}"
    print(f"{folder}: {len(logs)} logs, {share}")
    within = [float((near <= cells).mean()) for cells in range(FARTHEST + 1)]
    print("  observed within", *(f"{cells:>3}" for cells in range(FARTHEST + 1)), "cells")
    print("  of these in    ", *(f"{share:>3.0%}" for share in within))
    radii.append(next(cells for cells, share in enumerate(within) if share >= MOST))
print(f"radius: {max(radii)} cells")
