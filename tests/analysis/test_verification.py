"""A true log passes, and each kind of lie is named: step, topic, cell and both values."""

import itertools
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drawing import plan
from fakes import ConstantPredictor, FixedPredictor, NoisyPredictor
from mapreplay.analysis.diff.steps import Difference, step_differences
from mapreplay.analysis.verification import Verification, verify, verify_rerun, verify_step
from mapreplay.config import EpisodeConfig, MapKind
from mapreplay.episode import Episode, prepare_episode, run_episode
from mapreplay.errors import LogError, PluginError
from mapreplay.floorplan import FloorPlan
from mapreplay.floorplans.procedural import generate
from mapreplay.grid import OCCUPIED, UNKNOWN, Cell
from mapreplay.mapping import PredictionDtype
from mapreplay.planners import RULES, Choice, Planner
from mapreplay.planning import Situation
from mapreplay.predictors import NoPredictor, Predictor
from mapreplay.recorders.log import step_table
from mapreplay.recorders.log.header import outcome_pairs
from mapreplay.recorders.log.mcap.writer import ContainerWriter
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.recorders.log.writer import EpisodeWriter
from mapreplay.step import (
    FIRST_STAMP_NS,
    STEP_NS,
    Decision,
    EpisodeHeader,
    EventKind,
    Mode,
    Outcome,
    Step,
    StepMetrics,
)
from recordings import THREE_ROOMS, BlurPredictor, Recorded

K = 23
"""The step at which all lies are told: in the second chunk."""


def prepare(predictor: Predictor, floor_plan: FloorPlan | None = None, **config: object) -> Episode:
    """An episode whose configuration names the predictor that is used."""
    values = {"predictor": predictor.identity.name, "reach": 6, "max_steps": 60, "seed": 3}
    return prepare_episode(
        EpisodeConfig.of(values | config),
        floor_plan or plan(THREE_ROOMS, "three-rooms", resolution=0.2),
        predictor=predictor,
    )


def write(folder: Path, header: EpisodeHeader, steps: list[Step]) -> EpisodeLog:
    path = folder / "episode.mcap"
    with EpisodeWriter(path, header, force=True) as writer:
        for step in steps:
            writer.add(step)
    return EpisodeLog(path if path.exists() else writer.part)


def record(folder: Path, episode: Episode) -> EpisodeLog:
    return write(folder, episode.header, list(run_episode(episode)))


@pytest.fixture(scope="module")
def true(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """Cost-utility on fused maps: every field of a step is used."""
    episode = prepare(BlurPredictor(), coverage=1.0)
    steps = list(run_episode(episode))
    log = write(tmp_path_factory.mktemp("true"), episode.header, steps)
    return Recorded(log.path, episode.header, steps)


@pytest.fixture(scope="module")
def noisy(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """All metrics are defined."""
    episode = prepare(NoisyPredictor(), coverage=1.0)
    steps = list(run_episode(episode))
    log = write(tmp_path_factory.mktemp("noisy"), episode.header, steps)
    return Recorded(log.path, episode.header, steps)


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """Random exploration."""
    episode = prepare(NoPredictor(), planner="random")
    steps = list(run_episode(episode))
    log = write(tmp_path_factory.mktemp("drawn"), episode.header, steps)
    return Recorded(log.path, episode.header, steps)


def tell(
    recorded: Recorded, folder: Path, k: int, change: Callable[[Step], Step]
) -> tuple[Difference, ...]:
    """What is named when one step of a true log is changed."""
    steps = list(recorded.steps)
    steps[k] = change(steps[k])
    return verify(write(folder, recorded.header, steps)).differences


def decision_of(step: Step) -> Decision:
    assert step.decision is not None
    return step.decision


# True logs


def test_a_true_log_agrees(true: Recorded) -> None:
    assert verify(EpisodeLog(true.path)) == Verification(len(true.steps), (), 0, ())


@settings(max_examples=40, deadline=None)
@given(
    rows=st.lists(st.text("#....", min_size=7, max_size=12), min_size=4, max_size=10),
    planner=st.sampled_from(["random", "nearest", "cost-utility"]),
    plan_on=st.sampled_from(MapKind),
    build=st.sampled_from(MapKind),
    dtype=st.sampled_from(PredictionDtype),
    predictor=st.sampled_from(
        [NoPredictor(), NoisyPredictor(), ConstantPredictor(1.0), BlurPredictor()]
    ),
    delta=st.sampled_from([0.5, 0.9, 1.0]),
    fail_safe=st.booleans(),
)
def test_whatever_was_run_is_true(
    rows: list[str],
    planner: str,
    plan_on: MapKind,
    build: MapKind,
    dtype: PredictionDtype,
    predictor: Predictor,
    delta: float,
    fail_safe: bool,
) -> None:
    width = min(map(len, rows))
    picture = "\n".join([*(row[:width] for row in rows), "." * width])
    episode = prepare(
        predictor, plan(picture), planner=planner, plan_on=plan_on, build=build, reach=2,
        prediction_dtype=dtype, delta_free=delta, delta_occupied=delta, fail_safe=fail_safe,
        max_steps=None,
    )  # fmt: skip
    with TemporaryDirectory() as folder:
        log = record(Path(folder), episode)
        assert verify(log) == Verification(len(log), (), 0, ())


def test_an_unfinished_log_is_verified_as_far_as_it_goes(true: Recorded, tmp_path: Path) -> None:
    log = write(tmp_path, true.header, true.steps[:30])
    assert verify(log) == Verification(30, (), 0, ())


RING = """
    ###########
    #.........#
    #.#######.#
    #.#.....#.#
    #.#.###.#.#
    #...#.....#
    ###########
"""


def test_the_fail_safe_and_its_events_are_true(tmp_path: Path) -> None:
    """Walls are believed on both sides of the start: sealed in, and released where seen."""
    p_wall = np.full((7, 11), 0.5, np.float32)
    p_wall[4:7, 3] = p_wall[3, 0:3] = 1.0
    episode = prepare(FixedPredictor(p_wall), plan(RING), fail_safe=True, reach=1)
    steps = list(run_episode(episode))
    assert {step.mode for step in steps} == set(Mode)
    assert {EventKind.SEALED_IN, EventKind.RELEASED} <= {e.kind for s in steps for e in s.events}
    log = write(tmp_path, episode.header, steps)
    assert verify(log) == Verification(len(log), (), 0, ())


# Lies


def test_a_cell_of_the_observed_map(true: Recorded, tmp_path: Path) -> None:
    cell = Cell(*np.argwhere(true.steps[K].observed == UNKNOWN)[0].tolist())

    def lie(step: Step) -> Step:
        observed = step.observed.copy()
        observed[cell] = OCCUPIED
        return replace(step, observed=observed)

    (found,) = tell(true, tmp_path, K, lie)
    assert found == Difference(K, "/map/observed", "cell", cell, OCCUPIED, UNKNOWN)
    assert str(found) == (
        f"step 23: /map/observed cell ({cell.row}, {cell.col}): logged 100, expected -1"
    )


def test_cells_of_the_fused_map(true: Recorded, tmp_path: Path) -> None:
    free = [Cell(*cell) for cell in np.argwhere(true.steps[K].fused == 0)[:3].tolist()]

    def lie(step: Step) -> Step:
        fused = step.fused.copy()
        fused[tuple(np.transpose(free))] = OCCUPIED
        return replace(step, fused=fused)

    (found,) = tell(true, tmp_path, K, lie)
    assert found == Difference(K, "/map/fused", "cell", free[0], OCCUPIED, 0, more=2)
    assert str(found).endswith("logged 100, expected 0 (and 2 more)")


def test_a_prediction_across_a_threshold(true: Recorded, tmp_path: Path) -> None:
    """The map and the metrics that were made from it are not those that it makes."""
    cell = Cell(*np.argwhere(true.steps[K].fused == UNKNOWN)[0].tolist())

    def lie(step: Step) -> Step:
        assert step.p_wall is not None
        p_wall = step.p_wall.copy()
        p_wall[cell] = 0
        return replace(step, p_wall=p_wall)

    found = tell(true, tmp_path, K, lie)
    assert {difference.step for difference in found} == {K}
    assert found[0] == Difference(K, "/map/fused", "cell", cell, UNKNOWN, 0)
    assert {"/map/fused", "/metrics"} <= {str(difference.topic) for difference in found}


@pytest.mark.parametrize("value", [1.5, -0.25, np.nan, np.inf])
def test_a_prediction_that_is_no_probability(tmp_path: Path, value: float) -> None:
    episode = prepare(NoisyPredictor(), prediction_dtype="float32", delta_free=1, delta_occupied=1)
    steps = list(run_episode(episode))
    p_wall = np.array(steps[2].p_wall)
    p_wall[4, 5] = value
    steps[2] = replace(steps[2], p_wall=p_wall)
    with np.errstate(invalid="ignore"):  # its preview is undefined, too
        log = write(tmp_path, episode.header, steps)
    named = rf"step 2: /map/p_wall: {value} at cell \(4, 5\) is no probability"
    with pytest.raises(LogError, match=named):
        verify(log)


def test_a_prediction_of_another_type(true: Recorded, tmp_path: Path) -> None:
    """Everything else is true of it, but the configuration says uint8."""
    episode = prepare(BlurPredictor(), prediction_dtype="uint16", max_steps=2)
    config = episode.header.config.model_copy(update={"prediction_dtype": PredictionDtype.UINT8})
    header = replace(episode.header, config=config)
    result = verify(write(tmp_path, header, list(run_episode(episode))))
    assert result.count == 3
    assert result.differences[0] == Difference(0, "/map/p_wall", "type", None, "uint16", "uint8")


def test_a_hit(true: Recorded, tmp_path: Path) -> None:
    was = int(true.steps[K].hits[3])
    now = 1 if was != 1 else 2

    def lie(step: Step) -> Step:
        hits = step.hits.copy()
        hits[3] = now
        return replace(step, hits=hits)

    assert tell(true, tmp_path, K, lie) == (Difference(K, "/scan", "ray 3", None, now, was),)


def test_a_pose_that_is_not_where_the_move_led(true: Recorded, tmp_path: Path) -> None:
    elsewhere, was = true.header.start, true.steps[K].agent
    found = tell(true, tmp_path, K, lambda step: replace(step, agent=elsewhere))
    assert found == (Difference(K, "/pose", "agent", None, elsewhere, was),)
    assert str(found[0]) == (
        f"step 23: /pose agent: logged ({elsewhere.row}, {elsewhere.col}), "
        f"expected ({was.row}, {was.col})"
    )


def test_another_start(true: Recorded, tmp_path: Path) -> None:
    found = tell(true, tmp_path, 0, lambda step: replace(step, agent=Cell(5, 5)))
    assert found == (Difference(0, "/pose", "agent", None, Cell(5, 5), true.header.start),)


@pytest.mark.parametrize("away", [(0, 2), (0, 0)])
def test_an_illegal_move(true: Recorded, tmp_path: Path, away: tuple[int, int]) -> None:
    agent = true.steps[K].agent
    there = Cell(agent.row + away[0], agent.col + away[1])

    def lie(step: Step) -> Step:
        path = decision_of(step).path.copy()
        path[1] = there
        return replace(step, decision=replace(decision_of(step), path=path))

    found = tell(true, tmp_path, K, lie)
    was = decision_of(true.steps[K]).next_cell
    wanted = f"a free neighbour of ({agent.row}, {agent.col})"
    assert found == (
        Difference(K, "/plan", "pose 1", None, there, was),
        Difference(K, "/plan", "move", None, there, wanted),
    )


def test_a_move_into_a_wall_that_was_made(true: Recorded, tmp_path: Path) -> None:
    """From there nothing can be made again, and that is said."""
    steps = list(true.steps)
    walls = np.argwhere(true.header.floor_plan.cells == OCCUPIED)
    wall = Cell(*walls[0].tolist())
    path = decision_of(steps[K]).path.copy()
    path[1] = wall
    steps[K] = replace(steps[K], decision=replace(decision_of(steps[K]), path=path))
    steps[K + 1] = replace(steps[K + 1], agent=wall)
    result = verify(write(tmp_path, true.header, steps))
    assert result.steps == K + 1
    assert [d.topic for d in result.differences] == ["/plan", "/plan", "/pose"]
    assert result.notes == (f"step {K + 1} and later: not checked",)


def test_a_move_into_a_wall_next_to_the_agent(true: Recorded, tmp_path: Path) -> None:
    start = true.header.start
    wall = Cell(start.row + 1, start.col)

    def lie(step: Step) -> Step:
        path = decision_of(step).path.copy()
        path[1] = wall
        return replace(step, decision=replace(decision_of(step), path=path))

    assert [(d.what, d.logged) for d in tell(true, tmp_path, 0, lie)] == [
        ("pose 1", wall), ("move", wall),
    ]  # fmt: skip


def test_a_path_without_a_move(true: Recorded, tmp_path: Path) -> None:
    def lie(step: Step) -> Step:
        decision = decision_of(step)
        return replace(step, decision=replace(decision, path=decision.path[:1]))

    with pytest.raises(LogError, match=f"step {K}: /plan: a path of 1 cells"):
        tell(true, tmp_path, K, lie)


def test_another_target(true: Recorded, tmp_path: Path) -> None:
    decision = decision_of(true.steps[K])
    rival = decision.rivals[0]
    found = tell(
        true, tmp_path, K, lambda step: replace(step, decision=replace(decision, chosen=rival))
    )
    assert found == (
        Difference(K, "/decision", "target", None, rival.cell, decision.target),
    )  # fmt: skip


def test_swapped_rivals(true: Recorded, tmp_path: Path) -> None:
    decision = decision_of(true.steps[K])
    first, second, *others = decision.rivals
    swapped = replace(decision, rivals=(second, first, *others))
    found = tell(true, tmp_path, K, lambda step: replace(step, decision=swapped))
    assert found == (
        Difference(K, "/decision", "rival 0", None, second.cell, first.cell),
        Difference(K, "/decision", "rival 1", None, first.cell, second.cell),
    )


def test_a_missing_rival(true: Recorded, tmp_path: Path) -> None:
    decision = decision_of(true.steps[K])
    fewer = replace(decision, rivals=decision.rivals[:-1])
    found = tell(true, tmp_path, K, lambda step: replace(step, decision=fewer))
    last = len(decision.rivals) - 1
    assert found == (
        Difference(K, "/decision", f"rival {last}", None, None, decision.rivals[-1].cell),
    )


@pytest.mark.parametrize("field", ["utility", "reward"])
def test_a_utility_by_its_last_bit(true: Recorded, tmp_path: Path, field: str) -> None:
    decision = decision_of(true.steps[K])
    was = getattr(decision.chosen, field)
    now = float(np.nextafter(was, np.inf))
    value: dict[str, Any] = {field: now}
    changed = replace(decision, chosen=replace(decision.chosen, **value))
    (found,) = tell(true, tmp_path, K, lambda step: replace(step, decision=changed))
    assert found == Difference(K, "/decision", f"target's {field}", decision.target, now, was)
    assert repr(now) in str(found)
    assert repr(was) in str(found)


def test_a_mode(true: Recorded, tmp_path: Path) -> None:
    changed = replace(decision_of(true.steps[K]), mode=Mode.FAIL_SAFE)
    found = tell(true, tmp_path, K, lambda step: replace(step, decision=changed))
    assert found == (Difference(K, "/decision", "mode", None, "fail-safe", "normal"),)


def test_a_random_draw(drawn: Recorded, tmp_path: Path) -> None:
    k, was = next(
        (s.index, s.decision.random_draw) for s in drawn.steps if s.decision and s.index > 0
        and s.decision.random_draw is not None
    )  # fmt: skip
    assert was is not None
    changed = replace(decision_of(drawn.steps[k]), random_draw=was ^ 1)
    found = tell(drawn, tmp_path, k, lambda step: replace(step, decision=changed))
    assert found == (Difference(k, "/decision", "random_draw", None, was ^ 1, was),)
    claimed = next(s.index for s in drawn.steps if s.decision and s.decision.random_draw is None)
    changed = replace(decision_of(drawn.steps[claimed]), random_draw=7)
    found = tell(drawn, tmp_path, claimed, lambda step: replace(step, decision=changed))
    assert found == (Difference(claimed, "/decision", "random_draw", None, 7, None),)


def test_a_frontier_cell_too_few_and_one_too_many(true: Recorded, tmp_path: Path) -> None:
    cells = true.steps[K].frontier
    last = Cell(*cells[-1].tolist())
    found = tell(true, tmp_path, K, lambda step: replace(step, frontier=cells[:-1]))
    assert found == (Difference(K, "/frontier", "cell", last, None, "frontier"),)
    more = np.vstack([[[0, 0]], cells]).astype(np.int32)
    found = tell(true, tmp_path, K, lambda step: replace(step, frontier=more))
    assert found == (Difference(K, "/frontier", "cell", Cell(0, 0), "frontier", None),)
    found = tell(true, tmp_path, K, lambda step: replace(step, frontier=cells[::-1].copy()))
    assert found == (Difference(K, "/frontier", "order", None, "another", "row-major"),)


@pytest.mark.parametrize("name", StepMetrics.names())
def test_a_metric_by_its_last_bit(noisy: Recorded, tmp_path: Path, name: str) -> None:
    was = getattr(noisy.steps[K].metrics, name)
    now = float(np.nextafter(was, 0.501))
    metrics = replace(noisy.steps[K].metrics, **{name: now})
    found = tell(noisy, tmp_path, K, lambda step: replace(step, metrics=metrics))
    assert found == (Difference(K, "/metrics", name, None, now, was),)


def test_a_metric_where_it_is_undefined(drawn: Recorded, tmp_path: Path) -> None:
    metrics = replace(drawn.steps[K].metrics, brier=0.0)
    (found,) = tell(drawn, tmp_path, K, lambda step: replace(step, metrics=metrics))
    assert str(found) == "step 23: /metrics brier: logged 0.0, expected nan"


def test_the_outcome(true: Recorded, tmp_path: Path) -> None:
    last = true.steps[-1]
    was = last.outcome
    now = next(outcome for outcome in Outcome if outcome is not was)
    found = tell(true, tmp_path, last.index, lambda step: replace(step, outcome=now))
    assert found == (Difference(last.index, "/metrics", "outcome", None, now, was),)


def test_an_end_before_the_end(true: Recorded, tmp_path: Path) -> None:
    """A log that was cut off, and given an outcome."""
    steps = true.steps[:K]
    steps.append(replace(true.steps[K], outcome=Outcome.SEALED_IN, decision=None))
    found = verify(write(tmp_path, true.header, steps)).differences
    assert [(d.step, d.what, d.logged) for d in found] == [
        (K, "target", None), (K, "outcome", "sealed_in"),
    ]  # fmt: skip


def test_a_stamp(true: Recorded, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stamp = Step.stamp_ns.fget  # type: ignore[attr-defined]
    add = ContainerWriter.add_message

    def add_in_time(self: ContainerWriter, channel: int, k: int, _: int, data: bytes) -> None:
        # A message that is logged at another time is refused when it is read.
        add(self, channel, k, FIRST_STAMP_NS + k * STEP_NS, data)

    with monkeypatch.context() as lying:
        lying.setattr(ContainerWriter, "add_message", add_in_time)
        lying.setattr(Step, "stamp_ns", property(lambda step: stamp(step) + (step.index == K)))
        log = write(tmp_path, true.header, true.steps)
    found = verify(log, shown=100).differences
    assert {str(d.topic) for d in found} == {
        "/tf", "/pose", "/scan", "/map/observed", "/map/p_wall", "/map/predicted", "/map/fused",
        "/frontier", "/plan", "/decision", "/metrics",
    }  # fmt: skip
    assert {(d.step, d.what, d.logged, d.expected) for d in found} == {
        (K, "stamp", 3_300_000_001, 3_300_000_000)
    }


def test_an_event(true: Recorded, tmp_path: Path) -> None:
    k = next(step.index for step in true.steps if step.events)
    event = true.steps[k].events[0]
    found = tell(true, tmp_path, k, lambda step: replace(step, events=()))
    assert found == (
        Difference(k, "/events", "event 0", None, None, f"{event.kind}: {event.text}"),
    )


def test_the_budget_and_the_start_in_the_metadata(true: Recorded, tmp_path: Path) -> None:
    header = replace(true.header, max_steps=61)
    found = verify(write(tmp_path, header, true.steps[:10])).differences
    assert found == (Difference(None, "mapreplay.episode", "max_steps", None, 61, 60),)
    assert str(found[0]) == "mapreplay.episode max_steps: logged 61, expected 60"
    header = replace(true.header, start=Cell(5, 5))
    found = verify(write(tmp_path, header, true.steps[:10])).differences
    assert found[0].logged == Cell(5, 5)
    assert found[0].expected == true.header.start


def test_the_summary_and_the_attachment(
    true: Recorded, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    row_of = step_table.row_of
    with monkeypatch.context() as lying:
        lying.setattr(
            step_table, "row_of", lambda step: (*row_of(step)[:-1], float(step.index == 4))
        )
        lying.setattr(
            "mapreplay.recorders.log.writer.outcome_pairs",
            lambda summary, _: outcome_pairs(replace(summary, correct_time=17)),
        )
        log = write(tmp_path, true.header, true.steps)
    found = verify(log).differences
    name = StepMetrics.names()[-1]
    wrong = [step.index for step in true.steps if row_of(step)[-1] != float(step.index == 4)]
    assert found[0] == Difference(
        wrong[0], "steps.parquet", name, None, 0.0, row_of(true.steps[wrong[0]])[-1]
    )
    result = verify(log, shown=1000)
    assert result.differences[-1].topic == "mapreplay.outcome"
    assert (result.differences[-1].what, result.differences[-1].logged) == ("correct_time", 17)


def test_the_first_are_shown_and_all_are_counted(true: Recorded, tmp_path: Path) -> None:
    steps = [replace(s, metrics=replace(s.metrics, path_length=1.2345)) for s in true.steps]
    log = write(tmp_path, true.header, steps)
    result = verify(log, shown=4)
    assert result.count == len(steps)
    assert [difference.step for difference in result.differences] == [0, 1, 2, 3]
    assert not result.agrees


def test_other_versions_may_explain_a_difference(true: Recorded, tmp_path: Path) -> None:
    header = replace(true.header, versions=(("numpy", "0.1"), ("rules", RULES)))
    assert verify(write(tmp_path, header, true.steps)).notes == ()
    lie = replace(true.steps[0], frontier=true.steps[0].frontier[1:])
    (note,) = verify(write(tmp_path, header, [lie, *true.steps[1:]])).notes
    assert note == f"recorded with numpy 0.1 (here {np.__version__})"


class Farthest:
    """A planner that nobody else has."""

    def choose(self, situation: Situation) -> Choice:
        costs = situation.costs
        return Choice(int(np.argmax(costs)), costs, costs)


def test_without_the_planner_all_but_its_choices_is_checked(tmp_path: Path) -> None:
    farthest: Planner = Farthest()
    episode = replace(prepare(NoPredictor(), max_steps=30), planner=farthest)
    config = episode.header.config.model_copy(update={"planner": "farthest"})
    header = replace(episode.header, config=config)
    steps = list(run_episode(replace(episode, header=header)))
    note = "planner 'farthest' is not installed: decisions not checked"
    assert verify(write(tmp_path, header, steps)) == Verification(len(steps), (), 0, (note,))
    steps[5] = replace(steps[5], hits=np.zeros_like(steps[5].hits))
    moved = decision_of(steps[6])
    steps[6] = replace(steps[6], decision=replace(moved, mode=Mode.FAIL_SAFE))
    found = verify(write(tmp_path, header, steps)).differences
    assert [(d.step, d.topic) for d in found] == [(5, "/scan"), (6, "/decision")]
    with pytest.raises(PluginError, match="unknown planner 'farthest'"):
        verify_rerun(write(tmp_path, header, steps))


def test_a_step_is_compared_with_itself(true: Recorded) -> None:
    assert not any(list(step_differences(step, step)) for step in true.steps)


# Running again


@pytest.fixture
def installed_blur(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The predictor ``blur`` as a plug-in."""
    site = tmp_path / "site"
    info = site / "blur-1.0.dist-info"
    info.mkdir(parents=True)
    (site / "blur_plugin.py").write_text(
        "from recordings import BlurPredictor\n\ndef blur(device):\n    return BlurPredictor()\n"
    )
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: blur\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[mapreplay.predictors]\nblur = blur_plugin:blur\n")
    monkeypatch.syspath_prepend(str(site))


@pytest.mark.parametrize("planner", ["random", "nearest", "cost-utility"])
def test_running_again_gives_the_same(tmp_path: Path, planner: str) -> None:
    episode = prepare(NoPredictor(), planner=planner, plan_on="observed", build="observed")
    log = record(tmp_path, episode)
    assert verify_rerun(log) == Verification(len(log), (), 0, ())


@pytest.mark.parametrize("dtype", PredictionDtype)
def test_running_again_with_a_prediction(
    installed_blur: None, tmp_path: Path, dtype: PredictionDtype
) -> None:
    log = record(tmp_path, prepare(BlurPredictor(), prediction_dtype=dtype, max_steps=25))
    assert verify_rerun(log) == Verification(len(log), (), 0, ())
    for k in (0, 1, 12, len(log) - 1):
        assert verify_step(log, k) == Verification(1, (), 0, ())


def test_any_step_can_be_run_again(drawn: Recorded) -> None:
    """Also where a random target is kept, and at the end."""
    log = EpisodeLog(drawn.path)
    assert all(verify_step(log, k).agrees for k in range(len(log)))


def test_a_prediction_that_the_predictor_does_not_make(
    installed_blur: None, true: Recorded, tmp_path: Path
) -> None:
    """One quantum in one observed cell: no map, and no decision is another."""
    cell = Cell(*np.argwhere(true.steps[K].observed == OCCUPIED)[0].tolist())
    p_wall = true.steps[K].p_wall
    assert p_wall is not None
    forged = p_wall.copy()
    forged[cell] ^= 1
    steps = list(true.steps)
    steps[K] = replace(steps[K], p_wall=forged)
    log = write(tmp_path, true.header, steps)
    expected = Difference(K, "/map/p_wall", "cell", cell, int(forged[cell]), int(p_wall[cell]))
    assert verify_rerun(log).differences == (expected,)
    assert verify_step(log, K).differences == (expected,)
    assert verify_step(log, K - 1).agrees


def test_a_forgery_that_is_true_to_itself(installed_blur: None, tmp_path: Path) -> None:
    """Recorded with another predictor under the same name and hash."""
    forger = NoisyPredictor(BlurPredictor().identity)
    log = record(tmp_path, prepare(forger, max_steps=10))
    assert verify(log).agrees
    result = verify_rerun(log)
    assert not result.agrees
    assert (result.differences[0].step, result.differences[0].topic) == (0, "/map/p_wall")


def test_other_weights_are_named_first(installed_blur: None, tmp_path: Path) -> None:
    identity = replace(BlurPredictor().identity, sha256="1" * 64)
    log = record(tmp_path, prepare(BlurPredictor(identity), max_steps=5))
    expected = Difference(None, "mapreplay.episode", "predictor_sha256", None, "1" * 64, "0" * 64)
    assert verify_rerun(log) == Verification(0, (expected,), 1, ())
    assert verify_step(log, 2).differences == (expected,)


def test_a_log_that_goes_on_after_the_end(tmp_path: Path) -> None:
    episode = prepare(NoPredictor(), max_steps=8)
    longer = list(run_episode(prepare(NoPredictor(), max_steps=12)))
    log = write(tmp_path, episode.header, longer)
    for result in (verify(log), verify_rerun(log)):
        assert result.differences[0] == Difference(
            8, "/decision", "target", None, decision_of(longer[8]).target, None
        )


def test_a_step_that_is_no_state_to_go_on_from(true: Recorded, tmp_path: Path) -> None:
    steps = [*true.steps[:4], replace(true.steps[4], agent=Cell(0, 0))]
    log = write(tmp_path, true.header, steps)
    with pytest.raises(PluginError):
        verify_step(log, 4)
    episode = prepare(NoPredictor())
    steps = list(itertools.islice(run_episode(episode), 5))
    steps[4] = replace(steps[4], agent=Cell(0, 0))
    log = write(tmp_path, episode.header, steps)
    with pytest.raises(LogError, match=r"step 4 is no state to go on from \(the agent is at"):
        verify_step(log, 4)
    with pytest.raises(IndexError):
        verify_step(log, 5)


def test_the_trained_predictor_runs_again(tmp_path: Path) -> None:
    """The real network: the same weights give the same bytes."""
    config = EpisodeConfig.of({"predictor": "d1", "max_steps": 3})
    log = record(tmp_path, prepare_episode(config, generate(60000)))
    assert verify(log).agrees
    assert verify_rerun(log) == Verification(4, (), 0, ())
    assert verify_step(log, 2).agrees
