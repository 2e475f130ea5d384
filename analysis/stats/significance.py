"""Tests of significance on paired values, one pair per floor plan.

Sign-flips are counted here and not by scipy: its ``permutation_test`` gives the same exact p (a
test compares them) in 5 to 12 times the time, its ``wilcoxon`` with a ``PermutationMethod`` in a
thousand times (13 floor plans: 1 against 1,200 ms).

All are two-sided. The smallest p depends on the number of floor plans that differ: with five, no
p-value is below .0625. So every result has the smallest p that was possible.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy import stats

from mapreplay.analysis.stats.estimates import Values

EXACT: Final = 13
"""Floor plans up to which all assignments of signs are enumerated."""
PERMUTATIONS: Final = 9_999
"""Drawn where there are more."""


@dataclass(frozen=True)
class TestResult:
    """The result of a test: how likely an effect of this size would be by chance."""

    __test__ = False  # for pytest: not a test case

    name: str
    statistic: float
    p: float
    """NaN where there is nothing to test; 1 where nothing differs."""
    plans: int
    """Floor plans with a defined difference."""
    smallest_p: float
    """The smallest p possible with the number of floor plans that differ."""


def smallest_p(differing: int) -> float:
    """The smallest two-sided p of a signed-rank, sign-flip or McNemar test: 2 / 2^n."""
    return min(1.0, 2.0 ** (1 - differing))


def signed_rank(differences: Values) -> TestResult:
    """Wilcoxon's signed-rank test of paired differences, zeros after Pratt (1959).

    Exact for up to 13 floor plans, and up to 50 if there are no ties or zeros; normal
    approximation otherwise. NaN differences are left out.
    """
    name, data = "Wilcoxon signed-rank (Pratt)", _defined(differences)
    if data.size == 0 or not data.any():
        return _nothing(name, data.size)
    if data.size > EXACT:
        result = stats.wilcoxon(data, zero_method="pratt")
        statistic, p = float(result.statistic), float(result.pvalue)
    else:
        ranks = np.where(data != 0, stats.rankdata(np.abs(data)), 0)
        positive = float(ranks[data > 0].sum())
        statistic = min(positive, float(ranks.sum()) - positive)
        p = _two_sided(_signs(data.size) @ ranks, float(np.sign(data) @ ranks))
    return TestResult(name, statistic, p, data.size, _smallest(data))


def sign_flip(differences: Values) -> TestResult:
    """Permutation test of the mean difference: the signs of the differences are exchangeable.

    Exact for up to 13 floor plans; else 9,999 seeded draws, so that the same differences give
    the same p, and none is below 1 / 10,000. NaN differences are left out.
    """
    name, data = "sign-flip permutation", _defined(differences)
    if data.size == 0 or not data.any():
        return _nothing(name, data.size)
    signs = _signs(data.size)
    p = _two_sided(signs @ np.abs(data), float(data.sum()))
    floor = 0.0 if data.size <= EXACT else 1 / len(signs)
    return TestResult(name, float(data.mean()), p, data.size, max(_smallest(data), floor))


@dataclass(frozen=True)
class McNemar:
    """Two paired yes-or-no outcomes on the same floor plans, and McNemar's exact test."""

    both: int
    only_candidate: int
    only_reference: int
    neither: int
    p: float
    smallest_p: float
    """The smallest p possible with the number of floor plans on which the two differ."""


def mcnemar(candidate: Sequence[bool], reference: Sequence[bool]) -> McNemar:
    """Whether one succeeds more often than the other: an exact binomial test of the floor
    plans on which only one of them does.

    Raises:
        ValueError: they are not of the same floor plans (other lengths).
    """
    a, b = np.asarray(candidate, np.bool_), np.asarray(reference, np.bool_)
    if a.shape != b.shape:
        raise ValueError(f"{a.size} and {b.size} outcomes are not pairs")
    only_a, only_b = int((a & ~b).sum()), int((b & ~a).sum())
    differing = only_a + only_b
    p = float(stats.binomtest(only_a, differing).pvalue) if differing else 1.0
    if a.size == 0:
        p = math.nan
    return McNemar(
        int((a & b).sum()), only_a, only_b, int((~a & ~b).sum()), p, smallest_p(differing)
    )


def friedman(values: Sequence[Values]) -> TestResult:
    """Friedman's test: whether three or more candidates (rows) rank alike on the same floor
    plans (columns). Chi-square approximation. Floor plans with an undefined value are left out.

    Raises:
        ValueError: fewer than three candidates, or other lengths.
    """
    name, table = "Friedman", np.asarray(values, np.float64)
    if table.ndim != 2 or table.shape[0] < 3:
        raise ValueError("three or more candidates with a value for each floor plan are needed")
    table = table[:, ~np.isnan(table).any(axis=0)]
    candidates, plans = table.shape
    if plans < 2 or (np.ptp(table, axis=0) == 0).all():
        return _nothing(name, plans if plans >= 2 else 0)
    result = stats.friedmanchisquare(*table)
    best = stats.chi2.sf(plans * (candidates - 1), candidates - 1)
    return TestResult(name, float(result.statistic), float(result.pvalue), plans, float(best))


def holm(p_values: Sequence[float]) -> list[float]:
    """p-values corrected for their number after Holm (1979), in the same order.

    NaN (nothing to test) stays NaN and does not count as a test.
    """
    p = np.asarray(p_values, np.float64)
    order = [i for i in np.argsort(p, kind="stable") if not math.isnan(p[i])]
    corrected = np.full(p.shape, math.nan)
    worst = 0.0
    for rank, i in enumerate(order):
        worst = max(worst, min(1.0, (len(order) - rank) * float(p[i])))
        corrected[i] = worst
    return [float(value) for value in corrected]


def _signs(count: int) -> npt.NDArray[np.float64]:
    """float64[n, count] of -1 and 1: all assignments of signs, or seeded draws after a row of 1,
    which stands for what was observed.
    """
    if count <= EXACT:
        bits = np.arange(2**count)[:, None] >> np.arange(count) & 1
    else:
        bits = np.random.default_rng(0).integers(0, 2, (PERMUTATIONS + 1, count))
        bits[0] = 1
    return (2 * bits - 1).astype(np.float64)


def _two_sided(null: npt.NDArray[np.float64], observed: float) -> float:
    """Share of `null`, which is symmetric about 0, that is at least as extreme, on both sides."""
    slack = 1e-9 * max(
        float(np.abs(null).max()), 1e-300
    )  # the order of summation changes the last digits
    return min(1.0, float((np.abs(null) >= abs(observed) - slack).mean()))


def _defined(differences: Values) -> npt.NDArray[np.float64]:
    data = np.asarray(differences, np.float64)
    return data[~np.isnan(data)]


def _smallest(data: npt.NDArray[np.float64]) -> float:
    return smallest_p(int(np.count_nonzero(data)))


def _nothing(name: str, plans: int) -> TestResult:
    """The result for no floor plans, or for floor plans that do not differ."""
    return TestResult(name, math.nan, 1.0 if plans else math.nan, plans, 1.0)
