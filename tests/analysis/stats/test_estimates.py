"""Intervals: what they are on data whose truth is known."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pytest
import scipy.stats

from mapreplay.analysis.stats.estimates import (
    NEVER,
    Estimate,
    align,
    average_runs,
    cumulative_incidence,
    differences,
    mean_interval,
    paired_difference,
    paired_reduction,
    pooled_interval,
    proportion,
    reductions,
    restricted,
    restricted_mean,
    restricted_mean_difference,
)

Floats = npt.NDArray[np.float64]


def test_equal_values_give_a_point() -> None:
    estimate = mean_interval([0.25] * 8)
    assert (estimate.mean, estimate.low, estimate.high, estimate.plans) == (0.25, 0.25, 0.25, 8)


def test_one_value_has_no_interval_and_none_has_no_mean() -> None:
    one = mean_interval([0.5])
    assert one.mean == 0.5
    assert math.isnan(one.low)
    assert math.isnan(mean_interval([]).mean)


def test_the_same_values_give_the_same_interval() -> None:
    values = np.random.default_rng(1).normal(size=30).tolist()
    assert mean_interval(values) == mean_interval(values)


def test_the_interval_holds_the_truth_about_as_often_as_it_says() -> None:
    rng = np.random.default_rng(2)
    held = 0
    for _ in range(60):
        estimate = mean_interval(rng.exponential(size=40).tolist())
        held += estimate.low <= 1.0 <= estimate.high
    assert 50 <= held <= 60  # 95 % of 60 is 57


def test_it_is_near_the_textbook_interval_for_normal_data() -> None:
    values = np.random.default_rng(3).normal(5, 2, size=200)
    estimate = mean_interval(values.tolist())
    half = 1.96 * values.std(ddof=1) / math.sqrt(200)
    assert estimate.low == pytest.approx(values.mean() - half, abs=0.03)
    assert estimate.high == pytest.approx(values.mean() + half, abs=0.03)


def test_undefined_values_are_left_out_and_counted() -> None:
    estimate = mean_interval([1.0, math.nan, 1.0])
    assert (estimate.mean, estimate.plans, estimate.undefined) == (1.0, 2, 1)


def test_without_any_difference_the_interval_is_zero() -> None:
    assert paired_difference([3, 4, 5], [3, 4, 5]) == Estimate(0, 0, 0, 3)
    assert paired_reduction([3, 4, 5], [3, 4, 5]) == Estimate(0, 0, 0, 3)


def test_equal_but_for_rounding_is_equal() -> None:
    estimate = mean_interval([0.1 + 0.2, 0.3, 0.3])
    assert estimate.low == estimate.mean == estimate.high


def test_a_reduction_is_that_of_every_pair_and_not_of_the_means() -> None:
    assert reductions([50, 150], [100, 200]).tolist() == [0.5, 0.25]
    assert paired_reduction([50, 150], [100, 200]).mean == 0.375


def test_a_reduction_of_nothing_is_undefined_and_not_zero() -> None:
    estimate = paired_reduction([0, 5, 50], [0, 0, 100])
    assert (estimate.mean, estimate.plans, estimate.undefined) == (0.5, 1, 2)


def test_what_never_happened_twice_differs_by_nothing_known() -> None:
    assert math.isnan(differences([NEVER], [NEVER])[0])
    assert paired_difference([NEVER, 2], [NEVER, 1]).undefined == 1


def test_values_that_are_no_pairs_are_refused() -> None:
    with pytest.raises(ValueError, match="3 and 2 values are not pairs"):
        paired_difference([1, 2, 3], [1, 2])
    with pytest.raises(ValueError, match="negative"):
        paired_reduction([-1], [1])


def test_runs_of_a_plan_are_averaged_first_so_that_each_plan_counts_once() -> None:
    runs = [("a", 10.0), ("a", 20.0), ("a", 30.0), ("b", 100.0)]
    assert average_runs(runs) == {"a": 20.0, "b": 100.0}
    assert math.isnan(average_runs([("a", 1.0), ("a", math.nan)])["a"])


def test_alignment_keeps_the_plans_that_both_have() -> None:
    a, b = align({"x": 1.0, "y": 2.0, "z": 3.0}, {"z": 30.0, "x": 10.0, "w": 0.0})
    assert a.tolist() == [3.0, 1.0]
    assert b.tolist() == [30.0, 10.0]


def test_failures_take_the_whole_budget() -> None:
    assert restricted([10, NEVER, 300], 200).tolist() == [10, 200, 200]
    assert restricted([10, NEVER], [100, 50]).tolist() == [10, 50]
    assert restricted_mean([10, NEVER], 90).mean == 50
    assert restricted_mean_difference([10, NEVER], [30, NEVER], 90).mean == -10
    assert restricted_mean([math.nan, 10], 90).undefined == 1
    with pytest.raises(ValueError, match="positive"):
        restricted([1], 0)


def test_a_proportion_has_wilsons_interval() -> None:
    # 8 of 10 by hand: (p + z2/2n +- z sqrt(p q/n + z2/4n2)) / (1 + z2/n), z = 1.959964
    share = proportion(8, 10)
    assert (share.low, share.high) == pytest.approx((0.49016, 0.94332), abs=1e-5)
    assert proportion(0, 20).low == 0
    assert proportion(0, 20).high == pytest.approx(0.16113, abs=1e-5)
    assert math.isnan(proportion(0, 0).share)
    with pytest.raises(ValueError, match="3 of 2"):
        proportion(3, 2)


def test_cumulative_incidence_is_what_has_arrived() -> None:
    arrived = cumulative_incidence([5, 10, NEVER, 20], at=[4, 5, 12, 1000])
    assert [share.share for share in arrived] == [0, 0.25, 0.5, 0.75]
    with pytest.raises(ValueError, match="cut off"):
        cumulative_incidence([math.nan], at=[1])


def test_a_failure_is_a_competing_event_where_kaplan_meier_promises_too_much() -> None:
    # Half of the agents are sealed in at a random moment, whatever their way would have been.
    rng = np.random.default_rng(4)
    way, sealed = rng.exponential(100, 4000), rng.exponential(100, 4000)
    times = np.where(way <= sealed, way, NEVER)
    (ours,) = cumulative_incidence(times, at=[1e9])
    assert ours.low <= 0.5 <= ours.high
    censored = scipy.stats.CensoredData(uncensored=way[way <= sealed], right=sealed[way > sealed])
    assert scipy.stats.ecdf(censored).cdf.probabilities[-1] > 0.95


def test_pooled_statistics_agree_with_the_mean_they_generalize() -> None:
    values = np.random.default_rng(5).exponential(size=40)
    pooled = pooled_interval(lambda plans: float(values[plans].mean()), len(values), 4_999)
    simple = mean_interval(values)
    assert pooled.mean == simple.mean
    assert (pooled.low, pooled.high) == pytest.approx((simple.low, simple.high), abs=0.02)


def test_pooled_statistics_of_equal_or_too_few_plans() -> None:
    assert pooled_interval(lambda plans: 0.5, 8) == Estimate(0.5, 0.5, 0.5, 8)
    assert math.isnan(pooled_interval(lambda plans: 0.5, 1).low)
    assert math.isnan(pooled_interval(lambda plans: 0.5, 0).mean)
    assert math.isnan(pooled_interval(lambda plans: math.nan, 9).low)


@dataclass(frozen=True, eq=False)
class Simulated:
    """Times on plans of very different size, of a candidate that is 20 % faster in the mean."""

    reference: Floats
    candidate: Floats
    runs: Floats
    """float64[plans, seeds]: runs of the candidate, whose mean it is."""


def simulate(rng: np.random.Generator, plans: int, seeds: int) -> Simulated:
    size = rng.lognormal(5, 0.6, plans)
    candidate = size * 0.8 * rng.lognormal(-0.02, 0.2, plans)  # the factor has the mean 1
    runs = candidate[:, None] * rng.lognormal(-0.045, 0.3, (plans, seeds))  # and this one
    return Simulated(size, candidate, runs)


def coverage_of_nested_seeds(repetitions: int, rng: np.random.Generator) -> float:
    held = 0
    for _ in range(repetitions):
        data = simulate(rng, plans=40, seeds=5)
        estimate = mean_interval(reductions(data.runs.mean(axis=1), data.reference), resamples=999)
        held += estimate.low <= 0.2 <= estimate.high
    return held / repetitions


def test_intervals_cover_with_seeds_nested_in_plans() -> None:
    # 95 % nominal; BCa with 40 plans is known to fall a little short.
    assert 0.90 <= coverage_of_nested_seeds(200, np.random.default_rng(6)) <= 0.98


@pytest.mark.slow
def test_intervals_cover_with_seeds_nested_in_plans_at_large() -> None:
    assert 0.925 <= coverage_of_nested_seeds(3000, np.random.default_rng(7)) <= 0.96


def test_pairs_say_more_than_two_means_do() -> None:
    data = simulate(np.random.default_rng(8), plans=40, seeds=1)
    paired = paired_difference(data.candidate, data.reference)
    a, b = mean_interval(data.candidate), mean_interval(data.reference)
    unpaired = math.hypot(a.high - a.low, b.high - b.low)
    assert paired.high - paired.low < unpaired / 2
    assert paired.high < 0
