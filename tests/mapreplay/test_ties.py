"""Cells that promise the same are rated the same, in whatever order the rays meet the cells.

A map and its prediction are the same to the left and to the right of the agent; so are the gains,
and the tie goes to the smaller column. Rules 1 let the last bit of a sum decide.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drawing import plan
from mapreplay.analysis.verification import verify
from mapreplay.config import EpisodeConfig
from mapreplay.episode import prepare_episode, record, versions
from mapreplay.grid import UNKNOWN, Cell, Quantized
from mapreplay.planners import Planner, load_planner, planner_of, rules_1
from mapreplay.planners.cost_utility import CostUtility
from mapreplay.planners.informative_path import InformativePath
from mapreplay.planning import Situation, shortest_paths
from mapreplay.randomness import Draws, Purpose
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.recorders.log.writer import EpisodeWriter
from mapreplay.sensor import Sensor
from mapreplay.step import EpisodeHeader
from recordings import THREE_ROOMS, BlurPredictor

LEFT_AND_RIGHT = np.array([[2, 2], [2, 4]], np.int32)
BROKEN_BY_RULES_1 = np.random.default_rng(0).integers(0, 256, (5, 4)).astype(np.uint8)


def mirrored(left: Quantized) -> Situation:
    """5 x 7 cells of which three in the middle were seen; `left` is (5, 4) with the middle."""
    observed = np.full((5, 7), UNKNOWN, np.int8)
    observed[2, 2:5] = 0
    return Situation(
        agent=Cell(2, 3),
        plan_map=observed,
        build_map=observed,
        observed=observed,
        prediction=np.hstack([left, left[:, 2::-1]]),
        frontier=LEFT_AND_RIGHT,
        paths=shortest_paths(observed, Cell(2, 3)),
        previous_target=None,
        draws=Draws(1, Purpose.PLANNER),
        sensor=Sensor(rays=8, reach=3),
    )


def predictions() -> st.SearchStrategy[Quantized]:
    """(5, 4) of any of the three types."""
    integers = [
        st.lists(st.integers(0, np.iinfo(dtype).max), min_size=20, max_size=20).map(
            lambda values, dtype=dtype: np.array(values, dtype).reshape(5, 4)
        )
        for dtype in (np.uint8, np.uint16)
    ]
    floats = st.lists(st.floats(0, 1, width=32), min_size=20, max_size=20)
    return st.one_of(*integers, floats.map(lambda v: np.array(v, np.float32).reshape(5, 4)))


@pytest.mark.parametrize("planner", [CostUtility(), InformativePath(), InformativePath(ways=0)])
@given(left=predictions())
def test_a_tie_goes_to_the_first_cell(planner: Planner, left: Quantized) -> None:
    choice = planner.choose(mirrored(left))
    assert choice.utility[0] == choice.utility[1]
    assert choice.reward[0] == choice.reward[1]
    assert choice.index == 0


def test_rules_1_let_the_last_bit_decide() -> None:
    here = mirrored(BROKEN_BY_RULES_1)
    choice = rules_1.CostUtility1().choose(here)
    assert choice.index == 1
    assert choice.reward == pytest.approx(here.gains())


@given(st.lists(st.integers(0, 255), min_size=20, max_size=20))
def test_a_gain_is_the_sum_of_whole_doubts(values: list[int]) -> None:
    left = np.array(values, np.uint8).reshape(5, 4)
    here = mirrored(left)
    whole = here.gains() * 255
    assert whole == pytest.approx(np.rint(whole), abs=1e-9)
    assert (here.gains() == np.rint(whole) / 255).all()


def header_of(versions: tuple[tuple[str, str], ...], planner: str) -> EpisodeHeader:
    config = EpisodeConfig(planner=planner, predictor="blur", reach=6, max_steps=40, coverage=1.0)
    episode = prepare_episode(config, plan(THREE_ROOMS), predictor=BlurPredictor())
    return replace(episode.header, versions=versions)


@pytest.mark.parametrize("name", ["cost-utility", "informative-path", "nearest"])
def test_a_log_says_by_which_rules_it_was_decided(name: str) -> None:
    assert dict(versions())["rules"] == "2"
    assert type(planner_of(header_of(versions(), name))) is type(load_planner(name))
    old = planner_of(header_of((("mapreplay", "0.1.0"),), name))
    assert (type(old) is type(load_planner(name))) == (name == "nearest")


@pytest.mark.parametrize("name", ["cost-utility", "informative-path"])
def test_a_log_of_rules_1_is_verified_by_rules_1(tmp_path: Path, name: str) -> None:
    old = tuple(pair for pair in versions() if pair[0] != "rules")
    config = header_of(old, name).config
    results = []
    for number, (said, planner) in enumerate(
        [(old, rules_1.PLANNERS[name]), (versions(), rules_1.PLANNERS[name])]
    ):
        episode = prepare_episode(config, plan(THREE_ROOMS), planner, BlurPredictor())
        with EpisodeWriter(
            tmp_path / f"{number}.mcap", replace(episode.header, versions=said)
        ) as w:
            record(episode, w)
        results.append(verify(EpisodeLog(tmp_path / f"{number}.mcap")).agrees)
    assert results == [True, False]
