"""The configuration: what is wrong with it is one line, and those of the package are right."""

from pathlib import Path
from typing import Any

import pytest

from mapreplay.analysis.experiment.config import ExperimentConfig, shipped_configs
from mapreplay.errors import ConfigError, FloorPlanError, UsageError

SHIPPED = shipped_configs()
CONFIGS = SHIPPED["paper"].parent
PLAIN: dict[str, Any] = {
    "datasets": [
        {"name": "D1", "floorplans": "procedural:7-9", "predictor": "d1", "wall-share": 0.14}
    ],
    "planners": [{"planner": "nearest"}],
    "maps": [{"plan-on": "fused", "build": "fused"}],
}


def of(**changes: Any) -> ExperimentConfig:
    return ExperimentConfig.of(PLAIN | changes, "my.toml")


@pytest.mark.parametrize("name", SHIPPED)
def test_what_comes_with_the_package_is_read(name: str) -> None:
    config = ExperimentConfig.read(SHIPPED[name])
    assert all(dataset.ids is None or dataset.ids.exists() for dataset in config.datasets)


def test_the_papers_experiment_is_the_papers() -> None:
    config = ExperimentConfig.read(CONFIGS / "paper.toml")
    assert (config.delta_free, config.delta_occupied, config.coverage) == (0.93, 0.95, 0.98)
    assert {p.planner: p.runs for p in config.planners} == {
        "random": 10, "nearest": 1, "cost-utility": 1,
    }  # fmt: skip
    assert len(config.maps) == 4
    assert [(d.plans, d.curve_plans) for d in config.datasets] == [(100, 30), (100, 30)]
    d1, d2 = config.datasets
    assert d1.floorplans == "procedural:60000-60099"
    assert d2.ids is not None
    assert len(set(d2.ids.read_text().split("\n")[1:-1])) == 100


def test_validation_plans_are_no_test_plans() -> None:
    config = ExperimentConfig.read(CONFIGS / "validation.toml")
    assert config.datasets[0].floorplans == "procedural:50000-50019"
    paper = (CONFIGS / "d2-test.txt").read_text().split()
    ours = (CONFIGS / "d2-validation.txt").read_text().splitlines()[1:]
    assert len(ours) == 40
    assert not set(ours) & set(paper)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"speed": 3}, "unknown key 'speed'"),
        ({"coverage": 0}, "coverage = 0: should be greater than 0"),
        ({"datasets": []}, "datasets = []"),
        ({"planners": [{"planner": "nearest", "runs": 0}]}, "planners.0.runs = 0"),
        ({"maps": [{"plan-on": "both", "build": "fused"}]}, "maps.0.plan-on = 'both'"),
        ({"example": "D7"}, "example = 'D7': there is no such dataset"),
        ({"controls": ["coin"]}, "controls: no 'coin'; there are always-free, mean-wall"),
        ({"datasets": PLAIN["datasets"] * 2}, "two datasets have one name"),
    ],
)
def test_what_is_wrong_is_one_line(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(ConfigError) as error:
        of(**changes)
    assert str(error.value).startswith(f"my.toml: {said}")
    assert "\n" not in str(error.value)


def test_an_experiment_is_on_all_its_floor_plans_or_on_none(tmp_path: Path) -> None:
    (tmp_path / "ids.txt").write_text("procedural-8\nprocedural-77\n")
    (tmp_path / "my.toml").write_text(
        """
        planners = [{planner = "nearest"}]
        maps = [{plan-on = "fused", build = "fused"}]
        [[datasets]]
        name = "D1"
        floorplans = "procedural:7-9"
        ids = "ids.txt"
        predictor = "d1"
        wall-share = 0.14
        """
    )
    (dataset,) = ExperimentConfig.read(tmp_path / "my.toml").datasets
    with pytest.raises(FloorPlanError, match="D1: 1 floor plans are missing, such as procedural-7"):
        dataset.load()
    (tmp_path / "ids.txt").write_text("procedural-9\nprocedural-7\n")
    assert [plan.id for plan in dataset.load()] == ["procedural-9", "procedural-7"]
    assert [plan.id for plan in dataset.load("procedural:0-9")] == ["procedural-9", "procedural-7"]


def test_a_sweep_is_the_experiment_at_every_pair() -> None:
    config = of(sweep={"delta-free": [0.8, 0.9], "delta-occupied": [0.7]}, infill=[2])
    assert [(c.delta_free, c.delta_occupied) for c in config.swept()] == [(0.8, 0.7), (0.9, 0.7)]
    assert all(c.sweep is None and not c.infill for c in config.swept())
    assert of().swept() == []


def test_an_experiment_may_grow_but_not_change() -> None:
    one = of()
    more = of(planners=[{"planner": "random", "runs": 5}])
    (dataset,) = one.datasets
    assert one.of_dataset(dataset) == more.of_dataset(dataset)
    assert one.of_dataset(dataset) != of(coverage=0.9).of_dataset(dataset)


def test_datasets_are_chosen_by_name() -> None:
    two = of(datasets=[PLAIN["datasets"][0], PLAIN["datasets"][0] | {"name": "D2"}], example="D1")
    assert [d.name for d in two.only(("D2",)).datasets] == ["D2"]
    assert two.only(("D2",)).example is None
    with pytest.raises(UsageError, match="no dataset 'D3'; there are D1, D2"):
        two.only(("D3",))
