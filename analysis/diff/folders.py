"""Many pairs of episodes, ranked by what differs: which floor plans to look at first."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path, PurePath
from typing import Final

import polars as pl

from mapreplay.analysis.diff.divergence import Layer, find_partings
from mapreplay.analysis.episodes.corpus import LoggedEpisode
from mapreplay.analysis.pool import map_unordered
from mapreplay.errors import MapreplayError
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.text import printable


@dataclass(frozen=True)
class PairDiff:
    """Two episodes on one floor plan, from one start, with one seed."""

    floor_plan: str
    seed: int
    identical: bool
    """Bit for bit, see `parting.Partings`."""
    step: int | None
    """The first step that differs at all; None if none does."""
    layer: str | None
    """What differs there first."""
    move_step: int | None
    """The step at which the agents part."""
    outcome_a: str
    outcome_b: str
    time_a: int
    """Mapping time; under a common budget, which it is where the target was not reached."""
    time_b: int
    difference: int
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
    return map_unordered(
        _diff, pairs, jobs, lost=lambda _, error: error, name=lambda pair: str(pair[0].path)
    )


def _diff(pair: tuple[LoggedEpisode, LoggedEpisode]) -> PairDiff | MapreplayError:
    a, b = pair
    try:
        partings = find_partings(EpisodeLog(a.path), EpisodeLog(b.path))
    except MapreplayError as error:
        return error
    first, move = partings.layer, partings.first.get(Layer.MOVE)
    budget = min(a.header.max_steps, b.header.max_steps)
    time_a, time_b = (mapping_time(episode, budget) for episode in pair)
    return PairDiff(
        floor_plan=a.row.floor_plan,
        seed=a.row.seed,
        identical=partings.identical,
        step=partings.first[first].index if first else None,
        layer=first.value if first else None,
        move_step=move.index if move else None,
        outcome_a=a.row.outcome,
        outcome_b=b.row.outcome,
        time_a=time_a,
        time_b=time_b,
        difference=time_b - time_a,
        f1_a=a.row.f1,
        f1_b=b.row.f1,
        file_a=printable(str(a.path)),
        file_b=printable(str(b.path)),
    )


def mapping_time(episode: LoggedEpisode, budget: int) -> int:
    """Mapping time under a budget, all of which it takes where the target was not reached."""
    time = episode.row.mapping_time
    return budget if time is None else min(time, budget)


_DTYPES: Final = {
    "str": pl.String,
    "str | None": pl.String,
    "int": pl.Int64,
    "int | None": pl.Int64,
    "bool": pl.Boolean,
    "float": pl.Float64,
}


def pairs_frame(diffs: Sequence[PairDiff]) -> pl.DataFrame:
    """One row a pair, the largest difference of mapping time first."""
    ranked = sorted(diffs, key=lambda d: (-abs(d.difference), d.floor_plan, d.seed))
    schema = {f.name: _DTYPES[str(f.type)] for f in fields(PairDiff)}
    frame = pl.DataFrame([asdict(d) for d in ranked], schema=schema)
    return frame.with_columns(pl.col(pl.Float64).fill_nan(None))


def view_command(file_a: str | Path, file_b: str | Path, step: int | None) -> list[str | PurePath]:
    """The command that shows both episodes at a step."""
    return ["mapreplay", "view", Path(file_a), Path(file_b), "--step", str(step or 0)]
