"""Marks: cells of the map that are pointed at, over some steps, and why.

An analysis makes them (the wall that sealed the agent in, the opening that it closed); the viewer
and the pictures draw them without knowing what they are.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from mapreplay.recorders.pictures.palette import MARK_COLOURS, Colour
from mapreplay.step import Cells


@dataclass(frozen=True, eq=False)
class Mark:
    """Cells that are pointed at."""

    name: str
    """What they are: "blocking cell", "opening"; marks with the same name share a colour."""
    first_step: int
    last_step: int
    """Shown from `first_step` to this one, both included."""
    cells: Cells
    """int32[n, 2]: (row, col)."""
    text: str
    """A sentence about them."""

    def is_shown(self, step: int) -> bool:
        """Whether the mark is shown at `step`."""
        return self.first_step <= step <= self.last_step


def mark_colours(marks: Iterable[Mark]) -> dict[str, Colour]:
    """The colour of each name, in the order of their first marks."""
    names = dict.fromkeys(mark.name for mark in marks)
    return {name: MARK_COLOURS[i % len(MARK_COLOURS)] for i, name in enumerate(names)}


def shown_at(marks: Sequence[Mark], step: int) -> list[Mark]:
    """The marks that are shown at `step`, in order."""
    return [mark for mark in marks if mark.is_shown(step)]
