"""Compiled kernels of the planners that look through their own prediction.

Plain loops, compiled by numba and cached on disk, without `fastmath`, like `mapreplay.kernels`.
What the numbers mean is said where they are used (`informative_path`).
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from mapreplay.compiled import njit
from mapreplay.kernels import MOVES, walk_back

FAINT: Final = 0.02
"""A ray that gets through with less than this probability is not followed on."""


@njit
def explorable_chance(build_map: Any, observed: Any, p_wall: Any, chance: Any) -> None:
    """chance[r, c] = P(an unknown cell of `build_map` is explorable), 0 for known cells.

    That is the greatest probability of being free among the cell and its eight neighbours.
    build_map, observed: int8[H, W]; p_wall: float64[H, W], used where nothing was observed;
    chance: float64[H, W], written.
    """
    height, width = build_map.shape
    for r in range(height):
        for c in range(width):
            chance[r, c] = 0.0
            if build_map[r, c] != -1:
                continue
            most = 0.0
            for nr in range(max(r - 1, 0), min(r + 2, height)):
                for nc in range(max(c - 1, 0), min(c + 2, width)):
                    seen = observed[nr, nc]
                    free = 1.0 - p_wall[nr, nc] if seen == -1 else 1.0 if seen == 0 else 0.0
                    most = max(most, free)
            chance[r, c] = most


@njit
def look(
    transparency: Any, worth: Any, row: int, col: int, offsets: Any, mark: int, seen: Any,
    visibility: Any, cells: Any,
) -> Any:  # fmt: skip
    """The sum of `worth` times the probability of being seen over all cells, from (row, col).

    A ray gets through a cell with the probability `transparency` of it (float64[H, W]). Where
    several rays meet a cell, the most probable one counts. worth: float64[H, W]; offsets:
    int64[rays, reach, 2]; seen: int64[H, W], scratch in which nothing is `mark` yet.
    visibility: float64[H, W] and cells: int32[rays * reach + 1, 2], written: the cells that
    may be seen, and how probably. Returns the sum and the number of these cells.
    """
    height, width = transparency.shape
    seen[row, col] = mark
    visibility[row, col] = 1.0
    cells[0, 0] = row
    cells[0, 1] = col
    n = 1
    total = worth[row, col]
    for a in range(offsets.shape[0]):
        through = 1.0
        for k in range(offsets.shape[1]):
            r = row + offsets[a, k, 0]
            c = col + offsets[a, k, 1]
            if r < 0 or c < 0 or r >= height or c >= width:
                break
            if seen[r, c] != mark:
                seen[r, c] = mark
                visibility[r, c] = through
                cells[n, 0] = r
                cells[n, 1] = c
                n += 1
                total += through * worth[r, c]
            elif through > visibility[r, c]:
                total += (through - visibility[r, c]) * worth[r, c]
                visibility[r, c] = through
            through *= transparency[r, c]
            if through < FAINT:
                break
    return total, n


@njit
def view_gains(transparency: Any, worth: Any, targets: Any, offsets: Any, gains: Any) -> None:
    """gains[i] (float64[n], written) = what `look` expects from targets[i] (int32[n, 2])."""
    seen = np.zeros(worth.shape, np.int64)
    visibility = np.empty(worth.shape, np.float64)
    cells = np.empty((offsets.shape[0] * offsets.shape[1] + 1, 2), np.int32)
    for i in range(targets.shape[0]):
        gains[i], _ = look(
            transparency, worth, targets[i, 0], targets[i, 1], offsets, i + 1, seen, visibility,
            cells,
        )  # fmt: skip


@njit
def path_gain(
    transparency: Any, left: Any, path: Any, offsets: Any, seen: Any, visibility: Any, cells: Any,
    mark: int,
) -> float:  # fmt: skip
    """What is expected to be seen from the cells of `path` (int32[n, 2]) after the first.

    A cell that was seen from one of them with some probability counts for the next ones only
    as far as it may not have been. `left` (float64[H, W]) is the worth of each cell, and is used
    up; the others are as in `look`, and nothing in `seen` is `mark` to `mark` + n yet.
    """
    total = 0.0
    for i in range(1, path.shape[0]):
        gain, n = look(
            transparency, left, path[i, 0], path[i, 1], offsets, mark + i, seen, visibility, cells
        )
        total += gain
        for j in range(n):
            left[cells[j, 0], cells[j, 1]] *= 1.0 - visibility[cells[j, 0], cells[j, 1]]
    return total


@njit
def way_gains(
    transparency: Any, worth: Any, straight: Any, diagonal: Any, targets: Any, offsets: Any,
    gains: Any,
) -> None:  # fmt: skip
    """gains[i] (float64[n], written) = what the shortest path to targets[i] is expected to show.

    straight, diagonal: int32[H, W], of `mapreplay.kernels.shortest_paths`; the rest as in `look`.
    """
    seen = np.zeros(worth.shape, np.int64)
    visibility = np.empty(worth.shape, np.float64)
    cells = np.empty((offsets.shape[0] * offsets.shape[1] + 1, 2), np.int32)
    mark = 1
    for i in range(targets.shape[0]):
        path = walk_back(straight, diagonal, targets[i, 0], targets[i, 1], MOVES)
        gains[i] = path_gain(
            transparency, worth.copy(), path, offsets, seen, visibility, cells, mark
        )
        mark += path.shape[0]
