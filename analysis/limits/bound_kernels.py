"""Compiled loops of the lower bound; what they compute is said in `bound`."""

from __future__ import annotations

from typing import Any

import numpy as np

from mapreplay.analysis.limits.kernels import distances
from mapreplay.compiled import njit


@njit
def view_distances(moves: Any, seers: Any, seer_start: Any, chosen: Any, out: Any) -> None:
    """out[i, c] = moves from place c to where the cell chosen[i] is seen from, at most 255.

    chosen: int32[n]; out: uint8[n, F], written.
    """
    places = moves.shape[0]
    queue = np.empty(places, np.int32)
    far = np.empty(places, np.int32)
    for i in range(chosen.shape[0]):
        x = chosen[i]
        distances(moves, seers[seer_start[x] : seer_start[x + 1]], 255, far, queue)
        for c in range(places):
            out[i, c] = far[c]


@njit
def add_up(distance: Any, block: Any, radii: Any, edges: Any, height: Any, use: Any) -> None:
    """Of each block of cells and each radius, the sum of their truncated distances.

    height[b, k, c] = sum over the cells i of block b of min(distance[i, c], radii[k]);
    use[e, b, k] = the sum of how much each of them differs between the two places of edges[e].
    distance: uint8[n, F]; block: int32[n]; radii: int64[R]; edges: int32[E, 2]; height:
    float64[B, R, F] and use: float32[E, B, R], all 0 before.
    """
    n, places = distance.shape
    for i in range(n):
        b = block[i]
        row = distance[i]
        for k in range(radii.shape[0]):
            r = radii[k]
            for c in range(places):
                height[b, k, c] += min(np.int64(row[c]), r)
        for e in range(edges.shape[0]):
            p, q = np.int64(row[edges[e, 0]]), np.int64(row[edges[e, 1]])
            if p != q:
                low = min(p, q)
                for k in range(radii.shape[0]):
                    if low < radii[k]:  # distances of neighbours differ by at most one
                        use[e, b, k] += 1.0


@njit
def guaranteed(distance: Any, block: Any, table: Any, start: int, spare: int, more: Any) -> float:
    """The least over all ends c of more[c] + the potentials there and at the start, the `spare`
    dearest cells left out.

    distance: uint8[n, F]; block: int32[n]; table: float64[B, 256], the potential of a cell of
    that block at that distance; more: float64[F].
    """  # fmt: skip
    n, places = distance.shape
    values = np.empty(n, np.float64)
    least = np.inf
    for c in range(places):
        total = 0.0
        for i in range(n):
            of = table[block[i]]
            values[i] = of[distance[i, start]] + of[distance[i, c]]
            total += values[i]
        if spare >= n:
            total = 0.0
        elif spare > 0:
            total -= np.partition(values, n - spare)[n - spare :].sum()
        least = min(least, more[c] + total)
    return least


@njit
def privacy(view_start: Any, view: Any, away: Any, out: Any) -> None:
    """out[x] = the largest of `away` (int32[F]) over the places from which cell x is seen.

    out: int32[N], written.
    """
    out[:] = -1
    for c in range(away.shape[0]):
        for j in range(view_start[c], view_start[c + 1]):
            if away[c] > out[view[j]]:
                out[view[j]] = away[c]
