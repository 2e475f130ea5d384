"""The main job, end to end: record with and without a prediction, look, measure, compare."""

import json
from pathlib import Path

import pytest

from commands import Run
from mapreplay.analysis.episodes.corpus import pair, read_episode
from mapreplay.grid import FREE, UNKNOWN
from mapreplay.recorders.log.find import find_logs
from mapreplay.recorders.log.reader import EpisodeLog

SAMPLES = Path(__file__).parents[2] / "samples" / "floorplans"
OBSERVED = ["--planner", "nearest", "--plan-on", "observed", "--build", "observed"]
FUSED = ["--planner", "cost-utility", "--plan-on", "fused", "--build", "fused", "--fail-safe"]


def do_the_main_job(cli: Run, folder: Path, *source: object) -> None:
    """Everything that the README shows, on one floor plan, with what must be true after it."""
    for name, options in (("observed", OBSERVED), ("fused", FUSED)):
        ran = cli("run", *options, *source, "--out", folder / name)
        assert ran.code == 0, ran.err
    (observed,), (fused,) = find_logs([folder / "observed"]), find_logs([folder / "fused"])
    ((reference, candidate),) = pair([read_episode(observed)], [read_episode(fused)]).pairs
    assert reference.row.outcome == candidate.row.outcome == "mapped"
    assert candidate.row.coverage >= 0.98
    assert candidate.row.correct > 0.9
    assert candidate.row.f1 > 0.9

    log = EpisodeLog(fused)
    truth = log.header.floor_plan.cells
    for step in log.steps():
        seen = step.observed != UNKNOWN
        assert truth[step.agent] == FREE
        assert (step.fused[seen] == step.observed[seen]).all()
        # An unknown cell of a real robot's map is sensed as occupied.
        assert (step.observed[seen] == 0).tolist() == (truth[seen] == 0).tolist()

    assert cli("metrics", folder).code == 0
    listed = json.loads(cli("ls", folder, "--format", "json").out)["rows"]
    assert [row["steps"] for row in listed] == [candidate.row.steps, reference.row.steps]
    assert cli("info", fused).code == 0
    assert cli("view", fused, "--save", folder / "fused.rrd").code == 0
    assert cli("export", fused, "--npz", folder / "f.npz", "--png", folder / "maps").code == 0


def test_a_real_house(cli: Run, tmp_path: Path, houseexpo: Path) -> None:
    ids = tmp_path / "ids.txt"
    ids.write_text("# one house of the test list\n00052c0562bde7790f8354e6123ae7ff\n")
    archive = houseexpo / "json.tar.gz"
    do_the_main_job(cli, tmp_path, "--floorplans", archive, "--ids", ids)


@pytest.mark.parametrize("name", ["house.json", "office.yaml", "meander.png"])
def test_the_sample_floor_plans(cli: Run, tmp_path: Path, name: str) -> None:
    do_the_main_job(cli, tmp_path, "--floorplans", SAMPLES / name)


def test_an_episode_of_the_same_seed_is_the_same_file(cli: Run, tmp_path: Path) -> None:
    for name in ("a", "b"):
        ran = cli("run", "--floorplans", "procedural:60000", "--planner", "random",
                  "--max-steps", 25, "--seed", 3, "--out", tmp_path / name)  # fmt: skip
        assert ran.code == 0, ran.err
    (a,), (b,) = (tmp_path / "a").iterdir(), (tmp_path / "b").iterdir()
    assert a.name == b.name
    assert a.read_bytes() == b.read_bytes()
