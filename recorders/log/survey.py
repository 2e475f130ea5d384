"""What is in a file that does not say so itself: which steps, in which of its blocks.

Files of other tools, and those that were cut off, are read through once when they are opened.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import BinaryIO, Final, NamedTuple

from mapreplay.recorders.log.codec import decode_metrics
from mapreplay.recorders.log.limits import MAX_OPEN_BYTES, check_size
from mapreplay.recorders.log.mcap.reader import Block, Channels, read_block, unpack
from mapreplay.recorders.log.topics import Topic, missing, step_of
from mapreplay.step import FIRST_STAMP_NS, STEP_NS, Outcome

ALL_TOPICS: Final = frozenset(Topic)
_EVERY_STEP: Final = (Topic.POSE, Topic.OBSERVED, Topic.FUSED, Topic.FRONTIER, Topic.METRICS)


class StepMessage(NamedTuple):
    """A message, and the step that it is of."""

    topic: str
    step: int
    data: memoryview


def messages_in(
    records: bytes, channels: Channels, wanted: Iterable[str] = ALL_TOPICS
) -> Iterator[StepMessage]:
    """The messages in a block that are of a step.

    Where the sequence number and the time of logging are what we write, they tell the step.
    Other tools write their own; then the stamp in the message does. A message that is stamped
    with another time is of no step, but came from somewhere else.

    Raises:
        ValueError, LogError, struct.error: see `mapreplay.recorders.log.mcap.reader.unpack`.
    """
    for topic, step, data, log_time in unpack(records, channels, frozenset(wanted)):
        if log_time == FIRST_STAMP_NS + step * STEP_NS:
            yield StepMessage(topic, step, data)
        elif (stamped := step_of(Topic(topic), data)) is not None:
            yield StepMessage(topic, stamped, data)


class StepMessages(NamedTuple):
    """The messages of one step."""

    step: int
    by_topic: dict[str, list[memoryview]]


def steps_in(
    file: BinaryIO, blocks: Sequence[Block], wanted: Iterable[str], channels: Channels
) -> Iterator[StepMessages]:
    """The `wanted` messages by step, in order; what has no metrics is no step.

    Messages of a step may be in several blocks, and blocks have several steps. A step is whole
    when no block that is left has messages of it.

    Args:
        file: Open for reading.
        blocks: By the first step that they have.
        wanted: Topics; those of others are skipped.
        channels: Those known so far; learns those that the blocks declare.

    Raises:
        ValueError: the steps are spread over more than fits into memory.
        ValueError, LogError, McapError, ZstdError, struct.error: a block is damaged.
    """
    wanted = frozenset({*wanted, Topic.METRICS})
    waiting: dict[int, dict[str, list[memoryview]]] = {}
    sizes: list[tuple[int, int]] = []  # the last step of a block that is in memory, and its size
    for block in blocks:
        yield from _whole(waiting, [step for step in waiting if step < block.first])
        records = read_block(file, block)
        sizes = [(last, size) for last, size in sizes if last >= block.first]
        sizes.append((block.last, len(records)))
        check_size("chunks that share steps", sum(size for _, size in sizes), MAX_OPEN_BYTES)
        for topic, step, data in messages_in(records, channels, wanted):
            waiting.setdefault(step, {}).setdefault(topic, []).append(data)
    yield from _whole(waiting, list(waiting))


def _whole(
    waiting: dict[int, dict[str, list[memoryview]]], steps: list[int]
) -> Iterator[StepMessages]:
    for step in sorted(steps):
        messages = waiting.pop(step)
        if Topic.METRICS in messages:
            if len(messages[Topic.METRICS]) > 1:
                messages = _once(step, messages)
            yield StepMessages(step, messages)


def _once(step: int, messages: dict[str, list[memoryview]]) -> dict[str, list[memoryview]]:
    """A step that is in the file more than once, as it was before files were merged."""
    single = {topic: list(dict.fromkeys(map(bytes, of))) for topic, of in messages.items()}
    if any(len(of) > 1 for topic, of in single.items() if topic != Topic.EVENTS):
        raise ValueError(f"step {step} is in it more than once, and not the same")
    return {topic: [memoryview(data) for data in of] for topic, of in single.items()}


class Ends(NamedTuple):
    """What the metrics of a step say beside numbers."""

    outcome: Outcome | None
    is_predicted: bool
    """Whether there are scores of a prediction."""


def _ends_of(metrics: memoryview) -> Ends:
    outcome, scores = decode_metrics({Topic.METRICS: [metrics]})
    return Ends(outcome, not math.isnan(scores.brier))


@dataclass
class Survey:
    """What was found so far."""

    channels: Channels
    blocks: list[Block] = field(default_factory=list)
    """Those with messages of a step."""
    truth: Block | None = None
    """The first that has the true map."""
    _steps: dict[str, set[int]] = field(default_factory=lambda: {topic: set() for topic in Topic})
    _ends: dict[int, Ends] = field(default_factory=dict)

    def add(self, block: Block, records: bytes) -> None:
        """Take the records of a block; nothing is taken of one that is damaged.

        Raises:
            ValueError, LogError, struct.error: it is.
        """
        found: dict[str, set[int]] = {}
        metrics: dict[int, memoryview] = {}
        for topic, step, data in messages_in(records, self.channels):
            found.setdefault(topic, set()).add(step)
            if topic == Topic.METRICS:
                metrics[step] = data
        if not found:
            return
        ends = {step: _ends_of(data) for step, data in metrics.items()}
        steps = set().union(*found.values())
        block = block._replace(first=min(steps), last=max(steps))
        self.blocks.append(block)
        for topic, of_topic in found.items():
            self._steps[topic] |= of_topic
        self._ends |= ends
        if self.truth is None and Topic.TRUTH in found:
            self.truth = block

    def sorted_blocks(self) -> list[Block]:
        """By the first step that they have."""
        return sorted(self.blocks, key=lambda block: (block.first, block.offset))

    def outcome_at(self, step: int) -> Outcome | None:
        """How the episode ended at a step, if it did."""
        return self._ends[step].outcome if step in self._ends else None

    def steps(self, *, is_ours: bool) -> list[int]:
        """The numbers of the steps of which all is there that a step needs.

        Args:
            is_ours: Whether this simulator made them: then each has a scan, and a decision
                unless it is the last.

        Raises:
            LogError: no step has a message that each of them needs.
        """
        whole, some = set(self._ends), set().union(*(self._steps[t] for t in _EVERY_STEP))
        needs: dict[Topic, set[int]] = dict.fromkeys(_EVERY_STEP, some) | {
            Topic.P_WALL: {k for k, end in self._ends.items() if end.is_predicted},
            Topic.PLAN: self._steps[Topic.DECISION],
        }
        if is_ours:
            moved = {k for k, end in self._ends.items() if end.outcome is None}
            needs |= {Topic.SCAN: some, Topic.DECISION: moved}
        for topic, needing in needs.items():
            if needing and not needing & self._steps[topic]:
                raise missing(topic)
            whole -= needing - self._steps[topic]
        return sorted(whole)


def survey(file: BinaryIO, blocks: Iterable[Block], channels: Channels) -> Survey:
    """Read a file through.

    Raises:
        ValueError, LogError, McapError, ZstdError, struct.error: a block is damaged.
    """
    found = Survey(channels)
    for block in blocks:
        found.add(block, read_block(file, block))
    return found
