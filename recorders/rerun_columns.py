"""Steps as columns of a Rerun recording: what of a step is shown, and where in a picture."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import islice
from typing import Final

import numpy as np
import numpy.typing as npt
import rerun as rr

from mapreplay.floorplan import explorable
from mapreplay.recorders.palette import (
    AGENT_COLOUR,
    CELL_COLOURS,
    CURVE_COLOURS,
    FRONTIER_COLOUR,
    PLAN_COLOUR,
    RAYS_COLOUR,
    CellClass,
)
from mapreplay.recorders.rerun_layout import TIMELINE, Entity, curve_path
from mapreplay.recorders.scene import (
    cell_classes,
    curves,
    display_probability,
    error_classes,
    rays_of,
)
from mapreplay.step import EpisodeHeader, EventKind, Step

BLOCK_STEPS: Final = 100
BLOCK_BYTES: Final = 32 << 20
"""Of all pictures of a block of steps together."""
_PICTURES: Final = 4

_EVENT_LEVELS: Final = {
    EventKind.SEALED_IN: rr.TextLogLevel.WARN,
    EventKind.RELEASED: rr.TextLogLevel.INFO,
    EventKind.TARGET_REACHED: rr.TextLogLevel.INFO,
    EventKind.CORRECT_REACHED: rr.TextLogLevel.INFO,
    EventKind.OUTCOME: rr.TextLogLevel.INFO,
}

Points = npt.NDArray[np.float32]
"""float32[n, 2]: x to the right and y downwards, in cells from the top left of a picture."""


def send_episode(
    recording: rr.RecordingStream, header: EpisodeHeader, steps: Iterable[Step], root: str = ""
) -> None:
    """Send a whole episode, in blocks of steps, so that memory stays bounded.

    Args:
        recording: where to.
        header: of the episode.
        steps: in order, from the first.
        root: "" or "/..." without a slash at its end: two episodes in one recording need two
            roots, and then share the timeline.
    """
    columns = EpisodeColumns(recording, header, root)
    height, width = header.floor_plan.shape
    size = max(1, min(BLOCK_STEPS, BLOCK_BYTES // (_PICTURES * height * width)))
    for block in _blocks(steps, size):
        columns.send(block)


class EpisodeColumns:
    """Sends the steps of one episode to a recording, block by block, in order.

    What holds for the whole episode is sent when this is made.
    """

    def __init__(
        self, recording: rr.RecordingStream, header: EpisodeHeader, root: str = ""
    ) -> None:
        self._recording = recording
        self._header = header
        self._root = root
        self._explorable = explorable(header.floor_plan.cells, header.start)
        self._trail_end: Points = np.empty((0, 2), np.float32)
        self._send_static()

    def send(self, steps: Sequence[Step]) -> None:
        """Send the next steps; one column each, whatever their number."""
        index = rr.TimeColumn(TIMELINE, sequence=[step.index for step in steps])
        self._send_maps(index, steps)
        self._send_agent(index, steps)
        self._send_plan(index, steps)
        for curve in curves(self._header):
            values = [getattr(step.metrics, curve.value) for step in steps]
            self._send(curve_path(curve, self._root), index, rr.Scalars.columns(scalars=values))
        self._send_events(steps)

    def _send(self, path: str, index: rr.TimeColumn, columns: rr.ComponentColumnList) -> None:
        self._recording.send_columns(path, [index], columns)

    def _send_maps(self, index: rr.TimeColumn, steps: Sequence[Step]) -> None:
        truth = self._header.floor_plan.cells
        for entity, classes in (
            (Entity.OBSERVED, [cell_classes(step.observed) for step in steps]),
            (Entity.FUSED, [cell_classes(step.fused) for step in steps]),
            (Entity.ERROR, [error_classes(step.fused, truth, self._explorable) for step in steps]),
        ):
            columns = rr.SegmentationImage.columns(buffer=as_pictures(classes))
            self._send(entity.below(self._root), index, columns)
        predictions = [step.p_wall for step in steps]
        shown = [display_probability(p_wall) for p_wall in predictions if p_wall is not None]
        if shown:
            buffer = rr.DepthImage.columns(buffer=as_pictures(shown))
            columns = buffer.partition([int(p_wall is not None) for p_wall in predictions])
            self._send(Entity.PREDICTED.below(self._root), index, columns)

    def _send_agent(self, index: rr.TimeColumn, steps: Sequence[Step]) -> None:
        height = self._header.floor_plan.shape[0]
        agents = centres(np.array([step.agent for step in steps]), height)
        self._send(Entity.AGENT.below(self._root), index, rr.Points2D.columns(positions=agents))

        poses = np.concatenate([self._trail_end, agents])
        moves = np.stack([poses[:-1], poses[1:]], axis=1)
        first = [0] * (len(steps) - len(moves))  # the first step has no move
        trail = rr.LineStrips2D.columns(strips=moves).partition([*first, *[1] * len(moves)])
        self._send(Entity.TRAIL.below(self._root), index, trail)
        self._trail_end = agents[-1:]

        rays = np.concatenate([ray_strips(step, self._header) for step in steps])
        columns = rr.LineStrips2D.columns(strips=rays)
        columns = columns.partition([len(step.hits) for step in steps])
        self._send(Entity.RAYS.below(self._root), index, columns)

    def _send_plan(self, index: rr.TimeColumn, steps: Sequence[Step]) -> None:
        height = self._header.floor_plan.shape[0]
        frontier = centres(np.concatenate([step.frontier for step in steps]), height)
        columns = rr.Points2D.columns(positions=frontier)
        columns = columns.partition([len(step.frontier) for step in steps])
        self._send(Entity.FRONTIER.below(self._root), index, columns)

        decisions = [step.decision for step in steps]
        decided = [int(decision is not None) for decision in decisions]
        paths = [centres(decision.path, height) for decision in decisions if decision]
        strips = rr.LineStrips2D.columns(strips=paths).partition(decided)
        self._send(Entity.PATH.below(self._root), index, strips)
        targets = np.array([path[-1] for path in paths], np.float32).reshape(-1, 2)
        points = rr.Points2D.columns(positions=targets).partition(decided)
        self._send(Entity.TARGET.below(self._root), index, points)

    def _send_events(self, steps: Sequence[Step]) -> None:
        events = [(step.index, event) for step in steps for event in step.events]
        if events:
            index = rr.TimeColumn(TIMELINE, sequence=[i for i, _ in events])
            columns = rr.TextLog.columns(
                text=[f"step {i}, {event.kind}: {event.text}" for i, event in events],
                level=[_EVENT_LEVELS[event.kind] for _, event in events],
            )
            self._send(Entity.EVENTS.below(self._root), index, columns)

    def _send_static(self) -> None:
        height, width = self._header.floor_plan.shape
        picture = rr.components.ImageFormat(
            width=width, height=height, color_model="L", channel_datatype="U8"
        )
        truth = as_pictures([cell_classes(self._header.floor_plan.cells)])
        line, cells = rr.LineStrips2D.from_fields, rr.SegmentationImage.from_fields
        entities: dict[Entity, rr.AsComponents] = {
            Entity.MAPS: rr.AnnotationContext([(c, c.label, CELL_COLOURS[c]) for c in CellClass]),
            Entity.TRUTH: cells(buffer=truth[0], format=picture, opacity=1.0),
            Entity.OBSERVED: cells(format=picture, opacity=1.0),
            Entity.FUSED: cells(format=picture, opacity=1.0),
            Entity.ERROR: cells(format=picture, opacity=1.0),
            Entity.PREDICTED: rr.DepthImage.from_fields(
                format=picture, colormap="viridis", depth_range=[0, 255], meter=255.0
            ),
            # A negative radius is in points of the screen, so that it is seen on any map.
            Entity.RAYS: line(colors=[RAYS_COLOUR], radii=[-0.6]),
            Entity.TRAIL: line(colors=[AGENT_COLOUR], radii=[-1.2]),
            Entity.AGENT: rr.Points2D.from_fields(colors=[AGENT_COLOUR], radii=[-4.5]),
            Entity.FRONTIER: rr.Points2D.from_fields(colors=[FRONTIER_COLOUR], radii=[0.3]),
            Entity.PATH: line(colors=[PLAN_COLOUR], radii=[-1.2]),
            Entity.TARGET: rr.Points2D.from_fields(colors=[PLAN_COLOUR], radii=[-4.5]),
            Entity.HEADER: rr.TextDocument(describe(self._header), media_type="text/markdown"),
        }
        for entity, components in entities.items():
            self._recording.log(entity.below(self._root), components, static=True)
        for curve in curves(self._header):
            style = rr.SeriesLines(colors=[CURVE_COLOURS[curve]], names=[curve.label], widths=[2.0])
            self._recording.log(curve_path(curve, self._root), style, static=True)


def as_pictures(grids: Sequence[npt.NDArray[np.uint8]]) -> npt.NDArray[np.uint8]:
    """uint8[n, H * W]: grids uint8[H, W] as images, whose row 0 is on top.

    With `centres`, the one place where y is turned over: row r of a grid of height H is row
    H - 1 - r of its picture.
    """
    return np.stack([grid[::-1].ravel() for grid in grids])


def centres(cells: npt.NDArray[np.integer], height: int) -> Points:
    """float32[n, 2]: where the centres of cells, (row, col)[n, 2], lie in a picture."""
    rows, cols = cells[:, 0], cells[:, 1]
    return np.stack([cols + 0.5, height - 1 - rows + 0.5], axis=1).astype(np.float32)


def ray_strips(step: Step, header: EpisodeHeader) -> Points:
    """float32[n, 2, 2]: each ray of a step from the agent to the last cell that it marked."""
    height = header.floor_plan.shape[0]
    ends = rays_of(step, header).ends
    starts = np.broadcast_to(np.asarray(step.agent), ends.shape)
    return np.stack([centres(starts, height), centres(ends, height)], axis=1)


def describe(header: EpisodeHeader) -> str:
    """The header and the legend, as a Markdown document."""
    config, plan = header.config, header.floor_plan
    height, width = plan.shape
    rows = {
        "floor plan": plan.id,
        "size": f"{height} x {width} cells of {plan.resolution:g} m",
        "start (row, col)": f"{header.start.row}, {header.start.col}",
        "planner": config.planner,
        "predictor": header.predictor.name,
        "plan on / build": f"{config.plan_on} / {config.build}",
        "fail-safe": "on" if config.fail_safe else "off",
        "target": f"coverage {config.coverage:g} of the {config.build} map",
        "delta free / occupied": f"{config.delta_free:g} / {config.delta_occupied:g}",
        "sensor": f"{config.rays} rays of {config.reach} cells",
        "seed": str(config.seed),
        "at most": f"{header.max_steps} steps",
        **dict(header.versions),
    }
    heading, *rest = (f"| {key} | {value} |" for key, value in rows.items())
    return "\n".join([_LEGEND, "", heading, "|---|---|", *rest, ""])


_LEGEND: Final = """\
- **Maps**: free white, wall black, unknown grey
- **P(wall)**: 0 violet, 1 yellow
- **Error**: false wall red, false free light blue, not explorable slate; else as in the maps
- **Agent** and trail pink, rays blue, frontier orange, path and target green\
"""


def _blocks(steps: Iterable[Step], size: int) -> Iterator[list[Step]]:
    iterator = iter(steps)
    while block := list(islice(iterator, size)):
        yield block
