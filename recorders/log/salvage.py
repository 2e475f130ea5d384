"""What can be read of a damaged log: every chunk that is whole, wherever it stands."""

from __future__ import annotations

import io
import re
import struct
from bisect import bisect_left
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import BinaryIO, Final

from mcap.opcode import Opcode
from mcap.records import Metadata
from mcap.writer import MCAP0_MAGIC

from mapreplay.errors import LogError, MapreplayError
from mapreplay.recorders.log.codec import decode_step
from mapreplay.recorders.log.header import Pairs
from mapreplay.recorders.log.limits import MAX_METADATA_BYTES, MAX_NAMES, check_count
from mapreplay.recorders.log.mcap.index import (
    Index,
    Tail,
    chunk_at,
    find_chunks,
    read_index,
    read_summary,
)
from mapreplay.recorders.log.mcap.reader import DAMAGE, Block, Span, read_block, stream
from mapreplay.recorders.log.reader import STEP_TOPICS, EpisodeLog, reason_of
from mapreplay.recorders.log.survey import Survey
from mapreplay.step import Step

_PREFIX: Final = struct.Struct("<BQ")
_MESSAGE: Final = struct.Struct("<BQHIQQ")
_MESSAGE_HEAD: Final = re.compile(rb"\x05[\s\S]{4}\0\0\0\0", re.DOTALL)
_WINDOW: Final = 1 << 20
_FIXED: Final = {Opcode.FOOTER: 20, Opcode.DATA_END: 4}
_OTHERS: Final = range(0x80, 0x100)
"""Opcodes that MCAP leaves to everybody."""
_LOOSE: Final = frozenset({Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE})


class SalvagedLog(EpisodeLog):
    """A log of which everything is left out that cannot be read.

    It has no ending: how the episode ended is what its steps say.
    """

    damages: list[str]
    """What cannot be read and why, a line each."""

    @property
    def tail(self) -> Tail | None:
        """What follows the end of the log."""
        return self.state.tail

    def readable_steps(self) -> Iterator[Step]:
        """The steps that can be decoded, in order.

        Raises:
            LogError: the file can no longer be read.
        """
        with self._reading() as file:
            for index, messages in self._steps_in(file, self._blocks, STEP_TOPICS):
                try:
                    step = decode_step(messages, index, self.header)
                except (*DAMAGE, MapreplayError) as error:
                    reason = reason_of(error).removeprefix(f"step {index}: ")
                    self.damages.append(f"step {index}: {reason}")
                    continue
                yield step

    def _read_index(self, file: BinaryIO) -> Index:
        self.damages = []
        try:
            index = read_index(file)
        except DAMAGE:
            index = _search(file)
        return replace(index, is_ours=False)

    def _survey(self, file: BinaryIO, index: Index) -> Survey:
        found = Survey(index.channels)
        for block in index.blocks:
            try:
                found.add(block, read_block(file, block))
            except (*DAMAGE, MapreplayError) as error:
                self.damages.append(f"the chunk at byte {block.offset}: {reason_of(error)}")
        return found

    def _find_metadata(self, file: BinaryIO, name: str) -> Pairs | None:
        """The record of that name, also where its prefix, or the index, is damaged."""
        try:
            found = super()._find_metadata(file, name)
        except DAMAGE:
            found = None
        return found or _search_metadata(file, name)

    def _without_truth(self) -> LogError:
        if self.damages:
            return LogError(
                f"its true map cannot be read ({self.damages[0]}); nothing can be saved without it"
            )
        return super()._without_truth()

    def _damaged(self, reason: str) -> str:
        return f"damaged ({reason}), and nothing can be saved without that; copy it again"


def _search(file: BinaryIO) -> Index:
    """What is there, with the help of the summary as far as that can be read."""
    size = file.seek(0, io.SEEK_END)
    known = read_summary(file)
    index = known or Index("", "", size, size, is_closed=False)
    offsets = sorted(block.offset for block in index.blocks)
    blocks, end = [], 0
    for place in _plausible(file, size, offsets):
        end = place.end
        if place.opcode == Opcode.CHUNK:
            blocks.append(Block(0, 0, place.offset, place.length))
        elif place.opcode in _LOOSE:
            blocks.append(Block(0, 0, place.offset, place.length, is_chunk=False))
        elif place.opcode == Opcode.FOOTER:
            end += len(MCAP0_MAGIC)
    return replace(index, blocks=blocks, end=end, size=size)


def _plausible(file: BinaryIO, size: int, known: Sequence[int]) -> Iterator[Span]:
    """The records of a damaged file; where one makes no sense, from the next that does.

    Args:
        file: Open for reading.
        size: Of the file.
        known: Where its index says that chunks begin, in order.
    """
    offset = len(MCAP0_MAGIC)
    while offset < size:
        place = _place_at(file, offset, size)
        if place is not None:
            yield place
            if place.opcode == Opcode.FOOTER:
                return
            if place.end == size or _place_at(file, place.end, size) is not None:
                offset = place.end
                continue
        offset = _next_place(file, offset + 1, size, known)


def _place_at(file: BinaryIO, offset: int, size: int) -> Span | None:
    """The record at `offset`; a chunk also where only its prefix is damaged."""
    file.seek(offset)
    head = file.read(_PREFIX.size)
    if len(head) < _PREFIX.size:
        return None
    opcode, length = _PREFIX.unpack(head)
    if (chunk := chunk_at(file, offset, size)) is not None:
        return chunk
    place = Span(opcode, offset, _PREFIX.size + length)
    is_known = opcode in _OTHERS or 0 < opcode <= max(Opcode)
    if not is_known or place.end > size or _FIXED.get(Opcode(opcode), length) != length:
        return None
    return place


def _next_place(file: BinaryIO, start: int, size: int, known: Sequence[int]) -> int:
    """Where the next chunk, or message without a chunk, begins; `size` if there is none."""
    chunk = next(find_chunks(file, start, size), None)
    end = size if chunk is None else chunk.offset
    number = bisect_left(known, start)
    if number < len(known):
        end = min(end, known[number])
    return next(_messages(file, start, end), end)


def _messages(file: BinaryIO, start: int, end: int) -> Iterator[int]:
    """Where a message without a chunk begins, which is logged when it was published."""
    for position in range(start, end, _WINDOW):
        file.seek(position)
        data = file.read(_WINDOW + _MESSAGE.size)
        for match in _MESSAGE_HEAD.finditer(data):
            at = position + match.start()
            if at >= end or match.start() + _MESSAGE.size > len(data):
                continue
            _, length, _, _, log_time, publish_time = _MESSAGE.unpack_from(data, match.start())
            if log_time == publish_time and at + _PREFIX.size + length <= end:
                yield at


def _search_metadata(file: BinaryIO, name: str) -> Pairs | None:
    """The metadata of that name, by the name alone."""
    wanted = struct.pack("<I", len(name)) + name.encode()
    file.seek(0)
    data = file.read(MAX_METADATA_BYTES)
    for count, match in enumerate(re.finditer(re.escape(wanted), data)):
        check_count("metadata records", count, MAX_NAMES)
        try:
            pairs: Pairs = Metadata.read(stream(data[match.start() :])).metadata
        except DAMAGE:
            continue
        return pairs
    return None
