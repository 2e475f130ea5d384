"""A package outside of ours brings a planner, a predictor, a source and a metric."""

import json
from pathlib import Path

import pytest

from commands import Run
from mapreplay.errors import PluginError
from mapreplay.plugins import PluginKind, available, load

MODULE = """
import numpy as np
from mapreplay.floorplan import FloorPlan
from mapreplay.planners import Choice
from mapreplay.step import PredictorIdentity


class Farthest:
    def choose(self, situation):
        return Choice(int(np.argmax(situation.costs)), situation.costs, situation.costs)


class Optimist:
    identity = PredictorIdentity("optimist", "")

    def predict(self, observed):
        return np.zeros(observed.shape, np.float32)


def optimist(device):
    return Optimist()


class Boxes:
    default_predictor = "optimist"

    def __init__(self, rest, resolution):
        self.count = int(rest)

    def ids(self):
        return [f"box-{i}" for i in range(self.count)]

    def load(self, floor_plan_id):
        cells = np.full((12, 40), 100, np.int8)
        cells[1:-1, 1:-1] = 0
        return FloorPlan(floor_plan_id, cells, 0.1)


class Row:
    unit = "1"

    def measure(self, header, region, step):
        return step.agent.row
"""

BROKEN = "raise RuntimeError('no licence\\nfound')\n"

ENTRY_POINTS = """
[mapreplay.planners]
farthest = theirs:Farthest
unlucky = theirs_broken:Planner
missing = theirs:NotThere

[mapreplay.predictors]
optimist = theirs:optimist

[mapreplay.floorplans]
boxes = theirs:Boxes

[mapreplay.metrics]
row = theirs:Row
"""


@pytest.fixture
def theirs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Their package, installed."""
    site = tmp_path / "site"
    info = site / "their_package-1.0.dist-info"
    info.mkdir(parents=True)
    (site / "theirs.py").write_text(MODULE)
    (site / "theirs_broken.py").write_text(BROKEN)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: their-package\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(ENTRY_POINTS)
    monkeypatch.syspath_prepend(str(site))


def test_every_verb_takes_them_by_name(cli: Run, theirs: None, tmp_path: Path) -> None:
    described = json.loads(cli("floorplans", "boxes:2", "--format", "json").out)["rows"]
    assert [row["id"] for row in described] == ["box-0", "box-1"]
    out = tmp_path / "runs"
    ran = cli("run", "--planner", "farthest", "--floorplans", "boxes:1", "--delta-free", 1,
              "--coverage", 1, "--build", "observed", "--out", out, "--format", "json")  # fmt: skip
    assert ran.code == 0, ran.err
    (row,) = json.loads(ran.out)["rows"]
    assert (row["planner"], row["predictor"], row["outcome"]) == ("farthest", "optimist", "mapped")
    measured = json.loads(cli("metrics", out, "--metric", "row", "--format", "json").out)
    assert measured["rows"][0]["row"] == 10.0
    savings = cli("bench", "savings", "--predictor", "optimist", "--floorplans", "boxes:1",
                "--format", "json")  # fmt: skip
    assert json.loads(savings.out)["rows"][0]["floor_plan"] == "box-0"
    assert "1 floor plan: mapping time reduced by 97.2 %" in savings.err
    assert "predictions of unobserved cells: ECE" in savings.err


def test_a_broken_one_is_named_with_its_package_and_harms_nobody(
    cli: Run, theirs: None, tmp_path: Path
) -> None:
    broken = cli("run", "--planner", "unlucky", "--out", tmp_path / "a")
    assert broken.code == 2
    assert broken.err.strip() == (
        "mapreplay: planner 'unlucky' of their-package cannot be loaded "
        "(RuntimeError: no licence found)"
    )
    assert not (tmp_path / "a").exists()
    missing = cli("run", "--planner", "missing", "--out", tmp_path / "a")
    assert "planner 'missing' of their-package cannot be loaded (AttributeError" in missing.err
    fine = cli("run", "--planner", "farthest", "--predictor", "none", "--max-steps", 2,
               "--out", tmp_path / "a")  # fmt: skip
    assert fine.code == 0, fine.err


def test_listing_loads_nothing(theirs: None) -> None:
    import sys

    assert {"farthest", "unlucky", "nearest"} <= set(available(PluginKind.PLANNERS))
    assert "theirs_broken" not in sys.modules


def test_nobody_can_take_a_name_of_ours(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    info = tmp_path / "impostor-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: impostor\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[mapreplay.planners]\nnearest = impostor:Planner\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    assert available(PluginKind.PLANNERS)["nearest"].distribution == "mapreplay"


def test_a_plugin_that_fails_when_it_is_made_is_named_too(theirs: None) -> None:
    with pytest.raises(PluginError, match=r"floor-plan source 'boxes' of their-package .*ValueErr"):
        load(PluginKind.FLOORPLANS, "boxes")("many", None)
