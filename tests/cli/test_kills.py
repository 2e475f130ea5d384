"""Recordings that are killed with SIGKILL at random moments."""

import json
import random
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import pytest

from commands import Run
from mapreplay.episode import run_episode
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.recorders.log.writer import STEPS_A_CHUNK
from mapreplay.step import Step, differences
from recordings import three_rooms

LONG = {"predictor": "blur", "max_steps": 400, "coverage": 1.0}

RECORD = f"""
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from recordings import three_rooms
from mapreplay.episode import run_episode
from mapreplay.recorders.log.writer import EpisodeWriter

episode = three_rooms(**{LONG})
with EpisodeWriter(Path(sys.argv[2]), episode.header) as writer:
    for step in run_episode(episode):
        writer.add(step)
        print(step.index, flush=True)
"""


@dataclass(frozen=True)
class Killed:
    """What a killed recording left behind."""

    part: Path
    reported: int
    """Steps that it had said to be written."""


@pytest.fixture(scope="module")
def undisturbed() -> list[Step]:
    return list(run_episode(three_rooms(**LONG)))


def start(path: Path) -> subprocess.Popen[str]:
    tests = str(Path(__file__).parents[1] / "helpers")
    command = [sys.executable, "-c", RECORD, tests, str(path)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True)


def kill_at(process: subprocess.Popen[str], step: int, path: Path, draw: random.Random) -> Killed:
    """Kill `process` some microseconds after it said that `step` is written."""
    assert process.stdout is not None
    lines = [process.stdout.readline() for _ in range(step + 1)]
    time.sleep(draw.uniform(0, 0.002))
    process.kill()
    lines += process.stdout.readlines()
    process.stdout.close()
    assert process.wait() == -signal.SIGKILL or path.exists()
    return Killed(path.with_name(path.name + ".part"), len([x for x in lines if x.endswith("\n")]))


def check(killed: Killed, undisturbed: list[Step], cli: Run) -> None:
    log = EpisodeLog(killed.part)
    steps = list(log)
    assert not log.finished
    assert killed.reported - len(steps) <= STEPS_A_CHUNK
    for read, written in zip(steps, undisturbed, strict=False):
        assert set(differences(read, written)) <= {"profile"}
    (row,) = json.loads(cli("ls", killed.part, "--format", "json").out)["rows"]
    assert row["outcome"] == "unfinished"
    assert row["steps"] == max(len(steps) - 1, 0)


def kill_some(count: int, seed: int, folder: Path, undisturbed: list[Step], cli: Run) -> None:
    draw = random.Random(seed)

    def record(number: int) -> Killed:
        for attempt in range(10):
            path = folder / f"{number}-{attempt}.mcap"
            killed = kill_at(start(path), draw.randrange(len(undisturbed) - 50), path, draw)
            if not path.exists():
                return killed
        raise AssertionError("on this machine a recording always ends before it is killed")

    with ThreadPoolExecutor(count) as threads:  # most of the time is the start of a process
        for killed in threads.map(record, range(count)):
            check(killed, undisturbed, cli)


def test_five_killed_recordings_lose_at_most_20_steps(
    cli: Run, tmp_path: Path, undisturbed: list[Step]
) -> None:
    assert len(undisturbed) > 150
    kill_some(5, 1, tmp_path, undisturbed, cli)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2, 14))
def test_sixty_killed_recordings_lose_at_most_20_steps(
    cli: Run, tmp_path: Path, undisturbed: list[Step], seed: int
) -> None:
    kill_some(5, seed, tmp_path, undisturbed, cli)


def test_what_a_kill_left_is_recovered_and_the_loss_is_told(
    cli: Run, tmp_path: Path, undisturbed: list[Step]
) -> None:
    path = tmp_path / "a.mcap"
    killed = kill_at(start(path), 57, path, random.Random(1))
    saved = len(EpisodeLog(killed.part))
    result = cli("recover", killed.part, "--format", "json")
    assert result.code == 3
    (row,) = json.loads(result.out)["rows"]
    assert row == {
        "file": str(killed.part),
        "recovered": str(path),
        "steps": saved,
        "missing": f"all after step {saved - 1}",
    }
    log = EpisodeLog(path)
    assert len(log) == log.table().height == saved
    for read, written in zip(log, undisturbed, strict=False):
        assert set(differences(read, written)) <= {"profile"}
    listed = json.loads(cli("ls", path, "--format", "json").out)["rows"]
    assert [row["outcome"] for row in listed] == ["unfinished"]
