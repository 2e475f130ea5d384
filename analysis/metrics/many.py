"""Metrics of many logs: in several processes, through a store, so that memory stays bounded."""

from __future__ import annotations

import secrets
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import polars as pl

from mapreplay.analysis.cache import key_of
from mapreplay.analysis.metrics.measure import Scope, measure_log
from mapreplay.analysis.metrics.per_episode import episode_metrics
from mapreplay.analysis.metrics.registry import load_metric
from mapreplay.analysis.metrics.store import Store, Tables
from mapreplay.analysis.pool import WorkerError, map_unordered
from mapreplay.errors import LogError, MapreplayError
from mapreplay.recorders.log.blame import UnforeseenError, blaming
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.recorders.log.state import LogState
from mapreplay.text import printable


@dataclass(frozen=True, eq=False)
class MeasuredLog:
    """A log that was measured."""

    log: Path
    known: bool
    """The tables were there already."""
    state: LogState
    """Whether the log is whole."""
    kept: bool
    """They are there for the next time."""
    key: str
    """The same of two logs only if they are the same, byte for byte."""
    _episode: pl.DataFrame
    _schema: pl.Schema
    """Of the table of steps."""
    _task: _Task

    def steps(self) -> pl.LazyFrame:
        """One row a step, with the log's ``file`` in front; read when it is collected.

        What is no longer in the store then, or was never kept, is measured again.
        """
        frame = pl.defer(self._read_steps, schema=self._schema)
        return frame.select(pl.lit(printable(str(self.log))).alias("file"), pl.all())

    def episode(self) -> pl.DataFrame:
        """One row, see `episode_metrics`."""
        return self._episode.with_columns(pl.lit(printable(str(self.log))).alias("file"))

    def _read_steps(self) -> pl.DataFrame:
        found = self._task.store.find(self.key)
        return (found or self._task.measured(EpisodeLog(self.log))).steps


@dataclass(frozen=True)
class Unmeasured:
    """A log that could not be measured; `error` names it and says why."""

    log: Path
    error: MapreplayError


Result: TypeAlias = MeasuredLog | Unmeasured


def measure_logs(
    logs: Sequence[Path],
    store: Store,
    *,
    scope: Scope | None = None,
    metrics: Sequence[str] = (),
    jobs: int = 1,
) -> Iterator[Result]:
    """Measure every log into `store`, or find it there; results come as they are done.

    With further `metrics` (their names) everything is measured again: what they depend on is
    not known. A log that cannot be read is a result too, and so is one at which a process died.
    A store that cannot be written only costs time.

    Raises:
        PluginError: a further metric is unknown or broken.
        MapreplayError: a further metric failed.
    """
    for name in metrics:
        load_metric(name)
    task = _Task(store, scope or Scope(), tuple(metrics), secrets.token_hex() if metrics else "")
    for result in map_unordered(task, logs, jobs, lost=_lost):
        if isinstance(result, Unmeasured) and not isinstance(result.error, LogError):
            raise result.error
        yield result


def _lost(log: Path, error: WorkerError) -> Unmeasured:
    return Unmeasured(log, UnforeseenError(f"{log}: {error}"))


@dataclass(frozen=True)
class _Task:
    """What is done with each log."""

    store: Store
    scope: Scope
    metrics: tuple[str, ...]
    nonce: str
    """With further metrics, which may change: only this run finds the tables."""

    def __call__(self, path: Path) -> Result:
        try:
            with blaming(path):
                return self._result(EpisodeLog(path))
        except MapreplayError as error:
            return Unmeasured(path, error)

    def measured(self, log: EpisodeLog) -> Tables:
        """The tables, measured now."""
        measured = measure_log(log, self.scope, {name: load_metric(name) for name in self.metrics})
        return Tables(measured.steps, episode_metrics(log, measured, self.metrics))

    def _result(self, log: EpisodeLog) -> MeasuredLog:
        path = log.path  # it may have been finished, and renamed, meanwhile
        key = self.store.key(path, self.scope)
        if self.nonce:
            key = key_of(key, self.nonce)
        found = self.store.find(key)
        tables = found or self.measured(log)
        kept = found is not None or self._keep(key, tables)
        schema = tables.steps.schema
        known = found is not None
        return MeasuredLog(path, known, log.state, kept, key, tables.episode, schema, self)

    def _keep(self, key: str, tables: Tables) -> bool:
        try:
            self.store.keep(key, tables)
        except OSError:
            return False
        return True
