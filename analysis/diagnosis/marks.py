"""A diagnosis as marks, for whatever draws maps: the viewer, pictures, pages."""

from __future__ import annotations

from typing import Final

import numpy as np

from mapreplay.analysis.diagnosis.diagnosis import Diagnosis, Sealing
from mapreplay.analysis.reporting.wording import counted
from mapreplay.recorders.pictures.annotations import Mark
from mapreplay.step import Cells

CULPRIT: Final = "culprit"
DOORWAY: Final = "doorway"
TIED: Final = "also a culprit"
VIEW: Final = "view that would have helped"


def marks_of(diagnosis: Diagnosis) -> list[Mark]:
    """The marks of all sealings, each shown while the agent was sealed in."""
    return [mark for sealing in diagnosis.sealings for mark in sealing_marks(sealing)]


def sealing_marks(sealing: Sealing) -> list[Mark]:
    """Doorway, culprits and the cheapest view; a cell that is both shows as a culprit."""
    first, last = sealing.first_step, sealing.last_step
    marks = []
    culprits, doorway, view = sealing.culprits, sealing.doorway, sealing.remedy.view
    if culprits is not None:
        chosen = _set(culprits.cells)
        others = [cell for cell in culprits.tied.tolist() if tuple(cell) not in chosen]
        text = f"{counted(len(chosen), 'false wall')} sealed the agent in at step {first}"
        marks.append(Mark(CULPRIT, first, last, culprits.cells, text))
        if others:
            text = "each of these would have done as well"
            marks.append(Mark(TIED, first, last, np.array(others, np.int32), text))
        if doorway is not None:
            taken = _set(culprits.tied)
            left = [cell for cell in doorway.cells.tolist() if tuple(cell) not in taken]
            if left:
                text = f"the doorway, {counted(doorway.width, 'cell')} wide"
                marks.append(Mark(DOORWAY, first, last, np.array(left, np.int32), text))
    if view is not None:
        away, walls = counted(view.moves, "move"), counted(view.sees, "false wall")
        text = f"from here, {away} away, {walls} would have been seen"
        marks.append(Mark(VIEW, first, last, np.array([view.cell], np.int32), text))
    return marks


def _set(cells: Cells) -> set[tuple[int, int]]:
    return {(row, col) for row, col in cells.tolist()}
