"""What a coverage curve says in a few numbers: its area, and when it passed a milestone."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from mapreplay.step import Outcome

Curve = npt.NDArray[np.float64]
"""float64[n]: a coverage at step 0, 1, ..., n - 1; NaN where it is undefined."""

MILESTONES: Final = (0.50, 0.75, 0.90, 0.95, 0.98)


def first_reached(curve: Curve, level: float) -> int | None:
    """The first step at which the curve is at `level` or above; None if it never is."""
    reached = np.flatnonzero(curve >= level)
    return int(reached[0]) if reached.size else None


def mapping_time(coverage: Curve, target: float, outcome: str) -> int | None:
    """When an episode had mapped its floor plan: what every verb says, in steps; None if never.

    It is the first step at which the coverage of the built map is at `target`. Without a true map,
    of which the coverage would be a share (all of it is NaN), it is the step at which the episode
    ended as mapped, by its own account. The record in the log is of the coverage alone.
    """
    if coverage.size and np.isnan(coverage).all():
        return coverage.size - 1 if outcome == Outcome.MAPPED else None
    return first_reached(coverage, target)


def extended(curve: Curve, budget: int) -> Curve:
    """float64[budget + 1]: the curve on steps 0 to `budget`; its last value is held.

    An episode that ended keeps the map that it had, whether it was mapped or sealed in.

    Raises:
        ValueError: the curve is empty, or the budget negative.
    """
    if curve.size == 0 or budget < 0:
        raise ValueError(f"a curve of {curve.size} steps on a budget of {budget}")
    return np.asarray(np.pad(curve[: budget + 1], (0, max(0, budget + 1 - curve.size)), "edge"))


def area(curve: Curve, budget: int) -> float:
    """The mean of the curve over steps 0 to `budget`, its last value held, in [0, 1].

    This is the area under it divided by the budget: 1 would be knowing all from the start. NaN
    for an empty curve. Where the curve is NaN, the value before is held (0 before the first).
    """
    if curve.size == 0:
        return math.nan
    curve = _held(curve)
    seen = curve[: budget + 1]
    held = budget + 1 - seen.size
    return float((seen.sum() + held * seen[-1]) / (budget + 1))


def _held(curve: Curve) -> Curve:
    known = ~np.isnan(curve)
    if known.all() or not known.any():  # all of it is undefined without a true map
        return curve
    last = np.maximum.accumulate(np.where(known, np.arange(curve.size), -1))
    return np.where(last < 0, 0.0, curve[np.maximum(last, 0)])
