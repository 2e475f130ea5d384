"""Running an episode on from a logged step: whose steps are whose, and that its log is true."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drawing import draw, plan
from fakes import FixedPredictor
from mapreplay.analysis.branching import (
    BranchedEpisode,
    SetRight,
    branch,
    branch_path,
    lineage,
    past_at,
)
from mapreplay.analysis.metrics.measure import measure_log
from mapreplay.analysis.verification import verify, verify_rerun
from mapreplay.config import EpisodeConfig
from mapreplay.episode import prepare_episode, run_episode
from mapreplay.errors import ConfigError, LogError, UsageError
from mapreplay.grid import Cell
from mapreplay.mapping import PredictionDtype, Thresholds
from mapreplay.predictors import Predictor
from mapreplay.recorders.log.header import episode_pairs, header_of
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.recorders.log.writer import EpisodeWriter
from mapreplay.step import Outcome, differences
from recordings import BlurPredictor, Recorded, record, three_rooms

K = 23

TWO_ROOMS = """
    ###########
    #....#....#
    #.........#
    #....#....#
    ###########
"""
DOOR = (2, 5)


def closed_door() -> FixedPredictor:
    """Sure of everything in the left room, that the door is a wall, and of nothing else."""
    p_wall = np.full((5, 11), 0.5, np.float32)
    left = draw(TWO_ROOMS)[:, :6]
    p_wall[:, :6] = np.where(left == 0, 0.0, 1.0)
    p_wall[DOOR] = 1.0
    return FixedPredictor(p_wall)


@pytest.fixture(scope="module")
def sealed(tmp_path_factory: pytest.TempPathFactory) -> EpisodeLog:
    """Sealed in at the start: the sensor reaches one cell, the door is predicted shut."""
    config = EpisodeConfig.of({"planner": "nearest", "predictor": "fixed", "reach": 1})
    episode = prepare_episode(config, plan(TWO_ROOMS), predictor=closed_door())
    recorded = record(tmp_path_factory.mktemp("sealed"), episode)
    return EpisodeLog(recorded.path)


def written(branched: BranchedEpisode, path: Path) -> EpisodeLog:
    with EpisodeWriter(path, branched.header) as writer:
        for step in branched.steps():
            writer.add(step)
    return EpisodeLog(path)


def branched_log(
    log: EpisodeLog, at: int, *changes: str, to: Path, predictor: Predictor | None = None
) -> EpisodeLog:
    return written(branch(log, at, changes, predictor=predictor), to)


def test_a_closed_door_opens_when_the_prediction_is_set_right(
    sealed: EpisodeLog, tmp_path: Path
) -> None:
    assert (sealed.outcome, len(sealed)) == (Outcome.SEALED_IN, 1)
    log = branched_log(sealed, -1, "truth", to=tmp_path / "x.mcap", predictor=closed_door())
    assert log.outcome is Outcome.MAPPED
    assert log[0].fused[DOOR] == 0
    assert log.header.predictor.name == "fixed set right"
    assert verify(log).agrees


def test_the_fail_safe_gets_out(sealed: EpisodeLog, tmp_path: Path) -> None:
    log = branched_log(sealed, 0, "fail-safe=on", to=tmp_path / "x.mcap", predictor=closed_door())
    assert log.outcome is Outcome.MAPPED
    assert verify(log).agrees


def test_without_predictions_only_what_was_observed_counts(
    sealed: EpisodeLog, tmp_path: Path
) -> None:
    log = branched_log(sealed, 0, "observed", to=tmp_path / "x.mcap")
    assert log.outcome is Outcome.MAPPED
    assert all(step.p_wall is None for step in log)


@pytest.fixture(scope="module")
def parent(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    return record(tmp_path_factory.mktemp("parent"), three_rooms())


@pytest.fixture(scope="module")
def child(parent: Recorded, tmp_path_factory: pytest.TempPathFactory) -> EpisodeLog:
    path = tmp_path_factory.mktemp("child") / "child.mcap"
    return branched_log(EpisodeLog(parent.path), K, "planner=nearest", to=path)


def test_the_steps_before_are_the_parents(parent: Recorded, child: EpisodeLog) -> None:
    for theirs, ours in zip(parent.steps[:K], child, strict=False):
        assert differences(replace(theirs, profile=None), ours) == []


def test_the_step_is_made_anew_from_the_same_state(parent: Recorded, child: EpisodeLog) -> None:
    theirs, ours = parent.steps[K], child[K]
    assert (theirs.agent, theirs.observed.tobytes()) == (ours.agent, ours.observed.tobytes())
    assert theirs.decision is not None
    assert ours.decision is not None
    assert theirs.decision.chosen.utility == 1  # of a frontier cell that was drawn
    assert ours.decision.chosen.utility < 1


def test_its_log_names_parent_step_and_change(parent: Recorded, child: EpisodeLog) -> None:
    said = child.header.branch
    assert said is not None
    assert (said.step, said.changes) == (K, ("planner=nearest",))
    assert len(said.parent_sha256) == 64
    assert [part.config.planner for part in lineage(child.header)] == ["random", "nearest"]
    assert child.header.at(K - 1).config == parent.header.config
    assert child.header.at(K).config == child.header.config


def test_it_is_verified_from_itself_and_by_running_it_again(child: EpisodeLog) -> None:
    for result in (verify(child), verify_rerun(child)):
        assert (result.agrees, result.steps, result.notes) == (True, len(child), ())
    assert not measure_log(child).disagreements


def test_a_branch_that_says_a_wrong_step_is_found(child: EpisodeLog, tmp_path: Path) -> None:
    assert child.header.branch is not None
    later = replace(child.header, branch=replace(child.header.branch, step=K + 5))
    with EpisodeWriter(tmp_path / "x.mcap", later) as writer:
        for step in child:
            writer.add(step)
    result = verify(EpisodeLog(tmp_path / "x.mcap"))
    assert not result.agrees
    assert result.differences[0].step == K


def test_branches_of_branches(child: EpisodeLog, tmp_path: Path) -> None:
    log = branched_log(child, K + 9, "planner=random", "seed=8", to=tmp_path / "x.mcap")
    assert [part.config.planner for part in lineage(log.header)] == ["random", "nearest", "random"]
    assert verify(log).agrees
    assert verify_rerun(log).agrees
    early = branched_log(child, 5, "planner=nearest", to=tmp_path / "y.mcap")
    assert [part.config.planner for part in lineage(early.header)] == ["random", "nearest"]
    assert verify_rerun(early).agrees


def test_the_metadata_comes_back(child: EpisodeLog, tmp_path: Path) -> None:
    log = branched_log(child, -2, "max-steps=50", to=tmp_path / "x.mcap")
    pairs = episode_pairs(log.header)
    assert episode_pairs(header_of(pairs, log.header.floor_plan)) == pairs


def test_what_is_passed_on_is_what_the_simulator_had(parent: Recorded) -> None:
    log = EpisodeLog(parent.path)
    episode = three_rooms()
    on = list(run_episode(episode, past_at(log, K)))
    assert len(on) == len(parent.steps) - K
    for ours, theirs in zip(on, parent.steps[K:], strict=True):
        assert differences(replace(ours, profile=None), replace(theirs, profile=None)) == []


def test_set_right_is_as_sure_and_never_wrong() -> None:
    truth = draw("#..#")
    claimed = FixedPredictor(np.array([[0.01, 0.99, 0.5, 0.9]], np.float32))
    right = SetRight(claimed, truth, Thresholds(0.9, 0.9), PredictionDtype.UINT8)
    p_wall = right.predict(truth)
    assert p_wall is not None
    assert p_wall.tolist() == [[1.0, 0.0, 0.5, pytest.approx(0.9)]]


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ((), "say with --with what is to change"),
        (("magic",), "--with magic: expected one of truth, observed, planner=..."),
        (("seed=1", "seed=2"), "seed is changed twice"),
        (("fail-safe=maybe",), "expected fail-safe=on or fail-safe=off"),
        (("truth",), "nothing was predicted that could be set right"),
        (("planner=nowhere",), "unknown planner 'nowhere'"),
        (("coverage=0.5",), "--with coverage=0.5: expected one of"),
    ],
)
def test_bad_changes_are_named(parent: Recorded, changes: tuple[str, ...], said: str) -> None:
    with pytest.raises(UsageError, match=said.replace("(", r"\(")):
        branch(EpisodeLog(parent.path), K, changes)


def test_values_out_of_range_are_named(parent: Recorded) -> None:
    with pytest.raises(ConfigError, match=r"delta_occupied = 1\.5"):
        branch(EpisodeLog(parent.path), K, ["delta-occupied=1.5"])


def test_a_step_that_is_not_there(parent: Recorded) -> None:
    with pytest.raises(UsageError, match="has steps 0 to"):
        branch(EpisodeLog(parent.path), 10_000, ["truth"])


def test_other_weights_are_refused(sealed: EpisodeLog) -> None:
    other = replace(BlurPredictor().identity, name="fixed")
    with pytest.raises(UsageError, match="recorded with other weights of fixed"):
        branch(sealed, 0, ["fail-safe=on"], predictor=BlurPredictor(other))


def test_a_branch_that_makes_no_sense_is_damage(child: EpisodeLog) -> None:
    pairs = episode_pairs(child.header)
    for wrong in ("{", "[]", '{"step": -1}', '{"step": 3, "parent_sha256": "", "changes": []}'):
        with pytest.raises((ValueError, KeyError, TypeError, LogError)):
            header_of(pairs | {"branch": wrong}, child.header.floor_plan)


def test_its_name(child: EpisodeLog) -> None:
    path = branch_path(Path("runs/x__s1.mcap.part"), child.header)
    assert path == Path(f"runs/x__s1.at{K}-planner=nearest.mcap")


def test_the_agent_of_a_branch_starts_where_the_parent_did(child: EpisodeLog) -> None:
    assert child[0].agent == child.header.start == Cell(*child.header.start)
