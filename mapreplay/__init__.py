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
    from mapreplay.episode import prepare_episode, record, run_episode
    from mapreplay.errors import MapreplayError
    from mapreplay.external import ExternalEpisode, unknown_floor_plan
    from mapreplay.floorplan import FloorPlan
    from mapreplay.floorplans import open_source
    from mapreplay.recorders.log.reader import EpisodeLog
    from mapreplay.recorders.log.writer import EpisodeWriter
    from mapreplay.recorders.viewer.notebook import show
    from mapreplay.step import EpisodeHeader, Step

__all__ = [
    "EpisodeConfig",
    "EpisodeHeader",
    "EpisodeLog",
    "EpisodeWriter",
    "ExternalEpisode",
    "FloorPlan",
    "MapreplayError",
    "Step",
    "open_source",
    "prepare_episode",
    "record",
    "run_episode",
    "show",
    "unknown_floor_plan",
]

_HOMES = {
    "EpisodeConfig": "mapreplay.config",
    "EpisodeHeader": "mapreplay.step",
    "EpisodeLog": "mapreplay.recorders.log.reader",
    "EpisodeWriter": "mapreplay.recorders.log.writer",
    "ExternalEpisode": "mapreplay.external",
    "FloorPlan": "mapreplay.floorplan",
    "MapreplayError": "mapreplay.errors",
    "Step": "mapreplay.step",
    "open_source": "mapreplay.floorplans",
    "prepare_episode": "mapreplay.episode",
    "record": "mapreplay.episode",
    "run_episode": "mapreplay.episode",
    "show": "mapreplay.recorders.viewer.notebook",
    "unknown_floor_plan": "mapreplay.external",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'mapreplay' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return __all__
