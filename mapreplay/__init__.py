"""mapreplay: record, replay and analyse agents that map floor plans with a learned predictor.

    FloorPlan --sense--> observed --predict--> p_wall --fuse--> fused --plan--> Decision --move-->
    Step --EpisodeWriter--> episode.mcap --EpisodeLog--> Step

The names below are imported when they are first used, so that ``import mapreplay`` is quick.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mapreplay.config import EpisodeConfig
    from mapreplay.episode import StepSink, prepare_episode, record, run_episode
    from mapreplay.errors import (
        ConfigError,
        ExistsError,
        FloorPlanError,
        LogError,
        MapreplayError,
        PluginError,
        UsageError,
        WeightsError,
        WriteError,
    )
    from mapreplay.external import ExternalEpisode, unknown_floor_plan
    from mapreplay.floorplan import FloorPlan
    from mapreplay.floorplans import open_source
    from mapreplay.planners import Choice, Planner, load_planner
    from mapreplay.planning import Situation
    from mapreplay.predictors import Predictor, load_predictor
    from mapreplay.recorders.log.find import find_logs
    from mapreplay.recorders.log.reader import EpisodeLog
    from mapreplay.recorders.log.recover import recover
    from mapreplay.recorders.log.writer import EpisodeWriter
    from mapreplay.recorders.viewer.notebook import show
    from mapreplay.step import EpisodeHeader, Step


__version__: str

__all__ = [
    "Choice",
    "ConfigError",
    "EpisodeConfig",
    "EpisodeHeader",
    "EpisodeLog",
    "EpisodeWriter",
    "ExistsError",
    "ExternalEpisode",
    "FloorPlan",
    "FloorPlanError",
    "LogError",
    "MapreplayError",
    "Planner",
    "PluginError",
    "Predictor",
    "Situation",
    "Step",
    "StepSink",
    "UsageError",
    "WeightsError",
    "WriteError",
    "__version__",
    "find_logs",
    "load_planner",
    "load_predictor",
    "open_source",
    "prepare_episode",
    "record",
    "recover",
    "run_episode",
    "show",
    "unknown_floor_plan",
]

_HOMES = {
    "Choice": "planners",
    "ConfigError": "errors",
    "EpisodeConfig": "config",
    "EpisodeHeader": "step",
    "EpisodeLog": "recorders.log.reader",
    "EpisodeWriter": "recorders.log.writer",
    "ExistsError": "errors",
    "ExternalEpisode": "external",
    "FloorPlan": "floorplan",
    "FloorPlanError": "errors",
    "LogError": "errors",
    "MapreplayError": "errors",
    "Planner": "planners",
    "PluginError": "errors",
    "Predictor": "predictors",
    "Situation": "planning",
    "Step": "step",
    "StepSink": "episode",
    "UsageError": "errors",
    "WeightsError": "errors",
    "WriteError": "errors",
    "find_logs": "recorders.log.find",
    "load_planner": "planners",
    "load_predictor": "predictors",
    "open_source": "floorplans",
    "prepare_episode": "episode",
    "record": "episode",
    "recover": "recorders.log.recover",
    "run_episode": "episode",
    "show": "recorders.viewer.notebook",
    "unknown_floor_plan": "external",
}


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("mapreplay")
    if name not in _HOMES:
        raise AttributeError(f"module 'mapreplay' has no attribute {name!r}")
    return getattr(import_module(f"mapreplay.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return __all__
