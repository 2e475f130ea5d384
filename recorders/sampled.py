"""A few of the maps that an agent had observed: what a predictor can be trained on."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mapreplay.grid import Grid
from mapreplay.recorders.log.reader import EpisodeLog


def observed_maps(log: EpisodeLog, count: int) -> Sequence[Grid]:
    """int8[H, W] each: the observed maps of `count` steps of `log`, or of all if it has fewer.

    They are evenly spaced, the first and the last step included.

    Raises:
        LogError: the file is damaged or can no longer be read.
    """
    last = len(log) - 1
    wanted = set(np.linspace(0, last, min(count, last + 1)).round().astype(int).tolist())
    maps = []
    for index, (observed,) in enumerate(log.maps("observed")):
        if index in wanted and observed is not None:
            maps.append(observed.astype(np.int8, copy=False))
    return maps
