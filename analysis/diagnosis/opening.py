"""The opening: the minimum cut in true free space between the agent and what is hidden."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import ndimage, sparse
from scipy.sparse import csgraph

from mapreplay.analysis.diagnosis.reach import EIGHT, grown
from mapreplay.grid import FREE, Cell, Grid, Mask
from mapreplay.kernels import MOVES
from mapreplay.step import Cells


@dataclass(frozen=True, eq=False)
class Opening:
    """A minimum vertex cut."""

    cells: Cells
    """int32[n, 2], row-major: the cut that is nearest to the agent."""
    parts: int
    """Separate groups (8-connected) of these cells: how many openings were closed at once."""
    unique: bool
    """Whether there is no other cut of this size."""

    @property
    def width(self) -> int:
        """Cells that have to be closed."""
        return len(self.cells)


def find_opening(truth: Grid, inside: Mask, hidden: Mask) -> Opening | None:
    """The fewest truly free cells outside of `inside` that separate it from what is hidden.

    The agent sees a hidden cell when it stands on it or next to it. A maximum flow
    through truly free cells, each with capacity one, from `inside` to such cells finds the
    narrowest cut; of several the one nearest to `inside`.

    Args:
        truth: int8[H, W].
        inside: bool[H, W], the truly free cells that the agent can reach on its map.
        hidden: bool[H, W], explorable cells that its map does not know.

    Returns:
        None if nothing is hidden, or no wall of the map is between them.
    """
    free = truth == FREE
    goals = grown(hidden) & free & ~inside
    between = _between(free & ~inside, grown(inside), goals)
    entries, exits = between & grown(inside), between & goals
    if not exits.any() or (grown(hidden) & inside).any():
        return None
    graph, numbers = _graph(between, entries, exits)
    source, sink = graph.shape[0] - 2, graph.shape[0] - 1
    flow = csgraph.maximum_flow(graph, source, sink).flow
    residual = (graph - flow).tocsr()
    residual.eliminate_zeros()
    from_source = _connected(residual, source)
    to_sink = _connected(residual.T.tocsr(), sink)
    rooms = np.arange(0, source, 2)
    near = from_source[rooms] & ~from_source[rooms + 1]
    far = ~to_sink[rooms] & to_sink[rooms + 1]
    cells = np.argwhere(np.isin(numbers, np.flatnonzero(near))).astype(np.int32)
    mask = np.zeros(truth.shape, np.bool_)
    mask[cells[:, 0], cells[:, 1]] = True
    return Opening(cells, int(ndimage.label(mask, EIGHT)[1]), bool((near == far).all()))


def _between(open_cells: Mask, entry: Mask, goals: Mask) -> Mask:
    """The open cells that can be reached from the entry without passing through a goal."""
    through = ndimage.binary_propagation(open_cells & entry & ~goals, EIGHT, open_cells & ~goals)
    return np.asarray((through | (goals & (grown(through) | entry))) & open_cells, np.bool_)


def _graph(
    cells: Mask, entries: Mask, exits: Mask
) -> tuple[sparse.csr_array, npt.NDArray[np.int32]]:
    """Capacities between entrance 2i and exit 2i + 1 of each cell i, the source and the sink
    (the last two nodes), and int32[H, W] the number of each cell, -1 elsewhere.
    """
    count = int(cells.sum())
    numbers = np.full(cells.shape, -1, np.int32)
    numbers[cells] = np.arange(count)
    padded = np.pad(numbers, 1, constant_values=-1)
    height, width = cells.shape
    own = numbers[cells]
    heads, tails = [], []
    for dr, dc in MOVES.tolist():
        near = padded[1 + dr : 1 + dr + height, 1 + dc : 1 + dc + width][cells]
        heads.append(2 * own[near >= 0] + 1)
        tails.append(2 * near[near >= 0])
    source, sink, plenty = 2 * count, 2 * count + 1, count + 1
    ins, outs = numbers[entries], numbers[exits]
    rows = np.concatenate([2 * own, *heads, np.full(len(ins), source), 2 * outs + 1])
    cols = np.concatenate([2 * own + 1, *tails, 2 * ins, np.full(len(outs), sink)])
    rooms = np.full(len(rows), plenty, np.int32)
    rooms[:count] = 1
    graph = sparse.csr_array((rooms, (rows, cols)), shape=(2 * count + 2, 2 * count + 2))
    return graph, numbers


def _connected(graph: sparse.csr_array, start: int) -> npt.NDArray[np.bool_]:
    nodes = csgraph.breadth_first_order(graph, start, return_predecessors=False)
    mask = np.zeros(graph.shape[0], np.bool_)
    mask[nodes] = True
    return mask


def truly_inside(truth: Grid, believed: Mask, agent: Cell) -> Mask:
    """bool[H, W]: the truly free cells of `believed` that the agent can get to without leaving it.

    What it believes to be free may be a wall; what lies behind that is not inside.
    """
    mask = np.where(believed, truth, np.int8(1))
    labels, _ = ndimage.label(mask == FREE, EIGHT)
    if labels[agent] == 0:
        return np.zeros(truth.shape, np.bool_)
    return np.asarray(labels == labels[agent], np.bool_)
