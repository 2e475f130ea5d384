"""How often predicted probabilities are right, counted over cells that were not yet observed."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np
import numpy.typing as npt

from mapreplay.grid import FREE, OCCUPIED, UNKNOWN, Grid, Mask
from mapreplay.mapping import dequantize
from mapreplay.step import Step

BINS: Final = 50
"""Of P(occupied), of equal width."""
EVERY: Final = 10
"""Every Nth step is counted: the cells of successive steps are nearly the same."""


def _counts() -> npt.NDArray[np.int64]:
    return np.zeros((2, BINS), np.int64)


@dataclass(frozen=True, eq=False)
class Reliability:
    """Predicted cells by probability and truth."""

    counts: npt.NDArray[np.int64] = field(default_factory=_counts)
    """int64[2, BINS]: truly free and truly occupied cells in each bin of P(occupied)."""

    def __add__(self, other: Reliability) -> Reliability:
        return Reliability(self.counts + other.counts)

    def right(self, p_wall: float) -> tuple[float, int]:
        """The share of truly occupied cells among those about as likely, and the number of these.

        NaN if there are none.
        """
        free, occupied = self.counts[:, bin_of(p_wall)].tolist()
        total = free + occupied
        return (occupied / total if total else float("nan")), total


def bin_of(p_wall: float) -> int:
    """The bin of a probability."""
    return min(int(p_wall * BINS), BINS - 1)


class ReliabilityCounter:
    """Takes the steps of an episode in order."""

    def __init__(self, truth: Grid, region: Mask) -> None:
        self._occupied = truth == OCCUPIED
        self._known = region & ((truth == OCCUPIED) | (truth == FREE))
        self._counts = _counts()

    def take(self, step: Step) -> None:
        """Count the explorable cells that were not observed, every `EVERY` steps."""
        if step.p_wall is None or step.index % EVERY:
            return
        cells = self._known & (step.observed == UNKNOWN)
        p = dequantize(step.p_wall[cells])
        bins = np.minimum((p * BINS).astype(np.int64), BINS - 1)
        for row, chosen in enumerate((~self._occupied[cells], self._occupied[cells])):
            self._counts[row] += np.bincount(bins[chosen], minlength=BINS)

    def result(self) -> Reliability:
        """After the last step."""
        return Reliability(self._counts)
