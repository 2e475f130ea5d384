"""The blame chain: since when each blocking cell was a predicted wall, on which evidence."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import count
from typing import Final, TypeAlias

import numpy as np
import numpy.typing as npt

from mapreplay.analysis.diagnosis.detect import runs
from mapreplay.grid import FREE, OCCUPIED, UNKNOWN, Cell, Grid, Quantized
from mapreplay.mapping import dequantize
from mapreplay.step import Cells

AROUND: Final = 2
"""Evidence around a cell is what was observed at most this many rows and columns away."""

Maps: TypeAlias = tuple[Grid, Quantized | None, Grid]
"""Observed map, prediction and fused map of a step."""


@dataclass(frozen=True, eq=False)
class Blame:
    """The history of one blocking cell."""

    cell: Cell
    p_wall: float
    """P(occupied) when the agent was sealed in."""
    since: int
    """The step since which it was predicted to be a wall, up to the sealing."""
    first: int
    """The first step at which it was predicted to be a wall."""
    flickers: int
    """How often, before that, it was predicted to be a wall and then, unobserved, no longer."""
    seen_free: int
    """Observed free cells around it (`AROUND`) at `since`."""
    seen_occupied: int
    """Observed occupied cells there."""
    unseen: int
    """Cells of the map there that had not been observed."""
    distance: float | None
    """Cells to the nearest observed cell at `since`; None if nothing was observed."""
    seen_at: int | None
    """The first later step at which it had been observed; None if it never was."""
    history: npt.NDArray[np.float64]
    """float64[steps]: P(occupied) at every step of the log; NaN without a prediction."""

    @property
    def confidence(self) -> float:
        """Of the network in its prediction: |2 p - 1|, in [0, 1]."""
        return abs(2 * self.p_wall - 1)


@dataclass
class _Trace:
    """What is recorded of a cell at every step."""

    history: list[float]
    wall: list[int]
    """The steps at which it was predicted to be a wall."""
    seen_at: int | None


def trace_blame(
    maps: Iterable[Maps],
    blocking: Sequence[tuple[int, Cells]],
    numbers: Iterable[int] | None = None,
) -> list[list[Blame]]:
    """The blame chains of several sealings, in one pass over the maps of a log.

    Args:
        maps: Of all steps of the log, in order.
        blocking: For each sealing its first step and int32[n, 2] the cells to trace.
        numbers: Of the steps; 0, 1, 2, ... by default.

    Returns:
        For each sealing one chain per cell, in the order of the cells.
    """
    traces = [[_Trace([], [], None) for _ in cells] for _, cells in blocking]
    starts = [[-1] * len(cells) for _, cells in blocking]
    around: dict[tuple[int, int], tuple[int, int, int, float | None]] = {}
    for index, (observed, p_wall, fused) in zip(numbers or count(), maps, strict=False):
        for s, (step, cells) in enumerate(blocking):
            rows, cols = cells[:, 0], cells[:, 1]
            seen = observed[rows, cols] != UNKNOWN
            wall = (fused[rows, cols] == OCCUPIED) & ~seen
            p = np.full(len(cells), np.nan) if p_wall is None else dequantize(p_wall[rows, cols])
            for i in range(len(cells)):
                trace = traces[s][i]
                trace.history.append(float(p[i]))
                if seen[i] and trace.seen_at is None:
                    trace.seen_at = index
                if wall[i] and index <= step:
                    if starts[s][i] < 0:
                        starts[s][i] = index
                        around[s, i] = _evidence(observed, Cell(int(rows[i]), int(cols[i])))
                    trace.wall.append(index)
                elif index <= step:
                    starts[s][i] = -1
    return [
        [
            _blame(trace, Cell(*cell), step, around.get((s, i), (0, 0, 0, None)))
            for i, (trace, cell) in enumerate(zip(traces[s], cells.tolist(), strict=True))
        ]
        for s, (step, cells) in enumerate(blocking)
    ]


def _blame(
    trace: _Trace, cell: Cell, step: int, around: tuple[int, int, int, float | None]
) -> Blame:
    spells = list(runs(trace.wall)) or [(step, step)]
    return Blame(
        cell=cell,
        p_wall=trace.history[step],
        since=spells[-1][0],
        first=spells[0][0],
        flickers=len(spells) - 1,
        seen_free=around[0],
        seen_occupied=around[1],
        unseen=around[2],
        distance=around[3],
        seen_at=trace.seen_at,
        history=np.array(trace.history, np.float64),
    )


def _evidence(observed: Grid, cell: Cell) -> tuple[int, int, int, float | None]:
    """Free, occupied and unobserved cells around `cell`, and how far the nearest observed is."""
    rows = slice(max(0, cell.row - AROUND), cell.row + AROUND + 1)
    cols = slice(max(0, cell.col - AROUND), cell.col + AROUND + 1)
    near = observed[rows, cols]
    return (
        int((near == FREE).sum()),
        int((near == OCCUPIED).sum()),
        int((near == UNKNOWN).sum()),
        distance_to_observed(observed, cell),
    )


def distance_to_observed(observed: Grid, cell: Cell) -> float | None:
    """Cells (Euclidean) from `cell` to the nearest one that was observed; None if none was."""
    seen = np.argwhere(observed != UNKNOWN)
    if len(seen) == 0:
        return None
    return float(np.sqrt(((seen - np.array(cell)) ** 2).sum(axis=1).min()))
