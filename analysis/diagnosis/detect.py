"""When an agent's way out vanished, how it came back, and when it was nearly gone."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Final

from mapreplay.analysis.diagnosis.reach import (
    Scratch,
    corrected,
    false_walls,
    has_two_ways_out,
    hidden,
)
from mapreplay.config import MapKind
from mapreplay.grid import UNKNOWN, Cell, Grid
from mapreplay.mapping import fuse, overlay
from mapreplay.stages import Past
from mapreplay.step import EpisodeHeader, Mode, Outcome, Step

NEXT_STEPS: Final = 3
"""A way out was nearly closed if a prediction up to this many steps later closes it."""


class Ending(StrEnum):
    """What ended a sealing."""

    FINAL = "final"
    """Nothing: the episode ended with it."""
    SEEN = "seen"
    """New observations: with the old prediction it would be free as well."""
    PREDICTION = "prediction"
    """The prediction changed; the observations since then do not suffice."""
    MAPPED = "mapped"
    """The target coverage was reached while sealed in."""
    OUT_OF_STEPS = "out_of_steps"
    UNFINISHED = "unfinished"
    """The log ends with it."""


@dataclass(frozen=True, eq=False)
class SealedSpan:
    """A time without a frontier on the planning map, though something is hidden."""

    first: Step
    """Its first step."""
    past: Past
    """What that step continued from."""
    last_step: int
    """The last step of it."""
    ending: Ending
    moves: int
    """Made while sealed in: the cost of getting out, or of not getting out."""
    metres: float
    """Of these moves."""


class NearMissKind(StrEnum):
    """Why it was near."""

    ONE_CELL = "one_cell"
    """One cell would have closed all ways to the frontier; without the false walls it takes
    more."""
    CLOSING = "closing"
    """The prediction of one of the next `NEXT_STEPS` steps, with what had been observed at
    this one, leaves no way out, although something is hidden and the target is not reached."""


@dataclass(frozen=True)
class NearMiss:
    """Steps in a row at which the agent was nearly sealed in."""

    kind: NearMissKind
    first_step: int
    last_step: int
    agent: Cell
    """Where it was at the first of them."""
    led_to_sealing: bool
    """Whether it was sealed in within `NEXT_STEPS` steps after the last of them."""


def reason_never_sealed(header: EpisodeHeader) -> str | None:
    """Why an agent with this configuration cannot be sealed in by predicted walls, or None."""
    config = header.config
    if config.plan_on is not MapKind.FUSED or config.build is not MapKind.FUSED:
        return f"it plans on {config.plan_on} and builds {config.build} maps"
    return None


def is_sealed(header: EpisodeHeader, step: Step, scratch: Scratch) -> bool:
    """Whether the agent has no frontier on its fused map although it could still see more.

    With the true map that is exact: an explorable cell is hidden. Without a true
    map, any unknown cell counts.
    """
    if scratch.has_way_out(step.fused, step.agent):
        return False
    if step.outcome is Outcome.MAPPED:
        return False
    plan = header.floor_plan
    if not plan.has_truth:
        return bool((step.fused == UNKNOWN).any())
    return bool(hidden(plan.cells, step.fused, step.agent).any())


class SealingDetector:
    """Takes the steps of an episode in order; `spans` has the sealings after the last one."""

    def __init__(self, header: EpisodeHeader, scratch: Scratch) -> None:
        self.spans: list[SealedSpan] = []
        self.past = Past.at_start(header)
        """Of the step that was taken last."""
        self._header = header
        self._scratch = scratch
        self._open: SealedSpan | None = None
        self._before: Step | None = None

    def take(self, step: Step) -> bool:
        """Whether the agent is sealed in at `step`, the next one."""
        header = self._header.at(step.index)
        if self._before is not None:
            then = self._header.at(self._before.index)
            past = self.past.after(self._before, step.agent, then)
            self.past = replace(past, index=step.index)  # steps may be missing in a recovered log
        sealed = is_sealed(header, step, self._scratch)
        if self._open is not None:
            self._open = self._go_on(self._open, step)
            if not sealed:
                self._close(self._how(step))
        elif sealed:
            self._open = SealedSpan(step, self.past, step.index, Ending.UNFINISHED, 0, 0.0)
        if sealed and self._open is not None:
            self._open = replace(self._open, last_step=step.index)
            if step.outcome is not None:
                self._close(_ENDINGS[step.outcome])
        self._before = step
        return sealed

    def finish(self) -> None:
        """After the last step that there is."""
        if self._open is not None:
            self._close(Ending.UNFINISHED)

    def _go_on(self, span: SealedSpan, step: Step) -> SealedSpan:
        metres = self.past.travelled.metres(self._header.floor_plan.resolution)
        before = span.past.travelled.metres(self._header.floor_plan.resolution)
        return replace(span, moves=step.index - span.first.index, metres=metres - before)

    def _how(self, step: Step) -> Ending:
        """What freed the agent at `step`."""
        if step.outcome is Outcome.MAPPED:
            return Ending.MAPPED
        if self._before is None or self._scratch.has_way_out(
            overlay(step.observed, self._before.fused), step.agent
        ):
            return Ending.SEEN
        return Ending.PREDICTION

    def _close(self, ending: Ending) -> None:
        if self._open is not None:
            self.spans.append(replace(self._open, ending=ending))
        self._open = None


_ENDINGS: Final = {
    Outcome.SEALED_IN: Ending.FINAL,
    Outcome.MAPPED: Ending.MAPPED,
    Outcome.OUT_OF_STEPS: Ending.OUT_OF_STEPS,
}


class NearMissDetector:
    """Takes the steps of an episode in order, and whether the agent is sealed in at each."""

    def __init__(self, header: EpisodeHeader, scratch: Scratch) -> None:
        self._header = header
        self._region = header.explorable
        self._scratch = scratch
        self._recent: deque[tuple[int, Cell, Grid]] = deque(maxlen=NEXT_STEPS)
        self._steps: dict[NearMissKind, dict[int, Cell]] = {kind: {} for kind in NearMissKind}
        self._sealed: set[int] = set()

    def take(self, step: Step, *, sealed: bool) -> None:
        """The next step; one that has no prediction is no near miss."""
        if sealed:
            self._sealed.add(step.index)
        if step.p_wall is None:
            return
        if self._recent and self._recent[-1][0] + NEXT_STEPS < step.index:
            self._recent.clear()  # a recovered log that misses steps
        thresholds = self._header.at(step.index).thresholds
        closing = self._steps[NearMissKind.CLOSING]
        for index, agent, observed in self._recent:
            if index not in closing and self._seals(fuse(observed, step.p_wall, thresholds), agent):
                closing[index] = agent
        if sealed or step.outcome is not None or step.mode is Mode.FAIL_SAFE:
            return
        self._recent.append((step.index, step.agent, step.observed))
        truth = self._header.floor_plan.cells
        if not has_two_ways_out(step.fused, step.agent):
            wrong = false_walls(truth, step.observed, step.fused)
            if wrong.any() and has_two_ways_out(corrected(step.fused, wrong, truth), step.agent):
                self._steps[NearMissKind.ONE_CELL][step.index] = step.agent

    def _seals(self, fused: Grid, agent: Cell) -> bool:
        """Whether an agent with this map would be sealed in, and not done."""
        if self._scratch.has_way_out(fused, agent):
            return False
        known = float((fused[self._region] != UNKNOWN).mean())
        if known >= self._header.config.coverage:
            return False
        return bool(hidden(self._header.floor_plan.cells, fused, agent).any())

    def near_misses(self) -> Iterator[NearMiss]:
        """After the last step: those of each kind, steps in a row together."""
        for kind, steps in self._steps.items():
            for first, last in runs(sorted(steps)):
                after = range(last + 1, last + 1 + NEXT_STEPS)
                led = any(index in self._sealed for index in after)
                yield NearMiss(kind, first, last, steps[first], led)


def runs(numbers: list[int]) -> Iterator[tuple[int, int]]:
    """The first and last of each run of successive integers in a sorted list."""
    start: int | None = None
    before = 0
    for number in numbers:
        if start is None:
            start = number
        elif number != before + 1:
            yield start, before
            start = number
        before = number
    if start is not None:
        yield start, before
