"""Steps as columns of a Rerun recording, and cells as places in a picture."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import islice
from typing import Final

import numpy as np
import numpy.typing as npt
import rerun as rr

from mapreplay.recorders.pictures.annotations import Mark, mark_colours
from mapreplay.recorders.pictures.captions import decision_words, event_words, three_digits
from mapreplay.recorders.pictures.layers import (
    COMPARED,
    cell_classes,
    curves,
    display_probability,
    error_classes,
    has_truth,
    rays_of,
    state_of,
)
from mapreplay.recorders.pictures.palette import State
from mapreplay.recorders.pictures.replay import Replay
from mapreplay.recorders.viewer import static as rerun_static
from mapreplay.recorders.viewer.layout import TIMELINE, Entity, curve_path
from mapreplay.step import Candidate, EpisodeHeader, EventKind, Step, StepProfile
from mapreplay.text import markdown

BLOCK_STEPS: Final = 100
BLOCK_BYTES: Final = 16 << 20
"""Of all pictures of a block of steps."""
_PICTURES: Final = 4
_STAGES: Final = ("sense", "predict", "fuse", "score", "plan")

_EVENT_LEVELS: Final = {
    EventKind.SEALED_IN: rr.TextLogLevel.WARN,
    EventKind.RELEASED: rr.TextLogLevel.INFO,
    EventKind.TARGET_REACHED: rr.TextLogLevel.INFO,
    EventKind.CORRECT_REACHED: rr.TextLogLevel.INFO,
    EventKind.PREDICTOR: rr.TextLogLevel.INFO,
    EventKind.OUTCOME: rr.TextLogLevel.INFO,
}

Points = npt.NDArray[np.float32]
"""float32[n, 2]: x to the right and y downwards, in cells from the top left of a picture."""

Pictures = npt.NDArray[np.uint8]
"""uint8[n, H * W]: n pictures of one byte per cell, row 0 on top."""


def send_episode(
    recording: rr.RecordingStream, replay: Replay, root: str = "", name: str = ""
) -> None:
    """Send a whole episode, in blocks of steps, so that memory stays bounded.

    Args:
        recording: where to.
        replay: the episode; its steps are read.
        root: "" or "/..." without a slash at its end: two episodes in one recording need two
            roots, and then share the timeline.
        name: of the episode, where several are shown together.
    """
    columns = EpisodeColumns(recording, replay.header, root, name)
    height, width = replay.header.floor_plan.shape
    size = max(1, min(BLOCK_STEPS, BLOCK_BYTES // (_PICTURES * height * width)))
    for block in _blocks(replay.steps, size):
        columns.send(block)
    columns.send_marks(replay.marks)


def send_scores(recording: rr.RecordingStream, replay: Replay, root: str, name: str) -> None:
    """Send only the curves of an episode that is shown together with others."""
    for curve in COMPARED:
        values = replay.scores[curve]
        path = curve_path(curve, root)
        recording.log(path, rerun_static.compared_curve(root, name), static=True)
        index = rr.TimeColumn(TIMELINE, sequence=np.arange(len(values)))
        recording.send_columns(path, [index], rr.Scalars.columns(scalars=values))


class EpisodeColumns:
    """Sends the steps of one episode to a recording, block by block, in order.

    What belongs to the whole episode is sent at once. What does not change from one step to the
    next is sent only once: the viewer shows the newest value.
    """

    def __init__(
        self, recording: rr.RecordingStream, header: EpisodeHeader, root: str = "", name: str = ""
    ) -> None:
        self._recording = recording
        self._header = header
        self._root = root
        self._speaker = f"{name[:1]}: " if name else ""
        self._curves = COMPARED if name else curves(header)
        self._trail_end: Points = np.empty((0, 2), np.float32)
        self._shown: dict[Entity, npt.NDArray[np.uint8]] = {}
        self._state: State | None = None
        self._last_step = 0
        truth = as_pictures([cell_classes(header.floor_plan.cells)])[0]
        rerun_static.send_static(recording, header, root, name, truth)

    def send(self, steps: Sequence[Step]) -> None:
        """Send the next steps, each quantity as one column."""
        index = _index([step.index for step in steps])
        self._send_maps(steps)
        self._send_agent(index, steps)
        self._send_plan(index, steps)
        for curve in self._curves:
            values = [getattr(step.metrics, curve.value) for step in steps]
            path = curve_path(curve, self._root)
            self._recording.send_columns(path, [index], rr.Scalars.columns(scalars=values))
        self._send_profile(steps)
        self._send_state(steps)
        self._send_words(index, steps)
        self._last_step = steps[-1].index

    def send_marks(self, marks: Sequence[Mark]) -> None:
        """Send the marks, after all steps: each is cleared after its last step."""
        height = self._header.floor_plan.shape[0]
        colours = mark_colours(marks)
        for number, mark in enumerate(marks):
            if mark.first_step > self._last_step:
                continue  # it would make the timeline longer than the episode
            path = f"{Entity.MARKS.below(self._root)}/{number}"
            self._recording.log(
                path, rerun_static.mark_style(mark, colours[mark.name]), static=True
            )
            counts, at = [len(mark.cells)], [max(0, mark.first_step)]
            if mark.last_step < self._last_step:
                counts.append(0)
                at.append(mark.last_step + 1)
            boxes = rr.Boxes2D.columns(
                centers=centres(mark.cells, height),
                half_sizes=np.full((len(mark.cells), 2), 0.5, np.float32),
            )
            self._recording.send_columns(path, [_index(at)], boxes.partition(counts))

    def _send(self, entity: Entity, index: rr.TimeColumn, columns: rr.ComponentColumnList) -> None:
        self._recording.send_columns(entity.below(self._root), [index], columns)

    def _send_maps(self, steps: Sequence[Step]) -> None:
        truth = self._header.floor_plan.cells
        maps = {
            Entity.OBSERVED: [cell_classes(step.observed) for step in steps],
            Entity.FUSED: [cell_classes(step.fused) for step in steps],
        }
        if has_truth(self._header):
            maps[Entity.ERROR] = [
                error_classes(step.fused, truth, self._header.explorable) for step in steps
            ]
        for entity, classes in maps.items():
            pictures = as_pictures(classes)
            new = self._changed(entity, pictures)
            if len(new):
                index = _index([steps[i].index for i in new])
                columns = rr.SegmentationImage.columns(buffer=pictures[new])
                self._send(entity, index, columns)
        self._send_prediction(steps)

    def _send_prediction(self, steps: Sequence[Step]) -> None:
        """A step without a prediction clears the last one."""
        nothing = np.empty(0, np.uint8)
        shown = self._shown.get(Entity.PREDICTED, nothing)
        pictures, at, counts = [], [], []
        for step in steps:
            p_wall = step.p_wall
            picture = nothing if p_wall is None else display_probability(p_wall)[::-1].ravel()
            if not np.array_equal(picture, shown):
                at.append(step.index)
                counts.append(int(picture.size > 0))
                pictures += [picture] * counts[-1]
            shown = picture
        self._shown[Entity.PREDICTED] = shown
        if at:
            shape = (len(pictures), self._header.floor_plan.cells.size)
            buffer = np.array(pictures, np.uint8).reshape(shape)
            columns = rr.DepthImage.columns(buffer=buffer).partition(counts)
            self._send(Entity.PREDICTED, _index(at), columns)

    def _changed(self, entity: Entity, pictures: Pictures) -> npt.NDArray[np.intp]:
        """Which of the pictures differ from the one before."""
        changed = np.empty(len(pictures), np.bool_)
        before = self._shown.get(entity)
        changed[0] = before is None or (pictures[0] != before).any()
        changed[1:] = (pictures[1:] != pictures[:-1]).any(axis=1)
        self._shown[entity] = pictures[-1].copy()
        return np.flatnonzero(changed)

    def _send_agent(self, index: rr.TimeColumn, steps: Sequence[Step]) -> None:
        height = self._header.floor_plan.shape[0]
        agents = centres(np.array([step.agent for step in steps]), height)
        self._send(Entity.AGENT, index, rr.Points2D.columns(positions=agents))

        poses = np.concatenate([self._trail_end, agents])
        moves = np.stack([poses[:-1], poses[1:]], axis=1)
        first = [0] * (len(steps) - len(moves))  # the first step has no move
        trail = rr.LineStrips2D.columns(strips=moves).partition([*first, *[1] * len(moves)])
        self._send(Entity.TRAIL, index, trail)
        self._trail_end = agents[-1:]

        rays = [rays_of(step, self._header) for step in steps]
        ends = centres(np.concatenate([ray.ends for ray in rays]), height)
        counts = [len(ray.ends) for ray in rays]
        strips = np.stack([np.repeat(agents, counts, axis=0), ends], axis=1)
        columns = rr.LineStrips2D.columns(strips=strips).partition(counts)
        self._send(Entity.RAYS, index, columns)
        hit = np.concatenate([ray.hit for ray in rays])
        columns = rr.Points2D.columns(positions=ends[hit])
        self._send(Entity.HITS, index, columns.partition([int(ray.hit.sum()) for ray in rays]))

    def _send_plan(self, index: rr.TimeColumn, steps: Sequence[Step]) -> None:
        height = self._header.floor_plan.shape[0]
        frontier = centres(np.concatenate([step.frontier for step in steps]), height)
        columns = rr.Points2D.columns(positions=frontier)
        columns = columns.partition([len(step.frontier) for step in steps])
        self._send(Entity.FRONTIER, index, columns)

        decisions = [step.decision for step in steps]
        decided = [int(decision is not None) for decision in decisions]
        paths = [centres(decision.path, height) for decision in decisions if decision]
        strips = rr.LineStrips2D.columns(strips=paths).partition(decided)
        self._send(Entity.PATH, index, strips)
        targets = [decision.chosen for decision in decisions if decision]
        self._send_candidates(Entity.TARGET, index, targets, decided)
        rivals = [decision.rivals if decision else () for decision in decisions]
        counts = [len(some) for some in rivals]
        self._send_candidates(Entity.RIVALS, index, [r for some in rivals for r in some], counts)

    def _send_candidates(
        self,
        entity: Entity,
        index: rr.TimeColumn,
        candidates: Sequence[Candidate],
        counts: Sequence[int],
    ) -> None:
        height = self._header.floor_plan.shape[0]
        cells = np.array([c.cell for c in candidates], np.int32).reshape(-1, 2)
        points = rr.Points2D.columns(
            positions=centres(cells, height),
            labels=[f"utility {three_digits(candidate.utility)}" for candidate in candidates],
        )
        self._send(entity, index, points.partition(counts))

    def _send_profile(self, steps: Sequence[Step]) -> None:
        times: list[tuple[int, StepProfile]] = [
            (step.index, step.profile) for step in steps if step.profile
        ]
        if not times:
            return
        index = _index([i for i, _ in times])
        stages = {s: [getattr(profile, s) / 1e6 for _, profile in times] for s in _STAGES}
        stages["total"] = np.sum(list(stages.values()), axis=0).tolist()
        for stage, values in stages.items():
            path = f"{Entity.STAGES.below(self._root)}/{stage}"
            self._recording.send_columns(path, [index], rr.Scalars.columns(scalars=values))

    def _send_state(self, steps: Sequence[Step]) -> None:
        at, changes = [], []
        for step in steps:
            state = state_of(step)
            if state is not self._state:
                at.append(step.index)
                changes.append(str(state))
            self._state = state
        if at:
            self._send(Entity.STATE, _index(at), rr.StateChange.columns(state=changes))

    def _send_words(self, index: rr.TimeColumn, steps: Sequence[Step]) -> None:
        texts = [decision_document(step) for step in steps]
        self._send(Entity.DECISION, index, rr.TextDocument.columns(text=texts))
        events = [(step.index, event) for step in steps for event in step.events]
        if events:
            columns = rr.TextLog.columns(
                text=[self._speaker + event_words(event) for _, event in events],
                level=[_EVENT_LEVELS[event.kind] for _, event in events],
            )
            self._send(Entity.EVENTS, _index([i for i, _ in events]), columns)


def _index(steps: Sequence[int]) -> rr.TimeColumn:
    return rr.TimeColumn(TIMELINE, sequence=steps)


def as_pictures(grids: Sequence[npt.NDArray[np.uint8]]) -> Pictures:
    """uint8[n, H * W]: grids uint8[H, W] as images, whose row 0 is on top.

    With `centres`, the one place where y is flipped: row r of a grid of height H is row H - 1 - r
    of its picture.
    """
    return np.stack([grid[::-1].ravel() for grid in grids])


def centres(cells: npt.NDArray[np.integer], height: int) -> Points:
    """float32[n, 2]: where the centres of cells, (row, col)[n, 2], lie in a picture."""
    rows, cols = cells[:, 0], cells[:, 1]
    return np.stack([cols + 0.5, height - 1 - rows + 0.5], axis=1).astype(np.float32)


def decision_document(step: Step) -> str:
    """The decision of a step in Markdown: a sentence, and the best candidates."""
    lines = [f"**Step {step.index}: {state_of(step)}**", "", markdown(decision_words(step))]
    decision = step.decision
    if decision is not None and decision.rivals:
        lines += ["", "| (row, col) | utility | gain | cells away |", "|---|---|---|---|"]
        for mark, candidate in zip(
            ["**", *[""] * len(decision.rivals)], [decision.chosen, *decision.rivals], strict=True
        ):
            row, col = candidate.cell
            lines.append(
                f"| {mark}({row}, {col}){mark} | {three_digits(candidate.utility)} | "
                f"{candidate.reward:.1f} | {candidate.cost:.1f} |"
            )
    return "\n".join(lines)


def _blocks(steps: Iterable[Step], size: int) -> Iterator[list[Step]]:
    iterator = iter(steps)
    while block := list(islice(iterator, size)):
        yield block
