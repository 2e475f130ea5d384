"""The layout of the viewer as one picture, drawn without the viewer: maps, curves, words.

film = Film([Filmed.of(log)])
rgb = film.frame(60)
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import nan
from typing import TYPE_CHECKING, Final, Self

import numpy as np

from mapreplay.errors import UsageError
from mapreplay.grid import Cell
from mapreplay.pictures import Picture
from mapreplay.recorders.pictures.annotations import Mark, shown_at
from mapreplay.recorders.pictures.canvas import Area, Sheet
from mapreplay.recorders.pictures.captions import decision_words, event_words, three_digits
from mapreplay.recorders.pictures.layers import (
    COMPARED,
    MapView,
    curves,
    map_views,
    state_of,
)
from mapreplay.recorders.pictures.legend import LINE, draw_legend, entries, lines_of
from mapreplay.recorders.pictures.painter import MapPainter
from mapreplay.recorders.pictures.palette import (
    CURVE_COLOURS,
    EPISODE_COLOURS,
    LIGHT,
    STATE_COLOURS,
    Curve,
    State,
    Theme,
)
from mapreplay.recorders.pictures.plot import Line, Plot
from mapreplay.recorders.pictures.replay import Series, first_divergence, names_of
from mapreplay.step import Cells, Decision, EpisodeHeader, Event, Step

if TYPE_CHECKING:
    from mapreplay.recorders.log.reader import EpisodeLog

WIDTH: Final = 1280.0
"""Points of a frame; its height follows from the pixels."""
MIN_SIZE: Final = (640, 360)
MAX_SIZE: Final = (7680, 4320)
_MARGIN: Final = 16.0
_TEXT: Final = 12.0
_TITLE: Final = 14.0
_GAP: Final = 14.0
_HEAD: Final = 40.0
_BELOW: Final = (262.0, 190.0)
"""Minimum height below the legend, for one episode and for two."""
_WORDS: Final = 340.0
"""Width of the text next to the maps of each of two episodes."""


@dataclass(frozen=True, eq=False)
class Filmed:
    """An episode to be drawn: its log, and what a frame shows of all steps."""

    log: EpisodeLog
    marks: Sequence[Mark]
    track: Cells
    """int32[n, 2]: where the agent was at each step."""
    scores: dict[Curve, Series]
    states: list[State]
    events: list[tuple[int, Event]]
    painter: MapPainter

    @classmethod
    def of(cls, log: EpisodeLog, marks: Sequence[Mark] = ()) -> Self:
        """Read what is needed from a log.

        Raises:
            LogError: the log is damaged.
        """
        track, states, events = list[Cell](), list[State](), list[tuple[int, Event]]()
        scores: dict[Curve, list[float]] = {curve: [] for curve in Curve}
        for step in log.steps():
            lost = step.index - len(track)  # in a recovered log: the agent stays where it was
            track += [track[-1] if track else step.agent] * lost + [step.agent]
            states += [states[-1] if states else state_of(step)] * lost + [state_of(step)]
            events += [(step.index, event) for event in step.events]
            for curve, values in scores.items():
                values.extend([nan] * lost + [getattr(step.metrics, curve.value)])
        return cls(
            log,
            marks,
            np.array(track, np.int32).reshape(-1, 2),
            {curve: np.array(values, np.float64) for curve, values in scores.items()},
            states,
            events,
            MapPainter(log.header),
        )

    @property
    def header(self) -> EpisodeHeader:
        """The header of its log."""
        return self.log.header

    @property
    def last(self) -> int:
        """Its last step."""
        return len(self.track) - 1


class Film:
    """Draws the steps of one episode, or of two one above the other, as frames of one size."""

    def __init__(
        self, episodes: Sequence[Filmed], size: tuple[int, int] = (1920, 1080), theme: Theme = LIGHT
    ) -> None:
        """Prepare frames.

        Args:
            episodes: one or two; of two, A stands above B, on the same step.
            size: width and height in pixels; an even number of each, for films.
            theme: the colours around the maps.

        Raises:
            UsageError: more than two episodes, or a size out of range.
        """
        if not 1 <= len(episodes) <= 2:
            raise UsageError(f"{len(episodes)} episodes; a picture shows one or two")
        if not all(low <= n <= top for n, low, top in zip(size, MIN_SIZE, MAX_SIZE, strict=True)):
            raise UsageError(f"{size[0]}x{size[1]}: a picture has 640x360 to 7680x4320 pixels")
        self._episodes = episodes
        self._theme = theme
        self._unit = size[0] / WIDTH
        self._height = size[1] / self._unit
        headers = [episode.header for episode in episodes]
        self._names = names_of(headers) if len(episodes) > 1 else [""]
        self._legend = entries(headers, [mark for e in episodes for mark in e.marks])
        divergence = first_divergence(*(e.log for e in episodes)) if len(episodes) > 1 else None
        labels = [f"{name[:1]} state".strip() for name in self._names]
        states = [(label, e.states) for label, e in zip(labels, episodes, strict=True)]
        self._plot = Plot(self.last, states, divergence, theme)

    @property
    def last(self) -> int:
        """The last step of the longer episode."""
        return max(episode.last for episode in self._episodes)

    def frame(self, index: int) -> Picture:
        """uint8[h, w, 3]: step `index`; an episode that has ended stays at its last step.

        Raises:
            LogError: a log is damaged.
        """
        return self._draw([e.log[min(index, e.last)] for e in self._episodes], index)

    def frames(self, every: int = 1) -> Iterator[Picture]:
        """Every Nth step from the first, and the last one.

        Raises:
            LogError: a log is damaged.
        """
        readers = [episode.log.steps() for episode in self._episodes]
        steps = [next(reader) for reader in readers]
        following = [next(reader, None) for reader in readers]
        for index in range(self.last + 1):
            for number, reader in enumerate(readers):
                step = following[number]
                if step is not None and step.index <= index:
                    steps[number], following[number] = step, next(reader, None)
            if index % every == 0 or index == self.last:
                yield self._draw(steps, index)

    def _draw(self, steps: Sequence[Step], index: int) -> Picture:
        sheet = Sheet(WIDTH, self._height, self._unit, self._theme.paper)
        width = WIDTH - 2 * _MARGIN
        self._draw_head(sheet, steps, index)
        rows, legend = len(steps), lines_of(sheet, width, self._legend) * LINE
        beside = _WORDS + _GAP if rows > 1 else 0.0
        room = self._height - _HEAD - legend - _BELOW[rows - 1]
        row_height = min(room / rows, self._fitting(width - beside))
        for row, (episode, step) in enumerate(zip(self._episodes, steps, strict=True)):
            area = Area(_MARGIN, _HEAD + row * row_height, width - beside, row_height - 8)
            self._draw_maps(sheet, area, episode, step, self._names[row][:1])
            if beside:
                words = Area(WIDTH - _MARGIN - _WORDS, area.y, _WORDS, area.height)
                self._draw_words(sheet, words, row, step)
        top = _HEAD + rows * row_height
        draw_legend(sheet, _MARGIN, top + LINE / 2, width, self._legend, self._theme)
        top += legend + 6
        below = Area(_MARGIN, top, width, self._height - top - _MARGIN)
        if rows == 1:
            self._draw_below_one(sheet, below, steps[0], index)
        else:
            self._draw_below_two(sheet, below, index)
        return sheet.picture

    @property
    def _columns(self) -> list[MapView]:
        """The maps side by side: all that at least one of the episodes has."""
        return [v for v in MapView if any(v in map_views(e.header) for e in self._episodes)]

    def _fitting(self, width: float) -> float:
        """The height of a row in which the highest map fills its column."""
        each = (width - _GAP * (len(self._columns) - 1)) / len(self._columns)
        shapes = [episode.header.floor_plan.shape for episode in self._episodes]
        return each * max(height / width for height, width in shapes) + 28

    def _draw_head(self, sheet: Sheet, steps: Sequence[Step], index: int) -> None:
        right = WIDTH - _MARGIN
        count = f"step {index} of {self.last}"
        sheet.text(right, 22, count, _TITLE, self._theme.ink, bold=True, align="r")
        right -= sheet.width_of(count, _TITLE, bold=True) + 16
        if len(steps) == 1:
            self._draw_state(sheet, right, 22, state_of(steps[0]))
            right -= 110
        title = " and ".join(self._names) if len(steps) > 1 else _title(self._episodes[0].header)
        title = sheet.shortened(title, _TITLE * 1.12, right - _MARGIN)
        sheet.text(_MARGIN, 22, title, _TITLE, self._theme.ink, bold=True)

    @staticmethod
    def _draw_state(sheet: Sheet, right: float, y: float, state: State) -> None:
        width = sheet.width_of(state, _TEXT, bold=True) + 16
        sheet.box(right - width, y - 10, width, 20, STATE_COLOURS[state])
        sheet.text(right - width / 2, y, state, _TEXT, (0, 0, 0), bold=True, align="m")

    def _draw_maps(
        self, sheet: Sheet, area: Area, episode: Filmed, step: Step, letter: str
    ) -> None:
        width = (area.width - _GAP * (len(self._columns) - 1)) / len(self._columns)
        for number, view in enumerate(self._columns):
            x = area.x + number * (width + _GAP)
            title = f"{letter}  {view.heading}" if letter else view.heading
            sheet.text(x, area.y + 8, title, _TEXT, self._theme.ink, bold=True)
            box = Area(x, area.y + 20, width, area.height - 20)
            if view not in map_views(episode.header):
                sheet.text(x, box.y + 12, "Not in this episode.", _TEXT, self._theme.faint)
                continue
            picture = episode.painter.draw(
                view,
                step,
                sheet.px(box.width),
                sheet.px(box.height),
                track=episode.track[: step.index + 1],
                marks=episode.marks,
            )
            # The picture is aligned with its title, at the left of the box.
            sheet.paste(box.x, box.y, picture)

    def _draw_below_one(self, sheet: Sheet, area: Area, step: Step, index: int) -> None:
        episode = self._episodes[0]
        shown = curves(episode.header)
        lines = [
            Line(c.label, CURVE_COLOURS[c], episode.scores[c], 0.8 if c in _THIN else 1.5)
            for c in shown
        ]
        plot = Area(area.x, area.y, 0.5 * area.width, area.height)
        self._plot.draw(sheet, plot, "Scores", lines, index)
        x = area.x + plot.width + 28
        self._draw_words(sheet, Area(x, area.y, area.x + area.width - x, area.height), 0, step)

    def _draw_below_two(self, sheet: Sheet, area: Area, index: int) -> None:
        each = (area.width - 2 * _GAP) / len(COMPARED)
        for number, curve in enumerate(COMPARED):
            lines = [
                Line(name[:1], EPISODE_COLOURS[i], episode.scores[curve], 1.5)
                for i, (name, episode) in enumerate(zip(self._names, self._episodes, strict=True))
            ]
            heading = curve.label[0].upper() + curve.label[1:]
            box = Area(area.x + number * (each + 2 * _GAP), area.y, each, area.height)
            self._plot.draw(sheet, box, heading, lines, index)

    def _draw_words(self, sheet: Sheet, area: Area, number: int, step: Step) -> None:
        theme, episode = self._theme, self._episodes[number]
        name = self._names[number][:1]
        bottom = area.y + area.height
        sheet.text(area.x, area.y + 7, f"{name}  Decision".strip(), _TEXT, theme.ink, bold=True)
        if name:
            self._draw_state(sheet, area.x + area.width, area.y + 6, state_of(step))
        y = area.y + 27
        for line in sheet.wrapped(decision_words(step), _TEXT, area.width)[:3]:
            sheet.text(area.x, y, line, _TEXT, theme.ink)
            y += 17
        if step.decision and step.decision.rivals and bottom - y > _ROW * 8:
            y = self._draw_candidates(sheet, area.x, y + 6, step.decision)
        past = [(k, event) for k, event in episode.events if k <= step.index]
        notes = [(f"step {k}", event_words(event)) for k, event in past]
        notes += [("", f"{mark.name}: {mark.text}") for mark in shown_at(episode.marks, step.index)]
        room = max(0, int((bottom - y - 6) // _ROW))
        y += 10
        for when, text in notes[-room:] if room else []:
            sheet.text(area.x, y, when, 11, theme.faint)
            left = 60 if when else 0
            shown = sheet.shortened(text, 11, area.width - left)
            sheet.text(area.x + left, y, shown, 11, theme.ink)
            y += _ROW

    def _draw_candidates(self, sheet: Sheet, x: float, y: float, decision: Decision) -> float:
        """The chosen target and its rivals in a table; returns the y below it."""
        theme = self._theme
        columns = (x, x + 150, x + 230, x + 330)
        heads = ("(row, col)", "utility", "gain", "cells away")
        sheet.text(columns[0], y, heads[0], 10.5, theme.faint)
        for left, head in zip(columns[1:], heads[1:], strict=True):
            sheet.text(left, y, head, 10.5, theme.faint, align="r")
        for rank, candidate in enumerate((decision.chosen, *decision.rivals)):
            y += _ROW
            bold = rank == 0
            row, col = candidate.cell
            sheet.text(columns[0], y, f"({row}, {col})", 11, theme.ink, bold=bold)
            values = (
                three_digits(candidate.utility),
                f"{candidate.reward:.1f}",
                f"{candidate.cost:.1f}",
            )
            for left, value in zip(columns[1:], values, strict=True):
                sheet.text(left, y, value, 11, theme.ink, bold=bold, align="r")
        return y + 10


_ROW: Final = 16.0
"""From one line of small text to the next."""
_THIN: Final = (Curve.PRECISION, Curve.RECALL)


def _title(header: EpisodeHeader) -> str:
    config = header.config
    parts = [
        header.floor_plan.id,
        config.planner,
        f"plan on {config.plan_on}, build {config.build}",
        *([f"predictor {header.predictor.name}"] if MapView.PREDICTED in map_views(header) else []),
        *(["fail-safe"] if config.fail_safe else []),
        f"seed {config.seed}",
    ]
    return "   ·   ".join(parts)
