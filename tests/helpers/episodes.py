"""Episodes made up of a curve, without a file: for tests of what is said about many."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mapreplay.analysis.episodes.corpus import LoggedEpisode
from mapreplay.analysis.episodes.summary import UNFINISHED, EpisodeRow
from mapreplay.config import EpisodeConfig
from mapreplay.floorplan import FloorPlan
from mapreplay.grid import Cell
from mapreplay.recorders.log.state import Condition, LogState
from mapreplay.step import EpisodeHeader, PredictorIdentity


def floor_plan(number: int) -> FloorPlan:
    """A corridor that is as long as its number says, so that no two are the same."""
    cells = np.full((3, number + 4), 100, np.int8)
    cells[1, 1:-1] = 0
    return FloorPlan(f"plan-{number}", cells, 0.1)


def made_up(
    number: int,
    mapping_time: int | None,
    *,
    steps: int | None = None,
    f1: float = 0.9,
    max_steps: int = 400,
    plan: FloorPlan | None = None,
    version: str = "1",
    outcome: str | None = None,
    **config: object,
) -> LoggedEpisode:
    """An episode on plan `number`: its coverage rises evenly to the target, or stays below it."""
    values = {"planner": "nearest", "plan_on": "observed", "build": "observed"} | config
    values["max_steps"] = max_steps
    settings = EpisodeConfig.of(values)
    last = mapping_time if mapping_time is not None else steps if steps is not None else max_steps
    top = settings.coverage if mapping_time is not None else settings.coverage / 2
    curve = np.linspace(top if last == 0 else 0.0, top, last + 1)
    plan = plan or floor_plan(number)
    ending = "mapped" if mapping_time is not None else "sealed_in" if steps else "out_of_steps"
    path = Path(f"{plan.id}__{settings.planner}__s{settings.seed}.mcap")
    header = EpisodeHeader(
        config=settings,
        floor_plan=plan,
        start=Cell(1, 1),
        max_steps=max_steps,
        predictor=PredictorIdentity(settings.predictor, ""),
        versions=(("mapreplay", version),),
    )
    row = EpisodeRow(
        file=str(path), floor_plan=plan.id, planner=settings.planner,
        predictor=settings.predictor, plan_on=settings.plan_on, build=settings.build,
        fail_safe=settings.fail_safe, seed=settings.seed, start_row=1, start_col=1,
        max_steps=max_steps, outcome=outcome or ending, steps=last, mapping_time=mapping_time,
        correct_time=mapping_time, path_length=0.1 * last, coverage=float(curve[-1]),
        correct=float(curve[-1]), f1=f1, fail_safe_steps=0,
    )  # fmt: skip
    return LoggedEpisode(
        path=path,
        header=header,
        row=row,
        coverage=curve,
        correct=curve,
        f1=np.full(last + 1, f1),
        metres=0.1 * np.arange(last + 1),
        observed=curve,
        fail_safe=np.zeros(last + 1, np.bool_),
        state=LogState(_CONDITIONS.get(row.outcome, Condition.FINISHED), last + 1),
        log=None,  # nothing of it is read
    )


_CONDITIONS = {UNFINISHED: Condition.CUT_OFF}
