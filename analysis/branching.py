"""What would have happened? An episode run on from a logged step under a changed assumption.

The result is an episode of its own, whole: the parent's steps up to the branch, then what the
simulator makes from the agent's place and all that it had observed there. Its log names the
parent, the step and the change, and is verified like any other. The change acts on everything
that follows (closed loop), unlike a threshold that is tried on the logged predictions.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from mapreplay import mapping
from mapreplay.analysis.logged_predictor import logged_predictor
from mapreplay.config import EpisodeConfig, PredictionDtype
from mapreplay.episode import Episode, prepare_episode, run_episode
from mapreplay.errors import UsageError
from mapreplay.grid import FREE, OCCUPIED, Grid
from mapreplay.mapping import Thresholds
from mapreplay.planners import planner_of
from mapreplay.predictors import Predictor, choice_of, load_predictor
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.stages import Past
from mapreplay.step import OURS, Branch, EpisodeHeader, PredictorIdentity, Step

TRUTH: Final = "truth"
OBSERVED: Final = "observed"
_KEYS: Final = (
    "planner",
    "predictor",
    "delta-free",
    "delta-occupied",
    "fail-safe",
    "seed",
    "max-steps",
)
_NUMBERS: Final[dict[str, Callable[[str], Any]]] = {
    "delta-free": float,
    "delta-occupied": float,
    "seed": int,
    "max-steps": int,
}
_SWITCH: Final = {"on": True, "off": False}
FORMS: Final = f"{TRUTH}, {OBSERVED}, {', '.join(f'{key}=...' for key in _KEYS)}"
"""What a change may look like."""


@dataclass(frozen=True, eq=False)
class SetRight:
    """A predictor whose false claims are set right: it is as sure as it was, and never wrong.

    Where its prediction, thresholded, is sure of a class that is not the true one, P(occupied)
    is that of the truth. What it leaves open stays open.
    """

    predictor: Predictor
    truth: Grid
    thresholds: Thresholds
    dtype: PredictionDtype
    """How it will be logged, and so thresholded."""

    @property
    def identity(self) -> PredictorIdentity:
        """The predictor's, marked."""
        inner = self.predictor.identity
        return PredictorIdentity(f"{inner.name} set right", inner.sha256)

    def predict(self, observed: Grid) -> npt.NDArray[np.float32] | None:
        """See `mapreplay.predictors.Predictor`."""
        p_wall = self.predictor.predict(observed)
        if p_wall is None:
            return None
        sure = mapping.threshold(mapping.quantize(p_wall, self.dtype), self.thresholds)
        right = p_wall.copy()
        right[(sure == OCCUPIED) & (self.truth == FREE)] = 0
        right[(sure == FREE) & (self.truth == OCCUPIED)] = 1
        return right

    def choice(self, observed: Grid) -> str | None:
        """See `mapreplay.predictors.Choosing`."""
        return choice_of(self.predictor, observed)


def is_set_right(header: EpisodeHeader) -> bool:
    """Whether the predictions are set right by the truth: since the change that says so, until
    one that chooses another predictor.
    """
    branch = header.branch
    if branch is None:
        return False
    if TRUTH in branch.changes:
        return True
    other = any(c == OBSERVED or c.startswith("predictor=") for c in branch.changes)
    return not other and is_set_right(branch.before)


def predictor_of(header: EpisodeHeader, device: str, weights: Sequence[Path] = ()) -> Predictor:
    """What predicted under `header`; see `mapreplay.analysis.logged_predictor`.

    Raises:
        PluginError, WeightsError: it cannot be loaded.
    """
    predictor = logged_predictor(header, device, weights)
    if is_set_right(header):
        return set_right(predictor, header)
    return predictor


def set_right(predictor: Predictor, header: EpisodeHeader) -> SetRight:
    """`predictor` with its false claims set right, in the episode of `header`."""
    return SetRight(
        predictor, header.floor_plan.cells, header.thresholds, header.config.prediction_dtype
    )


def lineage(header: EpisodeHeader) -> list[EpisodeHeader]:
    """The headers of a log, that of the first steps first; one without a branch."""
    before = lineage(header.branch.before) if header.branch else []
    return [*before, header]


def run_again(header: EpisodeHeader, predictors: Sequence[Predictor]) -> Iterator[Step]:
    """Run an episode from what a log says once: all parents up to their branches, in turn.

    Args:
        header: Of the log.
        predictors: One for each header of the `lineage`.

    Raises:
        PluginError: a planner cannot be loaded.
        MapreplayError: a planner or predictor returned something impossible.
    """
    past: Past | None = None
    if header.branch is not None:
        before = header.branch.before
        past = Past.at_start(before)
        parent = run_again(before, predictors[:-1])
        for step in islice(parent, header.branch.step):
            yield step
            if step.decision is None:
                return
            past = past.after(step, step.decision.next_cell, before.at(step.index))
    episode = prepare_episode(
        header.config, header.floor_plan, planner_of(header), predictor=predictors[-1]
    )
    yield from run_episode(episode, past)


@dataclass(frozen=True, eq=False)
class BranchedEpisode:
    """An episode that is to be run on from a step of a log."""

    episode: Episode
    parent: EpisodeLog
    past: Past
    """What the step takes over from those before it."""

    @property
    def header(self) -> EpisodeHeader:
        """Of the log that is to be written."""
        return self.episode.header

    def steps(self) -> Iterator[Step]:
        """The parent's steps before the branch, then those that are made anew."""
        yield from islice(self.parent.steps(), self.past.index)
        yield from run_episode(self.episode, self.past)


def branch(
    log: EpisodeLog,
    at: int,
    changes: Sequence[str],
    device: str = "cpu",
    predictor: Predictor | None = None,
    weights: Sequence[Path] = (),
) -> BranchedEpisode:
    """Prepare to run the episode of `log` on from step `at` under `changes`.

    Args:
        log: Finished or not; of this simulator.
        at: The step that is made anew, from its place and what was observed before its scan;
            negative ones count from the end.
        changes: `TRUTH` (false claims of the predictor are set right), `OBSERVED` (nothing is
            predicted any more), or ``key=value``, such as ``delta-occupied=0.97``.
        device: Of the predictor.
        predictor: Used instead of loading the one by name.
        weights: Files, one of which may have the weights that the log was recorded with.

    Raises:
        UsageError: there is no such step, a change that is none, or an external log.
        ConfigError: a value is out of range.
        PluginError, WeightsError: the planner or predictor cannot be loaded, or is not the one
            that the log was recorded with.
        LogError: the log cannot be read.
    """
    if log.header.simulator != OURS:
        raise UsageError(
            f"{log.path}: recorded by {log.header.simulator}, which cannot be run on here"
        )
    index = at + log.last + 1 if at < 0 else at
    if not 0 <= index <= log.last:
        raise UsageError(f"--at {at}: {log.path} has steps 0 to {log.last}")
    log.check_whole_until(index, "a branch from there")
    before = log.header.at(index)
    values = config_values(changes, before)
    config = EpisodeConfig.of(before.config.model_dump() | values, "branch")
    if predictor is None and "predictor" in values:
        predictor = load_predictor(values["predictor"], device)
    elif predictor is None:
        predictor = logged_predictor(before, device, weights)
    draft = prepare_episode(config, before.floor_plan, predictor=predictor)
    branch = Branch(_sha256(log), index, tuple(changes), before)
    header = replace(draft.header, start=before.start, branch=branch)
    used = draft.predictor
    if "predictor" not in values and used.identity.sha256 != before.predictor.sha256:
        raise UsageError(
            f"{log.path}: recorded with other weights of {config.predictor} "
            f"({before.predictor.sha256[:12]}; here {used.identity.sha256[:12]}); give them with "
            "--predictor FILE, or name another predictor with --with predictor=NAME"
        )
    if is_set_right(header):
        used = set_right(used, header)
    header = replace(header, predictor=used.identity)
    return BranchedEpisode(Episode(header, draft.planner, used), log, past_at(log, index))


def past_at(log: EpisodeLog, index: int) -> Past:
    """What step `index` of a log takes over from those before it, from the log alone.

    Raises:
        LogError: the log cannot be read.
    """
    past = Past.at_start(log.header)
    before: Step | None = None
    for step in islice(log.steps(), index + 1):
        if before is not None:
            past = past.after(before, step.agent, log.header.at(before.index))
        before = step
    return past


def config_values(changes: Sequence[str], before: EpisodeHeader) -> dict[str, Any]:
    """The keys of `EpisodeConfig` that `changes` set.

    Raises:
        UsageError: one is of no known form, two say the same, or nothing would change.
    """
    values: dict[str, Any] = {}
    if not changes:
        raise UsageError(f"branch: say with --with what is to change: {FORMS}")
    for change in changes:
        key, value = _parse(change)
        if key in values:
            raise UsageError(f"--with {change}: {key.replace('_', '-')} is changed twice")
        values[key] = value
    if values.pop(TRUTH, None) and before.config.predictor == "none" and not values:
        raise UsageError(f"--with {TRUTH}: nothing was predicted that could be set right")
    return values


def _parse(change: str) -> tuple[str, Any]:
    if change == TRUTH:
        return TRUTH, True
    if change == OBSERVED:
        return "predictor", "none"
    key, equals, value = change.partition("=")
    if not equals or key not in _KEYS:
        raise UsageError(f"--with {change}: expected one of {FORMS}")
    if key == "fail-safe":
        if value not in _SWITCH:
            raise UsageError(f"--with {change}: expected fail-safe=on or fail-safe=off")
        return "fail_safe", _SWITCH[value]
    with suppress(ValueError):  # what is no number the configuration refuses, by its name
        return key.replace("-", "_"), _NUMBERS.get(key, str)(value)
    return key.replace("-", "_"), value


def _sha256(log: EpisodeLog) -> str:
    with log.path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def branch_path(parent: Path, header: EpisodeHeader) -> Path:
    """Where the log of a branch goes by default: beside its parent, named after the change."""
    branch = header.branch
    stem = parent.name.removesuffix(".part").removesuffix(".mcap")
    if branch is None:
        return parent.with_name(f"{stem}.mcap")
    change = re.sub(r"[^A-Za-z0-9.=+-]+", "-", "+".join(branch.changes))[:80]
    return parent.with_name(f"{stem}.at{branch.step}-{change}.mcap")
