"""Predictors and planners for tests: small, deterministic, and as wrong as a test needs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from mapreplay.grid import Grid
from mapreplay.step import PredictorIdentity


@dataclass(frozen=True)
class ConstantPredictor:
    """The same probability everywhere."""

    p_wall: float
    identity: PredictorIdentity = PredictorIdentity("constant", "")

    def predict(self, observed: Grid) -> npt.NDArray[np.float32]:
        return np.full(observed.shape, self.p_wall, np.float32)


@dataclass(frozen=True, eq=False)
class FixedPredictor:
    """Always the same map of probabilities, whatever was observed."""

    p_wall: npt.NDArray[np.float32]
    identity: PredictorIdentity = PredictorIdentity("fixed", "")

    def predict(self, observed: Grid) -> npt.NDArray[np.float32]:
        return self.p_wall


@dataclass(frozen=True)
class NoisyPredictor:
    """Probabilities that look random, but depend on the observed map alone."""

    identity: PredictorIdentity = PredictorIdentity("noisy", "")

    def predict(self, observed: Grid) -> npt.NDArray[np.float32]:
        rows, cols = np.indices(observed.shape)
        seen = int((observed >= 0).sum())
        return (((rows * 7919 + cols * 104729 + seen * 31) % 1009) / 1008).astype(np.float32)
