"""Further metrics of a step, by name: built-in and from plug-ins."""

from __future__ import annotations

from typing import Protocol, cast

from mapreplay import plugins
from mapreplay.errors import MapreplayError
from mapreplay.grid import FREE, OCCUPIED, Mask
from mapreplay.step import EpisodeHeader, Step
from mapreplay.text import one_line


class Metric(Protocol):
    """A number for each step; plug-ins register under the entry point ``mapreplay.metrics``."""

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
    """Explorable free cells that are walls in the fused map."""

    unit = "1"

    def measure(self, header: EpisodeHeader, region: Mask, step: Step) -> float:
        """See `Metric`."""
        truth = header.floor_plan.cells
        return float((region & (step.fused == OCCUPIED) & (truth == FREE)).sum())


class FalseFree:
    """Explorable walls that are free in the fused map."""

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
    return cast("Metric", plugins.load(plugins.PluginKind.METRICS, name)())


def guarded(name: str, metric: Metric, header: EpisodeHeader, region: Mask, step: Step) -> float:
    """The value of a metric, perhaps of a plug-in, at a step.

    Raises:
        MapreplayError: it failed; the error names it.
    """
    try:
        return float(metric.measure(header, region, step))
    except Exception as error:
        raise MapreplayError(
            f"metric {name!r} failed at step {step.index} "
            f"({type(error).__name__}: {one_line(error)})"
        ) from error
