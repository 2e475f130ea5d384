"""`mapreplay verify`: exit codes, what is named, and where it is said."""

import itertools
import json
from dataclasses import replace
from pathlib import Path

import pytest

from commands import Run
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.recorders.log.writer import EpisodeWriter


@pytest.fixture
def lie(logs: Path, tmp_path: Path) -> Path:
    """A log with one frontier cell too few at step 4, and a false hit at step 7."""
    log = EpisodeLog(sorted(logs.iterdir())[0])
    path = tmp_path / "lie.mcap"
    with EpisodeWriter(path, log.header) as writer:
        for step in log:
            hits = step.hits.copy()
            hits[2] = 1 if hits[2] != 1 else 2
            changed = {4: replace(step, frontier=step.frontier[1:]), 7: replace(step, hits=hits)}
            writer.add(changed.get(step.index, step))
    return path


@pytest.fixture
def part(logs: Path, tmp_path: Path) -> Path:
    """The first ten steps of a log."""
    log = EpisodeLog(sorted(logs.iterdir())[0])
    with EpisodeWriter(tmp_path / "part.mcap", log.header) as writer:
        for step in itertools.islice(log, 10):
            writer.add(step)
    return writer.part


@pytest.mark.parametrize("options", [(), ("--rerun",), ("--rerun-from", "12")])
def test_true_logs_agree(cli: Run, logs: Path, options: tuple[str, ...]) -> None:
    result = cli("verify", logs, *options, "--format", "json")
    assert result.code == 0, result.err
    answer = json.loads(result.out)
    assert answer["schema"] == "mapreplay.verify/1"
    steps = 1 if "12" in options else 31
    assert [(row["steps"], row["differences"]) for row in answer["rows"]] == [(steps, 0)] * 3
    assert result.err == f"3 logs, {3 * steps} steps: all agree, bit for bit\n"


def test_what_differs_is_named_with_both_values(cli: Run, logs: Path, lie: Path) -> None:
    result = cli("verify", lie, sorted(logs.iterdir())[1])
    assert result.code == 1
    first, second, verdict = result.err.splitlines()
    assert first.startswith(f"{lie}: step 4: /frontier cell (")
    assert first.endswith("): logged nothing, expected frontier")
    assert second.startswith(f"{lie}: step 7: /scan ray 2: logged ")
    assert verdict == "2 logs, 62 steps: 1 differ"
    assert [line.split() for line in result.out.splitlines()[2:]] == [
        ["procedural-8__nearest__observed-observed__s1.mcap", "31", "0"],
        ["lie.mcap", "31", "2"],
    ]


def test_differences_are_rows_for_programs(cli: Run, lie: Path) -> None:
    rows = json.loads(cli("verify", lie, "--format", "json").out)["rows"]
    assert [(row["step"], row["topic"], row["what"]) for row in rows] == [
        (4, "/frontier", "cell"), (7, "/scan", "ray 2"),
    ]  # fmt: skip
    assert rows[0]["row"] >= 0
    assert rows[1]["row"] is None
    assert (rows[0]["logged"], rows[0]["expected"], rows[0]["more"]) == ("nothing", "frontier", 0)
    csv = cli("verify", lie, "--rerun", "--format", "csv")
    assert csv.code == 1
    assert csv.out.count("\n") == 3


def test_more_than_ten_are_counted(cli: Run, logs: Path, tmp_path: Path) -> None:
    log = EpisodeLog(sorted(logs.iterdir())[0])
    with EpisodeWriter(tmp_path / "a.mcap", log.header) as writer:
        for step in log:
            writer.add(replace(step, metrics=replace(step.metrics, f1=0.987)))
    result = cli("verify", tmp_path)
    assert result.code == 1
    assert result.err.count("/metrics f1: logged 0.987") == 10
    assert f"{tmp_path / 'a.mcap'}: 31 differences; the first 10 shown" in result.err


def test_an_unfinished_log_agrees_as_far_as_it_goes(cli: Run, part: Path) -> None:
    result = cli("verify", part)
    assert result.code == 3
    assert result.err.splitlines() == [
        f"{part}: unfinished; 10 steps can be read",
        "1 log, 10 steps: all agree, bit for bit",
    ]


def test_an_unreadable_log_is_named_and_the_rest_verified(
    cli: Run, logs: Path, tmp_path: Path
) -> None:
    bad = tmp_path / "bad.mcap"
    bad.write_bytes(b"no log")
    result = cli("verify", bad, logs)
    assert result.code == 3
    assert f"not verified: {bad}: not an MCAP file" in result.err
    assert "3 logs, 93 steps: all agree" in result.err
    alone = cli("verify", bad)
    assert (alone.code, alone.err) == (1, f"mapreplay: {bad}: not an MCAP file\n")


def test_a_difference_weighs_more_than_a_loss(cli: Run, lie: Path, part: Path) -> None:
    assert lie.parent == part.parent
    assert cli("verify", lie.parent).code == 1


def test_where_chooses(cli: Run, logs: Path) -> None:
    result = cli("verify", logs, "--where", "floor_plan=procedural-9")
    assert result.code == 0
    assert "1 log, 31 steps" in result.err
    nothing = cli("verify", logs, "--where", "steps>30", "--format", "csv")
    assert nothing.code == 0
    assert nothing.out.count("\n") == 1


@pytest.mark.parametrize(
    ("options", "line"),
    [
        (["--rerun", "--rerun-from", "3"], "choose one of --rerun and --rerun-from"),
        (["--rerun-from", "31"], "has steps 0 to 30"),
        (["--where", "colour=red"], "no column 'colour'"),
    ],
)
def test_wrong_usage_is_one_line(cli: Run, logs: Path, options: list[str], line: str) -> None:
    result = cli("verify", logs, *options)
    assert (result.code, result.out) == (2, "")
    assert result.err.count("\n") == 1
    assert line in result.err


def test_a_predictor_that_is_not_here_is_named(cli: Run, logs: Path, tmp_path: Path) -> None:
    log = EpisodeLog(sorted(logs.iterdir())[0])
    config = log.header.config.model_copy(update={"predictor": "theirs"})
    path = tmp_path / "a.mcap"
    with EpisodeWriter(path, replace(log.header, config=config)) as writer:
        for step in log:
            writer.add(step)
    assert cli("verify", path).code == 0
    result = cli("verify", path, logs, "--rerun")
    assert result.code == 3
    told = "the log's predictor is theirs (without a hash), not registered here; give its weights"
    assert f"not verified: {path}: {told} with --predictor FILE" in result.err
