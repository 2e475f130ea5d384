"""Controls: predictors that know nothing, and must look as bad as they are.

A measure of mapping that rewards one of these measures the wrong thing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from mapreplay.grid import Grid
from mapreplay.step import PredictorIdentity


@dataclass(frozen=True)
class ConstantPredictor:
    """Says the same of every cell, whatever was observed."""

    identity: PredictorIdentity
    p_wall: float
    """P(occupied) in [0, 1]."""

    def predict(self, observed: Grid) -> npt.NDArray[np.float32]:
        """See `mapreplay.predictors.Predictor`."""
        return np.full(observed.shape, self.p_wall, np.float32)


def always_free(wall_share: float) -> ConstantPredictor:  # noqa: ARG001 (see `CONTROLS`)
    """Free everywhere, with certainty: it covers every map before the first move."""
    return ConstantPredictor(PredictorIdentity("always-free", ""), 0.0)


def mean_wall(wall_share: float) -> ConstantPredictor:
    """Repeats the training plans' share of walls, everywhere."""
    return ConstantPredictor(PredictorIdentity("mean-wall", ""), wall_share)


CONTROLS: Final[Mapping[str, Callable[[float], ConstantPredictor]]] = {
    "always-free": always_free,
    "mean-wall": mean_wall,
}
"""By name, made from the share of walls among the explorable cells of the training plans."""
