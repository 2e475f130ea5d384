"""Hand-drawn beliefs: what an agent observed and predicted, beside what is true.

Drawn as seen, top row first::

    # .   observed wall, observed free      A   the agent, on an observed free cell
    W f   predicted wall, predicted free    ?   unknown
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drawing import draw, find
from mapreplay.analysis.diagnosis.blocking import BlockingCells, find_blocking_cells
from mapreplay.analysis.diagnosis.opening import Opening, find_opening, truly_inside
from mapreplay.analysis.diagnosis.reach import hidden, reached
from mapreplay.grid import FREE, OCCUPIED, UNKNOWN, Cell, Grid

_FUSED = {"#": OCCUPIED, ".": FREE, "A": FREE, "W": OCCUPIED, "f": FREE, "?": UNKNOWN}
_OBSERVED = {"#": OCCUPIED, ".": FREE, "A": FREE, "W": UNKNOWN, "f": UNKNOWN, "?": UNKNOWN}


@dataclass(frozen=True, eq=False)
class Belief:
    """A drawn situation."""

    truth: Grid
    observed: Grid
    fused: Grid
    agent: Cell

    def blocking(self) -> BlockingCells | None:
        return find_blocking_cells(self.truth, self.observed, self.fused, self.agent)

    def opening(self) -> Opening | None:
        inside = truly_inside(self.truth, reached(self.fused, self.agent), self.agent)
        return find_opening(self.truth, inside, hidden(self.truth, self.fused, self.agent))


def belief(truth: str, believed: str) -> Belief:
    """The situation of two pictures of one size; what was observed must be true."""
    lines = [line.strip() for line in believed.strip().splitlines()][::-1]
    fused = np.array([[_FUSED[mark] for mark in line] for line in lines], np.int8)
    observed = np.array([[_OBSERVED[mark] for mark in line] for line in lines], np.int8)
    cells = draw(truth)
    assert cells.shape == fused.shape
    assert (cells[observed != UNKNOWN] == observed[observed != UNKNOWN]).all()
    return Belief(cells, observed, fused, Cell(*find(believed, "A")))


def marked(picture: str, mark: str) -> set[tuple[int, int]]:
    """(row, col) of every `mark` in a picture."""
    lines = [line.strip() for line in picture.strip().splitlines()][::-1]
    return {(r, c) for r, line in enumerate(lines) for c, m in enumerate(line) if m == mark}
