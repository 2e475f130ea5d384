"""Scores on maps whose counts a reader can check."""

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drawing import draw
from mapreplay.floorplan import explorable
from mapreplay.grid import Cell
from mapreplay.mapping import PredictionDtype, dequantize, quantize, quantum
from mapreplay.scores import Coverage, MapScore, UnknownAs, calibration, coverage, score, tally

TRUTH = draw("""
    ####
    #..#
    ####
""")
SAID = draw("""
    ##??
    #.#.
    ####
""")
EVERYWHERE = np.ones(TRUTH.shape, np.bool_)


def test_counts_are_by_what_is_said_and_what_is_true() -> None:
    #                  truth: unknown, free, occupied
    assert tally(SAID, TRUTH, EVERYWHERE).tolist() == [
        [0, 0, 2],  # said unknown
        [0, 1, 1],  # said free
        [0, 1, 7],  # said occupied
    ]


@pytest.mark.parametrize(
    ("unknown_as", "true_positive", "false_positive", "false_negative"),
    [
        (UnknownAs.FREE, 7, 1, 3),
        (UnknownAs.OCCUPIED, 9, 1, 1),
        (UnknownAs.IGNORED, 7, 1, 1),
    ],
)
def test_scores_of_the_occupied_class(
    unknown_as: UnknownAs, true_positive: int, false_positive: int, false_negative: int
) -> None:
    tp, fp, fn = true_positive, false_positive, false_negative
    assert score(tally(SAID, TRUTH, EVERYWHERE), unknown_as) == MapScore(
        precision=tp / (tp + fp),
        recall=tp / (tp + fn),
        f1=2 * tp / (2 * tp + fp + fn),
        iou=tp / (tp + fp + fn),
    )


def test_unknown_counts_as_not_occupied_by_default() -> None:
    counts = tally(SAID, TRUTH, EVERYWHERE)
    assert score(counts) == score(counts, UnknownAs.FREE)


def test_what_is_undefined_is_nan_and_never_zero() -> None:
    nothing_said = score(tally(draw("...."), draw("..#."), np.ones((1, 4), np.bool_)))
    assert math.isnan(nothing_said.precision)
    assert nothing_said.recall == nothing_said.f1 == nothing_said.iou == 0
    no_walls = score(tally(draw("...."), draw("...."), np.ones((1, 4), np.bool_)))
    assert all(map(math.isnan, (no_walls.precision, no_walls.recall, no_walls.f1, no_walls.iou)))


def test_cells_whose_truth_is_unknown_never_count() -> None:
    assert score(tally(draw("##"), draw("#?"), np.ones((1, 2), np.bool_))).precision == 1


def test_coverage_counts_known_explorable_cells_and_correct_coverage_the_right_ones() -> None:
    #  Explorable from the left room: its 2 free cells and the 10 walls around them.
    truth = draw("""
        #######
        #..##.#
        #######
    """)
    said = draw("""
        ####???
        #.?.?..
        ????###
    """)
    region = explorable(truth, Cell(1, 1))
    assert region.sum() == 12
    # Known: 4 walls on top, the left wall, one free cell, and the wall that is called free.
    assert coverage(tally(said, truth, region)) == Coverage(known=7 / 12, correct=6 / 12)


def test_calibration_by_hand() -> None:
    truth, p = draw("#."), np.array([[204, 102]], np.uint8)  # .8 and .4
    everywhere = np.ones((1, 2), np.bool_)
    result = calibration(p, truth, everywhere)
    assert result.brier == pytest.approx((0.2**2 + 0.4**2) / 2)
    assert result.log_loss == pytest.approx(-(math.log(0.8) + math.log(0.6)) / 2)


@settings(deadline=None)  # the first call loads what is compiled
@given(st.sampled_from(PredictionDtype), st.integers(0, 2**32), st.integers(1, 40))
def test_calibration_is_what_the_formula_says_cell_by_cell_to_the_last_bit(
    dtype: PredictionDtype, seed: int, side: int
) -> None:
    rng = np.random.default_rng(seed)
    raw = rng.random((side, 23)).astype(np.float32)
    p_wall = quantize(np.rint(raw * 3) / 3 if seed % 2 else raw, dtype)
    truth = rng.choice(np.array([-1, 0, 100], np.int8), raw.shape)
    region = rng.random(raw.shape) < 0.7
    result = calibration(p_wall, truth, region)
    if not region.any():
        assert math.isnan(result.brier)
        return
    p, wall, half = dequantize(p_wall)[region], truth[region] > 0, quantum(p_wall) / 2
    said = np.clip(np.where(wall, p, 1 - p), half, 1 - half)
    assert result.brier == float(np.mean((p - wall) ** 2))
    assert result.log_loss == float(-np.mean(np.log(said)))


def test_log_loss_of_a_certain_error_is_that_of_half_a_quantum() -> None:
    result = calibration(np.zeros((1, 1), np.uint8), draw("#"), np.ones((1, 1), np.bool_))
    assert result.log_loss == pytest.approx(-math.log(0.5 / 255))


def test_calibration_of_no_cell_is_nan() -> None:
    result = calibration(np.zeros((1, 1), np.uint8), draw("#"), np.zeros((1, 1), np.bool_))
    assert math.isnan(result.brier)
    assert math.isnan(result.log_loss)


@given(st.integers(1, 5000), st.sampled_from(["0.98", "0.95", "0.9", "0.333", "1.0"]), st.data())
def test_a_target_is_reached_exactly_where_the_counts_say_so(
    cells: int, target: str, data: st.DataObject
) -> None:
    """A share is one division, rounded once, as the decimal of the target is."""
    about = math.ceil(Fraction(target) * cells)
    known = data.draw(st.integers(max(0, about - 1), min(cells, about + 1)))
    truth = np.zeros((1, cells), np.int8)
    said = np.full((1, cells), -1, np.int8)
    said[0, :known] = 0
    got = coverage(tally(said, truth, truth == 0))
    assert (got.known >= float(target)) == (Fraction(known, cells) >= Fraction(target))
