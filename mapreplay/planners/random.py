"""Random Exploration (paper, section "Path Planning Algorithms")."""

from __future__ import annotations

import numpy as np

from mapreplay.planners import Choice
from mapreplay.planning import Situation
from mapreplay.randomness import scale


class RandomExploration:
    """Chooses a frontier cell uniformly at random, and again when it is no longer one."""

    def choose(self, situation: Situation) -> Choice:
        """See `mapreplay.planners.Planner`."""
        rating = np.ones(len(situation.frontier))
        if (same := situation.previous_index) is not None:
            return Choice(same, rating, rating)
        raw = situation.draws.raw()
        return Choice(scale(raw, len(rating)), rating, rating, raw)
