"""What `mapreplay train` trains and validates on: floor plans, and logs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final

from mapreplay.analysis.pool import map_unordered
from mapreplay.cli.output import note
from mapreplay.cli.progress import progress_bar
from mapreplay.errors import FloorPlanError, LogError
from mapreplay.floorplans import FloorPlanSource
from mapreplay.floorplans.plausibility import warning_lines
from mapreplay.recorders.log.blame import blaming
from mapreplay.recorders.log.find import find_logs
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.recorders.sampled import observed_maps
from mapreplay.training.dataset import MAPS_PER_LOG, TrainingPlan, load_plans, prepare_plan

PLANS_PER_CHUNK: Final = 250
"""At most so many are loaded by one process, which reads an archive from its start for them."""


@dataclass(frozen=True)
class LoggedPlans:
    """What the agents of logs had observed."""

    to_train_on: list[TrainingPlan]
    to_validate_on: list[TrainingPlan]
    """Of floor plans that are held out."""


def load(what: str, source: FloorPlanSource, ids: Sequence[str], jobs: int) -> list[TrainingPlan]:
    """The plans that can be read, in the order of `ids`; the others are counted on stderr.

    Raises:
        FloorPlanError: none can be read.
    """
    numbers = {floor_plan_id: number for number, floor_plan_id in enumerate(ids)}
    there = [floor_plan_id for floor_plan_id in source.ids() if floor_plan_id in numbers]
    size = max(PLANS_PER_CHUNK, -(-len(there) // jobs)) if jobs > 1 else PLANS_PER_CHUNK
    chunks = [{i: numbers[i] for i in there[k : k + size]} for k in range(0, len(there), size)]
    plans: list[TrainingPlan] = []
    refused: list[FloorPlanError] = []
    with progress_bar() as bar:
        task = bar.add_task(f"{what} plans", total=len(there))
        for results in map_unordered(
            partial(_load, source),
            chunks,
            jobs,
            name=lambda chunk: f"{what} plans from {next(iter(chunk))} on",
        ):
            plans += [result for result in results if isinstance(result, TrainingPlan)]
            refused += [result for result in results if isinstance(result, FloorPlanError)]
            bar.advance(task, len(results))
    plans.sort(key=lambda plan: plan.number)
    for line in warning_lines([plan.where for plan in plans], [plan.doubts for plan in plans]):
        note(line)
    if refused:
        note(f"{len(refused)} {what} plans were refused, such as: {refused[0]}")
    if not plans and ids:
        raise FloorPlanError(f"no {what} plan is left ({refused[0]})")
    return plans


def load_logs(paths: Sequence[Path], apart: frozenset[str], jobs: int) -> LoggedPlans:
    """What the agents of logs had observed; logs of the floor plans `apart` are to validate on.

    Raises:
        LogError: there are none to train on, or none can be read.
    """
    found = find_logs(list(paths))
    train: list[TrainingPlan] = []
    validate: list[TrainingPlan] = []
    with progress_bar() as bar:
        results = map_unordered(
            _logged,
            list(enumerate(found)),
            jobs,
            lost=lambda _, error: LogError(str(error)),
            name=lambda numbered: str(numbered[1]),
        )
        for result in bar.track(results, len(found), description="logs"):
            if isinstance(result, LogError):
                note(f"left out: {result}")
            else:
                floor_plan_id, plan = result
                (validate if floor_plan_id in apart else train).append(plan)
    if validate:
        note(f"logs to validate on, because their floor plans are held out: {len(validate)}")
    if not train:
        raise LogError("no log is left to train on")
    train.sort(key=lambda plan: plan.number)
    validate.sort(key=lambda plan: plan.number)
    return LoggedPlans(train, validate)


def _load(
    source: FloorPlanSource, numbers: Mapping[str, int]
) -> list[TrainingPlan | FloorPlanError]:
    return list(load_plans(numbers, source))


def _logged(numbered: tuple[int, Path]) -> tuple[str, TrainingPlan] | LogError:
    number, path = numbered
    try:
        with blaming(path):
            log = EpisodeLog(path)
            plan, start = log.header.floor_plan, log.header.start
            return plan.id, prepare_plan(number, plan, start, observed_maps(log, MAPS_PER_LOG))
    except LogError as error:
        return error
