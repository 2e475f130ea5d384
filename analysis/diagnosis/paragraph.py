"""A diagnosis in words: one paragraph an episode, one line if there is nothing to explain."""

from __future__ import annotations

from collections import Counter
from pathlib import PurePath
from typing import Final

from mapreplay.analysis.diagnosis.claims import Claims
from mapreplay.analysis.diagnosis.detect import Ending, NearMissKind
from mapreplay.analysis.diagnosis.diagnosis import Diagnosis, Sealing
from mapreplay.analysis.diagnosis.harms import HarmKind
from mapreplay.analysis.diagnosis.taxonomy import words
from mapreplay.analysis.reporting.wording import counted, share

TOLD: Final = 3
"""Sealings of an episode that are told in full."""

_ENDINGS: Final = {
    Ending.FINAL: "for good",
    Ending.SEEN: "and got out after {moves} by what it saw",
    Ending.PREDICTION: "and got out after {moves} because the prediction changed",
    Ending.MAPPED: "until the target was reached {moves} later",
    Ending.OUT_OF_STEPS: "until it ran out of steps {moves} later",
    Ending.UNFINISHED: "up to the end of the log, {moves} later",
}
_HARMS: Final = {
    HarmKind.PHANTOM_FRONTIER: "going for frontiers that did not exist",
    HarmKind.PHANTOM_PASSAGE: "planning through walls that were predicted free",
    HarmKind.OSCILLATION: "going to and fro between targets",
}


def paragraph(diagnosis: Diagnosis, claims: Claims | None = None) -> str:
    """The diagnosis of one log in words.

    Args:
        diagnosis: Of the log.
        claims: Of the corpus that it is part of; by default its own.
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
        sentences += _sealing(who, sealing, claims or diagnosis.claims)
    if diagnosis.sealings:
        sentences += _rest(diagnosis)
        sentences.append(f"{_outcome(diagnosis).capitalize()}.")
    sentences += _beside(diagnosis)
    sentences += [f"{note[:1].upper()}{note[1:]}." for note in diagnosis.notes]
    return " ".join(sentences)


def what_if(diagnosis: Diagnosis, log: PurePath) -> list[str | PurePath] | None:
    """The command that shows how it would have gone on with the truth; None if there is none.

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


def _sealing(who: str, sealing: Sealing, claims: Claims) -> list[str]:
    ending = _ENDINGS[sealing.ending].format(moves=counted(sealing.moves, "move"))
    covered = (
        "" if sealing.coverage != sealing.coverage else f", with {share(sealing.coverage)} covered"
    )
    said = [f"{who} sealed in at step {sealing.first_step}{covered}, {ending}."]
    culprits, doorway = sealing.culprits, sealing.doorway
    if culprits is None:
        return said
    count = len(culprits.cells)
    place = f" {words(sealing.kind)}" if sealing.kind != "unclassified" else " Unclassified."
    said[0] += place
    any_of = "" if culprits.unique else f", out of {len(culprits.tied)} that would do"
    exits = f" in {culprits.exits} places" if culprits.exits > 1 else ""
    where = ", ".join(f"({row}, {col})" for row, col in culprits.cells.tolist()[:4])
    more = f" and {count - 4} more" if count > 4 else ""
    unseen = counted(sealing.hidden, "explorable cell")
    were = "was" if sealing.hidden == 1 else "were"
    said.append(
        f"It could still reach {counted(sealing.inside, 'cell')}, and {unseen} {were} hidden "
        f"from it by {counted(count, 'false wall')} at {where}{more}{any_of}{exits}."
    )
    if doorway is not None:
        parts = f" in {doorway.parts} parts" if doorway.parts > 1 else ""
        said.append(f"The doorway there is {counted(doorway.width, 'cell')} wide{parts}.")
    said += _blame(sealing, claims)
    said += _remedy(sealing)
    return said


def _blame(sealing: Sealing, claims: Claims) -> list[str]:
    if not sealing.blame:
        return []
    blame = sealing.blame[0]
    which = "It" if len(sealing.blame) == 1 else "The first"
    right, count = claims.right(blame.p_wall)
    how_often = f" (such claims are right {share(right)} of the time, n = {count})" if count else ""
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
    seen = "was never seen" if blame.seen_at is None else f"was seen at step {blame.seen_at}"
    history = (
        f"{which} was taken for a wall since step {blame.since}{distance}, where {evidence}, with "
        f"P = {blame.p_wall:.3f} at the sealing{how_often}; it {seen}.{flicker}"
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
    view = remedy.view
    if view is not None:
        enough = "and let it out" if view.suffices else "which is not enough to let it out"
        said.append(
            f"{counted(view.moves, 'move')} to ({view.cell.row}, {view.cell.col}) would have shown "
            f"{counted(view.sees, 'false wall')}, {enough}."
        )
    if remedy.fail_safe_moves is not None and sealing.ending is Ending.FINAL:
        said.append(f"The fail-safe would have cost {counted(remedy.fail_safe_moves, 'move')}.")
    return said


def _rest(diagnosis: Diagnosis) -> list[str]:
    count = len(diagnosis.sealings)
    if count == 1:
        return []
    moves = sum(sealing.moves for sealing in diagnosis.sealings)
    more = f", {count - TOLD} more than told here" if count > TOLD else ""
    return [f"Sealed in {_times(count)} in all{more}, for {counted(moves, 'move')} together."]


def _beside(diagnosis: Diagnosis) -> list[str]:
    """Near misses and the other ways in which the prediction hurt."""
    said = []
    near = [miss for miss in diagnosis.near_misses if not miss.led_to_sealing]
    if near:
        kinds = Counter(miss.kind for miss in near)
        parts = []
        if kinds[NearMissKind.ONE_CELL]:
            parts.append(f"{_times(kinds[NearMissKind.ONE_CELL])} one cell was left open")
        if kinds[NearMissKind.CLOSING]:
            parts.append(f"{_times(kinds[NearMissKind.CLOSING])} the way out closed just behind it")
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
            f"Of the {share(coverage.claimed)} claimed at the end only "
            f"{share(coverage.correct)} is right ({walls}, {free} taken for free)."
        )
    return said


def _times(number: int) -> str:
    return {1: "once", 2: "twice"}.get(number, f"{number} times")
