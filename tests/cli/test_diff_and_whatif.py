"""`mapreplay diff` and `mapreplay whatif`: what they print, exit codes, one line for bad input."""

import json
import shutil
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from commands import Run
from mapreplay import EpisodeWriter, ExternalEpisode, unknown_floor_plan
from mapreplay.floorplan import FloorPlan
from mapreplay.recorders.log import reader
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.recorders.pictures.replay import first_divergence

SAMPLES = Path(__file__).parents[2] / "samples" / "episodes"
OBSERVED = SAMPLES / "procedural-60002__nearest__observed-observed__s1.mcap"
FUSED = SAMPLES / "procedural-60002__cost-utility__fused-fused__s1.mcap"
SEALED = SAMPLES / "procedural-60014__cost-utility__fused-fused__s1.mcap"


def test_two_episodes_part_somewhere_and_it_led_to_something(cli: Run) -> None:
    result = cli("diff", OBSERVED, FUSED)
    assert result.code == 0, result.err
    assert "They part at step 0, in the prediction." in result.out
    assert "A: mapped after 520 steps. B: mapped after 104 steps." in result.out
    lines = [line for line in result.out.splitlines() if not line.endswith(".mcap")]
    command = next(line for line in lines if line.startswith("mapreplay view"))
    assert command.split()[2:4] == [str(OBSERVED), str(FUSED)]
    diverge = first_divergence(EpisodeLog(OBSERVED), EpisodeLog(FUSED))
    assert command.split()[4:] == ["--step", str(diverge)]  # the step that the view marks
    lines.remove(command)
    assert max(map(len, lines)) <= 80
    rows = json.loads(cli("diff", OBSERVED, FUSED, "--format", "json").out)
    assert rows["schema"] == "mapreplay.diff/1"
    spent = [row for row in rows["rows"] if row["of"] == "time" and "of all" not in row["what"]]
    assert sum(row["a"] for row in spent) == 520
    assert sum(row["b"] for row in spent) == 104


def test_each_file_is_opened_and_checked_once(
    cli: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    checked = []
    read_index = reader.read_index
    monkeypatch.setattr(
        reader, "read_index", lambda file: checked.append(Path(file.name).name) or read_index(file)
    )
    assert cli("diff", OBSERVED, FUSED).code == 0
    assert sorted(checked) == sorted([OBSERVED.name, FUSED.name])
    checked.clear()
    folders = [tmp_path / "a", tmp_path / "b"]
    for folder in folders:
        folder.mkdir()
        for log in (OBSERVED, SEALED):
            shutil.copy(log, folder)
    assert cli("diff", *folders).code == 0
    assert sorted(checked) == sorted(2 * [OBSERVED.name, SEALED.name])


def test_exit_codes_for_scripts(cli: Run, tmp_path: Path) -> None:
    copy = shutil.copy(FUSED, tmp_path / "copy.mcap")
    same = cli("diff", FUSED, copy, "--exit-code")
    assert same.code == 0
    assert "identical: 105 steps, bit for bit" in same.out
    assert cli("diff", OBSERVED, FUSED, "--exit-code").code == 1
    (tmp_path / "text.mcap").write_text("hello")
    failed = cli("diff", FUSED, tmp_path / "text.mcap", "--exit-code")
    assert failed.code == 4
    assert failed.err.strip().endswith("text.mcap: not an MCAP file")
    assert cli("diff", FUSED, tmp_path / "text.mcap").code == 1
    other = cli("diff", FUSED, SEALED, "--exit-code")
    assert other.code == 2
    assert "choose two episodes on one floor plan" in other.err


def test_folders_are_paired_and_ranked(cli: Run, tmp_path: Path, logs: Path) -> None:
    for name, chosen in (("a", logs.iterdir()), ("b", sorted(logs.iterdir())[:2])):
        (tmp_path / name).mkdir()
        for log in chosen:
            shutil.copy(log, tmp_path / name)
    shutil.copy(OBSERVED, tmp_path / "a")
    shutil.copy(FUSED, tmp_path / "b")
    shutil.copy(FUSED, tmp_path / "b" / "again.mcap")
    result = cli("diff", tmp_path / "a", tmp_path / "b")
    assert result.code == 0, result.err
    assert "2 pairs, 2 identical" in result.out
    assert "left out, twice the same floor plan, start and seed" in result.err
    assert "only in A: " in result.err
    (tmp_path / "b" / "again.mcap").unlink()
    path = tmp_path / "pairs.parquet"
    assert cli("diff", tmp_path / "a", tmp_path / "b", "-o", path, "--exit-code").code == 1
    frame = pl.read_parquet(path)
    assert frame["identical"].to_list() == [False, True, True]
    top = frame.row(0, named=True)
    assert (top["time_a"], top["time_b"], top["difference"]) == (520, 104, -416)
    assert (top["step"], top["layer"]) == (0, "prediction")
    assert top["move_step"] > 0


def test_nothing_in_common_is_one_line(cli: Run, logs: Path) -> None:
    result = cli("diff", logs, SAMPLES)
    assert result.code == 1
    assert result.err.strip().splitlines()[-1] == (
        "mapreplay: no two episodes have floor plan, start and seed in common"
    )


def test_whatif_says_what_would_have_kept_a_way_open(cli: Run, tmp_path: Path) -> None:
    plot = tmp_path / "heat.png"
    result = cli("whatif", SEALED, "--plot", plot)
    assert result.code == 0, result.err
    assert result.out.startswith("Open loop: ")
    assert "It is sealed in at step 10." in result.out
    assert f"mapreplay branch {SEALED} --at 10 --with delta-occupied=0.76" in result.out
    assert "8 of 20 values of delta_occupied, 8 of 20 values of delta_free; all" in result.out
    # The logged thresholds are 0.7; the nearest of the grid are always shown.
    assert " 0.706 " in result.out.partition("occupied/free")[2].splitlines()[0]
    lines = [line for line in result.out.splitlines() if not line.startswith("mapreplay")]
    assert max(map(len, lines)) <= 80
    assert plot.read_bytes().startswith(b"\x89PNG")
    again = cli("whatif", SEALED, "--plot", plot)
    assert again.code == 2
    assert "exists; choose another name, or overwrite it with --force" in again.err


def test_whatif_tabulates_the_grid(cli: Run) -> None:
    rows = json.loads(
        cli("whatif", SEALED, "--delta-free", ".5:.9:5", "--delta-occupied", ".7", "--format",
            "json", "--step", 3).out
    )["rows"]  # fmt: skip
    assert [row["delta_free"] for row in rows] == [0.5, 0.6, 0.7, 0.8, 0.9]
    assert {row["delta_occupied"] for row in rows} == {0.7}
    assert [row["sealed"] for row in rows] == [None, 10, 10, 10, None]


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["--delta-free", "high"], "--delta-free high: expected a threshold, or FIRST:LAST"),
        (["--delta-free", ".9:.5"], "--delta-free .9:.5: expected"),
        (["--delta-occupied", "0:.5"], "--delta-occupied 0:.5: expected"),
        (["--delta-occupied", ".1:.5:1000"], "COUNT at most 200"),
        (["--step", "11"], "has steps 0 to 10"),
        (["--plot", "heat.jpg"], "should end in .png or .svg"),
    ],
)
def test_bad_thresholds_are_one_line(cli: Run, arguments: list[str], line: str) -> None:
    result = cli("whatif", SEALED, *arguments)
    assert result.code == 2
    assert line in result.err
    assert result.err.count("\n") == 1


def test_whatif_needs_a_prediction(cli: Run) -> None:
    result = cli("whatif", OBSERVED)
    assert result.code == 1
    assert "no step has a prediction to threshold" in result.err


def test_without_a_truth_or_a_budget_there_is_no_mapping_time(cli: Run, tmp_path: Path) -> None:
    truth = np.zeros((4, 6), np.int8)
    known = FloorPlan("lab", truth, 0.1)
    for side, column in (("a", 2), ("b", 3)):
        (tmp_path / side).mkdir()
        for seed, plan in ((1, unknown_floor_plan("lab", (4, 6), 0.1)), (2, known)):
            episode = ExternalEpisode(plan, (1, 1), planner=f"theirs-{side}", seed=seed)
            with EpisodeWriter(tmp_path / side / f"{seed}.mcap", episode.header) as writer:
                seen = np.full((4, 6), -1, np.int8)
                seen[:, :3] = 0
                writer.add(episode.step((1, 1), seen))
                writer.add(episode.step((1, column), seen, outcome="out_of_steps"))
    done = cli("diff", tmp_path / "a", tmp_path / "b")
    assert done.code == 0, done.err
    assert "10000000" not in done.out
    rows = json.loads(cli("diff", tmp_path / "a", tmp_path / "b", "--format", "json").out)["rows"]
    assert [(r["time_a"], r["time_b"], r["difference"]) for r in rows] == [(None,) * 3] * 2
    assert "10000000" not in cli("info", tmp_path / "a" / "1.mcap").out
    compared = cli("compare", tmp_path, "--html", tmp_path / "c.html")
    assert "10000000" not in compared.out + (tmp_path / "c.html").read_text()
    per = cli("metrics", tmp_path / "a" / "2.mcap", "--per", "episode", "--format", "json")
    assert json.loads(per.out)["rows"][0]["area"] is None


def test_every_verb_says_the_same_mapping_time_of_logs_without_a_truth(
    cli: Run, tmp_path: Path
) -> None:
    for side, steps in (("a", 3), ("b", 4)):
        plan = unknown_floor_plan("lab", (4, 6), 0.1)
        episode = ExternalEpisode(plan, (1, 1), planner=f"theirs-{side}")
        with EpisodeWriter(tmp_path / side / "1.mcap", episode.header) as writer:
            for k in range(steps):
                outcome = "mapped" if k == steps - 1 else None
                writer.add(episode.step((1, 1), np.zeros((4, 6), np.int8), outcome=outcome))
    a, b = tmp_path / "a", tmp_path / "b"

    def rows(*arguments: object) -> list[dict[str, object]]:
        result: list[dict[str, object]] = json.loads(cli(*arguments, "--format", "json").out)[
            "rows"
        ]
        return result

    assert [row["mapping_time"] for row in rows("ls", tmp_path)] == [2, 3]
    assert [r["value"] for r in rows("info", a) if r["what"] == "mapping time"] == ["2"]
    assert rows("metrics", a, "--per", "episode")[0]["mapping_time"] == 2
    means = [row for row in rows("compare", tmp_path) if row["of"] == "mean"]
    assert [row["value"] for row in means if row["what"] == "mapping time"] == [2, 3]
    for side in (a, b):  # a second one, so that folders are compared
        other = ExternalEpisode(plan, (2, 2), planner="theirs", seed=2)
        with EpisodeWriter(side / "2.mcap", other.header) as writer:
            writer.add(other.step((2, 2), np.zeros((4, 6), np.int8), outcome="out_of_steps"))
    times = {row["seed"]: (row["time_a"], row["time_b"]) for row in rows("diff", a, b)}
    assert times == {1: (2, 3), 2: (None, None)}
