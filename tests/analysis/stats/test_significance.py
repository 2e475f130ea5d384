"""Tests of significance: against hand-counted cases, and their level on data without an effect."""

import math
from collections.abc import Callable

import numpy as np
import pytest
import scipy.stats

from mapreplay.analysis.stats.significance import (
    TestResult,
    friedman,
    holm,
    mcnemar,
    sign_flip,
    signed_rank,
    smallest_p,
)

PAIRED = [signed_rank, sign_flip]


@pytest.mark.parametrize("test", PAIRED)
def test_five_plans_cannot_say_more_than_a_sixteenth(test: Callable[..., TestResult]) -> None:
    result = test([1, 2, 3, 4, 5])  # all signs agree: 2 of 32 assignments are as extreme
    assert result.p == result.smallest_p == smallest_p(5) == 0.0625


@pytest.mark.parametrize("test", PAIRED)
def test_nothing_differs(test: Callable[..., TestResult]) -> None:
    assert test([0.0, 0.0]).p == 1
    assert math.isnan(test([]).p)
    assert math.isnan(test([math.nan]).p)


@pytest.mark.parametrize("test", PAIRED)
def test_undefined_differences_are_left_out(test: Callable[..., TestResult]) -> None:
    assert test([1, 2, math.nan, 3, 4, 5]) == test([1, 2, 3, 4, 5])


def test_signed_ranks_by_hand() -> None:
    # W+ = 1 + 2 + 3 = 6. Of the 16 subsets of {1, 2, 3, 4}, the sums 6, 6, 7, 7, 8, 9 and 10 are
    # as large; two-sided 14 of 16.
    assert signed_rank([1, 2, 3, -4]).p == pytest.approx(14 / 16)


def test_zeros_keep_their_ranks_after_pratt() -> None:
    # |d| = 0, 1, 2 ranks 1, 2, 3; the zero's rank is dropped, the others stay 2 and 3: of the
    # four signs W+ is 0, 2, 3 or 5, so that two positive differences give p = 2 / 4.
    result = signed_rank([0, 1, 2])
    assert result.p == pytest.approx(0.5)
    assert result.smallest_p == 0.5


def test_scipys_exact_test_says_the_same() -> None:
    for size in (6, 13):
        data = np.random.default_rng(size).normal(0.4, 1, size)
        oracle = scipy.stats.wilcoxon(data, method="exact")
        ours = signed_rank(data)
        assert (ours.p, ours.statistic) == pytest.approx((oracle.pvalue, oracle.statistic))


def test_sign_flips_by_hand() -> None:
    # +-1 +-2 +-6 is -9, -7, -5, -3, 3, 5, 7 or 9: two of eight are 7 or more; two-sided four.
    assert sign_flip([-1, 2, 6]).p == pytest.approx(0.5)


def test_scipys_permutation_test_says_the_same_of_sign_flips() -> None:
    for size in (3, 8, 12):
        data = np.random.default_rng(size).normal(0.3, 1, size).round(1)
        oracle = scipy.stats.permutation_test(
            (data,), lambda x, axis: np.mean(x, axis=axis), permutation_type="samples",
            vectorized=True, n_resamples=np.inf,
        )  # fmt: skip
        assert sign_flip(data).p == pytest.approx(oracle.pvalue)


def test_the_same_differences_give_the_same_p() -> None:
    data = np.random.default_rng(1).normal(0.2, 1, 60)
    assert sign_flip(data) == sign_flip(data)
    assert sign_flip(np.ones(60)).p == sign_flip(np.ones(60)).smallest_p == 1 / 10_000


def test_mcnemar_by_hand() -> None:
    # They differ on six plans, five to one: p = 2 (1 + 6) / 64.
    candidate = [True] * 5 + [False] + [True] * 3 + [False] * 2
    reference = [False] * 5 + [True] + [True] * 3 + [False] * 2
    result = mcnemar(candidate, reference)
    counts = (result.both, result.only_candidate, result.only_reference, result.neither)
    assert counts == (3, 5, 1, 2)
    assert result.p == pytest.approx(14 / 64)
    assert result.smallest_p == 2 / 64


def test_mcnemar_without_a_difference_or_a_plan() -> None:
    assert mcnemar([True, False], [True, False]).p == 1
    assert math.isnan(mcnemar([], []).p)
    with pytest.raises(ValueError, match="1 and 2 outcomes"):
        mcnemar([True], [True, False])


def test_friedman_by_hand() -> None:
    # Three candidates, four plans, always in the same order: rank sums 4, 8, 12;
    # 12 / (4 * 3 * 4) * (16 + 64 + 144) - 3 * 4 * 4 = 8, p = exp(-4) for two degrees of freedom.
    result = friedman([[1, 2, 3, 4], [2, 3, 4, 5], [9, 9, 9, 9]])
    assert result.statistic == pytest.approx(8)
    assert result.p == result.smallest_p == pytest.approx(math.exp(-4))


def test_friedman_leaves_out_what_is_undefined_and_refuses_two() -> None:
    assert friedman([[1, math.nan, 3], [2, 3, 4], [3, 4, 5]]).plans == 2
    assert friedman([[1, 1], [1, 1], [1, 1]]).p == 1
    with pytest.raises(ValueError, match="three or more"):
        friedman([[1, 2], [1, 2]])


def test_holm_by_hand() -> None:
    # Sorted .01 .02 .03 .04 times 4 3 2 1 = .04 .06 .06 .04, never falling: .04 .06 .06 .06.
    assert holm([0.04, 0.01, 0.03, 0.02]) == pytest.approx([0.06, 0.04, 0.06, 0.06])
    assert holm([0.5, 0.9]) == [1.0, 1.0]


def test_holm_does_not_count_what_was_not_tested() -> None:
    corrected = holm([0.01, math.nan, 0.02])
    assert corrected[0] == pytest.approx(0.02)
    assert math.isnan(corrected[1])
    assert holm([]) == []


def level(test: Callable[..., TestResult], repetitions: int, rng: np.random.Generator) -> float:
    """How often the test finds an effect at 5 % where there is none; zeros and ties included."""
    found = 0
    for _ in range(repetitions):
        data = np.rint(rng.standard_t(3, size=12) * 3)
        found += test(data).p <= 0.05
    return found / repetitions


@pytest.mark.parametrize("test", PAIRED)
def test_tests_keep_their_level(test: Callable[..., TestResult]) -> None:
    # 150 tests at .05: more than 15 false alarms would happen once in 200 such runs.
    assert level(test, 150, np.random.default_rng(2)) <= 0.1


@pytest.mark.slow
@pytest.mark.parametrize("test", PAIRED)
def test_tests_keep_their_level_at_large(test: Callable[..., TestResult]) -> None:
    assert 0.035 <= level(test, 3000, np.random.default_rng(3)) <= 0.06


@pytest.mark.parametrize("test", PAIRED)
def test_tests_find_an_effect_that_is_there(test: Callable[..., TestResult]) -> None:
    rng = np.random.default_rng(4)
    assert sum(test(rng.normal(0.8, 1, 30)).p <= 0.05 for _ in range(30)) >= 28
