"""The shortest tour there is, by going through all: for small floor plans.

Breadth first over what the agent can know: where it is, and which cells were seen. Of two states
at one place, the one that is not later and knows all that the other knows makes it superfluous.
States from which no shorter tour than a known one can come are left out: those that would not
know enough in time even if each move that is left were made in all directions at once.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from mapreplay.analysis.limits import kernels
from mapreplay.analysis.limits.task import CoverageTask
from mapreplay.analysis.limits.tour import short_tour
from mapreplay.errors import FloorPlanError

MAX_STATES: Final = 200_000


def shortest(task: CoverageTask, max_states: int = MAX_STATES) -> int:
    """Moves of the shortest tour after which enough is known.

    Raises:
        FloorPlanError: there are more states to go through than `max_states`.
    """
    views = [_bits(task.seen_from(place).tolist()) for place in range(len(task.places))]
    if views[task.start].bit_count() >= task.needed:
        return 0
    achieved = short_tour(task).moves
    reach = _within(task, views, achieved)
    kept: list[list[int]] = [[] for _ in views]
    layer = {task.start: [views[task.start]]}
    states = 0
    for moves in range(1, achieved):
        left = achieved - 1 - moves
        found: dict[int, list[int]] = {}
        for place, masks in layer.items():
            for near in task.moves[place].tolist():
                if near < 0:
                    continue
                for mask in masks:
                    known = mask | views[near]
                    if known.bit_count() >= task.needed:
                        return moves
                    if (known | reach[near][left]).bit_count() < task.needed:
                        continue
                    if any(known | other == other for other in kept[near]):
                        continue
                    kept[near] = [o for o in kept[near] if o | known != known] + [known]
                    found.setdefault(near, []).append(known)
                    states += 1
                    if states > max_states:
                        raise FloorPlanError(
                            f"more than {max_states} states: too large to go through all"
                        )
        layer = {p: [m for m in masks if m in set(kept[p])] for p, masks in found.items()}
    return achieved


def _bits(numbers: list[int]) -> int:
    return sum(1 << n for n in numbers)


def _within(task: CoverageTask, views: list[int], most: int) -> list[list[int]]:
    """Of each place, and each number of moves up to `most`, what can be seen within them."""
    away = np.empty(len(views), np.int32)
    queue = np.empty_like(away)
    found = []
    for place in range(len(views)):
        kernels.distances(task.moves, np.array([place], np.int32), kernels.FAR, away, queue)
        by_distance = [0] * (most + 1)
        for other, moves in enumerate(away.tolist()):
            if moves <= most:
                by_distance[moves] |= views[other]
        for moves in range(1, most + 1):
            by_distance[moves] |= by_distance[moves - 1]
        found.append(by_distance)
    return found
