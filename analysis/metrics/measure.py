"""All metrics of an episode, computed again from its logged poses and maps and the true map.

One pass over the log gives a row for each step; `episode_metrics` makes one row of them. Memory
is bounded by a chunk of steps and by the result.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, Final, cast

import numpy as np
import numpy.typing as npt
import polars as pl

from mapreplay.analysis.metrics import kernels
from mapreplay.analysis.metrics.calibration import (
    DISTANCES,
    PredictionCounts,
    count_cells,
    score_columns,
)
from mapreplay.analysis.metrics.registry import Metric, guarded
from mapreplay.grid import Cell, Grid, Mask, Quantized
from mapreplay.mapping import certainty
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.scores import UnknownAs
from mapreplay.stages import Travelled, measure
from mapreplay.step import Step, StepMetrics

Floats = npt.NDArray[np.float64]

RECORDED: Final = tuple(StepMetrics.names())
"""The metrics that a log has, and that are compared with it."""
SCORES: Final = ("cells", "brier", "log_loss", "ece", "auroc")
"""Of the prediction on unobserved cells: of all of them, and by their distance from the
observed ones."""
CHANGES: Final = ("prediction_change", "prediction_flips")
"""Mean |change of p_wall| from the step before, and the share of cells that changed sides, on
the cells that are still unobserved."""
_CHUNK: Final = 1 << 18
"""Counts that are kept before they become scores."""


@dataclass(frozen=True)
class Scope:
    """Which cells count in the scores, and as what."""

    unknown_as: UnknownAs = UnknownAs.FREE
    everywhere: bool = False
    """All cells of the map, not only the explorable ones."""

    @property
    def as_recorded(self) -> bool:
        """Whether it is the scope of a log's own metrics."""
        return self == Scope()


@dataclass(frozen=True)
class Disagreement:
    """A metric whose recorded value differs from the one that the logged maps give."""

    step: int
    name: str
    recorded: float
    recomputed: float

    def __str__(self) -> str:
        return (
            f"step {self.step}: {self.name} was recorded as {self.recorded!r}, "
            f"the maps give {self.recomputed!r}"
        )


@dataclass(frozen=True, eq=False)
class Measurements:
    """The metrics of one episode."""

    steps: pl.DataFrame
    """A row per step: ``step``, all of `StepMetrics`, the prediction's scores on unobserved
    cells (``ece_unobserved``; by distance ``ece_at_1``, ..., see `distance_labels`), `CHANGES`,
    and the further metrics. What is undefined is null."""
    predictions: PredictionCounts | None
    """Those on unobserved cells of all steps together; None without a prediction."""
    disagreements: tuple[Disagreement, ...]
    """With the scope of a recording: where its values differ from those of the maps in any bit."""


def measure_log(
    log: EpisodeLog, scope: Scope | None = None, metrics: Mapping[str, Metric] | None = None
) -> Measurements:
    """All metrics of every step of a log.

    Args:
        log: an unfinished one is measured as far as it goes. Where steps are missing, the
            distance that was travelled in them is taken from the recording.
        scope: which cells count; the explorable ones, unknown as free, by default.
        metrics: further metrics by name; with any, reading takes about three times as long.

    Raises:
        LogError: the log cannot be read.
        MapreplayError: a further metric failed.
    """
    scope, metrics = scope or Scope(), metrics or {}
    plan, recorded = log.header.floor_plan, log.table()
    cells = np.ones(plan.shape, np.bool_) if scope.everywhere else log.header.explorable
    travelled, agent = Travelled(), log.header.start
    predictions = _Predictions(plan.cells, cells)
    rows, further = [], []
    looks = _looks(log, whole_steps=bool(metrics))
    places = recorded.select("step", "row", "col", "path_length").iter_rows()
    following, unbroken = 0, True
    for (k, row, col, said), look in zip(places, looks, strict=True):
        header, before, agent = log.header.at(k), agent, Cell(row, col)
        travelled = travelled.to(before, agent)
        if k != following:
            unbroken = False
            predictions.skip()
        following = k + 1
        length = travelled.metres(plan.resolution) if unbroken else said
        observed, p_wall, fused = look.observed, look.p_wall, look.fused
        scores = measure(header, observed, p_wall, fused, length, scope.unknown_as, cells)
        rows.append(_values(scores))
        predictions.add(observed, p_wall)
        if look.step is not None:
            values = [guarded(n, m, header, cells, look.step) for n, m in metrics.items()]
            further.append(values)
    measured = _columns(RECORDED, rows)
    steps = pl.DataFrame(
        {"step": recorded["step"].to_numpy().astype(np.int32)}
        | measured
        | predictions.columns()
        | _columns(list(metrics), further)
    ).with_columns(pl.col(pl.Float64).fill_nan(None))
    disagreements = _disagreements(recorded, measured) if scope.as_recorded else ()
    return Measurements(steps, predictions.total, disagreements)


_values = attrgetter(*RECORDED)


@dataclass(frozen=True, eq=False)
class _Look:
    """What is measured of a step."""

    observed: Grid
    p_wall: Quantized | None
    fused: Grid
    step: Step | None
    """Read only if a further metric needs it."""


def _looks(log: EpisodeLog, *, whole_steps: bool) -> Iterator[_Look]:
    if whole_steps:
        for step in log.steps():
            yield _Look(step.observed, step.p_wall, step.fused, step)
    else:
        for maps in log.maps("observed", "p_wall", "fused"):
            observed, p_wall, fused = cast("tuple[Grid, Quantized | None, Grid]", maps)
            yield _Look(observed, p_wall, fused, None)


def _columns(names: Sequence[str], rows: Sequence[Sequence[float]]) -> dict[str, Floats]:
    table = np.array(rows, np.float64).reshape(-1, len(names)) if names else np.empty((0, 0))
    return {name: np.ascontiguousarray(table[:, i]) for i, name in enumerate(names)}


def _disagreements(
    recorded: pl.DataFrame, measured: Mapping[str, Floats]
) -> tuple[Disagreement, ...]:
    """Where the two differ at all: both come from the same arithmetic on the same maps."""
    found = []
    steps = recorded["step"].to_numpy()
    for name, values in measured.items():
        said = recorded[name].to_numpy()
        wrong = ~((said == values) | (np.isnan(said) & np.isnan(values)))
        found += [
            Disagreement(int(steps[k]), name, float(said[k]), float(values[k]))
            for k in np.flatnonzero(wrong).tolist()
        ]
    return tuple(sorted(found, key=lambda d: d.step))


class _Predictions:
    """Scores of the predictions of an episode on the cells that were not yet observed."""

    def __init__(self, truth: Grid, cells: Mask) -> None:
        self.total: PredictionCounts | None = None
        self._truth = truth
        self._cells = cells
        self._before: Quantized | None = None
        self._waiting: list[npt.NDArray[np.int64] | None] = []
        self._scores: list[Floats] = []
        self._changes: list[tuple[float, float]] = []

    def add(self, observed: Grid, p_wall: Quantized | None) -> None:
        """The next step."""
        self._changes.append(self._change(observed, p_wall))
        self._before = p_wall
        if p_wall is None:
            self._waiting.append(None)
            return
        counts = count_cells(p_wall, self._truth, observed, self._cells)
        self.total = counts if self.total is None else self.total + counts
        self._waiting.append(counts.cells)
        if len(self._waiting) * counts.cells.size >= _CHUNK:
            self._score()

    def skip(self) -> None:
        """Steps are missing before the next one: nothing can be said of what changed."""
        self._before = None

    def columns(self) -> dict[str, Floats]:
        """float64[steps] each: all scores, of all unobserved cells and by distance; changes."""
        self._score()
        names = [f"{score}_{where}" for where in _WHERE for score in SCORES]
        table = np.concatenate([np.empty((0, len(names))), *self._scores])
        columns = {name: np.ascontiguousarray(table[:, i]) for i, name in enumerate(names)}
        # Brier score and log loss of all of them are among the recorded metrics, where they
        # are summed cell by cell.
        return {n: c for n, c in columns.items() if n not in RECORDED} | _columns(
            CHANGES, self._changes
        )

    def _change(self, observed: Grid, p_wall: Quantized | None) -> tuple[float, float]:
        before = self._before
        if p_wall is None or before is None or p_wall.dtype != before.dtype:
            return np.nan, np.nan
        cells, total, flips = kernels.prediction_change(
            before, p_wall, observed, self._cells, float(certainty(p_wall))
        )
        return (total / cells, flips / cells) if cells else (np.nan, np.nan)

    def _score(self) -> None:
        """Make scores of the counts that are waiting, all at once."""
        waiting, self._waiting = self._waiting, []
        table = np.full((len(waiting), len(_WHERE) * len(SCORES)), np.nan)
        there = [k for k, counts in enumerate(waiting) if counts is not None]
        if there:
            groups: npt.NDArray[Any] = np.stack([c for c in waiting if c is not None])
            groups = np.concatenate([groups.sum(axis=1, keepdims=True), groups], axis=1)
            table[there] = _table(groups).reshape(len(there), -1)
        self._scores.append(table)


def prediction_scores(counts: PredictionCounts | None) -> dict[str, float]:
    """`SCORES` of all counted cells and by distance, named like the columns of the steps; NaN
    without a prediction.
    """
    names = [f"{score}_{where}" for where in _WHERE for score in SCORES]
    if counts is None:
        return dict.fromkeys(names, float("nan"))
    groups = np.concatenate([counts.cells.sum(axis=0, keepdims=True), counts.cells])
    return dict(zip(names, _table(groups).ravel().tolist(), strict=True))


def _table(counts: npt.NDArray[np.int64]) -> Floats:
    """float64[..., scores] of int64[..., 2, levels]."""
    columns = score_columns(counts)
    return np.stack([getattr(columns, name) for name in SCORES], axis=-1).astype(np.float64)


def distance_labels() -> tuple[str, ...]:
    """What the distance groups are called in columns: "at_1", "at_3_4", ..., "beyond_16"."""
    first, labels = 1, []
    for last in DISTANCES:
        labels.append(f"at_{last}" if first == last else f"at_{first}_{last}")
        first = last + 1
    return (*labels, f"beyond_{first - 1}")


_WHERE: Final = ("unobserved", *distance_labels())
