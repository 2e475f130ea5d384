"""Rows of an experiment for tests, and jobs that kill their process or never end."""

from __future__ import annotations

import os
import time
from typing import Any

import numpy as np
import numpy.typing as npt

from mapreplay.analysis.experiment.jobs import Job
from mapreplay.analysis.experiment.rows import Row
from mapreplay.grid import Grid
from mapreplay.predictors import Predictor
from mapreplay.step import PredictorIdentity

_PLAIN = {
    "dataset": "D1", "floor_plan": "p1", "planner": "nearest", "plan_on": "observed",
    "build": "observed", "fail_safe": False, "seed": 1, "predictor": "none", "sha256": "",
    "outcome": "mapped", "steps": 100, "budget": 400, "mapping_time": 100, "correct_time": 90,
    "path_length": 25.0, "f1": 0.9, "precision": 0.95, "recall": 0.85, "coverage": 0.98,
    "correct": 0.97, "sealed_step": None, "fail_safe_steps": 0, "seconds": 0.5,
}  # fmt: skip


def ROW(**changes: Any) -> Row:  # noqa: N802 (a row, with what a test wants to be different)
    return Row(**(_PLAIN | changes))


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
