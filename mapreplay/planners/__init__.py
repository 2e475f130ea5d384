"""Planners: pure functions from a situation to a rating of the frontier and a choice."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Protocol, cast

import numpy as np

from mapreplay import plugins
from mapreplay.planning import Float64s, Situation
from mapreplay.step import EpisodeHeader

RULES: Final = "2"
"""Which rules our planners decide by; a log has them among its versions, as ``rules``. Raise it
when a decision changes, and let `planner_of` find the rules of the logs that there are.
"""


@dataclass(frozen=True, eq=False)
class Choice:
    """How a planner rated the frontier cells, and which it took."""

    index: int
    """Into the situation's frontier."""
    utility: Float64s
    """float64[n]."""
    reward: Float64s
    """float64[n]."""
    random_draw: int | None = None
    """The raw 64-bit number that decided, where chance did."""


class Planner(Protocol):
    """Anything that can choose a frontier cell.

    A planner keeps no state between steps: the same situation gives the same choice, so that
    a log's decisions can be made again.
    """

    def choose(self, situation: Situation) -> Choice:
        """Rate the frontier and choose one of its cells."""
        ...


def load_planner(name: str) -> Planner:
    """The planner registered as `name`.

    Raises:
        PluginError: there is none, or it is broken.
    """
    return cast("Planner", plugins.load(plugins.PluginKind.PLANNERS, name)())


def planner_of(header: EpisodeHeader) -> Planner:
    """The planner of a log, as it decided in the version that wrote the log.

    Raises:
        PluginError: there is none of that name, or it is broken.
    """
    if dict(header.versions).get("rules", "1") == "1":
        from mapreplay.planners import rules_1

        if header.config.planner in rules_1.PLANNERS:
            return rules_1.PLANNERS[header.config.planner]
    return load_planner(header.config.planner)


def best(utility: Float64s, costs: Float64s) -> int:
    """Index of the greatest utility; of several the one of least cost, then the first, which
    is the one of least row, then column.
    """
    ties = np.flatnonzero(utility == utility.max())
    return int(ties[np.argmin(costs[ties])])
