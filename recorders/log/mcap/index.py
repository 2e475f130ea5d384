"""Where the chunks, metadata and attachments of a file are, and where the log in it ends.

A log of ours says so itself, in the summary at its end. Other tools leave that out, put other
messages into a chunk, or none into chunks: their files are walked through record by record, like
those that were cut off.
"""

from __future__ import annotations

import io
import re
import struct
import zlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import BinaryIO, Final

from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import AttachmentIndex, Header, MetadataIndex
from mcap.writer import MCAP0_MAGIC

from mapreplay.recorders.log.limits import (
    MAX_INDEX_BYTES,
    MAX_LOOSE_BYTES,
    MAX_METADATA_BYTES,
    MAX_NAMES,
    MAX_STEPS,
    check_count,
    check_size,
)
from mapreplay.recorders.log.mcap.reader import (
    DAMAGE,
    Block,
    Channels,
    Span,
    body_of,
    places,
    read_chunk,
    read_record,
    stream,
)
from mapreplay.step import FIRST_STAMP_NS, OURS, STEP_NS

_PREFIX: Final = struct.Struct("<BQ")
_FOOTER: Final = struct.Struct("<BQQQI")
_DATA_END: Final = struct.Struct("<BQI")
_CHUNK: Final = struct.Struct("<QQQQI")
_NAME: Final = struct.Struct("<I")
_LENGTH: Final = struct.Struct("<Q")
_ATTACHMENT: Final = struct.Struct("<QQ")
_BLOCK: Final = 1 << 20
_ANYWHERE: Final = (0, MAX_STEPS)
"""The steps of a block of which that is not known yet."""
_LOOSE: Final = frozenset({Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE})
"""Records that stand in chunks, or in none."""


@dataclass(frozen=True)
class Index:
    """Where everything is in a file."""

    profile: str
    """Such as ``ros2``."""
    library: str
    """What wrote it."""
    size: int
    """Of the file."""
    end: int
    """Behind the last byte of the log."""
    is_closed: bool
    """Whether it ends with a footer, as a log does that nothing was cut off from."""
    is_ours: bool = False
    """Whether it is laid out as this package does it: each step in one chunk, and chunks in the
    order of the steps, with all checksums. Then `blocks` say which steps they have."""
    channels: Channels = field(default_factory=Channels)
    blocks: list[Block] = field(default_factory=list)
    metadata: dict[str, int] = field(default_factory=dict)
    """Where the first record of each name begins."""
    attachments: dict[str, int] = field(default_factory=dict)
    """Likewise."""


def read_index(file: BinaryIO) -> Index:
    """Find everything; of a file that is closed, its checksums are checked.

    Raises:
        ValueError: a checksum does not match, or the index is larger than a log's may be.
        McapError, struct.error: the index makes no sense.
    """
    size = file.seek(0, io.SEEK_END)
    try:
        index = _read_summary(file, size, size)
    except (ValueError, McapError, struct.error):
        # What stands at the end of the file may be of another one that was appended.
        index = walk(file, size)
        if not index.is_closed or index.end == size:
            raise
    else:
        if index is not None and index.is_ours:
            return index
        index = _checked(walk(file, size), index)
    if not index.is_closed or index.end == size:
        return index
    return _read_ours(file, index) or index


def _read_ours(file: BinaryIO, walked: Index) -> Index | None:
    index = _read_summary(file, walked.end, walked.size)
    return index if index is not None and index.is_ours else None


def _checked(walked: Index, summary: Index | None) -> Index:
    """What was found, with the channels of the summary, which names the same places."""
    if summary is None:
        return walked
    for named, found in (
        (summary.metadata, walked.metadata),
        (summary.attachments, walked.attachments),
    ):
        for name, offset in named.items():
            if found.get(name) != offset:
                raise ValueError(f"its index says that {name} is at byte {offset}")
    return replace(walked, channels=summary.channels)


def read_summary(file: BinaryIO) -> Index | None:
    """What the summary at the end of a file says, whether the checksums are right or not.

    None if it cannot be read.
    """
    size = file.seek(0, io.SEEK_END)
    try:
        found = _find_summary(file, size)
        return None if found is None else _parse(file, found[0], size, size)
    except DAMAGE:
        return None


def _find_summary(file: BinaryIO, end: int) -> tuple[int, int] | None:
    """Where the summary begins, and its checksum; None if there is none."""
    tail_size = _FOOTER.size + len(MCAP0_MAGIC)
    if end < tail_size + len(MCAP0_MAGIC):
        return None
    file.seek(end - tail_size)
    tail = file.read(tail_size)
    opcode, length, start, _, crc = _FOOTER.unpack(tail[: _FOOTER.size])
    if not tail.endswith(MCAP0_MAGIC) or (opcode, length) != (Opcode.FOOTER, 20) or start == 0:
        return None
    if not len(MCAP0_MAGIC) + _DATA_END.size <= start <= end - tail_size:
        raise ValueError("its index is outside of the file")
    check_size("an index", end - start, MAX_INDEX_BYTES)
    return start, crc


def _read_summary(file: BinaryIO, end: int, size: int) -> Index | None:
    """The summary of the log that ends at `end`, after checking every byte of it."""
    found = _find_summary(file, end)
    if found is None:
        return None
    start, index_crc = found
    data_end = start - _DATA_END.size
    file.seek(data_end)
    opcode, length, data_crc = _DATA_END.unpack(file.read(_DATA_END.size))
    if (opcode, length) != (Opcode.DATA_END, 4):
        raise ValueError("its index is not where it should be")
    # 0 means that whoever wrote the file did not compute it.
    if index_crc and _crc(file, start, end - len(MCAP0_MAGIC) - 4) != index_crc:
        raise ValueError("the checksum of its index does not match")
    if data_crc and _crc(file, 0, data_end) != data_crc:
        raise ValueError("the checksum of its data does not match")
    index = _parse(file, start, end, size)
    return replace(index, is_ours=index.is_ours and bool(index_crc and data_crc))


def _parse(file: BinaryIO, start: int, end: int, size: int) -> Index:
    index = Index(*_read_header(file), size, end, is_closed=True)
    strange, footer = False, 0
    for place in places(file, start, end):
        if place.opcode == Opcode.CHUNK_INDEX:
            block, compression = _read_chunk_index(body_of(file, place))
            strange |= compression != b"zstd" or block.first < 0
            index.blocks.append(block)
        elif place.opcode == Opcode.METADATA_INDEX:
            metadata = MetadataIndex.read(stream(body_of(file, place)))
            index.metadata.setdefault(metadata.name, metadata.offset)
            check_count("metadata records", len(index.metadata), MAX_NAMES)
        elif place.opcode == Opcode.ATTACHMENT_INDEX:
            attachment = AttachmentIndex.read(stream(body_of(file, place)))
            index.attachments.setdefault(attachment.name, attachment.offset)
            check_count("attachments", len(index.attachments), MAX_NAMES)
        elif place.opcode == Opcode.SCHEMA:
            index.channels.declare_type(body_of(file, place))
        elif place.opcode == Opcode.CHANNEL:
            index.channels.declare(body_of(file, place))
        elif place.opcode == Opcode.FOOTER:
            footer = place.end
    if footer != end - len(MCAP0_MAGIC):  # the index of another log, which lies in the middle
        raise ValueError("its index does not reach to its end")
    steps = [(block.first, block.last) for block in index.blocks[1:]]  # the first has the truth
    # A step in two chunks, or steps in any order, can be read, but not chunk by chunk.
    apart = all(a[1] < b[0] for a, b in pairwise(steps))
    begins = not steps or steps[0][0] == 0
    ours = index.library == OURS and bool(index.blocks) and not strange and apart and begins
    return replace(index, is_ours=ours)


def _read_chunk_index(body: bytes) -> tuple[Block, bytes]:
    """The chunk, of which steps -1 are those at a time that is none of ours; its compression."""
    first, last, offset, length, skipped = _CHUNK.unpack_from(body)
    place = _CHUNK.size + skipped + 8
    (count,) = _NAME.unpack_from(body, place)
    compression = body[place + _NAME.size :][:count]
    steps = [_step_at(first), _step_at(last)]
    return Block(min(steps), max(steps) if min(steps) >= 0 else -1, offset, length), compression


def _step_at(stamp_ns: int) -> int:
    step, rest = divmod(stamp_ns - FIRST_STAMP_NS, STEP_NS)
    return step if rest == 0 and 0 <= step < MAX_STEPS else -1


def walk(file: BinaryIO, size: int) -> Index:
    """Find everything record by record, up to where the log ends.

    Raises:
        ValueError: there is more of it behind what cannot be read, or the checksum of the data
            does not match.
    """
    index = Index(*_read_header(file), size, 0, is_closed=False)
    end = len(MCAP0_MAGIC)
    is_closed = False
    loose: Span | None = None  # records without a chunk, all together
    counts = Counter[int]()
    for place in places(file, end, size):
        counts[place.opcode] += 1
        joined = loose is not None and loose.length + place.length <= MAX_LOOSE_BYTES
        if loose is not None and not (joined and place.opcode in _LOOSE):
            index.blocks.append(Block(*_ANYWHERE, loose.offset, loose.length, is_chunk=False))
            loose = None
        end = place.end
        if place.opcode in _LOOSE:
            loose = Span(0, *(loose or place)[1:])
            loose = loose._replace(length=place.end - loose.offset)
        elif place.opcode == Opcode.CHUNK:
            index.blocks.append(Block(*_ANYWHERE, place.offset, place.length))
        elif place.opcode == Opcode.DATA_END:
            _check_data(file, place)
            break
        elif place.opcode == Opcode.METADATA:
            index.metadata.setdefault(_name_of(file, place, 0), place.offset)
            check_count("metadata records", counts[place.opcode], MAX_NAMES)
        elif place.opcode == Opcode.ATTACHMENT:
            index.attachments.setdefault(_name_of(file, place, _ATTACHMENT.size), place.offset)
            check_count("attachments", counts[place.opcode], MAX_NAMES)
    if loose is not None:
        index.blocks.append(Block(*_ANYWHERE, loose.offset, loose.length, is_chunk=False))
    for place in places(file, end, size):  # the summary, if there is one
        end = place.end
        if place.opcode == Opcode.FOOTER:
            file.seek(end)
            is_closed = file.read(len(MCAP0_MAGIC)) == MCAP0_MAGIC
            end += len(MCAP0_MAGIC) if is_closed else 0
    if not is_closed:
        _check_rest(file, end, size)
    return replace(index, end=end, is_closed=is_closed)


def _check_rest(file: BinaryIO, end: int, size: int) -> None:
    """Make sure that nothing of the log is behind a record at `end` that cannot be read."""
    if _starts_with(file, end, MCAP0_MAGIC):
        return
    closed = size >= len(MCAP0_MAGIC) and _starts_with(file, size - len(MCAP0_MAGIC), MCAP0_MAGIC)
    if (closed and end < size) or any(is_whole(file, c) for c in find_chunks(file, end, size)):
        raise ValueError(f"the record at byte {end} cannot be read, but others behind it can")


def _starts_with(file: BinaryIO, offset: int, start: bytes) -> bool:
    file.seek(offset)
    return file.read(len(start)) == start


@dataclass(frozen=True)
class Tail:
    """What follows the end of a log in its file, and is not read."""

    size: int
    """In bytes."""
    what: str
    """Such as "another MCAP file", or empty."""

    def __str__(self) -> str:
        follow = "1 byte follows" if self.size == 1 else f"{self.size} bytes follow"
        what = f" ({self.what})" if self.what else ""
        verb = "was" if self.size == 1 else "were"
        return f"{follow} the end of the log{what} and {verb} not read"


def tail_of(file: BinaryIO, index: Index) -> Tail | None:
    """What follows the end of the log; None also where a record of its own is cut off there."""
    size = index.size - index.end
    if size <= 0:
        return None
    if _starts_with(file, index.end, MCAP0_MAGIC):
        return Tail(size, "another MCAP file")
    file.seek(index.end)
    if not any(any(block) for block in iter(lambda: file.read(_BLOCK), b"")):
        return Tail(size, "nothing but zeros")
    return Tail(size, "") if index.is_closed else None


def _name_of(file: BinaryIO, place: Span, before: int) -> str:
    """The name that stands in a record after `before` bytes of its body."""
    file.seek(place.end - place.length + 9 + before)
    (length,) = _NAME.unpack(file.read(_NAME.size))
    check_size("a name", length, min(MAX_METADATA_BYTES, place.length))
    return file.read(length).decode(errors="replace")


def _check_data(file: BinaryIO, place: Span) -> None:
    (crc,) = _NAME.unpack_from(body_of(file, place))
    if crc and _crc(file, 0, place.offset) != crc:
        raise ValueError("the checksum of its data does not match")


def _read_header(file: BinaryIO) -> tuple[str, str]:
    """The profile and the library that wrote the file; empty where the header is damaged."""
    try:
        body = read_record(file, len(MCAP0_MAGIC), Opcode.HEADER)
        check_size("a header", len(body), MAX_METADATA_BYTES)
        header = Header.read(stream(body))
    except (ValueError, McapError, struct.error):
        return "", ""
    return header.profile, header.library


def _crc(file: BinaryIO, start: int, stop: int) -> int:
    crc = 0
    file.seek(start)
    for position in range(start, stop, _BLOCK):
        crc = zlib.crc32(file.read(min(_BLOCK, stop - position)), crc)
    return crc


def find_chunks(file: BinaryIO, start: int, size: int) -> Iterator[Span]:
    """What looks like a compressed chunk from `start` on, wherever it stands.

    A chunk says twice how long it is; here the inner length counts. They end where another MCAP
    file begins.
    """
    for position in _search(file, start, size):
        if _starts_with(file, position, MCAP0_MAGIC):
            return
        if (place := chunk_at(file, position, size)) is not None:
            yield place


def chunk_at(file: BinaryIO, offset: int, size: int) -> Span | None:
    """The chunk at `offset`, by what is in it and not by its prefix; None if there is none."""
    file.seek(offset + _PREFIX.size + _TO_COMPRESSION)
    head = file.read(_NAME.size + _LONGEST_NAME + _LENGTH.size)
    for name in _COMPRESSIONS:
        packed = _NAME.pack(len(name)) + name
        if head.startswith(packed) and len(head) >= len(packed) + _LENGTH.size:
            (length,) = _LENGTH.unpack_from(head, len(packed))
            whole = _PREFIX.size + _TO_COMPRESSION + len(packed) + _LENGTH.size + length
            return Span(Opcode.CHUNK, offset, whole) if offset + whole <= size else None
    return None


def is_whole(file: BinaryIO, place: Span) -> bool:
    """Whether the chunk at `place` can be read, and its checksum is right."""
    try:
        read_chunk(body_of(file, place))
    except DAMAGE:
        return False
    return True


_TO_COMPRESSION: Final = 28
"""Bytes of a chunk before it says how it is compressed."""
_COMPRESSIONS: Final = (b"zstd", b"lz4")
_LONGEST_NAME: Final = max(map(len, _COMPRESSIONS))
_MARKS: Final = {MCAP0_MAGIC: 0} | {
    _NAME.pack(len(name)) + name: _PREFIX.size + _TO_COMPRESSION for name in _COMPRESSIONS
}
"""What stands in each compressed chunk, and in each file, and how far from its first byte."""


def _search(file: BinaryIO, start: int, size: int) -> Iterator[int]:
    """Where a chunk or a file may begin."""
    pattern = re.compile(b"|".join(map(re.escape, _MARKS)))
    for position in range(start, size, _BLOCK):
        file.seek(position)
        data = file.read(_BLOCK + _LONGEST_MARK - 1)
        for match in pattern.finditer(data):
            begin = position + match.start() - _MARKS[match[0]]
            if begin >= start and match.start() < _BLOCK:
                yield begin


_LONGEST_MARK: Final = max(map(len, _MARKS))
