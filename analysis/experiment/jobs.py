"""The episodes of an experiment, and how one is run.

fused/fused is simulated with fail-safe only: what happens without it is the same up to the first
step at which the agent is sealed in, and ends there. So one job gives both rows.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import TypeAlias

from mapreplay.analysis.experiment.config import Dataset, ExperimentConfig
from mapreplay.analysis.experiment.controls import CONTROLS
from mapreplay.analysis.experiment.infill import PREFIX as INFILL
from mapreplay.analysis.experiment.infill import InFill
from mapreplay.analysis.experiment.rows import Row
from mapreplay.config import EpisodeConfig, MapKind
from mapreplay.episode import Episode, prepare_episode, run_episode, versions
from mapreplay.errors import MapreplayError
from mapreplay.floorplan import FloorPlan
from mapreplay.predictors import Predictor, kept_predictor
from mapreplay.source_digest import source_digest
from mapreplay.step import Mode, Outcome, Step

Identity: TypeAlias = tuple[str | bool | int, ...]
"""What a row is of: no two rows of an experiment are of the same."""


@dataclass(frozen=True, eq=False)
class Job:
    """One simulation."""

    dataset: str
    floor_plan: FloorPlan
    config: EpisodeConfig
    wall_share: float
    """What the control ``mean-wall`` says."""
    weights: Path | None = None
    """The file of the predictor's weights, where the configuration names one."""

    def predictor(self) -> Predictor:
        """The predictor of this job: a control, an oracle, or the registered one of that name."""
        name = self.config.predictor
        if self.weights is not None:
            return kept_predictor(str(self.weights))
        if name in CONTROLS:
            return CONTROLS[name](self.wall_share)
        if name.startswith(INFILL):
            radius = int(name.removeprefix(INFILL))
            return InFill(self.floor_plan, radius, self.wall_share)
        return kept_predictor(name)

    def digest(self, weights: str) -> str:
        """Of all that its rows depend on: also of the predictor's weights (their SHA-256) and of
        the code that there is now.
        """
        about = [
            self.config.model_dump_json(), self.floor_plan.sha256, self.wall_share, weights,
            code_digest(), versions(),
        ]  # fmt: skip
        return hashlib.sha256(json.dumps(about).encode()).hexdigest()[:16]

    def identities(self) -> list[Identity]:
        """Those of the rows that this job gives, with the weights that there are now."""
        config, sha256 = self.config, self.predictor().identity.sha256
        return [
            (
                self.dataset, self.floor_plan.id, config.planner, config.plan_on.value,
                config.build.value, fail_safe, config.seed, config.predictor, sha256,
            )
            for fail_safe in ((True, False) if config.fail_safe else (False,))
        ]  # fmt: skip


@cache
def code_digest() -> str:
    """Of our code that rows depend on."""
    return source_digest("mapreplay.analysis.experiment.jobs")


def identity(row: Row) -> Identity:
    """What a row is of."""
    return row.key


def jobs_of(config: ExperimentConfig, dataset: Dataset, plans: Sequence[FloorPlan]) -> list[Job]:
    """All jobs on a dataset: first those of the first run, then those of the second, ...

    So that a stopped experiment is a smaller experiment and not half a one.
    """
    jobs = []
    for run in range(max(planning.runs for planning in config.planners)):
        for planning in config.planners:
            if run >= planning.runs:
                continue
            episodes = list(_configurations(config, dataset, planning.planner, config.seed + run))
            jobs += [
                Job(dataset.name, plan, episode, dataset.wall_share, dataset.weights_of(episode))
                for episode in episodes
                for plan in plans
            ]
    return jobs


def _configurations(
    config: ExperimentConfig, dataset: Dataset, planner: str, seed: int
) -> Iterator[EpisodeConfig]:
    for maps in config.maps:
        kinds = (maps.plan_on, maps.build)
        predictor = dataset.predictor if MapKind.FUSED in kinds else "none"
        both = kinds == (MapKind.FUSED, MapKind.FUSED)
        yield config.episode(planner, predictor, maps, seed, fail_safe=both)
        if both and planner != "random" and seed == config.seed:
            for other in (*config.controls, *(f"{INFILL}{radius}" for radius in config.infill)):
                yield config.episode(planner, other, maps, seed, fail_safe=True)


def run_job(job: Job, predictor: Predictor) -> list[Row]:
    """Simulate; one row, or with fail-safe two: with it, and without.

    Raises:
        MapreplayError: the planner or predictor failed.
    """
    began = time.process_time()
    episode = prepare_episode(job.config, job.floor_plan, predictor=predictor)
    follow = _Follow(job, episode)
    for step in run_episode(episode):
        follow.add(step)
    return follow.rows(time.process_time() - began)


class _Follow:
    """What is kept of the steps of an episode."""

    def __init__(self, job: Job, episode: Episode) -> None:
        self._job = job
        self._header = episode.header
        self._digest = job.digest(episode.header.predictor.sha256)
        self._mapped: int | None = None
        self._corrected: int | None = None
        self._sealed: tuple[Step, int | None] | None = None
        """The first step without a frontier, and the time of correct coverage until then."""
        self._fail_safe_steps = 0
        self._last: Step | None = None

    def add(self, step: Step) -> None:
        config, metrics = self._job.config, step.metrics
        if self._mapped is None and metrics.coverage(config.build) >= config.coverage:
            self._mapped = step.index
        right = metrics.correct_coverage(config.build)
        if self._corrected is None and right >= config.correct_coverage:
            self._corrected = step.index
        safe = step.mode is Mode.FAIL_SAFE
        self._fail_safe_steps += safe
        if self._sealed is None and (safe or step.outcome is Outcome.SEALED_IN):
            self._sealed = step, self._corrected
        self._last = step

    def rows(self, seconds: float) -> list[Row]:
        last = self._last
        if last is None or last.outcome is None:
            raise MapreplayError(f"{self._job.floor_plan.id}: the episode has no end")
        row = self._row(last, last.outcome, self._mapped, self._corrected, seconds)
        if not self._job.config.fail_safe:
            return [row]
        without = replace(row, fail_safe=False, fail_safe_steps=0)
        if self._sealed is not None:
            step, corrected = self._sealed
            without = replace(
                self._row(step, Outcome.SEALED_IN, None, corrected, seconds),
                fail_safe=False,
                fail_safe_steps=0,
            )
        return [row, without]

    def _row(
        self,
        step: Step,
        outcome: Outcome,
        mapped: int | None,
        corrected: int | None,
        seconds: float,
    ) -> Row:
        config, metrics = self._job.config, step.metrics
        return Row(
            dataset=self._job.dataset,
            floor_plan=self._job.floor_plan.id,
            planner=config.planner,
            plan_on=config.plan_on.value,
            build=config.build.value,
            fail_safe=config.fail_safe,
            seed=config.seed,
            predictor=config.predictor,
            sha256=self._header.predictor.sha256,
            outcome=outcome.value,
            steps=step.index,
            budget=self._header.max_steps,
            mapping_time=mapped,
            correct_time=corrected,
            path_length=metrics.path_length,
            f1=metrics.f1,
            precision=metrics.precision,
            recall=metrics.recall,
            coverage=metrics.coverage(config.build),
            correct=metrics.correct_coverage(config.build),
            sealed_step=self._sealed[0].index if self._sealed else None,
            fail_safe_steps=self._fail_safe_steps,
            seconds=round(seconds, 4),
            digest=self._digest,
        )
