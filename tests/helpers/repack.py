"""Logs as other MCAP tools leave them: packed in another way, filtered, merged, put in order."""

from __future__ import annotations

import io
import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer


@dataclass(frozen=True)
class Logged:
    """A message, with what a channel says of it."""

    topic: str
    type_name: str
    definition: bytes
    sequence: int
    log_time: int
    data: bytes


@dataclass(frozen=True)
class Contents:
    """All that an MCAP file has."""

    messages: list[Logged]
    metadata: list[tuple[str, dict[str, str]]]
    attachments: list[tuple[str, str, bytes]]


def read(path: Path) -> Contents:
    """The contents of a file of ours, messages by time."""
    reader = make_reader(io.BytesIO(path.read_bytes()), validate_crcs=True)
    return Contents(
        [
            Logged(c.topic, s.name, s.data, m.sequence, m.log_time, m.data)
            for s, c, m in reader.iter_messages()
            if s is not None
        ],
        [(m.name, m.metadata) for m in reader.iter_metadata()],
        [(a.name, a.media_type, a.data) for a in reader.iter_attachments()],
    )


@dataclass(frozen=True)
class Tool:
    """What a tool does to a file; by default it copies it message by message."""

    change: Callable[[Contents], Contents] = lambda contents: contents
    library: str = "another tool"
    first_id: int = 1
    """Of channels; schemas count from 100 more."""
    options: dict[str, Any] = field(default_factory=dict)
    """Of mcap's Writer."""

    def write(self, contents: Contents, path: Path) -> Path:
        """Write what it makes of the contents."""
        contents = self.change(contents)
        with path.open("wb") as file:
            writer = Writer(file, **self.options)
            writer.start("ros2", self.library)
            channels = _channels(writer, contents.messages, self.first_id)
            for name, pairs in contents.metadata:
                writer.add_metadata(name, pairs)
            for m in contents.messages:
                writer.add_message(channels[m.topic], m.log_time, m.data, m.log_time, m.sequence)
            for name, media_type, data in contents.attachments:
                writer.add_attachment(0, 0, name, media_type, data)
            writer.finish()
        return path


def _channels(writer: Writer, messages: Sequence[Logged], first: int) -> dict[str, int]:
    for k in range(1, first):  # so that ids are others than ours
        writer.register_channel(f"/nothing/{k}", "cdr", writer.register_schema(f"a/B{k}", "x", b""))
    channels: dict[str, int] = {}
    for m in messages:
        if m.topic not in channels:
            schema = writer.register_schema(m.type_name, "ros2msg", m.definition)
            channels[m.topic] = writer.register_channel(m.topic, "cdr", schema)
    return channels


def renumbered(contents: Contents) -> Contents:
    """All sequence numbers are 0, as most writers have it."""
    return replace(contents, messages=[replace(m, sequence=0) for m in contents.messages])


def counted(contents: Contents) -> Contents:
    """Messages are numbered through, whatever their topic."""
    messages = [replace(m, sequence=k) for k, m in enumerate(contents.messages)]
    return replace(contents, messages=messages)


def shifted(contents: Contents) -> Contents:
    """Logged at another time than the one in the message, as when a bag is played and recorded."""
    messages = [replace(m, log_time=m.log_time + 10**18 + 7) for m in contents.messages]
    return replace(contents, messages=messages)


def shuffled(contents: Contents) -> Contents:
    """In any order."""
    messages = random.Random(1).sample(contents.messages, len(contents.messages))
    return replace(contents, messages=messages)


def by_topic(contents: Contents) -> Contents:
    """One topic after the other: each chunk has all steps of some topics."""
    return replace(contents, messages=sorted(contents.messages, key=lambda m: m.topic))


def without_records(contents: Contents) -> Contents:
    """Neither the table nor the outcome, as after ``mcap filter`` without metadata of the end."""
    metadata = [(name, pairs) for name, pairs in contents.metadata if name != "mapreplay.outcome"]
    return Contents(contents.messages, metadata, [])


def with_others(contents: Contents) -> Contents:
    """Merged with a recording of a robot's sensors."""
    others = [
        Logged("/camera", "std_msgs/msg/String", b"string data", k, 10**9 + k * 31, b"\0\1\0\0")
        for k in range(200)
    ]
    messages = sorted([*contents.messages, *others], key=lambda m: m.log_time)
    metadata = [("robot", {"name": "r2"}), *contents.metadata]
    return Contents(messages, metadata, [("map.pgm", "image/pgm", b"P5"), *contents.attachments])


def doubled(contents: Contents) -> Contents:
    """Merged with a copy of itself."""
    return replace(contents, messages=[m for m in contents.messages for _ in range(2)])


def without(*topics: str) -> Callable[[Contents], Contents]:
    """Filtered: without some topics."""

    def change(contents: Contents) -> Contents:
        kept = [m for m in contents.messages if m.topic not in topics]
        return replace(contents, messages=kept)

    return change


SMALL = {"chunk_size": 20_000}
TOOLS = {
    "copied": Tool(),
    "under our name": Tool(library="mapreplay"),
    "lz4": Tool(options={"compression": CompressionType.LZ4}),
    "not compressed": Tool(options={"compression": CompressionType.NONE}),
    "small chunks": Tool(options=SMALL),
    "small chunks under our name": Tool(library="mapreplay", options=SMALL),
    "a chunk a message": Tool(options={"chunk_size": 1}),
    "no chunks": Tool(options={"use_chunking": False}),
    "no checksums": Tool(options={"enable_crcs": False}),
    "data checksum": Tool(options={"enable_data_crcs": True}),
    "no index": Tool(options={"index_types": IndexType.NONE}),
    "no summary": Tool(
        options={"index_types": IndexType.NONE, "repeat_channels": False, "repeat_schemas": False,
                 "use_statistics": False, "use_summary_offsets": False}
    ),
    "no message indexes": Tool(options={"index_types": IndexType.ALL & ~IndexType.MESSAGE}),
    "no metadata index": Tool(options={"index_types": IndexType.CHUNK}),
    "neither chunks nor index": Tool(
        options={"use_chunking": False, "index_types": IndexType.NONE, "enable_crcs": False}
    ),
    "other ids": Tool(first_id=40),
    "sequence 0": Tool(renumbered),
    "sequence 0 under our name": Tool(renumbered, library="mapreplay"),
    "numbered through": Tool(counted, options=SMALL),
    "recorded later": Tool(shifted),
    "any order": Tool(shuffled, options=SMALL),
    "by topic": Tool(by_topic, options=SMALL | {"compression": CompressionType.LZ4}),
    "without records": Tool(without_records),
    "merged": Tool(with_others, options=SMALL),
    "merged with itself": Tool(doubled, options=SMALL),
    "filtered for viewers": Tool(without("/tf", "/map/predicted", "/profile")),
}  # fmt: skip
"""Each leaves a file of which every step can be read."""
