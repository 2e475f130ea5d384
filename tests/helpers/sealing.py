"""Episodes in hand-drawn plans with a predictor that is as wrong as a test needs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from drawing import draw, plan
from mapreplay.config import EpisodeConfig
from mapreplay.episode import Episode, prepare_episode, record
from mapreplay.grid import Grid
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.recorders.log.writer import EpisodeWriter
from mapreplay.step import PredictorIdentity

TWO_ROOMS = """
    ##############
    #.....#......#
    #.....#......#
    #............#
    #.....#......#
    #.....#......#
    ##############
"""
DOOR = (3, 6)
LEFT_ROOM = """
    #######???????
    #.....#???????
    #.....#???????
    #.....#???????
    #.....#???????
    #.....#???????
    #######???????
"""
"""The left room as it is predicted: its door is a wall."""

Forecast = Callable[[Grid], npt.NDArray[np.float32]]


@dataclass(frozen=True, eq=False)
class Told:
    """Predicts what it is told to, by the observed map."""

    forecast: Forecast
    identity: PredictorIdentity = PredictorIdentity("told", "")

    def predict(self, observed: Grid) -> npt.NDArray[np.float32]:
        return self.forecast(observed)


def drawn(picture: str) -> npt.NDArray[np.float32]:
    """P(occupied) of a picture: .01, .99, or .5 where it is unknown."""
    cells = draw(picture)
    return np.select([cells == 0, cells == 100], [0.01, 0.99], 0.5).astype(np.float32)


def always(picture: str) -> Told:
    """Always the same prediction."""
    p_wall = drawn(picture)
    return Told(lambda observed: p_wall)


def until(picture: str, seen: int, then: str) -> Told:
    """One prediction until so many cells were observed, another from then on."""
    before, after = drawn(picture), drawn(then)
    return Told(lambda observed: before if int((observed >= 0).sum()) < seen else after)


def episode(predictor: Told, picture: str = TWO_ROOMS, **config: object) -> Episode:
    """Nearest frontier with a sensor that reaches one cell."""
    values = {"planner": "nearest", "predictor": "told", "reach": 1, "max_steps": 200}
    return prepare_episode(
        EpisodeConfig.of(values | config), plan(picture, "drawn-1", 0.2), predictor=predictor
    )


def recorded(path: Path, made: Episode) -> EpisodeLog:
    with EpisodeWriter(path, made.header) as writer:
        record(made, writer)
    return EpisodeLog(path)
