"""A training from floor plans and logs to weights and their card."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

from mapreplay.errors import FloorPlanError, LogError, UsageError
from mapreplay.floorplans import FloorPlanSource, by_sha256, open_source, read_ids, select
from mapreplay.floorplans.plausibility import warning_lines
from mapreplay.predictors.weights import ModelCard
from mapreplay.training.dataset import TrainingPlan, load_plans
from mapreplay.training.loop import CurvePoint, Trainer, TrainingConfig, finish

PLANS_PER_CHUNK: Final = 250
"""Minimum number of plans that one process loads, because it reads an archive from its start."""


@dataclass(frozen=True)
class TrainingJob:
    """What is trained on what, and where the weights go."""

    config: TrainingConfig
    out: Path
    """The weights; the checkpoint and the card are written next to them."""
    floorplans: str | None
    """Source of the floor plans to train on; None to train on logs only."""
    logs: Sequence[Path]
    """Logs to train on, each of one episode."""
    ids: Path | None
    """File with the IDs of the floor plans to train on; None for all."""
    validate: str | None
    """Source of the validation plans; None to hold out some of `floorplans`."""
    hold_out: int
    validation_plans: int
    """Maximum number of validation plans."""
    resolution: float | None
    """Metres per cell, for sources that are rasterized."""
    init: Path | None
    """Weights to start from."""
    trained_on: str
    """What the card says about the training data."""
    command: Sequence[str]
    """The command that the card says reproduces the weights."""
    device: str = "cpu"
    jobs: int = 1
    resume: bool = False
    force: bool = False

    @property
    def checkpoint(self) -> Path:
        """Where the training can be resumed."""
        return self.out.with_suffix(".checkpoint")


@dataclass(frozen=True)
class Environment:
    """What a training needs from the layers above: processes, logs and output."""

    map_unordered: Callable[..., Iterator[Any]]
    """`mapreplay.analysis.pool.map_unordered`."""
    read_log: Callable[[tuple[int, Path]], tuple[str, TrainingPlan] | LogError]
    """Reads log number `int`: floor-plan ID and observed maps. A function of a module."""
    note: Callable[[str], None]
    """Prints a line for the user."""
    progress: Callable[[str, int], AbstractContextManager[Callable[[int], None]]]
    """Shows a task (name, total); the function takes the completed amount."""


def run_training(job: TrainingJob, environment: Environment) -> ModelCard:
    """Load the data, train to the end, and write weights and card.

    Raises:
        UsageError: there are no validation plans.
        FloorPlanError, LogError: there is no data to train on, or it cannot be read.
        TrainingError, WeightsError, WriteError: see `Trainer` and `finish`.
    """
    plans, held_out = _load_data(job, environment)
    trainer = Trainer(plans, held_out, job.config, job.device, job.checkpoint, job.jobs)
    if job.init is not None:
        trainer.start_from(job.init)
    if job.resume and job.checkpoint.exists():
        trainer.resume()
        environment.note(f"resumed after {trainer.samples} samples")
    elif job.resume:
        environment.note(f"{job.checkpoint}: no checkpoint; the training starts from its beginning")
    with (
        closing(trainer.run()) as reports,
        environment.progress("training", job.config.samples) as completed,
    ):
        for report in reports:
            if isinstance(report, CurvePoint):
                environment.note(
                    f"{report.samples:>9} samples  train {report.train_loss:.4f}  "
                    f"validation {report.validation_loss:.4f}  F1 {report.validation_f1:.4f}"
                )
            else:
                completed(report)
    return finish(
        trainer,
        job.out,
        trained_on=job.trained_on,
        validated_on=job.validate or f"{len(held_out)} of {job.hold_out} held-out plans",
        command=shlex.join(job.command),
        force=job.force,
    )


def _load_data(
    job: TrainingJob, environment: Environment
) -> tuple[list[TrainingPlan], list[TrainingPlan]]:
    """The plans to train on, and the plans to validate on; no plan is in both."""
    source, wanted = None, list[str]()
    if job.floorplans is not None:
        source = open_source(job.floorplans, job.resolution)
        wanted = list(select(source, read_ids(job.ids) if job.ids else None, None).ids)
    held_out: list[TrainingPlan] = []
    if job.validate is not None:
        other = open_source(job.validate, job.resolution)
        held_ids = list(other.ids())[: job.validation_plans]
        held_out = load("validation", other, held_ids, job.jobs, environment)
    elif source is not None:
        held_ids = by_sha256(wanted)[: job.hold_out]
        chosen = sorted(held_ids[: job.validation_plans])
        held_out = load("validation", source, chosen, job.jobs, environment)
    if not held_out:
        raise UsageError("nothing to validate on; use --validate or --hold-out")
    apart = frozenset(held_ids)
    plans: list[TrainingPlan] = []
    if source is not None:
        ids = [floor_plan_id for floor_plan_id in wanted if floor_plan_id not in apart]
        plans = load("training", source, ids, job.jobs, environment)
    if job.logs:
        train, validate = _load_logs(job, apart, environment)
        plans += train
        held_out += validate
    return plans, held_out


def load(
    what: str,
    source: FloorPlanSource,
    ids: Sequence[str],
    jobs: int,
    environment: Environment,
) -> list[TrainingPlan]:
    """The plans that can be read, in the order of `ids`; the others are reported.

    Raises:
        FloorPlanError: none can be read.
    """
    numbers = {floor_plan_id: number for number, floor_plan_id in enumerate(ids)}
    there = [floor_plan_id for floor_plan_id in source.ids() if floor_plan_id in numbers]
    size = max(PLANS_PER_CHUNK, -(-len(there) // jobs)) if jobs > 1 else PLANS_PER_CHUNK
    chunks = [{i: numbers[i] for i in there[k : k + size]} for k in range(0, len(there), size)]
    plans: list[TrainingPlan] = []
    refused: list[FloorPlanError] = []
    with environment.progress(f"{what} plans", len(there)) as completed:
        for results in environment.map_unordered(
            partial(_load_chunk, source),
            chunks,
            jobs,
            name=lambda chunk: f"{what} plans from {next(iter(chunk))} on",
        ):
            plans += [result for result in results if isinstance(result, TrainingPlan)]
            refused += [result for result in results if isinstance(result, FloorPlanError)]
            completed(len(plans) + len(refused))
    plans.sort(key=lambda plan: plan.number)
    for line in warning_lines([plan.where for plan in plans], [plan.doubts for plan in plans]):
        environment.note(line)
    if refused:
        environment.note(f"{len(refused)} {what} plans were refused, such as: {refused[0]}")
    if not plans and ids:
        raise FloorPlanError(f"no {what} plan is left ({refused[0]})")
    return plans


def _load_chunk(
    source: FloorPlanSource, numbers: Mapping[str, int]
) -> list[TrainingPlan | FloorPlanError]:
    return list(load_plans(numbers, source))


def _load_logs(
    job: TrainingJob, apart: frozenset[str], environment: Environment
) -> tuple[list[TrainingPlan], list[TrainingPlan]]:
    """Observed maps of logs: to train on, and (on the floor plans `apart`) to validate on."""
    train: list[TrainingPlan] = []
    validate: list[TrainingPlan] = []
    results = environment.map_unordered(
        environment.read_log,
        list(enumerate(job.logs)),
        job.jobs,
        lost=lambda _, error: LogError(str(error)),
        name=lambda numbered: str(numbered[1]),
    )
    with environment.progress("logs", len(job.logs)) as completed:
        for number, result in enumerate(results, start=1):
            if isinstance(result, LogError):
                environment.note(f"left out: {result}")
            else:
                floor_plan_id, plan = result
                (validate if floor_plan_id in apart else train).append(plan)
            completed(number)
    if validate:
        environment.note(f"logs of held-out floor plans, used for validation: {len(validate)}")
    if not train:
        raise LogError("no log is left to train on")
    train.sort(key=lambda plan: plan.number)
    validate.sort(key=lambda plan: plan.number)
    return train, validate
