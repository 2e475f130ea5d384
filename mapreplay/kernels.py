"""Compiled kernels: rays, shortest paths, frontiers, gains and tallies.

Everything here is a plain loop over arrays, compiled by numba and cached on disk, without
`fastmath`, so that the result is the same on every machine. What the numbers mean is said
in the modules that call these (`sensor`, `mapping`, `planning`, `scores`).
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from mapreplay.compiled import njit

SQRT2: Final = float(np.sqrt(2.0))

# The eight moves, straight ones first (E, N, W, S, NE, NW, SW, SE); the order of the last move,
# not of the neighbour that it comes from, decides which of two equally short paths is taken, and
# is part of the log's contract (`verify` makes every decision again).
MOVES: Final = np.array(
    [(0, 1), (1, 0), (0, -1), (-1, 0), (1, 1), (1, -1), (-1, -1), (-1, 1)], np.int64
)

UNREACHED: Final = -1


@njit
def cast_rays(blocked: Any, row: int, col: int, offsets: Any, hits: Any) -> None:
    """hits[i] = the k of the first blocked cell on ray i, or 0 if there is none in the grid.

    blocked: int8[H, W], not 0 where a ray stops; offsets: int64[rays, reach, 2];
    hits: int16[rays], written.
    """
    height, width = blocked.shape
    for i in range(offsets.shape[0]):
        hits[i] = 0
        for k in range(offsets.shape[1]):
            r = row + offsets[i, k, 0]
            c = col + offsets[i, k, 1]
            if r < 0 or c < 0 or r >= height or c >= width:
                break
            if blocked[r, c] != 0:
                hits[i] = k + 1
                break


@njit
def mark_rays(observed: Any, row: int, col: int, offsets: Any, hits: Any) -> None:
    """Write what the rays saw into `observed` (int8[H, W]): free up to the hit, then occupied."""
    height, width = observed.shape
    observed[row, col] = 0
    for i in range(offsets.shape[0]):
        hit = hits[i]
        reach = hit if hit > 0 else offsets.shape[1]
        for k in range(reach):
            r = row + offsets[i, k, 0]
            c = col + offsets[i, k, 1]
            if r < 0 or c < 0 or r >= height or c >= width:
                break
            observed[r, c] = 100 if k + 1 == hit else 0


@njit
def shortest_paths(grid: Any, row: int, col: int, straight: Any, diagonal: Any) -> None:
    """Dijkstra from (row, col) over the cells of `grid` (int8[H, W]) that are 0; 8-connected.

    A path cost is the pair (straight, diagonal) of integers, ordered by straight +
    diagonal * sqrt 2. With only two edge weights, two first-in-first-out queues replace the
    heap: what is pushed after a straight move is never less than what was pushed before it,
    nor after a diagonal one, so that the least is at the head of one of them.

    straight, diagonal: int32[H, W], written; UNREACHED (-1) where there is no path.
    """
    height, width = grid.shape
    pitch = width + 2  # a border of blocked cells saves all checks against the edge
    size = (height + 2) * pitch
    # The least cost found so far; -1 where blocked, because no cost is less than that.
    best = np.full(size, -1.0)
    s_of = np.full(size, UNREACHED, np.int32)
    d_of = np.full(size, UNREACHED, np.int32)
    free = 0
    for r in range(height):
        base = (r + 1) * pitch + 1
        for c in range(width):
            if grid[r, c] == 0:
                best[base + c] = np.inf
                free += 1
    # Each cell enters each queue at most once for each of four neighbours.
    cells = np.empty((2, 4 * free + 1), np.int32)
    costs = np.empty((2, 4 * free + 1), np.float64)
    head0 = tail0 = head1 = tail1 = 0
    start = (row + 1) * pitch + col + 1
    best[start] = 0.0
    s_of[start] = 0
    d_of[start] = 0
    cells[0, 0] = start
    costs[0, 0] = 0.0
    tail0 = 1
    while head0 < tail0 or head1 < tail1:
        if head1 == tail1 or (head0 < tail0 and costs[0, head0] <= costs[1, head1]):
            cell, cost = cells[0, head0], costs[0, head0]
            head0 += 1
        else:
            cell, cost = cells[1, head1], costs[1, head1]
            head1 += 1
        if cost != best[cell]:
            continue  # a shorter path was found after this was queued
        s, d = s_of[cell], d_of[cell]
        # From the integers and never from `cost`, so that equal pairs give equal costs.
        after_straight = (s + 1) + d * SQRT2
        after_diagonal = s + (d + 1) * SQRT2
        for step in (1, pitch, -1, -pitch):
            near = cell + step
            if after_straight < best[near]:
                best[near] = after_straight
                s_of[near] = s + 1
                d_of[near] = d
                cells[0, tail0] = near
                costs[0, tail0] = after_straight
                tail0 += 1
        for step in (pitch + 1, pitch - 1, -pitch - 1, -pitch + 1):
            near = cell + step
            if after_diagonal < best[near]:
                best[near] = after_diagonal
                s_of[near] = s
                d_of[near] = d + 1
                cells[1, tail1] = near
                costs[1, tail1] = after_diagonal
                tail1 += 1
    for r in range(height):
        base = (r + 1) * pitch + 1
        for c in range(width):
            straight[r, c] = s_of[base + c]
            diagonal[r, c] = d_of[base + c]


@njit
def costs_at(straight: Any, diagonal: Any, cells: Any) -> Any:
    """float64[n]: straight + diagonal * sqrt 2 at each of `cells` (int32[n, 2])."""
    costs = np.empty(cells.shape[0], np.float64)
    for i in range(cells.shape[0]):
        r, c = cells[i, 0], cells[i, 1]
        costs[i] = straight[r, c] + diagonal[r, c] * SQRT2
    return costs


@njit
def walk_back(straight: Any, diagonal: Any, row: int, col: int, moves: Any) -> Any:
    """The path that `shortest_paths` found to (row, col): int32[n, 2] from source to target.

    Going back, the first of `moves` that leads to a cell of exactly the remaining cost is
    taken: a rule that does not depend on how the search was made.
    """
    height, width = straight.shape
    s, d = straight[row, col], diagonal[row, col]
    path = np.empty((s + d + 1, 2), np.int32)
    r, c = row, col
    for i in range(s + d, -1, -1):
        path[i, 0] = r
        path[i, 1] = c
        for m in range(8):
            pr = r - moves[m, 0]
            pc = c - moves[m, 1]
            if pr < 0 or pc < 0 or pr >= height or pc >= width or straight[pr, pc] < 0:
                continue
            ps = s - 1 if m < 4 else s
            pd = d if m < 4 else d - 1
            if straight[pr, pc] == ps and diagonal[pr, pc] == pd:
                r, c, s, d = pr, pc, ps, pd
                break
    return path


@njit
def touching_unknown(straight: Any, built: Any, neighbours: int, moves: Any) -> Any:
    """int32[n, 2], row-major: cells with straight >= 0 that touch a -1 cell of `built`.

    neighbours: 4 or 8.
    """
    height, width = built.shape
    cells = np.empty((height * width, 2), np.int32)
    n = 0
    for r in range(height):
        for c in range(width):
            if straight[r, c] < 0:
                continue
            for m in range(neighbours):
                nr = r + moves[m, 0]
                nc = c + moves[m, 1]
                if nr < 0 or nc < 0 or nr >= height or nc >= width:
                    continue
                if built[nr, nc] == -1:
                    cells[n, 0] = r
                    cells[n, 1] = c
                    n += 1
                    break
    return cells[:n].copy()


@njit
def view_gains(
    grid: Any, uncertainty: Any, cells: Any, offsets: Any, seen: Any, gains: Any
) -> None:
    """gains[i] = the sum of `uncertainty` over what the sensor would mark from cells[i].

    grid: int8[H, W]; a ray ends with its first 100, and -1 is transparent. uncertainty:
    float64[H, W]. cells: int32[n, 2]. Each cell counts once, in the order of the rays.
    seen: int64[H, W], scratch, all below 1 on the first call and never reset between cells.
    """
    height, width = grid.shape
    for i in range(cells.shape[0]):
        row, col = cells[i, 0], cells[i, 1]
        mark = i + 1
        seen[row, col] = mark
        total = uncertainty[row, col]
        for a in range(offsets.shape[0]):
            for k in range(offsets.shape[1]):
                r = row + offsets[a, k, 0]
                c = col + offsets[a, k, 1]
                if r < 0 or c < 0 or r >= height or c >= width:
                    break
                if seen[r, c] != mark:
                    seen[r, c] = mark
                    total += uncertainty[r, c]
                if grid[r, c] == 100:
                    break
        gains[i] = total


@njit
def tally(grid: Any, truth: Any, region: Any, counts: Any) -> None:
    """counts[g, t] = cells of `region` (bool[H, W]) where the map says g and the truth t.

    grid, truth: int8[H, W]; counts: int64[3, 3], written; index 0 unknown, 1 free, 2 occupied.
    """
    counts[:, :] = 0
    for r in range(grid.shape[0]):
        for c in range(grid.shape[1]):
            if region[r, c]:
                g = grid[r, c]
                t = truth[r, c]
                counts[0 if g < 0 else 1 if g == 0 else 2, 0 if t < 0 else 1 if t == 0 else 2] += 1


@njit
def gather_levels(level: Any, truth: Any, region: Any, codes: Any) -> int:
    """codes[i] = 2 * level, plus 1 where the truth is occupied, of the i-th cell of `region`.

    level: unsigned integers, truth: int8, region: bool, all [H, W]; codes: int32[H * W], written
    in row-major order. Returns how many.
    """
    n = 0
    for r in range(level.shape[0]):
        for c in range(level.shape[1]):
            if region[r, c]:
                codes[n] = 2 * np.int32(level[r, c]) + (truth[r, c] > 0)
                n += 1
    return n


@njit
def flood(grid: Any, row: int, col: int, reached: Any, stack: Any, moves: Any) -> int:
    """Mark in `reached` (bool[H, W], False before) the 0 cells connected to (row, col).

    8-connected; stack: int32[H * W], scratch. Returns how many.
    """
    height, width = grid.shape
    if grid[row, col] != 0 or reached[row, col]:
        return 0
    stack[0] = row * width + col
    reached[row, col] = True
    top = 1
    count = 0
    while top > 0:
        top -= 1
        cell = stack[top]
        count += 1
        r = cell // width
        c = cell - r * width
        for m in range(8):
            nr = r + moves[m, 0]
            nc = c + moves[m, 1]
            if nr < 0 or nc < 0 or nr >= height or nc >= width:
                continue
            if grid[nr, nc] == 0 and not reached[nr, nc]:
                reached[nr, nc] = True
                stack[top] = nr * width + nc
                top += 1
    return count


@njit
def wander(truth: Any, row: int, col: int, offsets: Any, raws: Any, observed: Any) -> None:
    """A random tree of walks, observing at every cell passed; writes int8[H, W] `observed`.

    Each branch takes three of `raws` (uint64[3 * branches]): from which visited cell, along
    which ray, how far. See `training.observations`.
    """
    rays, reach, _ = offsets.shape
    branches = raws.shape[0] // 3
    height, width = truth.shape
    visited = np.empty((1 + branches * reach, 2), np.int64)
    looked = np.zeros((height, width), np.bool_)  # a second look from a cell shows nothing new
    visited[0, 0] = row
    visited[0, 1] = col
    n = 1
    hits = np.empty(rays, np.int16)
    cast_rays(truth, row, col, offsets, hits)
    mark_rays(observed, row, col, offsets, hits)
    looked[row, col] = True
    for b in range(branches):
        go_on = raws[3 * b] % np.uint64(4) != np.uint64(0)
        node = n - 1 if go_on else np.int64(raws[3 * b] // np.uint64(4) % np.uint64(n))
        a = np.int64(raws[3 * b + 1] % np.uint64(rays))
        r0, c0 = visited[node, 0], visited[node, 1]
        free = 0
        for k in range(reach):
            r = r0 + offsets[a, k, 0]
            c = c0 + offsets[a, k, 1]
            if r < 0 or c < 0 or r >= height or c >= width or truth[r, c] != 0:
                break
            free = k + 1
        if free == 0:
            continue
        length = 1 + np.int64(raws[3 * b + 2] % np.uint64(free))
        for k in range(length):
            r = r0 + offsets[a, k, 0]
            c = c0 + offsets[a, k, 1]
            if not looked[r, c]:
                cast_rays(truth, r, c, offsets, hits)
                mark_rays(observed, r, c, offsets, hits)
                looked[r, c] = True
            visited[n, 0] = r
            visited[n, 1] = c
            n += 1
