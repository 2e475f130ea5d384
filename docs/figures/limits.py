"""The table "How tight the bound is" of docs/limits.md: bound and tour next to the exact optimum.

On small made-up houses: rooms in a row or a square, with doors at random places.

    python docs/figures/limits.py
"""

from __future__ import annotations

import sys
from itertools import product
from pathlib import Path

import numpy as np

from mapreplay.analysis.experiment.markdown import table
from mapreplay.analysis.limits.bound import lower_bound
from mapreplay.analysis.limits.task import task_of
from mapreplay.analysis.limits.tour import short_tour
from mapreplay.errors import FloorPlanError
from mapreplay.floorplan import FloorPlan
from mapreplay.grid import FREE, OCCUPIED
from mapreplay.sensor import Sensor

sys.path.append(str(Path(__file__).parents[2] / "tests" / "helpers"))
from exact_tour import shortest

HOUSES = 24
ROOMS = ((1, 3), (2, 2), (2, 3), (3, 3))
STATES = 20_000


def house(seed: int) -> FloorPlan:
    """A few rooms of 2 to 4 cells per side, each with a door to the one below and next to it."""
    random = np.random.default_rng(seed)
    rows, cols = ROOMS[seed % len(ROOMS)]
    heights, widths = random.integers(2, 5, rows), random.integers(2, 5, cols)
    tops, lefts = np.cumsum([1, *(heights + 1)]), np.cumsum([1, *(widths + 1)])
    cells = np.full((tops[-1], lefts[-1]), OCCUPIED, np.int8)
    for i, j in product(range(rows), range(cols)):
        top, left = tops[i], lefts[j]
        cells[top : top + heights[i], left : left + widths[j]] = FREE
        if i + 1 < rows and (j == 0 or random.random() < 0.3):
            cells[top + heights[i], left + random.integers(widths[j])] = FREE
        if j + 1 < cols:
            cells[top + random.integers(heights[i]), left + widths[j]] = FREE
    return FloorPlan(f"rooms-{seed}", cells, 0.2)


def line(reach: int, target: float) -> list[str]:
    """Of all houses: the bound and the tour as shares of the exact optimum."""
    bounds, tours, exacts = [], [], []
    for seed in range(HOUSES):
        task = task_of(house(seed), target=target, sensor=Sensor(reach=reach))
        try:
            exact = shortest(task, STATES)
        except FloorPlanError:
            continue
        exacts.append(exact)
        bounds.append(lower_bound(task))
        tours.append(short_tour(task).moves)
    exact_moves, bound, tour = (np.array(x, np.float64) for x in (exacts, bounds, tours))
    if not (bound <= exact_moves).all() or not (exact_moves <= tour).all():
        raise AssertionError("a bound is no bound")
    some = exact_moves > 0
    return [
        f"{reach} cells",
        f"{100 * target:.0f} %",
        f"{len(exacts)} of {HOUSES}",
        f"{exact_moves.mean():.1f}",
        f"{(bound[some] / exact_moves[some]).mean():.2f}",
        f"{(bound[some] / exact_moves[some]).min():.2f}",
        f"{(tour[some] / exact_moves[some]).mean():.3f}",
        f"{int((tour == exact_moves).sum())} of {len(exacts)}",
    ]


if __name__ == "__main__":
    head = ["sensor", "target", "houses solved", "exact, moves", "bound / exact", "worst",
            "tour / exact", "tour is exact"]  # fmt: skip
    print(table(head, [line(*case) for case in product((20, 3), (0.98, 1.0))]))
