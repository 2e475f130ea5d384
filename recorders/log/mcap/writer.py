"""Writing MCAP: chunks that are closed when we say so, compressed well, with all checksums.

mcap's own Writer fixes the level of the compression and costs several times as much a message.
Records other than messages are still laid out by the mcap library.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from collections.abc import Mapping
from typing import BinaryIO, Final, NamedTuple

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC

ZSTD_LEVEL: Final = 6
"""8 % smaller than level 1, for 0.04 ms a step at 64 x 64. Level 19 would take another 13 % and
several milliseconds a step."""

_MESSAGE: Final = struct.Struct("<BQHIQQ")
_INDEX: Final = struct.Struct("<BQHI")
_MESSAGE_FIXED: Final = 2 + 4 + 8 + 8


class _Message(NamedTuple):
    channel: int
    sequence: int
    stamp_ns: int
    data: bytes


class ContainerWriter:
    """Writes one MCAP file; nothing is compressed or written before `flush` or `finish`."""

    def __init__(self, file: BinaryIO, profile: str, library: str) -> None:
        """Write the beginning to `file`, which is empty.

        Raises:
            OSError: `file` cannot be written; so do all methods.
        """
        self._file = file
        self._position = 0
        self._crc = 0
        self._compressor = zstandard.ZstdCompressor(level=ZSTD_LEVEL)
        self._schemas: dict[str, Schema] = {}
        self._channels: list[Channel] = []
        self._declarations: list[bytes] = []
        self._messages: list[_Message] = []
        self._counts: Counter[int] = Counter()
        self._chunk_indexes: list[ChunkIndex] = []
        self._attachment_indexes: list[AttachmentIndex] = []
        self._metadata_indexes: list[MetadataIndex] = []
        self._put(MCAP0_MAGIC)
        self._put(_bytes_of(Header(profile, library)))

    def add_metadata(self, name: str, pairs: Mapping[str, str]) -> None:
        """Write a metadata record."""
        record = _bytes_of(Metadata(name, dict(pairs)))
        self._metadata_indexes.append(MetadataIndex(self._position, len(record), name))
        self._put(record)

    def add_attachment(self, name: str, media_type: str, data: bytes) -> None:
        """Write an attachment of no date."""
        record = _bytes_of(Attachment(0, 0, name, media_type, data))
        self._attachment_indexes.append(
            AttachmentIndex(self._position, len(record), 0, 0, len(data), name, media_type)
        )
        self._put(record)

    def add_channel(
        self, topic: str, encoding: str, schema_name: str, schema_encoding: str, schema: str
    ) -> int:
        """Declare a topic, and its schema if that is new; returns the id for `add_message`."""
        if schema_name not in self._schemas:
            new = Schema(
                id=len(self._schemas) + 1,
                data=schema.encode(),
                encoding=schema_encoding,
                name=schema_name,
            )
            self._schemas[schema_name] = new
            self._declarations.append(_bytes_of(new))
        # rosbag2 wants this key in every channel.
        metadata = {"offered_qos_profiles": ""}
        number = len(self._channels) + 1
        channel = Channel(number, topic, encoding, metadata, self._schemas[schema_name].id)
        self._channels.append(channel)
        self._declarations.append(_bytes_of(channel))
        return number

    def add_message(self, channel: int, sequence: int, stamp_ns: int, data: bytes) -> None:
        """Keep a message for the chunk that `flush` closes."""
        self._messages.append(_Message(channel, sequence, stamp_ns, data))

    def flush(self) -> None:
        """Write all messages since the last time as a chunk, and flush the file.

        In the chunk they are sorted by channel: equal things side by side compress better,
        and who reads one topic finds it in one place.
        """
        if self._messages:
            self._write_chunk(sorted(self._messages, key=lambda message: message.channel))
            self._messages = []
            self._declarations = []
        self._file.flush()

    def finish(self) -> None:
        """Write what is left, and the summary; `file` stays open."""
        self.flush()
        self._put(_bytes_of(DataEnd(self._crc)))
        start = self._position
        groups: list[list[McapRecord]] = [
            [*self._schemas.values()],
            [*self._channels],
            [self._statistics()],
            [*self._chunk_indexes],
            [*self._attachment_indexes],
            [*self._metadata_indexes],
        ]
        summary, offsets = b"", b""
        for group in groups:
            records = b"".join(map(_bytes_of, group))
            if records:
                offset = SummaryOffset(Opcode(records[0]), start + len(summary), len(records))
                offsets += _bytes_of(offset)
            summary += records
        footer = Footer(
            summary_start=start, summary_offset_start=start + len(summary), summary_crc=0
        )
        # The checksum covers the footer up to itself.
        covered = summary + offsets + _bytes_of(footer)[:-4]
        footer.summary_crc = zlib.crc32(covered)
        self._put(covered + struct.pack("<I", footer.summary_crc) + MCAP0_MAGIC)

    def _write_chunk(self, messages: list[_Message]) -> None:
        parts = self._declarations
        length = sum(map(len, parts))
        indexes: dict[int, list[int]] = {}
        for channel, sequence, stamp_ns, data in messages:
            indexes.setdefault(channel, []).extend((stamp_ns, length))
            size = _MESSAGE_FIXED + len(data)
            parts.append(_MESSAGE.pack(Opcode.MESSAGE, size, channel, sequence, stamp_ns, stamp_ns))
            parts.append(data)
            length += _MESSAGE.size + len(data)
            self._counts[channel] += 1
        records = b"".join(parts)
        stamps = [message.stamp_ns for message in messages]
        chunk = Chunk(
            compression="zstd",
            data=self._compressor.compress(records),
            message_start_time=min(stamps),
            message_end_time=max(stamps),
            uncompressed_crc=zlib.crc32(records),
            uncompressed_size=length,
        )
        start = self._position
        self._put(_bytes_of(chunk))
        end = self._position
        offsets = {}
        for channel, index in indexes.items():
            offsets[channel] = self._position
            self._put(_index_record(channel, index))
        self._chunk_indexes.append(
            ChunkIndex(
                chunk_length=end - start,
                chunk_start_offset=start,
                compression=chunk.compression,
                compressed_size=len(chunk.data),
                message_end_time=chunk.message_end_time,
                message_index_length=self._position - end,
                message_index_offsets=offsets,
                message_start_time=chunk.message_start_time,
                uncompressed_size=length,
            )
        )

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=len(self._attachment_indexes),
            channel_count=len(self._channels),
            channel_message_counts=dict(self._counts),
            chunk_count=len(self._chunk_indexes),
            message_count=self._counts.total(),
            message_end_time=max((c.message_end_time for c in self._chunk_indexes), default=0),
            message_start_time=min((c.message_start_time for c in self._chunk_indexes), default=0),
            metadata_count=len(self._metadata_indexes),
            schema_count=len(self._schemas),
        )

    def _put(self, data: bytes) -> None:
        self._file.write(data)
        self._position += len(data)
        self._crc = zlib.crc32(data, self._crc)


def _index_record(channel: int, entries: list[int]) -> bytes:
    """A message index; `entries` are stamps and offsets in the chunk, in turn."""
    size = 8 * len(entries)
    fixed = _INDEX.pack(Opcode.MESSAGE_INDEX, 2 + 4 + size, channel, size)
    return fixed + struct.pack(f"<{len(entries)}Q", *entries)


def _bytes_of(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]
