"""Metrics of a log: by hand, by other people's code, and as they were recorded."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from sklearn import metrics as oracle

from drawing import plan
from mapreplay.analysis.metrics.calibration import distance_from_observed
from mapreplay.analysis.metrics.measure import (
    SCORES,
    Measurements,
    Scope,
    distance_labels,
    measure_log,
)
from mapreplay.analysis.metrics.per_episode import episode_metrics
from mapreplay.analysis.metrics.registry import load_metric
from mapreplay.external import ExternalEpisode
from mapreplay.grid import UNKNOWN
from mapreplay.mapping import dequantize
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.recorders.log.writer import EpisodeWriter
from mapreplay.scores import UnknownAs
from mapreplay.step import Step, StepMetrics
from recordings import record, three_rooms

CORRIDOR = """
    ######
    #....#
    ######
"""


@pytest.fixture(scope="module", params=["uint8", "float32"])
def log(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> EpisodeLog:
    """An episode with a prediction."""
    episode = three_rooms(predictor="blur", prediction_dtype=request.param, max_steps=25)
    return EpisodeLog(record(tmp_path_factory.mktemp("log"), episode).path)


@pytest.fixture(scope="module")
def measured(log: EpisodeLog) -> Measurements:
    return measure_log(log)


def test_what_was_recorded_comes_out_again_bit_for_bit(
    log: EpisodeLog, measured: Measurements
) -> None:
    assert measured.disagreements == ()
    for name in StepMetrics.names():
        values = [getattr(step.metrics, name) for step in log]
        expected = [None if math.isnan(value) else value for value in values]
        assert measured.steps[name].to_list() == expected


def unobserved(log: EpisodeLog, step: Step) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """p_wall, truth and distance of the cells that count at a step."""
    assert step.p_wall is not None
    counted = log.header.explorable & (step.observed == UNKNOWN)
    p = dequantize(step.p_wall)[counted]
    if step.p_wall.dtype != np.uint8:
        p = np.rint(p * 4095) / 4095
    return (
        p,
        log.header.floor_plan.cells[counted] > 0,
        distance_from_observed(step.observed)[counted],
    )


def test_scores_of_the_prediction_are_those_of_scikit_learn(
    log: EpisodeLog, measured: Measurements
) -> None:
    near = {"at_1": (1, 1), "at_2": (2, 2), "at_3_4": (3, 4), "at_5_8": (5, 8)}
    checked = 0
    for step, row in zip(log, measured.steps.iter_rows(named=True), strict=True):
        p, wall, distance = unobserved(log, step)
        for where, (low, high) in {"unobserved": (0, 99), **near}.items():
            chosen = (low <= distance) & (distance <= high)
            assert row[f"cells_{where}"] == chosen.sum()
            if not 0 < wall[chosen].sum() < chosen.sum():
                assert row[f"auroc_{where}"] is None
                continue
            checked += 1
            expected = oracle.roc_auc_score(wall[chosen], p[chosen])
            assert row[f"auroc_{where}"] == pytest.approx(expected)
            expected = oracle.brier_score_loss(wall[chosen], p[chosen])
            assert row[f"brier_{where}"] == pytest.approx(expected, abs=3e-4)
    assert checked > 50


def test_ece_is_the_gap_between_what_is_said_and_what_is(
    log: EpisodeLog, measured: Measurements
) -> None:
    p, wall, _ = unobserved(log, log[3])
    bins = np.minimum((p * 10).astype(int), 9)
    gaps = [abs(p[bins == b].sum() - wall[bins == b].sum()) for b in range(10)]
    assert measured.steps["ece_unobserved"][3] == pytest.approx(sum(gaps) / len(p))


def test_stability_is_the_change_on_cells_that_are_still_unobserved(
    log: EpisodeLog, measured: Measurements
) -> None:
    assert measured.steps["prediction_change"][0] is None
    before, now = log[6], log[7]
    assert before.p_wall is not None
    assert now.p_wall is not None
    counted = log.header.explorable & (now.observed == UNKNOWN)
    a, b = dequantize(before.p_wall)[counted], dequantize(now.p_wall)[counted]
    assert measured.steps["prediction_change"][7] == pytest.approx(np.abs(b - a).mean())
    assert measured.steps["prediction_flips"][7] == ((a >= 0.5) != (b >= 0.5)).mean()


def test_the_episode_pools_the_cells_of_all_steps(log: EpisodeLog, measured: Measurements) -> None:
    episode = episode_metrics(log, measured)
    row = episode.row(0, named=True)
    steps = [unobserved(log, step) for step in log]
    p, wall = (np.concatenate([step[i] for step in steps]) for i in (0, 1))
    assert row["cells_pooled"] == len(p)
    assert row["brier_pooled"] == pytest.approx(np.mean((p - wall) ** 2))
    assert row["auroc_pooled"] == pytest.approx(oracle.roc_auc_score(wall, p))
    assert row["log_loss_pooled"] == pytest.approx(
        oracle.log_loss(wall, np.clip(p, 0.5 / 255, 1 - 0.5 / 255)), rel=0.05
    )
    assert row["brier_unobserved"] == measured.steps["brier_unobserved"][-1]
    assert row["disagreements"] == 0


def test_milestones_and_area_of_a_walk_along_a_corridor(tmp_path: Path) -> None:
    #  18 explorable cells: 4 free, 14 walls. Each look shows one more column of three.
    corridor = plan(CORRIDOR, "corridor", resolution=0.5)
    episode = ExternalEpisode(corridor, (1, 1), planner="mine", max_steps=9)
    with EpisodeWriter(tmp_path / "log.mcap", episode.header) as writer:
        for k in range(4):
            observed = np.full(corridor.shape, UNKNOWN, np.int8)
            observed[:, : 3 + k] = corridor.cells[:, : 3 + k]
            outcome = "mapped" if k == 3 else None
            target = (1, 4) if k < 3 else None
            writer.add(episode.step((1, 1 + k), observed, target=target, outcome=outcome))
    log = EpisodeLog(tmp_path / "log.mcap")
    row = episode_metrics(log, measure_log(log)).row(0, named=True)
    covered = [9 / 18, 12 / 18, 15 / 18, 1.0]
    assert row["steps_to_50"] == 0
    assert (row["steps_to_75"], row["path_to_75"]) == (2, 1.0)
    assert row["steps_to_98"] == row["steps_to_correct_98"] == 3
    assert row["area"] == pytest.approx((sum(covered) + 6 * 1.0) / 10)
    assert row["ece_pooled"] is None
    assert row["prediction_change"] is None


def test_another_scope_gives_other_scores_and_is_not_compared(log: EpisodeLog) -> None:
    strict = measure_log(log, Scope(UnknownAs.OCCUPIED, everywhere=True))
    assert strict.disagreements == ()
    assert strict.steps["recall"][0] > log[0].metrics.recall


def test_a_wrong_recording_is_told(tmp_path: Path) -> None:
    episode = three_rooms(max_steps=4)
    path = record(tmp_path, episode).path
    steps = [replace(s, metrics=replace(s.metrics, f1=0.123)) for s in EpisodeLog(path)]
    with EpisodeWriter(tmp_path / "wrong.mcap", episode.header) as writer:
        for step in steps:
            writer.add(step)
    wrong = measure_log(EpisodeLog(tmp_path / "wrong.mcap")).disagreements
    assert [d.step for d in wrong] == list(range(5))
    assert str(wrong[0]).startswith("step 0: f1 was recorded as 0.123, the maps give 0.")


def test_further_metrics_have_columns_of_their_own(log: EpisodeLog) -> None:
    names = ["frontier-size", "false-walls", "false-free"]
    measured = measure_log(log, metrics={name: load_metric(name) for name in names})
    assert measured.steps["frontier-size"].to_list() == [len(step.frontier) for step in log]
    plain = measure_log(log)
    assert measured.steps.drop(names).equals(plain.steps)
    row = episode_metrics(log, measured, names)
    assert row["false-walls"][0] == measured.steps["false-walls"][-1]


def test_every_log_gives_the_same_columns(log: EpisodeLog, tmp_path: Path) -> None:
    without = measure_log(EpisodeLog(record(tmp_path, three_rooms(max_steps=2)).path))
    assert without.steps.schema == measure_log(log).steps.schema
    assert without.steps["ece_unobserved"].null_count() == 3
    assert without.predictions is None
    names = [f"{score}_{label}" for label in distance_labels() for score in SCORES]
    assert set(names) <= set(without.steps.columns)
    assert without.steps.schema["step"] == pl.Int32


def test_the_chessboard_distance_is_that_of_a_search(log: EpisodeLog) -> None:
    rng = np.random.default_rng(0)
    for share in (0.001, 0.02, 0.5):
        observed = np.where(rng.random((17, 23)) < share, 0, UNKNOWN).astype(np.int8)
        seen = np.argwhere(observed != UNKNOWN)
        cells = np.argwhere(np.ones(observed.shape))
        gaps = np.abs(cells[:, None] - seen[None]).max(axis=2)
        expected = gaps.min(axis=1, initial=23).reshape(observed.shape)
        assert (distance_from_observed(observed) == expected).all()
