"""rosbags' CDR serializer: another implementation of what the log's codec packs by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
from rosbags.typesys.stores import ros2_humble as ros

from mapreplay.recorders.log.schemas import typestore
from mapreplay.recorders.log.topics import Topic
from mapreplay.sensor import ranges
from mapreplay.step import Candidate, EpisodeHeader, EventKind, Step


def to_cdr(message: object, type_name: str) -> bytes:
    return bytes(typestore().serialize_cdr(message, type_name, little_endian=True))


def from_cdr(data: bytes, type_name: str) -> Any:
    return typestore().deserialize_cdr(data, type_name)


def messages_of(step: Step, header: EpisodeHeader) -> list[tuple[Topic, bytes]]:
    """What a log says of a step, built field by field from the definitions, but for the preview."""
    types = typestore().types
    plan, sensor = header.floor_plan, header.sensor
    height, width = plan.shape
    time = ros.builtin_interfaces__msg__Time(*divmod(step.stamp_ns, 10**9))
    in_map = ros.std_msgs__msg__Header(time, "map")
    no_turn = ros.geometry_msgs__msg__Quaternion(0.0, 0.0, 0.0, 1.0)

    def metres(cell: tuple[int, int]) -> tuple[float, float, float]:
        row, col = cell
        x, y = plan.origin
        return x + (col + 0.5) * plan.resolution, y + (row + 0.5) * plan.resolution, 0.0

    def pose(x: float, y: float, z: float = 0.0) -> ros.geometry_msgs__msg__Pose:
        return ros.geometry_msgs__msg__Pose(ros.geometry_msgs__msg__Point(x, y, z), no_turn)

    def stamped(x: float, y: float, z: float) -> ros.geometry_msgs__msg__PoseStamped:
        return ros.geometry_msgs__msg__PoseStamped(in_map, pose(x, y, z))

    def grid(cells: np.ndarray) -> ros.nav_msgs__msg__OccupancyGrid:
        load = ros.builtin_interfaces__msg__Time(1, 0)
        info = ros.nav_msgs__msg__MapMetaData(
            load, plan.resolution, width, height, pose(*plan.origin)
        )
        return ros.nav_msgs__msg__OccupancyGrid(in_map, info, cells.ravel())

    def prediction(p_wall: np.ndarray) -> object:
        code = {"uint8": 1, "uint16": 3, "float32": 7}[p_wall.dtype.name]
        field = types["foxglove_msgs/msg/PackedElementField"](name="p_wall", offset=0, type=code)
        return types["foxglove_msgs/msg/Grid"](
            timestamp=time,
            frame_id="map",
            pose=pose(*plan.origin),
            column_count=width,
            cell_size=types["foxglove_msgs/msg/Vector2"](x=plan.resolution, y=plan.resolution),
            row_stride=width * p_wall.itemsize,
            cell_stride=p_wall.itemsize,
            fields=[field],
            data=np.frombuffer(p_wall.tobytes(), np.uint8),
        )

    def candidate(c: Candidate) -> object:
        return types["mapreplay_msgs/msg/Candidate"](
            *c.cell, c.utility, c.reward, c.straight, c.diagonal, c.cost
        )

    move = ros.geometry_msgs__msg__Transform(
        ros.geometry_msgs__msg__Vector3(*metres(step.agent)), no_turn
    )
    transform = ros.geometry_msgs__msg__TransformStamped(in_map, "base_link", move)
    found: list[tuple[Topic, object]] = [
        (Topic.TF, ros.tf2_msgs__msg__TFMessage([transform])),
        (Topic.POSE, stamped(*metres(step.agent))),
    ]
    if len(step.hits):
        turn = 2 * np.pi / sensor.rays
        scan = ros.sensor_msgs__msg__LaserScan(
            ros.std_msgs__msg__Header(time, "base_link"),
            0.0, turn * (sensor.rays - 1), turn, 0.0, 0.1, 0.0,
            (sensor.reach + 1) * plan.resolution,
            ranges(step.hits, sensor, plan.resolution), np.empty(0, np.float32),
        )  # fmt: skip
        found.append((Topic.SCAN, scan))
    found.append((Topic.OBSERVED, grid(step.observed)))
    if step.p_wall is not None:
        found.append((Topic.P_WALL, prediction(step.p_wall)))
    found.append((Topic.FUSED, grid(step.fused)))
    points = [ros.geometry_msgs__msg__Point(*metres(cell)) for cell in step.frontier.tolist()]
    side = plan.resolution
    found.append((Topic.FRONTIER, ros.nav_msgs__msg__GridCells(in_map, side, side, points)))
    if (decision := step.decision) is not None:
        poses = [stamped(*metres(cell)) for cell in decision.path.tolist()]
        chosen = types["mapreplay_msgs/msg/Decision"](
            header=in_map,
            mode=str(decision.mode),
            chosen=candidate(decision.chosen),
            rivals=[candidate(rival) for rival in decision.rivals],
            is_random=decision.random_draw is not None,
            random_draw=decision.random_draw or 0,
        )
        found += [(Topic.PLAN, ros.nav_msgs__msg__Path(in_map, poses)), (Topic.DECISION, chosen)]
    for event in step.events:
        level = 30 if event.kind is EventKind.SEALED_IN else 20
        line = ros.rcl_interfaces__msg__Log(
            time, level, f"mapreplay.{event.kind}", event.text, "", "", 0
        )
        found.append((Topic.EVENTS, line))
    if step.profile is not None:
        times = vars(step.profile).values()
        found.append((Topic.PROFILE, types["mapreplay_msgs/msg/StepProfile"](in_map, *times)))
    scores = vars(step.metrics).values()
    outcome = str(step.outcome or "")
    found.append((Topic.METRICS, types["mapreplay_msgs/msg/StepMetrics"](in_map, outcome, *scores)))
    return [(topic, to_cdr(message, topic.type_name)) for topic, message in found]
