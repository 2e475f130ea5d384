"""MCAP files as we need them: checked whole, read by chunk, also when they end too early."""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Iterator
from typing import BinaryIO, Final, NamedTuple

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, McapRecord, Message, Metadata
from mcap.stream_reader import breakup_chunk
from mcap.summary import Summary
from mcap.writer import MCAP0_MAGIC

MAX_CHUNK_BYTES: Final = 1 << 30
"""Chunks that claim to be larger are refused: one step of the largest map has 150 MB."""

_PREFIX: Final = struct.Struct("<BQ")
_FOOTER: Final = struct.Struct("<BQQQI")
_DATA_END_SIZE: Final = _PREFIX.size + 4
_BLOCK: Final = 1 << 20


class Record(NamedTuple):
    """A record of the file, undecoded."""

    opcode: int
    body: bytes


def is_mcap(file: BinaryIO) -> bool:
    """Whether the file starts like one."""
    file.seek(0)
    return file.read(len(MCAP0_MAGIC)) == MCAP0_MAGIC


def read_records(file: BinaryIO, offset: int = len(MCAP0_MAGIC)) -> Iterator[Record]:
    """All complete records from `offset` on; a record that the file cuts off ends them."""
    size = file.seek(0, io.SEEK_END)
    file.seek(offset)
    while len(prefix := file.read(_PREFIX.size)) == _PREFIX.size:
        opcode, length = _PREFIX.unpack(prefix)
        if length > size - file.tell():
            return
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
    """A metadata record."""
    metadata: Metadata = Metadata.read(ReadDataStream(io.BytesIO(body)))
    return metadata


def read_chunk(body: bytes) -> list[McapRecord]:
    """The schemas, channels and messages of a chunk whose CRC is right.

    Raises:
        ValueError: it is not, or the chunk claims an absurd size.
        McapError, ZstdError, struct.error: the chunk is damaged.
    """
    chunk = Chunk.read(ReadDataStream(io.BytesIO(body)))
    claimed = chunk.uncompressed_size
    if chunk.compression == "zstd":
        claimed = max(claimed, zstandard.frame_content_size(chunk.data))
    if claimed > MAX_CHUNK_BYTES:
        raise ValueError(f"a chunk claims {claimed} bytes")
    return breakup_chunk(chunk, validate_crc=True)


class Unpacked(NamedTuple):
    """A message and the topic that it is on."""

    topic: str
    message: Message


def unpack(records: list[McapRecord], topics: dict[int, str]) -> Iterator[Unpacked]:
    """The messages of a chunk; `topics` by channel id learns the channels in it.

    Raises:
        ValueError: a message is on a channel that was never declared.
    """
    for record in records:
        if isinstance(record, Channel):
            topics[record.id] = record.topic
        elif isinstance(record, Message):
            if record.channel_id not in topics:
                raise ValueError("a message is on a channel that was never declared")
            yield Unpacked(topics[record.channel_id], record)


def read_summary(file: BinaryIO) -> Summary | None:
    """The index of a finished file after checking every byte of it; None if it is unfinished.

    Raises:
        ValueError: a checksum does not match.
        McapError, struct.error: the summary makes no sense.
    """
    tail_size = _FOOTER.size + len(MCAP0_MAGIC)
    size = file.seek(0, io.SEEK_END)
    if size < tail_size + len(MCAP0_MAGIC):
        return None
    file.seek(size - tail_size)
    tail = file.read(tail_size)
    opcode, length, summary_start, _, summary_crc = _FOOTER.unpack(tail[: _FOOTER.size])
    if not tail.endswith(MCAP0_MAGIC) or (opcode, length) != (Opcode.FOOTER, 20):
        return None
    if summary_start == 0:  # allowed by the format, but no log of ours
        return None
    data_end = summary_start - _DATA_END_SIZE
    if not len(MCAP0_MAGIC) <= data_end < size - tail_size:
        raise ValueError("its index is outside of the file")
    file.seek(data_end)
    opcode, length, data_crc = struct.unpack("<BQI", file.read(_DATA_END_SIZE))
    if (opcode, length) != (Opcode.DATA_END, 4):
        raise ValueError("its index is not where it should be")
    # 0 means that whoever wrote the file did not compute it.
    if summary_crc and _crc(file, summary_start, size - len(MCAP0_MAGIC) - 4) != summary_crc:
        raise ValueError("the checksum of its index does not match")
    if data_crc and _crc(file, 0, data_end) != data_crc:
        raise ValueError("the checksum of its data does not match")
    file.seek(0)
    return make_reader(file).get_summary()


def _crc(file: BinaryIO, start: int, stop: int) -> int:
    crc = 0
    file.seek(start)
    for position in range(start, stop, _BLOCK):
        crc = zlib.crc32(file.read(min(_BLOCK, stop - position)), crc)
    return crc
