"""From observation and prediction to the map: quantize, threshold, fuse.

Theta of the paper's block diagram. A prediction is quantized before it is used, so that the
log, which keeps the quantized one, reproduces every map and decision bit for bit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from typing import Final, cast

import numpy as np
import numpy.typing as npt

from mapreplay.config import PredictionDtype
from mapreplay.grid import FREE, OCCUPIED, UNKNOWN, Grid, Quantized

_TOP: Final = {np.dtype(np.uint8): 2**8 - 1, np.dtype(np.uint16): 2**16 - 1}
"""The level of certainty of the integer types."""
_FINE: Final = 2**32
"""Steps of the doubt of a float32."""


def quantize(p_wall: npt.NDArray[np.floating], dtype: PredictionDtype) -> Quantized:
    """Round P(occupied), float[H, W] in [0, 1], to the nearest value that `dtype` can hold.

    Raises:
        ValueError: a value is not a number in [0, 1].
    """
    if not (p_wall.min() >= 0 and p_wall.max() <= 1):  # also true of NaN
        raise ValueError("P(occupied) must be in [0, 1] everywhere")
    if dtype is PredictionDtype.FLOAT32:
        return p_wall.astype(np.float32)
    scaled = np.rint(p_wall.astype(np.float64) * _TOP[np.dtype(dtype.value)])
    if dtype is PredictionDtype.UINT16:
        return scaled.astype(np.uint16)
    return scaled.astype(np.uint8)


def dequantize(quantized: Quantized) -> npt.NDArray[np.float64]:
    """P(occupied) as float64[H, W] in [0, 1]."""
    return quantized.astype(np.float64) / certainty(quantized)


def doubt(quantized: Quantized) -> tuple[npt.NDArray[np.float64], int]:
    """1 - |2 p - 1| as whole numbers, so that sums are exact in any order.

    Returns:
        float64[H, W] of whole numbers, and what stands for 1 among them. Of float32 they are
        rounded to 2^-32; sums are exact up to 2^21 cells.
    """
    top = _TOP.get(quantized.dtype)
    if top is None:
        return np.rint((1 - np.abs(2 * dequantize(quantized) - 1)) * _FINE), _FINE
    return top - np.abs(2 * quantized.astype(np.float64) - top), top


def quantum(quantized: Quantized) -> float:
    """The step between two probabilities: 1/255, 1/65535, or the spacing of float32 at 1."""
    top = _TOP.get(quantized.dtype)
    return 1 / top if top else float(np.finfo(np.float32).eps)


def certainty(quantized: Quantized) -> int:
    """The level of P(occupied) = 1: 255, 65535, or 1 for float32."""
    return _TOP.get(quantized.dtype, 1)


@dataclass(frozen=True)
class Thresholds:
    """Confidence levels of the two classes, each in [0, 1] (paper, eq. thresholds)."""

    delta_free: float = 0.93
    delta_occupied: float = 0.95

    @property
    def free_at_most(self) -> Fraction:
        """A cell is free if p <= this; exact for the given decimal."""
        return (1 - Fraction(str(self.delta_free))) / 2

    @property
    def occupied_at_least(self) -> Fraction:
        """A cell is occupied if p >= this, and not free."""
        return (1 + Fraction(str(self.delta_occupied))) / 2


def threshold(quantized: Quantized, thresholds: Thresholds) -> Grid:
    """int8[H, W]: free, occupied, or unknown where the prediction is not confident.

    Integer predictions are compared exactly, float32 ones with the threshold rounded to
    float32. A value that satisfies both is free.
    """
    if quantized.dtype in _TOP:
        levels = cast("npt.NDArray[np.uint8]", quantized)
        return _classes_of_levels(levels.dtype, thresholds).take(levels)
    free, occupied = sure_levels(quantized, thresholds)
    cells = np.where(quantized >= np.float32(occupied), np.int8(OCCUPIED), np.int8(UNKNOWN))
    cells[quantized <= np.float32(free)] = FREE
    return cells


def sure_levels(quantized: Quantized, thresholds: Thresholds) -> tuple[float, float]:
    """The largest value of a prediction that is free, and the smallest that is occupied.

    Values are as they are logged; exact for integers, rounded to float32 for float32.
    """
    low, high = thresholds.free_at_most, thresholds.occupied_at_least
    top = _TOP.get(quantized.dtype)
    if top is None:
        return float(np.float32(float(low))), float(np.float32(float(high)))
    return math.floor(low * top), math.ceil(high * top)


@lru_cache(maxsize=8)
def _classes_of_levels(dtype: np.dtype[np.unsignedinteger], thresholds: Thresholds) -> Grid:
    """int8[top + 1]: the cell of each level of an integer prediction."""
    levels = np.arange(_TOP[dtype] + 1, dtype=dtype)
    free, occupied = sure_levels(cast("Quantized", levels), thresholds)
    classes = np.full(levels.size, UNKNOWN, np.int8)
    classes[levels >= occupied] = OCCUPIED
    classes[levels <= free] = FREE
    return classes


def raw_classes(quantized: Quantized) -> Grid:
    """int8[H, W]: occupied where p >= .5, else free; nothing is unknown."""
    top = _TOP.get(quantized.dtype)
    half = top // 2 + 1 if top else 0.5
    return np.where(quantized >= half, np.int8(OCCUPIED), np.int8(FREE))


def overlay(observed: Grid, predicted: Grid) -> Grid:
    """int8[H, W]: what was observed, and `predicted` where nothing was."""
    return np.where(observed == UNKNOWN, predicted, observed)


def fuse(observed: Grid, quantized: Quantized | None, thresholds: Thresholds) -> Grid:
    """The fused map: the observed map, completed where the prediction is confident.

    Without a prediction it is the observed map itself.
    """
    if quantized is None:
        return observed
    return overlay(observed, threshold(quantized, thresholds))
