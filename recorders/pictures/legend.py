"""The legend of the maps: what each colour and sign means."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np

from mapreplay.recorders.pictures.annotations import Mark, mark_colours
from mapreplay.recorders.pictures.canvas import Sheet
from mapreplay.recorders.pictures.layers import has_prediction, has_truth
from mapreplay.recorders.pictures.palette import (
    AGENT_COLOUR,
    CELL_COLOURS,
    FRONTIER_COLOUR,
    HITS_COLOUR,
    PLAN_COLOUR,
    RAYS_COLOUR,
    RIVALS_COLOUR,
    CellClass,
    Colour,
    Theme,
    viridis,
)
from mapreplay.step import EpisodeHeader

LINE: Final = 20.0
"""Points from one line of a legend to the next."""
_SIZE: Final = 11.5
_SIGN: Final = 12.0
_GAP: Final = 16.0
_BAR: Final = 72.0


class Sign(StrEnum):
    """How something is drawn."""

    CELL = "cell"
    DOT = "dot"
    LINE = "line"
    RAMP = "ramp"


@dataclass(frozen=True)
class Entry:
    """A sign and what it means."""

    sign: Sign
    colour: Colour
    label: str


def entries(headers: Sequence[EpisodeHeader], marks: Sequence[Mark] = ()) -> list[Entry]:
    """What is on the maps of these episodes, in the order of reading."""
    shown = [Entry(Sign.CELL, CELL_COLOURS[c], c.label) for c in _ALWAYS]
    if any(has_truth(header) for header in headers):
        shown += [Entry(Sign.CELL, CELL_COLOURS[c], c.label) for c in _JUDGED]
    if any(has_prediction(header) for header in headers):
        shown.append(Entry(Sign.RAMP, (0, 0, 0), "P(wall)"))
    shown += [
        Entry(Sign.DOT, AGENT_COLOUR, "agent, trail"),
        Entry(Sign.LINE, RAYS_COLOUR, "rays"),
        Entry(Sign.DOT, HITS_COLOUR, "hits"),
        Entry(Sign.DOT, FRONTIER_COLOUR, "frontier"),
        Entry(Sign.DOT, PLAN_COLOUR, "target, path"),
        Entry(Sign.DOT, RIVALS_COLOUR, "rivals"),
    ]
    return shown + [Entry(Sign.CELL, colour, name) for name, colour in mark_colours(marks).items()]


_ALWAYS: Final = (CellClass.FREE, CellClass.OCCUPIED, CellClass.UNKNOWN)
_JUDGED: Final = (CellClass.FALSE_WALL, CellClass.FALSE_FREE, CellClass.NOT_EXPLORABLE)


def draw_legend(
    sheet: Sheet, x: float, y: float, width: float, legend: Sequence[Entry], theme: Theme
) -> None:
    """Draw the entries in lines of `width` points, the first one's middle at `y`."""
    for line, placed in enumerate(_lines(sheet, width, legend)):
        for left, entry in placed:
            _draw(sheet, x + left, y + line * LINE, entry, theme)


def lines_of(sheet: Sheet, width: float, legend: Sequence[Entry]) -> int:
    """How many lines `draw_legend` takes."""
    return len(_lines(sheet, width, legend))


def _lines(sheet: Sheet, width: float, legend: Sequence[Entry]) -> list[list[tuple[float, Entry]]]:
    """The entries of each line with where they begin."""
    lines: list[list[tuple[float, Entry]]] = [[]]
    left = 0.0
    for entry in legend:
        needed = _width(sheet, entry)
        if lines[-1] and left + needed > width:
            lines.append([])
            left = 0.0
        lines[-1].append((left, entry))
        left += needed + _GAP
    return lines


def _width(sheet: Sheet, entry: Entry) -> float:
    label = sheet.width_of(entry.label, _SIZE)
    if entry.sign is Sign.RAMP:
        return label + 6 + _digits(sheet, "0") + _BAR + _digits(sheet, "1")
    return _SIGN + 5 + label


def _digits(sheet: Sheet, text: str) -> float:
    return sheet.width_of(text, _SIZE) + 4


def _draw(sheet: Sheet, x: float, y: float, entry: Entry, theme: Theme) -> None:
    middle = x + _SIGN / 2
    if entry.sign is Sign.RAMP:
        sheet.text(x, y, entry.label, _SIZE, theme.ink)
        x += sheet.width_of(entry.label, _SIZE) + 6
        sheet.text(x, y, "0", _SIZE, theme.ink)
        x += _digits(sheet, "0")
        levels = np.linspace(0, 255, sheet.px(_BAR)).astype(int)
        ramp = np.repeat(viridis()[None, levels], sheet.px(_SIGN), axis=0)
        sheet.paste(x, y - _SIGN / 2, ramp)
        sheet.text(x + _BAR + 4, y, "1", _SIZE, theme.ink)
        return
    if entry.sign is Sign.CELL:
        sheet.box(x, y - _SIGN / 2, _SIGN, _SIGN, entry.colour)
        sheet.frame(x, y - _SIGN / 2, _SIGN, _SIGN, theme.faint)
    elif entry.sign is Sign.DOT:
        sheet.disc(middle, y, 4.5, entry.colour)
    else:
        sheet.line(np.array([[x, y], [x + _SIGN, y]]), entry.colour, 1.6)
    sheet.text(x + _SIGN + 5, y, entry.label, _SIZE, theme.ink)
