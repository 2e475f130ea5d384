"""Curves over the steps of episodes, with a bar of their states below."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from mapreplay.recorders.pictures.canvas import Area, Sheet
from mapreplay.recorders.pictures.palette import STATE_COLOURS, Colour, State, Theme
from mapreplay.recorders.pictures.replay import Series

_HEADING: Final = 12.0
_LABEL: Final = 11.0
_TICK: Final = 10.0
_BAR: Final = 17.0
"""Height of a bar of states."""
_LAST_STATE: Final = 4.0
"""Width of the last state, which has only one step."""


class Line(NamedTuple):
    """A curve of a plot."""

    name: str
    colour: Colour
    values: Series
    width: float


@dataclass(frozen=True)
class Plot:
    """Everything that is the same at all steps."""

    last: int
    """The last step of the longest episode."""
    states: Sequence[tuple[str, Sequence[State]]]
    """The label of each episode's bar, and its state at each step."""
    divergence: int | None
    """The step from which the episodes diverge."""
    theme: Theme

    def draw(
        self, sheet: Sheet, area: Area, heading: str, lines: Sequence[Line], index: int
    ) -> None:
        """Draw the curves and the states, with a cursor at step `index` through both."""
        theme = self.theme
        sheet.text(area.x, area.y + 7, heading, _HEADING, theme.ink, bold=True)
        labels = [f"{line.name}  {_value(line.values, index)}" for line in lines]
        names = max(sheet.width_of(label, _LABEL) for label in ["A state", *labels]) + 28
        bars = _BAR * len(self.states)
        box = Area(area.x + 26, area.y + 20, area.width - 26 - names, area.height - 44 - bars)
        self._draw_states(sheet, Area(box.x, area.y + area.height - bars, box.width, bars))
        for share in (0.0, 0.25, 0.5, 0.75, 1.0):
            y = box.y + box.height * (1 - share)
            sheet.line(_points([box.x, box.x + box.width], [y, y]), theme.line, 0.8)
            sheet.text(box.x - 5, y, f"{share:g}", _TICK, theme.faint, align="r")
        for tick in _ticks(self.last):
            x = float(self._x(box, tick))
            sheet.text(x, box.y + box.height + 9, str(tick), _TICK, theme.faint, align="m")
        for line in lines:
            steps = self._x(box, np.arange(len(line.values)))
            heights = box.y + box.height * (1 - line.values)
            sheet.line(_points(steps, heights), line.colour, line.width)
        if self.divergence is not None:
            x = float(self._x(box, self.divergence))
            sheet.line(_points([x, x], [box.y - 5, box.y + box.height]), theme.faint, 1.0)
            text = f"diverge after step {self.divergence}"
            left = area.x + sheet.width_of(heading, _HEADING, bold=True) + 14  # above the curves
            right = box.x + box.width - sheet.width_of(text, _TICK)
            sheet.text(max(left, min(x - 3, right)), area.y + 8, text, _TICK, theme.faint)
        x = float(self._x(box, index))
        sheet.line(_points([x, x], [box.y - 3, area.y + area.height]), theme.ink, 1.0)
        for number, (line, label) in enumerate(zip(lines, labels, strict=True)):
            y = box.y + 8 + number * 17
            left = box.x + box.width + 10
            sheet.line(_points([left, left + 12], [y, y]), line.colour, max(2.0, line.width))
            sheet.text(left + 17, y, label, _LABEL, theme.ink)

    def _x(self, box: Area, step: npt.ArrayLike) -> npt.NDArray[np.float64]:
        return box.x + box.width * np.asarray(step, np.float64) / max(1, self.last)

    def _draw_states(self, sheet: Sheet, area: Area) -> None:
        for row, (label, states) in enumerate(self.states):
            y = area.y + row * _BAR
            for state, first, last in _runs(states):
                begin, end = float(self._x(area, first)), float(self._x(area, last + 1))
                if last == len(states) - 1:  # not into the label
                    end = max(min(end, area.x + area.width), begin + _LAST_STATE)
                sheet.box(begin, y, end - begin, _BAR - 3, STATE_COLOURS[state])
            sheet.text(area.x + area.width + 10, y + 7, label, _LABEL, self.theme.ink)


def _value(values: Series, step: int) -> str:
    value = values[min(step, len(values) - 1)]
    return f"{value:.2f}" if np.isfinite(value) else "-"


def _points(xs: npt.ArrayLike, ys: npt.ArrayLike) -> npt.NDArray[np.float64]:
    broad = np.broadcast_arrays(np.asarray(xs, np.float64), np.asarray(ys, np.float64))
    return np.stack(broad, axis=1)


def _ticks(last: int) -> list[int]:
    """Four to nine round numbers from 0 to `last`."""
    for step in (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000):
        if last / step <= 8:
            return list(range(0, last + 1, step))
    return [0, last]


def _runs(states: Sequence[State]) -> Iterator[tuple[State, int, int]]:
    """(state, first step, last step) of each run of the same state."""
    first = 0
    for i in range(1, len(states) + 1):
        if i == len(states) or states[i] is not states[first]:
            yield states[first], first, i - 1
            first = i
