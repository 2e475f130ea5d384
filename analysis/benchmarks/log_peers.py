"""How other libraries write and read the episode of the log's benchmark.

Each recorder gets a run with all that its user would have at hand, and says how long only its
writing took: files are opened before, and closed after, what is timed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import cached_property
from importlib.util import find_spec
from pathlib import Path
from time import perf_counter
from typing import Any, Final, TypeAlias

import numpy as np
import numpy.typing as npt

from mapreplay.mapping import dequantize
from mapreplay.recorders.log.codec import Encoded, encode_step
from mapreplay.recorders.log.schemas import schema_text, typestore
from mapreplay.recorders.log.topics import Topic
from mapreplay.recorders.log.writer import STEPS_A_CHUNK, EpisodeWriter
from mapreplay.sensor import ranges
from mapreplay.step import Cells, EpisodeHeader, Step

MAP_TOPICS: Final = (Topic.OBSERVED, Topic.P_WALL, Topic.FUSED)


@dataclass(frozen=True, eq=False)
class Run:
    """An episode that was simulated beforehand."""

    header: EpisodeHeader
    steps: list[Step]

    @cached_property
    def encoded(self) -> list[list[Encoded]]:
        """Its messages as bytes, step by step."""
        return [list(encode_step(step, self.header)) for step in self.steps]

    @cached_property
    def built(self) -> list[list[tuple[Topic, object]]]:
        """Its messages as rosbags' objects, step by step."""
        store = typestore()
        return [
            [(topic, store.deserialize_cdr(data, topic.type_name)) for topic, data in messages]
            for messages in self.encoded
        ]


Recorder: TypeAlias = Callable[[Run, Path], float]
"""Writes a run to a file that does not exist yet; returns the seconds of the writing."""


class _Clock:
    seconds = 0.0


@contextmanager
def _clock() -> Iterator[_Clock]:
    clock, began = _Clock(), perf_counter()
    yield clock
    clock.seconds = perf_counter() - began


def write_ours(run: Run, path: Path) -> float:
    """Steps to `EpisodeWriter.add`: encoding, compression, checksums and syncing to disk."""
    with EpisodeWriter(path, run.header) as writer, _clock() as clock:
        for step in run.steps:
            writer.add(step)
    return clock.seconds


def write_mcap(run: Run, path: Path) -> float:
    """Ready bytes to mcap.Writer, a chunk every 20 steps."""
    from mcap.writer import Writer

    with path.open("wb") as file:
        writer = Writer(file, chunk_size=1 << 62)
        writer.start(profile="ros2")
        ids = {}
        for topic in Topic:
            schema = writer.register_schema(
                topic.type_name, "ros2msg", schema_text(topic.type_name).encode()
            )
            ids[topic] = writer.register_channel(topic, "cdr", schema)
        with _clock() as clock:
            for step, messages in zip(run.steps, run.encoded, strict=True):
                for topic, data in messages:
                    writer.add_message(
                        ids[topic], step.stamp_ns, data, step.stamp_ns, sequence=step.index
                    )
                if (step.index + 1) % STEPS_A_CHUNK == 0:
                    writer.flush()  # type: ignore[no-untyped-call]
        writer.finish()  # type: ignore[no-untyped-call]
    return clock.seconds


def write_rosbags(run: Run, path: Path) -> float:
    """Message objects, built beforehand, to rosbags' serializer and its MCAP writer."""
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

    store, messages = typestore(), run.built
    writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    with writer:
        connections = {
            topic: writer.add_connection(str(topic), topic.type_name, typestore=store)
            for topic in Topic
        }
        with _clock() as clock:
            for step, built in zip(run.steps, messages, strict=True):
                for topic, message in built:
                    data = store.serialize_cdr(message, topic.type_name)
                    writer.write(connections[topic], step.stamp_ns, data)
    return clock.seconds


def write_foxglove_bytes(run: Run, path: Path) -> float:
    """Ready bytes to foxglove-sdk: what its writer alone costs."""
    import foxglove

    context = foxglove.Context()
    with foxglove.open_mcap(path, context=context):
        channels = {
            topic: foxglove.Channel(
                topic,
                schema=foxglove.Schema(
                    name=topic.type_name,
                    encoding="ros2msg",
                    data=schema_text(topic.type_name).encode(),
                ),
                message_encoding="cdr",
                context=context,
            )
            for topic in Topic
        }
        with _clock() as clock:
            for step, messages in zip(run.steps, run.encoded, strict=True):
                for topic, data in messages:
                    channels[topic].log(data, log_time=step.stamp_ns)
    return clock.seconds


def write_foxglove(run: Run, path: Path) -> float:
    """Steps to foxglove-sdk's own message classes, as its user would; the rest as JSON."""
    import foxglove

    context = foxglove.Context()
    with foxglove.open_mcap(path, context=context):
        log_step = _foxglove_recorder(run.header, context)
        with _clock() as clock:
            for step in run.steps:
                log_step(step)
    return clock.seconds


def _foxglove_recorder(header: EpisodeHeader, context: Any) -> Callable[[Step], None]:
    from foxglove import Channel, channels, messages

    plan, sensor = header.floor_plan, header.sensor
    resolution, no_turn = plan.resolution, messages.Quaternion(x=0, y=0, z=0, w=1)
    corner = messages.Pose(
        position=messages.Vector3(x=plan.origin.x, y=plan.origin.y, z=0), orientation=no_turn
    )
    cell_size = messages.Vector2(x=resolution, y=resolution)
    grids = {
        topic: channels.GridChannel(topic, context=context)
        for topic in (*MAP_TOPICS, Topic.PREDICTED)
    }
    transforms = channels.FrameTransformChannel(Topic.TF, context=context)
    poses = channels.PoseInFrameChannel(Topic.POSE, context=context)
    scans = channels.LaserScanChannel(Topic.SCAN, context=context)
    frontiers = channels.PointCloudChannel(Topic.FRONTIER, context=context)
    plans = channels.PosesInFrameChannel(Topic.PLAN, context=context)
    events = channels.LogChannel(Topic.EVENTS, context=context)
    decisions = Channel(Topic.DECISION, context=context)
    metrics = Channel(Topic.METRICS, context=context)
    number = messages.PackedElementFieldNumericType
    xyz = [messages.PackedElementField(name=n, offset=8 * i, type=number.Float64)
           for i, n in enumerate("xyz")]  # fmt: skip
    field = {
        np.dtype(name): [messages.PackedElementField(name="cell", offset=0, type=kind)]
        for name, kind in [
            ("int8", number.Int8), ("uint8", number.Uint8), ("uint16", number.Uint16),
            ("float32", number.Float32),
        ]
    }  # fmt: skip

    def points(cells: Cells) -> npt.NDArray[np.float64]:
        corner_xy = (plan.origin.x, plan.origin.y)
        xy = corner_xy + (cells[:, ::-1] + 0.5) * resolution
        return np.column_stack([xy, np.zeros(len(cells))])

    def pose(x: float, y: float) -> Any:
        return messages.Pose(position=messages.Vector3(x=x, y=y, z=0), orientation=no_turn)

    def log_step(step: Step) -> None:
        at = step.stamp_ns
        stamp = messages.Timestamp(*divmod(at, 1_000_000_000))
        x, y, _ = points(np.array([step.agent]))[0].tolist()

        def log_grid(topic: Topic, cells: npt.NDArray[Any]) -> None:
            grid = messages.Grid(
                timestamp=stamp, frame_id="map", pose=corner, column_count=cells.shape[1],
                cell_size=cell_size, row_stride=cells.shape[1] * cells.itemsize,
                cell_stride=cells.itemsize, fields=field[cells.dtype], data=cells.tobytes(),
            )  # fmt: skip
            grids[topic].log(grid, log_time=at)

        transforms.log(
            messages.FrameTransform(
                timestamp=stamp, parent_frame_id="map", child_frame_id="base_link",
                translation=messages.Vector3(x=x, y=y, z=0), rotation=no_turn,
            ),
            log_time=at,
        )  # fmt: skip
        poses.log(messages.PoseInFrame(timestamp=stamp, frame_id="map", pose=pose(x, y)),
                  log_time=at)  # fmt: skip
        scans.log(
            messages.LaserScan(
                timestamp=stamp, frame_id="base_link", start_angle=0.0,
                end_angle=sensor.angles()[-1],
                ranges=ranges(step.hits, sensor, resolution).tolist(),
            ),
            log_time=at,
        )  # fmt: skip
        log_grid(Topic.OBSERVED, step.observed)
        if step.p_wall is not None:
            log_grid(Topic.P_WALL, step.p_wall)
            log_grid(Topic.PREDICTED, (10 * np.rint(10 * dequantize(step.p_wall))).astype(np.int8))
        log_grid(Topic.FUSED, step.fused)
        frontiers.log(
            messages.PointCloud(timestamp=stamp, frame_id="map", point_stride=24, fields=xyz,
                                data=points(step.frontier).tobytes()),
            log_time=at,
        )  # fmt: skip
        if step.decision is not None:
            path = [pose(x, y) for x, y, _ in points(step.decision.path).tolist()]
            plans.log(messages.PosesInFrame(timestamp=stamp, frame_id="map", poses=path),
                      log_time=at)  # fmt: skip
            rated = [asdict(c) for c in (step.decision.chosen, *step.decision.rivals)]
            decisions.log(
                {"mode": step.decision.mode, "candidates": rated,
                 "random_draw": step.decision.random_draw},
                log_time=at,
            )  # fmt: skip
        for event in step.events:
            line = messages.Log(timestamp=stamp, message=event.text, name=event.kind)
            events.log(line, log_time=at)
        metrics.log(asdict(step.metrics), log_time=at)

    return log_step


def recorders() -> dict[str, Recorder | None]:
    """All recorders by what is printed of them; None for one that is not installed."""
    foxglove = find_spec("foxglove") is not None
    return {
        "mapreplay, from Steps": write_ours,
        "foxglove-sdk, own messages from Steps": write_foxglove if foxglove else None,
        "foxglove-sdk, ready bytes": write_foxglove_bytes if foxglove else None,
        "mcap.Writer, ready bytes": write_mcap,
        "rosbags, ready objects": write_rosbags,
    }


def read_with_mcap(path: Path, *, checked: bool) -> Iterator[npt.NDArray[Any]]:
    """The maps of all steps through make_reader and rosbags' deserializer.

    Without `checked`, which is mcap's default, damage goes unnoticed.
    """
    from mcap.reader import make_reader

    store = typestore()
    with path.open("rb") as file:
        for _, channel, message in make_reader(file, validate_crcs=checked).iter_messages(
            MAP_TOPICS
        ):
            topic = Topic(channel.topic)
            grid: Any = store.deserialize_cdr(message.data, topic.type_name)
            width = grid.column_count if topic is Topic.P_WALL else grid.info.width
            yield grid.data.reshape(-1, width)


def read_metrics_with_mcap(path: Path) -> list[Any]:
    """The metrics of all steps through make_reader and rosbags' deserializer, unchecked."""
    from mcap.reader import make_reader

    store = typestore()
    with path.open("rb") as file:
        return [
            store.deserialize_cdr(message.data, Topic.METRICS.type_name)
            for _, _, message in make_reader(file).iter_messages([Topic.METRICS])
        ]
