"""A short tour of a planner that knows the floor plan: no shorter than the shortest there is.

Stops are chosen by how much of what is still unknown they show for their detour, and the tour
goes from one to the next on shortest paths, looking at every place. It is then improved by large
neighbourhood search (Shaw 1998): some stops are taken out, others put in, what is seen on the way
anyhow is left out, stops are shifted and stretches turned round. Seeded: the same task gives the
same tour.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from mapreplay.analysis.limits import kernels
from mapreplay.analysis.limits.task import CoverageTask, Ints
from mapreplay.errors import FloorPlanError

ROUNDS: Final = 200
"""Times that stops are removed and others inserted."""
MAX_PLACES: Final = 30_000
"""Reachable free cells above which no tour is searched for."""


@dataclass(frozen=True, eq=False)
class Tour:
    """A walk from the start, at whose end enough is known."""

    path: Ints
    """int32[moves + 1]: places, each one move from that before."""
    stops: Ints
    """int32[n]: the places that it goes between on shortest paths, the first the start."""

    @property
    def moves(self) -> int:
        """Its mapping time."""
        return len(self.path) - 1


def short_tour(task: CoverageTask, rounds: int = ROUNDS, seed: int = 0) -> Tour:
    """A short tour that observes enough.

    Raises:
        FloorPlanError: the floor plan is too large.
    """
    nothing = np.zeros(len(task.cells), np.bool_)
    start = np.array([task.start], np.int32)
    return search(task, start, nothing, task.needed, rounds, seed)


def search(
    task: CoverageTask,
    stops: Ints,
    before: npt.NDArray[np.bool_],
    needed: int,
    rounds: int,
    seed: int,
) -> Tour:
    """A short tour that observes `needed` cells besides those that are known before.

    Args:
        task: the floor plan.
        stops: int32[n] that the search begins with, the first where the tour starts.
        before: bool[N], cells that count as known without being seen.
        needed: at most the number of other cells.
        rounds: times that it is improved.
        seed: of the search.

    Raises:
        FloorPlanError: the floor plan is too large.
    """
    places = len(task.places)
    if places > MAX_PLACES:
        raise FloorPlanError(
            f"{places} free cells can be reached; a tour is searched for on at most {MAX_PLACES}"
        )
    seer_start, seers = task.seers
    kept = np.empty(max(places, len(stops)) + 1, np.int32)
    kept[: len(stops)] = stops
    count, length = kernels.improve(
        kept, len(stops), kernels.FAR, before, needed, task.moves, task.view_start, task.view,
        seers, seer_start, rounds, np.array([seed], np.uint64),
    )  # fmt: skip
    if length == kernels.FAR:
        raise FloorPlanError("no tour was found that observes enough")
    path = kernels.trace(kept, count, before, needed, task.moves, task.view_start, task.view)
    return Tour(path, kept[:count].copy())
