"""A floor plan in numbers."""

from __future__ import annotations

from dataclasses import dataclass

from mapreplay.floorplan import FloorPlan, explorable
from mapreplay.grid import FREE, UNKNOWN, Cell


@dataclass(frozen=True)
class PlanSummary:
    """What `mapreplay floorplans` reports of a floor plan; sizes in cells unless noted."""

    id: str
    height: int
    width: int
    resolution: float
    """Metres per cell."""
    width_m: float
    height_m: float
    wall_share: float
    """Occupied share of the explorable cells, 0 to 1."""
    free: int
    explorable: int
    unknown: int
    start: Cell


def describe(plan: FloorPlan) -> PlanSummary:
    """Summarize `plan`, explored from its default start."""
    height, width = plan.shape
    return PlanSummary(
        id=plan.id,
        height=height,
        width=width,
        resolution=plan.resolution,
        width_m=width * plan.resolution,
        height_m=height * plan.resolution,
        wall_share=plan.wall_share,
        free=int((plan.cells == FREE).sum()),
        explorable=int(explorable(plan.cells, plan.default_start).sum()),
        unknown=int((plan.cells == UNKNOWN).sum()),
        start=plan.default_start,
    )
