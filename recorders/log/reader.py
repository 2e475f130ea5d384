"""Reading an episode back: the same Steps, from finished files and from unfinished ones, and
from those that another tool has packed in another way.
"""

from __future__ import annotations

import os
import shlex
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from enum import StrEnum
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Final, NamedTuple, TypeAlias, TypeVar, overload

from mcap.opcode import Opcode

from mapreplay.errors import LogError, MapreplayError
from mapreplay.files.identify import identify_file
from mapreplay.files.whole import open_regular
from mapreplay.grid import Grid, Quantized
from mapreplay.recorders.log import step_table
from mapreplay.recorders.log.codec import (
    Messages,
    decode_events,
    decode_map,
    decode_prediction,
    decode_step,
    decode_truth,
)
from mapreplay.recorders.log.find import whereabouts
from mapreplay.recorders.log.header import (
    EPISODE_RECORD,
    NO_STEPS,
    OUTCOME_RECORD,
    EpisodeSummary,
    Pairs,
    check_episode_pairs,
    header_of,
    missing_of,
    summary_of,
)
from mapreplay.recorders.log.lock import is_locked
from mapreplay.recorders.log.mcap.index import Index, read_index, tail_of
from mapreplay.recorders.log.mcap.reader import (
    DAMAGE,
    Block,
    is_mcap,
    read_attachment,
    read_block,
    read_metadata,
    read_record,
    unpack,
)
from mapreplay.recorders.log.parquet import UnknownParquetError
from mapreplay.recorders.log.state import Condition, LogState, gaps_in, span_words
from mapreplay.recorders.log.survey import StepMessages, Survey, steps_in, survey
from mapreplay.recorders.log.topics import Topic, missing, stamp_ns_of
from mapreplay.step import OURS, EpisodeHeader, Event, Outcome, Step

if TYPE_CHECKING:
    import polars as pl

_T = TypeVar("_T")


class MapName(StrEnum):
    """The maps that every step has."""

    OBSERVED = "observed"
    P_WALL = "p_wall"
    FUSED = "fused"

    @property
    def topic(self) -> Topic:
        """Where it is logged."""
        return Topic(f"/map/{self}")


NO_STEPS_KEPT: Final = (
    "holds scalars only; to have its steps, run the experiment again with --keep-logs"
)

Stamps: TypeAlias = "list[tuple[Topic, int]]"
"""What messages are stamped with, in nanoseconds of simulated time."""

STEP_TOPICS: Final = frozenset(Topic) - {Topic.TRUTH, Topic.TF, Topic.PREDICTED}
"""What a Step is read from: the others repeat it for viewers."""


class _Near(NamedTuple):
    """The messages of the steps in some blocks of a file, undecoded."""

    blocks: tuple[Block, ...]
    steps: Mapping[int, Messages]


_NOTHING_NEAR: Final = _Near((), {})


class EpisodeLog:
    """A log of one episode; opening it checks its checksums and reads what it says once.

    Finished files (``.mcap``) are checked whole when they are opened. Unfinished ones, such
    as the ``.mcap.part`` that a killed run leaves, files that were cut off, and those that
    another tool has packed in another way, are read through once, up to their last complete
    record. What they are, `state` tells.

    Steps keep the numbers that they had: ``log[40]`` is step 40, also of a recovered log that has
    no steps 20 to 39. ``len(log)`` is how many there are; `indices` are their numbers, and `last`
    is that of the last one. Iteration and slices give those that there are, in order.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        """Open the file at `path`, or, if that was finished meanwhile, at its new name.

        Raises:
            LogError: it cannot be read, is damaged, was written by a newer version, or is not
                a log of this package.
        """
        self.path: Final = whereabouts(Path(path))
        with self._reading() as file:
            if not is_mcap(file):
                raise LogError(self._not_mcap())
            index = self._index = self._read_index(file)
            pairs = self._find_metadata(file, EPISODE_RECORD)
            if pairs is None:
                raise LogError(_what_bag(file, index))
            check_episode_pairs(pairs)
            ending = self._find_metadata(file, OUTCOME_RECORD) if index.is_closed else None
            summary = None if ending is None else summary_of(ending)
            found = None if index.is_ours and summary else self._survey(file, index)
            # The true map has a block of its own, and steps have others.
            self.has_steps: Final = found is not None or len(index.blocks) > 1
            """Whether there is more than the scalars of the steps."""
            self._channels: Final = found.channels if found else index.channels
            self._blocks: Final = found.sorted_blocks() if found else index.blocks
            self.header: Final = self._read_header(file, pairs, found)
            if found is None:
                gaps, last = missing_of(ending or {}), summary.steps if summary else -1
                self._numbers: Sequence[int] = _without(last + 1, gaps)
            else:
                self._numbers = found.steps(is_ours=self.header.simulator == OURS)
                last = self._numbers[-1] if self._numbers else -1
                if summary is None and index.is_closed and found.outcome_at(last) is not None:
                    summary = self._summarize()  # another tool has left it out
                elif summary is not None:
                    if not self._numbers:
                        raise missing(Topic.METRICS)
                    last = max(last, summary.steps)
                gaps = gaps_in(self._numbers, last)
            self.summary: Final = summary
            """How the episode ended; None if the log is unfinished, with an `outcome` of None
            if it was recovered."""
            tail = tail_of(file, index)
            self.state: Final = LogState(self._condition(), len(self._numbers), gaps, tail)
            """Whether it is whole, and if not, why."""
        self._near = _NOTHING_NEAR

    def __repr__(self) -> str:
        said = self.outcome or self.state
        return f"EpisodeLog({str(self.path)!r}: {len(self)} steps, {said}, {self.header!r})"

    def __getstate__(self) -> dict[str, object]:
        self.forget()
        return self.__dict__

    def forget(self) -> None:
        """Drop what is kept so that it need not be read twice: the table, and the last chunk."""
        self._near = _NOTHING_NEAR
        self.__dict__.pop("_table", None)

    @property
    def finished(self) -> bool:
        """Whether the whole episode is in it: its last step, and all before."""
        return self.state.finished

    @property
    def outcome(self) -> Outcome | None:
        """How the episode ended; None if the log is unfinished, also if it was recovered."""
        return self.summary.outcome if self.summary and self.finished else None

    @property
    def indices(self) -> Sequence[int]:
        """The numbers of the steps that there are, in order: 0, 1, 2, ... but for a log with
        gaps.
        """
        return self._numbers

    @property
    def last(self) -> int:
        """The number of the last step; -1 if there is none."""
        return self._numbers[-1] if self._numbers else -1

    def check_whole_until(self, last: int, what: str) -> None:
        """Refuse to do what needs all steps up to `last`, if there are gaps among them.

        Raises:
            LogError: there are.
        """
        gaps = [gap for gap in self.state.missing if gap.start <= last]
        if gaps:
            raise LogError(f"{self.path}: {span_words(gaps)} missing; {what} needs all of them")

    @property
    def repacked(self) -> tuple[str, ...]:
        """What in the file is not as this package writes it; empty if all is, or if it is cut off.

        A tool that repacks, filters or merges MCAP files writes checksums, and an index, of its
        own: that these are right says nothing about what we had written.
        """
        if self._index.is_ours or not self._index.is_closed:
            return ()
        by = "mapreplay" if self._index.library == OURS else self._index.library or "another tool"
        said = [f"packed by {by!r} and not as mapreplay does it: its checksums are not ours"]
        if step_table.ATTACHMENT not in self._index.attachments:
            said.append(f"without {step_table.ATTACHMENT}: the scalars were read from its steps")
        if OUTCOME_RECORD not in self._index.metadata:
            said.append(f"without {OUTCOME_RECORD}: the outcome was read from its steps")
        return tuple(said)

    def __len__(self) -> int:
        """Number of steps that there are, the one at the start included."""
        return len(self._numbers)

    def __iter__(self) -> Iterator[Step]:
        return self.steps()

    def steps(self) -> Iterator[Step]:
        """All steps in order; one chunk at a time is in memory.

        Raises:
            LogError: the file is damaged or can no longer be read.
        """
        return self._decoded(
            STEP_TOPICS, lambda messages, index: decode_step(messages, index, self.header)
        )

    def steps_with_stamps(self) -> Iterator[tuple[Step, Stamps]]:
        """All steps in order, each with the stamp of every message of it, in nanoseconds.

        Raises:
            LogError: the file is damaged or can no longer be read.
        """

        def decode(messages: Messages, index: int) -> tuple[Step, Stamps]:
            stamps = [
                (topic, stamp_ns_of(topic, data))
                for topic in Topic
                for data in messages.get(topic, ())
            ]
            return decode_step(messages, index, self.header), stamps

        return self._decoded(tuple(Topic), decode)

    def events(self) -> Iterator[tuple[int, Event]]:
        """The step and the event of everything that happened, in order; no map is decoded.

        Raises:
            LogError: the file is damaged or can no longer be read.
        """

        def decode(messages: Messages, index: int) -> list[tuple[int, Event]]:
            return [(index, event) for event in decode_events(messages)]

        return chain.from_iterable(self._decoded((Topic.EVENTS,), decode))

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

    @overload
    def __getitem__(self, index: int) -> Step: ...

    @overload
    def __getitem__(self, index: slice) -> list[Step]: ...

    def __getitem__(self, index: int | slice) -> Step | list[Step]:
        """Step `index`; negative ones count from the end. Nothing before it is read.

        The last chunk that was read is kept, so that steps in order take as long as iteration.
        A slice is of step numbers, and gives a list of those of them that there are.

        Raises:
            IndexError: there is no such step.
            LogError: the step is missing, as all are in a log that was cut off before the first, or
                the file is damaged or can no longer be read.
        """
        if isinstance(index, slice):
            numbers = range(self.last + 1)[index]
            there = numbers if isinstance(self._numbers, range) else self._number_set
            steps = [self._step(k) for k in sorted(numbers) if k in there]
            return steps if numbers.step > 0 else steps[::-1]
        k = index + self.last + 1 if index < 0 else index
        if not self._numbers:
            raise LogError(f"{self.path}: {self.state}")
        if not 0 <= k <= self.last:
            raise IndexError(f"step {index} of {self.last + 1}")
        self.check_step(k)
        return self._step(k)

    def _step(self, k: int) -> Step:
        blocks = tuple(block for block in self._blocks if block.first <= k <= block.last)
        with self._blaming():
            if not set(blocks) <= set(self._near.blocks):
                with whereabouts(self.path).open("rb") as file:
                    steps = dict(self._steps_in(file, blocks, STEP_TOPICS))
                self._near = _Near(blocks, steps)
            if k not in self._near.steps:
                raise ValueError(f"step {k} is missing")
            return decode_step(self._near.steps[k], k, self.header)

    def check_step(self, index: int) -> None:
        """Refuse a step that is missing in the middle of a log.

        Raises:
            LogError: it is.
        """
        for gap in self.state.missing:
            if index in gap:
                raise LogError(f"{self.path}: {span_words([gap])} missing, which lost {index}")

    def table(self) -> pl.DataFrame:
        """The scalars of all steps; see `mapreplay.recorders.log.step_table.table_of`.

        Read from the attachment if that agrees with the end of the log. An unfinished log, and one
        whose table is not there or was written by another tool, is tabulated from its steps.

        Raises:
            LogError: the file is damaged or can no longer be read, or its table is not that of
                its steps.
        """
        return self._table

    def attached_table(self) -> pl.DataFrame | None:
        """The table that is attached, compared with nothing; None without one that can be read, or
        of other steps than there are.

        Raises:
            LogError: the file or the table is damaged.
        """
        offset = self._index.attachments.get(step_table.ATTACHMENT)
        if offset is None or not self._has_table:
            return None
        with self._reading() as file:
            body = read_record(file, offset, Opcode.ATTACHMENT)
            try:
                return step_table.from_parquet(read_attachment(body).data, self.indices)
            except UnknownParquetError:
                return None

    @cached_property
    def _table(self) -> pl.DataFrame:
        attached = self.attached_table()
        if attached is None or self.summary is None:
            return step_table.table_of([step_table.row_of(step) for step in self.steps()])
        last = self[-1] if self.has_steps else None
        with self._blaming():
            step_table.check_end(attached, last, self.summary, self.header)
        return attached

    @property
    def _has_table(self) -> bool:
        """Whether the table of the file is of the steps that there are."""
        return (
            self.summary is not None
            and self.summary.steps == self.last
            and (self._index.is_ours or not self.state.missing)
        )

    def _decoded(
        self, wanted: Collection[Topic], decode: Callable[[Messages, int], _T]
    ) -> Iterator[_T]:
        """What `decode` makes of the `wanted` messages of each step, and of its index."""
        with self._reading() as file:
            expected = iter(self._numbers)
            for index, messages in self._steps_in(file, self._blocks, wanted):
                if index != (number := next(expected, None)):
                    raise ValueError(f"step {index if number is None else number} is missing")
                yield decode(messages, index)
            if (number := next(expected, None)) is not None:
                raise ValueError(f"step {number} is missing")

    def _steps_in(
        self, file: BinaryIO, blocks: Sequence[Block], wanted: Collection[Topic]
    ) -> Iterator[StepMessages]:
        """The `wanted` messages of the steps in `blocks`, of those that there are.

        Raises:
            LogError: there are only scalars.
        """
        if not self.has_steps:
            raise LogError(NO_STEPS_KEPT)
        found = steps_in(file, blocks, wanted, self._channels)
        if isinstance(self._numbers, range):
            return found
        return (of_step for of_step in found if of_step.step in self._number_set)

    @cached_property
    def _number_set(self) -> frozenset[int]:
        return frozenset(self._numbers)

    def _read_index(self, file: BinaryIO) -> Index:
        return read_index(file)

    def _survey(self, file: BinaryIO, index: Index) -> Survey:
        return survey(file, index.blocks, index.channels)

    def _summarize(self) -> EpisodeSummary:
        """How the episode ended, from its steps."""
        summary = NO_STEPS
        for step in self.steps():
            summary = summary.after(step, self.header.at(step.index).config)
        return summary

    def _condition(self) -> Condition:
        if self.summary is not None:
            if self.summary.outcome is None:
                return Condition.RECOVERED
            return Condition.FINISHED if self.has_steps else Condition.SCALARS_ONLY
        if self._index.is_closed:
            return Condition.UNFINISHED
        if is_locked(self.path):
            return Condition.BEING_WRITTEN
        return Condition.UNFINISHED if self.path.suffix == ".part" else Condition.CUT_OFF

    def _find_metadata(self, file: BinaryIO, name: str) -> Pairs | None:
        offset = self._index.metadata.get(name)
        if offset is None:
            return None
        metadata = read_metadata(read_record(file, offset, Opcode.METADATA))
        if metadata.name != name:
            raise ValueError(f"{name} is not where its index says")
        return metadata.metadata

    def _read_header(self, file: BinaryIO, pairs: Pairs, found: Survey | None) -> EpisodeHeader:
        block = found.truth if found else self._blocks[0]  # where the writer puts it
        if block is None:
            raise self._without_truth()
        for message in unpack(read_block(file, block), self._channels, {Topic.TRUTH}):
            resolution = float(pairs["resolution"])
            plan = decode_truth(message.data, pairs["floor_plan_id"], resolution)
            return header_of(pairs, plan)
        raise self._without_truth()

    def _without_truth(self) -> LogError:
        if self._index.is_closed:
            return missing(Topic.TRUTH)
        return LogError("cut off before the true map; nothing in it can be read")

    def _damaged(self, reason: str) -> str:
        """What is said of damage."""
        command = f"mapreplay recover {shlex.quote(str(self.path))}"
        return f"damaged ({reason}); copy it again, or save what can be read: {command}"

    def _not_mcap(self) -> str:
        if is_locked(self.path):
            return "another process has just begun to write it; nothing can be read yet"
        what = identify_file(self.path)
        return f"not an MCAP file: {what}" if what else "not an MCAP file"

    @contextmanager
    def _reading(self) -> Iterator[BinaryIO]:
        """The open file."""
        with self._blaming(), open_regular(whereabouts(self.path)) as file:
            yield file

    @contextmanager
    def _blaming(self) -> Iterator[None]:
        """Whatever is wrong with the file becomes a LogError that names it."""
        try:
            yield
        except MapreplayError as error:
            told = str(error)
            raise LogError(
                told if told.startswith(f"{self.path}: ") else f"{self.path}: {told}"
            ) from None
        except OSError as error:
            raise LogError(f"{self.path}: {cannot_read(self.path, error)}") from None
        except DAMAGE as error:
            raise LogError(f"{self.path}: {self._damaged(reason_of(error))}") from None


def reason_of(error: Exception) -> str:
    """What a library said of damage, as one short line."""
    reason = " ".join(str(error).split())[:200] or type(error).__name__
    return f"{reason} is missing" if isinstance(error, KeyError) else reason


def cannot_read(path: Path, error: OSError) -> str:
    """Why a file cannot be read, and where it should be if it is a link."""
    reason = f"cannot be read ({error.strerror or error})"
    if path.is_symlink():
        try:
            return f"{reason}: a link to {path.readlink()}"
        except OSError:
            return reason
    return reason


def _without(count: int, gaps: Sequence[range]) -> Sequence[int]:
    """The numbers 0 to count - 1 that are in no gap."""
    if not gaps:
        return range(count)
    starts = [0, *(gap.stop for gap in gaps)]
    stops = [*(gap.start for gap in gaps), count]
    return tuple(chain.from_iterable(map(range, starts, stops)))


_SHOWN: Final = 8


def _what_bag(file: BinaryIO, index: Index) -> str:
    """What an MCAP file is that has no metadata of ours."""
    channels = index.channels
    for block in index.blocks[:_LOOKED_AT]:
        if channels.names:
            break
        with suppress(LogError):  # one of our topics, but not of our type
            for _ in unpack(read_block(file, block), channels, ()):
                pass
    topics = sorted(channels.names)
    if {Topic.TRUTH, Topic.METRICS} <= set(topics):
        return (
            f"has the topics of a log, but no metadata {EPISODE_RECORD!r}, which another tool may "
            "have left out; it cannot be read without it"
        )
    kind = {"ros2": "a ROS 2 bag", "ros1": "a ROS 1 bag in MCAP"}.get(index.profile)
    kind = kind or ("a ROS 2 bag" if channels.encodings == {"cdr"} else "an MCAP file")
    some = ", ".join(topics[:_SHOWN]) + (" ..." if len(topics) > _SHOWN else "")
    return f"{kind} {f'with topics {some}' if topics else 'without topics'}: not a log of mapreplay"


_LOOKED_AT: Final = 16
"""Blocks in which topics are looked for."""
