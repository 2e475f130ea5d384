"""Planners, predictors, floor-plan sources and metrics by name, through entry points.

Ours are registered like those of other packages. Listing loads nothing; a plug-in that cannot
be loaded is reported with its distribution when it is used, and does not affect others.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from mapreplay.errors import MapreplayError, PluginError


class PluginKind(StrEnum):
    """The entry-point groups, and the signatures of their factories."""

    PLANNERS = "mapreplay.planners"
    """() -> mapreplay.planners.Planner"""
    PREDICTORS = "mapreplay.predictors"
    """(device: str) -> mapreplay.predictors.Predictor"""
    FLOORPLANS = "mapreplay.floorplans"
    """(rest_of_the_spec: str, resolution: float | None) -> mapreplay.floorplans.FloorPlanSource"""
    METRICS = "mapreplay.metrics"
    """() -> mapreplay.analysis.metrics.registry.Metric"""

    @property
    def noun(self) -> str:
        """The name of the kind in messages."""
        return {"planners": "planner", "predictors": "predictor", "floorplans": "floor-plan source",
                "metrics": "metric"}[self.value.rpartition(".")[2]]  # fmt: skip


@dataclass(frozen=True)
class Plugin:
    """A name and the distribution that provides it."""

    name: str
    distribution: str
    entry: EntryPoint


def available(kind: PluginKind) -> dict[str, Plugin]:
    """All plug-ins of a kind by name, sorted; nothing is imported.

    If two have the same name, ours wins, so that an installed package cannot silently change the
    meaning of a built-in name.
    """
    found: dict[str, Plugin] = {}
    for entry in entry_points(group=kind.value):
        owner = entry.dist.name if entry.dist else "an unknown distribution"
        if entry.name not in found or owner == "mapreplay":
            found[entry.name] = Plugin(entry.name, owner, entry)
    return dict(sorted(found.items()))


def find(kind: PluginKind, name: str) -> Plugin:
    """The plug-in called `name`; nothing is imported.

    Raises:
        PluginError: it is unknown.
    """
    plugins = available(kind)
    if name not in plugins:
        raise PluginError(f"unknown {kind.noun} {name!r}; known: {', '.join(plugins) or 'none'}")
    return plugins[name]


def load(kind: PluginKind, name: str) -> Callable[..., Any]:
    """The factory called `name`.

    Raises:
        PluginError: it is unknown, or its import failed.
    """
    plugin = find(kind, name)
    try:
        factory = plugin.entry.load()
    except Exception as error:  # anything that an external module does on import
        raise PluginError(_broken(kind, plugin, error)) from error
    if not callable(factory):
        raise PluginError(f"{kind.noun} {name!r} of {plugin.distribution} is not callable")

    def guarded(*args: Any) -> Any:
        try:
            return factory(*args)
        except MapreplayError:
            raise
        except Exception as error:
            raise PluginError(_broken(kind, plugin, error)) from error

    return guarded


def _broken(kind: PluginKind, plugin: Plugin, error: Exception) -> str:
    reason = " ".join(str(error).split()) or "no message"
    return (
        f"{kind.noun} {plugin.name!r} of {plugin.distribution} cannot be loaded "
        f"({type(error).__name__}: {reason})"
    )
