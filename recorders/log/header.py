"""What a log says once, as the string pairs of two MCAP metadata records.

``mapreplay.episode`` is written first, so that unfinished files have it; it carries a
checksum of its own, because MCAP's cover metadata only in finished files.
``mapreplay.outcome`` is written last; its outcome is empty in a recovered log, whose end is
lost (see `mapreplay.recorders.log.recover`).
"""

from __future__ import annotations

import json
import math
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from pydantic import ValidationError

from mapreplay.config import EpisodeConfig, describe
from mapreplay.errors import LogError
from mapreplay.floorplan import FloorPlan
from mapreplay.grid import Cell
from mapreplay.recorders.log.limits import MAX_BUDGET, MAX_STEPS
from mapreplay.step import OURS, Branch, EpisodeHeader, Outcome, PredictorIdentity, Step

FORMAT_VERSION: Final = 1
EPISODE_RECORD: Final = "mapreplay.episode"
OUTCOME_RECORD: Final = "mapreplay.outcome"

Pairs = Mapping[str, str]


@dataclass(frozen=True)
class EpisodeSummary:
    """How an episode ended."""

    outcome: Outcome | None
    """None in a recovered log, whose end is lost."""
    steps: int
    """Moves made: the index of the last step that there is."""
    mapping_time: int | None
    """The first step at which the coverage of the built map reached the target."""
    correct_time: int | None
    """The first step at which its correct coverage reached `config.correct_coverage`."""
    path_length: float
    """Metres."""

    def after(self, step: Step, config: EpisodeConfig) -> EpisodeSummary:
        """The summary with one more step, the next, counted."""
        metrics, mapping_time, correct_time = step.metrics, self.mapping_time, self.correct_time
        if mapping_time is None and metrics.coverage(config.build) >= config.coverage:
            mapping_time = step.index
        right = metrics.correct_coverage(config.build)
        if correct_time is None and right >= config.correct_coverage:
            correct_time = step.index
        return EpisodeSummary(
            step.outcome, step.index, mapping_time, correct_time, metrics.path_length
        )


NO_STEPS: Final = EpisodeSummary(None, -1, None, None, 0.0)
"""Before the first step."""


def episode_pairs(header: EpisodeHeader) -> dict[str, str]:
    """The record ``mapreplay.episode``; no path, host or date is in it."""
    pairs = {
        "format_version": str(FORMAT_VERSION),
        "config": header.config.model_dump_json(),
        "floor_plan_id": header.floor_plan.id,
        "floor_plan_sha256": header.floor_plan.sha256,
        # An OccupancyGrid keeps only a float32 of it.
        "resolution": repr(float(header.floor_plan.resolution)),
        "start": json.dumps(header.start),
        "max_steps": str(header.max_steps),
        "predictor": header.predictor.name,
        "predictor_sha256": header.predictor.sha256,
        "seed": str(header.config.seed),
        "versions": json.dumps(dict(header.versions)),
        "simulator": header.simulator,
    }
    if header.branch is not None:
        pairs["branch"] = json.dumps(_branch_values(header.branch))
    return pairs | {"crc32": _crc(pairs)}


_OWN_KEYS: Final = ("config", "max_steps", "predictor", "predictor_sha256", "versions")
"""What a branch may say otherwise than its parent; all else holds for both."""


def _branch_values(branch: Branch) -> dict[str, object]:
    pairs = episode_pairs(branch.before)
    before: dict[str, object] = {key: pairs[key] for key in _OWN_KEYS}
    if branch.before.branch is not None:
        before["branch"] = _branch_values(branch.before.branch)
    return {
        "parent_sha256": branch.parent_sha256,
        "step": branch.step,
        "changes": branch.changes,
        "before": before,
    }


def check_episode_pairs(pairs: Pairs) -> None:
    """Whether this version can read the log, and whether the record is intact.

    Raises:
        LogError: the log was written by a newer version.
        KeyError, ValueError: the record is damaged.
    """
    version = int(pairs["format_version"])
    if version > FORMAT_VERSION:
        raise LogError(
            f"log format {version} is newer than {FORMAT_VERSION}, the newest that this "
            "mapreplay reads; upgrade mapreplay"
        )
    if pairs["crc32"] != _crc({key: pairs[key] for key in pairs if key != "crc32"}):
        raise ValueError(f"the checksum of {EPISODE_RECORD} does not match")


def header_of(pairs: Pairs, floor_plan: FloorPlan) -> EpisodeHeader:
    """The header that `episode_pairs` and the true map tell.

    Raises:
        LogError: the configuration has an illegal value, or the map is not the one meant.
        KeyError, ValueError: the record is damaged.
        FloorPlanError: the start is not a free cell.
    """
    try:
        config = EpisodeConfig.model_validate_json(pairs["config"])
    except ValidationError as error:
        raise LogError(f"its configuration: {describe(error)[:200]}") from None
    if floor_plan.sha256 != pairs["floor_plan_sha256"]:
        raise ValueError("the true map is not the one that the metadata names")
    row, col = json.loads(pairs["start"])
    max_steps = int(pairs["max_steps"])
    if not 1 <= max_steps <= MAX_BUDGET:
        raise ValueError(f"a budget of {max_steps} steps; 1 to {MAX_BUDGET} are allowed")
    return EpisodeHeader(
        config=config,
        floor_plan=floor_plan,
        start=floor_plan.check_start(Cell(row, col)),
        max_steps=max_steps,
        predictor=PredictorIdentity(pairs["predictor"], pairs["predictor_sha256"]),
        versions=tuple(json.loads(pairs["versions"]).items()),
        simulator=pairs.get("simulator", OURS),
        branch=_branch_of(pairs, floor_plan) if "branch" in pairs else None,
    )


def _branch_of(pairs: Pairs, floor_plan: FloorPlan) -> Branch:
    values = json.loads(pairs["branch"])
    before = {key: value for key, value in pairs.items() if key != "branch"}
    for key, value in values["before"].items():
        before[key] = value if isinstance(value, str) else json.dumps(value)
    step = int(values["step"])
    if not 0 <= step < MAX_STEPS:
        raise ValueError(f"a branch at step {step}; at most {MAX_STEPS} are allowed")
    return Branch(
        parent_sha256=str(values["parent_sha256"]),
        step=step,
        changes=tuple(map(str, values["changes"])),
        before=header_of(before, floor_plan),
    )


def outcome_pairs(summary: EpisodeSummary, missing: Sequence[range] = ()) -> dict[str, str]:
    """The record ``mapreplay.outcome``; what was never reached is empty.

    Args:
        summary: Of the steps that there are.
        missing: Steps that are not, of a recovered log.
    """
    mapping, correct = summary.mapping_time, summary.correct_time
    gaps = [[gap.start, gap.stop - 1] for gap in missing]
    return {
        "outcome": str(summary.outcome or ""),
        "steps": str(summary.steps),
        "mapping_time": "" if mapping is None else str(mapping),
        "correct_time": "" if correct is None else str(correct),
        "path_length": repr(float(summary.path_length)),
    } | ({"missing_steps": json.dumps(gaps)} if gaps else {})


def missing_of(pairs: Pairs) -> tuple[range, ...]:
    """The steps that are missing, by the record ``mapreplay.outcome``.

    Raises:
        KeyError, TypeError, ValueError: the record is damaged.
    """
    gaps = tuple(range(int(a), int(b) + 1) for a, b in json.loads(pairs.get("missing_steps", "[]")))
    ends = [-1, *(end for gap in gaps for end in (gap.start, gap.stop)), int(pairs["steps"])]
    if ends != sorted(ends) or not all(gaps):
        raise ValueError("missing steps that are not in order")
    return gaps


def summary_of(pairs: Pairs) -> EpisodeSummary:
    """The inverse of `outcome_pairs`.

    Raises:
        KeyError, ValueError: the record is damaged.
    """
    steps = int(pairs["steps"])
    if not 0 <= steps < MAX_STEPS:
        raise ValueError(f"{steps} steps; at most {MAX_STEPS} are allowed")
    path_length = float(pairs["path_length"])
    if not 0 <= path_length < math.inf:
        raise ValueError(f"a path of {path_length} m")
    return EpisodeSummary(
        outcome=Outcome(pairs["outcome"]) if pairs["outcome"] else None,
        steps=steps,
        mapping_time=_time(pairs["mapping_time"], steps),
        correct_time=_time(pairs["correct_time"], steps),
        path_length=path_length,
    )


def _time(text: str, steps: int) -> int | None:
    if not text:
        return None
    time = int(text)
    if not 0 <= time <= steps:
        raise ValueError(f"step {time} of {steps}")
    return time


def _crc(pairs: Pairs) -> str:
    return f"{zlib.crc32(json.dumps(sorted(pairs.items())).encode()):08x}"
