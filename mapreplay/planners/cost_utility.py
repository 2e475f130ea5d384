"""Cost-Utility (paper, section "Greedy Selection")."""

from __future__ import annotations

from mapreplay.planners import Choice, best
from mapreplay.planning import Situation


class CostUtility:
    """Chooses the greatest potential confidence increase per distance.

    utility = gain / (1 + distance), with the gain of `Situation.gains`.
    """

    def choose(self, situation: Situation) -> Choice:
        """See `mapreplay.planners.Planner`."""
        reward = situation.gains()
        utility = reward / (1 + situation.costs)
        return Choice(best(utility, situation.costs), utility, reward)
