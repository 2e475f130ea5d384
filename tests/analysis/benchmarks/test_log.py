"""The log's benchmark on a few steps: all contenders take part, and do what they claim."""

from pathlib import Path

import numpy as np
import pytest

from drawing import plan
from mapreplay.analysis.benchmarks import log_peers
from mapreplay.analysis.benchmarks.log import (
    four_in_a_square,
    measure_log,
    simulate,
    step_arrays,
)
from mapreplay.analysis.benchmarks.log_peers import Run, read_with_mcap, recorders, write_ours
from mapreplay.errors import UsageError
from mapreplay.floorplan import explorable
from mapreplay.grid import FREE
from recordings import THREE_ROOMS


@pytest.fixture(scope="module")
def run() -> Run:
    return simulate(plan(THREE_ROOMS, "three-rooms"), "blur", 6)


def test_every_recorder_and_reader_is_measured(run: Run) -> None:
    lines = list(measure_log(run, rounds=1))
    assert [line.what for line in lines].count("record") == len(recorders())
    assert {line.what for line in lines} == {
        "record", "read all maps", "read all scalars", "size",
    }  # fmt: skip
    for what in {line.what for line in lines}:
        ours, *others = [line for line in lines if line.what == what]
        assert ours.ours == 1.0
        for line in others:
            assert line.unit == ours.unit
            if line.value is not None and ours.value is not None:
                assert line.ours == pytest.approx(ours.value / line.value)


def test_a_peer_that_is_not_installed_is_named(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(log_peers, "find_spec", lambda _: None)
    missing = [line for line in measure_log(run, rounds=1) if line.value is None]
    assert {line.how.partition(",")[0] for line in missing} == {"foxglove-sdk"}
    assert all(line.ours is None for line in missing)


def test_the_peers_read_the_same_maps(run: Run, tmp_path: Path) -> None:
    write_ours(run, tmp_path / "log.mcap")
    expected = [array for step in run.steps for array in (step.observed, step.p_wall, step.fused)]
    got = {array.tobytes() for array in read_with_mcap(tmp_path / "log.mcap", checked=True)}
    assert got == {array.tobytes() for array in expected if array is not None}


def test_the_arrays_are_all_that_the_steps_hold(run: Run) -> None:
    arrays = step_arrays(run)
    assert arrays["observed"].shape == (6, 12, 28)
    assert arrays["frontier"].shape == (arrays["frontier_length"].sum(), 2)
    assert len(arrays["path_length"]) == 5  # the last step decides nothing
    assert arrays["metrics"].dtype == np.float64


def test_four_plans_in_a_square_are_one() -> None:
    closed = plan("\n".join(["#" * 20, *["#" + "." * 18 + "#"] * 18, "#" * 20]), "closed")
    square = four_in_a_square([closed] * 4)
    assert square.shape == (40, 40)
    assert simulate(square, "blur", 2).header.start == (38, 1)
    reached = explorable(square.cells, square.default_start) & (square.cells == FREE)
    assert reached.sum() == (square.cells == FREE).sum()


def test_one_step_is_not_enough() -> None:
    with pytest.raises(UsageError, match="at least 2 steps"):
        simulate(plan(THREE_ROOMS), "blur", 1)
