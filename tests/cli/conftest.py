"""Running the command line inside of the test's process."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from commands import Result, Run
from mapreplay.cli import main


@pytest.fixture
def cli(capfdbinary: pytest.CaptureFixture[bytes], monkeypatch: pytest.MonkeyPatch) -> Run:
    """``cli("ls", folder)`` -> exit code, stdout, stderr."""

    def run(*arguments: object) -> Result:
        monkeypatch.setattr(sys, "argv", ["mapreplay", *map(str, arguments)])
        capfdbinary.readouterr()
        with pytest.raises(SystemExit) as ended:
            main()
        out, err = capfdbinary.readouterr()
        assert isinstance(ended.value.code, int)
        return Result(ended.value.code, out.decode(), err.decode())

    return run


@pytest.fixture(scope="session")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a few short episodes without a predictor."""
    folder = tmp_path_factory.mktemp("logs")
    subprocess.run(
        [sys.executable, "-m", "mapreplay", "run", "--planner", "nearest", "--plan-on", "observed",
         "--build", "observed", "--floorplans", "procedural:7-9", "--max-steps", "30",
         "--out", str(folder)],
        check=True,
        capture_output=True,
    )  # fmt: skip
    return folder
