"""Shares in words: what is not all or nothing does not look so."""

from __future__ import annotations

import math

import pytest

from mapreplay.analysis.reporting.wording import percent, share, with_interval
from mapreplay.analysis.stats.estimates import Estimate


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (0.471, "47.1 %"),
        (1.0, "100.0 %"),
        (0.9996, ">99.9 %"),
        (1 - 1e-12, ">99.9 %"),
        (0.9994, "99.9 %"),
        (0.0, "0.0 %"),
        (0.0004, "<0.1 %"),
        (-0.0004, ">-0.1 %"),
        (0.0005, "0.1 %"),
        (-0.25, "-25.0 %"),
        (math.nan, "-"),
    ],
)
def test_a_share(value: float, words: str) -> None:
    assert share(value) == words


def test_an_estimate_has_its_interval_in_parentheses_if_there_is_one() -> None:
    saved, one = Estimate(0.471, 0.328, 0.538, 9), Estimate(0.471, math.nan, math.nan, 1)
    none = Estimate(math.nan, math.nan, math.nan, 0)
    assert percent(saved) == "47.1 % (32.8 to 53.8 %)"
    assert [with_interval(e, 2) for e in (saved, one, none)] == [
        "0.47 (0.33 to 0.54)", "0.47", "-",
    ]  # fmt: skip
    assert with_interval(saved, 0, 100) == "47 (33 to 54)"
