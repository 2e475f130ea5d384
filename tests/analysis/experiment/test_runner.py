"""The runner: rows are durable, nothing is run twice, nothing is mixed."""

import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import psutil
import pytest

from drawing import plan
from experiments import DeadlyJob
from mapreplay.analysis.experiment.jobs import Job
from mapreplay.analysis.experiment.rows import Row, RowFile
from mapreplay.analysis.experiment.runner import jobs_left, run_jobs
from mapreplay.config import EpisodeConfig
from mapreplay.errors import MapreplayError

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


def timeless(rows: list[Row]) -> list[Row]:
    return sorted(
        (replace(row, seconds=0) for row in rows), key=lambda r: (r.floor_plan, r.fail_safe)
    )


def run(these: list[Job], file: RowFile, processes: int = 1) -> list[Row]:
    return [row for rows in run_jobs(these, file, processes) for row in rows]


def test_rows_are_on_disk_when_they_are_told(tmp_path: Path) -> None:
    file = RowFile(tmp_path / "rows.jsonl")
    for number, rows in enumerate(run_jobs(jobs(), file, 1), start=1):
        assert file.read()[-2:] == rows
        assert len(file.read()) == 2 * number
    assert jobs_left(jobs(), file) == []


def test_two_processes_say_what_one_says(tmp_path: Path) -> None:
    one = run(jobs(), RowFile(tmp_path / "one.jsonl"))
    two = run(jobs(), RowFile(tmp_path / "two.jsonl"), processes=2)
    assert timeless(one) == timeless(two)
    assert timeless(two) == timeless(RowFile(tmp_path / "two.jsonl").read())


@pytest.mark.parametrize("kept", range(7))
@pytest.mark.parametrize("torn", [0, 5])
def test_a_kill_anywhere_costs_the_job_that_it_was_at(tmp_path: Path, kept: int, torn: int) -> None:
    path = tmp_path / "rows.jsonl"
    file = RowFile(path)
    whole = run(jobs(), file)
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join(lines[:kept]) + b"".join(lines[kept:])[:torn])
    left = jobs_left(jobs(), file)
    assert [job.floor_plan.id for job in left] == ["p0", "p1", "p2"][kept // 2 :]
    run(left, file)
    assert timeless(file.read()) == timeless(whole)


def test_rows_of_other_weights_are_not_mixed_with_ours(tmp_path: Path) -> None:
    file = RowFile(tmp_path / "rows.jsonl")
    first, *_ = run(jobs(1), file)
    file.append(replace(first, sha256="c0ffee", seed=2))
    with pytest.raises(MapreplayError, match=r"rows.jsonl: holds nearest on p0 .* c0ffee"):
        jobs_left(jobs(), file)


def test_rows_of_other_datasets_are_left_alone(tmp_path: Path) -> None:
    file = RowFile(tmp_path / "rows.jsonl")
    first, *_ = run(jobs(1), file)
    file.append(replace(first, dataset="D2"))
    assert len(jobs_left(jobs(), file)) == 2


def test_a_dead_process_is_told_and_what_was_finished_is_kept(tmp_path: Path) -> None:
    (template,) = jobs(1)
    deadly = [DeadlyJob("D1", plan(HOUSE, f"deadly{n}"), template.config, 0.14) for n in range(2)]
    file = RowFile(tmp_path / "rows.jsonl")
    told = r"deadly., seed 1: a worker process died at it \(exit code 9\).* other episodes are kept"
    with pytest.raises(MapreplayError, match=told):
        run(deadly, file, processes=2)
    assert len(run(jobs_left(jobs(1), file), file)) == 2  # and it goes on


def test_two_runs_on_one_file_are_refused(tmp_path: Path) -> None:
    file = RowFile(tmp_path / "rows.jsonl")
    first = run_jobs(jobs(), file, 1)
    next(first)
    with pytest.raises(MapreplayError, match=r"rows.jsonl: another process is writing it"):
        run(jobs(), file)
    first.close()
    run(jobs_left(jobs(), file), file)
    assert len(file.read()) == 6


SLOW_PARENT = """
import sys
sys.path.insert(0, sys.argv[1])
from pathlib import Path
from drawing import plan
from experiments import SleepyJob
from mapreplay.analysis.experiment.rows import RowFile
from mapreplay.analysis.experiment.runner import run_jobs
from mapreplay.config import EpisodeConfig
if __name__ == "__main__":
    jobs = [
        SleepyJob("D1", plan("###\\n#.#\\n###", f"p{n}"), EpisodeConfig(), 0.1) for n in range(2)
    ]
    list(run_jobs(jobs, RowFile(Path(sys.argv[2])), 2))
"""


def test_workers_end_when_their_parent_is_killed(tmp_path: Path) -> None:
    helpers = str(Path(__file__).parents[2] / "helpers")
    script = tmp_path / "parent.py"
    script.write_text(SLOW_PARENT)
    parent = subprocess.Popen([sys.executable, script, helpers, tmp_path / "rows.jsonl"])
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
