"""The episodes of an experiment, and how one is run.

fused/fused is simulated with fail-safe only: what happens without it is the same up to the first
step at which the agent is sealed in, and ends there. So one job gives both logs.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final

from mapreplay.analysis.experiment.config import Dataset, ExperimentConfig
from mapreplay.analysis.experiment.controls import CONTROLS
from mapreplay.analysis.experiment.infill import PREFIX as INFILL
from mapreplay.analysis.experiment.infill import InFill
from mapreplay.analysis.experiment.without import WithoutFailSafe, without_fail_safe
from mapreplay.config import EpisodeConfig, MapKind
from mapreplay.episode import Episode, StepSink, prepare_episode, record
from mapreplay.errors import LogError
from mapreplay.floorplan import FloorPlan
from mapreplay.predictors import Predictor, kept_predictor
from mapreplay.recorders.log.facts import header_differences
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.recorders.log.scalars import ScalarsWriter
from mapreplay.recorders.log.writer import EpisodeWriter
from mapreplay.source_digest import source_digest
from mapreplay.step import EpisodeHeader

LOGS: Final = "logs"
"""The folder of the logs, in that of the results."""


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

    @property
    def name(self) -> str:
        """What it is called in a line."""
        return f"{self.config.planner} on {self.floor_plan.id}, seed {self.config.seed}"

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

    def prepare(self) -> Episode:
        """The episode, ready to run."""
        return prepare_episode(self.config, self.floor_plan, predictor=self.predictor())


@dataclass(frozen=True)
class Shelf:
    """Where the logs of an experiment lie, and what is kept of an episode."""

    folder: Path
    """Of the results."""
    whole: bool = False
    """Whole logs, and not only scalars."""

    def path(self, dataset: str, header: EpisodeHeader) -> Path:
        """``logs/<dataset>/<planner>__<plan-on>-<build>__<predictor>[+fail-safe]/<log>``: a folder
        per arm, so that `mapreplay diff` pairs two of them.
        """
        c = header.config
        arm = f"{c.planner}__{c.plan_on}-{c.build}__{header.predictor.name}"
        arm += "+fail-safe" if c.fail_safe else ""
        return self.folder / LOGS / dataset / arm / header.file_name

    def has(self, job: Job) -> bool:
        """Whether the logs of a job are there, finished, and whole if they should be.

        Raises:
            LogError: one is of another episode, such as one with other weights, or damaged:
                nothing is mixed.
        """
        return all(
            self._has(self.path(job.dataset, header), header)
            for header in headers_of(job.prepare())
        )

    def _has(self, path: Path, header: EpisodeHeader) -> bool:
        if not path.exists():
            return False
        log = EpisodeLog(path)
        others = header_differences(log.header, header)
        if others:
            said = "; ".join(f"{fact.what} {fact.a}, here {fact.b}" for fact in others)
            raise LogError(f"{path}: a log of another episode ({said}); choose another --out")
        return log.finished and (log.has_steps or not self.whole)


def headers_of(episode: Episode) -> list[EpisodeHeader]:
    """Of the logs that an episode gives: one, or with fail-safe two: with it, and without."""
    header = episode.header
    return [header, without_fail_safe(header)] if header.config.fail_safe else [header]


@cache
def code_digest() -> str:
    """Of our code that logs depend on."""
    return source_digest("mapreplay.analysis.experiment.jobs")


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


def run_job(job: Job, shelf: Shelf) -> str:
    """Simulate, and write the logs of a job; returns its name.

    Raises:
        MapreplayError: the planner or predictor failed, or a log cannot be written.
    """
    episode = job.prepare()
    writer_of = EpisodeWriter if shelf.whole else ScalarsWriter
    with ExitStack() as stack:
        sinks: list[StepSink] = []
        for header in headers_of(episode):
            path = shelf.path(job.dataset, header)
            writer = stack.enter_context(writer_of(path, header, force=True))
            sinks.append(writer if header is episode.header else WithoutFailSafe(header, writer))
        record(episode, *sinks)
    return job.name
