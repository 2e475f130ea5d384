"""Calibration of P(occupied): reliability, ECE, Brier score, log loss, AUROC.

Everything comes from one small table of counts: how many cells had each level of p_wall, free
and occupied, at each distance from what was observed. Counts of steps, episodes and floor plans
are added (`+`), so a thousand episodes need no more memory than one, and of an 8-bit prediction
all scores are exact.
Count only cells that were unobserved when they were predicted: the others are known.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Final

import numpy as np
import numpy.typing as npt

from mapreplay.analysis.metrics import kernels
from mapreplay.analysis.stats.estimates import Estimate, pooled_interval
from mapreplay.grid import Grid, Mask, Quantized
from mapreplay.mapping import Thresholds, dequantize

DISTANCES: Final = (1, 2, 4, 8, 16)
"""Last distance (cells) of each group but the last one: 1, 2, 3-4, 5-8, 9-16, beyond 16."""
BINS: Final = 10
LEVELS: Final = 256
"""Of an 8-bit prediction; finer ones are rounded to `FINE_LEVELS`."""
FINE_LEVELS: Final = 4096


@dataclass(frozen=True, eq=False)
class PredictionCounts:
    """Cells by distance group, truth and level of the prediction; add them with ``+``."""

    cells: npt.NDArray[np.int64]
    """int64[groups, 2, levels]; truth 0 is free and 1 occupied; level k is p = k / (levels - 1)."""
    distances: tuple[int, ...]
    """Last distance of each group but the last, in cells, chessboard."""

    def __add__(self, other: PredictionCounts) -> PredictionCounts:
        if self.distances != other.distances or self.cells.shape != other.cells.shape:
            raise ValueError("counts of other distance groups or levels cannot be added")
        return PredictionCounts(self.cells + other.cells, self.distances)

    @property
    def p_wall(self) -> npt.NDArray[np.float64]:
        """float64[levels], the probability of each level."""
        levels = self.cells.shape[2]
        return np.linspace(0, 1, levels)

    @property
    def total(self) -> npt.NDArray[np.int64]:
        """int64[2, levels], over all distances."""
        return np.asarray(self.cells.sum(axis=0), np.int64)

    def group(self, number: int) -> PredictionCounts:
        """Those of one distance group."""
        alone = np.zeros_like(self.cells)
        alone[number] = self.cells[number]
        return PredictionCounts(alone, self.distances)

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the groups: "1", "2", "3-4", ..., ">16"."""
        first = 1
        names = []
        for last in self.distances:
            names.append(str(last) if first == last else f"{first}-{last}")
            first = last + 1
        return (*names, f">{first - 1}")


def distance_from_observed(observed: Grid) -> npt.NDArray[np.int32]:
    """int32[H, W]: chessboard distance of each cell to the nearest observed one, in cells.

    0 for observed cells; the larger side of the map where nothing was observed.
    """
    distance = np.empty(observed.shape, np.int32)
    kernels.chessboard_distance(observed, distance)
    return distance


def count_cells(
    p_wall: Quantized,
    truth: Grid,
    observed: Grid,
    region: Mask,
    distances: tuple[int, ...] = DISTANCES,
) -> PredictionCounts:
    """Count the unobserved cells of `region` (bool[H, W]; the explorable ones) of one step.

    All are [H, W]. Cells whose truth is unknown do not count.
    """
    level = p_wall
    if p_wall.dtype != np.uint8:
        level = np.rint(dequantize(p_wall) * (FINE_LEVELS - 1)).astype(np.uint16)
    levels = LEVELS if p_wall.dtype == np.uint8 else FINE_LEVELS
    group_of = np.searchsorted(distances, np.arange(max(observed.shape) + 1))
    cells = np.zeros((len(distances) + 1, 2, levels), np.int64)
    distance = distance_from_observed(observed)
    kernels.count_levels(level, truth, observed, region, distance, group_of, cells)
    return PredictionCounts(cells, distances)


def no_cells(levels: int = LEVELS, distances: tuple[int, ...] = DISTANCES) -> PredictionCounts:
    """Counts of nothing, to add to."""
    return PredictionCounts(np.zeros((len(distances) + 1, 2, levels), np.int64), distances)


@dataclass(frozen=True)
class Bin:
    """The predictions in one interval of [0, 1), closed at its lower end."""

    low: float
    high: float
    cells: int
    mean_p: float
    """Mean prediction; NaN in an empty bin, like the next."""
    wall_share: float
    """Share of the cells that are occupied."""


def reliability(counts: PredictionCounts, bins: int = BINS) -> tuple[Bin, ...]:
    """The reliability diagram: `bins` intervals of equal width; only the last includes its end."""
    free, occupied = counts.total
    both = free + occupied
    levels = both.size
    place = np.minimum(np.arange(levels) * bins // (levels - 1), bins - 1)
    cells = np.bincount(place, both, bins)
    walls = np.bincount(place, occupied, bins)
    p_sum = np.bincount(place, both * counts.p_wall, bins)
    return tuple(
        Bin(i / bins, (i + 1) / bins, int(n), _ratio(p, n), _ratio(w, n))
        for i, (n, p, w) in enumerate(zip(cells, p_sum, walls, strict=True))
    )


@dataclass(frozen=True)
class CalibrationScores:
    """Of P(occupied) on some cells; NaN where undefined."""

    cells: int
    wall_share: float
    mean_p: float
    ece: float
    """Expected calibration error: mean |mean prediction - wall share| of ten bins of P(wall) of
    equal width, [0, .1) to [.9, 1], weighted by their cells (Naeini et al. 2015)."""
    brier: float
    log_loss: float
    """Nats; probabilities are clipped at half a level, so that being certain and wrong
    costs much, but not infinitely much."""
    auroc: float
    """Probability that a wall got a higher p_wall than a free cell, ties counting half."""


@dataclass(frozen=True, eq=False)
class ScoreColumns:
    """The fields of `CalibrationScores`, each as an array of one value for each set of cells."""

    cells: npt.NDArray[np.int64]
    wall_share: npt.NDArray[np.float64]
    mean_p: npt.NDArray[np.float64]
    ece: npt.NDArray[np.float64]
    brier: npt.NDArray[np.float64]
    log_loss: npt.NDArray[np.float64]
    auroc: npt.NDArray[np.float64]


def score_columns(counts: npt.NDArray[np.int64]) -> ScoreColumns:
    """All scores of many sets of cells at once: int64[..., 2, levels], see `PredictionCounts`."""
    free, occupied = counts[..., 0, :].astype(np.float64), counts[..., 1, :].astype(np.float64)
    both, levels = free + occupied, counts.shape[-1]
    p = np.arange(levels) / (levels - 1)
    half = 0.5 / (levels - 1)
    clipped = np.clip(p, half, 1 - half)
    starts = np.ceil(np.arange(BINS) * (levels - 1) / BINS).astype(np.intp)
    gap = np.add.reduceat(both * p, starts, axis=-1) - np.add.reduceat(occupied, starts, axis=-1)
    cells, walls = both.sum(axis=-1), occupied.sum(axis=-1)
    ranks = (occupied * (np.cumsum(free, axis=-1) - free / 2)).sum(axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return ScoreColumns(
            cells=cells.astype(np.int64),
            wall_share=walls / cells,
            mean_p=both @ p / cells,
            ece=np.abs(gap).sum(axis=-1) / cells,
            brier=(free @ p**2 + occupied @ (1 - p) ** 2) / cells,
            log_loss=-(free @ np.log1p(-clipped) + occupied @ np.log(clipped)) / cells,
            auroc=ranks / (walls * (cells - walls)),
        )


def calibration_scores(counts: PredictionCounts) -> CalibrationScores:
    """All scores of the counted cells together."""
    columns = score_columns(counts.total)
    return CalibrationScores(**{f.name: getattr(columns, f.name).item() for f in fields(columns)})


@dataclass(frozen=True)
class Decided:
    """How many of the counted cells the thresholds decide."""

    cells: int
    free: int
    """Decided free."""
    free_wrong: int
    """Of these, walls."""
    occupied: int
    """Decided occupied."""
    occupied_wrong: int
    """Of these, free."""

    @property
    def share(self) -> float:
        """Of the cells, those that are not left unknown."""
        return _ratio(self.free + self.occupied, self.cells)

    @property
    def right(self) -> float:
        """Of the cells, those that are decided and right."""
        wrong = self.free_wrong + self.occupied_wrong
        return _ratio(self.free + self.occupied - wrong, self.cells)


def decided(counts: PredictionCounts, thresholds: Thresholds) -> Decided:
    """How many of the counted cells the thresholds decide, and how many of them wrongly."""
    levels = counts.cells.shape[2]
    last_free = math.floor(thresholds.free_at_most * (levels - 1))
    first_occupied = max(math.ceil(thresholds.occupied_at_least * (levels - 1)), last_free + 1)
    free, occupied = counts.total
    below, above = slice(None, last_free + 1), slice(first_occupied, None)
    return Decided(
        cells=int(counts.total.sum()),
        free=int(free[below].sum() + occupied[below].sum()),
        free_wrong=int(occupied[below].sum()),
        occupied=int(free[above].sum() + occupied[above].sum()),
        occupied_wrong=int(free[above].sum()),
    )


def score_interval(
    plans: Sequence[PredictionCounts], score: Callable[[PredictionCounts], float]
) -> Estimate:
    """A score of all cells pooled, such as ``lambda c: calibration_scores(c).ece``, with a
    bootstrap interval over floor plans; `plans` has the counts of each.
    """
    if not plans:
        return pooled_interval(lambda _: math.nan, 0)
    table = np.stack([counts.cells for counts in plans])
    distances = plans[0].distances

    def pooled(numbers: npt.NDArray[np.intp]) -> float:
        weights = np.bincount(numbers, minlength=len(table))
        return score(PredictionCounts(np.tensordot(weights, table, axes=1), distances))

    return pooled_interval(pooled, len(plans))


def _ratio(part: float, whole: float) -> float:
    return float(part / whole) if whole else math.nan
