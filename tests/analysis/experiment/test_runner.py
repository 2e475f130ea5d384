"""The runner: logs are durable, nothing is run twice, nothing is mixed."""

import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from drawing import plan
from experiments import DeadlyJob
from mapreplay.analysis.experiment.jobs import Job, Shelf, headers_of
from mapreplay.analysis.experiment.runner import run_jobs
from mapreplay.config import EpisodeConfig
from mapreplay.errors import LogError, MapreplayError
from mapreplay.recorders.log.scalars import ScalarsWriter

HOUSE = """
    ############
    #....#.....#
    #..........#
    #....#.....#
    ############
"""


def jobs(count: int = 3) -> list[Job]:
    config = EpisodeConfig(planner="nearest", predictor="mean-wall", fail_safe=True, reach=2)
    return [Job("D1", plan(HOUSE, f"p{n}"), config, 0.14) for n in range(count)]


def run(these: list[Job], folder: Path, processes: int = 1) -> dict[str, bytes]:
    """Run jobs; all that is in the folder then."""
    assert len(list(run_jobs(these, Shelf(folder), processes))) == len(these)
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


def left(these: list[Job], folder: Path) -> list[str]:
    return [job.floor_plan.id for job in these if not Shelf(folder).has(job)]


def test_logs_are_on_disk_when_they_are_told(tmp_path: Path) -> None:
    for number, _ in enumerate(run_jobs(jobs(), Shelf(tmp_path), 1), start=1):
        assert len(list(tmp_path.rglob("*.mcap"))) == 2 * number
        assert left(jobs(), tmp_path) == ["p0", "p1", "p2"][number:]


def test_two_processes_write_what_one_writes(tmp_path: Path) -> None:
    assert run(jobs(), tmp_path / "one") == run(jobs(), tmp_path / "two", processes=2)


@pytest.mark.parametrize("kept", range(7))
def test_a_kill_anywhere_costs_the_job_that_it_was_at(tmp_path: Path, kept: int) -> None:
    whole = run(jobs(), tmp_path)
    paths = [
        Shelf(tmp_path).path("D1", header) for job in jobs() for header in headers_of(job.prepare())
    ]
    for path in paths[kept:]:
        path.rename(f"{path}.part")
        Path(f"{path}.part").write_bytes(path.name.encode())  # whatever is left of it
    assert left(jobs(), tmp_path) == ["p0", "p1", "p2"][kept // 2 :]
    assert run([job for job in jobs() if not Shelf(tmp_path).has(job)], tmp_path) == whole


def test_logs_of_another_episode_are_not_mixed_with_ours(tmp_path: Path) -> None:
    (job,) = jobs(1)
    run([job], tmp_path)
    other = job.config.model_copy(update={"coverage": 0.5})
    with pytest.raises(LogError, match=r"p0__.*: a log of another episode \(coverage 0.98, here"):
        Shelf(tmp_path).has(Job("D1", job.floor_plan, other, 0.14))
    assert not Shelf(tmp_path).has(Job("D2", job.floor_plan, other, 0.14))


def test_a_dead_process_is_told_and_what_was_finished_is_kept(tmp_path: Path) -> None:
    (template,) = jobs(1)
    deadly = [DeadlyJob("D1", plan(HOUSE, f"deadly{n}"), template.config, 0.14) for n in range(2)]
    told = r"deadly., seed 1: a worker process died at it \(exit code 9\).* other episodes are kept"
    with pytest.raises(MapreplayError, match=told):
        run(deadly, tmp_path, processes=2)
    run(jobs(1), tmp_path)  # and it goes on
    assert left(jobs(1), tmp_path) == []


def test_two_runs_that_write_one_log_are_refused(tmp_path: Path) -> None:
    header = jobs(1)[0].prepare().header
    told = r"p0__.*: another process is writing it"
    with (
        ScalarsWriter(Shelf(tmp_path).path("D1", header), header),
        pytest.raises(LogError, match=told),
    ):
        run(jobs(), tmp_path)
    run(jobs(), tmp_path)
    assert left(jobs(), tmp_path) == []


SLOW_PARENT = """
import sys
sys.path.insert(0, sys.argv[1])
from pathlib import Path
from drawing import plan
from experiments import SleepyJob
from mapreplay.analysis.experiment.jobs import Shelf
from mapreplay.analysis.experiment.runner import run_jobs
from mapreplay.config import EpisodeConfig
if __name__ == "__main__":
    jobs = [
        SleepyJob("D1", plan("###\\n#.#\\n###", f"p{n}"), EpisodeConfig(), 0.1) for n in range(2)
    ]
    list(run_jobs(jobs, Shelf(Path(sys.argv[2])), 2))
"""


def test_workers_end_when_their_parent_is_killed(tmp_path: Path) -> None:
    helpers = str(Path(__file__).parents[2] / "helpers")
    script = tmp_path / "parent.py"
    script.write_text(SLOW_PARENT)
    parent = subprocess.Popen([sys.executable, script, helpers, tmp_path])
    this = psutil.Process(parent.pid)
    deadline = time.monotonic() + 120
    while len(workers := [p for p in this.children() if "spawn_main" in str(p.cmdline())]) < 2:
        assert time.monotonic() < deadline
        assert parent.poll() is None
        time.sleep(0.1)
    parent.kill()
    parent.wait()
    _, alive = psutil.wait_procs(workers, timeout=120)
    assert not alive
