"""Damage to logs and other files: at random, but the same for the same seed; also damage that no
checksum sees, because they are made anew after it.
"""

from __future__ import annotations

import io
import random
import struct
import zlib
from collections.abc import Iterator
from contextlib import suppress
from typing import Final, NamedTuple

import zstandard
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Chunk,
    ChunkIndex,
    McapRecord,
    Metadata,
    MetadataIndex,
)
from mcap.writer import MCAP0_MAGIC

from mapreplay.recorders.log import step_table
from mapreplay.recorders.log.header import _crc

ABSURD: Final = (0, 1, 2**7, 2**8 - 1, 2**15, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1)
REALS: Final = (float("nan"), float("inf"), -float("inf"), 1e300, -1e300, -0.0, 1e-300, 0.5, 7.0)
TEXTS: Final = (
    "",
    "0",
    "-1",
    "nan",
    "1e999",
    "99999999999",
    "[1, 2",
    "{}",
    "null",
    "[0, 0]",
    "\x1b[2J",
)


class Piece(NamedTuple):
    """A record of a log."""

    opcode: int
    body: bytes


def pieces_of(data: bytes) -> list[Piece]:
    """The records of a log before its index."""
    found, position = [], len(MCAP0_MAGIC)
    while position < len(data):
        opcode, length = struct.unpack_from("<BQ", data, position)
        position += 9 + length
        if opcode == Opcode.DATA_END:
            break
        found.append(Piece(opcode, data[position - length : position]))
    return found


def log_of(pieces: list[Piece]) -> bytes:
    """A finished log with an index in which all checksums are right."""
    data, index = io.BytesIO(), []
    data.write(MCAP0_MAGIC)
    for opcode, body in pieces:
        place = data.tell()
        data.write(_raw(opcode, body))
        if opcode == Opcode.METADATA:
            name = Metadata.read(_stream(body)).name
            index.append(_encoded(MetadataIndex(place, len(body) + 9, name)))
        elif opcode == Opcode.ATTACHMENT:
            found = Attachment.read(_stream(body))
            index.append(
                _encoded(AttachmentIndex(place, len(body) + 9, 0, 0, len(found.data), found.name,
                                         found.media_type))
            )  # fmt: skip
        elif opcode == Opcode.CHUNK:
            chunk = Chunk.read(_stream(body))
            index.append(_encoded(_index_of(chunk, place, len(body) + 9)))
            with suppress(struct.error):  # a length that is damaged
                index += [
                    _raw(*record)
                    for record in _records(zstandard.decompress(chunk.data))
                    if record.opcode in (Opcode.SCHEMA, Opcode.CHANNEL)
                ]
    end = _raw(Opcode.DATA_END, struct.pack("<I", zlib.crc32(data.getvalue())))
    start = data.tell() + len(end)
    tail = b"".join(index) + struct.pack("<BQQQ", Opcode.FOOTER, 20, start, 0)
    crc = struct.pack("<I", zlib.crc32(tail))
    return data.getvalue() + end + tail + crc + MCAP0_MAGIC


def attachment_of(piece: Piece) -> bytes:
    """What is attached."""
    return bytes(Attachment.read(_stream(piece.body)).data)


def with_attachment(data: bytes) -> Piece:
    """The record of a table."""
    record = Attachment(0, 0, step_table.ATTACHMENT, step_table.MEDIA_TYPE, data)
    return Piece(Opcode.ATTACHMENT, _encoded(record)[9:])


def damaged(data: bytes, draw: random.Random) -> bytes:
    """Bits flipped, bytes cut out, doubled, overwritten, or cut off."""
    changed = bytearray(data)
    for _ in range(draw.choice((1, 1, 1, 2, 5))):
        if not changed:
            break
        a = draw.randrange(len(changed))
        b = min(len(changed), a + draw.choice((1, 2, 4, 8, 40)))
        how = draw.randrange(8)
        if how <= 2:
            changed[a] ^= 1 << draw.randrange(8)
        elif how == 3:
            changed[a:b] = draw.randbytes(b - a)
        elif how == 4:
            a -= a % 4
            changed[a : a + 4] = struct.pack("<I", draw.choice(ABSURD))
        elif how == 5:
            a -= a % 4
            changed[a : a + 8] = struct.pack("<d", draw.choice(REALS))
        elif how == 6:
            changed[a:a] = changed[a:b]
        else:
            del changed[a : b if draw.random() < 0.8 else len(changed)]
    return bytes(changed)


def damaged_log(data: bytes, draw: random.Random) -> bytes:
    """A log that is damaged somewhere, mostly so that all of its checksums are right."""
    how = draw.randrange(10)
    if how == 0:
        return damaged(data, draw)
    pieces = pieces_of(data)
    if how == 1:
        return log_of(_shuffled(pieces, draw))
    kinds = {2: Opcode.METADATA, 3: Opcode.ATTACHMENT}
    wanted = kinds.get(how, Opcode.CHUNK)
    there = [k for k, piece in enumerate(pieces) if piece.opcode == wanted]
    k = draw.choice(there)
    body = pieces[k].body
    if wanted == Opcode.METADATA:
        body = _damaged_metadata(body, draw)
    elif wanted == Opcode.ATTACHMENT:
        body = with_attachment(damaged(attachment_of(pieces[k]), draw)).body
    else:
        body = _damaged_chunk(body, draw)
    pieces[k] = Piece(wanted, body)
    return log_of(pieces)


def _shuffled(pieces: list[Piece], draw: random.Random) -> list[Piece]:
    """A record is missing, or there twice, or two have changed places."""
    a, b = draw.randrange(len(pieces)), draw.randrange(len(pieces))
    how = draw.randrange(3)
    if how == 0:
        return pieces[:a] + pieces[a + 1 :]
    if how == 1:
        return [*pieces[:a], pieces[b], *pieces[a:]]
    pieces[a], pieces[b] = pieces[b], pieces[a]
    return pieces


def _damaged_metadata(body: bytes, draw: random.Random) -> bytes:
    found = Metadata.read(_stream(body))
    pairs = dict(found.metadata)
    key = draw.choice(sorted(pairs))
    if draw.random() < 0.2:
        del pairs[key]
    elif draw.random() < 0.5:
        pairs[key] = draw.choice(TEXTS)
    else:
        text = damaged(pairs[key].encode(), draw)
        pairs[key] = text.decode(errors="ignore")
    if "crc32" in pairs and key != "crc32":
        del pairs["crc32"]
        pairs["crc32"] = _crc(pairs)
    return _encoded(Metadata(found.name, pairs))[9:]


def _damaged_chunk(body: bytes, draw: random.Random) -> bytes:
    """Damage in the data of messages, in their headers, or in channels, under a right checksum."""
    chunk = Chunk.read(_stream(body))
    records = list(_records(zstandard.decompress(chunk.data, chunk.uncompressed_size)))
    k = draw.randrange(len(records))
    opcode, data = records[k]
    if draw.random() < 0.1:
        del records[k]
    elif opcode == Opcode.MESSAGE and draw.random() < 0.95:
        # Fields stand at the beginning; most of the rest are the cells of maps.
        head = draw.choice((22, 60, 120, 400, len(data)))
        records[k] = Piece(opcode, data[:22] + damaged(data[22:head], draw) + data[head:])
    else:
        records[k] = Piece(opcode, damaged(data, draw))
    packed = b"".join(_raw(*record) for record in records)
    return _encoded(
        Chunk(
            compression="zstd",
            data=zstandard.compress(packed, 1),
            message_end_time=chunk.message_end_time,
            message_start_time=chunk.message_start_time,
            uncompressed_crc=zlib.crc32(packed),
            uncompressed_size=len(packed),
        )
    )[9:]  # fmt: skip


def _records(data: bytes) -> Iterator[Piece]:
    position = 0
    while position < len(data):
        opcode, length = struct.unpack_from("<BQ", data, position)
        position += 9 + length
        yield Piece(opcode, data[position - length : position])


def _index_of(chunk: Chunk, place: int, size: int) -> ChunkIndex:
    return ChunkIndex(
        chunk_length=size,
        chunk_start_offset=place,
        compression=chunk.compression,
        compressed_size=len(chunk.data),
        message_end_time=chunk.message_end_time,
        message_index_length=0,
        message_index_offsets={},
        message_start_time=chunk.message_start_time,
        uncompressed_size=chunk.uncompressed_size,
    )


def _raw(opcode: int, body: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(body)) + body


def _encoded(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()


def _stream(body: bytes) -> ReadDataStream:
    return ReadDataStream(io.BytesIO(body))
