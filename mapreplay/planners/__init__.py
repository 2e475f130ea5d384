"""Planners: pure functions from a situation to a rating of the frontier and a choice."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Protocol, cast

import numpy as np

from mapreplay import plugins
from mapreplay.planning import Float64s, Situation
from mapreplay.step import EpisodeHeader

RULES: Final = "2"
"""Version of our planners' rules, logged as ``rules``. Increase it when a decision changes, and let
`planner_of` return the old rules for existing logs.
"""


@dataclass(frozen=True, eq=False)
class Choice:
    """A planner's rating of the frontier cells, and the chosen one."""

    index: int
    """Index into the situation's frontier."""
    utility: Float64s
    """float64[n]."""
    reward: Float64s
    """float64[n]."""
    random_draw: int | None = None
    """The raw 64-bit random number of a random choice."""


class Planner(Protocol):
    """Anything that can choose a frontier cell.

    A planner keeps no state between steps: the same situation gives the same choice, so that
    a log's decisions can be recomputed.
    """

    def choose(self, situation: Situation) -> Choice:
        """Rate the frontier and choose one of its cells."""
        ...


def load_planner(name: str) -> Planner:
    """The planner registered as `name`.

    Raises:
        PluginError: it is unknown or broken.
    """
    return cast("Planner", plugins.load(plugins.PluginKind.PLANNERS, name)())


def planner_of(header: EpisodeHeader) -> Planner:
    """The planner of a log, with the rules of the version that wrote the log.

    Raises:
        PluginError: it is unknown or broken.
    """
    if dict(header.versions).get("rules", "1") == "1":
        from mapreplay.planners import rules_1

        if header.config.planner in rules_1.PLANNERS:
            return rules_1.PLANNERS[header.config.planner]
    return load_planner(header.config.planner)


def best(utility: Float64s, costs: Float64s) -> int:
    """Index of the greatest utility; ties are broken by the lowest cost, then the lowest row, then
    the lowest column.
    """
    ties = np.flatnonzero(utility == utility.max())
    return int(ties[np.argmin(costs[ties])])
