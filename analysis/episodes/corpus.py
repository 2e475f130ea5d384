"""Many episodes at once: what is known of each, and which of them belong together.

Read from the scalars of a log, so that a thousand take seconds. Two episodes are a pair if they
are on the same floor plan (cell for cell), from the same start, with the same seed.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from mapreplay.analysis.episodes.curves import Curve
from mapreplay.analysis.episodes.summary import EpisodeRow, row_of_log
from mapreplay.analysis.pool import WorkerError, map_unordered
from mapreplay.config import MapKind
from mapreplay.errors import MapreplayError
from mapreplay.recorders.log.blame import UnforeseenError, blaming
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.recorders.log.state import LogState, by_step
from mapreplay.step import EpisodeHeader, Mode
from mapreplay.text import printable


class Start(NamedTuple):
    """Where an episode is run, beside its seed."""

    floor_plan_sha256: str
    row: int
    col: int


class PairKey(NamedTuple):
    """What two episodes of a pair have in common."""

    start: Start
    seed: int


@dataclass(frozen=True, eq=False)
class LoggedEpisode:
    """An episode as far as its scalars tell."""

    path: Path
    header: EpisodeHeader
    row: EpisodeRow
    coverage: Curve
    """float64[steps + 1], of the built map, like the next two; NaN without a true map."""
    correct: Curve
    f1: Curve
    metres: Curve
    """Travelled so far."""
    observed: Curve
    """Coverage of the observed map."""
    fail_safe: npt.NDArray[np.bool_]
    """bool[steps + 1]: planned in fail-safe mode."""
    state: LogState
    """Whether the log is whole. Of one that misses steps, the curves are NaN there."""
    log: EpisodeLog
    """What it was read from."""

    @property
    def start(self) -> Start:
        """Floor plan and start."""
        header = self.header
        return Start(header.floor_plan.sha256, *header.start)

    @property
    def key(self) -> PairKey:
        """What it is paired by."""
        return PairKey(self.start, self.header.config.seed)


def read_episode(path: Path) -> LoggedEpisode:
    """What the log at `path` says of its episode in scalars, finished or not.

    Raises:
        LogError: it cannot be read.
    """
    return episode_of(EpisodeLog(path))


def episode_of(log: EpisodeLog) -> LoggedEpisode:
    """What an open log says of its episode in scalars, finished or not.

    Raises:
        LogError: it cannot be read.
    """
    built = "observed" if log.header.config.build is MapKind.OBSERVED else "fused"
    table = log.table()

    def curve(name: str) -> Curve:
        return by_step(table["step"].to_numpy(), table[name].to_numpy())

    return LoggedEpisode(
        path=log.path,
        header=log.header,
        row=row_of_log(log, printable(str(log.path))),
        coverage=curve(f"coverage_{built}"),
        correct=curve(f"correct_coverage_{built}"),
        f1=curve("f1"),
        metres=curve("path_length"),
        observed=curve("coverage_observed"),
        fail_safe=by_step(
            table["step"].to_numpy(), (table["mode"] == Mode.FAIL_SAFE.value).to_numpy()
        )
        == 1,
        state=log.state,
        log=log,
    )


@dataclass(frozen=True)
class Unreadable:
    """A log that could not be read; the reason names it."""

    path: Path
    error: MapreplayError


def read_corpus(paths: Sequence[Path], jobs: int = 1) -> Iterator[LoggedEpisode | Unreadable]:
    """`read_episode` of every path, as they are done; what cannot be read is a result, too."""
    return map_unordered(_read, paths, jobs, lost=_lost)


def _read(path: Path) -> LoggedEpisode | Unreadable:
    try:
        with blaming(path):
            episode = read_episode(path)
            episode.log.forget()  # there may be thousands of them
            return episode
    except MapreplayError as error:
        return Unreadable(path, error)


def _lost(path: Path, error: WorkerError) -> Unreadable:
    return Unreadable(path, UnforeseenError(f"{path}: {error}"))


Pairs: TypeAlias = list[tuple[LoggedEpisode, LoggedEpisode]]


@dataclass(frozen=True, eq=False)
class Pairing:
    """Two sets of episodes, as far as they belong together."""

    pairs: Pairs
    """(A, B), in the order of A."""
    only_a: list[LoggedEpisode]
    only_b: list[LoggedEpisode]
    repeated: list[tuple[LoggedEpisode, LoggedEpisode]]
    """Two episodes of one set that cannot be told apart; neither is paired."""


def pair(a: Iterable[LoggedEpisode], b: Iterable[LoggedEpisode]) -> Pairing:
    """Pair two sets of episodes by floor plan, start and seed."""
    repeated: list[tuple[LoggedEpisode, LoggedEpisode]] = []
    of_a, of_b = _by_key(a, repeated), _by_key(b, repeated)
    return Pairing(
        pairs=[(episode, of_b[key]) for key, episode in of_a.items() if key in of_b],
        only_a=[episode for key, episode in of_a.items() if key not in of_b],
        only_b=[episode for key, episode in of_b.items() if key not in of_a],
        repeated=repeated,
    )


def _by_key(
    episodes: Iterable[LoggedEpisode], repeated: list[tuple[LoggedEpisode, LoggedEpisode]]
) -> Mapping[PairKey, LoggedEpisode]:
    found: dict[PairKey, LoggedEpisode] = {}
    twice = set()
    for episode in episodes:
        if episode.key in found:
            repeated.append((found[episode.key], episode))
            twice.add(episode.key)
        else:
            found[episode.key] = episode
    return {key: episode for key, episode in found.items() if key not in twice}
