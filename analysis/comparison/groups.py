"""Episodes in groups that differ in what is compared; any other difference is reported."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Final, TypeAlias

from mapreplay.analysis.episodes.corpus import LoggedEpisode, PairKey, Start
from mapreplay.analysis.episodes.summary import UNFINISHED
from mapreplay.analysis.reporting.wording import counted
from mapreplay.config import EpisodeConfig
from mapreplay.errors import MapreplayError, UsageError
from mapreplay.step import Branch, EpisodeHeader

_NOT_COMPARED: Final = {"seed", "start"}
"""Keys of a configuration that pair episodes rather than group them."""
KEYS: Final = (
    *(key for key in EpisodeConfig.model_fields if key not in _NOT_COMPARED),
    "simulator",
    "branch",
)
"""What episodes can be compared by."""
COMBINED: Final = {
    "maps": ("plan_on", "build"),
    "thresholds": ("delta_free", "delta_occupied"),
    "configuration": KEYS,
}
"""Several keys under one name; "configuration" is all of them."""


Label: TypeAlias = Callable[[LoggedEpisode, Sequence[str]], tuple[str, ...]]
"""The values of an episode for some keys."""


@dataclass(frozen=True, eq=False)
class Group:
    """Episodes of one configuration, in the keys that matter."""

    name: str
    episodes: tuple[LoggedEpisode, ...]

    @property
    def places(self) -> dict[Start, list[LoggedEpisode]]:
        """The runs of each floor plan and start, in order."""
        found: dict[Start, list[LoggedEpisode]] = {}
        for episode in self.episodes:
            found.setdefault(episode.start, []).append(episode)
        return found


@dataclass(frozen=True, eq=False)
class Grouping:
    """Groups whose episodes can be compared, floor plan by floor plan."""

    groups: tuple[Group, ...]
    by: tuple[str, ...]
    """The keys whose values name a group."""
    notes: tuple[str, ...]
    """What was left out or kept apart, and what else differs: one sentence each."""


def value_of(header: EpisodeHeader, key: str) -> str:
    """The part of a group's name from one key."""
    if key == "predictor":
        return header.predictor.name
    if key == "simulator":
        return header.simulator
    if key == "branch":
        return f"branch with {_changes(header.branch)}" if header.branch else "no branch"
    value = getattr(header.config, key)
    if isinstance(value, bool):
        return f"{key.replace('_', '-')} {'on' if value else 'off'}"
    if isinstance(value, float | int) or value is None:
        return f"{key.replace('_', '-')} {'default' if value is None else value}"
    return str(value)


def _changes(branch: Branch) -> str:
    """The changes of a branch and of its parents, without the steps."""
    before = branch.before.branch
    earlier = f"{_changes(before)}, then " if before else ""
    return earlier + ", ".join(branch.changes)


def _facts(header: EpisodeHeader) -> dict[str, str]:
    """Everything that must not be mixed, by key."""
    facts = {key: value_of(header, key) for key in KEYS}
    weights = header.predictor.sha256
    return facts | {"weights": f"weights {weights[:8]}" if weights else ""}


def group_episodes(episodes: Sequence[LoggedEpisode], by: Sequence[str]) -> Grouping:
    """Group by the values of `by`, and keep apart what else would be mixed in a group.

    Episodes that were cut off are left out, and so is the second of two with the same
    configuration and seed. So are branches among other episodes, whose first steps they share,
    unless `by` names "branch". All other differences between the groups are reported. The order
    of `episodes` does not matter: floor plans are sorted by id, and runs by seed.

    Raises:
        UsageError: there is no such key.
        MapreplayError: no finished episode is left.
    """
    keys = _keys(by)
    notes: list[str] = []
    episodes = sorted(episodes, key=lambda e: (e.row.floor_plan, e.key, str(e.path)))
    finished = [e for e in episodes if e.row.outcome != UNFINISHED]
    if len(finished) < len(episodes):
        notes.append(f"{counted(len(episodes) - len(finished), 'unfinished episode')} left out")
    if not finished:
        raise MapreplayError("no finished episode to compare")
    whole = [e for e in finished if e.header.branch is None]
    if 0 < len(whole) < len(finished) and "branch" not in by:
        left_out = counted(len(finished) - len(whole), "branched episode")
        notes.append(f"{left_out} left out; --by branch compares them")
        finished = whole
    facts = {id(episode): _facts(episode.header) for episode in finished}

    def label(episode: LoggedEpisode, names: Sequence[str]) -> tuple[str, ...]:
        return tuple(facts[id(episode)][name] for name in names)

    mixed = _mixed(finished, keys, label)
    if mixed:
        notes.append(f"kept apart, because one group would mix them: {_list(mixed)}")
    names = [*keys, *mixed]
    found: dict[tuple[str, ...], list[LoggedEpisode]] = {}
    for episode in finished:
        found.setdefault(label(episode, names), []).append(episode)
    varying = [i for i in range(len(names)) if len({values[i] for values in found}) > 1]
    groups = []
    for values in sorted(found):
        name = " ".join(value for i in varying or range(len(keys)) if (value := values[i]))
        groups.append(Group(name, tuple(_without_duplicates(found[values], notes))))
    if len(groups) > 1:
        others = [k for k in (*KEYS, "weights") if k not in names]
        also = [k for k in others if len({facts[id(e)][k] for e in finished}) > 1]
        if also:
            notes.append(f"the groups also differ in {_list(also)}")
    versions = {dict(e.header.versions).get("mapreplay") for e in finished}
    if len(versions) > 1:
        notes.append(f"recorded with mapreplay {_list(sorted(map(str, versions)))}")
    return Grouping(tuple(groups), tuple(names), tuple(notes))


def _keys(by: Sequence[str]) -> list[str]:
    keys: list[str] = []
    for name in by:
        key = name.replace("-", "_")
        if key not in KEYS and key not in COMBINED:
            raise UsageError(f"--by {name}: there is {_list([*COMBINED, *KEYS])}")
        keys += [k for k in COMBINED.get(key, (key,)) if k not in keys]
    return keys


def _mixed(episodes: Iterable[LoggedEpisode], keys: Sequence[str], label: Label) -> list[str]:
    """Further keys that have several values within a group."""
    episodes, mixed = list(episodes), list[str]()
    for key in (*KEYS, "weights"):
        if key in keys:
            continue
        names = [*keys, *mixed]
        together = {label(e, names) for e in episodes}
        if len({label(e, [*names, key]) for e in episodes}) > len(together):
            mixed.append(key)
    return mixed


def _without_duplicates(
    episodes: Iterable[LoggedEpisode], notes: list[str]
) -> Iterable[LoggedEpisode]:
    seen: dict[PairKey, LoggedEpisode] = {}
    for episode in episodes:
        if episode.key in seen:
            first = seen[episode.key].path
            notes.append(f"left out, a duplicate of {first}: {episode.path}")
        else:
            seen[episode.key] = episode
    return seen.values()


def _list(words: Iterable[str]) -> str:
    return ", ".join(words)
