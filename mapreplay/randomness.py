"""Counter-based random numbers: any draw can be recomputed from its counters alone.

Only the raw output of Philox is used, because that is the same in every version of NumPy
and on every machine; the methods of ``numpy.random.Generator`` promise neither.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from functools import cached_property
from typing import TypeVar

import numpy as np
import numpy.typing as npt

T = TypeVar("T")


class Purpose(IntEnum):
    """What a stream is for; streams of different purposes never overlap."""

    FLOOR_PLAN = 1
    PLANNER = 2
    OBSERVATIONS = 3
    SHUFFLE = 4
    ORIENTATION = 5


class Draws:
    """A stream of random integers, fixed by `seed`, `purpose`, `index` and `run`."""

    def __init__(self, seed: int, purpose: Purpose, index: int = 0, run: int = 0) -> None:
        self._key = (seed, 0)
        self._counter = (0, run, index, purpose)

    @cached_property
    def _philox(self) -> np.random.Philox:
        # Made when first asked: most steps of most planners draw nothing.
        return np.random.Philox(
            key=np.array(self._key, np.uint64), counter=np.array(self._counter, np.uint64)
        )

    def raw(self) -> int:
        """A uniform integer in [0, 2^64)."""
        return int(self._philox.random_raw())

    def raws(self, count: int) -> npt.NDArray[np.uint64]:
        """uint64[count], each uniform in [0, 2^64)."""
        return self._philox.random_raw(count)

    def below(self, bound: int) -> int:
        """A uniform integer in [0, bound); the bias is below bound / 2^64."""
        return scale(self.raw(), bound)

    def between(self, low: int, high: int) -> int:
        """A uniform integer in [low, high], both included."""
        return low + self.below(high - low + 1)

    def choice(self, items: Sequence[T]) -> T:
        """One of `items`."""
        return items[self.below(len(items))]

    def permutation(self, count: int) -> npt.NDArray[np.int64]:
        """int64[count]: 0..count-1 in random order (stable argsort of raw draws)."""
        return np.argsort(self.raws(count), kind="stable").astype(np.int64)


def scale(raw: int, bound: int) -> int:
    """Map `raw`, uniform in [0, 2^64), to [0, bound) by multiplication."""
    return (raw * bound) >> 64
