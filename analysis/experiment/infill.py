"""What would suffice: a predictor that knows the truth near what was observed.

It is a bound to compare networks with, no predictor: it needs the true map. So it is made from a
floor plan inside of an experiment, and is never registered under a name that `mapreplay run`
could be given.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np
import numpy.typing as npt

from mapreplay.analysis.metrics.calibration import distance_from_observed
from mapreplay.floorplan import FloorPlan
from mapreplay.grid import OCCUPIED, UNKNOWN, Grid
from mapreplay.step import PredictorIdentity

RADII: Final = (1, 2, 4, 8)
PREFIX: Final = "infill-"


@dataclass(frozen=True, eq=False)
class InFill:
    """Right and certain within `radius` cells (chessboard distance) of an observed cell.

    Everywhere else, and where the truth is unknown, it says `wall_share`.
    """

    floor_plan: FloorPlan
    radius: int
    wall_share: float
    """In [0, 1]: the mean of the training plans."""
    identity: PredictorIdentity = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "identity", PredictorIdentity(f"{PREFIX}{self.radius}", ""))

    def predict(self, observed: Grid) -> npt.NDArray[np.float32]:
        """See `mapreplay.predictors.Predictor`."""
        truth = self.floor_plan.cells
        near = (distance_from_observed(observed) <= self.radius) & (truth != UNKNOWN)
        return np.where(near, truth == OCCUPIED, self.wall_share).astype(np.float32)
