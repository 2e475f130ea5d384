"""Nearest Frontier (paper, section "Greedy Selection")."""

from __future__ import annotations

import numpy as np

from mapreplay.planners import Choice, best
from mapreplay.planning import Situation


class NearestFrontier:
    """Chooses the nearest frontier cell: utility 1 / (1 + distance)."""

    def choose(self, situation: Situation) -> Choice:
        """See `mapreplay.planners.Planner`."""
        utility = 1 / (1 + situation.costs)
        return Choice(best(utility, situation.costs), utility, np.ones_like(utility))
