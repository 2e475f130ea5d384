"""Curves that a reader can draw: their area, and when they passed a milestone."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapreplay.analysis.episodes.curves import area, extended, first_reached, mapping_time

CURVE = np.array([0.0, 0.5, 0.5, 1.0])


def test_a_milestone_is_reached_at_the_first_step_that_is_there() -> None:
    assert first_reached(CURVE, 0.5) == 1
    assert first_reached(CURVE, 0.51) == 3
    assert first_reached(CURVE[:3], 1.0) is None
    assert first_reached(np.array([np.nan, 0.9]), 0.9) == 1


def test_the_mapping_time_is_by_the_coverage_and_without_a_truth_by_what_the_episode_says() -> None:
    unknown = np.full(5, np.nan)
    assert mapping_time(CURVE, 0.5, "out_of_steps") == 1
    assert mapping_time(CURVE[:3], 0.9, "mapped") is None
    assert mapping_time(unknown, 0.9, "mapped") == 4
    assert mapping_time(unknown, 0.9, "unfinished") is None
    assert mapping_time(np.empty(0), 0.9, "unfinished") is None


def test_the_area_is_the_mean_over_the_budget_with_the_last_value_held() -> None:
    assert area(CURVE, 3) == 2.0 / 4
    assert area(CURVE, 7) == (2.0 + 4 * 1.0) / 8
    assert area(CURVE, 1) == 0.5 / 2  # what comes after the budget does not count
    assert math.isnan(area(np.empty(0), 5))


def test_who_is_sealed_in_early_has_less_area_than_who_goes_on() -> None:
    going_on = np.array([0.2, 0.4, 0.6, 0.8])
    assert area(going_on[:2], 10) < area(going_on, 10)


@given(st.lists(st.floats(0, 1), min_size=1, max_size=20), st.integers(0, 30))
def test_the_area_is_that_of_the_extended_curve(values: list[float], budget: int) -> None:
    curve = np.array(values)
    assert area(curve, budget) == pytest.approx(extended(curve, budget).mean())
    assert len(extended(curve, budget)) == budget + 1


def test_no_curve_can_be_extended_from_nothing() -> None:
    with pytest.raises(ValueError, match="a curve of 0 steps"):
        extended(np.empty(0), 3)
