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

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Metadata, Schema
from mcap.writer import MCAP0_MAGIC

from mapreplay.errors import LogError
from mapreplay.recorders.log.limits import (
    MAX_CHUNK_BYTES,
    MAX_MESSAGES_A_CHUNK,
    MAX_METADATA_BYTES,
    MAX_NAMES,
    check_count,
    check_size,
)
from mapreplay.recorders.log.schemas import MESSAGE_ENCODING
from mapreplay.recorders.log.topics import Topic

DAMAGE: Final = (
    ArithmeticError,
    AttributeError,
    LookupError,
    McapError,
    MemoryError,
    RecursionError,
    RuntimeError,
    struct.error,
    TypeError,
    ValueError,
    zstandard.ZstdError,
)
"""What the libraries raise when bytes are not what they should be."""

_PREFIX: Final = struct.Struct("<BQ")
_MESSAGE: Final = struct.Struct("<HIQQ")


class Record(NamedTuple):
    """A record of the file, undecoded."""

    opcode: int
    body: bytes


class Span(NamedTuple):
    """Where a record stands in the file."""

    opcode: int
    offset: int
    """Of its first byte."""
    length: int
    """Of all of it, in bytes."""

    @property
    def end(self) -> int:
        """Where the next record begins."""
        return self.offset + self.length


class Block(NamedTuple):
    """A stretch of the file with messages: a chunk, or records that are in no chunk."""

    first: int
    """The first step that it has messages of."""
    last: int
    offset: int
    length: int
    is_chunk: bool = True


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


def places(file: BinaryIO, offset: int, size: int) -> Iterator[Span]:
    """Where the complete records from `offset` on stand, in a file of `size` bytes.

    They end with the footer, before a record that the file cuts off, and before what cannot
    begin a record: zeros, or the magic of another MCAP file.
    """
    while offset + _PREFIX.size <= size:
        file.seek(offset)
        head = file.read(_PREFIX.size)
        opcode, length = _PREFIX.unpack(head)
        place = Span(opcode, offset, _PREFIX.size + length)
        if opcode == 0 or head.startswith(MCAP0_MAGIC) or place.end > size:
            return
        yield place
        if opcode == Opcode.FOOTER:
            return
        offset = place.end


def body_of(file: BinaryIO, place: Span) -> bytes:
    """The body of the record at `place`.

    Raises:
        ValueError: it is larger than a record of ours may be, or is no longer there.
    """
    length = place.length - _PREFIX.size
    check_size("a record", length, MAX_CHUNK_BYTES)
    file.seek(place.offset + _PREFIX.size)
    body = file.read(length)
    if len(body) < length:
        raise ValueError(f"the record at byte {place.offset} is cut off")
    return body


def read_block(file: BinaryIO, block: Block) -> bytes:
    """The records of a block.

    Raises:
        ValueError, LogError, McapError, struct.error, OSError: see `read_chunk`.
    """
    check_size("a record", block.length, MAX_CHUNK_BYTES)
    file.seek(block.offset)
    data = file.read(block.length)
    if len(data) < block.length:
        raise ValueError(f"the record at byte {block.offset} is cut off")
    if not block.is_chunk:
        return data
    if data[0] != Opcode.CHUNK:
        raise ValueError(f"no chunk at byte {block.offset}")
    return read_chunk(data[_PREFIX.size :])


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
    """The records in a chunk record, whose CRC is right if it has one.

    Raises:
        ValueError, RuntimeError: the CRC or the size is not right, or the chunk claims an
            absurd size.
        McapError, ZstdError, struct.error: the chunk is damaged.
        LogError: it is compressed in a way that is none of MCAP's.
    """
    chunk = Chunk.read(stream(body))
    check_size("a chunk", chunk.uncompressed_size, MAX_CHUNK_BYTES)
    try:
        unpack_with = _DECOMPRESSORS[chunk.compression]
    except KeyError:
        raise LogError(
            f"a chunk is compressed with {chunk.compression!r}, which cannot be read here; "
            "repack the file with zstd"
        ) from None
    records = unpack_with(chunk.data, chunk.uncompressed_size)
    if len(records) != chunk.uncompressed_size:
        raise ValueError(
            f"a chunk of {len(records)} bytes that should have {chunk.uncompressed_size}"
        )
    # 0 means that whoever wrote the chunk did not compute it.
    if chunk.uncompressed_crc and zlib.crc32(records) != chunk.uncompressed_crc:
        raise ValueError("the checksum of a chunk does not match")
    return records


def _from_zstd(data: bytes, size: int) -> bytes:
    # The frame says it once more, or nothing (-1); memory is allocated for what it says.
    check_size("a chunk", zstandard.frame_content_size(data), MAX_CHUNK_BYTES)
    return zstandard.ZstdDecompressor().decompress(data, max_output_size=size)


def _from_lz4(data: bytes, size: int) -> bytes:
    unpacker = lz4.frame.LZ4FrameDecompressor()
    # What the frame says of its size is not looked at. One byte more, so that too much is seen.
    records = bytes(unpacker.decompress(data, max_length=size + 1))
    if not unpacker.eof:
        raise ValueError("a chunk with more bytes than it should have, or cut off")
    return records


def _as_it_is(data: bytes, _: int) -> bytes:
    return data


_DECOMPRESSORS: Final = {"zstd": _from_zstd, "lz4": _from_lz4, "": _as_it_is}
"""The three compressions of MCAP."""


class Channels:
    """The channels of a log, as far as they were declared, by id."""

    def __init__(self) -> None:
        self.topics: dict[int, str] = {}
        """Those that can be read."""
        self.names: set[str] = set()
        """All topics, also those that cannot be read."""
        self.encodings: set[str] = set()
        """Of their messages."""
        self._unexpected: dict[int, str] = {}
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
        check_count("channels", len(self.topics) + len(self._unexpected), MAX_NAMES)
        check_count("topics", len(self.names), MAX_NAMES)
        self.names.add(channel.topic)
        self.encodings.add(channel.message_encoding)
        found = f"{self._types.get(channel.schema_id)} as {channel.message_encoding}"
        if channel.topic in frozenset(Topic):
            expected = f"{Topic(channel.topic).type_name} as {MESSAGE_ENCODING}"
            if found != expected:
                self._unexpected[channel.id] = f"{channel.topic} is {found}, and not {expected}"
                return
        self.topics[channel.id] = channel.topic

    def topic(self, number: int) -> str:
        """The topic of a channel.

        Raises:
            ValueError: it was never declared.
            LogError: it is one of ours with a type that is not.
        """
        try:
            return self.topics[number]
        except KeyError:
            if number in self._unexpected:
                raise LogError(self._unexpected[number]) from None
            raise ValueError("a message is on a channel that was never declared") from None


class Unpacked(NamedTuple):
    """A message, its topic and sequence number, and the time at which it is logged."""

    topic: str
    sequence: int
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
        ValueError: a message is on a channel that was never declared, a record is longer than
            the chunk, or there are more messages than a chunk may have.
        LogError: a message is on one of our topics, but of another type.
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
