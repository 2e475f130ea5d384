"""Whole episodes: configurations, outcomes, the fail-safe, and what can never happen."""

from collections.abc import Callable
from itertools import groupby, pairwise

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drawing import draw, plan
from fakes import ConstantPredictor, FixedPredictor, NoisyPredictor
from mapreplay.config import EpisodeConfig, MapKind
from mapreplay.episode import prepare_episode, record, recorded, run_episode
from mapreplay.errors import MapreplayError
from mapreplay.floorplan import FloorPlan
from mapreplay.floorplans.procedural import generate
from mapreplay.grid import FREE, OCCUPIED, UNKNOWN, Grid
from mapreplay.mapping import PredictionDtype, quantize
from mapreplay.planners import Choice, Planner
from mapreplay.planners.cost_utility import CostUtility
from mapreplay.planners.nearest import NearestFrontier
from mapreplay.planners.random import RandomExploration
from mapreplay.planning import Situation
from mapreplay.predictors import NoPredictor, Predictor
from mapreplay.step import EventKind, Mode, Outcome, Step

TWO_ROOMS = """
    ###############
    #......#......#
    #......#......#
    #.............#
    #......#......#
    #......#......#
    ###############
"""


def explore(
    floor_plan: FloorPlan,
    predictor: Predictor | None = None,
    planner: Planner | None = None,
    **config: object,
) -> list[Step]:
    episode = prepare_episode(
        EpisodeConfig.of(config),
        floor_plan,
        planner=planner or NearestFrontier(),
        predictor=predictor or NoPredictor(),
    )
    return list(run_episode(episode))


def wall_at(picture: str, probability: float, *cells: tuple[int, int]) -> FixedPredictor:
    """Right and sure everywhere, but for `cells`, which get `probability`."""
    p = np.where(draw(picture) == OCCUPIED, 1, 0).astype(np.float32)
    for cell in cells:
        p[cell] = probability
    return FixedPredictor(p)


def test_observations_alone_map_everything() -> None:
    steps = explore(plan(TWO_ROOMS), plan_on="observed", build="observed")
    last = steps[-1]
    assert last.outcome is Outcome.MAPPED
    assert last.decision is None
    assert last.metrics.coverage_observed >= 0.98
    assert steps[-2].metrics.coverage_observed < 0.98
    assert [s.index for s in steps] == list(range(len(steps)))
    assert all(s.outcome is None and s.decision is not None for s in steps[:-1])


def test_the_agent_starts_at_the_top_left_and_moves_by_one_cell_a_step() -> None:
    steps = explore(plan(TWO_ROOMS))
    assert steps[0].agent == (5, 1)
    assert explore(plan(TWO_ROOMS), start=(1, 9))[0].agent == (1, 9)
    for before, after in pairwise(steps):
        assert np.abs(np.subtract(after.agent, before.agent)).max() == 1
        assert before.decision is not None
        assert after.agent == before.decision.next_cell


def test_path_length_counts_diagonals_as_sqrt_two_and_is_in_metres() -> None:
    steps = explore(plan(TWO_ROOMS, resolution=0.5))
    total = 0.0
    for before, after in pairwise(steps):
        total += 0.5 * float(np.hypot(*np.subtract(after.agent, before.agent)))
        assert after.metrics.path_length == pytest.approx(total)


def test_a_perfect_prediction_maps_at_once() -> None:
    steps = explore(plan(TWO_ROOMS), wall_at(TWO_ROOMS, 0.0))
    assert (len(steps), steps[0].outcome) == (1, Outcome.MAPPED)
    assert steps[0].metrics.correct_coverage_fused == 1
    assert steps[0].metrics.coverage_observed < 0.7


def test_a_confidently_wrong_prediction_covers_everything_and_is_not_right() -> None:
    steps = explore(plan(TWO_ROOMS), ConstantPredictor(0.0))
    assert steps[0].outcome is Outcome.MAPPED
    assert steps[0].metrics.coverage_fused == 1
    assert steps[0].metrics.correct_coverage_fused < 0.9


RING = """
    ###########
    #.........#
    #.#######.#
    #.#.....#.#
    #.#.###.#.#
    #...#.....#
    ###########
"""


def walls_two_cells_away() -> FixedPredictor:
    """Sure of a wall two cells from the start in both directions, and of nothing else.

    The agent starts at the top left and sees one cell far: right of it and below it lie cells
    that it knows to be free, and behind those, as it believes, walls.
    """
    p = np.full(draw(RING).shape, 0.5, np.float32)
    p[4:7, 3] = p[3, 0:3] = 1.0
    return FixedPredictor(p)


def test_a_predicted_wall_across_every_way_seals_the_agent_in() -> None:
    (only,) = explore(plan(RING), walls_two_cells_away(), reach=1)
    assert only.outcome is Outcome.SEALED_IN
    assert len(only.frontier) == 0
    assert only.decision is None
    assert [e.kind for e in only.events] == [EventKind.SEALED_IN, EventKind.OUTCOME]


def test_the_fail_safe_leads_out_and_says_so() -> None:
    steps = explore(plan(RING), walls_two_cells_away(), reach=1, fail_safe=True)
    assert steps[-1].outcome is Outcome.MAPPED
    first = steps[0]
    assert first.mode is Mode.FAIL_SAFE
    assert [e.kind for e in first.events] == [EventKind.SEALED_IN]
    # It plans on its observations: to the nearest free cell that touches the unknown.
    assert first.decision is not None
    assert first.decision.target == (4, 1)
    # One move and the predicted wall is seen to be none.
    assert steps[1].mode is Mode.NORMAL
    assert [e.kind for e in steps[1].events] == [EventKind.RELEASED]


def test_no_other_configuration_can_be_sealed_in() -> None:
    for plan_on, build in [("observed", "fused"), ("fused", "observed"), ("observed", "observed")]:
        steps = explore(plan(RING), walls_two_cells_away(), reach=1, plan_on=plan_on, build=build)
        assert steps[-1].outcome is Outcome.MAPPED


def test_the_budget_ends_an_episode() -> None:
    steps = explore(plan(TWO_ROOMS), max_steps=3, plan_on="observed", build="observed")
    assert (steps[-1].index, steps[-1].outcome) == (3, Outcome.OUT_OF_STEPS)
    assert steps[-1].decision is None


def test_the_default_budget_is_four_times_the_explorable_free_cells() -> None:
    floor_plan = plan("""
        #####
        #...#
        #####
        #.###
        #####
    """)
    episode = prepare_episode(EpisodeConfig(), floor_plan, NearestFrontier(), NoPredictor())
    assert episode.header.max_steps == 4 * 3


def test_a_target_reached_at_the_last_step_of_the_budget_counts() -> None:
    needed = explore(plan(TWO_ROOMS))[-1].index
    assert explore(plan(TWO_ROOMS), max_steps=needed)[-1].outcome is Outcome.MAPPED


def test_built_from_observations_a_prediction_only_steers() -> None:
    steps = explore(plan(TWO_ROOMS), wall_at(TWO_ROOMS, 0.0), plan_on="fused", build="observed")
    last = steps[-1]
    assert last.outcome is Outcome.MAPPED
    assert last.metrics.coverage_observed >= 0.98
    assert steps[0].metrics.coverage_fused == 1  # not what ends this one
    assert last.metrics.f1 == last.metrics.f1_observed


def test_planning_on_observations_falls_back_to_their_own_frontier() -> None:
    # All that touches the observed is predicted, so the fused map has no frontier that can be
    # reached over observed cells; the far end is not, so the target is not reached either.
    corridor = "#" * 40 + "\n#" + "." * 38 + "#\n" + "#" * 40
    p = np.where(draw(corridor) == OCCUPIED, 1, 0).astype(np.float32)
    p[:, 30:] = 0.5
    steps = explore(plan(corridor), FixedPredictor(p), plan_on="observed", build="fused", reach=3)
    assert len(steps[0].frontier) > 0
    assert (steps[0].observed[tuple(steps[0].frontier.T)] == FREE).all()
    assert steps[-1].outcome is Outcome.MAPPED


def test_the_events_tell_the_headlines() -> None:
    steps = explore(plan(TWO_ROOMS), plan_on="observed", build="observed")
    by_kind = {e.kind: s for s in steps for e in s.events}
    assert by_kind[EventKind.TARGET_REACHED] is steps[-1]
    assert by_kind[EventKind.OUTCOME] is steps[-1]
    first = by_kind[EventKind.CORRECT_REACHED]
    assert first.metrics.correct_coverage_observed >= 0.95
    assert steps[first.index - 1].metrics.correct_coverage_observed < 0.95


class Moody:
    """At every other step right and sure of all but one cell, between without an idea."""

    identity = NoisyPredictor.identity

    def __init__(self, picture: str) -> None:
        self.right = np.where(draw(picture) == OCCUPIED, 1, 0).astype(np.float32)
        self.right[1, 13] = 0.5
        self.asked = 0

    def predict(self, observed: Grid) -> npt.NDArray[np.float32]:
        self.asked += 1
        return self.right if self.asked % 2 else np.full_like(self.right, 0.5)


def test_a_headline_that_is_reached_lost_and_reached_again_is_told_once() -> None:
    steps = explore(
        plan(TWO_ROOMS), Moody(TWO_ROOMS), plan_on="observed", build="fused", coverage=1,
        correct_coverage=0.9, max_steps=6, start=(5, 1), reach=3, delta_occupied=1,
    )  # fmt: skip
    reached = [s.metrics.correct_coverage_fused >= 0.9 for s in steps]
    assert reached[:4] == [True, False, True, False]
    told = [s.index for s in steps for e in s.events if e.kind is EventKind.CORRECT_REACHED]
    assert told == [0]


class Counting:
    """Remembers what it was asked."""

    identity = NoisyPredictor.identity

    def __init__(self) -> None:
        self.asked: list[bytes] = []

    def predict(self, observed: Grid) -> npt.NDArray[np.float32]:
        self.asked.append(observed.tobytes())
        return NoisyPredictor().predict(observed)


def test_where_nothing_new_was_seen_nothing_is_predicted_again() -> None:
    predictor = Counting()
    steps = explore(generate(60000), predictor, RandomExploration(), plan_on="observed")
    maps = [step.observed.tobytes() for step in steps]
    assert predictor.asked == [a for a, _ in groupby(maps)]
    assert len(predictor.asked) < len(steps) / 2
    for step in steps:  # and yet every step has its own map's prediction
        expected = quantize(NoisyPredictor().predict(step.observed), PredictionDtype.UINT8)
        assert step.p_wall is not None
        assert (step.p_wall == expected).all()


def test_the_best_rivals_are_logged_best_first() -> None:
    steps = explore(generate(60000), planner=CostUtility(), max_steps=20)
    seen = 0
    for step in steps[:-1]:
        assert step.decision is not None
        ratings = [r.utility for r in step.decision.rivals]
        assert ratings == sorted(ratings, reverse=True)
        assert len(ratings) <= 5
        assert all(r.utility <= step.decision.chosen.utility for r in step.decision.rivals)
        assert step.decision.target not in [r.cell for r in step.decision.rivals]
        seen += len(ratings)
    assert seen > 0


class WrongShape:
    identity = NoisyPredictor.identity

    def predict(self, observed: np.ndarray) -> np.ndarray:
        return np.zeros((2, 2), np.float32)


class Overeager:
    def choose(self, situation: Situation) -> Choice:
        return Choice(10**6, situation.costs, situation.costs)


def test_a_predictor_or_planner_that_answers_nonsense_is_named() -> None:
    with pytest.raises(MapreplayError, match=r"predictor 'noisy' returned shape \(2, 2\)"):
        explore(plan(TWO_ROOMS), WrongShape())
    with pytest.raises(MapreplayError, match=r"predictor 'constant': P.occupied. must be in"):
        explore(plan(TWO_ROOMS), ConstantPredictor(float("nan")))
    episode = prepare_episode(
        EpisodeConfig(planner="mine"), plan(TWO_ROOMS), Overeager(), NoPredictor()
    )
    with pytest.raises(MapreplayError, match="planner 'mine' chose number 1000000 of"):
        list(run_episode(episode))


PLANNERS: list[Callable[[], Planner]] = [NearestFrontier, CostUtility, RandomExploration]


@st.composite
def small_plans(draw_: st.DrawFn) -> FloorPlan:
    """Caves of free and occupied cells, with a closed border."""
    height, width = draw_(st.integers(8, 16)), draw_(st.integers(8, 16))
    walls = draw_(st.lists(st.integers(0, 3), min_size=height * width, max_size=height * width))
    cells = np.where(np.reshape(walls, (height, width)) == 0, 100, 0).astype(np.int8)
    cells[[0, -1]] = cells[:, [0, -1]] = 100
    cells[1, 1] = 0
    return FloorPlan("cave", cells, 0.2)


@settings(max_examples=60, deadline=None)
@given(
    floor_plan=small_plans(),
    planner=st.sampled_from(PLANNERS),
    plan_on=st.sampled_from(list(MapKind)),
    build=st.sampled_from(list(MapKind)),
    fail_safe=st.booleans(),
    delta=st.sampled_from([0.0, 0.5, 0.9]),
    seed=st.integers(0, 5),
)
def test_what_holds_in_every_episode(
    floor_plan: FloorPlan,
    planner: Callable[[], Planner],
    plan_on: MapKind,
    build: MapKind,
    fail_safe: bool,
    delta: float,
    seed: int,
) -> None:
    steps = explore(
        floor_plan, NoisyPredictor(), planner(), plan_on=plan_on, build=build, seed=seed,
        fail_safe=fail_safe, delta_free=delta, delta_occupied=delta, reach=4,
    )  # fmt: skip
    truth = floor_plan.cells
    for step in steps:
        assert truth[step.agent] == FREE
        seen = step.observed != UNKNOWN
        assert (step.observed[seen] == truth[seen]).all()
        assert (step.fused[seen] == step.observed[seen]).all()
        if step.decision is not None:
            assert step.decision.target in {(r, c) for r, c in step.frontier.tolist()}
    for before, after in pairwise(steps):
        known = before.observed != UNKNOWN
        assert (after.observed[known] == before.observed[known]).all()
        assert after.metrics.coverage_observed >= before.metrics.coverage_observed
    last = steps[-1]
    assert last.outcome is not None
    if last.outcome is Outcome.SEALED_IN:
        # Only an agent that plans on its own predictions and builds them can be sealed in.
        assert plan_on is MapKind.FUSED
        assert build is MapKind.FUSED
        assert not fail_safe
    if last.outcome is Outcome.MAPPED:
        assert last.metrics.coverage(build) >= 0.98


def test_the_same_seed_gives_the_same_episode() -> None:
    def agents(seed: int) -> list[tuple[int, int]]:
        steps = explore(
            generate(60001), NoisyPredictor(), RandomExploration(), seed=seed, max_steps=120
        )
        return [s.agent for s in steps]

    assert agents(1) == agents(1)
    assert agents(1) != agents(2)


class Diary:
    """A sink that keeps what it was given, and says so in a list that several share."""

    def __init__(self, name: str, heard: list[tuple[str, int]]) -> None:
        self.name, self.heard = name, heard

    def add(self, step: Step) -> None:
        self.heard.append((self.name, step.index))


def test_record_gives_every_step_to_every_sink_in_order_and_returns_the_last() -> None:
    episode = prepare_episode(EpisodeConfig(planner="nearest", max_steps=3), plan(TWO_ROOMS))
    steps, heard = list(run_episode(episode)), list[tuple[str, int]]()
    last = record(episode, Diary("a", heard), Diary("b", heard))
    assert heard == [(name, k) for k in range(4) for name in "ab"]
    assert (last.index, last.outcome) == (3, Outcome.OUT_OF_STEPS)
    assert record(steps, Diary("a", heard)) is steps[-1]  # of a log's steps it does the same
    with pytest.raises(ValueError, match="without steps"):
        record([])


def test_recorded_says_a_step_when_the_sinks_have_it_and_not_sooner() -> None:
    episode = prepare_episode(EpisodeConfig(planner="nearest", max_steps=3), plan(TWO_ROOMS))
    heard: list[tuple[str, int]] = []
    steps = recorded(episode, Diary("a", heard))
    assert (next(steps).index, heard) == (0, [("a", 0)])
    steps.close()
    assert heard == [("a", 0)]
