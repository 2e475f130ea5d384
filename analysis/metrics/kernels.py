"""Compiled kernels of the analysis: counts of predictions, and whether a way out is left.

As in `mapreplay.kernels`: plain loops over arrays, compiled by numba and cached on disk, without
`fastmath`. What the numbers mean is said in the modules that call these.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mapreplay.compiled import njit


@njit
def chessboard_distance(grid: Any, distance: Any) -> None:
    """distance[r, c] = chessboard distance to the nearest cell of `grid` (int8[H, W]) that is
    not -1; the larger side of the map where there is none. int32[H, W], written.

    Two passes are exact for this distance: the shortest way to any cell is a chain of
    neighbours, half of it seen in each direction.
    """
    height, width = grid.shape
    far = max(height, width)
    for r in range(height):
        for c in range(width):
            d = far
            if grid[r, c] != -1:
                d = 0
            else:
                if c > 0:
                    d = min(d, distance[r, c - 1] + 1)
                if r > 0:
                    d = min(d, distance[r - 1, c] + 1)
                    if c > 0:
                        d = min(d, distance[r - 1, c - 1] + 1)
                    if c + 1 < width:
                        d = min(d, distance[r - 1, c + 1] + 1)
            distance[r, c] = d
    for r in range(height - 1, -1, -1):
        for c in range(width - 1, -1, -1):
            d = distance[r, c]
            if c + 1 < width:
                d = min(d, distance[r, c + 1] + 1)
            if r + 1 < height:
                d = min(d, distance[r + 1, c] + 1)
                if c > 0:
                    d = min(d, distance[r + 1, c - 1] + 1)
                if c + 1 < width:
                    d = min(d, distance[r + 1, c + 1] + 1)
            distance[r, c] = d


@njit
def count_levels(
    level: Any, truth: Any, observed: Any, region: Any, distance: Any, group_of: Any, counts: Any
) -> None:
    """Add the unobserved cells of `region` whose truth is known to `counts`.

    counts: int64[groups, 2, levels], by group_of[distance], truth (occupied is 1) and level.
    level: any integers, truth, observed: int8, region: bool, distance: int32, all [H, W];
    group_of: int64[at least the largest distance + 1].
    """
    height, width = observed.shape
    for r in range(height):
        for c in range(width):
            if region[r, c] and observed[r, c] == -1 and truth[r, c] != -1:
                wall = 1 if truth[r, c] > 0 else 0
                counts[group_of[distance[r, c]], wall, level[r, c]] += 1


@njit
def prediction_change(before: Any, now: Any, observed: Any, region: Any, top: float) -> Any:
    """How a prediction changed on the unobserved cells of `region`.

    before, now: of one type, [H, W]; observed: int8[H, W]; region: bool[H, W]; top: what stands
    for certainty. Returns (cells, sum of absolute changes of p, cells that went from one side of
    p = .5 to the other).
    """
    height, width = observed.shape
    cells = flips = 0
    total = 0.0
    for r in range(height):
        for c in range(width):
            if region[r, c] and observed[r, c] == -1:
                a = float(before[r, c])
                b = float(now[r, c])
                cells += 1
                total += abs(b - a)
                flips += (2 * a >= top) != (2 * b >= top)
    return cells, total / top, flips


@njit
def has_way_on(
    level: Any, observed: Any, row: int, col: int, free: Any, occupied: Any, seen: Any, stack: Any
) -> bool:
    """Whether the fused map has a frontier within reach of (row, col).

    A cell is what was observed; else free if its level is at most `free`, occupied if at least
    `occupied`, else unknown. There is a frontier if a free cell that can be reached
    (8-connected) touches an unknown one. level: numbers[H, W]; observed: int8[H, W]; seen:
    uint8[H, W], scratch; stack: int32[H * W], scratch.
    """
    height, width = observed.shape
    seen[:, :] = 0
    seen[row, col] = 1
    stack[0] = row * width + col
    top = 1
    while top > 0:
        top -= 1
        r, c = divmod(stack[top], width)
        for nr in range(max(r - 1, 0), min(r + 2, height)):
            for nc in range(max(c - 1, 0), min(c + 2, width)):
                if seen[nr, nc] != 0:
                    continue
                seen[nr, nc] = 1
                state = observed[nr, nc]
                if state == -1:
                    if level[nr, nc] <= free:
                        state = 0
                    elif level[nr, nc] < occupied:
                        return True
                if state == 0:
                    stack[top] = nr * width + nc
                    top += 1
    return False


@njit
def sealed_thresholds(
    level: Any, observed: Any, row: int, col: int, free: Any, occupied: Any, sealed: Any
) -> None:
    """sealed[i, j] = no frontier is within reach with the levels free[i] and occupied[j].

    See `has_way_on`. free: float64[m], not rising; occupied: float64[n], not falling: both get
    stricter. An agent that is sealed in with one pair is so with every laxer one: a stricter bound
    only makes cells unknown, and the first such cell on a way from the agent is a frontier. So
    the edge between the two is a staircase, and m + n searches find it. sealed: bool[m, n],
    written.
    """
    height, width = observed.shape
    seen = np.empty((height, width), np.uint8)
    stack = np.empty(height * width, np.int32)
    sealed[:, :] = False
    j = occupied.shape[0] - 1
    for i in range(free.shape[0]):
        while j >= 0 and has_way_on(level, observed, row, col, free[i], occupied[j], seen, stack):
            j -= 1
        sealed[i, : j + 1] = True
