"""`mapreplay run --resume`: what is finished is skipped, what is not is recorded again."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import psutil
import pytest

from commands import Run
from mapreplay.episode import versions
from mapreplay.floorplans import procedural
from mapreplay.predictors import NoPredictor
from mapreplay.step import PredictorIdentity

COMMAND = ("run", "--planner", "nearest", "--predictor", "none", "--plan-on", "observed",
           "--build", "observed", "--floorplans", "procedural:7-9", "--max-steps", 12)  # fmt: skip


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """What three episodes leave, by file name."""
    folder = tmp_path_factory.mktemp("undisturbed")
    command = [sys.executable, "-m", "mapreplay", *map(str, COMMAND), "--out", str(folder)]
    subprocess.run(command, check=True, capture_output=True)
    return content(folder)


def content(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_a_run_is_finished_and_what_was_finished_is_not_touched(
    cli: Run, tmp_path: Path, undisturbed: dict[str, bytes]
) -> None:
    first, second, third = sorted(undisturbed)
    (tmp_path / first).write_bytes(undisturbed[first])
    (tmp_path / (second + ".part")).write_bytes(undisturbed[second][:9000])
    (tmp_path / (third + ".part")).write_bytes(b"not even a log")
    before = (tmp_path / first).stat()
    result = cli(*COMMAND, "--out", tmp_path, "--resume")
    assert result.code == 0, result.err
    assert "1 of 3 episodes are already finished" in result.err
    assert result.out.count("procedural-") == 3
    assert content(tmp_path) == undisturbed
    assert (tmp_path / first).stat().st_mtime_ns == before.st_mtime_ns
    assert cli(*COMMAND, "--out", tmp_path, "--resume", "--jobs", 2).code == 0
    assert content(tmp_path) == undisturbed


def test_it_starts_where_there_is_nothing(
    cli: Run, tmp_path: Path, undisturbed: dict[str, bytes]
) -> None:
    assert cli(*COMMAND, "--out", tmp_path / "new", "--resume").code == 0
    assert content(tmp_path / "new") == undisturbed


@pytest.mark.parametrize(
    ("option", "reason"),
    [
        (("--coverage", 0.5), "a log of another episode (coverage 0.98, here 0.5);"),
        (
            ("--max-steps", 13),
            "a log of another episode (budget 12 steps, here 13 steps);",
        ),
        (("--start", "3,3"), "a log of another episode (start row "),
    ],
)
def test_logs_of_another_run_are_refused_before_anything_is_recorded(
    cli: Run, tmp_path: Path, undisturbed: dict[str, bytes],
    option: tuple[str, object], reason: str,
) -> None:  # fmt: skip
    last = sorted(undisturbed)[-1]
    (tmp_path / last).write_bytes(undisturbed[last])
    result = cli(*COMMAND, *option, "--out", tmp_path, "--resume")
    assert result.code == 1
    assert reason in result.err
    assert "--force" in result.err
    assert content(tmp_path) == {last: undisturbed[last]}
    assert cli(*COMMAND, *option, "--out", tmp_path, "--resume", "--force").code == 0
    assert set(content(tmp_path)) == set(undisturbed)
    assert (tmp_path / last).read_bytes() != undisturbed[last]


@pytest.mark.parametrize(("size", "reason"), [(9000, "cut off"), (5, "not an MCAP file")])
def test_a_log_that_is_cut_or_damaged_is_refused(
    cli: Run, tmp_path: Path, undisturbed: dict[str, bytes], size: int, reason: str
) -> None:
    first = sorted(undisturbed)[0]
    (tmp_path / first).write_bytes(undisturbed[first][:size])
    result = cli(*COMMAND, "--out", tmp_path, "--resume")
    assert result.code == 1
    assert f"{first}: {reason}" in result.err
    assert cli(*COMMAND, "--out", tmp_path, "--resume", "--force").code == 0
    assert content(tmp_path) == undisturbed


def test_it_needs_the_folder(cli: Run) -> None:
    result = cli(*COMMAND, "--resume")
    assert result.code == 2
    assert "--resume: give the folder of the stopped run with --out" in result.err


def test_after_a_worker_was_killed_the_run_says_how_to_go_on_and_can(
    cli: Run, tmp_path: Path
) -> None:
    command = [*COMMAND[:-3], "procedural:0-5", "--max-steps", "300", "--out", tmp_path]
    process = subprocess.Popen(
        [sys.executable, "-m", "mapreplay", *map(str, command), "--jobs", "2"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    deadline = time.monotonic() + 60
    while not list(tmp_path.glob("*.part")) and time.monotonic() < deadline:
        time.sleep(0.02)
    worker = next(
        child
        for child in psutil.Process(process.pid).children()
        if "resource_tracker" not in " ".join(child.cmdline())
    )
    os.kill(worker.pid, signal.SIGKILL)
    _, err = process.communicate(timeout=120)
    assert process.returncode == 1
    assert "its worker process died (killed by SIGKILL)" in err
    assert (
        f"1 of 6 episodes failed; to resume, repeat the command with --resume --out {tmp_path}"
        in err
    )
    assert len(list(tmp_path.glob("*.mcap"))) == 5
    result = cli(*command, "--resume")
    assert result.code == 0, result.err
    assert "5 of 6 episodes are already finished" in result.err
    assert len(content(tmp_path)) == len(list(tmp_path.glob("*.mcap"))) == 6


def test_logs_of_other_plans_weights_or_versions_are_refused(
    cli: Run, tmp_path: Path, undisturbed: dict[str, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Under the same name and with the same options."""
    first = sorted(undisturbed)[0]
    (tmp_path / first).write_bytes(undisturbed[first])

    def refused() -> str:
        result = cli(*COMMAND, "--out", tmp_path, "--resume")
        assert (result.code, result.err.count("\n")) == (1, 1)
        assert content(tmp_path) == {first: undisturbed[first]}
        return result.err

    real = procedural.generate
    with monkeypatch.context() as patch:
        patch.setattr(
            procedural,
            "generate",
            lambda n, *rest: replace(real(n + 1, *rest), id=f"procedural-{n}"),
        )
        assert f"{first}: a log of another episode (" in (said := refused())
        assert "floor plan sha256 " in said
    with monkeypatch.context() as patch:
        later = tuple((name, "9.9" if name == "mapreplay" else v) for name, v in versions())
        patch.setattr("mapreplay.episode.versions", lambda: later)
        assert f"(version mapreplay {dict(versions())['mapreplay']}, here 9.9);" in refused()
    with monkeypatch.context() as patch:
        patch.setattr(NoPredictor, "identity", PredictorIdentity("none", 64 * "1"))
        assert "(weights -, here 111111111111);" in refused()
