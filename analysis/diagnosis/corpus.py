"""Diagnoses counted over a corpus: how often, why, at which cost, where, and how confident."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import reduce
from itertools import pairwise
from operator import add
from typing import Any, Final, TypeAlias

import numpy as np

from mapreplay.analysis.diagnosis.detect import Ending, NearMissKind
from mapreplay.analysis.diagnosis.diagnosis import Diagnosis, Sealing
from mapreplay.analysis.diagnosis.harms import HarmKind
from mapreplay.analysis.diagnosis.reliability import Reliability
from mapreplay.analysis.diagnosis.taxonomy import KINDS, UNCLASSIFIED
from mapreplay.analysis.stats.estimates import Estimate, Proportion, mean_interval, proportion
from mapreplay.recorders.log.header import episode_pairs

FREED: Final = frozenset({Ending.SEEN, Ending.PREDICTION, Ending.MAPPED})
"""Endings of a sealing after which the episode went on, or was done."""
NARROW: Final = 6
"""A passage of at most this many cells is narrow: a door, a corridor, a closet."""


@dataclass(frozen=True)
class CorpusGroup:
    """Episodes of one kind: a row of the table of a corpus."""

    by: str
    """What they have in common: planner, predictor, thresholds, ..."""
    value: str
    episodes: int
    sealed: Proportion
    """Those that were sealed in at least once."""
    final: int
    """Those that were never freed."""
    sealings: int
    moves: int
    """Made while sealed in, by all of them."""
    coverage: float
    """Median of the fused map's at the sealings; NaN without one."""
    near: int
    """Near misses that did not lead to a sealing."""


def _wall_share(diagnosis: Diagnosis) -> str:
    plan = diagnosis.header.floor_plan
    if not plan.has_truth:
        return "not known"
    return _tenth(plan.wall_share, 0.05)


def _tenth(value: float, width: float) -> str:
    low = int(value / width + 1e-9) * width
    return f"{low:.2f} to {low + width:.2f}"


_Key: TypeAlias = Callable[[Diagnosis], str]
_BY: Final[dict[str, _Key]] = {
    "all": lambda _: "",
    "planner": lambda d: d.header.config.planner,
    "predictor": lambda d: d.header.predictor.name,
    "delta": lambda d: f"{d.header.config.delta_occupied:g}/{d.header.config.delta_free:g}",
    "fail-safe": lambda d: "on" if d.header.config.fail_safe else "off",
    "wall share": _wall_share,
}


def groups(diagnoses: Sequence[Diagnosis]) -> list[CorpusGroup]:
    """The corpus as a whole, and by everything in which its episodes differ."""
    return [_group(by, value, members) for by, value, members in _grouped(diagnoses, _BY)]


def _grouped(
    diagnoses: Sequence[Diagnosis], by: Iterable[str]
) -> Iterator[tuple[str, str, list[Diagnosis]]]:
    """All of them, and those of each value of what they differ in."""
    for name in by:
        members: dict[str, list[Diagnosis]] = defaultdict(list)
        for diagnosis in diagnoses:
            members[_BY[name](diagnosis)].append(diagnosis)
        if name == "all" or len(members) > 1:
            for value in sorted(members):
                yield name, value, members[value]


def _group(by: str, value: str, members: Sequence[Diagnosis]) -> CorpusGroup:
    found = [sealing for diagnosis in members for sealing in diagnosis.sealings]
    sealed = sum(bool(diagnosis.sealings) for diagnosis in members)
    covered = [s.coverage for s in found if s.coverage == s.coverage]
    return CorpusGroup(
        by=by,
        value=value,
        episodes=len(members),
        sealed=proportion(sealed, len(members)),
        final=sum(any(s.is_final for s in d.sealings) for d in members),
        sealings=len(found),
        moves=sum(s.moves for s in found),
        coverage=float(np.median(covered)) if covered else float("nan"),
        near=sum(not miss.led_to_sealing for d in members for miss in d.near_misses),
    )


@dataclass(frozen=True)
class KindCount:
    """Sealings of one kind."""

    kind: str
    sealings: int
    final: int
    share: Proportion
    """Of all sealings."""
    coverage: float
    """Median at the time."""
    blocking: float
    """Median number."""
    opening: float
    """Median width in cells."""
    p_wall: float
    """Median of the first blocking cell."""
    threshold: float
    """Median delta_occupied above which it would not have happened; NaN if never known."""
    viewpoint: float
    """Median moves to the informative viewpoint."""
    fail_safe: float
    """Median moves of the fail-safe, where it frees the agent."""


def kind_counts(diagnoses: Sequence[Diagnosis]) -> list[KindCount]:
    """A row per kind that occurs, in the taxonomy's order."""
    found = [sealing for diagnosis in diagnoses for sealing in diagnosis.sealings]
    rows = []
    for kind in (*(known.name for known in KINDS), UNCLASSIFIED):
        chosen = [sealing for sealing in found if sealing.kind == kind]
        if chosen:
            rows.append(_kind(kind, chosen, len(found)))
    return rows


def _kind(kind: str, chosen: Sequence[Sealing], of: int) -> KindCount:
    return KindCount(
        kind=kind,
        sealings=len(chosen),
        final=sum(sealing.is_final for sealing in chosen),
        share=proportion(len(chosen), of),
        coverage=_median(chosen, lambda s: s.coverage),
        blocking=_median(chosen, lambda s: len(s.blocking.cells) if s.blocking else None),
        opening=_median(chosen, lambda s: s.opening.width if s.opening else None),
        p_wall=_median(chosen, lambda s: s.blame[0].p_wall if s.blame else None),
        threshold=_median(chosen, lambda s: s.remedy.delta_occupied_above),
        viewpoint=_median(
            chosen, lambda s: s.remedy.viewpoint.moves if s.remedy.viewpoint else None
        ),
        fail_safe=_median(chosen, lambda s: s.remedy.fail_safe_moves),
    )


def _median(chosen: Sequence[Sealing], value: Callable[[Sealing], float | None]) -> float:
    values = [v for s in chosen if (v := value(s)) is not None and v == v]
    return float(np.median(values)) if values else float("nan")


@dataclass(frozen=True)
class PassageShare:
    """How often agents are sealed in at passages of a width, and how often they are there."""

    feature: str
    sealings: Proportion
    """Sealings whose blocking cell lies at such a place."""
    steps: float
    """Share of all steps at such a place."""


def passage_shares(diagnoses: Sequence[Diagnosis]) -> list[PassageShare]:
    """By the true width of the place: of the passage at the blocking cell, of the agent's cell."""
    places = [s.passage for d in diagnoses for s in d.sealings if s.passage is not None]
    length = max((len(d.walked) for d in diagnoses), default=1)
    walked = np.zeros(length, np.int64)
    for diagnosis in diagnoses:
        walked[: len(diagnosis.walked)] += diagnosis.walked
    total = int(walked.sum())
    rows = []
    for low, high in ((1, 2), (3, 4), (5, NARROW), (NARROW + 1, 12), (13, length)):
        inside = sum(low <= passage.gap <= high for passage in places)
        share = int(walked[low : high + 1].sum()) / total if total else float("nan")
        name = f"{low} to {high} cells wide" if high < length else f"{low} cells or wider"
        rows.append(PassageShare(name, proportion(inside, len(places)), share))
    return rows


@dataclass(frozen=True)
class ReliabilityBin:
    """Walls that sealed by their confidence, and how often such predictions are right."""

    low: float
    """Of P(occupied)."""
    high: float
    cells: int
    """Predicted cells of that probability, unseen and explorable, at the steps counted."""
    right: float
    """Share of them that are walls."""
    sealed: int
    """First blocking cells of that probability: all of them free cells."""


def reliability_bins(diagnoses: Sequence[Diagnosis]) -> list[ReliabilityBin]:
    """By P(occupied), from .5 upwards."""
    reliability = pooled_reliability(diagnoses)
    p_walls = np.array([s.blame[0].p_wall for d in diagnoses for s in d.sealings if s.blame])
    edges = (0.5, 0.7, 0.8, 0.9, 0.94, 0.98, 1.0)
    rows = []
    for low, high in pairwise(edges):
        first, last = (
            round(low * reliability.counts.shape[1]),
            round(high * reliability.counts.shape[1]),
        )
        free, occupied = reliability.counts[:, first:last].sum(axis=1).tolist()
        total = free + occupied
        in_bin = (p_walls >= low) & ((p_walls < high) | (high == 1))
        right = occupied / total if total else float("nan")
        rows.append(ReliabilityBin(low, high, total, right, int(in_bin.sum())))
    return rows


def pooled_reliability(diagnoses: Sequence[Diagnosis]) -> Reliability:
    """That of all logs together."""
    return reduce(add, (diagnosis.reliability for diagnosis in diagnoses), Reliability())


@dataclass(frozen=True)
class HarmCount:
    """One of the other ways in which predictions hurt."""

    kind: str
    episodes: Proportion
    """In which it happened."""
    times: int
    moves: int


def harm_counts(diagnoses: Sequence[Diagnosis]) -> list[HarmCount]:
    """Near misses that led to no sealing, detours, oscillation and coverage that was wrong at
    the end.
    """
    rows = []
    for kind in NearMissKind:
        missed = [[m.kind for m in d.near_misses if not m.led_to_sealing] for d in diagnoses]
        times = [kinds.count(kind) for kinds in missed]
        rows.append(_harm(f"near miss: {kind.replace('_', ' ')}", times, [0] * len(times)))
    for harm in HarmKind:
        times = [sum(h.kind is harm for h in d.harms) for d in diagnoses]
        moves = [sum(h.moves for h in d.harms if h.kind is harm) for d in diagnoses]
        rows.append(_harm(harm.replace("_", " "), times, moves))
    short = [int(d.coverage is not None and d.coverage.is_short) for d in diagnoses]
    rows.append(_harm("mapped, but not correctly", short, [0] * len(short)))
    return rows


def _harm(kind: str, times: Sequence[int], moves: Sequence[int]) -> HarmCount:
    return HarmCount(
        kind, proportion(sum(t > 0 for t in times), len(times)), sum(times), sum(moves)
    )


def endings(diagnoses: Sequence[Diagnosis]) -> dict[Ending, tuple[int, float, float]]:
    """For each ending: sealings, and the median and the largest number of moves that they took."""
    rows = {}
    for ending in Ending:
        moves = [s.moves for d in diagnoses for s in d.sealings if s.ending is ending]
        if moves:
            rows[ending] = len(moves), float(np.median(moves)), float(max(moves))
    return rows


@dataclass(frozen=True)
class Cost:
    """What it cost to be freed: means over the episodes that were sealed in and always freed."""

    by: str
    value: str
    """As in `CorpusGroup`."""
    episodes: int
    times: int
    """Sealings of these."""
    moves: Estimate
    """Made while sealed in, of an episode."""
    metres: Estimate
    share: Estimate
    """Of all moves of an episode, 0 to 1."""


def costs(diagnoses: Sequence[Diagnosis]) -> list[Cost]:
    """All, by planner and by predictor; nothing where none was freed.

    The same diagnoses give the same intervals in whatever order they come.
    """
    freed = [d for d in diagnoses if d.sealings and all(s.ending in FREED for s in d.sealings)]
    freed.sort(key=lambda d: (d.header.floor_plan.id, json.dumps(episode_pairs(d.header))))
    return [
        Cost(
            by=by,
            value=value,
            episodes=len(members),
            times=sum(len(d.sealings) for d in members),
            moves=_mean(members, lambda d: sum(s.moves for s in d.sealings)),
            metres=_mean(members, lambda d: sum(s.metres for s in d.sealings)),
            share=_mean(members, lambda d: sum(s.moves for s in d.sealings) / (d.steps - 1)),
        )
        for by, value, members in _grouped(freed, ("all", "planner", "predictor"))
    ]


def _mean(members: Sequence[Diagnosis], value: Callable[[Diagnosis], float]) -> Estimate:
    return mean_interval(np.array([value(diagnosis) for diagnosis in members], np.float64))


_KEYS: Final = {
    "blocking": "culprits", "opening": "doorway", "viewpoint": "view", "cells": "claims",
}  # fmt: skip
"""Names of fields in JSON, where they are older."""


def corpus_record(diagnoses: Sequence[Diagnosis]) -> dict[str, Any]:
    """All of it as plain values."""

    def plain(row: Any) -> dict[str, Any]:
        return {_KEYS.get(key, key): _plain(value) for key, value in asdict(row).items()}

    return {
        "groups": [plain(row) for row in groups(diagnoses)],
        "kinds": [plain(row) for row in kind_counts(diagnoses)],
        "places": [plain(row) for row in passage_shares(diagnoses)],
        "calibration": [plain(row) for row in reliability_bins(diagnoses)],
        "harms": [plain(row) for row in harm_counts(diagnoses)],
        "endings": {
            ending: {"sealings": count, "median_moves": median, "most_moves": most}
            for ending, (count, median, most) in endings(diagnoses).items()
        },
        "costs": [plain(row) for row in costs(diagnoses)],
    }


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    return None if isinstance(value, float) and value != value else value
