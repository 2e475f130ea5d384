"""Metrics of a log, step by step, computed again from its maps alone."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Protocol, cast

import polars as pl

from mapreplay import plugins
from mapreplay.episode import Travelled, measure
from mapreplay.errors import MapreplayError
from mapreplay.grid import FREE, OCCUPIED, Mask
from mapreplay.recorders.log import EpisodeLog
from mapreplay.scores import UnknownAs
from mapreplay.step import EpisodeHeader, Step, StepMetrics


class Metric(Protocol):
    """A number for each step; others come in through the entry point ``mapreplay.metrics``."""

    @property
    def unit(self) -> str:
        """Of the number; "1" for a share or a count."""
        ...

    def measure(self, header: EpisodeHeader, region: Mask, step: Step) -> float:
        """The value at `step`, NaN where undefined; `region` (bool[H, W]) is explorable."""
        ...


class FrontierSize:
    """Number of frontier cells that the planner chose from."""

    unit = "1"

    def measure(self, header: EpisodeHeader, region: Mask, step: Step) -> float:  # noqa: ARG002
        """See `Metric`."""
        return float(len(step.frontier))


class FalseWalls:
    """Explorable free cells that the fused map takes for walls."""

    unit = "1"

    def measure(self, header: EpisodeHeader, region: Mask, step: Step) -> float:
        """See `Metric`."""
        truth = header.floor_plan.cells
        return float((region & (step.fused == OCCUPIED) & (truth == FREE)).sum())


class FalseFree:
    """Explorable walls that the fused map takes for free."""

    unit = "1"

    def measure(self, header: EpisodeHeader, region: Mask, step: Step) -> float:
        """See `Metric`."""
        truth = header.floor_plan.cells
        return float((region & (step.fused == FREE) & (truth == OCCUPIED)).sum())


def load_metric(name: str) -> Metric:
    """The metric registered as `name`.

    Raises:
        PluginError: there is none, or it is broken.
    """
    return cast("Metric", plugins.load(plugins.Group.METRICS, name)())


@dataclass(frozen=True)
class Measured:
    """A step's metrics, as recorded and computed again."""

    step: int
    recorded: StepMetrics
    metrics: StepMetrics
    extra: tuple[float, ...]


def recompute(
    log: EpisodeLog,
    *,
    unknown_as: UnknownAs = UnknownAs.FREE,
    region: Mask | None = None,
    extra: Mapping[str, Metric] | None = None,
) -> Iterator[Measured]:
    """All metrics of every step, from the logged poses and maps and the true map.

    `region` (bool[H, W]) is the explorable cells by default; `extra` are further metrics by
    name. Memory is bounded by a step.

    Raises:
        LogError: the log cannot be read.
        MapreplayError: a further metric failed.
    """
    cells = log.explorable if region is None else region
    travelled, agent = Travelled(), log.header.start
    for step in log.steps():
        header = log.header.at(step.index)
        travelled = travelled.to(agent, step.agent)
        agent = step.agent
        path_length = travelled.metres(header.floor_plan.resolution)
        metrics = measure(
            header, cells, step.observed, step.p_wall, step.fused, path_length, unknown_as
        )
        values = tuple(
            _guarded(name, metric, header, cells, step) for name, metric in (extra or {}).items()
        )
        yield Measured(step.index, step.metrics, metrics, values)


def _guarded(name: str, metric: Metric, header: EpisodeHeader, region: Mask, step: Step) -> float:
    try:
        return float(metric.measure(header, region, step))
    except Exception as error:
        raise MapreplayError(
            f"metric {name!r} failed at step {step.index} ({type(error).__name__}: {error})"
        ) from error


@dataclass(frozen=True)
class Disagreement:
    """A metric whose recorded value is not the one that the logged maps give."""

    step: int
    name: str
    recorded: float
    recomputed: float

    def __str__(self) -> str:
        return (
            f"step {self.step}: {self.name} was recorded as {self.recorded!r}, "
            f"the maps give {self.recomputed!r}"
        )


def disagreements(measured: Measured) -> list[Disagreement]:
    """Where the two differ at all: both come from the same arithmetic on the same maps."""
    pairs = zip(asdict(measured.recorded).items(), asdict(measured.metrics).values(), strict=True)
    return [
        Disagreement(measured.step, name, old, new)
        for (name, old), new in pairs
        if not (old == new or (math.isnan(old) and math.isnan(new)))
    ]


def metrics_frame(rows: Sequence[Measured], extra: Sequence[str] = ()) -> pl.DataFrame:
    """One row a step: ``step``, all of `StepMetrics`, and the further metrics; NaN is null."""
    columns: dict[str, list[float]] = {
        name: [getattr(row.metrics, name) for row in rows] for name in StepMetrics.names()
    }
    for i, name in enumerate(extra):
        columns[name] = [row.extra[i] for row in rows]
    schema = dict.fromkeys(columns, pl.Float64)
    frame = pl.DataFrame(columns, schema=schema).fill_nan(None)
    return frame.insert_column(0, pl.Series("step", [row.step for row in rows], pl.Int64))
