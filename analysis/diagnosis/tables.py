"""The counts of a corpus as tables for 80 columns."""

from __future__ import annotations

from collections.abc import Sequence

import polars as pl

from mapreplay.analysis.diagnosis import corpus
from mapreplay.analysis.diagnosis.diagnosis import Diagnosis
from mapreplay.analysis.reporting.wording import UNDEFINED, interval, share, with_interval
from mapreplay.analysis.stats.estimates import Proportion


def groups_table(diagnoses: Sequence[Diagnosis]) -> pl.DataFrame:
    """By everything in which the episodes differ."""
    return pl.DataFrame(
        [
            {
                "episodes": row.by if row.by == "all" else f"{row.by} {row.value}",
                "n": row.episodes,
                "in": row.sealed.count,
                "share": share(row.sealed.share),
                "95 %": _percent_interval(row.sealed),
                "for good": row.final,
                "times": row.sealings,
                "moves": row.moves,
                "cover": row.coverage,
            }
            for row in corpus.groups(diagnoses)
        ]
    )


def kinds_table(diagnoses: Sequence[Diagnosis]) -> pl.DataFrame:
    """By what happened."""
    return pl.DataFrame(
        [
            {
                "kind": row.kind.replace("_", " "),
                "n": row.sealings,
                "share": share(row.share.share),
                "cover": row.coverage,
                "walls": _median(row.blocking),
                "door": _median(row.opening),
                "P": row.p_wall,
                "delta>": row.threshold,
                "view": _median(row.viewpoint),
                "fail-safe": _median(row.fail_safe),
            }
            for row in corpus.kind_counts(diagnoses)
        ]
    )


def endings_table(diagnoses: Sequence[Diagnosis]) -> pl.DataFrame:
    """By what ended a sealing."""
    return pl.DataFrame(
        [
            {
                "ended by": ending.replace("_", " "),
                "sealings": times,
                "median moves": _median(median),
                "most": _median(most),
            }
            for ending, (times, median, most) in corpus.endings(diagnoses).items()
        ]
    )


def costs_table(diagnoses: Sequence[Diagnosis]) -> pl.DataFrame:
    """What it cost to be freed."""
    return pl.DataFrame(
        [
            {
                "freed": row.by if row.by == "all" else f"{row.by} {row.value}",
                "n": row.episodes,
                "times": row.times,
                "moves": with_interval(row.moves, 0),
                "metres": with_interval(row.metres, 1),
                "% of moves": with_interval(row.share, 0, 100),
            }
            for row in corpus.costs(diagnoses)
        ]
    )


def passages_table(diagnoses: Sequence[Diagnosis]) -> pl.DataFrame:
    """Where blocking cells lie, and where agents are."""
    return pl.DataFrame(
        [
            {
                "place": row.feature,
                "sealings": row.sealings.count,
                "share": share(row.sealings.share),
                "95 %": _percent_interval(row.sealings),
                "share of all steps": share(row.steps),
            }
            for row in corpus.passage_shares(diagnoses)
            if row.sealings.of
        ]
    )


def reliability_table(diagnoses: Sequence[Diagnosis]) -> pl.DataFrame:
    """How confident the network was of walls that sealed."""
    return pl.DataFrame(
        [
            {
                "P(occupied)": f"{row.low:g} to {row.high:g}",
                "predicted cells": row.cells,
                "truly walls": share(row.right),
                "first blocking cells": row.sealed,
            }
            for row in corpus.reliability_bins(diagnoses)
            if row.cells or row.sealed
        ]
    )


def harms_table(diagnoses: Sequence[Diagnosis]) -> pl.DataFrame:
    """Near misses, detours, oscillation, wrong coverage."""
    return pl.DataFrame(
        [
            {
                "what": row.kind,
                "episodes": row.episodes.count,
                "share": share(row.episodes.share),
                "95 %": _percent_interval(row.episodes),
                "times": row.times,
                "moves": row.moves,
            }
            for row in corpus.harm_counts(diagnoses)
        ]
    )


def _percent_interval(share: Proportion) -> str:
    return interval(share.low, share.high, factor=100)


def _median(value: float) -> str:
    """A median of whole numbers: ``2``, ``2.5``."""
    return UNDEFINED if value != value else f"{value:g}"


def all_tables(diagnoses: Sequence[Diagnosis]) -> list[tuple[str, pl.DataFrame]]:
    """Every table with its title, in the order in which they are shown."""
    return [
        ("Sealed in", groups_table(diagnoses)),
        ("Why, and what would have helped (medians)", kinds_table(diagnoses)),
        ("How it ended", endings_table(diagnoses)),
        ("Cost of being freed: means per episode, with 95 % intervals", costs_table(diagnoses)),
        (
            "Where: true width of the passage, compared with where the agents were",
            passages_table(diagnoses),
        ),
        (
            "How confident: predicted walls that sealed, and all predictions",
            reliability_table(diagnoses),
        ),
        ("Other harm", harms_table(diagnoses)),
    ]
