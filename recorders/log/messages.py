"""A step to and from ROS 2 messages: pure functions, topic by topic (design, "The log").

Everything is in frame ``map``, except the scan, which is in ``base_link``: the centre of the
agent's cell. The sensor is fixed to the map frame, so the yaw between the two is always 0.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Mapping, Sequence
from enum import StrEnum
from operator import attrgetter
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from mapreplay.errors import LogError
from mapreplay.floorplan import FloorPlan
from mapreplay.grid import FREE, OCCUPIED, UNKNOWN, Cell, Grid, Origin, Quantized, check_grid
from mapreplay.mapping import dequantize
from mapreplay.recorders.log import cdr
from mapreplay.recorders.log.limits import MAX_STEPS, check_count
from mapreplay.sensor import Hits, Sensor, hits_from_ranges, ranges
from mapreplay.step import (
    FIRST_STAMP_NS,
    STEP_NS,
    Candidate,
    Cells,
    Decision,
    EpisodeHeader,
    Event,
    EventKind,
    Mode,
    Outcome,
    Step,
    StepMetrics,
    StepProfile,
)


class Topic(StrEnum):
    """The topics of a log."""

    TRUTH = "/map/truth"
    TF = "/tf"
    POSE = "/pose"
    SCAN = "/scan"
    OBSERVED = "/map/observed"
    P_WALL = "/map/p_wall"
    PREDICTED = "/map/predicted"
    FUSED = "/map/fused"
    FRONTIER = "/frontier"
    PLAN = "/plan"
    DECISION = "/decision"
    EVENTS = "/events"
    PROFILE = "/profile"
    METRICS = "/metrics"
    """The last message of a step: with it the step is complete."""

    @property
    def type_name(self) -> str:
        """The type of its messages."""
        return _TYPES[self]


_TYPES: Final = {
    Topic.TRUTH: "nav_msgs/msg/OccupancyGrid",
    Topic.TF: "tf2_msgs/msg/TFMessage",
    Topic.POSE: "geometry_msgs/msg/PoseStamped",
    Topic.SCAN: "sensor_msgs/msg/LaserScan",
    Topic.OBSERVED: "nav_msgs/msg/OccupancyGrid",
    Topic.P_WALL: "foxglove_msgs/msg/Grid",
    Topic.PREDICTED: "nav_msgs/msg/OccupancyGrid",
    Topic.FUSED: "nav_msgs/msg/OccupancyGrid",
    Topic.FRONTIER: "nav_msgs/msg/GridCells",
    Topic.PLAN: "nav_msgs/msg/Path",
    Topic.DECISION: "mapreplay_msgs/msg/Decision",
    Topic.EVENTS: "rcl_interfaces/msg/Log",
    Topic.PROFILE: "mapreplay_msgs/msg/StepProfile",
    Topic.METRICS: "mapreplay_msgs/msg/StepMetrics",
}


class Encoded(NamedTuple):
    """A message as it is written."""

    topic: Topic
    data: bytes


Messages = Mapping[str, Sequence[cdr.Buffer]]
"""The messages of one step, by topic."""

_PACKED_TYPES: Final[dict[int, np.dtype[Any]]] = {
    1: np.dtype("<u1"),
    3: np.dtype("<u2"),
    7: np.dtype("<f4"),
}
"""What a PackedElementField's type means, of those that a prediction may have."""

_STAMP: Final = struct.Struct("<iI")
_LEVELS: Final = {EventKind.SEALED_IN: 30}
_INFO: Final = 20
_scores_of: Final = attrgetter(*StepMetrics.names())
_times_of: Final = attrgetter(*StepProfile.__dataclass_fields__)


def encode_truth(plan: FloorPlan) -> Encoded:
    """The floor plan, stamped as the first step.

    Its resolution is a float32 in this message; the exact one is in the metadata.
    """
    return Encoded(Topic.TRUTH, _grid(plan.cells, plan, _stamp(FIRST_STAMP_NS)))


def decode_truth(data: cdr.Buffer, plan_id: str, resolution: float) -> FloorPlan:
    """The inverse of `encode_truth`.

    Raises:
        FloorPlanError: the cells, the resolution or the id make no floor plan.
        LogError: its cells cannot be told from their metres.
        ValueError, struct.error: the bytes are not an OccupancyGrid.
    """
    info, cells = cdr.unpack_grid(data)
    has_truth = bool((cells != UNKNOWN).any())
    plan = FloorPlan(plan_id, cells, resolution, Origin(info.x, info.y), has_truth)
    check_geometry(plan)
    return plan


def encode_step(step: Step, header: EpisodeHeader) -> Iterator[Encoded]:
    """All messages of a step, the metrics last; what a step does not have has no message."""
    plan, stamp = header.floor_plan, _stamp(step.stamp_ns)
    x, y = _centre(step.agent, plan)
    yield Encoded(Topic.TF, cdr.pack_transform(stamp, x, y))
    yield Encoded(Topic.POSE, cdr.pack_pose(stamp, x, y))
    if len(step.hits):
        scan = _scan(step.hits, header.sensor, plan.resolution)
        yield Encoded(Topic.SCAN, cdr.pack_scan(stamp, scan))
    yield Encoded(Topic.OBSERVED, _grid(step.observed, plan, stamp))
    if step.p_wall is not None:
        yield Encoded(Topic.P_WALL, _packed_grid(step.p_wall, plan, stamp))
        yield Encoded(Topic.PREDICTED, _grid(_preview(step.p_wall), plan, stamp))
    yield Encoded(Topic.FUSED, _grid(step.fused, plan, stamp))
    frontier = _points(step.frontier, plan)
    yield Encoded(Topic.FRONTIER, cdr.pack_grid_cells(stamp, plan.resolution, frontier))
    if step.decision is not None:
        yield Encoded(Topic.PLAN, cdr.pack_path(stamp, _points(step.decision.path, plan)))
        yield Encoded(Topic.DECISION, cdr.pack_decision(stamp, _choice(step.decision)))
    for event in step.events:
        line = cdr.LogLine(_LEVELS.get(event.kind, _INFO), f"mapreplay.{event.kind}", event.text)
        yield Encoded(Topic.EVENTS, cdr.pack_log(stamp, line))
    if step.profile is not None:
        yield Encoded(Topic.PROFILE, cdr.pack_profile(stamp, _times_of(step.profile)))
    outcome = str(step.outcome or "")
    yield Encoded(Topic.METRICS, cdr.pack_metrics(stamp, outcome, _scores_of(step.metrics)))


def decode_step(messages: Messages, index: int, header: EpisodeHeader) -> Step:
    """The inverse of `encode_step`.

    Arrays own their memory. Topics that are not ours are ignored. Whatever a log says, the step
    is one that all else can work with: cells lie in the map, maps have no other values than they
    may have, probabilities are some, paths have a move, and no number is absurd. Whether it is
    true is for `mapreplay.analysis.verification` to say.

    Raises:
        LogError: a message is missing.
        ValueError, struct.error: a message is not what its topic says, or does not fit the
            floor plan.
    """
    try:
        return _decode_step(messages, index, header)
    except ValueError as error:
        raise ValueError(f"step {index}: {error}") from None


def _decode_step(messages: Messages, index: int, header: EpisodeHeader) -> Step:
    plan = header.floor_plan
    x, y = cdr.unpack_pose(_message(messages, Topic.POSE))
    row, col = _cells_in(np.array([[x, y, 0.0]]), plan)[0].tolist()
    hits = np.empty(0, np.int16)
    if Topic.SCAN in messages:
        metres = cdr.unpack_ranges(messages[Topic.SCAN][0])
        hits = _hits(metres, header.sensor, plan.resolution)
    outcome, metrics = decode_metrics(messages)
    decision = profile = None
    if Topic.DECISION in messages:
        path = cdr.unpack_path(_message(messages, Topic.PLAN))
        choice = cdr.unpack_decision(messages[Topic.DECISION][0])
        decision = _decision(choice, _cells_in(path, plan), plan)
    if Topic.PROFILE in messages:
        profile = StepProfile(*cdr.unpack_profile(messages[Topic.PROFILE][0]))
    return Step(
        index=index,
        agent=Cell(row, col),
        hits=hits,
        observed=decode_map(messages, Topic.OBSERVED, plan),
        p_wall=decode_prediction(messages, plan),
        fused=decode_map(messages, Topic.FUSED, plan),
        frontier=_cells_in(cdr.unpack_grid_cells(_message(messages, Topic.FRONTIER)), plan),
        decision=decision,
        metrics=_checked(metrics, index, plan),
        events=tuple(_event(cdr.unpack_log(data)) for data in messages.get(Topic.EVENTS, ())),
        outcome=outcome,
        profile=profile,
    )


def decode_metrics(messages: Messages) -> tuple[Outcome | None, StepMetrics]:
    """How the episode ended with a step, if it did, and its scores, whatever they are.

    Raises:
        LogError: there is no such message.
        ValueError, struct.error: it is not what it should be.
    """
    data = _message(messages, Topic.METRICS)
    outcome, scores = cdr.unpack_metrics(data, len(StepMetrics.names()))
    return Outcome(outcome) if outcome else None, StepMetrics(*scores)


def _message(messages: Messages, topic: Topic) -> cdr.Buffer:
    if topic not in messages:
        raise missing(topic)
    return messages[topic][0]


def missing(topic: str) -> LogError:
    """What is said of a log in which there are no messages on a topic that a step needs."""
    return LogError(
        f"messages on {topic} are missing, which another tool may have left out; a log cannot be "
        "read without them"
    )


def stamp_ns_of(topic: Topic, data: cdr.Buffer) -> int:
    """The simulated time that a message on `topic` is stamped with, in nanoseconds.

    Raises:
        struct.error: the message is too short.
    """
    # A TFMessage begins with the number of its transforms.
    stamp = cdr.Stamp(*_STAMP.unpack_from(data, 8 if topic is Topic.TF else 4))
    return stamp.sec * 1_000_000_000 + stamp.nanosec


def step_of(topic: Topic, data: cdr.Buffer) -> int | None:
    """The step that a message on `topic` is stamped with; None if its time is no step's.

    Raises:
        struct.error: the message is too short.
    """
    step, rest = divmod(stamp_ns_of(topic, data) - FIRST_STAMP_NS, STEP_NS)
    return step if rest == 0 and 0 <= step < MAX_STEPS else None


def decode_map(messages: Messages, topic: Topic, plan: FloorPlan) -> Grid:
    """int8[H, W]: the map on `topic`; it owns its memory.

    Raises:
        LogError: there is none.
        ValueError, struct.error: it is no map, does not fit the floor plan, or has a cell that is
            not -1, 0 or 100.
    """
    _, cells = cdr.unpack_grid(_message(messages, topic))
    if cells.shape != plan.shape:
        raise ValueError(f"a map of {cells.shape} cells on a floor plan of {plan.shape}")
    if not _LEGAL.take(cells.view(np.uint8)).all():
        raise ValueError(f"{topic}: {check_grid(cells)}")
    return cells


def decode_prediction(messages: Messages, plan: FloorPlan) -> Quantized | None:
    """The prediction as it was used; it owns its memory. None if the step has none.

    Raises:
        KeyError: its cells are of an unknown type.
        ValueError, struct.error: it is no prediction, does not fit the floor plan, or has a cell
            that is no probability.
    """
    if Topic.P_WALL not in messages:
        return None
    grid = cdr.unpack_packed_grid(messages[Topic.P_WALL][0])
    packed = _PACKED_TYPES[grid.field_type]
    cells: npt.NDArray[Any] = grid.data.view(packed).reshape(plan.shape)
    # Of a NaN both are false.
    if packed.kind == "f" and not (cells.min() >= 0 and cells.max() <= 1):
        row, col = np.argwhere(~((cells >= 0) & (cells <= 1)))[0].tolist()
        value = cells[row, col].item()
        raise ValueError(f"{Topic.P_WALL}: {value} at cell ({row}, {col}) is no probability")
    return cells.astype(packed.newbyteorder("="), copy=False)


def check_geometry(plan: FloorPlan) -> None:
    """Make sure that every cell of `plan` can be told from its metres.

    Raises:
        LogError: cells are too small for the distance of the origin, or absurdly large.
    """
    side = np.arange(max(plan.shape), dtype=np.int32)
    cells = np.stack([side, side], axis=1)
    if not 1e-6 <= plan.resolution <= 1e6 or not np.array_equal(
        _cells_at(_points(cells, plan), plan), cells
    ):
        raise LogError(
            f"floor plan {plan.id}: cells of {plan.resolution} m at {tuple(plan.origin)} cannot "
            "be logged in metres; choose another origin or resolution"
        )


def _stamp(nanoseconds: int) -> cdr.Stamp:
    return cdr.Stamp(*divmod(nanoseconds, 1_000_000_000))


# Cells and metres


def _centre(cell: Cell, plan: FloorPlan) -> tuple[float, float]:
    resolution = plan.resolution
    return (
        plan.origin.x + (cell.col + 0.5) * resolution,
        plan.origin.y + (cell.row + 0.5) * resolution,
    )


def _points(cells: Cells, plan: FloorPlan) -> cdr.Points:
    points = np.zeros((len(cells), 3))
    points[:, 0] = plan.origin.x + (cells[:, 1] + 0.5) * plan.resolution
    points[:, 1] = plan.origin.y + (cells[:, 0] + 0.5) * plan.resolution
    return points


def _cells_at(points: cdr.Points, plan: FloorPlan) -> npt.NDArray[np.float64]:
    """float64[n, 2]: the cells whose centres are at `points`, wherever that is."""
    metres = points[:, 1::-1] - (plan.origin.y, plan.origin.x)
    cells: npt.NDArray[np.float64] = np.rint(metres / plan.resolution - 0.5)
    return cells


def _cells_in(points: cdr.Points, plan: FloorPlan) -> Cells:
    """int32[n, 2]: the cells whose centres are at `points`.

    Raises:
        ValueError: they are not in the map, or are more than it has cells.
    """
    check_count(f"cells in a map of {plan.cells.size}", len(points), plan.cells.size)
    with np.errstate(invalid="ignore", over="ignore"):
        cells = _cells_at(points, plan)
    if not ((cells >= 0) & (cells < plan.shape)).all():  # also if one is not a number
        raise ValueError("a cell outside of the map")
    return cells.astype(np.int32)


def _scan(hits: Hits, sensor: Sensor, resolution: float) -> cdr.Scan:
    increment = 2 * math.pi / sensor.rays
    return cdr.Scan(
        angle_min=0.0,
        angle_max=increment * (sensor.rays - 1),
        angle_increment=increment,
        time_increment=0.0,
        scan_time=STEP_NS / 1e9,
        range_min=0.0,
        # The centre of the last cell of a ray may lie up to .71 cells further than `reach`.
        range_max=(sensor.reach + 1) * resolution,
        ranges=ranges(hits, sensor, resolution),
    )


def _hits(metres: npt.NDArray[np.float32], sensor: Sensor, resolution: float) -> Hits:
    """What the rays of a scan hit.

    Raises:
        ValueError: these are not the ranges of that sensor.
    """
    if metres.shape != (sensor.rays,):
        raise ValueError(f"{Topic.SCAN}: {len(metres)} ranges of {sensor.rays} rays")
    # inf is a ray that hit nothing.
    if not ((metres > 0) & ((metres <= (sensor.reach + 1) * resolution) | np.isinf(metres))).all():
        raise ValueError(f"{Topic.SCAN}: a range that no ray of that sensor has")
    return hits_from_ranges(metres, sensor, resolution)


# Maps


_LEGAL: Final = np.isin(np.arange(256, dtype=np.uint8).view(np.int8), (UNKNOWN, FREE, OCCUPIED))
"""bool[256]: which bytes a cell of a map may be."""


def _info(plan: FloorPlan) -> cdr.GridInfo:
    height, width = plan.shape
    return cdr.GridInfo(plan.resolution, width, height, *plan.origin)


def _grid(cells: Grid, plan: FloorPlan, stamp: cdr.Stamp) -> bytes:
    return cdr.pack_grid(stamp, _stamp(FIRST_STAMP_NS), _info(plan), cells)


def _packed_grid(p_wall: Quantized, plan: FloorPlan, stamp: cdr.Stamp) -> bytes:
    (code,) = [code for code, dtype in _PACKED_TYPES.items() if dtype == p_wall.dtype]
    return cdr.pack_packed_grid(stamp, _info(plan), code, p_wall.astype(_PACKED_TYPES[code]))


def _preview(p_wall: Quantized) -> Grid:
    """int8[H, W]: 0, 10, ..., 100 percent.

    Percents would take nearly as much of the file as the prediction itself.
    """
    if p_wall.dtype == np.uint8:
        return _PREVIEW_OF_UINT8.take(p_wall.view(np.uint8))
    return _in_tenths(p_wall)


def _in_tenths(p_wall: Quantized) -> Grid:
    return (10 * np.rint(10 * dequantize(p_wall))).astype(np.int8)


_PREVIEW_OF_UINT8: Final = _in_tenths(np.arange(256, dtype=np.uint8))


# What was decided


def _choice(decision: Decision) -> cdr.Choice:
    return cdr.Choice(
        mode=str(decision.mode),
        chosen=_rated(decision.chosen),
        rivals=[_rated(rival) for rival in decision.rivals],
        is_random=decision.random_draw is not None,
        random_draw=decision.random_draw or 0,
    )


def _decision(choice: cdr.Choice, path: Cells, plan: FloorPlan) -> Decision:
    if len(path) < 2:
        raise ValueError(f"{Topic.PLAN}: a path of {len(path)} cells; one has 2 or more")
    check_count("rivals of a target", len(choice.rivals), plan.cells.size)
    return Decision(
        chosen=_candidate(choice.chosen, plan),
        path=path,
        mode=Mode(choice.mode),
        rivals=tuple(_candidate(rival, plan) for rival in choice.rivals),
        random_draw=choice.random_draw if choice.is_random else None,
    )


def _rated(c: Candidate) -> cdr.Rated:
    return cdr.Rated(*c.cell, c.utility, c.reward, c.straight, c.diagonal, c.cost)


def _candidate(rated: cdr.Rated, plan: FloorPlan) -> Candidate:
    row, col, utility, reward, straight, diagonal, _ = rated
    height, width = plan.shape
    if not (0 <= row < height and 0 <= col < width):
        raise ValueError(f"{Topic.DECISION}: a target at ({row}, {col}), outside of the map")
    if not (0 <= straight < plan.cells.size and 0 <= diagonal < plan.cells.size):
        raise ValueError(f"{Topic.DECISION}: a path of {straight} straight, {diagonal} diagonal")
    return Candidate(Cell(row, col), utility, reward, straight, diagonal)


def _checked(metrics: StepMetrics, index: int, plan: FloorPlan) -> StepMetrics:
    check_scores(np.array(_scores_of(metrics))[:, None], index, plan)
    return metrics


def check_scores(scores: npt.NDArray[np.float64], steps: int, plan: FloorPlan) -> None:
    """Whether metrics are numbers that metrics can be.

    Args:
        scores: float64[metrics, n], those of n steps in the order of `StepMetrics`; NaN where
            undefined.
        steps: Index of the last of them.
        plan: The floor plan.

    Raises:
        ValueError: one is not.
    """
    # The agent of an external simulator may jump through the map at each step.
    furthest = (steps + 1) * sum(plan.shape) * plan.resolution
    tops = np.where(_IS_LENGTH, furthest, np.where(_IS_LOSS, MAX_LOSS, 1.0))[:, None]
    wrong = ~((scores >= 0) & (scores <= tops)) & ~(np.isnan(scores) & ~_IS_LENGTH[:, None])
    if wrong.any():
        metric, step = np.argwhere(wrong)[0].tolist()
        value, name = scores[metric, step].item(), StepMetrics.names()[metric]
        raise ValueError(f"{Topic.METRICS}: {name} is {value}, which it cannot be")


MAX_LOSS: Final = 1000.0
"""More than any log loss: predictions are clipped at half a quantum."""
_IS_LENGTH: Final = np.array([name == "path_length" for name in StepMetrics.names()])
_IS_LOSS: Final = np.array([name.startswith("log_loss") for name in StepMetrics.names()])


# What happened


def _event(line: cdr.LogLine) -> Event:
    return Event(EventKind(line.name.removeprefix("mapreplay.")), line.text)
