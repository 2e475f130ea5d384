"""A step to and from ROS 2 messages: pure functions, topic by topic (design, "The log").

Everything is in frame ``map``, except the scan, which is in ``base_link``: the centre of the
agent's cell. The sensor is fixed to the map frame, so the yaw between the two is always 0.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from enum import StrEnum
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
from rosbags.typesys.stores import ros2_humble as ros

from mapreplay.errors import LogError
from mapreplay.floorplan import FloorPlan
from mapreplay.grid import Cell, Grid, Origin, Quantized
from mapreplay.mapping import dequantize
from mapreplay.recorders.schemas import from_cdr, to_cdr, typestore
from mapreplay.sensor import Sensor, hits_from_ranges, ranges
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


_PACKED_TYPES: Final[dict[int, np.dtype[Any]]] = {
    1: np.dtype("<u1"),
    3: np.dtype("<u2"),
    7: np.dtype("<f4"),
}
"""What a PackedElementField's type means, of those that a prediction may have."""

_LEVELS: Final = {EventKind.SEALED_IN: 30}
_INFO: Final = 20
_NO_TURN: Final = ros.geometry_msgs__msg__Quaternion(0.0, 0.0, 0.0, 1.0)


def encode_truth(plan: FloorPlan) -> Encoded:
    """The floor plan, stamped as the first step.

    Its resolution is a float32 in this message; the exact one is in the metadata.
    """
    return Encoded(Topic.TRUTH, _grid(plan.cells, plan, _stamp(FIRST_STAMP_NS)))


def decode_truth(data: bytes, plan_id: str, resolution: float) -> FloorPlan:
    """The inverse of `encode_truth`.

    Raises:
        FloorPlanError: the cells, the resolution or the id make no floor plan.
        ValueError: the bytes are not an OccupancyGrid.
    """
    grid: ros.nav_msgs__msg__OccupancyGrid = from_cdr(data, Topic.TRUTH.type_name)
    corner = grid.info.origin.position
    return FloorPlan(plan_id, _cells(grid), resolution, Origin(corner.x, corner.y))


def encode_step(step: Step, header: EpisodeHeader) -> Iterator[Encoded]:
    """All messages of a step, the metrics last; what a step does not have has no message."""
    plan, stamp = header.floor_plan, _stamp(step.stamp_ns)
    yield _encode(Topic.TF, _transform(step.agent, plan, stamp))
    yield _encode(Topic.POSE, _pose(step.agent, plan, stamp))
    yield _encode(Topic.SCAN, _scan(step, header.sensor, plan.resolution))
    yield Encoded(Topic.OBSERVED, _grid(step.observed, plan, stamp))
    if step.p_wall is not None:
        percent = np.rint(100 * dequantize(step.p_wall)).astype(np.int8)
        yield _encode(Topic.P_WALL, _packed_grid(step.p_wall, plan, stamp))
        yield Encoded(Topic.PREDICTED, _grid(percent, plan, stamp))
    yield Encoded(Topic.FUSED, _grid(step.fused, plan, stamp))
    yield _encode(Topic.FRONTIER, _grid_cells(step.frontier, plan, stamp))
    if step.decision is not None:
        yield _encode(Topic.PLAN, _path(step.decision.path, plan, stamp))
        yield _encode(Topic.DECISION, _decision(step.decision, stamp))
    for event in step.events:
        yield _encode(Topic.EVENTS, _log_line(event, stamp))
    if step.profile is not None:
        yield _encode(Topic.PROFILE, _own(Topic.PROFILE.type_name, stamp, **asdict(step.profile)))
    outcome = str(step.outcome or "")
    yield _encode(
        Topic.METRICS,
        _own(Topic.METRICS.type_name, stamp, outcome=outcome, **asdict(step.metrics)),
    )


def decode_step(messages: Mapping[str, Sequence[bytes]], index: int, header: EpisodeHeader) -> Step:
    """The inverse of `encode_step`; `messages` are those of one step, by topic.

    Arrays own their memory. Topics that are not ours are ignored.

    Raises:
        KeyError: a message is missing.
        ValueError: a message is not what its topic says, or does not fit the floor plan.
    """
    plan = header.floor_plan

    def first(topic: Topic) -> Any:
        return from_cdr(messages[topic][0], topic.type_name)

    pose: ros.geometry_msgs__msg__PoseStamped = first(Topic.POSE)
    scan: ros.sensor_msgs__msg__LaserScan = first(Topic.SCAN)
    frontier: ros.nav_msgs__msg__GridCells = first(Topic.FRONTIER)
    metrics = first(Topic.METRICS)
    (agent,) = _cells_at([pose.pose.position], plan).tolist()
    decision = p_wall = profile = None
    if Topic.DECISION in messages:
        decision = _decision_of(first(Topic.DECISION), first(Topic.PLAN), plan)
    if Topic.P_WALL in messages:
        p_wall = _quantized(first(Topic.P_WALL), plan)
    if Topic.PROFILE in messages:
        profile = _fields(StepProfile, first(Topic.PROFILE))
    return Step(
        index=index,
        agent=Cell(*agent),
        hits=hits_from_ranges(scan.ranges, header.sensor, plan.resolution),
        observed=_map(first(Topic.OBSERVED), plan),
        p_wall=p_wall,
        fused=_map(first(Topic.FUSED), plan),
        frontier=_cells_at(frontier.cells, plan),
        decision=decision,
        metrics=_fields(StepMetrics, metrics),
        events=tuple(
            _event(from_cdr(data, Topic.EVENTS.type_name))
            for data in messages.get(Topic.EVENTS, ())
        ),
        outcome=Outcome(metrics.outcome) if metrics.outcome else None,
        profile=profile,
    )


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


def _encode(topic: Topic, message: object) -> Encoded:
    return Encoded(topic, to_cdr(message, topic.type_name))


def _own(type_name: str, stamp: ros.builtin_interfaces__msg__Time, **values: Any) -> object:
    return typestore().types[type_name](header=_header(stamp), **values)


def _fields(cls: Any, message: Any) -> Any:
    """An instance of a dataclass whose fields a message has."""
    return cls(*[getattr(message, name) for name in cls.__dataclass_fields__])


def _stamp(nanoseconds: int) -> ros.builtin_interfaces__msg__Time:
    return ros.builtin_interfaces__msg__Time(*divmod(nanoseconds, 1_000_000_000))


def _header(
    stamp: ros.builtin_interfaces__msg__Time, frame: str = "map"
) -> ros.std_msgs__msg__Header:
    return ros.std_msgs__msg__Header(stamp, frame)


# Cells and metres


def _points(cells: Cells, plan: FloorPlan) -> list[ros.geometry_msgs__msg__Point]:
    x = plan.origin.x + (cells[:, 1] + 0.5) * plan.resolution
    y = plan.origin.y + (cells[:, 0] + 0.5) * plan.resolution
    pairs = zip(x.tolist(), y.tolist(), strict=True)
    return [ros.geometry_msgs__msg__Point(*pair, 0.0) for pair in pairs]


def _cells_at(points: Sequence[ros.geometry_msgs__msg__Point], plan: FloorPlan) -> Cells:
    """int32[n, 2]: the cells whose centres are at `points`."""
    metres = np.array([(p.y, p.x) for p in points], np.float64).reshape(-1, 2)
    corner = (plan.origin.y, plan.origin.x)
    return np.rint((metres - corner) / plan.resolution - 0.5).astype(np.int32)


# The agent


def _transform(
    agent: Cell, plan: FloorPlan, stamp: ros.builtin_interfaces__msg__Time
) -> ros.tf2_msgs__msg__TFMessage:
    (point,) = _points(np.array([agent], np.int32), plan)
    move = ros.geometry_msgs__msg__Transform(
        ros.geometry_msgs__msg__Vector3(point.x, point.y, 0.0), _NO_TURN
    )
    return ros.tf2_msgs__msg__TFMessage(
        [ros.geometry_msgs__msg__TransformStamped(_header(stamp), "base_link", move)]
    )


def _pose(
    agent: Cell, plan: FloorPlan, stamp: ros.builtin_interfaces__msg__Time
) -> ros.geometry_msgs__msg__PoseStamped:
    (point,) = _points(np.array([agent], np.int32), plan)
    return ros.geometry_msgs__msg__PoseStamped(
        _header(stamp), ros.geometry_msgs__msg__Pose(point, _NO_TURN)
    )


def _scan(step: Step, sensor: Sensor, resolution: float) -> ros.sensor_msgs__msg__LaserScan:
    angles = sensor.angles()
    return ros.sensor_msgs__msg__LaserScan(
        _header(_stamp(step.stamp_ns), "base_link"),
        angle_min=angles[0],
        angle_max=angles[-1],
        angle_increment=2 * math.pi / sensor.rays,
        time_increment=0.0,
        scan_time=STEP_NS / 1e9,
        range_min=0.0,
        # The centre of the last cell of a ray may lie up to .71 cells further than `reach`.
        range_max=(sensor.reach + 1) * resolution,
        ranges=ranges(step.hits, sensor, resolution),
        intensities=np.empty(0, np.float32),
    )


# Maps


def _corner(plan: FloorPlan) -> ros.geometry_msgs__msg__Pose:
    return ros.geometry_msgs__msg__Pose(ros.geometry_msgs__msg__Point(*plan.origin, 0.0), _NO_TURN)


def _grid(cells: Grid, plan: FloorPlan, stamp: ros.builtin_interfaces__msg__Time) -> bytes:
    height, width = cells.shape
    message = ros.nav_msgs__msg__OccupancyGrid(
        _header(stamp),
        ros.nav_msgs__msg__MapMetaData(
            _stamp(FIRST_STAMP_NS), plan.resolution, width, height, _corner(plan)
        ),
        cells.ravel(),
    )
    return to_cdr(message, message.__msgtype__)


def _cells(grid: ros.nav_msgs__msg__OccupancyGrid) -> Grid:
    return grid.data.reshape(grid.info.height, grid.info.width).copy()


def _map(grid: ros.nav_msgs__msg__OccupancyGrid, plan: FloorPlan) -> Grid:
    cells = _cells(grid)
    if cells.shape != plan.shape:
        raise ValueError(f"a map of {cells.shape} cells on a floor plan of {plan.shape}")
    return cells


def _packed_grid(
    p_wall: Quantized, plan: FloorPlan, stamp: ros.builtin_interfaces__msg__Time
) -> object:
    types = typestore().types
    (code,) = [code for code, dtype in _PACKED_TYPES.items() if dtype == p_wall.dtype]
    size = p_wall.dtype.itemsize
    data = np.frombuffer(p_wall.astype(_PACKED_TYPES[code]).tobytes(), np.uint8)
    return types[Topic.P_WALL.type_name](
        timestamp=stamp,
        frame_id="map",
        pose=_corner(plan),
        column_count=p_wall.shape[1],
        cell_size=types["foxglove_msgs/msg/Vector2"](x=plan.resolution, y=plan.resolution),
        row_stride=p_wall.shape[1] * size,
        cell_stride=size,
        fields=[types["foxglove_msgs/msg/PackedElementField"](name="p_wall", offset=0, type=code)],
        data=data,
    )


def _quantized(grid: Any, plan: FloorPlan) -> Quantized:
    (field,) = grid.fields
    packed = _PACKED_TYPES[field.type]
    cells: npt.NDArray[Any] = np.frombuffer(grid.data.tobytes(), packed).reshape(plan.shape)
    return cells.astype(packed.newbyteorder("="))


# What was decided


def _grid_cells(
    cells: Cells, plan: FloorPlan, stamp: ros.builtin_interfaces__msg__Time
) -> ros.nav_msgs__msg__GridCells:
    return ros.nav_msgs__msg__GridCells(
        _header(stamp), plan.resolution, plan.resolution, _points(cells, plan)
    )


def _path(
    cells: Cells, plan: FloorPlan, stamp: ros.builtin_interfaces__msg__Time
) -> ros.nav_msgs__msg__Path:
    header = _header(stamp)
    poses = [
        ros.geometry_msgs__msg__PoseStamped(header, ros.geometry_msgs__msg__Pose(point, _NO_TURN))
        for point in _points(cells, plan)
    ]
    return ros.nav_msgs__msg__Path(header, poses)


def _decision(decision: Decision, stamp: ros.builtin_interfaces__msg__Time) -> object:
    return _own(
        Topic.DECISION.type_name,
        stamp,
        mode=str(decision.mode),
        chosen=_candidate(decision.chosen),
        rivals=[_candidate(rival) for rival in decision.rivals],
        is_random=decision.random_draw is not None,
        random_draw=decision.random_draw or 0,
    )


def _decision_of(message: Any, plan_path: ros.nav_msgs__msg__Path, plan: FloorPlan) -> Decision:
    return Decision(
        chosen=_candidate_of(message.chosen),
        path=_cells_at([pose.pose.position for pose in plan_path.poses], plan),
        mode=Mode(message.mode),
        rivals=tuple(_candidate_of(rival) for rival in message.rivals),
        random_draw=message.random_draw if message.is_random else None,
    )


def _candidate(candidate: Candidate) -> object:
    return typestore().types["mapreplay_msgs/msg/Candidate"](
        row=candidate.cell.row,
        col=candidate.cell.col,
        utility=candidate.utility,
        reward=candidate.reward,
        straight=candidate.straight,
        diagonal=candidate.diagonal,
        cost=candidate.cost,
    )


def _candidate_of(message: Any) -> Candidate:
    return Candidate(
        Cell(message.row, message.col),
        utility=message.utility,
        reward=message.reward,
        straight=message.straight,
        diagonal=message.diagonal,
    )


# What happened


def _log_line(
    event: Event, stamp: ros.builtin_interfaces__msg__Time
) -> ros.rcl_interfaces__msg__Log:
    level = _LEVELS.get(event.kind, _INFO)
    return ros.rcl_interfaces__msg__Log(
        stamp, level, f"mapreplay.{event.kind}", event.text, file="", function="", line=0
    )


def _event(line: ros.rcl_interfaces__msg__Log) -> Event:
    return Event(EventKind(line.name.removeprefix("mapreplay.")), line.msg)
