"""The other ways in which a prediction hurts: detours, oscillation, wrong coverage."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np

from mapreplay.analysis.diagnosis.detect import runs
from mapreplay.config import MapKind
from mapreplay.grid import FREE, OCCUPIED, Cell, Grid, Mask
from mapreplay.step import Decision, EpisodeHeader, Outcome, Step

SOON: Final = 20
"""A target that is chosen again within this many steps was given up for nothing."""
AROUND: Final = 5
"""Rows and columns around a target in which an observation may have changed its utility: on
validation plans 95 % of the rewards that observations changed by more than a tenth had one there
(`samples/experiments/oscillation_radius.py`)."""
SAME_PLACE: Final = 2
"""Targets at most this many rows and columns apart count as one."""


class HarmKind(StrEnum):
    """What the prediction did."""

    PHANTOM_FRONTIER = "phantom_frontier"
    """The agent went for a frontier cell that is no explorable free cell."""
    PHANTOM_PASSAGE = "phantom_passage"
    """It went for a real frontier cell on a path through a wall that was predicted free."""
    OSCILLATION = "oscillation"
    """It went for one target, for another, and back for the first, though both were still there
    and nothing had been observed around either."""


@dataclass(frozen=True)
class Harm:
    """Steps in a row at which it happened."""

    kind: HarmKind
    first_step: int
    last_step: int
    target: Cell
    """The last target of these steps; of an oscillation the one that was taken up again."""

    @property
    def moves(self) -> int:
        """Made meanwhile."""
        if self.kind is HarmKind.OSCILLATION:
            return self.last_step - self.first_step
        return self.last_step - self.first_step + 1


@dataclass(frozen=True)
class WrongCoverage:
    """The coverage of the built map at the end, and what of it is wrong."""

    claimed: float
    """Coverage of the built map, 0 to 1."""
    correct: float
    """Known and right, 0 to 1."""
    false_walls: int
    """Explorable cells that are free and that it has as walls."""
    false_free: int
    """Explorable walls that it has as free."""
    is_short: bool
    """Whether the target was reached only because wrong cells count as covered."""


def is_real_frontier(truth: Grid, region: Mask, target: Cell) -> bool:
    """Whether an agent can reach `target` and see something there: it is free and explorable
    (bool[H, W] `region`); then its unknown neighbours are explorable too.
    """
    return bool(truth[target] == FREE and region[target])


def passes_wall(truth: Grid, decision: Decision) -> bool:
    """Whether the path leads through a cell that is no free one."""
    return bool((truth[decision.path[:, 0], decision.path[:, 1]] != FREE).any())


@dataclass(frozen=True, eq=False)
class _GivenUp:
    """A target that was still a frontier cell when another was taken."""

    step: int
    target: Cell
    observed: Grid
    """Then."""


class HarmDetector:
    """Takes the steps of an episode in order."""

    def __init__(self, header: EpisodeHeader) -> None:
        self._truth = header.floor_plan.cells
        self._region = header.explorable
        self._targets: dict[int, Cell] = {}
        self._phantoms: list[int] = []
        self._passages: list[int] = []
        self._given_up: deque[_GivenUp] = deque()
        self._oscillations: list[Harm] = []
        self._target: Cell | None = None

    def take(self, step: Step) -> None:
        """The next step; without a decision there is nothing to judge."""
        decision = step.decision
        if decision is None:
            return
        target = decision.target
        self._targets[step.index] = target
        if not is_real_frontier(self._truth, self._region, target):
            self._phantoms.append(step.index)
        elif passes_wall(self._truth, decision):
            self._passages.append(step.index)
        left = self._target
        if left is not None and not _is_near(target, left) and _is_among(left, step):
            self._find_return(step, left, target)
            self._given_up.append(_GivenUp(step.index, left, step.observed))
        self._target = target

    def _find_return(self, step: Step, left: Cell, target: Cell) -> None:
        """Whether `target` is one that was given up for nothing, when `left` is given up."""
        index = step.index
        while self._given_up and self._given_up[0].step < index - SOON:
            self._given_up.popleft()
        for before in self._given_up:
            if not _is_near(target, before.target):
                continue
            if any(_has_changed(before.observed, step.observed, c) for c in (before.target, left)):
                continue
            last = self._oscillations[-1] if self._oscillations else None
            first = before.step
            if last is not None and first <= last.last_step:  # the same oscillation goes on
                first = min(last.first_step, first)
                self._oscillations.pop()
            self._oscillations.append(Harm(HarmKind.OSCILLATION, first, index, target))
            return

    def harms(self) -> Iterator[Harm]:
        """After the last step."""
        for kind, steps in (
            (HarmKind.PHANTOM_FRONTIER, self._phantoms),
            (HarmKind.PHANTOM_PASSAGE, self._passages),
        ):
            for first, last in runs(steps):
                yield Harm(kind, first, last, self._targets[last])
        yield from self._oscillations


def wrong_coverage(header: EpisodeHeader, last: Step) -> WrongCoverage:
    """The coverage of the built map at the last step, on explorable cells."""
    config, truth, region = header.config, header.floor_plan.cells, header.explorable
    built = last.observed if config.build is MapKind.OBSERVED else last.fused
    correct = last.metrics.correct_coverage(config.build)
    return WrongCoverage(
        claimed=last.metrics.coverage(config.build),
        correct=correct,
        false_walls=int((region & (built == OCCUPIED) & (truth == FREE)).sum()),
        false_free=int((region & (built == FREE) & (truth == OCCUPIED)).sum()),
        is_short=last.outcome is Outcome.MAPPED and correct < config.coverage,
    )


def _is_near(a: Cell, b: Cell) -> bool:
    return max(abs(a.row - b.row), abs(a.col - b.col)) <= SAME_PLACE


def _is_among(cell: Cell, step: Step) -> bool:
    return bool((step.frontier == np.array(cell)).all(axis=1).any())


def _has_changed(before: Grid, after: Grid, around: Cell) -> bool:
    """Whether something was observed around a cell."""
    rows = slice(max(0, around.row - AROUND), around.row + AROUND + 1)
    cols = slice(max(0, around.col - AROUND), around.col + AROUND + 1)
    return not np.array_equal(before[rows, cols], after[rows, cols])
