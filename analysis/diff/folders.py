"""Many pairs of episodes, ranked by what differs: which floor plans to look at first."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, fields
from itertools import zip_longest
from pathlib import Path, PurePath
from typing import Final, NamedTuple

import polars as pl

from mapreplay.analysis.diff.divergence import Layer, find_divergences
from mapreplay.analysis.episodes.corpus import LoggedEpisode
from mapreplay.analysis.pool import WorkerError, map_unordered
from mapreplay.errors import MapreplayError
from mapreplay.recorders.log.blame import UnforeseenError, blaming
from mapreplay.recorders.log.facts import header_differences
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.text import printable


@dataclass(frozen=True)
class PairDiff:
    """Two episodes on one floor plan, from one start, with one seed."""

    floor_plan: str
    seed: int
    identical: bool
    """Bit for bit, see `divergence.Divergences`."""
    step: int | None
    """The first step that differs at all; None if none does."""
    layer: str | None
    """What differs there first."""
    move_step: int | None
    """The step at which the agents diverge."""
    outcome_a: str
    outcome_b: str
    time_a: int | None
    """Mapping time; under a common budget, which it is where the target was not reached. None
    if it was not reached, and there is no budget."""
    time_b: int | None
    difference: int | None
    """time_b - time_a."""
    f1_a: float
    """At the end, like the next."""
    f1_b: float
    file_a: str
    file_b: str


def diff_pairs(
    pairs: Sequence[tuple[LoggedEpisode, LoggedEpisode]], jobs: int = 1
) -> Iterator[PairDiff | MapreplayError]:
    """Compare each pair; results come as they are done, errors of reading among them."""
    return map_unordered(_diff, pairs, jobs, lost=_lost)


def _lost(pair: tuple[LoggedEpisode, LoggedEpisode], error: WorkerError) -> MapreplayError:
    return UnforeseenError(f"{pair[0].path} and {pair[1].path}: {error}")


def _diff(pair: tuple[LoggedEpisode, LoggedEpisode]) -> PairDiff | MapreplayError:
    a, b = pair
    try:
        with blaming(a.path, b.path):
            found = _found(a.log, b.log)
    except MapreplayError as error:
        return error
    budget = min((e.header.budget for e in pair if e.header.budget is not None), default=None)
    time_a, time_b = (_within(e.row.mapping_time, budget) for e in pair)
    return PairDiff(
        floor_plan=a.row.floor_plan,
        seed=a.row.seed,
        identical=found.identical,
        step=found.step,
        layer=found.layer,
        move_step=found.move_step,
        outcome_a=a.row.outcome,
        outcome_b=b.row.outcome,
        time_a=time_a,
        time_b=time_b,
        difference=None if time_a is None or time_b is None else time_b - time_a,
        f1_a=a.row.f1,
        f1_b=b.row.f1,
        file_a=printable(str(a.path)),
        file_b=printable(str(b.path)),
    )


class _Found(NamedTuple):
    identical: bool
    step: int | None
    layer: str | None
    move_step: int | None


def _found(a: EpisodeLog, b: EpisodeLog) -> _Found:
    """Where two episodes diverge; if a log has no steps, by their scalars."""
    if a.has_steps and b.has_steps:
        divergences = find_divergences(a, b)
        first, move = divergences.layer, divergences.first.get(Layer.MOVE)
        return _Found(
            divergences.identical,
            divergences.first[first].index if first else None,
            first.value if first else None,
            move.index if move else None,
        )
    rows = list(zip_longest(a.table().iter_rows(), b.table().iter_rows()))
    step = next((k for k, (one, other) in enumerate(rows) if one != other), None)
    both = [(one[1:3], other[1:3]) for one, other in rows if one and other]  # where they are
    apart = next((k for k, (one, other) in enumerate(both) if one != other), 0)
    same = step is None and not header_differences(a.header, b.header)
    return _Found(same, step, None if step is None else "scalars", apart - 1 if apart else None)


def _within(time: int | None, budget: int | None) -> int | None:
    """A mapping time under a budget, all of which it takes if the target was not reached."""
    return min((number for number in (time, budget) if number is not None), default=None)


_DTYPES: Final = {
    "str": pl.String,
    "str | None": pl.String,
    "int": pl.Int64,
    "int | None": pl.Int64,
    "bool": pl.Boolean,
    "float": pl.Float64,
}


def _rank(diff: PairDiff) -> tuple[bool, int, str, int]:
    return diff.difference is None, -abs(diff.difference or 0), diff.floor_plan, diff.seed


def pairs_frame(diffs: Sequence[PairDiff]) -> pl.DataFrame:
    """One row a pair, the largest difference of mapping time first, undefined ones last."""
    ranked = sorted(diffs, key=_rank)
    schema = {f.name: _DTYPES[str(f.type)] for f in fields(PairDiff)}
    frame = pl.DataFrame([asdict(d) for d in ranked], schema=schema)
    return frame.with_columns(pl.col(pl.Float64).fill_nan(None))


def view_command(file_a: str | Path, file_b: str | Path, step: int | None) -> list[str | PurePath]:
    """The command that shows both episodes at a step."""
    return ["mapreplay", "view", Path(file_a), Path(file_b), "--step", str(step or 0)]
