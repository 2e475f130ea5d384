"""The table, on episodes whose answer can be seen."""

import math
import random
import tempfile
from collections.abc import Iterable
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from experiments import ROW, Row, fill
from mapreplay.analysis.episodes.corpus import LoggedEpisode
from mapreplay.analysis.experiment import table
from mapreplay.analysis.experiment.table import (
    ArmResult,
    read_episodes,
    summary_frame,
)


def fused(**changes: object) -> Row:
    """Nearest Frontier on predictions."""
    return ROW(plan_on="fused", build="fused", predictor="d1", sha256="ab", **changes)


ROWS = [
    *(
        ROW(floor_plan=p, mapping_time=t, steps=t, budget=600)
        for p, t in [("a", 100), ("b", 200), ("c", 300)]
    ),
    fused(floor_plan="a", mapping_time=50, steps=50),
    fused(floor_plan="b", mapping_time=50, steps=50),
    fused(floor_plan="c", mapping_time=None, steps=30, outcome="sealed_in", budget=600),
]


def compare_arms(rows: Iterable[Row]) -> list[ArmResult]:
    with tempfile.TemporaryDirectory() as folder:
        fill(Path(folder), rows)
        return table.compare_arms(read_episodes(Path(folder)))


def find(summaries: list[ArmResult], maps: str) -> ArmResult:
    (found,) = [s for s in summaries if s.arm.maps == maps]
    return found


def test_a_reduction_is_against_the_reference_on_the_same_floor_plan() -> None:
    effects = find(compare_arms(ROWS), "fused/fused").reductions
    assert effects == (0.5, 0.75, -1.0)  # c took its whole budget of 600


def test_who_was_sealed_in_pays_the_budget_and_is_counted() -> None:
    row = find(compare_arms(ROWS), "fused/fused")
    assert row.mapping_time.mean == pytest.approx((50 + 50 + 600) / 3)
    assert row.reduction.mean == pytest.approx((0.5 + 0.75 - 1) / 3)
    assert row.reduction_finished.mean == pytest.approx((0.5 + 0.75) / 2)
    assert row.reduction_finished.plans == 2
    assert row.success.mean == pytest.approx(2 / 3)
    assert row.sealed_in.mean == pytest.approx(1 / 3)
    assert 0 < row.sealed_in.low < 1 / 3 < row.sealed_in.high < 1


def test_the_reference_saves_nothing_and_certainly_so() -> None:
    row = find(compare_arms(ROWS), "observed/observed")
    assert (row.reduction.mean, row.reduction.low, row.reduction.high) == (0, 0, 0)
    assert math.isnan(row.p)


def test_no_share_is_certain_because_nothing_else_happened() -> None:
    row = find(compare_arms(ROWS), "observed/observed")
    assert row.success.mean == 1
    assert row.success.low < 0.5  # three of three


def test_runs_of_a_plan_count_as_one_plan() -> None:
    runs = [
        ROW(planner="random", floor_plan="a", seed=s, mapping_time=t)
        for s, t in enumerate([100, 200, 300])
    ]
    runs += [ROW(planner="random", floor_plan="b", seed=0, mapping_time=400)]
    summary = next(s for s in compare_arms([*ROWS, *runs]) if s.arm.planner == "random")
    assert (summary.plans, summary.runs) == (2, 4)
    assert summary.mapping_time.mean == 300  # of 200 and 400, not of four numbers
    assert summary.reduction.mean == pytest.approx((-1 - 1) / 2)


def test_a_plan_counts_as_finished_if_every_run_did() -> None:
    runs = [
        ROW(
            planner="random",
            floor_plan=p,
            seed=s,
            mapping_time=t,
            steps=t or 400,
            outcome="mapped" if t else "out_of_steps",
        )
        for p, s, t in [("a", 0, 50), ("a", 1, None), ("b", 0, 100), ("b", 1, 100)]
    ]
    summary = next(s for s in compare_arms([*ROWS, *runs]) if s.arm.planner == "random")
    assert summary.reduction_finished.plans == 1
    assert summary.reduction_finished.mean == 0.5


def test_without_a_reference_there_is_no_reduction() -> None:
    (summary,) = compare_arms(ROWS[3:])
    assert math.isnan(summary.reduction.mean)


def test_datasets_and_predictors_are_apart_and_planners_in_the_papers_order() -> None:
    rows = [
        *ROWS,
        ROW(dataset="D2", planner="cost-utility"),
        ROW(dataset="D2", planner="random"),
        ROW(dataset="D2"),
        fused(dataset="D2"),
        ROW(dataset="D2", plan_on="fused", build="fused", predictor="always-free"),
    ]
    arms = [s.arm for s in compare_arms(rows)]
    assert [(a.dataset, a.predictor, a.planner) for a in arms] == [
        ("D1", "none", "nearest"),
        ("D1", "d1", "nearest"),
        ("D2", "none", "random"),
        ("D2", "none", "nearest"),
        ("D2", "none", "cost-utility"),
        ("D2", "d1", "nearest"),
        ("D2", "always-free", "nearest"),
    ]


def test_frames_have_an_interval_for_each_estimate() -> None:
    frame = summary_frame(compare_arms(ROWS))
    assert frame.height == 2
    assert {"reduction", "reduction_low", "reduction_high", "p", "finished_plans"} <= set(
        frame.columns
    )


def test_undefined_scores_stay_undefined() -> None:
    (summary,) = compare_arms([ROW(f1=math.nan)])
    assert math.isnan(summary.f1.mean)
    assert summary_frame([summary])["f1"].item() is None


@pytest.fixture(scope="module")
def many(tmp_path_factory: pytest.TempPathFactory) -> list[LoggedEpisode]:
    draw = random.Random(0)
    rows = []
    for k in range(60):
        planner = "nearest" if k % 30 < 15 else "random"
        numbers = {"mapping_time": draw.randint(50, 300), "f1": draw.random()}
        rows.append(ROW(floor_plan=f"p{k % 15}", seed=1 + k // 30, planner=planner, **numbers))
    folder = tmp_path_factory.mktemp("many")
    fill(folder, rows)
    return read_episodes(folder)["D1"]


@given(st.permutations(range(60)))
@settings(max_examples=5, deadline=None)
def test_which_worker_ended_first_is_in_no_number(
    many: list[LoggedEpisode], order: list[int]
) -> None:
    """More plans than have an exact test, several runs each: everything is resampled."""
    shuffled = table.compare_arms({"D1": [many[k] for k in order]})
    assert repr(shuffled) == repr(table.compare_arms({"D1": many}))
