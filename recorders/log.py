"""Reading an episode back: the same Steps, from finished files and from unfinished ones."""

from __future__ import annotations

import glob
import struct
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Final, NamedTuple

import zstandard
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.summary import Summary

from mapreplay.errors import LogError, MapreplayError
from mapreplay.floorplan import explorable
from mapreplay.grid import Mask
from mapreplay.recorders import table
from mapreplay.recorders.container import (
    Unpacked,
    is_mcap,
    read_chunk,
    read_metadata,
    read_record,
    read_records,
    read_summary,
    unpack,
)
from mapreplay.recorders.messages import Topic, decode_step, decode_truth
from mapreplay.recorders.metadata import (
    EPISODE_RECORD,
    OUTCOME_RECORD,
    Pairs,
    check_episode_pairs,
    header_of,
    summary_of,
)
from mapreplay.step import FIRST_STAMP_NS, STEP_NS, EpisodeHeader, Outcome, Step

if TYPE_CHECKING:
    import polars as pl

SUFFIXES: Final = (".mcap", ".mcap.part")

_DAMAGE: Final = (
    ArithmeticError,
    AttributeError,
    LookupError,
    McapError,
    MemoryError,
    struct.error,
    TypeError,
    ValueError,
    zstandard.ZstdError,
)
"""What the libraries raise when bytes are not what they should be."""


class EpisodeLog:
    """A log of one episode; opening it checks its checksums and reads what it says once.

    Finished files (``.mcap``) are checked whole when they are opened. Unfinished ones, such
    as the ``.mcap.part`` that a killed run leaves, and files that were cut off, are read up to
    their last complete chunk, whose checksum is checked as it is read.
    """

    def __init__(self, path: Path) -> None:
        """Open `path`.

        Raises:
            LogError: it cannot be read, is damaged, was written by a newer version, or is not
                a log of this package.
        """
        self.path: Final = path
        with self._reading() as file:
            if not is_mcap(file):
                raise LogError("not an MCAP file")
            self._index = read_summary(file)
            pairs = self._find_metadata(file, EPISODE_RECORD)
            if pairs is None:
                raise LogError(f"no log of mapreplay: it has no metadata {EPISODE_RECORD!r}")
            check_episode_pairs(pairs)
            self.header: Final = self._read_header(file, pairs)
            ending = self._find_metadata(file, OUTCOME_RECORD) if self._index else None
            self.summary: Final = None if ending is None else summary_of(ending)
            """How the episode ended; None if the log is unfinished."""

    @property
    def finished(self) -> bool:
        """Whether the log is whole: its last step was written, and nothing was cut off."""
        return self.summary is not None

    @property
    def outcome(self) -> Outcome | None:
        """How the episode ended; None if the log is unfinished."""
        return self.summary.outcome if self.summary else None

    @cached_property
    def explorable(self) -> Mask:
        """bool[H, W]: the explorable cells, from the start."""
        return explorable(self.header.floor_plan.cells, self.header.start)

    def __len__(self) -> int:
        """Number of steps, the one at the start included."""
        return self._length

    @cached_property
    def _length(self) -> int:
        if self.summary:
            return self.summary.steps + 1
        with self._reading() as file:
            return sum(1 for _ in _steps_of(_messages(file)))

    def __iter__(self) -> Iterator[Step]:
        return self.steps()

    def steps(self) -> Iterator[Step]:
        """All steps in order; one chunk at a time is in memory.

        Raises:
            LogError: the file is damaged or can no longer be read.
        """
        with self._reading() as file:
            count = 0
            for index, messages in _steps_of(_messages(file)):
                if index != count:
                    raise ValueError(f"step {count} is missing")
                yield decode_step(messages, index, self.header)
                count += 1
            if self.summary and count != len(self):
                raise ValueError(f"{count} steps, and not {len(self)}")

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
            found = _messages(file) if self._index is None else _seek(file, self._index, k)
            for step, messages in _steps_of(found):
                if step == k:
                    return decode_step(messages, k, self.header)
            raise ValueError(f"step {k} is missing")

    def table(self) -> pl.DataFrame:
        """The scalars of all steps; see `mapreplay.recorders.table.table_of`.

        Read from the attachment, or for an unfinished log from its steps.

        Raises:
            LogError: the file is damaged or can no longer be read.
        """
        if not self.finished:
            return table.table_of([table.row_of(step) for step in self.steps()])
        with self._reading() as file:
            for attachment in make_reader(file).iter_attachments():
                if attachment.name == table.ATTACHMENT:
                    return table.from_parquet(attachment.data)
            raise ValueError(f"it has no attachment {table.ATTACHMENT}")

    def _find_metadata(self, file: BinaryIO, name: str) -> Pairs | None:
        if self._index:
            offsets = [entry.offset for entry in self._index.metadata_indexes if entry.name == name]
            if not offsets:
                return None
            return read_metadata(read_record(file, offsets[0], Opcode.METADATA)).metadata
        for record in read_records(file):
            if record.opcode == Opcode.METADATA:
                metadata = read_metadata(record.body)
                if metadata.name == name:
                    return metadata.metadata
        return None

    def _read_header(self, file: BinaryIO, pairs: Pairs) -> EpisodeHeader:
        for topic, message in _messages(file):
            if topic == Topic.TRUTH:
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


class _StepMessages(NamedTuple):
    """The messages of one step."""

    step: int
    by_topic: dict[str, list[bytes]]


def _messages(file: BinaryIO) -> Iterator[Unpacked]:
    """All messages, in the order of the file."""
    topics: dict[int, str] = {}
    for record in read_records(file):
        if record.opcode == Opcode.CHUNK:
            yield from unpack(read_chunk(record.body), topics)


def _seek(file: BinaryIO, index: Summary, step: int) -> Iterator[Unpacked]:
    """The messages of the chunks that `step` is in."""
    stamp = FIRST_STAMP_NS + step * STEP_NS
    topics = {channel.id: channel.topic for channel in index.channels.values()}
    for chunk in index.chunk_indexes:
        if chunk.message_start_time <= stamp <= chunk.message_end_time:
            body = read_record(file, chunk.chunk_start_offset, Opcode.CHUNK)
            yield from unpack(read_chunk(body), topics)


def _steps_of(messages: Iterator[Unpacked]) -> Iterator[_StepMessages]:
    """Messages by step; a step without its last message was cut off and is left out."""
    by_topic: dict[str, list[bytes]] = {}
    for topic, message in messages:
        if topic == Topic.TRUTH:
            continue
        by_topic.setdefault(topic, []).append(message.data)
        if topic == Topic.METRICS:
            yield _StepMessages(message.sequence, by_topic)
            by_topic = {}


def find_logs(paths: Sequence[Path]) -> list[Path]:
    """The logs that files, folders (searched through) and glob patterns stand for, sorted.

    Raises:
        LogError: a path does not exist, or there is no log in it.
    """
    found: set[Path] = set()
    for path in paths:
        matches = [path]
        if not path.exists():
            # Path.glob takes no absolute patterns.
            matches = [Path(p) for p in glob.glob(str(path), recursive=True)]  # noqa: PTH207
        if not matches:
            raise LogError(f"{path}: no such file or folder")
        logs = [log for match in matches for log in _logs_in(match)]
        if not logs:
            raise LogError(f"{path}: no .mcap or .mcap.part file in it")
        found.update(logs)
    return sorted(found)


def _logs_in(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path]
    return [log for suffix in SUFFIXES for log in path.rglob(f"*{suffix}") if log.is_file()]
