"""Reading an episode back: the same Steps, from finished files and from unfinished ones."""

from __future__ import annotations

import os
import struct
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from enum import StrEnum
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Final, NamedTuple, TypeVar

import zstandard
from mcap.exceptions import McapError
from mcap.opcode import Opcode

from mapreplay.errors import LogError, MapreplayError
from mapreplay.grid import Grid, Quantized
from mapreplay.recorders.log import step_table as table
from mapreplay.recorders.log.header import (
    EPISODE_RECORD,
    OUTCOME_RECORD,
    Pairs,
    check_episode_pairs,
    header_of,
    summary_of,
)
from mapreplay.recorders.log.limits import MAX_NAMES, check_count
from mapreplay.recorders.log.mcap.index import Index, read_index
from mapreplay.recorders.log.mcap.reader import (
    Channels,
    is_mcap,
    read_attachment,
    read_chunk,
    read_metadata,
    read_record,
    read_records,
    unpack,
)
from mapreplay.recorders.log.messages import (
    Messages,
    Topic,
    decode_map,
    decode_prediction,
    decode_step,
    decode_truth,
)
from mapreplay.step import FIRST_STAMP_NS, STEP_NS, EpisodeHeader, Outcome, Step

if TYPE_CHECKING:
    import polars as pl

_T = TypeVar("_T")

_DAMAGE: Final = (
    ArithmeticError,
    AttributeError,
    LookupError,
    McapError,
    MemoryError,
    RecursionError,
    struct.error,
    TypeError,
    ValueError,
    zstandard.ZstdError,
)
"""What the libraries raise when bytes are not what they should be."""


class MapName(StrEnum):
    """The maps that every step has."""

    OBSERVED = "observed"
    P_WALL = "p_wall"
    FUSED = "fused"

    @property
    def topic(self) -> Topic:
        """Where it is logged."""
        return Topic(f"/map/{self}")


_STEP_TOPICS: Final = frozenset(Topic) - {Topic.TRUTH, Topic.TF, Topic.PREDICTED}
"""What a Step is read from: the others repeat it for viewers."""


class EpisodeLog:
    """A log of one episode; opening it checks its checksums and reads what it says once.

    Finished files (``.mcap``) are checked whole when they are opened. Unfinished ones, such
    as the ``.mcap.part`` that a killed run leaves, and files that were cut off, are read up to
    their last complete chunk, whose checksum is checked as it is read.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        """Open the file at `path`.

        Raises:
            LogError: it cannot be read, is damaged, was written by a newer version, or is not
                a log of this package.
        """
        self.path: Final = Path(path)
        with self._reading() as file:
            if not is_mcap(file):
                raise LogError("not an MCAP file")
            self._index = self._read_index(file)
            pairs = self._find_metadata(file, EPISODE_RECORD)
            if pairs is None:
                raise LogError(f"no log of mapreplay: it has no metadata {EPISODE_RECORD!r}")
            check_episode_pairs(pairs)
            self.header: Final = self._read_header(file, pairs)
            ending = self._find_metadata(file, OUTCOME_RECORD) if self._index else None
            self.summary: Final = None if ending is None else summary_of(ending)
            """How the episode ended; None if the log is unfinished, with an `outcome` of None
            if it was recovered."""

    @property
    def finished(self) -> bool:
        """Whether the log is whole: its last step was written, and nothing was cut off."""
        return self.outcome is not None

    @property
    def outcome(self) -> Outcome | None:
        """How the episode ended; None if the log is unfinished, also if it was recovered."""
        return self.summary.outcome if self.summary else None

    def __len__(self) -> int:
        """Number of steps, the one at the start included."""
        return self._length

    @cached_property
    def _length(self) -> int:
        if self.summary:
            return self.summary.steps + 1
        with self._reading() as file:
            return sum(1 for _ in _steps_of(_chunks(file), (), Channels()))

    def __iter__(self) -> Iterator[Step]:
        return self.steps()

    def steps(self) -> Iterator[Step]:
        """All steps in order; one chunk at a time is in memory.

        Raises:
            LogError: the file is damaged or can no longer be read.
        """
        return self._decoded(
            _STEP_TOPICS, lambda messages, index: decode_step(messages, index, self.header)
        )

    def steps_with_messages(self) -> Iterator[tuple[Step, Messages]]:
        """All steps in order, each with the messages of all topics that it was read from.

        Raises:
            LogError: the file is damaged or can no longer be read.
        """

        def decode(messages: Messages, index: int) -> tuple[Step, Messages]:
            return decode_step(messages, index, self.header), messages

        return self._decoded(tuple(Topic), decode)

    def maps(self, *names: str) -> Iterator[tuple[Grid | Quantized | None, ...]]:
        """The named maps of all steps in order: arrays [H, W] that own their memory.

        Nothing else is decoded; ``for observed, p_wall in log.maps("observed", "p_wall")``
        is the quick way to the arrays.

        Args:
            names: Of "observed" and "fused" (int8), "p_wall" (as it was quantized, or None).

        Raises:
            LogError: the file is damaged or can no longer be read.
            ValueError: there is no map of that name.
        """
        plan = self.header.floor_plan
        topics = [MapName(name).topic for name in names]

        def decode(messages: Messages, _: int) -> tuple[Grid | Quantized | None, ...]:
            return tuple(
                decode_prediction(messages, plan)
                if topic is Topic.P_WALL
                else decode_map(messages, topic, plan)
                for topic in topics
            )

        return self._decoded(topics, decode)

    def __getitem__(self, index: int) -> Step:
        """Step `index`; negative ones count from the end. Finished logs are not read through.

        Raises:
            IndexError: there is no such step.
            LogError: the file is damaged or can no longer be read.
        """
        k = index + len(self) if index < 0 else index
        if not 0 <= k < len(self):
            raise IndexError(f"step {index} of {len(self)}")
        with self._reading() as file:
            found = self._index
            chunks = _seek(file, found, k) if found else _chunks(file)
            channels = found.channels if found else Channels()
            for step, messages in _steps_of(chunks, _STEP_TOPICS, channels):
                if step == k:
                    return decode_step(messages, k, self.header)
            raise ValueError(f"step {k} is missing")

    def table(self) -> pl.DataFrame:
        """The scalars of all steps; see `mapreplay.recorders.log.step_table.table_of`.

        Read from the attachment, or for an unfinished log from its steps.

        Raises:
            LogError: the file is damaged or can no longer be read.
        """
        if self.summary is None:
            return table.table_of([table.row_of(step) for step in self.steps()])
        with self._reading() as file:
            offset = self._index.attachments.get(table.ATTACHMENT) if self._index else None
            if offset is None:
                raise ValueError(f"it has no attachment {table.ATTACHMENT}")
            body = read_record(file, offset, Opcode.ATTACHMENT)
            return table.from_parquet(read_attachment(body).data, rows=len(self))

    def _decoded(
        self, wanted: Collection[Topic], decode: Callable[[Messages, int], _T]
    ) -> Iterator[_T]:
        """What `decode` makes of the `wanted` messages of each step, and of its index."""
        with self._reading() as file:
            count = 0
            for index, messages in _steps_of(_chunks(file), wanted, Channels()):
                if index != count:
                    raise ValueError(f"step {count} is missing")
                yield decode(messages, index)
                count += 1
            if self.summary and count != len(self):
                raise ValueError(f"{count} steps, and not {len(self)}")

    def _read_index(self, file: BinaryIO) -> Index | None:
        return read_index(file)

    def _find_metadata(self, file: BinaryIO, name: str) -> Pairs | None:
        if self._index:
            offset = self._index.metadata.get(name)
            if offset is None:
                return None
            return read_metadata(read_record(file, offset, Opcode.METADATA)).metadata
        for count, record in enumerate(read_records(file, wanted={Opcode.METADATA})):
            check_count("metadata records", count, MAX_NAMES)
            metadata = read_metadata(record.body)
            if metadata.name == name:
                return metadata.metadata
        return None

    def _read_header(self, file: BinaryIO, pairs: Pairs) -> EpisodeHeader:
        for records in islice(_chunks(file), 1):  # where the writer puts it
            for message in unpack(records, Channels(), {Topic.TRUTH}):
                resolution = float(pairs["resolution"])
                plan = decode_truth(message.data, pairs["floor_plan_id"], resolution)
                return header_of(pairs, plan)
        raise LogError("cut off before the true map; nothing in it can be read")

    @contextmanager
    def _reading(self) -> Iterator[BinaryIO]:
        """The open file; whatever is wrong with it becomes a LogError that names it."""
        try:
            with self.path.open("rb") as file:
                yield file
        except MapreplayError as error:
            raise LogError(f"{self.path}: {error}") from None
        except OSError as error:
            raise LogError(f"{self.path}: cannot be read ({error.strerror or error})") from None
        except _DAMAGE as error:
            reason = " ".join(str(error).split())[:200] or type(error).__name__
            if isinstance(error, KeyError):
                reason += " is missing"
            raise LogError(
                f"{self.path}: damaged ({reason}); copy it again, or record it again"
            ) from None


class SalvagedLog(EpisodeLog):
    """A log read as if its index had been cut off: up to its first damaged chunk."""

    def _read_index(self, file: BinaryIO) -> None:  # noqa: ARG002
        return None


class _StepMessages(NamedTuple):
    """The messages of one step."""

    step: int
    by_topic: dict[str, list[memoryview]]


def _chunks(file: BinaryIO) -> Iterator[bytes]:
    """The records of all chunks."""
    for record in read_records(file, wanted={Opcode.CHUNK}):
        yield read_chunk(record.body)


def _seek(file: BinaryIO, index: Index, step: int) -> Iterator[bytes]:
    """The records of the chunks that `step` is in."""
    for chunk in index.chunks_at(FIRST_STAMP_NS + step * STEP_NS):
        yield read_chunk(read_record(file, chunk.offset, Opcode.CHUNK))


def _steps_of(
    chunks: Iterator[bytes], wanted: Collection[Topic], channels: Channels
) -> Iterator[_StepMessages]:
    """The `wanted` messages by step; a step without metrics was cut off and is left out.

    All messages of a step are in one chunk, in any order. `channels` learns those that the
    chunks declare.

    Raises:
        ValueError: a message is logged at another time than its step's.
    """
    for records in chunks:
        steps: dict[int, dict[str, list[memoryview]]] = {}
        for topic, step, data, log_time in unpack(records, channels, {*wanted, Topic.METRICS}):
            if log_time != FIRST_STAMP_NS + step * STEP_NS:
                raise ValueError(f"a message of step {step} is logged at {log_time} ns")
            steps.setdefault(step, {}).setdefault(topic, []).append(data)
        for step in sorted(steps):
            if Topic.METRICS in steps[step]:
                yield _StepMessages(step, steps[step])
