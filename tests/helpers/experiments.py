"""Logs of an experiment for tests, and jobs that kill their process or never end."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from mapreplay.analysis.experiment.jobs import Job, Shelf
from mapreplay.config import EpisodeConfig
from mapreplay.episode import record
from mapreplay.floorplan import FloorPlan
from mapreplay.grid import FREE, UNKNOWN, Cell, Grid
from mapreplay.predictors import Predictor
from mapreplay.recorders.log.scalars import ScalarsWriter
from mapreplay.step import EpisodeHeader, Outcome, PredictorIdentity, Step, StepMetrics

Row = Mapping[str, Any]

_PLAIN = {
    "dataset": "D1", "floor_plan": "p1", "planner": "nearest", "plan_on": "observed",
    "build": "observed", "fail_safe": False, "seed": 1, "predictor": "none", "sha256": "",
    "outcome": "mapped", "steps": None, "budget": 400, "mapping_time": 100, "path_length": 25.0,
    "f1": 0.9, "correct": 0.97,
}  # fmt: skip


def ROW(**changes: Any) -> Row:  # noqa: N802 (an episode, with what a test wants to be different)
    assert changes.keys() <= _PLAIN.keys()
    return _PLAIN | changes


def fill(folder: Path, rows: Iterable[Row]) -> None:
    """Write the scalars of episodes that never happened into a folder of results."""
    for row in rows:
        header = _header(row)
        path = Shelf(folder).path(row["dataset"], header)
        with ScalarsWriter(path, header) as writer:
            record(_steps(row), writer)


def _header(row: Row) -> EpisodeHeader:
    cells = np.full((3, 2 + sum(map(ord, row["floor_plan"]))), FREE, np.int8)  # another for each
    keys = ("planner", "predictor", "plan_on", "build", "fail_safe", "seed")
    return EpisodeHeader(
        config=EpisodeConfig.of({key: row[key] for key in keys}),
        floor_plan=FloorPlan(row["floor_plan"], cells, 0.2),
        start=Cell(1, 1),
        max_steps=row["budget"],
        predictor=PredictorIdentity(row["predictor"], row["sha256"]),
        versions=(),
    )


def _steps(row: Row) -> Iterable[Step]:
    """The target is reached at once, at the mapping time."""
    unknown, nothing = np.full((1, 1), UNKNOWN, np.int8), np.empty((0, 2), np.int32)
    mapped = row["mapping_time"]
    last = row["steps"] if row["steps"] is not None else mapped
    for k in range(last + 1):
        coverage = 0.98 if mapped is not None and k >= mapped else 0.5
        known = {"path_length": row["path_length"], "f1": row["f1"]}
        known |= dict.fromkeys(("coverage_observed", "coverage_fused"), coverage)
        known |= dict.fromkeys(
            ("correct_coverage_observed", "correct_coverage_fused"), row["correct"]
        )
        scores = {name: known.get(name, math.nan) for name in StepMetrics.names()}
        yield Step(
            index=k, agent=Cell(1, 1), hits=np.empty(0, np.int16), observed=unknown, p_wall=None,
            fused=unknown, frontier=nothing, decision=None, metrics=StepMetrics(**scores),
            events=(), outcome=Outcome(row["outcome"]) if k == last else None, profile=None,
        )  # fmt: skip


class GivenJob(Job):
    """A job with the predictor that the test gives it."""

    given: Predictor

    def with_predictor(self, predictor: Predictor) -> GivenJob:
        object.__setattr__(self, "given", predictor)
        return self

    def predictor(self) -> Predictor:
        return self.given


class _Deadly:
    identity = PredictorIdentity("deadly", "")

    def predict(self, observed: Grid) -> npt.NDArray[np.float32]:
        os._exit(9)


class DeadlyJob(Job):
    """A job whose predictor takes its process with it."""

    def predictor(self) -> Predictor:
        return _Deadly()


class SleepyJob(Job):
    """A job that does not end by itself."""

    def predictor(self) -> Predictor:
        time.sleep(3600)
        raise AssertionError
