"""Compiled loops of the diagnosis; what they compute is said in the modules that call them."""

from __future__ import annotations

from typing import Any

import numpy as np

from mapreplay.compiled import njit


@njit
def touches_unknown(grid: Any, r: int, c: int) -> bool:
    """Whether one of the eight neighbours of (r, c) is -1."""
    height, width = grid.shape
    for dr in (-1, 0, 1):
        for dc in (-1, 0, 1):
            nr, nc = r + dr, c + dc
            if 0 <= nr < height and 0 <= nc < width and grid[nr, nc] == -1:
                return True
    return False


@njit
def nearest_edge(
    grid: Any, row: int, col: int, seen: Any, mark: int, before: Any, queue: Any
) -> int:
    """The nearest cell that touches a -1 and can be reached from (row, col) over 0 cells.

    seen: int32[H, W], nowhere `mark` before; before: int32[H * W], written: the cell from which
    each seen one was reached, -1 at the start. queue: int32[H * W], scratch. Cells are numbered
    row * W + col; -1 if there is none.
    """
    height, width = grid.shape
    queue[0] = row * width + col
    before[queue[0]] = -1
    seen[row, col] = mark
    head, tail = 0, 1
    while head < tail:
        cell = queue[head]
        r, c = cell // width, cell % width
        head += 1
        if touches_unknown(grid, r, c):
            return int(cell)
        for dr in (-1, 0, 1):
            for dc in (-1, 0, 1):
                nr, nc = r + dr, c + dc
                if nr < 0 or nc < 0 or nr >= height or nc >= width:
                    continue
                if grid[nr, nc] == 0 and seen[nr, nc] != mark:
                    seen[nr, nc] = mark
                    before[nr * width + nc] = cell
                    queue[tail] = nr * width + nc
                    tail += 1
    return -1


@njit
def zero_one(cost: Any, starts: Any, dist: Any) -> None:
    """Least sum of `cost` over the cells of a path from one of `starts`, both ends included.

    cost: int8[H, W], 0 or 1, or 2 where there is no passing; 8-connected. starts: int32[n, 2];
    dist: int32[H, W], written, -1 where there is no path.
    """
    height, width = cost.shape
    size = height * width
    # A deque: what costs nothing goes to the front, what costs one to the back.
    deque = np.empty(2 * size + 2 * starts.shape[0] + 2, np.int32)
    head = tail = size + starts.shape[0] + 1
    dist[:, :] = -1
    for pass_cost in (0, 1):
        for i in range(starts.shape[0]):
            r, c = starts[i, 0], starts[i, 1]
            if cost[r, c] == pass_cost and dist[r, c] < 0:
                dist[r, c] = pass_cost
                deque[tail] = r * width + c
                tail += 1
    done = np.zeros((height, width), np.bool_)
    while head < tail:
        cell = deque[head]
        head += 1
        r, c = cell // width, cell % width
        if done[r, c]:
            continue
        done[r, c] = True
        for dr in (-1, 0, 1):
            for dc in (-1, 0, 1):
                nr, nc = r + dr, c + dc
                if nr < 0 or nc < 0 or nr >= height or nc >= width or cost[nr, nc] > 1:
                    continue
                through = dist[r, c] + cost[nr, nc]
                if dist[nr, nc] < 0 or through < dist[nr, nc]:
                    dist[nr, nc] = through
                    if cost[nr, nc] == 0:
                        head -= 1
                        deque[head] = nr * width + nc
                    else:
                        deque[tail] = nr * width + nc
                        tail += 1


@njit
def fewest_moves(allowed: Any, cost: Any, dist: Any, row: int, col: int, goals: Any) -> Any:
    """int32[n, 2]: of the paths of least cost to a goal, one with the fewest moves.

    allowed: bool[H, W], the cells of such paths; dist: of `zero_one` from (row, col). Moves
    are tried by row, then column, so that the path is always the same; empty if there is none.
    """
    height, width = cost.shape
    before = np.full((height, width), -2, np.int32)
    queue = np.empty(height * width, np.int32)
    queue[0] = row * width + col
    before[row, col] = -1
    head, tail, last = 0, 1, -1
    while head < tail:
        cell = queue[head]
        head += 1
        r, c = cell // width, cell % width
        if goals[r, c]:
            last = cell
            break
        for dr in (-1, 0, 1):
            for dc in (-1, 0, 1):
                nr, nc = r + dr, c + dc
                if nr < 0 or nc < 0 or nr >= height or nc >= width or not allowed[nr, nc]:
                    continue
                if before[nr, nc] == -2 and dist[nr, nc] == dist[r, c] + cost[nr, nc]:
                    before[nr, nc] = cell
                    queue[tail] = nr * width + nc
                    tail += 1
    length, cell = 0, last
    while cell >= 0:
        length += 1
        cell = before[cell // width, cell % width]
    path = np.empty((length, 2), np.int32)
    cell = last
    for i in range(length - 1, -1, -1):
        path[i, 0], path[i, 1] = cell // width, cell % width
        cell = before[cell // width, cell % width]
    return path


@njit
def has_two_ways(grid: Any, row: int, col: int) -> bool:
    """Whether two paths over 0 cells, with no cell but (row, col) in common, lead from it to
    cells that touch a -1; also if it touches one itself. There is one path at least.

    Menger: one path is found, and then another in what its flow leaves of the graph in which
    each cell is an entrance and an exit with room for one.
    """
    height, width = grid.shape
    if touches_unknown(grid, row, col):
        return True
    size = height * width
    source = row * width + col
    before = np.empty(size, np.int32)
    queue = np.empty(2 * size, np.int32)
    seen = np.zeros((height, width), np.int32)
    end = nearest_edge(grid, row, col, seen, 1, before, queue)
    if end < 0:
        return False
    onward = np.full(size, -1, np.int32)  # the next cell of the first path
    cell = end
    while cell != source:
        onward[before[cell]] = cell
        cell = before[cell]
    on_path = np.zeros(size, np.bool_)
    cell = end
    while cell >= 0:
        on_path[cell] = True
        cell = before[cell]
    entered = np.zeros(size, np.bool_)
    left = np.zeros(size, np.bool_)
    queue[0] = source
    left[source] = True
    head, tail = 0, 1
    while head < tail:  # the queue holds exits
        cell = queue[head]
        head += 1
        r, c = cell // width, cell % width
        for dr in (-1, 0, 1):
            for dc in (-1, 0, 1):
                nr, nc = r + dr, c + dc
                if nr < 0 or nc < 0 or nr >= height or nc >= width or grid[nr, nc] != 0:
                    continue
                near = nr * width + nc
                if near == source or entered[near] or onward[cell] == near:
                    continue
                entered[near] = True
                # Also its own entrance, from the exit of a cell of the first path.
                if not on_path[near]:
                    if touches_unknown(grid, nr, nc):
                        return True
                    if not left[near]:
                        left[near] = True
                        queue[tail] = near
                        tail += 1
                elif before[near] != source and not left[before[near]]:
                    left[before[near]] = True
                    queue[tail] = before[near]
                    tail += 1
    return False


@njit
def first_viewpoint(truth: Any, cells: Any, offsets: Any, wanted: Any) -> int:
    """The number of the first of `cells` (int32[n, 2]) from which the sensor marks a cell of
    `wanted` (bool[H, W]); -1 if there is none. What is not 0 in `truth` stops a ray.
    """
    height, width = truth.shape
    for i in range(cells.shape[0]):
        row, col = cells[i, 0], cells[i, 1]
        if wanted[row, col]:
            return i
        for a in range(offsets.shape[0]):
            for k in range(offsets.shape[1]):
                r = row + offsets[a, k, 0]
                c = col + offsets[a, k, 1]
                if r < 0 or c < 0 or r >= height or c >= width:
                    break
                if wanted[r, c]:
                    return i
                if truth[r, c] != 0:
                    break
    return -1
