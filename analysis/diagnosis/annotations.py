"""A diagnosis as marks on maps, for the viewer, pictures and pages."""

from __future__ import annotations

from typing import Final

import numpy as np

from mapreplay.analysis.diagnosis.diagnosis import Diagnosis, Sealing
from mapreplay.analysis.reporting.wording import counted
from mapreplay.recorders.pictures.annotations import Mark
from mapreplay.step import Cells

BLOCKING: Final = "blocking cell"
OPENING: Final = "opening"
TIED: Final = "equivalent cell"
VIEWPOINT: Final = "informative viewpoint"


def marks_of(diagnosis: Diagnosis) -> list[Mark]:
    """The marks of all sealings, each shown while the agent was sealed in."""
    return [mark for sealing in diagnosis.sealings for mark in sealing_marks(sealing)]


def sealing_marks(sealing: Sealing) -> list[Mark]:
    """Blocking cells, those of the opening that are none, and the informative viewpoint."""
    first, last = sealing.first_step, sealing.last_step
    marks = []
    blocking, opening, viewpoint = sealing.blocking, sealing.opening, sealing.remedy.viewpoint
    if blocking is not None:
        chosen = _set(blocking.cells)
        others = [cell for cell in blocking.tied.tolist() if tuple(cell) not in chosen]
        text = f"{counted(len(chosen), 'false wall')} sealed the agent in at step {first}"
        marks.append(Mark(BLOCKING, first, last, blocking.cells, text))
        if others:
            text = "correcting one of these would have opened a way out as well"
            marks.append(Mark(TIED, first, last, np.array(others, np.int32), text))
        if opening is not None:
            taken = _set(blocking.tied)
            left = [cell for cell in opening.cells.tolist() if tuple(cell) not in taken]
            if left:
                text = f"the opening, {counted(opening.width, 'cell')} wide"
                marks.append(Mark(OPENING, first, last, np.array(left, np.int32), text))
    if viewpoint is not None:
        away, walls = counted(viewpoint.moves, "move"), counted(viewpoint.sees, "false wall")
        text = f"from here, {away} away, {walls} would have been seen as free"
        marks.append(Mark(VIEWPOINT, first, last, np.array([viewpoint.cell], np.int32), text))
    return marks


def _set(cells: Cells) -> set[tuple[int, int]]:
    return {(row, col) for row, col in cells.tolist()}
