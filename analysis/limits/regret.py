"""Regret: how much longer an episode took than a planner that knows the floor plan."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from functools import lru_cache

from mapreplay.analysis.comparison.compare import Measure, Terms, mapping_time
from mapreplay.analysis.episodes.corpus import LoggedEpisode, Start
from mapreplay.analysis.limits.measure import reference_moves
from mapreplay.errors import FloorPlanError
from mapreplay.floorplan import FloorPlan
from mapreplay.grid import Cell
from mapreplay.sensor import Sensor
from mapreplay.step import OURS


def reference_time(episode: LoggedEpisode, target: float) -> float:
    """Mapping time of a short tour of the episode's floor plan, from its start and sensor.

    NaN where there is none: without a true map, on too large a floor plan, or for an external
    episode, whose steps are not moves of the simulator.
    """
    header = episode.header
    if header.simulator != OURS or not header.floor_plan.has_truth:
        return math.nan
    return _reference(_Plan(header.floor_plan), header.start, target, header.sensor)


def reference_times(episodes: Iterable[LoggedEpisode], target: float) -> Iterator[float]:
    """`reference_time` of each floor plan and start, once; a second on the first time."""
    seen = set[Start]()
    for episode in episodes:
        if episode.start not in seen:
            seen.add(episode.start)
            yield reference_time(episode, target)


def _regret(episode: LoggedEpisode, terms: Terms, budget: int) -> float:
    time = min(mapping_time(episode, terms.target), float(budget))
    return time / max(reference_time(episode, terms.target), 1.0) - 1


REGRET = Measure("regret", "1", 3, _regret)
"""T / T_reference - 1, where T is at most the budget; a reference of no move counts as one move.

0 is as fast as the reference. It can be negative: the reference has to observe everything, and
an agent that builds the fused map does not.
"""


class _Plan:
    """A floor plan that is the same as another with the same cells."""

    def __init__(self, floor_plan: FloorPlan) -> None:
        self.floor_plan = floor_plan

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Plan) and self.floor_plan.sha256 == other.floor_plan.sha256

    def __hash__(self) -> int:
        return hash(self.floor_plan.sha256)


@lru_cache(maxsize=4096)
def _reference(plan: _Plan, start: Cell, target: float, sensor: Sensor) -> float:
    try:
        return float(reference_moves(plan.floor_plan, start, target, sensor))
    except FloorPlanError:
        return math.nan
