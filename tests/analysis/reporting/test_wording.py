"""Numbers as a person would write them."""

import math

import pytest

from mapreplay.analysis.experiment.markdown import saved
from mapreplay.analysis.reporting.wording import change, p_number, p_value, reduction
from mapreplay.analysis.stats.estimates import Estimate


@pytest.mark.parametrize(
    ("p", "said"),
    [
        (0.0, "p < 0.001"), (0.0009, "p < 0.001"), (0.001, "p = 0.001"), (0.03125, "p = 0.031"),
        (0.5, "p = 0.5"), (0.999, "p > 0.99"), (1.0, "p = 1"), (math.nan, "p -"),
    ],
)  # fmt: skip
def test_no_p_value_is_nought(p: float, said: str) -> None:
    assert p_value(p) == said
    assert p_number(p) == said.removeprefix("p ").removeprefix("= ")


@pytest.mark.parametrize(
    ("mean", "low", "high", "said"),
    [
        (0.471, 0.328, 0.538, "reduced by 47.1 % (32.8 to 53.8 %)"),
        (0.05, -0.03, 0.121, "reduced by 5.0 % (3.0 % longer to 12.1 % less)"),
        (-0.074, -0.113, -0.02, "7.4 % longer (2.0 to 11.3 %)"),
        (-0.074, -0.3, 0.02, "7.4 % longer (30.0 % longer to 2.0 % less)"),
        (-63.37, -96.0, -30.0, "64 times as long (31 times to 97 times)"),
        (-1.5, -3.0, -0.5, "2.5 times as long (4.0 times as long to 50.0 % longer)"),
        (0.12, -63.37, 0.4, "reduced by 12.0 % (64 times as long to 40.0 % less)"),
        (0.0, 0.0, 0.0, "reduced by 0.0 % (0.0 to 0.0 %)"),
        (-63.37, math.nan, math.nan, "64 times as long"),
        (math.nan, math.nan, math.nan, "not comparable"),
    ],
)
def test_a_time_is_reduced_longer_or_a_multiple(
    mean: float, low: float, high: float, said: str
) -> None:
    assert reduction(Estimate(mean, low, high, 9)) == said


def test_one_reduction() -> None:
    assert [change(r) for r in (0.4, 0.0, -0.074, -1.0, -63.37, math.nan)] == [
        "40.0 % less", "0.0 % less", "7.4 % longer", "100.0 % longer", "64 times as long", "-",
    ]  # fmt: skip


def test_a_cell_of_an_experiments_table() -> None:
    assert saved(Estimate(0.471, 0.328, 0.538, 9)) == "47.1 [32.8, 53.8]"
    assert saved(Estimate(-63.37, -96, -30, 9)) == "64 times as long [31, 97]"
    assert saved(Estimate(-63.37, math.nan, math.nan, 1)) == "64 times as long"
    assert saved(Estimate(math.nan, math.nan, math.nan, 0)) == "-"
