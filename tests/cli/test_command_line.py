"""Every verb, its exit codes, and that each error is one line."""

import csv
import io
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from commands import Run


@pytest.mark.parametrize(
    ("words", "loaded", "shown"),
    [
        ([], set(), "run view ls info metrics verify recover export train bench"),
        (["run"], {"pydantic"}, "--planner --seed --start --out"),
    ],
    ids=["mapreplay", "run"],
)
def test_help_loads_nothing_slow(words: list[str], loaded: set[str], shown: str) -> None:
    code = (
        f"import sys; sys.argv = ['mapreplay', *{words}, '--help']\n"
        "from mapreplay.cli import main\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        "slow = {'torch', 'rerun', 'polars', 'numba', 'numpy', 'pydantic'} & set(sys.modules)\n"
        f"assert slow == {loaded}, slow\n"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stderr
    for word in shown.split():
        assert re.search(rf"\n  (-o, )?{word} ", result.stdout)


@pytest.mark.parametrize("words", [["ls", "nowhere"], ["run", "--planner", "nearby"]])
def test_a_mistyped_name_is_told_before_anything_slow_is_loaded(words: list[str]) -> None:
    code = (
        f"import sys; sys.argv = ['mapreplay', *{words}]\n"
        "from mapreplay.cli import main\n"
        "try: main()\n"
        "except SystemExit as end: assert end.code\n"
        "slow = {'torch', 'rerun', 'polars', 'numba', 'scipy'} & set(sys.modules)\n"
        "assert not slow, slow\n"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stderr
    assert words[-1] in result.stderr


def test_help_is_quick() -> None:
    command = [sys.executable, "-m", "mapreplay", "--help"]
    subprocess.run(command, check=True, capture_output=True)
    spent = []
    for _ in range(5):
        before = os.times()
        subprocess.run(command, check=True, capture_output=True)
        after = os.times()
        spent.append(
            after.children_user + after.children_system
            - before.children_user - before.children_system
        )  # fmt: skip
    assert min(spent) < 0.3  # CPU seconds, and the least of them: the machine may be busy


def test_the_version_is_printed(cli: Run) -> None:
    result = cli("--version")
    assert result.code == 0
    assert result.out.startswith("mapreplay 0.")


TRAIN = "train --floorplans procedural:0 --validate procedural:1 --out x.safetensors"


@pytest.mark.parametrize(
    ("arguments", "code", "line"),
    [
        ("fly", 2, "No such command 'fly'."),
        ("run --planner nearby", 2, "unknown planner 'nearby'; known: cost-utility, "),
        ("run --predictor d7", 2, "unknown predictor 'd7'; known: auto, d1, d2, d2-unet, none, or"),
        ("run --coverage 1.5", 2, "run: coverage = 1.5: should be less than or equal to 1"),
        ("run --plan-on truth", 2, "run: plan_on = 'truth': should be 'observed' or 'fused'"),
        ("run --start here", 2, "--start here: expected ROW,COL"),
        ("run --start 0,0", 1, "no floor plan is left to run on"),
        ("run --floorplans procedural:9-1", 2, "seeds go from 0 to"),
        ("run --floorplans nowhere.tar.gz", 1, "nowhere.tar.gz"),
        ("run --config nowhere.toml", 2, "nowhere.toml: cannot be read"),
        ("run --jobs 0", 2, "jobs = 0: should be greater than or equal to 1"),
        ("ls nowhere", 1, "nowhere"),
        ("info nowhere.mcap", 1, "nowhere.mcap"),
        ("view nowhere.mcap", 1, "nowhere.mcap"),
        ("export nowhere.mcap", 2, "say what to write"),
        ("train --floorplans procedural:0-1 --out x.pt", 2, "should end in .safetensors"),
        (f"{TRAIN} --loss-region some", 2, "some: choose all or explorable or nearby"),
        (f"{TRAIN} --architecture mlp", 2, "--architecture mlp: choose autoencoder or unet"),
        (f"{TRAIN} --from-logs nowhere", 1, "nowhere"),
        ("train --validate procedural:1 --out x.safetensors", 2, "use --floorplans SPEC or --from"),
        ("train --from-logs a --hold-out 1 --out x.safetensors", 2, "use --validate SPEC"),
        (f"{TRAIN} --init no.safetensors", 1, "no.safetensors: cannot be read"),
        ("metrics nowhere.mcap --region some", 2, "should be explorable or all"),
    ],
)
def test_an_error_is_one_line_and_an_exit_code(
    cli: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path,
    arguments: str, code: int, line: str,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    result = cli(*arguments.split())
    assert result.code == code
    assert result.out == ""
    last = result.err.strip().splitlines()[-1]
    assert last.startswith("mapreplay: ")
    assert line in last
    assert "Traceback" not in result.err


def test_info_fits_a_terminal_and_keeps_all_in_json(cli: Run) -> None:
    log = next((Path(__file__).parents[2] / "samples/episodes").glob("*60014*.mcap"))
    lines = cli("info", log).out.splitlines()
    assert max(map(len, lines)) <= 80
    assert any(line.split()[:2] == ["end", "outcome"] for line in lines)
    rows = json.loads(cli("info", log, "--format", "json").out)["rows"]
    hashes = [row["value"] for row in rows if row["what"] == "sha256"]
    assert [len(value) for value in hashes] == [64, 64]


def test_info_of_an_unfinished_log_has_no_end(cli: Run, tmp_path: Path) -> None:
    log = next((Path(__file__).parents[2] / "samples/episodes").glob("*60014*.mcap"))
    cut = tmp_path / "cut.mcap.part"
    cut.write_bytes(log.read_bytes()[: log.stat().st_size // 2])
    result = cli("info", cut)
    assert result.code == 3
    assert not [line for line in result.out.splitlines() if line.split()[:1] == ["end"]]


def test_run_writes_logs_and_says_where(cli: Run, tmp_path: Path) -> None:
    result = cli(
        "run", "--planner", "random", "--plan-on", "observed", "--build", "observed",
        "--floorplans", "procedural:7", "--episodes", 2, "--max-steps", 5, "--out", tmp_path / "o",
    )  # fmt: skip
    assert result.code == 0, result.err
    names = sorted(path.name for path in (tmp_path / "o").iterdir())
    assert names == [
        "procedural-7__random__observed-observed__s1.mcap",
        "procedural-7__random__observed-observed__s2.mcap",
    ]
    assert "procedural-7" in result.out
    assert f"logs: {tmp_path / 'o'}" in result.err


def test_run_never_overwrites_without_force(cli: Run, tmp_path: Path) -> None:
    arguments = ["run", "--planner", "nearest", "--predictor", "none", "--floorplans",
                 "procedural:7", "--max-steps", "3", "--out", str(tmp_path)]  # fmt: skip
    assert cli(*arguments).code == 0
    (log,) = tmp_path.iterdir()
    before = log.read_bytes()
    again = cli(*arguments)
    assert again.code == 2
    assert "1 of 1 logs exist" in again.err
    assert log.read_bytes() == before
    assert cli(*arguments, "--force").code == 0
    assert log.read_bytes() == before  # and the same run writes the same bytes


@pytest.mark.parametrize("predictor", ["none", "d1"])
def test_the_number_of_jobs_changes_nothing(cli: Run, tmp_path: Path, predictor: str) -> None:
    for jobs in (1, 2):
        result = cli(
            "run", "--planner", "random", "--predictor", predictor,
            "--floorplans", "procedural:7-9",
            "--max-steps", 12, "--jobs", jobs, "--out", tmp_path / str(jobs),
        )  # fmt: skip
        assert result.code == 0, result.err
    for log in (tmp_path / "1").iterdir():
        assert log.read_bytes() == (tmp_path / "2" / log.name).read_bytes()


def test_a_configuration_file_gives_defaults_that_options_override(
    cli: Run, tmp_path: Path
) -> None:
    config = tmp_path / "run.toml"
    config.write_text(
        'planner = "nearest"\npredictor = "none"\nmax_steps = 4\nfloorplans = "procedural:3"\n'
    )
    result = cli(
        "run", "--config", config, "--max-steps", 2, "--format", "json", "--out", tmp_path / "o"
    )
    (row,) = json.loads(result.out)["rows"]
    assert (row["planner"], row["steps"], row["outcome"]) == ("nearest", 2, "out_of_steps")
    config.write_text("steps = 3\n")
    result = cli("run", "--config", config)
    assert (result.code, result.err) == (2, f"mapreplay: {config}: unknown key 'steps'\n")


def test_ls_lists_and_filters_in_every_format(cli: Run, logs: Path, tmp_path: Path) -> None:
    listed = json.loads(cli("ls", logs, "--format", "json").out)
    assert listed["schema"] == "mapreplay.episodes/1"
    assert [row["floor_plan"] for row in listed["rows"]] == [
        "procedural-7", "procedural-8", "procedural-9",
    ]  # fmt: skip
    one = cli("ls", logs, "--where", "floor_plan=procedural-8", "--format", "csv").out
    assert [row["steps"] for row in csv.DictReader(io.StringIO(one))] == ["30"]
    assert cli("ls", logs, "--where", "steps>30", "--format", "csv").out.count("\n") == 1
    out = tmp_path / "x.parquet"
    assert cli("ls", f"{logs}/*.mcap", "--format", "parquet", "-o", out).code == 0
    assert pl.read_parquet(out).height == 3
    refused = cli("ls", logs, "--where", "colour=red")
    assert (refused.code, refused.err.count("\n")) == (2, 1)
    assert "no column 'colour'" in refused.err


def test_ls_fits_a_terminal_of_80_columns(
    cli: Run, logs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = cli("ls", logs)
    assert max(map(len, result.out.splitlines())) <= 80


def test_an_unreadable_log_is_named_and_the_rest_is_listed(
    cli: Run, logs: Path, tmp_path: Path
) -> None:
    good = next(logs.iterdir())
    (tmp_path / "good.mcap").write_bytes(good.read_bytes())
    (tmp_path / "bad.mcap").write_bytes(b"not a log at all")
    result = cli("ls", tmp_path, "--format", "csv")
    assert result.code == 3
    assert result.out.count("\n") == 2
    assert "bad.mcap" in result.err


def test_info_tells_everything_about_one_log(cli: Run, logs: Path) -> None:
    log = sorted(logs.iterdir())[0]
    rows = json.loads(cli("info", log, "--format", "json").out)["rows"]
    facts = {(row["of"], row["what"]): row["value"] for row in rows}
    assert facts["end", "outcome"] == "out_of_steps"
    assert facts["floor plan", "cells"] == "64 x 64"
    assert facts["config", "planner"] == "nearest"
    assert facts["event", "30 outcome"] == "out_of_steps after 30 steps"


def test_metrics_agree_with_the_recording_and_take_options(cli: Run, logs: Path) -> None:
    log = sorted(logs.iterdir())[0]
    result = cli("metrics", log, "--format", "csv")
    assert result.code == 0, result.err
    assert "31 steps agree with the recorded metrics, bit for bit" in result.err
    rows = list(csv.DictReader(io.StringIO(result.out)))
    assert [int(row["step"]) for row in rows] == list(range(31))
    strict = cli("metrics", log, "--format", "csv", "--unknown-as", "occupied", "--metric",
                 "false-walls").out  # fmt: skip
    last = list(csv.DictReader(io.StringIO(strict)))[-1]
    assert float(last["recall"]) == 1.0
    assert float(last["precision"]) < 1.0
    assert float(last["false-walls"]) == 0.0


def test_export_writes_arrays_and_pictures(cli: Run, logs: Path, tmp_path: Path) -> None:
    log = sorted(logs.iterdir())[0]
    npz, png = tmp_path / "a.npz", tmp_path / "maps"
    result = cli("export", log, "--npz", npz, "--png", png, "--step", 0, "--step", -1)
    assert result.code == 0, result.err
    with np.load(npz) as arrays:
        assert arrays["observed"].shape == (31, 64, 64)
    assert list(png.glob("*.png"))
    assert cli("export", log, "--npz", npz).code == 2  # it is there
    assert cli("export", log, "--png", tmp_path / "b", "--step", 99).code == 2


def test_watching_without_a_display_records_nothing(
    cli: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if sys.platform != "linux":
        pytest.skip("displays are looked for in the environment on Linux only")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    result = cli("run", "--view", "--floorplans", "procedural:1", "--out", tmp_path)
    assert result.code == 2
    assert result.err.count("\n") == 1
    assert "mapreplay view LOG --web" in result.err
    assert not list(tmp_path.iterdir())


def test_floorplans_describes_and_previews(cli: Run, tmp_path: Path) -> None:
    sheet = tmp_path / "sheet.png"
    result = cli("floorplans", "procedural:1-3", "--preview", sheet, "--format", "json")
    rows = json.loads(result.out)["rows"]
    assert [row["id"] for row in rows] == ["procedural-1", "procedural-2", "procedural-3"]
    assert {row["height"] for row in rows} == {64}
    assert sheet.read_bytes().startswith(b"\x89PNG")


def test_floorplans_tells_how_many_more_there_are(cli: Run) -> None:
    result = cli("floorplans", "procedural:0-99", "--limit", 2, "--format", "csv")
    assert result.out.count("\n") == 3
    assert "2 of 100 plans" in result.err


def test_bench_sim_prints_a_rate(cli: Run) -> None:
    result = cli("bench", "sim", "--floorplans", "procedural:1-2")
    assert result.code == 0
    assert " steps/s, median of 2 episodes" in result.out


def test_bench_predict_sets_our_network_beside_pytorch(cli: Run) -> None:
    small = ("bench", "predict", "--size", 16, "--maps", 3, "--rounds", 1)
    table = cli(*small)
    assert table.code == 0, table.err
    assert max(map(len, table.out.splitlines())) <= 80
    rows = json.loads(cli(*small, "--format", "json").out)["rows"]
    assert [row["how"].split(",")[0] for row in rows] == ["PyTorch"] * 3 + ["mapreplay"]
    assert rows[0]["speed_up"] == 1
    assert rows[0]["largest_difference"] == 0
    assert 0 < rows[3]["largest_difference"] < 1e-4
    assert all(row["quanta"] <= 3 for row in rows)
    assert cli("bench", "predict", "--size", 12).err.startswith("mapreplay: --size 12: not a mult")


def test_train_makes_weights_that_run_can_use(cli: Run, tmp_path: Path) -> None:
    out = tmp_path / "tiny.safetensors"
    arguments = ["train", "--floorplans", "procedural:0-7", "--validate", "procedural:50000-50001",
                 "--samples", "40", "--batch", "8", "--out", str(out)]  # fmt: skip
    result = cli(*arguments)
    assert result.code == 0, result.err
    card = json.loads(out.with_suffix(".json").read_text())
    assert card["samples"] == 40
    assert card["trained_on"] == "procedural:0-7"
    assert cli(*arguments).code == 2  # it is there
    again = cli(*arguments[:-1], tmp_path / "more.safetensors", "--init", out,
                "--loss-region", "explorable")  # fmt: skip
    assert again.code == 0, again.err
    more = json.loads((tmp_path / "more.json").read_text())
    assert more["init_sha256"] == card["sha256"]
    assert more["loss_region"] == "explorable"
    ran = cli("run", "--predictor", out, "--max-steps", 2, "--out", tmp_path / "o")
    assert ran.code == 0, ran.err


def test_train_from_logs_makes_weights_that_run_can_use(cli: Run, tmp_path: Path) -> None:
    logs, out = tmp_path / "logs", tmp_path / "second.safetensors"
    ran = cli("run", "--floorplans", "procedural:0-2", "--max-steps", 20, "--out", logs)
    assert ran.code == 0, ran.err
    result = cli("train", "--from-logs", logs, "--floorplans", "procedural:5-9", "--architecture",
                 "unet", "--loss-region", "nearby", "--validate", "procedural:2",
                 "--samples", "40", "--batch", "8", "--augment", "--jobs", "2",
                 "--out", out)  # fmt: skip
    assert result.code == 0, result.err
    assert "logs of held-out floor plans, used for validation: 1" in result.err
    card = json.loads(out.with_suffix(".json").read_text())
    assert card["trained_on"] == "procedural:5-9, logs logs"
    assert card["plans"] == 5 + 2
    assert card["architecture"].startswith("U-Net")
    again = cli("run", "--predictor", out, "--max-steps", 2, "--out", tmp_path / "o")
    assert again.code == 0, again.err


def test_ctrl_c_leaves_readable_logs_and_exit_code_130(cli: Run, tmp_path: Path) -> None:
    for jobs in ("1", "2"):
        folder = tmp_path / jobs
        process = subprocess.Popen(
            [sys.executable, "-m", "mapreplay", "run", "--planner", "nearest", "--plan-on",
             "observed", "--build", "observed", "--floorplans", "procedural:0-400", "--jobs", jobs,
             "--coverage", "1", "--out", str(folder)],
            stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True,
        )  # fmt: skip
        deadline = time.monotonic() + 60
        # Until twenty steps are on the disk: the first waits for the kernels to be loaded.
        while time.monotonic() < deadline and not any(
            part.stat().st_size > 10_000 for part in folder.glob("*.part")
        ):
            time.sleep(0.02)
        os.killpg(process.pid, signal.SIGINT)
        try:
            _, err = process.communicate(timeout=8)
        except subprocess.TimeoutExpired:
            # It can be lost where a library handles it itself, as Polars seems to: press again.
            os.killpg(process.pid, signal.SIGINT)
            _, err = process.communicate(timeout=30)
        assert process.returncode == 130, err
        assert err.strip().splitlines()[-1] == "mapreplay: interrupted"
        assert "Traceback" not in err, err
        listed = cli("ls", folder, "--format", "csv")
        assert listed.code in (0, 3), listed.err
        assert listed.out.count("\n") >= 1


def test_a_dead_worker_costs_its_episode_only(cli: Run, tmp_path: Path) -> None:
    psutil = pytest.importorskip("psutil")
    process = subprocess.Popen(
        [sys.executable, "-m", "mapreplay", "run", "--planner", "nearest", "--plan-on",
         "observed", "--build", "observed", "--floorplans", "procedural:0-7", "--jobs", "2",
         "--out", str(tmp_path)],
        stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    deadline = time.monotonic() + 60
    while not list(tmp_path.glob("*.part")) and time.monotonic() < deadline:
        time.sleep(0.02)
    workers = [
        child
        for child in psutil.Process(process.pid).children()
        if "resource_tracker" not in " ".join(child.cmdline())
    ]
    workers[0].kill()
    _, err = process.communicate(timeout=120)
    assert process.returncode == 1
    assert "its worker process died (killed by SIGKILL)" in err
    assert len(list(tmp_path.glob("*.mcap"))) == 7
