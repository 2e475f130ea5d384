"""Compiled loops of the limits: views, distances, and the search for short tours.

As in `mapreplay.kernels`: plain loops over arrays, compiled by numba and cached on disk, without
`fastmath`. Cells that the agent can stand on are numbered 0..F-1 (places), cells that are to be
known 0..N-1; what the numbers mean is said in the modules that call these.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mapreplay.compiled import njit

FAR = np.iinfo(np.int32).max


@njit
def find_views(
    blocked: Any, places: Any, number: Any, offsets: Any, within: int, start: Any, seen: Any
) -> int:
    """What is known after looking from each place, as compressed rows.

    blocked: int8[H, W], not 0 where a ray stops; places: int32[F, 2]; number: int32[H, W], of the
    cells that are to be known, else -1; offsets: int64[rays, reach, 2]; within: chessboard
    distance from a seen cell at which a cell is known, too. start: int64[F + 1], written; seen:
    int32[n], written if n is large enough. Returns the length that `seen` needs.
    """
    height, width = blocked.shape
    mark = np.full((height, width), -1, np.int32)
    near = np.full((height, width), -1, np.int32)
    n = 0
    for i in range(places.shape[0]):
        start[i] = n
        row, col = places[i, 0], places[i, 1]
        for a in range(-1, offsets.shape[0]):
            for k in range(1 if a < 0 else offsets.shape[1]):
                r, c = row, col
                if a >= 0:
                    r += offsets[a, k, 0]
                    c += offsets[a, k, 1]
                if r < 0 or c < 0 or r >= height or c >= width:
                    break
                if mark[r, c] != i:
                    mark[r, c] = i
                    for nr in range(max(r - within, 0), min(r + within + 1, height)):
                        for nc in range(max(c - within, 0), min(c + within + 1, width)):
                            if near[nr, nc] != i:
                                near[nr, nc] = i
                                if number[nr, nc] >= 0:
                                    if n < seen.shape[0]:
                                        seen[n] = number[nr, nc]
                                    n += 1
                if blocked[r, c] != 0:
                    break
    start[places.shape[0]] = n
    return n


@njit
def distances(moves: Any, sources: Any, limit: int, out: Any, queue: Any) -> None:
    """out[c] = moves from the nearest of `sources` (int32[n]) to each place, at most `limit`.

    moves: int32[F, 8], the places that a move leads to, or -1; out: int32[F] or int16[F], written;
    queue: int32[F], scratch.
    """
    out[:] = limit
    tail = 0
    for source in sources:
        if out[source] != 0:
            out[source] = 0
            queue[tail] = source
            tail += 1
    head = 0
    while head < tail:
        cell = queue[head]
        head += 1
        after = out[cell] + 1
        if after >= limit:
            break
        for m in range(8):
            near = moves[cell, m]
            if near >= 0 and out[near] > after:
                out[near] = after
                queue[tail] = near
                tail += 1


@njit
def draw(state: Any, n: int) -> Any:
    """A number in 0..n-1 (splitmix64, Steele et al. 2014). state: uint64[1], advanced."""
    state[0] += np.uint64(0x9E3779B97F4A7C15)
    z = state[0]
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z ^= z >> np.uint64(31)
    return np.int64((z >> np.uint64(11)) % np.uint64(n))


@njit
def row_to(place: int, moves: Any, rows: Any, row_of: Any, queue: Any, used: Any) -> Any:
    """Which of `rows` holds the distances to `place`; computed if none did.

    rows: int16[capacity, F]; row_of: int32[F], -1 where there is none; used: int64[1], how many
    rows there are. When all are taken, all are forgotten.
    """
    if row_of[place] < 0:
        if used[0] == rows.shape[0]:
            row_of[:] = -1
            used[0] = 0
        sources = np.empty(1, np.int32)
        sources[0] = place
        distances(moves, sources, 32767, rows[used[0]], queue)
        row_of[place] = used[0]
        used[0] += 1
    return row_of[place]


@njit
def follow(
    stops: Any,
    count: int,
    needed: int,
    moves: Any,
    start: Any,
    seen: Any,
    rows: Any,
    row_of: Any,
    queue: Any,
    used: Any,
    known: Any,
    path: Any,
) -> Any:
    """Walk from stop to stop on shortest paths, looking at every place, until `needed` are known.

    Of several shortest paths, the one whose next place sees most. stops: int32[n], the first
    `count` are taken; known: bool[N], what is known before, changed to what is after; needed:
    how many more must be; path: int32[n], written with the places, the first the start.
    Returns (moves, newly known, the number of the stop that it was on the way to at its end).
    """  # fmt: skip
    place = stops[0]
    path[0] = place
    length = 0
    new = 0
    for j in range(start[place], start[place + 1]):
        if not known[seen[j]]:
            known[seen[j]] = True
            new += 1
    if new >= needed:
        return 0, new, 0
    for i in range(1, count):
        target = stops[i]
        to = rows[row_to(target, moves, rows, row_of, queue, used)]
        while place != target:
            best, most = -1, -1
            for m in range(8):
                near = moves[place, m]
                if near >= 0 and to[near] < to[place]:
                    size = start[near + 1] - start[near]
                    if size > most:
                        best, most = near, size
            if best < 0 or length + 1 == path.shape[0]:
                return length, new, i
            place = best
            length += 1
            path[length] = place
            for j in range(start[place], start[place + 1]):
                if not known[seen[j]]:
                    known[seen[j]] = True
                    new += 1
            if new >= needed:
                return length, new, i
    return length, new, count - 1


@njit
def add_stop(
    stops: Any,
    count: int,
    missing: int,
    moves: Any,
    seers: Any,
    seer_start: Any,
    rows: Any,
    row_of: Any,
    queue: Any,
    used: Any,
    known: Any,
    state: Any,
    noise: int,
    gain: Any,
    touched: Any,
) -> int:
    """Insert the stop that shows most of what is not known for its detour; returns the new count.

    The same count: there is none. seers, seer_start: the places from which each cell is seen, as
    compressed rows; noise: percent by which a rating is blurred; gain: int32[F], all 0 before and
    after; touched: int32[F], scratch.
    """  # fmt: skip
    n = 0
    for x in range(known.shape[0]):
        if not known[x]:
            for j in range(seer_start[x], seer_start[x + 1]):
                c = seers[j]
                if gain[c] == 0:
                    touched[n] = c
                    n += 1
                gain[c] += 1
    if n == 0 or count > rows.shape[0]:
        return count
    to_stop = np.empty(count, np.int64)
    for i in range(count):
        # Twice, because the memory of rows may have been cleared on the way.
        row_to(stops[i], moves, rows, row_of, queue, used)
    for i in range(count):
        to_stop[i] = row_to(stops[i], moves, rows, row_of, queue, used)
    between = np.zeros(count, np.int32)
    for i in range(count - 1):
        between[i] = rows[to_stop[i], stops[i + 1]]
    best_rating, best_place, best_after = -1.0, -1, 0
    detour = np.empty(n, np.int32)
    after = np.empty(n, np.int32)
    last = rows[to_stop[count - 1]]
    for t in range(n):
        detour[t] = last[touched[t]]
        after[t] = count - 1
    for i in range(count - 1):
        a, b, ab = rows[to_stop[i]], rows[to_stop[i + 1]], between[i]
        for t in range(n):
            c = touched[t]
            extra = a[c] + b[c] - ab
            if extra < detour[t]:
                detour[t] = extra
                after[t] = i
    for t in range(n):
        rating = min(gain[touched[t]], missing) / (detour[t] + 0.5)
        if noise > 0:
            rating *= 1.0 + 0.01 * (draw(state, 2 * noise + 1) - noise)
        if rating > best_rating:
            best_rating, best_place, best_after = rating, touched[t], after[t]
    for t in range(n):
        gain[touched[t]] = 0
    for i in range(count, best_after + 1, -1):
        stops[i] = stops[i - 1]
    stops[best_after + 1] = best_place
    return count + 1


@njit
def remove_some(stops: Any, count: int, rows: Any, row_of: Any, state: Any) -> int:
    """Take stops out: a stretch of the tour, some at random, or those near to one of them.

    The first, where the tour starts, stays. Returns the new count.
    """
    if count < 2:
        return count
    how = draw(state, 3)
    drop = np.zeros(count, np.bool_)
    if how == 0:
        first = 1 + draw(state, count - 1)
        for i in range(first, min(count, first + 1 + draw(state, 6))):
            drop[i] = True
    elif how == 1:
        for _ in range(1 + draw(state, 4)):
            drop[1 + draw(state, count - 1)] = True
    else:
        centre = stops[1 + draw(state, count - 1)]
        radius = 3 + draw(state, 12)
        if row_of[centre] >= 0:
            for i in range(1, count):
                drop[i] = rows[row_of[centre], stops[i]] <= radius
    left = 1
    for i in range(1, count):
        if not drop[i]:
            stops[left] = stops[i]
            left += 1
    return left


@njit
def turn_round(stops: Any, first: int, last: int) -> None:
    """Reverse the stretch from stop `first` to stop `last`."""
    while first < last:
        stops[first], stops[last] = stops[last], stops[first]
        first += 1
        last -= 1


@njit
def improve(
    stops: Any,
    count: int,
    length: int,
    before: Any,
    needed: int,
    moves: Any,
    start: Any,
    seen: Any,
    seers: Any,
    seer_start: Any,
    rounds: int,
    state: Any,
) -> Any:
    """Search for a shorter tour: take some stops out, put better ones in, again and again.

    before: bool[N], known before the tour begins; needed: how many more must be known at its end;
    length: that of the tour through the first `count` of `stops`, or FAR if it is not known or does
    not show enough. Returns (count, length) of the best, whose stops are in `stops`: int32[n],
    n >= F + 1. A tour that cannot show enough has length FAR.
    """  # fmt: skip
    places, cells = moves.shape[0], before.shape[0]
    rows = np.empty((min(places, max(64, 40_000_000 // places)), places), np.int16)
    row_of = np.full(places, -1, np.int32)
    queue = np.empty(places, np.int32)
    used = np.zeros(1, np.int64)
    gain = np.zeros(places, np.int32)
    touched = np.empty(places, np.int32)
    known = np.empty(cells, np.bool_)
    path = np.empty(64 * places + 64, np.int32)
    now = np.empty(places + 1, np.int32)
    trial = np.empty(places + 1, np.int32)
    now[:count] = stops[:count]
    n_now, l_now = count, length
    best, l_best = count, length
    for _ in range(rounds):
        trial[:n_now] = now[:n_now]
        n = n_now
        if l_now < FAR:
            n = remove_some(trial, n, rows, row_of, state)
        # Put stops in until enough is known.
        enough = False
        moved = 0
        while n <= places:
            known[:] = before
            moved, new, on = follow(
                trial, n, needed, moves, start, seen, rows, row_of, queue, used, known, path
            )
            if new >= needed:
                enough = True
                n = on + 1
                trial[on] = path[moved]
                break
            if l_now < FAR and moved > l_now + 2 + l_now // 50:
                break
            longer = add_stop(
                trial, n, needed - new, moves, seers, seer_start, rows, row_of, queue, used,
                known, state, 25, gain, touched,
            )  # fmt: skip
            if longer == n:
                break
            n = longer
        if not enough:
            continue
        # Leave out what is seen on the way anyhow, and straighten.
        i = n - 1
        while i >= 1:
            if i < n:
                here = trial[i]
                for j in range(i, n - 1):
                    trial[j] = trial[j + 1]
                known[:] = before
                shorter, new, on = follow(
                    trial, n - 1, needed, moves, start, seen, rows, row_of, queue, used, known,
                    path,
                )  # fmt: skip
                if new >= needed and shorter <= moved:
                    moved = shorter
                    n = on + 1
                    trial[on] = path[moved]
                else:
                    for j in range(n - 1, i, -1):
                        trial[j] = trial[j - 1]
                    trial[i] = here
            i -= 1
        for _shift in range(min(n - 1, 8)):
            i = 1 + draw(state, n - 1)
            here = trial[i]
            near = moves[here, draw(state, 8)]
            if near < 0:
                continue
            trial[i] = near
            known[:] = before
            shorter, new, on = follow(
                trial, n, needed, moves, start, seen, rows, row_of, queue, used, known, path
            )
            if new >= needed and shorter <= moved:
                moved = shorter
                n = on + 1
                trial[on] = path[moved]
                if n < 2:
                    break
            else:
                trial[i] = here
        for _turn in range(min(n - 2, 8)):
            i = 1 + draw(state, n - 1)
            j = 1 + draw(state, n - 1)
            if i > j:
                i, j = j, i
            if i == j:
                continue
            turn_round(trial, i, j)
            known[:] = before
            shorter, new, on = follow(
                trial, n, needed, moves, start, seen, rows, row_of, queue, used, known, path
            )
            if new >= needed and shorter <= moved:
                moved = shorter
                n = on + 1
                trial[on] = path[moved]
                if n < 3:
                    break
            else:
                turn_round(trial, i, j)
        if l_now == FAR or moved <= l_best + draw(state, 2 + l_best // 50):
            now[:n] = trial[:n]
            n_now, l_now = n, moved
            if moved < l_best:
                stops[:n] = trial[:n]
                best, l_best = n, moved
    return best, l_best


@njit
def trace(
    stops: Any, count: int, before: Any, needed: int, moves: Any, start: Any, seen: Any
) -> Any:
    """int32[moves + 1]: the places of the tour, see `follow`."""
    places = moves.shape[0]
    rows = np.empty((min(count + 1, places), places), np.int16)
    row_of = np.full(places, -1, np.int32)
    queue = np.empty(places, np.int32)
    used = np.zeros(1, np.int64)
    path = np.empty(64 * places + 64, np.int32)
    length, _, _ = follow(
        stops, count, needed, moves, start, seen, rows, row_of, queue, used, before.copy(), path
    )
    return path[: length + 1].copy()
