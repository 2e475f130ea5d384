"""What a recording holds once: styles, the legend, the truth, the episode's description."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
import numpy.typing as npt
import rerun as rr

from mapreplay.recorders.log.facts import facts_of
from mapreplay.recorders.pictures.annotations import Mark
from mapreplay.recorders.pictures.canvas import Sheet
from mapreplay.recorders.pictures.layers import COMPARED, curves, has_truth
from mapreplay.recorders.pictures.legend import draw_legend, entries, lines_of
from mapreplay.recorders.pictures.palette import (
    AGENT_COLOUR,
    CELL_COLOURS,
    CURVE_COLOURS,
    DARK,
    EPISODE_COLOURS,
    FRONTIER_COLOUR,
    HITS_COLOUR,
    PLAN_COLOUR,
    RAYS_COLOUR,
    RIVALS_COLOUR,
    STATE_COLOURS,
    CellClass,
    Colour,
    Curve,
    State,
)
from mapreplay.recorders.pictures.replay import LETTERS, Replay
from mapreplay.recorders.viewer.layout import (
    DIVERGENCE,
    LEGEND,
    NOTE,
    PAPER,
    TIMELINE,
    Entity,
    curve_path,
)
from mapreplay.step import EpisodeHeader
from mapreplay.text import markdown

_LEGEND_WIDTH: Final = 1240.0
"""Points: the narrowest window that the layout is made for, less its margins."""
_LEGEND_SCALE: Final = 2.0
_THIN: Final = (Curve.PRECISION, Curve.RECALL)


def send_static(
    recording: rr.RecordingStream,
    header: EpisodeHeader,
    root: str,
    name: str,
    truth: npt.NDArray[np.uint8],
) -> None:
    """Send what belongs to a whole episode; `truth` is uint8[H * W], its picture."""
    height, width = header.floor_plan.shape
    picture = rr.components.ImageFormat(
        width=width, height=height, color_model="L", channel_datatype="U8"
    )
    line, cells = rr.LineStrips2D.from_fields, rr.SegmentationImage.from_fields
    points = rr.Points2D.from_fields
    entities: dict[Entity, rr.AsComponents] = {
        Entity.MAPS: rr.AnnotationContext([(c, c.label, CELL_COLOURS[c]) for c in CellClass]),
        Entity.OBSERVED: cells(format=picture, opacity=1.0),
        Entity.FUSED: cells(format=picture, opacity=1.0),
        Entity.PREDICTED: rr.DepthImage.from_fields(
            format=picture, colormap="viridis", depth_range=[0, 255], meter=255.0
        ),
        # A negative radius is in points of the screen, so that it is visible on any map.
        Entity.RAYS: line(colors=[RAYS_COLOUR], radii=[-0.6]),
        Entity.HITS: points(colors=[HITS_COLOUR], radii=[0.3]),
        Entity.TRAIL: line(colors=[AGENT_COLOUR], radii=[-1.2]),
        Entity.FRONTIER: points(colors=[FRONTIER_COLOUR], radii=[0.4], draw_order=30.0),
        Entity.PATH: line(colors=[PLAN_COLOUR], radii=[-1.2], draw_order=31.0),
        Entity.RIVALS: points(
            colors=[RIVALS_COLOUR], radii=[0.45], show_labels=False, draw_order=32.0
        ),
        Entity.TARGET: points(
            colors=[PLAN_COLOUR], radii=[-4.5], show_labels=False, draw_order=33.0
        ),
        Entity.AGENT: points(colors=[AGENT_COLOUR], radii=[-4.5], draw_order=34.0),
        Entity.STATE: rr.StateConfiguration(
            values=[str(state) for state in State],
            colors=[STATE_COLOURS[state] for state in State],
        ),
        Entity.DECISION: rr.TextDocument.from_fields(media_type="text/markdown"),
        Entity.HEADER: rr.TextDocument(describe(header), media_type="text/markdown"),
    }
    if has_truth(header):
        entities[Entity.TRUTH] = cells(buffer=truth, format=picture, opacity=1.0)
        entities[Entity.ERROR] = cells(format=picture, opacity=1.0)
    for entity, components in entities.items():
        recording.log(entity.below(root), components, static=True)
    for curve in COMPARED if name else curves(header):
        style = compared_curve(root, name) if name else _curve_style(curve)
        recording.log(curve_path(curve, root), style, static=True)


def _curve_style(curve: Curve) -> rr.SeriesLines:
    width = 1.0 if curve in _THIN else 2.0
    return rr.SeriesLines(colors=[CURVE_COLOURS[curve]], names=[curve.label], widths=[width])


def compared_curve(root: str, name: str) -> rr.SeriesLines:
    """The style of the curve of an episode among those of others."""
    colour = EPISODE_COLOURS[LETTERS.index(root[-1]) % len(EPISODE_COLOURS)]
    return rr.SeriesLines(colors=[colour], names=[name], widths=[2.0])


def mark_style(mark: Mark, colour: Colour) -> rr.Boxes2D:
    """The style of a mark; hovering over a cell shows its text."""
    return rr.Boxes2D.from_fields(
        colors=[colour], radii=[-1.2], labels=[f"{mark.name}: {mark.text}"], show_labels=False
    )


def send_legend(recording: rr.RecordingStream, replays: Sequence[Replay]) -> None:
    """Send the legend of all maps, as a picture."""
    marks = [mark for replay in replays for mark in replay.marks]
    legend = entries([replay.header for replay in replays], marks)
    theme = replace(DARK, paper=PAPER)
    lines = lines_of(Sheet(1, 1, _LEGEND_SCALE, PAPER), _LEGEND_WIDTH, legend)
    sheet = Sheet(_LEGEND_WIDTH + 20, 22.0 * lines, _LEGEND_SCALE, PAPER)
    draw_legend(sheet, 10, 11, _LEGEND_WIDTH, legend, theme)
    recording.log(LEGEND, rr.Image(sheet.picture), static=True)
    recording.log(NOTE, rr.TextDocument("Not in this episode."), static=True)


def send_divergence(recording: rr.RecordingStream, name: str, step: int) -> None:
    """Send where an episode diverges from the first one: a line through the curves, and an event.

    Args:
        recording: where to.
        name: of the episode that diverges.
        step: the last step at which they are the same.
    """
    index = rr.TimeColumn(TIMELINE, sequence=[step])
    text = f"{name[:1]} diverges from the first after step {step}"
    recording.send_columns(f"{DIVERGENCE}/events", [index], rr.TextLog.columns(text=[text]))
    path = f"{DIVERGENCE}/at/{name[:1]}"
    line = rr.SeriesLines(
        colors=[(150, 150, 150)],
        names=[f"{name[:1]} diverges here"],
        widths=[1.5],
        aggregation_policy=rr.components.AggregationPolicy.Off,
    )
    recording.log(path, line, static=True)
    # Two values at one step are a vertical line.
    index = rr.TimeColumn(TIMELINE, sequence=[step, step])
    recording.send_columns(path, [index], rr.Scalars.columns(scalars=[0.0, 1.0]))


def describe(header: EpisodeHeader) -> str:
    """The header as a Markdown document."""
    heading, *rest = (
        f"| {markdown(fact.name)} | {markdown(fact.short)} |" for fact in facts_of(header)
    )
    return "\n".join([heading, "|---|---|", *rest, ""])
