"""Metrics of many logs: in several processes, through a store, so that memory stays bounded."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeAlias

import polars as pl

from mapreplay.analysis.metrics.measure import Scope, measure_log
from mapreplay.analysis.metrics.per_episode import episode_metrics
from mapreplay.analysis.metrics.registry import load_metric
from mapreplay.analysis.metrics.store import Store, Stored
from mapreplay.analysis.pool import WorkerError, map_unordered
from mapreplay.errors import LogError, MapreplayError
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.recorders.state import LogState
from mapreplay.text import printable


@dataclass(frozen=True)
class MeasuredLog:
    """A log and where its tables are."""

    log: Path
    stored: Stored
    known: bool
    """The tables were there already."""
    state: LogState
    """Whether the log is whole."""

    def steps(self) -> pl.LazyFrame:
        """One row a step, with the log's ``file`` in front; read when it is collected."""
        frame = pl.scan_parquet(self.stored.steps)
        return frame.select(pl.lit(printable(str(self.log))).alias("file"), pl.all())

    def episode(self) -> pl.DataFrame:
        """One row, see `episode_metrics`."""
        frame = pl.read_parquet(self.stored.episode)
        return frame.with_columns(pl.lit(printable(str(self.log))).alias("file"))


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

    With further `metrics` (their names) everything is measured anew: what they depend on is
    not known. A log that cannot be read is a result like others.

    Raises:
        PluginError: a further metric is unknown or broken.
        MapreplayError: the store cannot be written.
    """
    for name in metrics:
        load_metric(name)
    work = partial(_measure, store=store, scope=scope or Scope(), metrics=tuple(metrics))
    for result in map_unordered(work, logs, jobs, lost=Unmeasured, name=str):
        if isinstance(result, Unmeasured) and not isinstance(result.error, LogError | WorkerError):
            raise result.error
        yield result


def _measure(path: Path, store: Store, scope: Scope, metrics: tuple[str, ...]) -> Result:
    try:
        log = EpisodeLog(path)
        path = log.path  # it may have been finished, and renamed, meanwhile
        key = store.key(path, scope)
        found = None if metrics else store.find(key)
        if found is not None:
            return MeasuredLog(path, found, known=True, state=log.state)
        measured = measure_log(log, scope, {name: load_metric(name) for name in metrics})
        stored = store.keep(key, measured.steps, episode_metrics(log, measured, metrics))
        return MeasuredLog(path, stored, known=False, state=log.state)
    except OSError as error:
        reason = error.strerror or str(error)
        return Unmeasured(path, MapreplayError(f"{store.folder}: cannot be written ({reason})"))
    except MapreplayError as error:
        return Unmeasured(path, error)
