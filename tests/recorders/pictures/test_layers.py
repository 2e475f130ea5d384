from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from drawing import draw, plan
from mapreplay.config import EpisodeConfig
from mapreplay.episode import prepare_episode, run_episode
from mapreplay.external import ExternalEpisode, unknown_floor_plan
from mapreplay.floorplan import explorable
from mapreplay.grid import Cell
from mapreplay.recorders.pictures.captions import decision_words
from mapreplay.recorders.pictures.layers import (
    MapView,
    curves,
    display_probability,
    error_classes,
    map_views,
    rays_of,
    state_of,
)
from mapreplay.recorders.pictures.palette import CellClass, Curve, State
from mapreplay.recorders.pictures.replay import first_divergence
from mapreplay.step import Candidate, Decision, Mode, Outcome, Step
from recordings import two_rooms


@pytest.fixture(scope="module")
def steps() -> list[Step]:
    return list(run_episode(two_rooms()))


def goes(step: Step, **values: Any) -> Step:
    """The step with another decision: to (12, 40), 14 straight moves away."""
    rated = {"utility": 3.2, "reward": 48.0, **values}
    chosen = Candidate(Cell(12, 40), rated["utility"], rated["reward"], 14, 0)
    rivals = (Candidate(Cell(30, 8), 2.9, 20.3, 6, 0),) if rated.get("rivals", True) else ()
    path = np.array([[0, 0], [12, 40]], np.int32)
    mode = rated.get("mode", Mode.NORMAL)
    return replace(step, decision=Decision(chosen, path, mode, rivals, rated.get("draw")))


def test_errors_are_marked_where_the_agent_could_have_known_better() -> None:
    truth = draw("""
        ######
        #..#.#
        #..###
        ######
    """)
    fused = draw("""
        ####??
        #.##??
        #?..##
        ######
    """)
    marks = {".": CellClass.FREE, "#": CellClass.OCCUPIED, "?": CellClass.UNKNOWN,
             "W": CellClass.FALSE_WALL, "f": CellClass.FALSE_FREE,
             "-": CellClass.NOT_EXPLORABLE}  # fmt: skip
    drawn = """
        ####--
        #.W#--
        #?.f--
        ####--
    """
    expected = [[marks[mark] for mark in line.strip()] for line in drawn.strip().splitlines()][::-1]
    region = explorable(truth, Cell(1, 1))
    assert error_classes(fused, truth, region).tolist() == expected


@pytest.mark.parametrize(
    ("p_wall", "shown"),
    [
        (np.array([[0, 77, 255]], np.uint8), [0, 77, 255]),
        (np.array([[0, 19789, 65535]], np.uint16), [0, 77, 255]),
        (np.array([[0.0, 0.302, 1.0]], np.float32), [0, 77, 255]),
    ],
)
def test_predictions_of_any_type_are_shown_in_256_levels(
    p_wall: npt.NDArray[Any], shown: list[int]
) -> None:
    assert display_probability(p_wall).tolist() == [shown]


@pytest.mark.parametrize(
    ("decided", "words"),
    [
        (
            {},
            "went to (12, 40): utility 3.20 = gain 48.0 / (1 + 14.0); runner-up (30, 8) 2.90",
        ),
        ({"rivals": False}, "went to (12, 40): utility 3.20 = gain 48.0 / (1 + 14.0)"),
        (
            {"utility": 7.0, "rivals": False},  # a plug-in's, which weighs in another way
            "went to (12, 40): utility 7.00, gain 48.0, 14.0 cells away",
        ),
        (
            {"mode": Mode.FAIL_SAFE, "rivals": False},
            "went to (12, 40) by the fail-safe: utility 3.20 = gain 48.0 / (1 + 14.0)",
        ),
        ({"draw": 9}, "went to (12, 40): drawn at random, 14.0 cells away"),
        (
            {"utility": 1.0, "reward": 1.0},
            "went to (12, 40): its target as before, 14.0 cells away",
        ),
        (
            {"utility": float("nan"), "reward": float("nan"), "rivals": False},
            "went to (12, 40): 14.0 cells away",
        ),
    ],
)
def test_a_decision_is_told_in_a_sentence(
    steps: list[Step], decided: dict[str, Any], words: str
) -> None:
    assert decision_words(goes(steps[0], **decided)) == words


def test_the_last_step_tells_how_it_ended(steps: list[Step]) -> None:
    assert decision_words(steps[-1]) == "out of steps after 8 steps"
    assert decision_words(replace(steps[0], decision=None)) == "no target is logged"


def test_the_state_is_the_mode_and_at_the_end_the_outcome(steps: list[Step]) -> None:
    assert state_of(steps[0]) is State.EXPLORING
    assert state_of(goes(steps[0], mode=Mode.FAIL_SAFE)) is State.FAIL_SAFE
    ends = [state_of(replace(steps[-1], outcome=outcome)) for outcome in Outcome]
    assert ends == [State.DONE, State.SEALED_IN, State.OUT_OF_STEPS]


def test_rays_end_at_the_hit_the_range_or_the_border() -> None:
    corridor = plan("""
        ..........
        ..........
        #....S...#
        ..........
        ..........
    """)
    config = EpisodeConfig(planner="nearest", start=(2, 5), reach=4, rays=8, max_steps=1)
    episode = prepare_episode(config, corridor)
    rays = rays_of(next(run_episode(episode)), episode.header)
    east, north_east, north, _, west, _, south, _ = [tuple(end) for end in rays.ends.tolist()]
    assert east == (2, 9)  # the hit
    assert west == (2, 1)  # the end of its range of four cells
    assert north == (4, 5)  # the border
    assert north_east == (4, 7)
    assert south == (0, 5)
    assert rays.hit.tolist() == [True] + [False] * 7


def test_without_a_scan_there_are_no_rays(steps: list[Step]) -> None:
    silent = replace(steps[0], hits=np.empty(0, np.int16))
    assert rays_of(silent, two_rooms().header).ends.tolist() == []


def test_two_episodes_part_after_the_last_step_that_is_the_same_to_the_agent(
    steps: list[Step],
) -> None:
    def from_three(**change: Any) -> list[Step]:
        return [*steps[:3], *(replace(step, **change) for step in steps[3:])]

    assert first_divergence(steps, list(steps)) is None
    assert first_divergence(steps, from_three(agent=Cell(0, 0))) == 2
    assert first_divergence(steps, from_three(observed=steps[0].observed)) == 2
    assert first_divergence(steps, from_three(observed=np.zeros((2, 2), np.int8))) == 2
    assert first_divergence(steps, [replace(s, agent=Cell(0, 0)) for s in steps]) == 0
    assert first_divergence(steps, from_three(p_wall=None)) is None, "not what the agent sees"
    assert first_divergence(steps, steps[:5]) == 4
    assert first_divergence(steps[:5], steps) == 4
    assert first_divergence([], []) is None


def test_only_what_says_something_is_shown() -> None:
    predicted = two_rooms().header
    everything = (MapView.OBSERVED, MapView.PREDICTED, MapView.FUSED, MapView.ERROR)
    assert map_views(predicted) == everything
    assert curves(predicted) == tuple(Curve)

    config = EpisodeConfig(planner="nearest", predictor="none")
    seen = prepare_episode(config, predicted.floor_plan).header
    assert map_views(seen) == (MapView.OBSERVED, MapView.FUSED, MapView.ERROR)
    assert curves(seen) == (Curve.F1, Curve.PRECISION, Curve.RECALL, Curve.COVERAGE_OBSERVED)

    external = ExternalEpisode(
        unknown_floor_plan("lab", (9, 9), 0.1), (4, 4), planner="mine"
    ).header
    assert map_views(external) == (MapView.OBSERVED, MapView.FUSED)
    assert curves(external) == ()
