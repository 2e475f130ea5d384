"""The diagnosis of one log: everything that its predicted map did to the agent."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import cast

import numpy as np
import numpy.typing as npt

from mapreplay.analysis.diagnosis import taxonomy
from mapreplay.analysis.diagnosis.blame import Blame, Maps, trace_blame
from mapreplay.analysis.diagnosis.claims import ClaimCounter, Claims
from mapreplay.analysis.diagnosis.culprits import Culprits, find_culprits
from mapreplay.analysis.diagnosis.detect import (
    Ending,
    NearMiss,
    NearMissDetector,
    SealingDetector,
    Span,
    can_be_sealed,
)
from mapreplay.analysis.diagnosis.doorway import Doorway, find_doorway, truly_inside
from mapreplay.analysis.diagnosis.harms import Harm, HarmDetector, WrongCoverage, wrong_coverage
from mapreplay.analysis.diagnosis.places import Surroundings, place_of, widths
from mapreplay.analysis.diagnosis.reach import Scratch, hidden, reached
from mapreplay.analysis.diagnosis.remedy import (
    Remedy,
    cheapest_view,
    fail_safe_moves,
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
    """Truly free cells that it could still get to on its map."""
    hidden: int
    """Explorable cells that its map did not know."""
    culprits: Culprits | None
    """None without a true map."""
    blame: tuple[Blame, ...]
    """One chain for each of the culprits' `cells`."""
    doorway: Doorway | None
    place: Surroundings | None
    """What the plan looks like at the first culprit."""
    remedy: Remedy

    @property
    def is_final(self) -> bool:
        """Whether the agent never got out."""
        return self.ending is Ending.FINAL


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What a log says about what its predictions did."""

    header: EpisodeHeader
    steps: int
    """Steps read, the one at the start included."""
    outcome: Outcome | None
    sealings: tuple[Sealing, ...]
    near_misses: tuple[NearMiss, ...]
    harms: tuple[Harm, ...]
    coverage: WrongCoverage | None
    """None without a true map, or without a step."""
    claims: Claims
    """How often predicted probabilities were right in this log."""
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
    sealing = None if can_be_sealed(header) else SealingDetector(header, scratch)
    near = NearMissDetector(header, scratch)
    harms, claims = HarmDetector(header), ClaimCounter(plan.cells, region)
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
            claims.take(step)
            walked[width[step.agent]] += 1
        predicted = predicted or step.p_wall is not None
    if sealing is not None:
        sealing.finish()
    if last is not None and not predicted:
        notes.append("no prediction in the log: nothing that it could have caused")
    spans = sealing.spans if sealing else []
    return Diagnosis(
        header=header,
        steps=0 if last is None else last.index + 1,
        outcome=log.outcome,
        sealings=_explain(log, spans, scratch, notes),
        near_misses=tuple(near.near_misses()),
        harms=tuple(harms.harms()),
        coverage=wrong_coverage(header, last) if plan.has_truth and last else None,
        claims=claims.result(),
        walked=walked,
        notes=tuple(notes),
    )


def _limits(log: EpisodeLog) -> list[str]:
    """What the kind of log leaves unsaid."""
    header, notes = log.header, []
    reason = can_be_sealed(header)
    if reason is not None:
        notes.append(f"the agent cannot be sealed in by predicted walls: {reason}")
    if header.simulator != OURS:
        notes.append(f"recorded by {header.simulator}: the cost of the fail-safe is not known")
    if not header.floor_plan.has_truth:
        notes.append(
            "no true map in the log: that the way out vanished is seen, but not whether there "
            "was one, nor culprits, doorway, detours and wrong coverage"
        )
    if not log.finished:
        notes.append(f"{log.state}: diagnosed as far as it goes")
    return notes


def _explain(
    log: EpisodeLog, spans: list[Span], scratch: Scratch, notes: list[str]
) -> tuple[Sealing, ...]:
    if not spans:
        return ()
    truth, has_truth = log.header.floor_plan.cells, log.header.floor_plan.has_truth
    found: list[Culprits | None] = [
        find_culprits(truth, s.first.observed, s.first.fused, s.first.agent) if has_truth else None
        for s in spans
    ]
    chains: list[list[Blame]] = [[] for _ in spans]
    traced = [i for i, culprits in enumerate(found) if culprits is not None]
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
        _sealing(log, span, culprits, chain, planner, scratch)
        for span, culprits, chain in zip(spans, found, chains, strict=True)
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
    span: Span,
    culprits: Culprits | None,
    chain: list[Blame],
    planner: Planner | None,
    scratch: Scratch,
) -> Sealing:
    step, header = span.first, log.header.at(span.first.index)
    truth = header.floor_plan.cells
    believed = reached(step.fused, step.agent)
    inside = truly_inside(truth, believed, step.agent)
    unseen = hidden(truth, step.fused, step.agent)
    doorway = place = view = None
    if culprits is not None:
        doorway = find_doorway(truth, inside, unseen)
        place = place_of(truth, step, culprits)
        view = cheapest_view(
            truth, step, inside, culprits, header.sensor, header.floor_plan.resolution, scratch
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
        culprits=culprits,
        blame=tuple(chain),
        doorway=doorway,
        place=place,
        remedy=Remedy(walls, free, view, moves),
    )
    return taxonomy.classified(sealing)
