"""The planners of versions before 0.2.0, whose logs have no ``rules`` among their versions.

Their gains were sums of rounded numbers in the order of the rays, so that a tie could be decided
by the last bit. They are kept to recompute the decisions of such logs, bit for bit.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from mapreplay.grid import UNKNOWN
from mapreplay.mapping import dequantize
from mapreplay.planners import Choice, Planner, best
from mapreplay.planners.informative_path import InformativePath
from mapreplay.planning import Float64s, Situation


class CostUtility1:
    """`mapreplay.planners.cost_utility.CostUtility`, with rounded gains."""

    def choose(self, situation: Situation) -> Choice:
        """See `mapreplay.planners.Planner`."""
        unseen = situation.observed == UNKNOWN
        worth = np.asarray(unseen, np.float64)
        if situation.prediction is not None:
            confidence = np.abs(2 * dequantize(situation.prediction) - 1)
            worth = np.where(unseen, 1 - confidence, 0.0)
        reward = situation.sums_in_view(worth)
        utility = reward / (1 + situation.costs)
        return Choice(best(utility, situation.costs), utility, reward)


class InformativePath1(InformativePath):
    """`InformativePath`, with gains that are not rounded."""

    @staticmethod
    def settled(gains: Float64s) -> Float64s:
        """See `InformativePath`."""
        return gains


PLANNERS: Final[dict[str, Planner]] = {
    "cost-utility": CostUtility1(),
    "informative-path": InformativePath1(),
}
"""By their names in logs; other planners are unchanged."""
