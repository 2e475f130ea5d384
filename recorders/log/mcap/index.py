"""The index at the end of a finished log: where its chunks, metadata and attachments are."""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import BinaryIO, Final, NamedTuple

from mcap.opcode import Opcode
from mcap.records import AttachmentIndex, MetadataIndex
from mcap.writer import MCAP0_MAGIC

from mapreplay.recorders.log.limits import MAX_INDEX_BYTES, MAX_NAMES, check_count, check_size
from mapreplay.recorders.log.mcap.reader import Channels, read_records, stream

_FOOTER: Final = struct.Struct("<BQQQI")
_DATA_END: Final = struct.Struct("<BQI")
_CHUNK: Final = struct.Struct("<QQQ")
_BLOCK: Final = 1 << 20
_WANTED: Final = frozenset(
    {Opcode.SCHEMA, Opcode.CHANNEL, Opcode.CHUNK_INDEX, Opcode.METADATA_INDEX,
     Opcode.ATTACHMENT_INDEX}
)  # fmt: skip


class ChunkPlace(NamedTuple):
    """A chunk: the stamps of its first and last message, and where its record begins."""

    first_ns: int
    last_ns: int
    offset: int


@dataclass(frozen=True)
class Index:
    """What the index of a log says."""

    channels: Channels = field(default_factory=Channels)
    chunks: list[ChunkPlace] = field(default_factory=list)
    metadata: dict[str, int] = field(default_factory=dict)
    """Where the first record of each name begins."""
    attachments: dict[str, int] = field(default_factory=dict)
    """Likewise."""

    def chunks_at(self, stamp_ns: int) -> Iterator[ChunkPlace]:
        """The chunks that may have messages of that stamp."""
        return (chunk for chunk in self.chunks if chunk.first_ns <= stamp_ns <= chunk.last_ns)


def read_index(file: BinaryIO) -> Index | None:
    """The index of a finished file after checking every byte of it; None if it is unfinished.

    Raises:
        ValueError: a checksum does not match, or the index is larger than a log's may be.
        McapError, struct.error: the index makes no sense.
    """
    tail_size = _FOOTER.size + len(MCAP0_MAGIC)
    size = file.seek(0, io.SEEK_END)
    if size < tail_size + len(MCAP0_MAGIC):
        return None
    file.seek(size - tail_size)
    tail = file.read(tail_size)
    opcode, length, start, _, index_crc = _FOOTER.unpack(tail[: _FOOTER.size])
    if not tail.endswith(MCAP0_MAGIC) or (opcode, length) != (Opcode.FOOTER, 20):
        return None
    if start == 0:  # allowed by the format, but no log of ours
        return None
    data_end = start - _DATA_END.size
    if not len(MCAP0_MAGIC) <= data_end < size - tail_size:
        raise ValueError("its index is outside of the file")
    check_size("an index", size - start, MAX_INDEX_BYTES)
    file.seek(data_end)
    opcode, length, data_crc = _DATA_END.unpack(file.read(_DATA_END.size))
    if (opcode, length) != (Opcode.DATA_END, 4):
        raise ValueError("its index is not where it should be")
    # 0 means that whoever wrote the file did not compute it.
    if index_crc and _crc(file, start, size - len(MCAP0_MAGIC) - 4) != index_crc:
        raise ValueError("the checksum of its index does not match")
    if data_crc and _crc(file, 0, data_end) != data_crc:
        raise ValueError("the checksum of its data does not match")
    return _parse(file, start)


def _parse(file: BinaryIO, start: int) -> Index:
    index = Index()
    for opcode, body in read_records(file, start, _WANTED):
        if opcode == Opcode.CHUNK_INDEX:
            index.chunks.append(ChunkPlace(*_CHUNK.unpack_from(body)))
        elif opcode == Opcode.METADATA_INDEX:
            metadata = MetadataIndex.read(stream(body))
            index.metadata.setdefault(metadata.name, metadata.offset)
            check_count("metadata records", len(index.metadata), MAX_NAMES)
        elif opcode == Opcode.ATTACHMENT_INDEX:
            attachment = AttachmentIndex.read(stream(body))
            index.attachments.setdefault(attachment.name, attachment.offset)
            check_count("attachments", len(index.attachments), MAX_NAMES)
        elif opcode == Opcode.SCHEMA:
            index.channels.declare_type(body)
        else:
            index.channels.declare(body)
    return index


def _crc(file: BinaryIO, start: int, stop: int) -> int:
    crc = 0
    file.seek(start)
    for position in range(start, stop, _BLOCK):
        crc = zlib.crc32(file.read(min(_BLOCK, stop - position)), crc)
    return crc
