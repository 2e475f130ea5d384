"""The topics of a log, the types of their messages, and what a message's stamp says."""

from __future__ import annotations

import struct
from enum import StrEnum
from typing import Final

from mapreplay.errors import LogError
from mapreplay.recorders.log.limits import MAX_STEPS
from mapreplay.step import FIRST_STAMP_NS, STEP_NS


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
_STAMP: Final = struct.Struct("<iI")


def missing(topic: str) -> LogError:
    """What is said of a log in which there are no messages on a topic that a step needs."""
    return LogError(
        f"messages on {topic} are missing, which another tool may have left out; a log cannot be "
        "read without them"
    )


def stamp_ns_of(topic: Topic, data: bytes | memoryview) -> int:
    """The simulated time that a message on `topic` is stamped with, in nanoseconds.

    Raises:
        struct.error: the message is too short.
    """
    # A TFMessage begins with the number of its transforms.
    seconds, nanoseconds = _STAMP.unpack_from(data, 8 if topic is Topic.TF else 4)
    return int(seconds * 1_000_000_000 + nanoseconds)


def step_of(topic: Topic, data: bytes | memoryview) -> int | None:
    """The step that a message on `topic` is stamped with; None if its time is no step's.

    Raises:
        struct.error: the message is too short.
    """
    step, rest = divmod(stamp_ns_of(topic, data) - FIRST_STAMP_NS, STEP_NS)
    return step if rest == 0 and 0 <= step < MAX_STEPS else None
