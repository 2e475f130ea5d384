"""The diagnosis of one log: everything that its predicted map did to the agent."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import cast

import numpy as np
import numpy.typing as npt

from mapreplay.analysis.diagnosis import taxonomy
from mapreplay.analysis.diagnosis.blame import Blame, Maps, trace_blame
from mapreplay.analysis.diagnosis.blocking import BlockingCells, find_blocking_cells
from mapreplay.analysis.diagnosis.detect import (
    Ending,
    NearMiss,
    NearMissDetector,
    SealedSpan,
    SealingDetector,
    reason_never_sealed,
)
from mapreplay.analysis.diagnosis.harms import Harm, HarmDetector, WrongCoverage, wrong_coverage
from mapreplay.analysis.diagnosis.opening import Opening, find_opening, truly_inside
from mapreplay.analysis.diagnosis.passage import Passage, passage_at, widths
from mapreplay.analysis.diagnosis.reach import Scratch, hidden, reached
from mapreplay.analysis.diagnosis.reliability import Reliability, ReliabilityCounter
from mapreplay.analysis.diagnosis.remedy import (
    Remedy,
    fail_safe_moves,
    informative_viewpoint,
    threshold_of_free,
    threshold_of_walls,
)
from mapreplay.config import MapKind
from mapreplay.errors import LogError, PluginError
from mapreplay.grid import Cell
from mapreplay.planners import Planner, planner_of
from mapreplay.recorders.log.reader import EpisodeLog, MapName
from mapreplay.step import OURS, EpisodeHeader, Outcome, Step


@dataclass(frozen=True, eq=False)
class Sealing:
    """An agent that its own predicted map sealed in, and why."""

    kind: str
    """What happened, by `taxonomy`."""
    first_step: int
    last_step: int
    ending: Ending
    moves: int
    """Made while sealed in."""
    metres: float
    agent: Cell
    """Where it was when it happened."""
    coverage: float
    """Of the fused map then, 0 to 1."""
    correct_coverage: float
    inside: int
    """Truly free cells that it could still reach on its map."""
    hidden: int
    """Explorable cells that its map did not know."""
    blocking: BlockingCells | None
    """None without a true map."""
    blame: tuple[Blame, ...]
    """One chain for each of the blocking cells' `cells`."""
    opening: Opening | None
    passage: Passage | None
    """What the plan looks like at the first blocking cell."""
    remedy: Remedy

    @property
    def is_final(self) -> bool:
        """Whether the agent was never freed."""
        return self.ending is Ending.FINAL


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What the predictions did to the agent of a log."""

    header: EpisodeHeader
    steps: int
    """Steps read, the one at the start included."""
    outcome: Outcome | None
    sealings: tuple[Sealing, ...]
    near_misses: tuple[NearMiss, ...]
    harms: tuple[Harm, ...]
    coverage: WrongCoverage | None
    """None without a true map, or without a step."""
    reliability: Reliability
    """How often predictions of each confidence were right in this log."""
    walked: npt.NDArray[np.int64]
    """int64[n]: how many steps the agent was at a place of true width 0, 1, ..., n - 1 cells."""
    notes: tuple[str, ...]
    """What cannot be said of this log, and why."""


def diagnose(log: EpisodeLog) -> Diagnosis:
    """Diagnose a log, finished or not; read once, and once more if an agent was sealed in.

    Raises:
        LogError: the log cannot be read.
        MapreplayError: the planner returned something impossible.
    """
    header, region = log.header, log.header.explorable
    plan, notes = header.floor_plan, list(_limits(log))
    scratch = Scratch(plan.shape)
    sealing = None if reason_never_sealed(header) else SealingDetector(header, scratch)
    near = NearMissDetector(header, scratch)
    harms, reliability = HarmDetector(header), ReliabilityCounter(plan.cells, region)
    width = widths(plan.cells) if plan.has_truth else np.zeros(plan.shape, np.int64)
    walked = np.zeros(int(width.max()) + 1, np.int64)
    last: Step | None = None
    predicted = False
    for step in log.steps():
        last = step
        if sealing is not None:
            sealed = sealing.take(step)
            if plan.has_truth:
                near.take(step, sealed=sealed)
        if plan.has_truth:
            harms.take(step)
            reliability.take(step)
            walked[width[step.agent]] += 1
        predicted = predicted or step.p_wall is not None
    if sealing is not None:
        sealing.finish()
    if last is not None and not predicted:
        notes.append("no prediction in the log: it cannot have caused anything")
    spans = sealing.spans if sealing else []
    return Diagnosis(
        header=header,
        steps=0 if last is None else last.index + 1,
        outcome=log.outcome,
        sealings=_explain(log, spans, scratch, notes),
        near_misses=tuple(near.near_misses()),
        harms=tuple(harms.harms()),
        coverage=wrong_coverage(header, last) if plan.has_truth and last else None,
        reliability=reliability.result(),
        walked=walked,
        notes=tuple(notes),
    )


def _limits(log: EpisodeLog) -> list[str]:
    """What cannot be diagnosed from this kind of log."""
    header, notes = log.header, []
    reason = reason_never_sealed(header)
    if reason is not None:
        notes.append(f"the agent cannot be sealed in by predicted walls: {reason}")
    if header.simulator != OURS:
        notes.append(f"recorded by {header.simulator}: the cost of the fail-safe is not known")
    if not header.floor_plan.has_truth:
        notes.append(
            "no true map in the log: it is known that the way out vanished, but not whether there "
            "was one, nor blocking cells, the opening, detours and wrong coverage"
        )
    if not log.finished:
        notes.append(f"{log.state}: diagnosed as far as it goes")
    return notes


def _explain(
    log: EpisodeLog, spans: list[SealedSpan], scratch: Scratch, notes: list[str]
) -> tuple[Sealing, ...]:
    if not spans:
        return ()
    truth, has_truth = log.header.floor_plan.cells, log.header.floor_plan.has_truth
    found: list[BlockingCells | None] = [
        find_blocking_cells(truth, s.first.observed, s.first.fused, s.first.agent)
        if has_truth
        else None
        for s in spans
    ]
    chains: list[list[Blame]] = [[] for _ in spans]
    traced = [i for i, blocking in enumerate(found) if blocking is not None]
    if traced:
        maps = cast("Iterable[Maps]", log.maps(MapName.OBSERVED, MapName.P_WALL, MapName.FUSED))
        wanted = [(spans[i].first.index, c.cells) for i in traced if (c := found[i]) is not None]
        for i, chain in zip(traced, trace_blame(maps, wanted, log.indices), strict=True):
            chains[i] = chain
            for blame in chain:
                if np.isnan(blame.p_wall):
                    step, (row, col) = spans[i].first.index, blame.cell
                    raise LogError(
                        f"{log.path}: step {step}: the fused map has a wall at ({row}, {col}) that "
                        "was neither observed nor predicted, so why it is there cannot be told"
                    )
    planner = _planner(log, notes)
    return tuple(
        _sealing(log, span, blocking, chain, planner, scratch)
        for span, blocking, chain in zip(spans, found, chains, strict=True)
    )


def _planner(log: EpisodeLog, notes: list[str]) -> Planner | None:
    """The planner of the log, to try the fail-safe with."""
    if log.header.simulator != OURS:
        return None
    try:
        return planner_of(log.header)
    except PluginError as error:
        notes.append(f"the cost of the fail-safe is not known: {error}")
        return None


def _sealing(
    log: EpisodeLog,
    span: SealedSpan,
    blocking: BlockingCells | None,
    chain: list[Blame],
    planner: Planner | None,
    scratch: Scratch,
) -> Sealing:
    step, header = span.first, log.header.at(span.first.index)
    truth = header.floor_plan.cells
    believed = reached(step.fused, step.agent)
    inside = truly_inside(truth, believed, step.agent)
    unseen = hidden(truth, step.fused, step.agent)
    opening = passage = viewpoint = None
    if blocking is not None:
        opening = find_opening(truth, inside, unseen)
        passage = passage_at(truth, step, blocking)
        viewpoint = informative_viewpoint(
            truth, step, inside, blocking, header.sensor, header.floor_plan.resolution, scratch
        )
    walls = free = moves = None
    if step.p_wall is not None:
        walls = threshold_of_walls(step.observed, step.fused, step.p_wall, believed)
        free = threshold_of_free(step.observed, step.fused, step.p_wall, believed)
        if planner is not None:
            moves = fail_safe_moves(header, planner, span, scratch)
    sealing = Sealing(
        kind=taxonomy.UNCLASSIFIED,
        first_step=step.index,
        last_step=span.last_step,
        ending=span.ending,
        moves=span.moves,
        metres=span.metres,
        agent=step.agent,
        coverage=step.metrics.coverage(MapKind.FUSED),
        correct_coverage=step.metrics.correct_coverage(MapKind.FUSED),
        inside=int(inside.sum()),
        hidden=int(unseen.sum()),
        blocking=blocking,
        blame=tuple(chain),
        opening=opening,
        passage=passage,
        remedy=Remedy(walls, free, viewpoint, moves),
    )
    return taxonomy.classified(sealing)
