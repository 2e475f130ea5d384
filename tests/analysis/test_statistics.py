"""Intervals: what they are on data whose truth is known."""

import math

import numpy as np
import pytest

from mapreplay.analysis.statistics import mean_interval


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
