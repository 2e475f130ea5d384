"""Where two episodes part: a change in each layer of a step is found there, and nowhere else."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drawing import plan
from mapreplay.analysis.diff import divergence
from mapreplay.analysis.diff.causes import rating
from mapreplay.analysis.diff.divergence import Layer, find_divergences
from mapreplay.analysis.diff.pair import diff_frame, diff_logs, rest_of, spans_of
from mapreplay.config import EpisodeConfig
from mapreplay.episode import prepare_episode, run_episode
from mapreplay.errors import UsageError
from mapreplay.external import ExternalEpisode
from mapreplay.floorplans import open_source
from mapreplay.grid import Cell
from mapreplay.planners import Choice
from mapreplay.planning import Situation
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.recorders.log.writer import EpisodeWriter
from mapreplay.step import Candidate, Decision, EpisodeHeader, Mode, Outcome, Step
from recordings import THREE_ROOMS, BlurPredictor, three_rooms


def write(path: Path, header: EpisodeHeader, steps: list[Step]) -> EpisodeLog:
    with EpisodeWriter(path, header) as writer:
        for step in steps:
            writer.add(step)
    return EpisodeLog(path)


@pytest.fixture(scope="module")
def base(tmp_path_factory: pytest.TempPathFactory) -> EpisodeLog:
    episode = three_rooms(predictor="blur", planner="nearest", max_steps=12)
    return write(tmp_path_factory.mktemp("base") / "a.mcap", episode.header,
                 list(run_episode(episode)))  # fmt: skip


def flip(array: np.ndarray, value: object) -> np.ndarray:
    """A copy with another value in its first cell."""
    other = array.copy()
    other.flat[0] = value
    return other


def decision_of(step: Step) -> Decision:
    assert step.decision is not None
    return step.decision


def other_utility(step: Step) -> Step:
    chosen = decision_of(step).chosen
    chosen = replace(chosen, utility=float(np.nextafter(chosen.utility, 9)))
    return replace(step, decision=replace(decision_of(step), chosen=chosen))


def other_path(step: Step) -> Step:
    path = decision_of(step).path
    away = path.copy()
    away[1:, 0] += 1
    return replace(step, decision=replace(decision_of(step), path=away))


CHANGES: dict[Layer, Callable[[Step], Step]] = {
    Layer.OBSERVATION: lambda s: replace(s, observed=flip(s.observed, 0)),
    Layer.PREDICTION: lambda s: replace(s, p_wall=flip(s.p_wall, s.p_wall.flat[0] ^ 1)),  # type: ignore[union-attr, operator, arg-type]
    Layer.FUSED: lambda s: replace(s, fused=flip(s.fused, 0)),
    Layer.RANKING: other_utility,
    Layer.DECISION: lambda s: replace(s, decision=replace(decision_of(s), random_draw=7)),
    Layer.MOVE: other_path,
    Layer.END: lambda s: replace(s, decision=None, outcome=Outcome.SEALED_IN),
    Layer.RECORD: lambda s: replace(s, metrics=replace(s.metrics, iou=0.123)),
}  # fmt: skip


@pytest.mark.parametrize("layer", CHANGES)
def test_a_change_in_one_layer_is_found_in_that_layer(
    base: EpisodeLog, tmp_path: Path, layer: Layer
) -> None:
    steps = list(base)
    steps[5] = CHANGES[layer](steps[5])
    if layer is Layer.END:
        steps = steps[:6]
    other = write(tmp_path / "b.mcap", base.header, steps)
    divergences = find_divergences(base, other)
    assert divergences.layer is layer
    assert divergences.first[layer].index == 5
    assert not divergences.identical
    assert divergences.headers == ()
    diff = diff_logs(base, other)
    assert diff.cause is not None
    assert (diff.cause.step, diff.cause.layer) == (5, layer)
    assert diff.cause.text


def test_the_same_episode_twice_is_identical_and_one_bit_is_not(
    base: EpisodeLog, tmp_path: Path
) -> None:
    again = write(tmp_path / "again.mcap", base.header, list(base))
    assert find_divergences(base, again).identical
    assert diff_logs(base, again).causes == ()
    versions = replace(base.header, versions=(("mapreplay", "9"),))
    newer = find_divergences(base, write(tmp_path / "newer.mcap", versions, list(base)))
    assert newer.first == {}
    assert ("version mapreplay", "9") in [(s.what, s.b) for s in newer.headers]
    assert {s.what.split()[0] for s in newer.headers} == {"version"}
    assert not newer.identical


def test_causes_come_in_causal_order_within_a_step(base: EpisodeLog, tmp_path: Path) -> None:
    steps = list(base)
    for layer in (Layer.RANKING, Layer.FUSED, Layer.OBSERVATION):
        steps[3] = CHANGES[layer](steps[3])
    divergences = find_divergences(base, write(tmp_path / "b.mcap", base.header, steps))
    assert list(divergences.first) == [Layer.OBSERVATION, Layer.FUSED, Layer.RANKING]


def test_who_has_a_larger_budget_goes_on(tmp_path: Path) -> None:
    logs = []
    for steps in (3, 6):
        episode = three_rooms(max_steps=steps)
        logs.append(write(tmp_path / f"{steps}.mcap", episode.header, list(run_episode(episode))))
    divergences = find_divergences(*logs)
    assert divergences.layer is Layer.END
    assert divergences.first[Layer.END].index == 3
    assert {s.what for s in divergences.headers} == {"budget"}
    cause = diff_logs(*logs).cause
    assert cause is not None
    assert cause.text == "A ended (out_of_steps), the other continues"


CROSSROADS = """
    ###########
    #.........#
    ####.######
    ####.######
    #.........#
    #.........#
    #.........#
    ###########
"""


def test_planners_part_in_what_they_want_and_the_margins_are_told(tmp_path: Path) -> None:
    floor_plan = plan(CROSSROADS, "crossroads")
    logs = []
    for planner in ("nearest", "cost-utility"):
        config = EpisodeConfig(planner=planner, reach=2, start=(3, 1), max_steps=40)
        episode = prepare_episode(config, floor_plan, predictor=BlurPredictor())
        logs.append(write(tmp_path / f"{planner}.mcap", episode.header, list(run_episode(episode))))
    diff = diff_logs(*logs)
    texts = {cause.layer: cause for cause in diff.causes}
    decision = texts[Layer.DECISION]
    assert decision.text.startswith("both saw the same map; A chose (")
    step_a, step_b = logs[0][decision.step], logs[1][decision.step]
    chosen = decision_of(step_a).chosen
    theirs = rating(logs[1], step_b, None, chosen.cell)
    assert theirs is not None
    assert (
        f"B's gain there was {theirs.reward:.4g}, its utility {theirs.utility:.4g}" in decision.text
    )
    assert {s.what for s in diff.headers} == {"planner"}
    assert diff_frame(diff).filter(of="parting").height == len(diff.causes)


def test_two_random_runs_part_by_the_draw_and_not_by_the_ranking(tmp_path: Path) -> None:
    logs = []
    for seed in (1, 2, 3):
        episode = three_rooms(planner="random", seed=seed, max_steps=12)
        steps = list(run_episode(episode))
        logs.append(write(tmp_path / f"{seed}.mcap", episode.header, steps))
    for other, seed in zip(logs[1:], (2, 3), strict=True):
        diff = diff_logs(logs[0], other)
        assert diff.cause is not None
        assert (diff.cause.step, diff.cause.layer) == (0, Layer.DECISION)
        assert f"the draw differs (seed 1 in A, {seed} in B)" in diff.cause.text
        assert Layer.RANKING not in {cause.layer for cause in diff.causes}


def rated(chosen: int, *others: int, utilities: dict[int, float] | None = None) -> Decision:
    """A decision for the cell (0, chosen) with the rivals (0, ...); a column is a cost."""
    worth = utilities or {}
    candidates = [Candidate(Cell(0, c), worth.get(c, 1.0), 1.0, c, 0) for c in (chosen, *others)]
    return Decision(
        candidates[0], np.zeros((2, 2), np.int32), Mode.NORMAL, tuple(candidates[1:]), 5
    )


@pytest.mark.parametrize(
    ("a", "b", "alike"),
    [
        (rated(9, 1, 2, 3, 4, 5), rated(8, 1, 2, 3, 4, 5), True),  # both far: not listed there
        (rated(9, 1, 2, 3, 4, 5), rated(2, 1, 3, 4, 5, 6), True),
        (rated(1, 2, 3), rated(3, 1, 2), True),
        (rated(9, 1, 2, 3, 4, 5), rated(9, 5, 4, 3, 2, 1), True),  # whatever their order
        (rated(9, 1, 2, 3, 4, 5), rated(8, 1, 2, 4, 5, 6), False),  # 3 would be listed
        (rated(9, 1, 2, 3, 4, 5), rated(0, 1, 2, 3, 4, 5), False),  # 0 is nearer than all of A's
        (rated(1, 2, 3), rated(1, 2, 3, utilities={3: 0.5}), False),
        (rated(1, 2, 3), rated(1, 2, 4), False),  # all are listed
    ],
)  # fmt: skip
def test_rankings_are_compared_as_far_as_both_are_logged(
    a: Decision, b: Decision, alike: bool
) -> None:
    for one, other in ((a, b), (b, a)):
        assert divergence._rated_alike(one, other) is alike


def test_any_frontier_cell_can_be_rated_again_as_it_was(tmp_path: Path) -> None:
    floor_plan = open_source("procedural:60002").load("procedural-60002")
    asked: list[tuple[Situation, Choice]] = []
    config = EpisodeConfig(planner="cost-utility", max_steps=3)
    episode = prepare_episode(config, floor_plan, predictor=BlurPredictor())

    class Spy:
        def choose(self, situation: Situation) -> Choice:
            asked.append((situation, episode.planner.choose(situation)))
            return asked[-1][1]

    log = write(
        tmp_path / "log.mcap", episode.header, list(run_episode(replace(episode, planner=Spy())))
    )
    situation, choice = asked[2]
    assert len(situation.frontier) > 6  # more than are logged
    step, before = log[2], log[1].decision
    for i, cell in enumerate(map(tuple, situation.frontier.tolist())):
        rated = rating(log, step, before, cell)  # type: ignore[arg-type]
        assert rated is not None
        assert (rated.utility, rated.reward) == (choice.utility[i], choice.reward[i])
        assert rated.cost == situation.costs[i]
    assert rating(log, step, before, (0, 0)) is None  # type: ignore[arg-type]


def test_episodes_of_other_simulators_part_where_their_poses_do(tmp_path: Path) -> None:
    floor_plan = plan(THREE_ROOMS, "three-rooms")
    logs = []
    for name, column in (("a", 3), ("b", 4)):
        episode = ExternalEpisode(floor_plan, (5, 2), planner="theirs")
        observed = floor_plan.cells
        steps = [episode.step(cell, observed) for cell in [(5, 2), (5, 3), (6, column)]]
        steps.append(episode.step((7, 3), observed, outcome="mapped"))
        logs.append(write(tmp_path / f"{name}.mcap", episode.header, steps))
    divergences = find_divergences(*logs)
    assert divergences.layer is Layer.MOVE
    assert divergences.first[Layer.MOVE].index == 2
    cause = diff_logs(*logs).cause
    assert cause is not None
    assert cause.text == "A is at (6, 3), B at (6, 4)"


def test_other_floor_plans_are_refused_even_of_the_same_name(
    base: EpisodeLog, tmp_path: Path
) -> None:
    other = prepare_episode(
        EpisodeConfig(max_steps=2), plan("####\n#..#\n####", base.header.floor_plan.id)
    )
    log = write(tmp_path / "other.mcap", other.header, list(run_episode(other)))
    with pytest.raises(UsageError, match="on three-rooms, of the same name but with other cells"):
        diff_logs(base, log)


def test_where_the_time_went_by_hand() -> None:
    curve = np.array([0.1, 0.5, 0.5, 0.7, 0.7, 0.7])
    assert spans_of(curve, [0.5, 0.6, 0.7]) == [1, 2, 0]
    assert np.isnan(spans_of(curve, [0.5, 0.9])[1])
    assert rest_of(curve, [0.5, 0.6, 0.7]) == 2
    assert rest_of(curve, [0.9]) == 5
    # However the levels are chosen, no step is lost or counted twice.
    assert sum(spans_of(curve, [0.5, 0.7])) + rest_of(curve, [0.5, 0.7]) == len(curve) - 1
