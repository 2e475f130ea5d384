"""Scores of a map against the truth: precision, recall, F1, IoU, coverage, calibration.

The occupied class is the positive one (paper, section "Evaluation Index"). What is
undefined, such as the precision of a map without a single occupied cell, is NaN, never 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from mapreplay import kernels
from mapreplay.grid import Grid, Mask

Counts: TypeAlias = npt.NDArray[np.int64]
"""int64[3, 3]: cells where the map says [unknown, free, occupied] and the truth [the same]."""


class UnknownAs(StrEnum):
    """What a cell that the map does not know counts as."""

    FREE = "free"
    OCCUPIED = "occupied"
    IGNORED = "ignored"


@dataclass(frozen=True)
class MapScore:
    """Of the occupied class; each in [0, 1], or NaN where it is undefined."""

    precision: float
    recall: float
    f1: float
    iou: float


@dataclass(frozen=True)
class Coverage:
    """Shares of the explorable cells, each in [0, 1]."""

    known: float
    correct: float
    """Known and right."""


@dataclass(frozen=True)
class Calibration:
    """Of P(occupied); NaN where no cell counts."""

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
    """Known, and known and right, among all cells counted (the explorable ones)."""
    total = int(counts.sum())
    known = int(counts[1:].sum())
    right = int(counts[1, 1] + counts[2, 2])
    return Coverage(_ratio(known, total), _ratio(right, total))


def calibration(
    p_wall: npt.NDArray[np.floating], truth: Grid, region: Mask, quantum: float
) -> Calibration:
    """Brier score and log loss of `p_wall` (float[H, W] in [0, 1]) on the cells of `region`.

    `quantum` is the step between two probabilities as logged; the log loss clips to half of
    it, so that a certain error costs much and not everything.
    """
    p = p_wall[region].astype(np.float64)
    if p.size == 0:
        return Calibration(float("nan"), float("nan"))
    wall = truth[region] > 0
    said = np.clip(np.where(wall, p, 1 - p), quantum / 2, 1 - quantum / 2)
    return Calibration(float(np.mean((p - wall) ** 2)), float(-np.mean(np.log(said))))


def _ratio(part: int, whole: int) -> float:
    return part / whole if whole else float("nan")
