"""An episode's metrics in one row: of its end, of its curve, and of its predictions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import polars as pl

from mapreplay.analysis.episodes.curves import MILESTONES, area, first_reached
from mapreplay.analysis.episodes.summary import episode_frame, row_of_log
from mapreplay.analysis.metrics.measure import CHANGES, RECORDED, Measurements, prediction_scores
from mapreplay.config import MapKind
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.recorders.log.state import by_step

_IN_ROW: Final = {"path_length", "f1"}
"""Of `RECORDED`, what an `EpisodeRow` has already."""


def episode_metrics(
    log: EpisodeLog, measured: Measurements, further: Sequence[str] = ()
) -> pl.DataFrame:
    """One row: what was run, how it ended, and its metrics.

    All fields of `EpisodeRow` (its file empty); of each of `StepMetrics` and of the `further`
    metrics the value at the last step; ``area`` under the coverage curve of the built map over
    the whole budget (see `curves.area`) and ``correct_area``; steps and metres until each
    milestone (``steps_to_90``, ``path_to_90``, and the same of ``correct_90``), null if it was
    never reached; the scores of the predictions on the unobserved cells of all steps together
    (``brier_pooled``, while ``brier_unobserved`` is that of the last step); the means
    of `CHANGES`; and how many ``disagreements`` with the recording there are, and the first.
    What is undefined is null.
    """
    row = episode_frame([row_of_log(log, "")])
    steps = measured.steps
    last = [*(name for name in RECORDED if name not in _IN_ROW), *further]
    numbers: dict[str, float | int | None] = {
        name: steps[name][-1] if len(steps) else None for name in last
    }
    built = "observed" if log.header.config.build is MapKind.OBSERVED else "fused"
    numbers |= _milestones(steps, "", f"coverage_{built}", log.header.budget)
    numbers |= _milestones(steps, "correct_", f"correct_coverage_{built}", log.header.budget)
    for name, value in prediction_scores(measured.predictions).items():
        numbers[name.replace("_unobserved", "_pooled")] = value
    numbers |= {name: _mean(steps[name]) for name in CHANGES}
    schema = {name: pl.Int64 if _is_count(name) else pl.Float64 for name in numbers}
    metrics = pl.DataFrame([numbers], schema=schema, strict=False)
    first = str(measured.disagreements[0]) if measured.disagreements else None
    return pl.concat([row, metrics], how="horizontal").with_columns(
        pl.col(pl.Float64).fill_nan(None),
        pl.lit(len(measured.disagreements), pl.Int64).alias("disagreements"),
        pl.lit(first, pl.String).alias("first_disagreement"),
    )


def _milestones(
    steps: pl.DataFrame, prefix: str, column: str, budget: int | None
) -> dict[str, float | int | None]:
    numbers_of_steps = steps["step"].to_numpy()
    curve = by_step(numbers_of_steps, steps[column].to_numpy())
    length = by_step(numbers_of_steps, steps["path_length"].to_numpy()).tolist()
    # Without a budget the area is a share of nothing.
    numbers: dict[str, float | int | None] = {
        f"{prefix}area": None if budget is None else area(curve, budget)
    }
    for level in MILESTONES:
        step, name = first_reached(curve, level), f"{prefix}{round(100 * level)}"
        numbers[f"steps_to_{name}"] = step
        numbers[f"path_to_{name}"] = None if step is None else length[step]
    return numbers


def _is_count(name: str) -> bool:
    return name.startswith("steps_to_")


def _mean(column: pl.Series) -> float | None:
    mean = column.mean()
    return mean if isinstance(mean, float) else None
