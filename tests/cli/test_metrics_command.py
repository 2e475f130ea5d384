"""`mapreplay metrics`: per step and per episode, in every format, from the cache and without."""

import csv
import io
import json
from pathlib import Path

import polars as pl
import pytest

from commands import Run


def test_one_row_an_episode(cli: Run, logs: Path) -> None:
    result = cli("metrics", logs, "--per", "episode", "--format", "json")
    assert result.code == 0, result.err
    said = json.loads(result.out)
    assert said["schema"] == "mapreplay.metrics.episodes/1"
    assert [row["floor_plan"] for row in said["rows"]] == [f"procedural-{k}" for k in (7, 8, 9)]
    for row in said["rows"]:
        assert row["outcome"] == "out_of_steps"
        assert 0 < row["area"] < row["coverage"] < 0.5
        assert row["steps_to_50"] is None
        assert row["ece_pooled"] is None  # nothing was predicted


def test_the_table_of_episodes_fits_a_terminal(cli: Run, logs: Path) -> None:
    lines = cli("metrics", logs, "--per", "episode").out.splitlines()
    assert any("out_of_steps" in line for line in lines)  # the longest that there is
    assert max(map(len, lines)) <= 80


def test_all_formats_say_the_same(cli: Run, logs: Path, tmp_path: Path) -> None:
    from_json = json.loads(cli("metrics", logs, "--format", "json").out)["rows"]
    from_csv = list(csv.DictReader(io.StringIO(cli("metrics", logs, "--format", "csv").out)))
    path = tmp_path / "all.parquet"
    assert cli("metrics", logs, "-o", path).code == 0
    from_parquet = pl.read_parquet(path).to_dicts()
    assert from_parquet == from_json
    assert len(from_csv) == len(from_json) == 93
    for a, b in zip(from_csv, from_json, strict=True):
        assert list(a) == list(b)
        assert a["file"] == b["file"]
        assert float(a["f1"] or "nan") == pytest.approx(b["f1"] or float("nan"), nan_ok=True)


def test_tables_fit_the_terminal(cli: Run, logs: Path) -> None:
    one = sorted(logs.iterdir())[0]
    for arguments in ([one], [logs, "--per", "episode"]):
        out = cli("metrics", *arguments).out
        assert max(map(len, out.splitlines())) <= 80


def test_what_was_measured_before_is_not_measured_again(cli: Run, logs: Path) -> None:
    first = cli("metrics", logs, "--per", "episode", "--format", "csv")
    again = cli("metrics", logs, "--per", "episode", "--format", "csv")
    assert again.out == first.out
    assert "3 of 3 episodes were unchanged and taken from the cache" in again.err
    fresh = cli("metrics", logs, "--per", "episode", "--format", "csv", "--no-cache")
    assert fresh.out == first.out
    assert "before" not in fresh.err


def test_a_cache_that_cannot_be_written_is_done_without(
    cli: Run, logs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    result = cli("metrics", logs, "--per", "episode")
    assert result.code == 0
    assert "cannot be written" in result.err


def test_what_cannot_be_read_is_named_and_the_rest_is_measured(
    cli: Run, logs: Path, tmp_path: Path
) -> None:
    good = sorted(logs.iterdir())[0]
    (tmp_path / "text.mcap").write_text("hello")
    result = cli("metrics", tmp_path / "text.mcap", good, "--format", "csv")
    assert result.code == 3
    assert result.out.count("\n") == 32
    assert "unreadable" in result.err
    assert "text.mcap: not an MCAP file" in result.err
    alone = cli("metrics", tmp_path)
    assert alone.code == 1
    assert alone.err.strip().endswith("text.mcap: not an MCAP file")


def test_a_pattern_without_logs_is_one_line(cli: Run, tmp_path: Path) -> None:
    result = cli("metrics", tmp_path / "*.mcap")
    assert result.code == 1
    assert result.err.strip() == f"mapreplay: {tmp_path}/*.mcap: matches nothing"


def test_conditions_choose_episodes(cli: Run, logs: Path) -> None:
    result = cli("metrics", logs, "--where", "floor_plan=procedural-8", "--per", "episode",
                 "--format", "csv")  # fmt: skip
    assert result.out.count("\n") == 2
    none = cli("metrics", logs, "--where", "outcome=sealed_in")
    assert none.code == 0
    assert "none of 3 episodes matches --where" in none.err
