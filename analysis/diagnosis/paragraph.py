"""A diagnosis in words: a paragraph per episode, a line if there is nothing to explain."""

from __future__ import annotations

from collections import Counter
from pathlib import PurePath
from typing import Final

from mapreplay.analysis.diagnosis.detect import Ending, NearMissKind
from mapreplay.analysis.diagnosis.diagnosis import Diagnosis, Sealing
from mapreplay.analysis.diagnosis.harms import HarmKind
from mapreplay.analysis.diagnosis.reliability import Reliability
from mapreplay.analysis.diagnosis.taxonomy import words
from mapreplay.analysis.reporting.wording import counted, share

TOLD: Final = 3
"""Sealings of an episode that are described in full."""

_ENDINGS: Final = {
    Ending.FINAL: "for good",
    Ending.SEEN: "and was freed after {moves} by new observations",
    Ending.PREDICTION: "and was freed after {moves} by a changed prediction",
    Ending.MAPPED: "until the target was reached {moves} later",
    Ending.OUT_OF_STEPS: "until it ran out of steps {moves} later",
    Ending.UNFINISHED: "up to the end of the log, {moves} later",
}
_HARMS: Final = {
    HarmKind.PHANTOM_FRONTIER: "heading for frontiers that did not exist",
    HarmKind.PHANTOM_PASSAGE: "planning through walls that were predicted free",
    HarmKind.OSCILLATION: "going back and forth between targets",
}


def paragraph(diagnosis: Diagnosis, reliability: Reliability | None = None) -> str:
    """The diagnosis of one log in words.

    Args:
        diagnosis: Of the log.
        reliability: Of the corpus that it is part of; by default its own.
    """
    config = diagnosis.header.config
    opening = (
        f"{diagnosis.header.floor_plan.id} ({config.planner}, predictor "
        f"{diagnosis.header.predictor.name}, thresholds {config.delta_occupied:g} occupied / "
        f"{config.delta_free:g} free)"
    )
    sentences = []
    if not diagnosis.sealings:
        sentences.append(f"{opening} was never sealed in: {_outcome(diagnosis)}.")
    for number, sealing in enumerate(diagnosis.sealings[:TOLD]):
        who = f"{opening} was" if number == 0 else "It was"
        sentences += _sealing(who, sealing, reliability or diagnosis.reliability)
    if diagnosis.sealings:
        sentences += _rest(diagnosis)
        sentences.append(f"{_outcome(diagnosis).capitalize()}.")
    sentences += _other_harms(diagnosis)
    sentences += [f"{note[:1].upper()}{note[1:]}." for note in diagnosis.notes]
    return " ".join(sentences)


def what_if(diagnosis: Diagnosis, log: PurePath) -> list[str | PurePath] | None:
    """The command that continues the episode with the ground truth; None if there is none.

    Args:
        diagnosis: Of the log.
        log: Its file.
    """
    if not (diagnosis.sealings and diagnosis.header.floor_plan.has_truth):
        return None
    at = diagnosis.sealings[0].first_step
    return ["mapreplay", "branch", log, "--at", str(at), "--with", "truth"]


def _outcome(diagnosis: Diagnosis) -> str:
    moves = max(diagnosis.steps - 1, 0)
    if diagnosis.outcome is None:
        return f"the log ends unfinished after {counted(moves, 'step')}"
    return f"the episode ended {diagnosis.outcome.replace('_', ' ')} after {counted(moves, 'step')}"


def _sealing(who: str, sealing: Sealing, reliability: Reliability) -> list[str]:
    ending = _ENDINGS[sealing.ending].format(moves=counted(sealing.moves, "move"))
    covered = (
        "" if sealing.coverage != sealing.coverage else f", with {share(sealing.coverage)} covered"
    )
    said = [f"{who} sealed in at step {sealing.first_step}{covered}, {ending}."]
    blocking, opening = sealing.blocking, sealing.opening
    if blocking is None:
        return said
    count = len(blocking.cells)
    what = f" {words(sealing.kind)}" if sealing.kind != "unclassified" else " Unclassified."
    said[0] += what
    chosen = "" if blocking.unique else f", chosen from {len(blocking.tied)} equivalent cells"
    exits = f" in {blocking.exits} places" if blocking.exits > 1 else ""
    where = ", ".join(f"({row}, {col})" for row, col in blocking.cells.tolist()[:4])
    more = f" and {count - 4} more" if count > 4 else ""
    unseen = counted(sealing.hidden, "explorable cell")
    were = "was" if sealing.hidden == 1 else "were"
    said.append(
        f"It could still reach {counted(sealing.inside, 'cell')}, and {unseen} {were} hidden "
        f"from it by {counted(count, 'false wall')} at {where}{more}{chosen}{exits}."
    )
    if opening is not None:
        parts = f" in {opening.parts} parts" if opening.parts > 1 else ""
        said.append(f"The opening there is {counted(opening.width, 'cell')} wide{parts}.")
    said += _blame(sealing, reliability)
    said += _remedy(sealing)
    return said


def _blame(sealing: Sealing, reliability: Reliability) -> list[str]:
    if not sealing.blame:
        return []
    blame = sealing.blame[0]
    which = "The false wall" if len(sealing.blame) == 1 else "The first of them"
    right, count = reliability.right(blame.p_wall)
    how_often = (
        f" (predictions this confident are right {share(right)} of the time, n = {count})"
        if count
        else ""
    )
    distance = (
        ""
        if blame.distance is None
        else f", {blame.distance:.1f} cells from the nearest observation"
    )
    evidence = (
        f"{counted(blame.seen_occupied, 'wall')} and {counted(blame.seen_free, 'free cell')} had "
        "been observed around it"
    )
    flicker = f" It had flickered {_times(blame.flickers)}." if blame.flickers else ""
    seen = "never observed" if blame.seen_at is None else f"observed at step {blame.seen_at}"
    history = (
        f"{which} was predicted since step {blame.since}{distance}, where "
        f"{evidence}, with P = {blame.p_wall:.3f} at the sealing{how_often}; it was {seen}."
        f"{flicker}"
    )
    return [history]


def _remedy(sealing: Sealing) -> list[str]:
    remedy, said = sealing.remedy, []
    thresholds = [
        f"{name} above {value:.3f}"
        for name, value in (
            ("delta-occupied", remedy.delta_occupied_above),
            ("delta-free", remedy.delta_free_above),
        )
        if value is not None
    ]
    if thresholds:
        said.append(f"Open loop, {' or '.join(thresholds)} would have prevented it at this step.")
    else:
        said.append("No threshold would have prevented it at this step.")
    viewpoint = remedy.viewpoint
    if viewpoint is not None:
        enough = "and freed it" if viewpoint.suffices else "which is not enough to free it"
        said.append(
            f"{counted(viewpoint.moves, 'move')} to ({viewpoint.cell.row}, {viewpoint.cell.col}) "
            f"would have shown {counted(viewpoint.sees, 'false wall')}, {enough}."
        )
    if remedy.fail_safe_moves is not None and sealing.ending is Ending.FINAL:
        said.append(f"The fail-safe would have cost {counted(remedy.fail_safe_moves, 'move')}.")
    return said


def _rest(diagnosis: Diagnosis) -> list[str]:
    count = len(diagnosis.sealings)
    if count == 1:
        return []
    moves = sum(sealing.moves for sealing in diagnosis.sealings)
    more = f", {count - TOLD} more than described here" if count > TOLD else ""
    return [f"Sealed in {_times(count)}{more}, for {counted(moves, 'move')} in total."]


def _other_harms(diagnosis: Diagnosis) -> list[str]:
    """Near misses and the other ways in which the prediction hurt."""
    said = []
    near = [miss for miss in diagnosis.near_misses if not miss.led_to_sealing]
    if near:
        kinds = Counter(miss.kind for miss in near)
        parts = []
        if kinds[NearMissKind.ONE_CELL]:
            parts.append(f"{_times(kinds[NearMissKind.ONE_CELL])} one cell was left open")
        if kinds[NearMissKind.CLOSING]:
            closed = _times(kinds[NearMissKind.CLOSING])
            parts.append(f"{closed} one of the next predictions closed the way out")
        said.append(f"Near misses: {', '.join(parts)}.")
    for kind, text in _HARMS.items():
        moves = sum(harm.moves for harm in diagnosis.harms if harm.kind is kind)
        if moves:
            said.append(f"It spent {counted(moves, 'move')} {text}.")
    coverage = diagnosis.coverage
    if coverage is not None and coverage.is_short:
        walls, free = (
            counted(coverage.false_walls, "false wall"),
            counted(coverage.false_free, "wall"),
        )
        said.append(
            f"Of the {share(coverage.claimed)} covered at the end only "
            f"{share(coverage.correct)} is correct ({walls}, {free} predicted free)."
        )
    return said


def _times(number: int) -> str:
    return {1: "once", 2: "twice"}.get(number, f"{number} times")
