"""The F1 curve: of a predictor whose answer is known, and there and back through a file."""

from pathlib import Path

import numpy as np
import pytest

from drawing import plan
from fakes import ConstantPredictor, FixedPredictor
from mapreplay.analysis.experiment.curve import (
    MAPS,
    OBSERVATIONS,
    load_curve,
    measure_curve,
    measure_plan,
)
from mapreplay.analysis.metrics.calibration import calibration_scores
from mapreplay.errors import MapreplayError
from mapreplay.mapping import Thresholds
from mapreplay.predictors import NoPredictor

HOUSE = plan("""
    ############
    #....#.....#
    #..........#
    #....#.....#
    ############
""")
SURE = Thresholds()


def test_a_perfect_prediction_is_right_from_the_first_observation_on() -> None:
    curve = measure_plan(HOUSE, FixedPredictor((HOUSE.cells == 100).astype(np.float32)), SURE)
    assert (curve.f1[:3] == 1).all()
    observed = curve.f1[MAPS.index("observed")]
    assert observed[0] < 1
    assert (np.diff(observed) >= 0).all()
    assert calibration_scores(curve.counts).brier == 0


def test_a_prediction_that_is_never_sure_adds_nothing() -> None:
    curve = measure_plan(HOUSE, ConstantPredictor(0.4), SURE)
    raw, thresholded, fused, observed = curve.f1
    assert (raw == 0).all()
    assert (thresholded == 0).all()
    assert (fused == observed).all()
    assert calibration_scores(curve.counts).mean_p == pytest.approx(0.4)


def test_a_walk_that_has_ended_keeps_its_last_values() -> None:
    curve = measure_plan(HOUSE, ConstantPredictor(0.4), SURE)
    assert curve.walk < 50
    after = [n >= curve.walk for n in OBSERVATIONS]
    assert (curve.f1[3][after] == curve.f1[3][-1]).all()
    assert curve.f1[3][-1] > 0.9


def test_only_unobserved_cells_are_counted() -> None:
    curve = measure_plan(HOUSE, ConstantPredictor(0.4), SURE)
    measured = sum(n <= curve.walk for n in OBSERVATIONS)
    assert calibration_scores(curve.counts).cells < measured * HOUSE.cells.size / 2


def test_there_and_back(tmp_path: Path) -> None:
    data = measure_curve("D1", [HOUSE, HOUSE], ConstantPredictor(0.4), SURE)
    again = load_curve(data.save(tmp_path))
    assert (again.dataset, again.predictor, again.thresholds) == ("D1", data.predictor, SURE)
    assert [p.floor_plan for p in again.plans] == ["drawn", "drawn"]
    assert np.array_equal(again.f1("fused"), data.f1("fused"))
    assert (again.plans[1].counts.cells == data.plans[1].counts.cells).all()
    assert list(tmp_path.iterdir()) == [tmp_path / "curve-D1.npz"]


def test_where_nothing_is_predicted_the_observations_stand_alone() -> None:
    curve = measure_plan(HOUSE, NoPredictor(), SURE)
    raw, thresholded, fused, observed = curve.f1
    assert np.isnan([raw, thresholded]).all()
    assert np.array_equal(fused, observed)
    assert curve.counts.cells.sum() == 0


def test_bad_files_and_predictors_are_named(tmp_path: Path) -> None:
    path = tmp_path / "curve-D1.npz"
    path.write_bytes(b"nonsense")
    with pytest.raises(MapreplayError, match=r"curve-D1.npz: not the data of a curve"):
        load_curve(path)
    with pytest.raises(MapreplayError, match=r"'constant': P\(occupied\)"):
        measure_plan(HOUSE, ConstantPredictor(1.5), SURE)
