"""Episodes and their logs, for tests of what is recorded."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from drawing import plan
from mapreplay.config import EpisodeConfig
from mapreplay.episode import Episode, prepare_episode, run_episode
from mapreplay.grid import Grid
from mapreplay.planners.random import RandomExploration
from mapreplay.predictors import NoPredictor
from mapreplay.recorders.log.writer import EpisodeWriter
from mapreplay.step import EpisodeHeader, PredictorIdentity, Step

THREE_ROOMS = """
    ############################
    #........#.......#.........#
    #........#.......#.........#
    #........#.......#.........#
    #........#.................#
    #................#.........#
    #........#.......#.........#
    #........#.......#.........#
    ####.#############.........#
    #........................###
    #........................#.#
    ############################
"""


TWO_ROOMS = """
    ############
    #....#.....#
    #....#.....#
    #..........#
    #....#.....#
    ##.#########
    #..........#
    #...#......#
    #...#......#
    #...#......#
    #..........#
    ############
"""


@dataclass(frozen=True)
class BlurPredictor:
    """Walls are where walls are near: a blur of what was observed."""

    identity: PredictorIdentity = PredictorIdentity("blur", "0" * 64)

    def predict(self, observed: Grid) -> npt.NDArray[np.float32]:
        p = np.select([observed == -1, observed == 0], [0.5, 0.0], 1.0).astype(np.float32)
        return cv2.blur(p, (5, 5))


@dataclass(frozen=True)
class Recorded:
    """A log, and what was written to it."""

    path: Path
    header: EpisodeHeader
    steps: list[Step]


def three_rooms(**config: object) -> Episode:
    """Random exploration of three rooms, with the given keys of the configuration."""
    values = {"planner": "random", "reach": 6, "max_steps": 60, "seed": 3} | config
    blurred = values.get("predictor") == "blur"
    return prepare_episode(
        EpisodeConfig.of(values),
        plan(THREE_ROOMS, "three-rooms", resolution=0.2),
        planner=RandomExploration(),
        predictor=BlurPredictor() if blurred else NoPredictor(),
    )


def two_rooms() -> Episode:
    """Eight moves in a map of 12 x 12 cells, with a prediction."""
    return prepare_episode(
        EpisodeConfig.of({"planner": "random", "reach": 4, "max_steps": 8, "seed": 3}),
        plan(TWO_ROOMS, "two-rooms"),
        planner=RandomExploration(),
        predictor=BlurPredictor(),
    )


def record(folder: Path, episode: Episode) -> Recorded:
    """Run an episode and write its log, with profile."""
    path = folder / "episode.mcap"
    steps = list(run_episode(episode))
    with EpisodeWriter(path, episode.header, profile=True) as writer:
        for step in steps:
            writer.add(step)
    return Recorded(path, episode.header, steps)
