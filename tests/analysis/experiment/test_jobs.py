"""Jobs: which episodes, in which order, and what is kept of one."""

from dataclasses import replace

import numpy as np

from drawing import draw, plan
from fakes import FixedPredictor
from mapreplay.analysis.experiment.config import ExperimentConfig
from mapreplay.analysis.experiment.controls import CONTROLS
from mapreplay.analysis.experiment.infill import InFill
from mapreplay.analysis.experiment.jobs import Job, identity, jobs_of, run_job
from mapreplay.config import EpisodeConfig
from mapreplay.episode import prepare_episode, run_episode
from mapreplay.floorplans.procedural import generate
from mapreplay.predictors import NoPredictor

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


def job(**changes: object) -> Job:
    config = EpisodeConfig.of(
        {"planner": "nearest", "predictor": "none", "reach": 1, "fail_safe": True} | changes
    )
    return Job("D1", plan(RING), config, 0.14)


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


def test_only_fused_fused_gives_two_rows() -> None:
    jobs = jobs_of(CONFIG, CONFIG.datasets[0], [generate(7)])
    for each in jobs:
        safe = [entry[5] for entry in each.identities()]
        assert safe == ([True, False] if each.config.build == "fused" else [False])


def test_predictors_are_made_of_the_floor_plan_or_the_share() -> None:
    oracle = job(predictor="infill-4").predictor()
    assert isinstance(oracle, InFill)
    assert oracle.radius == 4
    nothing: np.ndarray[tuple[int, int], np.dtype[np.int8]] = np.full((3, 3), -1, np.int8)
    for name, said in (("always-free", 0.0), ("mean-wall", 0.14)):
        assert name in CONTROLS
        p_wall = job(predictor=name).predictor().predict(nothing)
        assert p_wall is not None
        assert (p_wall == np.float32(said)).all()


def test_an_agent_that_was_sealed_in_has_a_row_that_ends_there() -> None:
    safe, without = run_job(job(), walls_two_cells_away())
    assert (safe.outcome, safe.fail_safe) == ("mapped", True)
    assert safe.fail_safe_steps > 0
    assert (without.outcome, without.fail_safe, without.steps) == ("sealed_in", False, 0)
    assert without.mapping_time is None
    assert safe.sealed_step == without.sealed_step == 0
    assert without.coverage < safe.coverage


def test_the_row_without_fail_safe_is_that_of_an_episode_run_without() -> None:
    for predictor in (walls_two_cells_away(), NoPredictor()):
        _, without = run_job(job(), predictor)
        (real,) = run_job(job(fail_safe=False), predictor)
        assert without.digest != real.digest  # it was had by another simulation
        assert replace(without, seconds=0, digest="") == replace(real, seconds=0, digest="")


def test_a_row_is_what_the_steps_say() -> None:
    each = job(plan_on="observed", build="observed", fail_safe=False)
    (row,) = run_job(each, NoPredictor())
    episode = prepare_episode(each.config, each.floor_plan, predictor=NoPredictor())
    steps = list(run_episode(episode))
    last = steps[-1]
    assert (row.steps, row.outcome) == (last.index, "mapped")
    assert (row.mapping_time, row.sealed_step, row.fail_safe_steps) == (last.index, None, 0)
    assert row.correct_time == next(
        s.index for s in steps if s.metrics.correct_coverage_observed >= 0.95
    )
    assert (row.path_length, row.f1) == (last.metrics.path_length, last.metrics.f1)
    assert row.budget == episode.header.max_steps
    assert identity(row) in each.identities()
