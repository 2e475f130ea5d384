"""Reading MCAP files as we need them: checked whole, a chunk at a time, also when they end early.

Sizes that a file claims are compared with the file, and with `mapreplay.recorders.log.limits`,
before anything is allocated.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Collection, Iterator
from typing import BinaryIO, Final, NamedTuple

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Metadata, Schema
from mcap.writer import MCAP0_MAGIC

from mapreplay.recorders.log.limits import (
    MAX_CHUNK_BYTES,
    MAX_MESSAGES_A_CHUNK,
    MAX_METADATA_BYTES,
    MAX_NAMES,
    check_count,
    check_size,
)
from mapreplay.recorders.log.messages import Topic
from mapreplay.recorders.log.schemas import MESSAGE_ENCODING

_PREFIX: Final = struct.Struct("<BQ")
_MESSAGE: Final = struct.Struct("<HIQQ")


class Record(NamedTuple):
    """A record of the file, undecoded."""

    opcode: int
    body: bytes


def is_mcap(file: BinaryIO) -> bool:
    """Whether the file starts like one."""
    file.seek(0)
    return file.read(len(MCAP0_MAGIC)) == MCAP0_MAGIC


def read_records(
    file: BinaryIO, offset: int = len(MCAP0_MAGIC), wanted: Collection[int] = frozenset(Opcode)
) -> Iterator[Record]:
    """All complete records of the `wanted` kinds from `offset` on; others are skipped.

    A record that the file cuts off ends them, and so does the footer.

    Raises:
        ValueError: a wanted record is larger than a record of ours may be.
    """
    size = file.seek(0, io.SEEK_END)
    while offset + _PREFIX.size <= size:
        file.seek(offset)
        opcode, length = _PREFIX.unpack(file.read(_PREFIX.size))
        offset += _PREFIX.size + length
        if offset > size:
            return
        if opcode in wanted:
            check_size("a record", length, MAX_CHUNK_BYTES)
            yield Record(opcode, file.read(length))
        if opcode == Opcode.FOOTER:
            return


def read_record(file: BinaryIO, offset: int, opcode: Opcode) -> bytes:
    """The body of the record at `offset`.

    Raises:
        ValueError: there is no complete record of that kind.
    """
    for record in read_records(file, offset):
        if record.opcode == opcode:
            return record.body
        break
    raise ValueError(f"no {opcode.name} record at byte {offset}")


def read_metadata(body: bytes) -> Metadata:
    """A metadata record.

    Raises:
        ValueError: it is larger than one of ours may be.
        McapError, struct.error: it is damaged.
    """
    check_size("a metadata record", len(body), MAX_METADATA_BYTES)
    metadata: Metadata = Metadata.read(stream(body))
    return metadata


def read_attachment(body: bytes) -> Attachment:
    """An attachment record."""
    attachment: Attachment = Attachment.read(stream(body))
    return attachment


def read_chunk(body: bytes) -> bytes:
    """The records in a chunk record, whose CRC is right.

    Raises:
        ValueError: it is not, the chunk claims an absurd size, or it is not compressed with
            zstd.
        McapError, ZstdError, struct.error: the chunk is damaged.
    """
    chunk = Chunk.read(stream(body))
    if chunk.compression != "zstd":
        raise ValueError(f"a chunk is compressed with {chunk.compression!r}, and not with 'zstd'")
    # The frame says it once more, or nothing (-1); memory is allocated for what it says.
    claimed = max(chunk.uncompressed_size, zstandard.frame_content_size(chunk.data))
    check_size("a chunk", claimed, MAX_CHUNK_BYTES)
    records = zstandard.ZstdDecompressor().decompress(
        chunk.data, max_output_size=chunk.uncompressed_size
    )
    if zlib.crc32(records) != chunk.uncompressed_crc:
        raise ValueError("the checksum of a chunk does not match")
    return records


class Channels:
    """The channels of a log, as far as they were declared, by id."""

    def __init__(self) -> None:
        self.topics: dict[int, str] = {}
        """Those that can be read."""
        self._foreign: dict[int, str] = {}
        self._types: dict[int, str] = {}

    def declare_type(self, body: bytes) -> None:
        """Learn from a schema record.

        Raises:
            ValueError: there are too many.
            McapError, struct.error: it is damaged.
        """
        schema = Schema.read(stream(body))
        self._types[schema.id] = schema.name
        check_count("types", len(self._types), MAX_NAMES)

    def declare(self, body: bytes) -> None:
        """Learn from a channel record.

        Raises:
            ValueError: there are too many.
            McapError, struct.error: it is damaged.
        """
        channel = Channel.read(stream(body))
        check_count("channels", len(self.topics) + len(self._foreign), MAX_NAMES)
        found = f"{self._types.get(channel.schema_id)} as {channel.message_encoding}"
        if channel.topic in frozenset(Topic):
            expected = f"{Topic(channel.topic).type_name} as {MESSAGE_ENCODING}"
            if found != expected:
                self._foreign[channel.id] = f"{channel.topic} is {found}, and not {expected}"
                return
        self.topics[channel.id] = channel.topic

    def topic(self, number: int) -> str:
        """The topic of a channel.

        Raises:
            ValueError: it was never declared, or is one of ours with a type that is not.
        """
        try:
            return self.topics[number]
        except KeyError:
            reason = "a message is on a channel that was never declared"
            raise ValueError(self._foreign.get(number, reason)) from None


class Unpacked(NamedTuple):
    """A message, the topic and the step that it is of, and the time at which it is logged."""

    topic: str
    step: int
    data: memoryview
    log_time: int


def unpack(
    records: bytes, channels: Channels, wanted: Collection[str] | None = None
) -> Iterator[Unpacked]:
    """The messages in the records of a chunk, as views of it.

    Args:
        records: See `read_chunk`.
        channels: Those known so far; learns those in the chunk.
        wanted: Other topics are skipped; None stands for all.

    Raises:
        ValueError: a message is on a channel that cannot be read, a record is longer than
            the chunk, or there are more messages than a chunk may have.
        struct.error: a record is cut off.
    """
    view, position, count = memoryview(records), 0, 0
    known = channels.topics
    while position < len(records):
        opcode, length = _PREFIX.unpack_from(records, position)
        start = position + _PREFIX.size
        position = start + length
        if position > len(records):
            raise ValueError("a record is longer than its chunk")
        if opcode == Opcode.MESSAGE:
            channel, sequence, log_time, _ = _MESSAGE.unpack_from(records, start)
            topic = known.get(channel) or channels.topic(channel)
            count += 1
            if count > MAX_MESSAGES_A_CHUNK:
                check_count("messages in a chunk", count, MAX_MESSAGES_A_CHUNK)
            if wanted is None or topic in wanted:
                data = view[start + _MESSAGE.size : position]
                yield Unpacked(topic, sequence, data, log_time)
        elif opcode == Opcode.CHANNEL:
            channels.declare(records[start:position])
        elif opcode == Opcode.SCHEMA:
            channels.declare_type(records[start:position])


def stream(body: bytes) -> ReadDataStream:
    """The body of a record, for mcap's classes to read from."""
    return ReadDataStream(io.BytesIO(body))
