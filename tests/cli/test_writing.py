"""Every file that a verb writes is there whole or not at all, and never behind a link."""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import sys
from pathlib import Path

import polars as pl
import pytest

from commands import Run

SAMPLES = Path(__file__).parents[2] / "samples"
LOG = next((SAMPLES / "sealed").glob("*50053*.mcap"))
COMMANDS = {
    "ls": (f"ls {LOG} -o", "a.csv"),
    "info": (f"info {LOG} -o", "a.json"),
    "metrics csv": (f"metrics {LOG} -o", "a.csv"),
    "metrics parquet": (f"metrics {LOG} -o", "a.parquet"),
    "metrics json": (f"metrics {LOG} -o", "a.json"),
    "metrics text": (f"metrics {LOG} -o", "a.txt"),
    "compare": (f"compare {LOG} -o", "a.csv"),
    "compare html": (f"compare {LOG} --html", "a.html"),
    "compare plot": (f"compare {LOG} --plot", "a.svg"),
    "diagnose json": (f"diagnose {LOG} --no-save -o", "a.json"),
    "diagnose html": (f"diagnose {LOG} --no-save --html", "a.html"),
    "diff": (f"diff {LOG} {LOG} -o", "a.json"),
    "whatif": (f"whatif {LOG} -o", "a.csv"),
    "whatif plot": (f"whatif {LOG} --plot", "a.png"),
    "verify": (f"verify {LOG} -o", "a.csv"),
    "bundle": (f"bundle {LOG} -o", "a.zip"),
    "branch": (f"branch {LOG} --at -1 --with truth -o", "a.mcap"),
    "export npz": (f"export {LOG} --npz", "a.npz"),
    "view png": (f"view {LOG} --size 640x360 --png", "a.png"),
    "view gif": (f"view {LOG} --size 640x360 --gif", "a.gif"),
    "view mp4": (f"view {LOG} --size 640x360 --mp4", "a.mp4"),
    "view save": (f"view {LOG} --save", "a.rrd"),
    "floorplans": ("floorplans procedural:7 -o", "a.csv"),
    "floorplans preview": ("floorplans procedural:7 --preview", "a.png"),
}
every_command = pytest.mark.parametrize(("command", "name"), COMMANDS.values(), ids=COMMANDS.keys())


@every_command
def test_a_full_disk_leaves_what_was_there(
    cli: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str, name: str
) -> None:
    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    (tmp_path / name).write_bytes(b"old")
    monkeypatch.setattr(os, "fsync", full)
    result = cli(*command.split(), tmp_path / name, "--force")
    assert result.code == 1, result.err
    assert result.err.endswith("cannot be written (No space left on device)\n")
    assert name in result.err
    left = {path.name for path in tmp_path.iterdir()} - {f"{name}.part"}  # of `branch`
    assert left == {name}
    assert (tmp_path / name).read_bytes() == b"old"


@every_command
def test_what_is_there_stays_without_force_and_a_link_with_it(
    cli: Run, tmp_path: Path, command: str, name: str
) -> None:
    (tmp_path / "target").write_bytes(b"old")
    (tmp_path / name).symlink_to("target")
    result = cli(*command.split(), tmp_path / name, "--force")
    assert result.code == 2
    assert result.err.endswith("is a link; give its target instead\n")
    assert (tmp_path / "target").read_bytes() == b"old"
    (tmp_path / name).unlink()
    (tmp_path / name).write_bytes(b"old")
    result = cli(*command.split(), tmp_path / name)
    assert result.code == 2
    assert result.err.endswith("exists; choose another name, or overwrite it with --force\n")
    assert (tmp_path / name).read_bytes() == b"old"


def test_maps_in_a_folder_are_all_refused_or_none(cli: Run, tmp_path: Path) -> None:
    (tmp_path / "target").write_bytes(b"old")
    (tmp_path / "step-000007-fused.png").symlink_to("target")
    result = cli("export", LOG, "--png", tmp_path, "--force")
    assert result.code == 2
    assert "step-000007-fused.png: is a link" in result.err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["step-000007-fused.png", "target"]
    assert cli("export", LOG, "--png", tmp_path / "a", "--step", 3, "--step", 3).code == 0


@pytest.mark.parametrize("ending", ["", ".part"])
def test_a_log_is_not_recorded_through_a_link(cli: Run, tmp_path: Path, ending: str) -> None:
    name = "procedural-7__nearest__observed-observed__s1.mcap"
    (tmp_path / "target").write_bytes(b"old")
    (tmp_path / f"{name}{ending}").symlink_to("target")
    result = cli(
        "run", "--planner", "nearest", "--plan-on", "observed", "--build", "observed",
        "--floorplans", "procedural:7", "--max-steps", 2, "--out", tmp_path, "--force",
    )  # fmt: skip
    assert result.code == 1
    assert f"{name}{ending}: is a link; give its target instead" in result.err
    assert (tmp_path / "target").read_bytes() == b"old"


def test_recovering_and_diagnosing_write_through_no_link(cli: Run, tmp_path: Path) -> None:
    part = tmp_path / "a.mcap.part"
    shutil.copyfile(LOG, part)
    (tmp_path / "target").write_bytes(b"old")
    (tmp_path / "a.mcap").symlink_to("target")
    (tmp_path / "a.diagnosis.json").symlink_to("target")
    assert "a.mcap: is a link" in cli("recover", part, "--force").err
    assert "a.diagnosis.json: is a link" in cli("diagnose", part).err
    assert (tmp_path / "target").read_bytes() == b"old"


def test_one_name_for_two_results_is_refused(cli: Run, tmp_path: Path) -> None:
    path = tmp_path / "a.html"
    result = cli("diagnose", LOG, "--html", path, "-o", path, "--format", "json")
    assert result.code == 2
    assert "given twice as an output" in result.err


@pytest.mark.parametrize("option", ["-o", "--out", "--output"])
def test_one_option_says_where_to(cli: Run, tmp_path: Path, option: str) -> None:
    assert cli("ls", LOG, option, tmp_path / "a.csv").code == 0
    assert (tmp_path / "a.csv").exists()
    folder = tmp_path / "runs"
    run = ("run", "--planner", "nearest", "--floorplans", "procedural:7", "--max-steps", 2)
    assert cli(*run, "--predictor", "none", option, folder).code == 0
    assert list(folder.glob("*.mcap"))


@pytest.mark.parametrize("name", ["x" * 300, "a\0b", "file", "file/below"])
def test_a_folder_that_cannot_be_is_one_line(
    cli: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("MAPREPLAY_DEBUG")
    (tmp_path / "file").write_bytes(b"")
    (tmp_path / "c.toml").write_text(
        f'floorplans = "procedural:7"\npredictor = "none"\nmax-steps = 2\nout = "{name}"\n'.replace(
            "\0", "\\u0000"
        )
    )
    result = cli("run", "--config", "c.toml")
    assert result.code in {1, 2}
    assert result.err.count("\n") == 1
    assert "internal error" not in result.err


def test_a_film_that_does_not_fit_is_no_film(tmp_path: Path) -> None:
    """OpenCV's writer says nothing of it."""
    done = subprocess.run(
        [sys.executable, "-m", "mapreplay", "view", LOG, "--size", "640x360", "--mp4", "a.mp4"],
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (9000, 9000)), cwd=tmp_path,
        capture_output=True, text=True, check=False, timeout=60,
    )  # fmt: skip
    assert done.returncode == 1
    said = "mapreplay: a.mp4: cannot be written (no more than a part of it; a full disk?)\n"
    assert done.stderr == said
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def odd(tmp_path: Path) -> Path:
    """A folder of logs, the name of one of which is not UTF-8."""
    folder = tmp_path / "logs"
    folder.mkdir()
    try:
        shutil.copyfile(LOG, folder / "bad\udcff.mcap")
    except OSError:
        pytest.skip("such names are refused here")
    shutil.copyfile(LOG, folder / "good.mcap")
    return folder


@pytest.mark.parametrize("form", ["json", "csv", "parquet"])
@pytest.mark.parametrize(
    "verb", ["ls", "metrics --per episode", "metrics", "diagnose --no-save", "verify"]
)
def test_names_that_are_not_utf_8_are_escaped(
    cli: Run, tmp_path: Path, odd: Path, verb: str, form: str
) -> None:
    path = tmp_path / f"a.{form}"
    assert cli(*verb.split(), odd, "-o", path).code == 0
    if form != "parquet":
        assert path.read_bytes().decode()
    elif verb != "verify":  # which lists what differs
        assert set(pl.read_parquet(path)["file"]) == {
            str(odd / r"bad\udcff.mcap"),
            str(odd / "good.mcap"),
        }


@pytest.mark.parametrize("verb", ["info", "recover", "bundle", "whatif", "verify", "view --png P"])
def test_a_log_of_such_a_name_is_read_as_any_other(cli: Run, odd: Path, verb: str) -> None:
    words = verb.replace("P", str(odd / "p\udcfe.png")).split()
    result = cli(words[0], odd / "bad\udcff.mcap", *words[1:])
    assert result.code == 0, result.err
    assert "\udcff" not in result.out + result.err
