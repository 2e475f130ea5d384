"""A diagnosis as a page: the maps at the sealing, the histories of the blocking cells, counts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from matplotlib.figure import Figure

from mapreplay.analysis.diagnosis import tables
from mapreplay.analysis.diagnosis.annotations import sealing_marks
from mapreplay.analysis.diagnosis.corpus import groups, pooled_reliability
from mapreplay.analysis.diagnosis.diagnosis import Diagnosis, Sealing
from mapreplay.analysis.diagnosis.paragraph import paragraph, what_if
from mapreplay.analysis.diagnosis.taxonomy import KINDS
from mapreplay.analysis.reporting.figures import colour, in_the_dark, render
from mapreplay.analysis.reporting.page import (
    Columns,
    CommandLine,
    Facts,
    Heading,
    Illustration,
    Items,
    Note,
    Page,
    PageBlock,
    Paragraph,
    Table,
)
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.recorders.pictures.annotations import mark_colours
from mapreplay.recorders.pictures.layers import MapView
from mapreplay.recorders.pictures.painter import map_pngs
from mapreplay.recorders.pictures.palette import GREEN, ORANGE, SKY_BLUE, YELLOW, Theme, hex_of
from mapreplay.text import shell_command

SHOWN: Final = 3
"""Sealings of a log that get pictures."""
MOST: Final = 40
"""Logs that get pictures; of more there are the counts only."""
_SIDE: Final = 640
"""Pixels of a map's longer side."""


def diagnosis_page(diagnoses: Sequence[tuple[Path, Diagnosis]]) -> str:
    """One HTML page on these logs; those that were sealed in have pictures.

    Raises:
        LogError: a log can no longer be read.
    """
    found = [diagnosis for _, diagnosis in diagnoses]
    reliability = pooled_reliability(found)
    whole = groups(found)[0]
    blocks: list[PageBlock] = []
    if len(found) > 1:
        blocks += _counts(found)
    sealed = [(path, d) for path, d in diagnoses if d.sealings]
    for path, diagnosis in sealed[:MOST]:
        blocks.append(Heading(diagnosis.header.floor_plan.id))
        blocks.append(Paragraph(paragraph(diagnosis, reliability)))
        if command := what_if(diagnosis, path):
            blocks.append(CommandLine(shell_command(command)))
        blocks += _pictures(path, diagnosis)
    if len(sealed) > MOST:
        left = len(sealed) - MOST
        blocks.append(Note(f"{left} more logs were sealed in; their pictures are left out."))
    others = [(path, d) for path, d in diagnoses if not d.sealings]
    if others and len(diagnoses) <= MOST:
        blocks.append(Heading("Never sealed in"))
        blocks.append(Items([[paragraph(d, reliability)] for _, d in others]))
    blocks.append(Heading("What the names mean"))
    blocks.append(Facts([(kind.name.replace("_", " "), kind.rule) for kind in KINDS]))
    lead = (
        f"{whole.sealed.count} of {whole.episodes} agents were sealed in by walls that their own "
        f"prediction invented, {whole.final} of them for good."
    )
    return Page("Why was it sealed in?", lead, blocks, "Made by mapreplay diagnose.").html()


def _counts(found: Sequence[Diagnosis]) -> list[PageBlock]:
    blocks: list[PageBlock] = []
    for title, frame in tables.all_tables(found):
        if len(frame):
            blocks.append(Heading(title, 3))
            rows = [list(row) for row in frame.iter_rows()]
            blocks.append(Table(frame.columns, rows))
    return blocks


def _pictures(path: Path, diagnosis: Diagnosis) -> list[PageBlock]:
    log = EpisodeLog(path)
    views = (MapView.OBSERVED, MapView.FUSED, MapView.ERROR)
    blocks: list[PageBlock] = []
    for sealing in diagnosis.sealings[:SHOWN]:
        step = log[sealing.first_step]
        maps = [
            Illustration(
                png,
                f"{view.heading} map at step {step.index}, the blocking cells marked",
                f"{view.heading}, step {step.index}",
                pixelated=True,
            )
            for view, png in zip(
                views, map_pngs(log, step, views, _SIDE, sealing_marks(sealing)), strict=True
            )
        ]
        blocks.append(Columns(maps))
        blocks.append(Paragraph(legend(sealing)))
        if sealing.blame:
            svg = render(HistoryFigure(diagnosis, sealing), (7.5, 2.4))
            blocks.append(
                Illustration(
                    svg,
                    "P(occupied) of each blocking cell over the steps, with the threshold",
                    "P(occupied) of the blocking cells over the steps; vertical line: the sealing",
                    in_the_dark(svg),
                )
            )
    return blocks


_NAMES: Final = {YELLOW: "yellow", SKY_BLUE: "light blue", GREEN: "green", ORANGE: "orange"}


def legend(sealing: Sealing) -> str:
    """What the colours of the marks mean."""
    colours = mark_colours(sealing_marks(sealing))
    said = ", ".join(f"{_NAMES[colour]}: {name}" for name, colour in colours.items())
    return (
        f"Purple: the agent and its trail; {said}; in the error map red: false wall, blue: wall "
        "predicted free."
    )


@dataclass(frozen=True, eq=False)
class HistoryFigure:
    """P(occupied) of each blocking cell over the steps."""

    diagnosis: Diagnosis
    sealing: Sealing

    def __call__(self, figure: Figure, theme: Theme) -> None:
        """See `figures.Draw`."""
        ink, faint, first = hex_of(theme.ink), hex_of(theme.faint), self.sealing.first_step
        axes = figure.subplots()
        for number, blame in enumerate(self.sealing.blame):
            line, seen = colour(number, theme), blame.seen_at
            name = f"({blame.cell.row}, {blame.cell.col})"
            axes.plot(blame.history, color=line, drawstyle="steps-post", label=name)
            axes.plot([first], [blame.history[first]], "D", color=line, clip_on=False)
            if seen is not None:
                axes.plot([seen], [blame.history[seen]], "o", color=ink)
        high = float(self.diagnosis.header.at(first).thresholds.occupied_at_least)
        axes.axhline(high, color=faint, linestyle=":", linewidth=1)
        axes.annotate(
            "predicted wall above this line", (0, high), color=faint, fontsize=8, va="bottom"
        )
        axes.axvline(first, color=ink, linewidth=1)
        axes.set_xlabel("step")
        axes.set_ylabel("P(occupied)")
        axes.set_ylim(-0.03, 1.06)
        axes.set_xlim(0, max(1, len(self.sealing.blame[0].history) - 1))
        axes.grid(visible=False)
        if len(self.sealing.blame) > 1:
            axes.legend(fontsize=8)
