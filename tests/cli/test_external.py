"""Logs of other simulators: little is needed, and every verb says what it can still do."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from commands import Run
from drawing import draw, plan
from mapreplay import EpisodeLog, EpisodeWriter, ExternalEpisode, unknown_floor_plan
from mapreplay.analysis.verification import verify
from mapreplay.errors import ConfigError, FloorPlanError, UsageError
from mapreplay.grid import Cell
from mapreplay.step import differences

README = Path(__file__).parents[2] / "README.md"

ROOM = """
    ########
    #......#
    #......#
    #......#
    ########
"""


def record(folder: Path, episode: ExternalEpisode, maps: list[np.ndarray], **last: object) -> Path:
    """A walk along row 1, with the given observed maps."""
    path = folder / "theirs.mcap"
    with EpisodeWriter(path, episode.header) as writer:
        for k, observed in enumerate(maps):
            ended = k == len(maps) - 1
            writer.add(
                episode.step(
                    (1, 1 + k),
                    observed,
                    target=None if ended else (1, 6),
                    outcome="mapped" if ended else None,
                    **last,  # type: ignore[arg-type]
                )
            )
    return path


def growing_maps() -> list[np.ndarray]:
    truth = draw(ROOM)
    maps = []
    for k in range(4):
        observed = np.full(truth.shape, -1, np.int8)
        observed[:, : 3 + k] = truth[:, : 3 + k]
        maps.append(observed)
    return maps


def test_the_readmes_example_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    section = README.read_text().partition("## Recording from your own simulator")[2]
    code = re.search(r"```python\n(.*?)```", section, re.DOTALL)
    assert code is not None
    lines = [line for line in code[1].splitlines() if line.strip()]
    assert len(lines) <= 14
    monkeypatch.chdir(tmp_path)
    exec(compile(code[1], "README.md", "exec"), {})
    (log,) = tmp_path.rglob("*.mcap")
    assert verify(EpisodeLog(log)).agrees


def test_poses_and_observed_maps_are_enough(tmp_path: Path, cli: Run) -> None:
    episode = ExternalEpisode(unknown_floor_plan("lab", (5, 8), 0.05), (1, 1), planner="mine")
    path = record(tmp_path, episode, growing_maps())
    log = EpisodeLog(path)
    assert not log.header.floor_plan.has_truth
    assert not log.header.explorable.any()
    assert [step.agent.col for step in log] == [1, 2, 3, 4]
    assert np.isnan(log[2].metrics.f1)
    assert log[3].metrics.path_length == pytest.approx(3 * 0.05)
    assert len(log[0].hits) == 0
    for verb in ("ls", "info", "metrics", "verify"):
        result = cli(verb, path)
        assert result.code == 0, (verb, result.err)
    assert cli("view", path, "--save", tmp_path / "x.rrd").code == 0
    assert cli("export", path, "--npz", tmp_path / "x.npz", "--png", tmp_path / "p").code == 0
    assert "not checked" in cli("verify", path).err
    again = cli("verify", path, "--rerun")
    assert again.code == 2
    assert "cannot be run again here" in again.err


def test_everything_that_is_given_comes_back(tmp_path: Path) -> None:
    floor_plan = plan(ROOM, resolution=0.1)
    episode = ExternalEpisode(floor_plan, (1, 1), planner="mine", simulator="gym", seed=7)
    p_wall = np.linspace(0, 1, 40).reshape(5, 8)
    frontier = np.array([[1, 2], [2, 2]], np.int32)
    steps = [
        episode.step((1, 1), growing_maps()[0], p_wall=p_wall, hits=np.full(16, 3, np.int16),
                     target=(1, 2), frontier=frontier),
        episode.step((1, 2), growing_maps()[1], outcome="out_of_steps"),
    ]  # fmt: skip
    path = tmp_path / "theirs.mcap"
    with EpisodeWriter(path, episode.header) as writer:
        for step in steps:
            writer.add(step)
    log = EpisodeLog(path)
    assert (log.header.simulator, log.header.config.seed) == ("gym", 7)
    for written, read in zip(steps, log, strict=True):
        assert differences(written, read) == []
    assert log[0].metrics.coverage_observed > 0
    assert log[0].decision is not None
    assert log[0].decision.path.tolist() == [[1, 1], [1, 2]]
    assert verify(log).agrees


def test_poses_that_are_not_neighbours_are_joined_by_the_shortest_way(tmp_path: Path) -> None:
    episode = ExternalEpisode(plan(ROOM), (1, 1), planner="mine")
    observed = draw(ROOM)
    episode.step((1, 1), observed)
    assert episode.step((3, 6), observed).metrics.path_length == pytest.approx(3 + 2 * 2**0.5)


def test_a_fused_map_that_does_not_follow_is_found(tmp_path: Path) -> None:
    episode = ExternalEpisode(plan(ROOM), (1, 1), planner="mine")
    path = record(tmp_path, episode, growing_maps(), fused=draw(ROOM))
    found = verify(EpisodeLog(path))
    assert not found.agrees
    assert "/map/fused" in str(found.differences[0])


def test_wrong_input_is_named() -> None:
    floor_plan = plan(ROOM)
    with pytest.raises(FloorPlanError, match=r"start \(0, 0\) is not a free cell"):
        ExternalEpisode(floor_plan, (0, 0), planner="mine")
    with pytest.raises(ConfigError, match="unknown key 'sed'"):
        ExternalEpisode(floor_plan, (1, 1), planner="mine", sed=3)
    episode = ExternalEpisode(floor_plan, (1, 1), planner="mine")
    observed = draw(ROOM)
    for message, arguments in [
        (r"agent \(9, 9\) lies outside of 5 x 8", {"agent": (9, 9), "observed": observed}),
        (r"observed: shape \(2, 2\)", {"agent": (1, 1), "observed": observed[:2, :2]}),
        ("observed: expected int8", {"agent": (1, 1), "observed": observed.astype(float)}),
        ("observed: cells must be", {"agent": (1, 1), "observed": observed + np.int8(1)}),
        ("p_wall: P.occupied.", {"agent": (1, 1), "observed": observed,
                                 "p_wall": np.full((5, 8), 2.0)}),
        ("outcome 'won'", {"agent": (1, 1), "observed": observed, "outcome": "won"}),
        ("target", {"agent": (1, 1), "observed": observed, "target": (5, 0)}),
    ]:  # fmt: skip
        with pytest.raises(UsageError, match=message):
            episode.step(**arguments)  # type: ignore[arg-type]


def lab() -> ExternalEpisode:
    return ExternalEpisode(unknown_floor_plan("lab", (4, 6), 0.1), (1, 2), planner="theirs", rays=8)


SEEN = np.zeros((4, 6), np.int8)


@pytest.mark.parametrize(
    ("pose", "message"),
    [
        ((1, 5.3), r"agent \(1, 5.3\): expected \(row, col\), two whole numbers"),
        ((float("nan"), 2), "two whole numbers"),
        ((float("inf"), 2), "two whole numbers"),
        ((True, 2), "two whole numbers"),
        ((np.True_, 2), "two whole numbers"),
        (("1", "2"), "two whole numbers"),
        ((1, 2, 3), "two whole numbers"),
        ((1,), "two whole numbers"),
        (None, "two whole numbers"),
        ((-1, 2), r"agent \(-1, 2\) lies outside of 4 x 6"),
        ((1, 6), r"agent \(1, 6\) lies outside of 4 x 6"),
        ((1, 3), r"agent \(1, 3\) at step 0: the episode starts at \(1, 2\)"),
    ],
)
def test_a_pose_that_is_no_cell_or_not_the_start_is_refused(pose: object, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        lab().step(pose, SEEN)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "pose", [(1, 2), (np.int64(1), np.uint8(2)), (1.0, np.float32(2)), np.array([1, 2])]
)
def test_a_pose_in_whole_numbers_of_any_type_is_that_cell(pose: object) -> None:
    step = lab().step(pose, SEEN)  # type: ignore[arg-type]
    assert step.agent == (1, 2)
    assert all(type(value) is int for value in step.agent)


@pytest.mark.parametrize("start", [(1.5, 2), (True, 2), ("1", 2), (1, 2, 3), (9, 9), (-1, 0)])
def test_a_start_that_is_no_cell_is_refused(start: object) -> None:
    with pytest.raises(UsageError, match="start"):
        ExternalEpisode(unknown_floor_plan("lab", (4, 6), 0.1), start, planner="theirs")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("what", "value"),
    [
        ("target", (1.5, 2)),
        ("target", (9, 2)),
        ("hits", np.zeros(8, np.float64)),
        ("hits", np.zeros(7, np.int16)),
        ("hits", np.full(8, 21, np.int16)),
        ("hits", np.full(8, -1, np.int16)),
        ("frontier", np.array([[1.5, 2]])),
        ("frontier", np.array([1, 2])),
        ("frontier", np.array([[1, 6]])),
        ("p_wall", [[0.5] * 6] * 4),
        ("p_wall", np.full((4, 6), "x")),
        ("fused", SEEN.tolist()),
    ],
)
def test_nothing_else_is_cut_or_guessed_either(what: str, value: object) -> None:
    with pytest.raises(UsageError, match=what):
        lab().step((1, 2), SEEN, **{what: value})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("key", "value"),
    [("seed", 1.5), ("seed", "1"), ("seed", True), ("rays", 8.0), ("fail_safe", "yes"),
     ("coverage", "0.9"), ("max_steps", 3.0)],
)  # fmt: skip
def test_a_setting_of_another_type_is_refused(key: str, value: object) -> None:
    with pytest.raises(ConfigError, match=key):
        ExternalEpisode(unknown_floor_plan("lab", (4, 6), 0.1), (1, 2), "theirs", **{key: value})  # type: ignore[arg-type]


def test_a_setting_of_numpy_is_one_of_python() -> None:
    plan = unknown_floor_plan("lab", (4, 6), 0.1)
    config = ExternalEpisode(
        plan, (1, 2), "theirs", seed=np.int64(3), coverage=np.float32(0.5)
    ).header.config
    assert (config.seed, config.coverage) == (3, 0.5)
    assert type(config.seed) is int


def test_a_first_pose_that_is_not_the_start_is_a_difference(tmp_path: Path) -> None:
    episode = lab()
    first = episode.step((1, 2), SEEN, outcome="mapped")
    path = tmp_path / "lab.mcap"
    with EpisodeWriter(path, replace(episode.header, start=Cell(1, 3))) as writer:
        writer.add(first)
    found = [d for d in verify(EpisodeLog(path)).differences if d.what == "agent"]
    assert [(d.step, d.logged, d.expected) for d in found] == [(0, (1, 2), (1, 3))]
