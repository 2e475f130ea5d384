"""Two episodes on one floor plan: where they diverge, why there, and what it led to."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import polars as pl

from mapreplay.analysis.diff.causes import Cause, causes, outcome_name
from mapreplay.analysis.diff.divergence import find_divergences
from mapreplay.analysis.episodes.corpus import LoggedEpisode, episode_of
from mapreplay.analysis.episodes.curves import Curve, first_reached
from mapreplay.errors import UsageError
from mapreplay.recorders.log.facts import HeaderDifference
from mapreplay.recorders.log.reader import EpisodeLog

LEVELS: Final = (0.5, 0.6, 0.7, 0.8, 0.9, 0.95)
"""Coverages between which steps are counted, beside the target."""


@dataclass(frozen=True)
class Both:
    """A number of both episodes; NaN where it is undefined."""

    what: str
    a: float
    b: float

    @property
    def difference(self) -> float:
        """B - a."""
        return self.b - self.a


@dataclass(frozen=True)
class EpisodeDiff:
    """What `diff` says of two episodes."""

    identical: bool
    """Bit for bit in all that happened and in all that the logs say of it."""
    steps: int
    """Steps that both have."""
    headers: tuple[HeaderDifference, ...]
    """What the two say otherwise of the whole episode, such as the planner."""
    causes: tuple[Cause, ...]
    """The layers that differ, by their first step, causes first, until the agents diverge."""
    outcomes: tuple[str, str]
    ends: tuple[Both, ...]
    """Steps, metres, coverages and F1, each at its own end."""
    meanwhile: tuple[Both, ...]
    """The same at the last step that both have."""
    times: tuple[Both, ...]
    """Steps that each took from one coverage of its built map to the next, and for what else;
    NaN where the coverage was never reached."""

    @property
    def cause(self) -> Cause | None:
        """The layer that diverges first; None if all steps are the same."""
        return self.causes[0] if self.causes else None


def diff_logs(a: EpisodeLog, b: EpisodeLog) -> EpisodeDiff:
    """Where two episodes diverge, and what it led to.

    Raises:
        UsageError: they are on different floor plans.
        LogError: a log cannot be read.
    """
    plan_a, plan_b = a.header.floor_plan, b.header.floor_plan
    if plan_a.sha256 != plan_b.sha256:
        alike = ", of the same name but with other cells" if plan_a.id == plan_b.id else ""
        raise UsageError(
            f"{a.path} is on floor plan {plan_a.id}, {b.path} on {plan_b.id}{alike}: "
            "choose two episodes on one floor plan"
        )
    divergences = find_divergences(a, b)
    one, other = episode_of(a), episode_of(b)
    last = divergences.steps - 1
    return EpisodeDiff(
        identical=divergences.identical,
        steps=divergences.steps,
        headers=divergences.headers,
        causes=tuple(causes(a, b, divergences)),
        outcomes=(outcome_name(a), outcome_name(b)),
        ends=tuple(_states(one, len(one.f1) - 1, other, len(other.f1) - 1)),
        meanwhile=tuple(_states(one, last, other, last)),
        times=tuple(_times(one, other)),
    )


def _states(a: LoggedEpisode, at_a: int, b: LoggedEpisode, at_b: int) -> Iterator[Both]:
    """Where both are at a step of each."""
    if at_a < 0 or at_b < 0:  # an episode that was killed before its first step was kept
        return
    yield Both("steps", at_a, at_b)
    yield Both("path length, m", float(a.metres[at_a]), float(b.metres[at_b]))
    yield Both("coverage", float(a.coverage[at_a]), float(b.coverage[at_b]))
    yield Both("correct coverage", float(a.correct[at_a]), float(b.correct[at_b]))
    yield Both("F1", float(a.f1[at_a]), float(b.f1[at_b]))


def _times(a: LoggedEpisode, b: LoggedEpisode) -> Iterator[Both]:
    """Where the steps of both went."""
    targets = sorted({episode.header.config.coverage for episode in (a, b)})
    levels = [level for level in LEVELS if level < targets[0]] + targets
    spans = zip(spans_of(a.coverage, levels), spans_of(b.coverage, levels), strict=True)
    below = [0.0, *levels]
    for low, high, (of_a, of_b) in zip(below, levels, spans, strict=False):
        if not (math.isnan(of_a) and math.isnan(of_b)):
            yield Both(f"coverage {low:.2f} to {high:.2f}", of_a, of_b)
    left = (rest_of(episode.coverage, levels) for episode in (a, b))
    yield Both("after the last of these", *left)
    yield Both("of all: in fail-safe mode", *(float(e.fail_safe.sum()) for e in (a, b)))
    idle = (float((np.diff(e.observed) == 0).sum()) for e in (a, b))
    yield Both("of all: nothing new was seen", *idle)


def spans_of(curve: Curve, levels: Sequence[float]) -> list[float]:
    """Steps from each of the rising `levels` to the next, from 0 on; NaN where never reached."""
    spans, then = [], 0
    for level in levels:
        now = first_reached(curve, level)
        spans.append(math.nan if now is None else float(now - then))
        then = then if now is None else now
    return spans


def rest_of(curve: Curve, levels: Sequence[float]) -> float:
    """Steps after the last of the `levels` that was reached."""
    reached = [step for level in levels if (step := first_reached(curve, level)) is not None]
    return float(max(0, curve.size - 1 - max(reached, default=0)))


def diff_frame(diff: EpisodeDiff) -> pl.DataFrame:
    """All of it as one table: of, what, step, a, b, difference, text.

    ``of`` is "parting" (what: a layer; step and text), "header" (text: A's | B's), "end",
    "meanwhile" (step: the last common one) or "time" (a, b, and difference = b - a).
    """
    rows: list[tuple[str, str, int | None, float | None, float | None, float | None, str]] = []
    rows += [("parting", c.layer.value, c.step, None, None, None, c.text) for c in diff.causes]
    rows += [("header", s.what, None, None, None, None, f"{s.a} | {s.b}") for s in diff.headers]
    rows.append(("end", "outcome", None, None, None, None, " | ".join(diff.outcomes)))
    for of, numbers, step in (
        ("end", diff.ends, None),
        ("meanwhile", diff.meanwhile, diff.steps - 1),
        ("time", diff.times, None),
    ):
        rows += [(of, n.what, step, n.a, n.b, n.difference, "") for n in numbers]
    schema = {
        "of": pl.String,
        "what": pl.String,
        "step": pl.Int64,
        "a": pl.Float64,
        "b": pl.Float64,
        "difference": pl.Float64,
        "text": pl.String,
    }
    return pl.DataFrame(rows, schema=schema, orient="row").with_columns(
        pl.col(pl.Float64).fill_nan(None)
    )
