"""The paper's mapping figure: one episode, recorded, whose last step is drawn."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from mapreplay.config import EpisodeConfig
from mapreplay.episode import prepare_episode, record
from mapreplay.floorplan import FloorPlan
from mapreplay.predictors import Predictor
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.recorders.log.writer import EpisodeWriter
from mapreplay.step import Cells, Step

EXAMPLE_FILE: Final = "example.mcap"
SHARE: Final = 0.85
"""The paper's example: 85 % coverage, both thresholds at 85 %."""


def example_config(predictor: str) -> EpisodeConfig:
    """Cost-Utility on fused/fused at 85/85 to 85 % coverage, without fail-safe."""
    return EpisodeConfig(
        planner="cost-utility",
        predictor=predictor,
        delta_free=SHARE,
        delta_occupied=SHARE,
        coverage=SHARE,
    )


def record_example(floor_plan: FloorPlan, predictor: Predictor, folder: Path) -> Path:
    """Run the example and write ``example.mcap``, in place of one that is there."""
    config = example_config(predictor.identity.name)
    episode = prepare_episode(config, floor_plan, predictor=predictor)
    path = folder / EXAMPLE_FILE
    with EpisodeWriter(path, episode.header, force=True) as writer:
        record(episode, writer)
    return path


@dataclass(frozen=True, eq=False)
class Example:
    """What the figure shows."""

    log: EpisodeLog
    last: Step
    track: Cells
    """int32[n, 2]: the agent's cell at every step."""

    @property
    def exposure_observed(self) -> float:
        """Share of the explorable cells that were observed at the end."""
        return self.last.metrics.coverage_observed

    @property
    def exposure_fused(self) -> float:
        """Share that the fused map knows."""
        return self.last.metrics.coverage_fused


def read_example(path: Path) -> Example:
    """The example that was recorded.

    Raises:
        LogError: it cannot be read.
    """
    log = EpisodeLog(path)
    track, last = [], deque[Step](maxlen=1)
    for step in log.steps():
        track.append(step.agent)
        last.append(step)
    return Example(log, last[0], np.array(track, np.int32))
