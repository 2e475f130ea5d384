"""Floor-plan sources: from a specification to floor plans, one at a time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from mapreplay.floorplan import FloorPlan


class FloorPlanSource(Protocol):
    """A collection of floor plans with ids."""

    @property
    def default_predictor(self) -> str:
        """The predictor that suits these floor plans."""
        ...

    def ids(self) -> Sequence[str]:
        """All ids, in a fixed order. Raises FloorPlanError if the source cannot be read."""
        ...

    def load(self, floor_plan_id: str) -> FloorPlan:
        """One floor plan. Raises FloorPlanError if it is not there, or is refused."""
        ...
