"""What a prediction was worth: relative reduction of mapping time on the same floor plans."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from mapreplay.analysis.episodes import EpisodeRow
from mapreplay.analysis.statistics import Estimate, mean_interval


@dataclass(frozen=True)
class Pair:
    """Two episodes on the same floor plan from the same start."""

    reference: EpisodeRow
    candidate: EpisodeRow

    @property
    def reduction(self) -> float:
        """1 - T / T_ref, where T is the budget if the target was not reached."""
        return 1 - _time(self.candidate) / _time(self.reference)


def _time(row: EpisodeRow) -> int:
    # A target that is reached where the agent starts takes one step's worth of time, so that
    # the ratio is defined.
    return max(row.mapping_time if row.mapping_time is not None else row.max_steps, 1)


def pair_episodes(reference: Iterable[EpisodeRow], candidate: Iterable[EpisodeRow]) -> list[Pair]:
    """Pairs by floor plan, start and seed, in the order of `reference`; the rest is left out."""

    def key(row: EpisodeRow) -> tuple[str, int, int, int]:
        return row.floor_plan, row.start_row, row.start_col, row.seed

    others = {key(row): row for row in candidate}
    return [Pair(row, others[key(row)]) for row in reference if key(row) in others]


def mean_reduction(pairs: Sequence[Pair]) -> Estimate:
    """The mean over floor plans of the reduction, with a 95 % interval."""
    return mean_interval([pair.reduction for pair in pairs])
