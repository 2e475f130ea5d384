"""Jobs: which episodes, in which order, and what is kept of one."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from drawing import draw, plan
from experiments import GivenJob
from fakes import FixedPredictor
from mapreplay.analysis.diff.folders import PairDiff, diff_pairs
from mapreplay.analysis.episodes.corpus import read_episode
from mapreplay.analysis.experiment.config import ExperimentConfig
from mapreplay.analysis.experiment.controls import CONTROLS
from mapreplay.analysis.experiment.infill import InFill
from mapreplay.analysis.experiment.jobs import Job, Shelf, headers_of, jobs_of, run_job
from mapreplay.analysis.metrics.calibration import distance_from_observed
from mapreplay.analysis.verification import verify, verify_rerun
from mapreplay.config import EpisodeConfig
from mapreplay.episode import record
from mapreplay.errors import LogError
from mapreplay.floorplans.procedural import generate
from mapreplay.grid import Grid
from mapreplay.predictors import NoPredictor, Predictor
from mapreplay.recorders.log.header import NO_STEPS
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.recorders.log.scalars import ScalarsWriter
from mapreplay.step import Outcome, PredictorIdentity

RING = """
    ###########
    #.........#
    #.#######.#
    #.#.....#.#
    #.#.###.#.#
    #...#.....#
    ###########
"""
CONFIG = ExperimentConfig.of(
    {
        "datasets": [
            {"name": "D1", "floorplans": "procedural:7-8", "predictor": "d1", "wall-share": 0.14}
        ],
        "planners": [{"planner": "nearest"}, {"planner": "random", "runs": 2}],
        "maps": [
            {"plan-on": "observed", "build": "observed"},
            {"plan-on": "fused", "build": "fused"},
        ],
        "controls": ["always-free"],
        "infill": [4],
        "seed": 5,
    },
    "here",
)


def job(predictor: Predictor | None = None, **changes: object) -> GivenJob:
    config = EpisodeConfig.of(
        {"planner": "nearest", "predictor": "none", "reach": 1, "fail_safe": True} | changes
    )
    return GivenJob("D1", plan(RING), config, 0.14).with_predictor(predictor or NoPredictor())


def logs(job: Job, folder: Path, *, whole: bool = False) -> list[EpisodeLog]:
    """Those that a job gives."""
    shelf = Shelf(folder, whole)
    run_job(job, shelf)
    assert shelf.has(job)
    return [EpisodeLog(shelf.path(job.dataset, h)) for h in headers_of(job.prepare())]


def walls_two_cells_away() -> FixedPredictor:
    """Sure of walls that are not there, two cells from the start: see `test_episode`."""
    p = np.full(draw(RING).shape, 0.5, np.float32)
    p[4:7, 3] = p[3, 0:3] = 1.0
    return FixedPredictor(p)


def test_every_episode_is_there_once_and_first_runs_come_first() -> None:
    plans = [generate(7), generate(8)]
    jobs = jobs_of(CONFIG, CONFIG.datasets[0], plans)
    told = [(j.config.planner, j.config.predictor, j.config.seed, j.floor_plan.id) for j in jobs]
    assert len(set(told)) == len(told)
    kinds = list(dict.fromkeys(entry[:3] for entry in told))
    assert kinds == [
        ("nearest", "none", 5), ("nearest", "d1", 5), ("nearest", "always-free", 5),
        ("nearest", "infill-4", 5), ("random", "none", 5), ("random", "d1", 5),
        ("random", "none", 6), ("random", "d1", 6),
    ]  # fmt: skip
    assert [entry[3] for entry in told] == ["procedural-7", "procedural-8"] * 8


class Late:
    """Sure of a wall around all that was observed, as soon as that are so many cells."""

    identity = PredictorIdentity("late", "")

    def __init__(self, cells: int) -> None:
        self._cells = cells

    def predict(self, observed: Grid) -> npt.NDArray[np.float32]:
        late = (observed >= 0).sum() >= self._cells
        return np.where(late & (distance_from_observed(observed) <= 1), 1.0, 0.5).astype(np.float32)


def test_only_fused_fused_gives_two_logs() -> None:
    jobs = jobs_of(CONFIG, CONFIG.datasets[0], [generate(7)])
    for each in jobs:
        safe = [header.config.fail_safe for header in headers_of(each.prepare())]
        assert safe == ([True, False] if each.config.build == "fused" else [False])


def test_predictors_are_made_of_the_floor_plan_or_the_share() -> None:
    def made(name: str) -> Predictor:
        return Job("D1", plan(RING), EpisodeConfig(predictor=name), 0.14).predictor()

    oracle = made("infill-4")
    assert isinstance(oracle, InFill)
    assert oracle.radius == 4
    nothing: np.ndarray[tuple[int, int], np.dtype[np.int8]] = np.full((3, 3), -1, np.int8)
    for name, said in (("always-free", 0.0), ("mean-wall", 0.14)):
        assert name in CONTROLS
        p_wall = made(name).predict(nothing)
        assert p_wall is not None
        assert (p_wall == np.float32(said)).all()


def test_an_agent_that_was_sealed_in_has_a_log_that_ends_there(tmp_path: Path) -> None:
    made = logs(job(walls_two_cells_away()), tmp_path)
    safe, without = (read_episode(log.path) for log in made)
    assert (safe.row.outcome, safe.row.fail_safe) == ("mapped", True)
    assert safe.row.fail_safe_steps > 0
    assert safe.fail_safe[0]
    assert (without.row.outcome, without.row.steps) == ("sealed_in", 0)
    assert not without.row.fail_safe
    assert without.row.mapping_time is None
    assert without.row.coverage < safe.row.coverage


@pytest.mark.parametrize("whole", [False, True])
def test_the_log_without_fail_safe_is_that_of_an_episode_run_without(
    tmp_path: Path, whole: bool
) -> None:
    ends = set()
    cases = [(cells, steps) for cells in (1, 12, 20) for steps in (1, 2, 3, 4, None)]
    for number, (cells, steps) in enumerate(cases):
        changes = {"max_steps": steps} if steps else {}
        here, there = tmp_path / f"{number}", tmp_path / f"{number}-alone"
        safe, without = logs(job(Late(cells), **changes), here, whole=whole)
        (alone,) = logs(job(Late(cells), fail_safe=False, **changes), there, whole=whole)
        assert without.path.read_bytes() == alone.path.read_bytes()
        ends.add((safe.outcome, without.outcome, (without.summary or NO_STEPS).steps > 0))
    out_of_steps = Outcome.OUT_OF_STEPS
    assert {(Outcome.MAPPED, Outcome.SEALED_IN, True), (out_of_steps, out_of_steps, True)} <= ends


def test_scalars_are_those_of_the_whole_log_and_are_all_that_there_is(tmp_path: Path) -> None:
    each = job(plan_on="observed", build="observed", fail_safe=False)
    (scalars,), (whole,) = logs(each, tmp_path / "s"), logs(each, tmp_path / "w", whole=True)
    assert scalars.table().equals(whole.table())
    assert (scalars.summary, scalars.header.config) == (whole.summary, whole.header.config)
    of_scalars, of_whole = read_episode(scalars.path), read_episode(whole.path)
    assert replace(of_scalars.row, file="") == replace(of_whole.row, file="")
    assert (str(scalars.state), scalars.state.whole) == ("scalars only", True)
    told = r"holds scalars only; .* --keep-logs"
    for use in (list, lambda log: log[0], verify, lambda log: list(log.maps("observed"))):
        with pytest.raises(LogError, match=told):
            use(scalars)
    assert verify(whole).agrees


def test_scalars_are_verified_by_running_the_episode_again(tmp_path: Path) -> None:
    each = job(plan_on="observed", build="observed", fail_safe=False)
    (log,) = logs(each, tmp_path)
    found = verify_rerun(log)
    assert (found.agrees, found.steps) == (True, len(log))
    other = replace(log.header, config=log.header.config.model_copy(update={"planner": "random"}))
    path = tmp_path / "claims.mcap"
    with ScalarsWriter(path, other) as writer:
        record(each.prepare(), writer)
    assert not verify_rerun(EpisodeLog(path)).agrees


def test_folders_of_scalars_are_diffed_by_them(tmp_path: Path) -> None:
    safe, without = logs(job(Late(12)), tmp_path)
    a, b = read_episode(safe.path), read_episode(without.path)
    (found,) = diff_pairs([(a, b)])
    (same,) = diff_pairs([(a, a)])
    assert isinstance(found, PairDiff)
    assert isinstance(same, PairDiff)
    assert (same.identical, same.step) == (True, None)
    # They agree until the one without is sealed in: it decides nothing there, and ends.
    assert (found.identical, found.step, found.layer) == (False, without.last, "scalars")
    assert (found.move_step, found.outcome_b) == (None, "sealed_in")


def test_scalars_do_not_count_where_whole_logs_are_wanted(tmp_path: Path) -> None:
    each = job(fail_safe=False)
    run_job(each, Shelf(tmp_path))
    assert Shelf(tmp_path).has(each)
    assert not Shelf(tmp_path, whole=True).has(each)
    run_job(each, Shelf(tmp_path, whole=True))
    assert Shelf(tmp_path).has(each)
    assert Shelf(tmp_path, whole=True).has(each)
