"""Statistics for comparing planners on the same floor plans."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy import stats

RESAMPLES: Final = 9_999
CONFIDENCE: Final = 0.95


@dataclass(frozen=True)
class Estimate:
    """A mean over floor plans and its 95 % interval."""

    mean: float
    low: float
    high: float
    plans: int


def mean_interval(values: Sequence[float]) -> Estimate:
    """Mean of paired values, one for each floor plan, with a BCa bootstrap interval.

    The interval is the mean itself where all values are equal, and NaN for fewer than two.
    The resampling is seeded: the same values give the same interval.
    """
    data = np.asarray(values, np.float64)
    if data.size == 0:
        return Estimate(float("nan"), float("nan"), float("nan"), 0)
    mean = float(data.mean())
    if data.size < 2:
        return Estimate(mean, float("nan"), float("nan"), int(data.size))
    if np.ptp(data) == 0:
        return Estimate(mean, mean, mean, int(data.size))
    interval = stats.bootstrap(
        (data,),
        np.mean,
        n_resamples=RESAMPLES,
        confidence_level=CONFIDENCE,
        method="BCa",
        rng=np.random.default_rng(0),
    ).confidence_interval
    return Estimate(mean, float(interval.low), float(interval.high), int(data.size))
