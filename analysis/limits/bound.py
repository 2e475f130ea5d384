"""A proved lower bound on the mapping time: no planner can know enough after fewer moves.

Give each cell x that is to be known a potential: a function of the places, at least 0, that is 0
wherever x is seen from. Let the potentials change by at most 1 in all with every move. A walk
from s to e that sees x brings the potential of x from its value at s down to 0 and up to its
value at e, so that

    moves >= sum over the cells seen of (potential of x at s + potential of x at e).

Which cells are left out, and where the walk ends, is the planner's choice: the bound is the least
over all ends, with as many of the dearest cells left out as may be.

A set of more cells than may be left out cannot be missed as a whole. So it may have a potential,
too, that is 0 wherever one of its cells is seen from, and of which nothing is left out.

Every such choice of potentials proves a bound; a linear program finds a good one. Potentials are
multiples of distances to where something is seen from, cut off at several radii: in the language
of the travelling salesman, moats around it (Jünger and Pulleyblank 1993).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np
import numpy.typing as npt
from scipy.optimize import linprog

from mapreplay.analysis.limits import bound_kernels, kernels
from mapreplay.analysis.limits.task import CoverageTask, Ints

Floats: TypeAlias = npt.NDArray[np.float64]
Bytes: TypeAlias = npt.NDArray[np.uint8]

FAR: Final = 255
"""Distances above it are taken for it: that only lowers a bound."""
CELL_RADII: Final = np.array([1, 2, 4, 8, 16, FAR], np.int64)
SET_RADII: Final = np.array([1, 2, 3, 4, 6, 8, 11, 16, 22, 32, 45, FAR], np.int64)
BLOCKS: Final = 6
"""Of cells that share a multiple, along each side of the floor plan."""
SETS: Final = 80
"""That cannot be missed."""
MAX_ROUNDS: Final = 12
"""Of the linear program, each with the moves at which the one before went wrong."""
SAMPLED: Final = 4_000
"""Moves, of which the first round takes those that matter most."""
CLOSE_ENOUGH: Final = 1.01
"""Of the change of all potentials with a move."""
MOST: Final = 1 << 28
"""Distances that are kept; beyond, only some of the cells have a potential."""


def lower_bound(task: CoverageTask) -> int:
    """Moves that every walk takes that knows enough at its end."""
    if task.needed <= len(task.seen_from(task.start)):
        return 0
    return max(1, reach_bound(task), math.ceil(potential_bound(task) - 1e-6))


def reach_bound(task: CoverageTask) -> int:
    """Moves within which enough cells can be seen, each by a walk of its own."""
    first = _first_seen(task)
    return int(np.partition(first, task.needed - 1)[task.needed - 1])


def potential_bound(task: CoverageTask) -> float:
    """The bound by potentials, see above."""
    potentials = _Potentials.of(task)
    solution = _solve(potentials, task.spare)
    return potentials.prove(solution, task.spare)


def _away(task: CoverageTask, place: int) -> Ints:
    """int32[F]: moves from `place`."""
    away = np.empty(len(task.places), np.int32)
    kernels.distances(
        task.moves, np.array([place], np.int32), kernels.FAR, away, np.empty_like(away)
    )
    return away


def _first_seen(task: CoverageTask) -> Ints:
    """int32[N]: moves from the start to where each cell is seen from."""
    start, seers = task.seers
    return np.minimum.reduceat(_away(task, task.start)[seers], start[:-1])


@dataclass(frozen=True, eq=False)
class _Potentials:
    """What multiples are chosen for: each block of cells and each set, at each radius.

    Columns are the radii of the first block, of the second, ..., and then those of the sets.
    """

    start: int
    edges: Ints
    """int32[E, 2]: every move, in one of its directions."""
    of_cell: Bytes
    """uint8[n, F]: distance to where each cell is seen from."""
    block: Ints
    """int32[n]: the block of each of these cells."""
    of_set: Bytes
    """uint8[S, F]: distance to where one of a set is seen from."""
    height: Floats
    """float64[B, R, F], see `bound_kernels.add_up`."""
    use: npt.NDArray[np.float32]
    """float32[E, B, R]."""

    @classmethod
    def of(cls, task: CoverageTask) -> _Potentials:
        places = len(task.places)
        seer_start, seers = task.seers
        step = math.ceil(len(task.cells) * places / MOST)
        chosen = np.arange(0, len(task.cells), step, dtype=np.int32)
        of_cell = np.empty((len(chosen), places), np.uint8)
        bound_kernels.view_distances(task.moves, seers, seer_start, chosen, of_cell)
        p, m = np.nonzero(task.moves >= 0)
        edges = np.stack([p, task.moves[p, m]], axis=1).astype(np.int32)
        edges = edges[edges[:, 0] < edges[:, 1]]
        block = _blocks(task.cells[chosen])
        shape = int(block.max()) + 1, len(CELL_RADII)
        height = np.zeros((*shape, places))
        use = np.zeros((len(edges), *shape), np.float32)
        bound_kernels.add_up(of_cell, block, CELL_RADII, edges, height, use)
        return cls(task.start, edges, of_cell, block, _sets(task), height, use)

    @property
    def columns(self) -> tuple[int, int]:
        """How many multiples there are: of cells, and of sets."""
        return self.height.shape[0] * len(CELL_RADII), len(self.of_set) * len(SET_RADII)

    def at_edges(self, edges: Ints) -> Floats:
        """float64[n, columns]: how much each changes with some of the moves."""
        ends = _cut(self.of_set[:, self.edges[edges]], SET_RADII)
        of_sets = np.abs(ends[..., 0] - ends[..., 1]).reshape(self.columns[1], -1).T
        return np.hstack([self.use[edges].reshape(len(edges), -1), of_sets])

    def at_places(self, places: Ints) -> Floats:
        """float64[columns, n]: the sum of each over its cells."""
        of_sets = _cut(self.of_set[:, places], SET_RADII).reshape(self.columns[1], -1)
        return np.vstack([self.height[:, :, places].reshape(self.columns[0], -1), of_sets])

    def caps(self) -> Floats:
        """float64[B, R]: the most that a cell of each block has at start and end together."""
        found = []
        for b in range(self.height.shape[0]):
            here = self.of_cell[self.block == b]
            found.append(
                np.minimum(here[:, self.start].max(), CELL_RADII)
                + np.minimum(here.max(), CELL_RADII)
            )
        return np.array(found, np.float64)

    def tables(self, multiples: Floats) -> tuple[Floats, Floats]:
        """float64[B, 256] and float64[S, 256]: the potential at a distance."""
        cells, sets = self.columns
        far = np.arange(FAR + 1)
        return (
            multiples[:cells].reshape(-1, len(CELL_RADII)) @ np.minimum(far, CELL_RADII[:, None]),
            multiples[cells : cells + sets].reshape(-1, len(SET_RADII))
            @ np.minimum(far, SET_RADII[:, None]),
        )

    def change(self, multiples: Floats) -> Floats:
        """float64[E]: by how much all potentials together change with each move."""
        cells, _ = self.columns
        change = self.use.reshape(len(self.edges), -1).astype(np.float64) @ multiples[:cells]
        for table, far in zip(self.tables(multiples)[1], self.of_set, strict=True):
            values = table[far]
            change += np.abs(values[self.edges[:, 0]] - values[self.edges[:, 1]])
        return change

    def prove(self, multiples: Floats, spare: int) -> float:
        """The bound that these multiples prove, whatever they are."""
        worst = float(self.change(multiples).max(initial=0.0)) * (1 + 1e-9)
        if worst <= 0:
            return 0.0
        of_cell, of_set = self.tables(multiples / worst)
        sets = np.zeros(self.of_set.shape[1])
        for table, far in zip(of_set, self.of_set, strict=True):
            sets += table[far[self.start]] + table[far]
        return float(
            bound_kernels.guaranteed(self.of_cell, self.block, of_cell, self.start, spare, sets)
        )


def _cut(distance: Bytes, radii: npt.NDArray[np.int64]) -> Floats:
    """float64[S, R, ...] of uint8[S, ...]: distances, cut off at each radius."""
    shape = (1, len(radii), *([1] * (distance.ndim - 1)))
    return np.minimum(distance[:, None].astype(np.float64), radii.reshape(shape))


def _blocks(cells: Ints) -> Ints:
    """int32[n] in 0..B-1: the square of the floor plan that each cell lies in."""
    low = cells.min(axis=0)
    span = cells.max(axis=0) - low + 1
    side = math.ceil(math.sqrt(span[0] * span[1]) / BLOCKS)
    row, col = ((cells - low) // side).T
    return np.unique(row * span[1] + col, return_inverse=True)[1].astype(np.int32)


def _sets(task: CoverageTask) -> Bytes:
    """uint8[S, F]: distances to where one cell of a set is seen from, that cannot be missed.

    Around each of some places that are far from each other: the cells that can only be seen from
    nearby. And those that are seen last from the start.
    """
    size = task.spare + 1
    queue = np.empty(len(task.places), np.int32)
    seer_start, seers = task.seers

    def toward(cells: npt.NDArray[np.intp]) -> Bytes:
        from_where = [seers[seer_start[x] : seer_start[x + 1]] for x in cells]
        sources = np.unique(np.concatenate(from_where))
        far = np.empty(len(task.places), np.int32)
        kernels.distances(task.moves, sources, FAR, far, queue)
        return far.astype(np.uint8)

    found = [toward(np.argsort(-_first_seen(task), kind="stable")[:size])]
    away = nearest = _away(task, task.start)
    worst = np.empty(len(task.cells), np.int32)
    for _ in range(min(SETS, len(task.places))):
        bound_kernels.privacy(task.view_start, task.view, away, worst)
        found.append(toward(np.argsort(worst, kind="stable")[:size]))
        away = _away(task, int(nearest.argmax()))
        nearest = np.minimum(nearest, away)
    return np.unique(found, axis=0)


def _solve(potentials: _Potentials, spare: int) -> Floats:
    """float64[columns]: multiples that prove much.

    Variables are the multiples, and of the adversary's dual the price of leaving out any cell,
    what a block is dearer than that, and the bound. Moves and ends are taken in as they turn out
    to matter.
    """
    cells, sets = potentials.columns
    caps = potentials.caps()
    blocks, radii = caps.shape
    sizes = np.bincount(potentials.block, minlength=blocks)
    width = cells + sets + blocks + 2
    dear = np.zeros((blocks, width))
    for b in range(blocks):
        dear[b, b * radii : (b + 1) * radii] = caps[b]
        dear[b, cells + sets + b] = -1
    dear[:, -2] = -1
    objective = np.zeros(width)
    objective[-1] = -1
    start = np.array([potentials.start], np.int32)
    at_start = potentials.at_places(start)
    everywhere = potentials.at_places(np.arange(potentials.of_set.shape[1], dtype=np.int32))
    sample = np.arange(
        0, len(potentials.edges), 1 + len(potentials.edges) // SAMPLED, dtype=np.int32
    )
    edges = np.unique(sample[potentials.at_edges(sample).argmax(axis=0)])
    ends = start
    multiples = np.zeros(cells + sets)
    for _ in range(MAX_ROUNDS):
        moved = np.zeros((len(edges), width))
        moved[:, : cells + sets] = potentials.at_edges(edges)
        ended = np.zeros((len(ends), width))
        ended[:, : cells + sets] = -(at_start + everywhere[:, ends]).T
        ended[:, cells + sets : -2] = sizes
        ended[:, -2], ended[:, -1] = spare, 1
        limits = np.concatenate([np.ones(len(edges)), np.zeros(blocks + len(ends))])
        found = linprog(
            objective, A_ub=np.vstack([moved, dear, ended]), b_ub=limits, method="highs"
        )
        if found.x is None:
            break
        multiples = np.maximum(found.x[: cells + sets], 0.0)
        change, totals = potentials.change(multiples), multiples @ everywhere
        if change.max() < CLOSE_ENOUGH and totals[ends].min() <= totals.min() + 0.1:
            break
        worst = np.argsort(-change)[:200]
        edges = np.union1d(edges, worst[change[worst] > 1.001]).astype(np.int32)
        ends = np.union1d(ends, np.argsort(totals)[:5]).astype(np.int32)
    return multiples
