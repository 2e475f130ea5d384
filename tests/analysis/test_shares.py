"""Shares in words: what is not all or nothing does not look so."""

from __future__ import annotations

import math

import pytest

from mapreplay.analysis.reporting.wording import share


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
