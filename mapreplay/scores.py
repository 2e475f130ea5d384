"""Scores of a map against the truth: precision, recall, F1, IoU, coverage, calibration.

The occupied class is the positive one (paper, section "Evaluation Index"). What is
undefined, such as the precision of a map without a single occupied cell, is NaN, never 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from mapreplay import kernels, mapping
from mapreplay.grid import Grid, Mask, Quantized

Counts: TypeAlias = npt.NDArray[np.int64]
"""int64[3, 3]: cells where the map says [unknown, free, occupied] and the truth [the same]."""


Reals: TypeAlias = npt.NDArray[np.float64]


class UnknownAs(StrEnum):
    """How unknown cells of the map are counted."""

    FREE = "free"
    OCCUPIED = "occupied"
    IGNORED = "ignored"


@dataclass(frozen=True)
class MapScore:
    """Scores of the occupied class; each in [0, 1], or NaN where undefined."""

    precision: float
    recall: float
    f1: float
    iou: float


@dataclass(frozen=True)
class Coverage:
    """Shares of the explorable cells, each in [0, 1]."""

    known: float
    correct: float
    """Known and correct."""


@dataclass(frozen=True)
class PredictionScore:
    """Scores of P(occupied); NaN if no cell is scored."""

    brier: float
    """Mean squared error of the probability, in [0, 1]."""
    log_loss: float
    """Mean -log of the probability given to the truth, nats."""


def tally(cells: Grid, truth: Grid, region: Mask) -> Counts:
    """Count the cells of `region` (bool[H, W]) by what the map says and what is true."""
    counts = np.empty((3, 3), np.int64)
    kernels.tally(cells, truth, region, counts)
    return counts


def score(counts: Counts, unknown_as: UnknownAs = UnknownAs.FREE) -> MapScore:
    """Precision, recall, F1 (paper, eq. f_score) and IoU of the occupied class.

    A cell whose truth is unknown never counts. By default an unknown cell of the map counts
    as not occupied: the paper's baseline is the observations themselves.
    """
    unknown, free, occupied = counts.tolist()
    true_positive, false_positive = occupied[2], occupied[1]
    false_negative = free[2]
    if unknown_as is UnknownAs.FREE:
        false_negative += unknown[2]
    elif unknown_as is UnknownAs.OCCUPIED:
        true_positive += unknown[2]
        false_positive += unknown[1]
    claimed = true_positive + false_positive
    actual = true_positive + false_negative
    return MapScore(
        precision=_ratio(true_positive, claimed),
        recall=_ratio(true_positive, actual),
        f1=_ratio(2 * true_positive, claimed + actual),
        iou=_ratio(true_positive, claimed + false_negative),
    )


def coverage(counts: Counts) -> Coverage:
    """Shares of known cells, and of known and correct cells, among all explorable cells."""
    total = int(counts.sum())
    known = int(counts[1:].sum())
    right = int(counts[1, 1] + counts[2, 2])
    return Coverage(_ratio(known, total), _ratio(right, total))


def calibration(p_wall: Quantized, truth: Grid, region: Mask) -> PredictionScore:
    """Brier score and log loss of `p_wall` (as it is logged, [H, W]) on the cells of `region`.

    The log loss clips to half of the step between two probabilities as logged, so that the
    loss of a certain error is large but finite.
    """
    if p_wall.dtype == np.float32:
        levels, wall = p_wall[region], truth[region] > 0
        errors, losses = _penalties(levels, wall)
    else:
        codes = np.empty(p_wall.size, np.int32)
        count = kernels.gather_levels(p_wall, truth, region, codes)
        of_error, of_loss = _penalties_of_levels(p_wall.dtype)
        errors, losses = of_error.take(codes[:count]), of_loss.take(codes[:count])
    if errors.size == 0:
        return PredictionScore(float("nan"), float("nan"))
    return PredictionScore(float(np.mean(errors)), float(np.mean(losses)))


def _penalties(levels: Quantized, wall: Mask) -> tuple[Reals, Reals]:
    """Squared error and -log of the probability of the truth, for each cell."""
    p, half = mapping.dequantize(levels), mapping.quantum(levels) / 2
    said = np.clip(np.where(wall, p, 1 - p), half, 1 - half)
    return (p - wall) ** 2, -np.log(said)


@lru_cache(maxsize=2)
def _penalties_of_levels(dtype: np.dtype[np.unsignedinteger]) -> tuple[Reals, Reals]:
    """The same of level k of an integer prediction: at 2 k for a free cell, 2 k + 1 for a wall."""
    codes = np.arange(2 * (np.iinfo(dtype).max + 1))
    return _penalties((codes // 2).astype(dtype), codes % 2 == 1)


def _ratio(part: int, whole: int) -> float:
    return part / whole if whole else float("nan")
