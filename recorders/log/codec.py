"""A Step as the messages of a log, and back: topic by topic, what packs next to what unpacks.

Everything is in frame ``map``, except the scan, which is in ``base_link``: the centre of the
agent's cell. The sensor is fixed to the map frame, so the yaw between the two is always 0. The
fields are those of the definitions that a log carries. Sizes and frame names of ours never change,
so nearly all of a message is one `struct`, in which ``x`` is padding.

rosbags packs the same bytes, and the tests compare each with it. On the samples (64 x 64 cells) it
takes this many times our CPU time: tf 4.5, pose 4.1, scan 1.5, maps 4.5, prediction 4.0, frontier
5.7, plan 6.0, decision 1.2, metrics 2.2; 3.4 for a step, and 2 to 27 to unpack. Nor does it say
which frame a message is in, or whether a string ends. So we pack by hand.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Mapping, Sequence
from operator import attrgetter
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from mapreplay.floorplan import FloorPlan
from mapreplay.grid import FREE, OCCUPIED, UNKNOWN, Cell, Grid, Origin, Quantized, check_grid
from mapreplay.mapping import dequantize
from mapreplay.recorders.log.cdr import (
    BASE_LINK,
    HEADER_SIZE,
    UNFRAMED,
    Buffer,
    Packer,
    Unpacker,
    array_of,
    fields_of,
    header_at,
)
from mapreplay.recorders.log.geometry import cell_at, cells_at, centre, centres, check_geometry
from mapreplay.recorders.log.limits import check_count
from mapreplay.recorders.log.topics import Topic, missing
from mapreplay.sensor import Hits, hits_from_ranges, ranges
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


class Encoded(NamedTuple):
    """A message as it is written."""

    topic: Topic
    data: bytes


Messages = Mapping[str, Sequence[Buffer]]
"""The messages of one step, by topic."""


def encode_step(step: Step, header: EpisodeHeader) -> Iterator[Encoded]:
    """All messages of a step, the metrics last; what a step does not have has no message."""
    plan, begin = header.floor_plan, header_at(step.stamp_ns)
    yield Encoded(Topic.TF, _pack_transform(begin, step.agent, plan))
    yield Encoded(Topic.POSE, _pack_pose(begin, step.agent, plan))
    if len(step.hits):
        yield Encoded(Topic.SCAN, _pack_scan(begin, step.hits, header))
    yield Encoded(Topic.OBSERVED, _pack_map(begin, step.observed, plan))
    if step.p_wall is not None:
        yield Encoded(Topic.P_WALL, _pack_prediction(begin, step.p_wall, plan))
        yield Encoded(Topic.PREDICTED, _pack_map(begin, _preview(step.p_wall), plan))
    yield Encoded(Topic.FUSED, _pack_map(begin, step.fused, plan))
    yield Encoded(Topic.FRONTIER, _pack_frontier(begin, step.frontier, plan))
    if step.decision is not None:
        yield Encoded(Topic.PLAN, _pack_path(begin, step.decision.path, plan))
        yield Encoded(Topic.DECISION, _pack_decision(begin, step.decision))
    for event in step.events:
        yield Encoded(Topic.EVENTS, _pack_event(begin, event))
    if step.profile is not None:
        yield Encoded(Topic.PROFILE, begin + _PROFILE.pack(*_times_of(step.profile)))
    yield Encoded(Topic.METRICS, _pack_metrics(begin, step.outcome, step.metrics))


def decode_step(messages: Messages, index: int, header: EpisodeHeader) -> Step:
    """The inverse of `encode_step`.

    Arrays own their memory. Topics that are not ours are ignored. Whatever a log says, the step
    is one that all else can work with: cells lie in the map, maps have no other values than they
    may have, probabilities are some, paths have a move, and no number is absurd. Whether it is
    true is for `mapreplay.analysis.verification` to say.

    Raises:
        LogError: a message is missing.
        ValueError: a message is not what its topic says, or does not fit the floor plan.
    """
    plan = header.floor_plan
    try:
        agent = _unpack_pose(_message(messages, Topic.POSE), plan)
        hits = np.empty(0, np.int16)
        if Topic.SCAN in messages:
            hits = _unpack_scan(messages[Topic.SCAN][0], header)
        outcome, metrics = decode_metrics(messages)
        decision = profile = None
        if Topic.DECISION in messages:
            path = _unpack_path(_message(messages, Topic.PLAN), plan)
            decision = _unpack_decision(messages[Topic.DECISION][0], path, plan)
        if Topic.PROFILE in messages:
            profile = StepProfile(*fields_of(messages[Topic.PROFILE][0], _PROFILE))
        step = Step(
            index=index,
            agent=agent,
            hits=hits,
            observed=decode_map(messages, Topic.OBSERVED, plan),
            p_wall=decode_prediction(messages, plan),
            fused=decode_map(messages, Topic.FUSED, plan),
            frontier=_unpack_frontier(_message(messages, Topic.FRONTIER), plan),
            decision=decision,
            metrics=metrics,
            events=decode_events(messages),
            outcome=outcome,
            profile=profile,
        )
        check_scores(np.array(_scores_of(metrics))[:, None], index, plan)
    except struct.error:
        raise ValueError(f"step {index}: a message ends too soon") from None
    except ValueError as error:
        raise ValueError(f"step {index}: {error}") from None
    return step


def _message(messages: Messages, topic: Topic) -> Buffer:
    if topic not in messages:
        raise missing(topic)
    return messages[topic][0]


# /tf and /pose: the agent

_NO_TURN: Final = (0.0, 0.0, 0.0, 1.0)
_ONE: Final = struct.pack("<I", 1)
_TRANSFORM: Final = struct.Struct("<14s6x7d")
_POSE: Final = struct.Struct("<7d")


def _pack_transform(begin: bytes, agent: Cell, plan: FloorPlan) -> bytes:
    """tf2_msgs/TFMessage: ``base_link`` in ``map``, not turned. Nothing is read from it."""
    x, y = centre(agent, plan)
    return begin[:4] + _ONE + begin[4:] + _TRANSFORM.pack(BASE_LINK, x, y, 0.0, *_NO_TURN)


def _pack_pose(begin: bytes, agent: Cell, plan: FloorPlan) -> bytes:
    """geometry_msgs/PoseStamped in ``map``, not turned."""
    return begin + _POSE.pack(*centre(agent, plan), 0.0, *_NO_TURN)


def _unpack_pose(data: Buffer, plan: FloorPlan) -> Cell:
    x, y, *_ = fields_of(data, _POSE)
    return cell_at(x, y, plan)


# /scan

_SCAN: Final = struct.Struct("<2x7fI")
_NO_INTENSITIES: Final = bytes(4)


def _pack_scan(begin: bytes, hits: Hits, header: EpisodeHeader) -> bytes:
    """sensor_msgs/LaserScan in ``base_link``: metres, infinite where nothing was hit."""
    sensor, resolution = header.sensor, header.floor_plan.resolution
    increment = 2 * math.pi / sensor.rays
    metres = ranges(hits, sensor, resolution)
    fixed = _SCAN.pack(
        0.0,
        increment * (sensor.rays - 1),
        increment,
        0.0,
        STEP_NS / 1e9,
        0.0,
        # The centre of the last cell of a ray may lie up to .71 cells further than `reach`.
        (sensor.reach + 1) * resolution,
        len(metres),
    )
    return begin[:UNFRAMED] + BASE_LINK + fixed + metres.astype("<f4").tobytes() + _NO_INTENSITIES


def _unpack_scan(data: Buffer, header: EpisodeHeader) -> Hits:
    """What the rays hit.

    Raises:
        ValueError: these are not the ranges of the sensor.
    """
    sensor, resolution = header.sensor, header.floor_plan.resolution
    *_, count = fields_of(data, _SCAN, BASE_LINK)
    metres = array_of(data, "<f4", count, UNFRAMED + len(BASE_LINK) + _SCAN.size)
    if metres.shape != (sensor.rays,):
        raise ValueError(f"{Topic.SCAN}: {len(metres)} ranges of {sensor.rays} rays")
    # inf is a ray that hit nothing.
    if not ((metres > 0) & ((metres <= (sensor.reach + 1) * resolution) | np.isinf(metres))).all():
        raise ValueError(f"{Topic.SCAN}: a range that no ray of that sensor has")
    return hits_from_ranges(metres, sensor, resolution)


# /map/truth, /map/observed, /map/fused, /map/predicted

_MAP: Final = struct.Struct("<iIfII4x7dI")
_CELLS: Final = HEADER_SIZE + _MAP.size
"""Where the cells begin."""
_LOAD_TIME: Final = divmod(FIRST_STAMP_NS, 1_000_000_000)
_LEGAL: Final = np.isin(np.arange(256, dtype=np.uint8).view(np.int8), (UNKNOWN, FREE, OCCUPIED))
"""bool[256]: which bytes a cell of a map may be."""


def _pack_map(begin: bytes, cells: Grid, plan: FloorPlan) -> bytes:
    """nav_msgs/OccupancyGrid in ``map``."""
    (height, width), (x, y) = plan.shape, plan.origin
    fixed = _MAP.pack(*_LOAD_TIME, plan.resolution, width, height, x, y, 0.0, *_NO_TURN, cells.size)
    return begin + fixed + cells.tobytes()


def _unpack_map(data: Buffer) -> tuple[Origin, Grid]:
    """The lower left corner, and int8[H, W], whatever is in them."""
    _, _, _, width, height, x, y, *_, count = fields_of(data, _MAP)
    return Origin(x, y), array_of(data, "i1", count, _CELLS).reshape(height, width)


def decode_map(messages: Messages, topic: Topic, plan: FloorPlan) -> Grid:
    """int8[H, W]: the map on `topic`; it owns its memory.

    Raises:
        LogError: there is none.
        ValueError, struct.error: it is no map, does not fit the floor plan, or has a cell that is
            not -1, 0 or 100.
    """
    _, cells = _unpack_map(_message(messages, topic))
    if cells.shape != plan.shape:
        raise ValueError(f"a map of {cells.shape} cells on a floor plan of {plan.shape}")
    if not _LEGAL.take(cells.view(np.uint8)).all():
        raise ValueError(f"{topic}: {check_grid(cells)}")
    return cells


def encode_truth(plan: FloorPlan) -> Encoded:
    """The floor plan, stamped as the first step.

    Its resolution is a float32 in this message; the exact one is in the metadata.
    """
    return Encoded(Topic.TRUTH, _pack_map(header_at(FIRST_STAMP_NS), plan.cells, plan))


def decode_truth(data: Buffer, plan_id: str, resolution: float) -> FloorPlan:
    """The inverse of `encode_truth`.

    Raises:
        FloorPlanError: the cells, the resolution or the id make no floor plan.
        LogError: its cells cannot be told from their metres.
        ValueError, struct.error: the bytes are not an OccupancyGrid.
    """
    origin, cells = _unpack_map(data)
    has_truth = bool((cells != UNKNOWN).any())
    plan = FloorPlan(plan_id, cells, resolution, origin, has_truth)
    check_geometry(plan)
    return plan


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


# /map/p_wall

_PREDICTION: Final = struct.Struct("<7dI4x2dIIII7sxIB3xI")
_ONE_FIELD: Final = (1, 7, b"p_wall\0")
_PACKED_TYPES: Final[dict[int, np.dtype[Any]]] = {
    1: np.dtype("<u1"),
    3: np.dtype("<u2"),
    7: np.dtype("<f4"),
}
"""What a PackedElementField's type means, of those that a prediction may have."""


def _pack_prediction(begin: bytes, p_wall: Quantized, plan: FloorPlan) -> bytes:
    """foxglove_msgs/Grid in ``map`` with the field ``p_wall``."""
    (code,) = [code for code, dtype in _PACKED_TYPES.items() if dtype == p_wall.dtype]
    (x, y), resolution, width, size = plan.origin, plan.resolution, plan.shape[1], p_wall.itemsize
    fixed = _PREDICTION.pack(
        x, y, 0.0, *_NO_TURN, width, resolution, resolution,
        width * size, size, *_ONE_FIELD, 0, code, p_wall.nbytes,
    )  # fmt: skip
    return begin + fixed + p_wall.astype(_PACKED_TYPES[code], copy=False).tobytes()


def decode_prediction(messages: Messages, plan: FloorPlan) -> Quantized | None:
    """The prediction as it was used; it owns its memory. None if the step has none.

    Raises:
        KeyError: its cells are of an unknown type.
        ValueError, struct.error: it is no prediction, does not fit the floor plan, or has a cell
            that is no probability.
    """
    if Topic.P_WALL not in messages:
        return None
    data = messages[Topic.P_WALL][0]
    *_, fields, length, name, _, code, size = fields_of(data, _PREDICTION)
    if (fields, length, name) != _ONE_FIELD:
        raise ValueError("a packed grid without the field p_wall")
    packed = _PACKED_TYPES[code]
    cells = (
        array_of(data, "u1", size, HEADER_SIZE + _PREDICTION.size).view(packed).reshape(plan.shape)
    )
    # Of a NaN both are false.
    if packed.kind == "f" and not (cells.min() >= 0 and cells.max() <= 1):
        row, col = np.argwhere(~((cells >= 0) & (cells <= 1)))[0].tolist()
        value = cells[row, col].item()
        raise ValueError(f"{Topic.P_WALL}: {value} at cell ({row}, {col}) is no probability")
    return cells.astype(packed.newbyteorder("="), copy=False)


# /frontier

_FRONTIER: Final = struct.Struct("<ffI")
_FIRST_POINT: Final = 36
"""Where the points begin: after the fixed part and 4 bytes of padding, if there are any."""


def _pack_frontier(begin: bytes, frontier: Cells, plan: FloorPlan) -> bytes:
    """nav_msgs/GridCells in ``map``."""
    fixed = begin + _FRONTIER.pack(plan.resolution, plan.resolution, len(frontier))
    if not len(frontier):
        return fixed
    return fixed + bytes(4) + centres(frontier, plan).astype("<f8", copy=False).tobytes()


def _unpack_frontier(data: Buffer, plan: FloorPlan) -> Cells:
    *_, count = fields_of(data, _FRONTIER)
    points = array_of(data, "<f8", 3 * count, _FIRST_POINT) if count else np.empty(0)
    return cells_at(points.reshape(-1, 3), plan)


# /plan

_PATH: Final = struct.Struct("<I")
_FIRST_POSE: Final = 28
"""Where the poses begin, if the padding of the first stood before its header."""
_POSES: Final = np.dtype([("header", "S16"), ("point", "<f8", 3), ("turn", "<f8", 4)])


def _pack_path(begin: bytes, path: Cells, plan: FloorPlan) -> bytes:
    """nav_msgs/Path in ``map``: poses that are not turned, all of the same stamp."""
    header = begin[4:]
    poses = np.empty(len(path), _POSES)
    poses["header"] = header
    poses["point"] = centres(path, plan)
    poses["turn"] = _NO_TURN
    # Only the first pose needs padding, and that comes after its header.
    return begin + _PATH.pack(len(path)) + header + bytes(4) + poses.tobytes()[len(header) :]


def _unpack_path(data: Buffer, plan: FloorPlan) -> Cells:
    """The cells, two or more.

    Raises:
        ValueError: they are fewer, or not in the map.
    """
    (count,) = fields_of(data, _PATH)
    if count < 2:
        raise ValueError(f"{Topic.PLAN}: a path of {count} cells; one has 2 or more")
    return cells_at(array_of(data, _POSES, count, _FIRST_POSE)["point"], plan)


# /decision

_CANDIDATE: Final = {0: struct.Struct("<iiddiid"), 4: struct.Struct("<ii4xddiid")}
"""A candidate by the position, modulo 8, where it begins: its float64 fields are aligned."""
_FLAG: Final = struct.Struct("<?")
_DRAW: Final = struct.Struct("<Q")


def _pack_decision(begin: bytes, decision: Decision) -> bytes:
    """mapreplay_msgs/Decision."""
    message, draw = Packer(begin), decision.random_draw
    message.text(decision.mode)
    _pack_candidate(message, decision.chosen)
    message.count(len(decision.rivals))
    for rival in decision.rivals:
        _pack_candidate(message, rival)
    message.add(1, _FLAG, draw is not None)
    message.add(8, _DRAW, draw or 0)
    return bytes(message.data)


def _unpack_decision(data: Buffer, path: Cells, plan: FloorPlan) -> Decision:
    """The decision for a `path`.

    Raises:
        ValueError: a target is not in the map, or a number is absurd.
    """
    message = Unpacker(data)
    mode, chosen = Mode(message.text()), _unpack_candidate(message, plan)
    count = message.count()
    check_count("rivals of a target", count, plan.cells.size)
    rivals = tuple(_unpack_candidate(message, plan) for _ in range(count))
    (by_chance,), (draw,) = message.take(1, _FLAG), message.take(8, _DRAW)
    return Decision(chosen, path, mode, rivals, draw if by_chance else None)


def _pack_candidate(message: Packer, c: Candidate) -> None:
    layout = _CANDIDATE[message.align(4)]
    message.add(4, layout, *c.cell, c.utility, c.reward, c.straight, c.diagonal, c.cost)


def _unpack_candidate(message: Unpacker, plan: FloorPlan) -> Candidate:
    layout = _CANDIDATE[message.align(4)]
    row, col, utility, reward, straight, diagonal, _ = message.take(4, layout)
    height, width = plan.shape
    if not (0 <= row < height and 0 <= col < width):
        raise ValueError(f"{Topic.DECISION}: a target at ({row}, {col}), outside of the map")
    if not (0 <= straight < plan.cells.size and 0 <= diagonal < plan.cells.size):
        raise ValueError(f"{Topic.DECISION}: a path of {straight} straight, {diagonal} diagonal")
    return Candidate(Cell(row, col), utility, reward, straight, diagonal)


# /events

_LEVEL: Final = struct.Struct("<B")
_LEVELS: Final = {EventKind.SEALED_IN: 30}
_INFO: Final = 20


def _pack_event(begin: bytes, event: Event) -> bytes:
    """rcl_interfaces/Log, without the place in a source file."""
    message = Packer(begin[:UNFRAMED])
    message.add(1, _LEVEL, _LEVELS.get(event.kind, _INFO))
    for text in (f"mapreplay.{event.kind}", event.text, "", ""):
        message.text(text)
    message.count(0)  # the line
    return bytes(message.data)


def decode_events(messages: Messages) -> tuple[Event, ...]:
    """What happened at a step.

    Raises:
        ValueError, struct.error: a message is not what it should be.
    """
    return tuple(_unpack_event(data) for data in messages.get(Topic.EVENTS, ()))


def _unpack_event(data: Buffer) -> Event:
    message = Unpacker(data, framed=False)
    message.take(1, _LEVEL)
    return Event(EventKind(message.text().removeprefix("mapreplay.")), message.text())


# /profile

_PROFILE: Final = struct.Struct("<5q")
"""mapreplay_msgs/StepProfile, after its header."""
_times_of: Final = attrgetter(*StepProfile.__dataclass_fields__)


# /metrics

_SCORES: Final = struct.Struct(f"<{len(StepMetrics.names())}d")
_scores_of: Final = attrgetter(*StepMetrics.names())


def _pack_metrics(begin: bytes, outcome: Outcome | None, metrics: StepMetrics) -> bytes:
    """mapreplay_msgs/StepMetrics."""
    message = Packer(begin)
    message.text(outcome or "")
    message.add(8, _SCORES, *_scores_of(metrics))
    return bytes(message.data)


def decode_metrics(messages: Messages) -> tuple[Outcome | None, StepMetrics]:
    """How the episode ended with a step, if it did, and its scores, whatever they are.

    Raises:
        LogError: there is no such message.
        ValueError, struct.error: it is not what it should be.
    """
    data = _message(messages, Topic.METRICS)
    message = Unpacker(data)
    outcome = message.text()
    return Outcome(outcome) if outcome else None, StepMetrics(*message.take(8, _SCORES))


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
