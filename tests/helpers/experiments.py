"""Rows of an experiment for tests."""

from __future__ import annotations

from typing import Any

from mapreplay.analysis.experiment.rows import Row

_PLAIN = {
    "dataset": "D1", "floor_plan": "p1", "planner": "nearest", "plan_on": "observed",
    "build": "observed", "fail_safe": False, "seed": 1, "predictor": "none", "sha256": "",
    "outcome": "mapped", "steps": 100, "budget": 400, "mapping_time": 100, "correct_time": 90,
    "path_length": 25.0, "f1": 0.9, "precision": 0.95, "recall": 0.85, "coverage": 0.98,
    "correct": 0.97, "sealed_step": None, "fail_safe_steps": 0, "seconds": 0.5,
}  # fmt: skip


def ROW(**changes: Any) -> Row:  # noqa: N802 (a row, with what a test wants to be different)
    return Row(**(_PLAIN | changes))
