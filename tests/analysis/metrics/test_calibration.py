"""Calibration: hand-drawn cells, scikit-learn as oracle, and predictions that are true or not."""

import math

import numpy as np
import numpy.typing as npt
import pytest

from drawing import draw
from mapreplay.analysis.metrics.calibration import (
    PredictionCounts,
    calibration_scores,
    count_cells,
    decided,
    distance_from_observed,
    no_cells,
    reliability,
    score_interval,
)
from mapreplay.grid import FREE, OCCUPIED, UNKNOWN, Grid
from mapreplay.mapping import PredictionDtype, Thresholds, dequantize, quantize

Levels = npt.NDArray[np.uint8]


def counts_of(level: Levels, wall: npt.NDArray[np.bool_]) -> PredictionCounts:
    """Counts of cells in a row, none of them observed."""
    truth: Grid = np.where(wall, np.int8(OCCUPIED), np.int8(FREE))[None]
    nothing: Grid = np.full(truth.shape, UNKNOWN, np.int8)
    return count_cells(level[None], truth, nothing, np.ones(truth.shape, np.bool_))


def honest(rng: np.random.Generator, cells: int) -> tuple[Levels, npt.NDArray[np.bool_]]:
    """Predictions that are right as often as they say, most of them near 0."""
    level = np.rint(255 * rng.beta(0.4, 1.6, cells)).astype(np.uint8)
    return level, rng.random(cells) < level / 255


def test_distance_is_that_of_a_chess_king() -> None:
    observed = draw("""
        ?????
        ?????
        ??.??
        ?????
    """)
    assert distance_from_observed(observed)[::-1].tolist() == [
        [2, 2, 2, 2, 2],
        [2, 1, 1, 1, 2],
        [2, 1, 0, 1, 2],
        [2, 1, 1, 1, 2],
    ]


def test_nothing_observed_is_far_away() -> None:
    assert (distance_from_observed(draw("???\n???")) == 3).all()


def test_only_unobserved_cells_of_the_region_count_by_their_distance() -> None:
    observed = draw(".?????")
    truth = draw("..#.#?")
    region = np.array([[True, True, True, True, False, True]])
    p_wall = np.array([[9, 0, 255, 51, 7, 7]], np.uint8)
    counts = count_cells(p_wall, truth, observed, region)
    assert counts.labels == ("1", "2", "3-4", "5-8", "9-16", ">16")
    found = [tuple(map(int, place)) for place in np.argwhere(counts.cells)]
    # (group, truth, level): the cell beside, the wall at 2, the free one at 3; the one outside
    # of the region, the observed one and the one whose truth is unknown are left out.
    assert found == [(0, 0, 0), (1, 1, 255), (2, 0, 51)]
    assert calibration_scores(counts.group(1)).wall_share == 1


def test_scores_by_hand() -> None:
    # p = 0 free, p = 1 occupied, p = .2 free and occupied.
    counts = counts_of(np.array([0, 255, 51, 51], np.uint8), np.array([False, True, False, True]))
    scores = calibration_scores(counts)
    assert scores.cells == 4
    assert scores.wall_share == 0.5
    assert scores.mean_p == pytest.approx((0 + 1 + 0.2 + 0.2) / 4)
    assert scores.brier == pytest.approx((0.04 + 0.64) / 4)
    assert scores.ece == pytest.approx(2 / 4 * 0.3)  # two cells say .2 where half are walls
    half = 0.5 / 255
    logs = 2 * math.log(1 - half) + math.log(0.8) + math.log(0.2)
    assert scores.log_loss == pytest.approx(-logs / 4)
    assert scores.auroc == pytest.approx((1 + 1 + 1 + 0.5) / 4)
    bins = reliability(counts)
    assert [b.cells for b in bins] == [1, 0, 2, 0, 0, 0, 0, 0, 0, 1]
    assert bins[2].mean_p == pytest.approx(0.2)
    assert bins[2].wall_share == 0.5
    assert math.isnan(bins[1].mean_p)


def test_nothing_is_undefined_and_not_zero() -> None:
    scores = calibration_scores(no_cells())
    assert scores.cells == 0
    assert all(math.isnan(v) for v in (scores.ece, scores.brier, scores.log_loss, scores.auroc))
    only_free = calibration_scores(counts_of(np.zeros(3, np.uint8), np.zeros(3, np.bool_)))
    assert math.isnan(only_free.auroc)
    assert only_free.brier == 0


def test_scikit_learn_says_the_same() -> None:
    from sklearn.metrics import brier_score_loss, log_loss, roc_auc_score

    level, wall = honest(np.random.default_rng(1), 3000)
    scores = calibration_scores(counts_of(level, wall))
    p = level / 255
    assert scores.brier == pytest.approx(brier_score_loss(wall, p))
    clipped = np.clip(p, 0.5 / 255, 1 - 0.5 / 255)
    assert scores.log_loss == pytest.approx(log_loss(wall, clipped))
    assert scores.auroc == pytest.approx(roc_auc_score(wall, p))


def test_the_reliability_diagram_is_that_of_scikit_learn() -> None:
    from sklearn.calibration import calibration_curve

    level, wall = honest(np.random.default_rng(2), 3000)
    level[level % 51 == 0] += 1  # scikit-learn puts an edge into the lower bin, we into the upper
    ours = [b for b in reliability(counts_of(level, wall), bins=5) if b.cells]
    share, mean_p = calibration_curve(wall, level / 255, n_bins=5)
    assert [b.wall_share for b in ours] == pytest.approx(share.tolist())
    assert [b.mean_p for b in ours] == pytest.approx(mean_p.tolist())


@pytest.mark.parametrize("dtype", list(PredictionDtype))
def test_each_precision_is_counted(dtype: PredictionDtype) -> None:
    rng = np.random.default_rng(3)
    p_wall = quantize(rng.random((20, 20)), dtype)
    truth: Grid = np.where(rng.random((20, 20)) < 0.3, np.int8(OCCUPIED), np.int8(FREE))
    unseen: Grid = np.full(truth.shape, UNKNOWN, np.int8)
    counts = count_cells(p_wall, truth, unseen, np.ones(truth.shape, np.bool_))
    expected = float(np.mean((dequantize(p_wall) - (truth == OCCUPIED)) ** 2))
    assert calibration_scores(counts).brier == pytest.approx(expected, abs=2e-4)


def test_counts_of_parts_add_up_to_the_counts_of_the_whole() -> None:
    level, wall = honest(np.random.default_rng(4), 900)
    parts = [counts_of(level[i::3], wall[i::3]) for i in range(3)]
    whole = counts_of(level, wall)
    added = sum(parts, no_cells())
    # In a row with nothing observed, the shorter parts are nearer to it: only the sum is equal.
    assert (added.total == whole.total).all()
    assert reliability(added) == reliability(whole)
    with pytest.raises(ValueError, match="cannot be added"):
        whole + no_cells(levels=4096)


def test_decisions_are_those_of_the_thresholds() -> None:
    level = np.array([0, 8, 9, 100, 248, 249, 255, 255], np.uint8)
    wall = np.array([0, 1, 0, 0, 1, 1, 1, 0], np.bool_)
    # 93 %: free up to p = .035 (level 8); 95 %: occupied from p = .975 (level 249).
    result = decided(counts_of(level, wall), Thresholds(0.93, 0.95))
    assert (result.free, result.free_wrong) == (2, 1)
    assert (result.occupied, result.occupied_wrong) == (3, 1)
    assert result.share == 5 / 8
    assert result.right == 3 / 8


def test_free_wins_where_both_thresholds_hold() -> None:
    counts = counts_of(np.array([127], np.uint8), np.array([True]))
    result = decided(counts, Thresholds(0.0, 0.0))
    assert (result.free, result.free_wrong, result.occupied) == (1, 1, 0)


def test_an_honest_prediction_is_calibrated_and_a_bold_one_is_not() -> None:
    level, wall = honest(np.random.default_rng(5), 100_000)
    assert calibration_scores(counts_of(level, wall)).ece < 0.01
    bold = np.where(level < 128, 0, 255).astype(np.uint8)
    assert calibration_scores(counts_of(bold, wall)).ece > 0.05


def test_the_interval_over_plans_is_wider_than_cells_would_have_it() -> None:
    # Twenty plans whose predictions are wrong together: each has a bias of its own.
    rng = np.random.default_rng(6)
    plans = []
    for bias in rng.normal(0, 0.1, 20):
        level = np.full(2000, 51, np.uint8)
        plans.append(counts_of(level, rng.random(2000) < 0.3 + bias))
    estimate = score_interval(plans, lambda c: calibration_scores(c).ece)
    assert estimate.plans == 20
    assert estimate.low <= 0.1 <= estimate.high
    assert estimate.high - estimate.low > 4 * 2 * 1.96 * math.sqrt(0.3 * 0.7 / 40_000)


def test_no_plan_has_no_score() -> None:
    assert math.isnan(score_interval([], lambda c: calibration_scores(c).ece).mean)
