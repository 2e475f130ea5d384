"""`mapreplay experiment`: from training to tables and figures, and what can be wrong with it."""

import json
import random
from dataclasses import replace
from pathlib import Path

import pytest

from commands import Run
from mapreplay.floorplans import procedural

SAMPLES = Path(__file__).parents[2] / "samples" / "experiments"
TINY = SAMPLES / "tiny.toml"


def test_the_whole_pipeline(cli: Run, tmp_path: Path) -> None:
    """Train for seconds, evaluate three plans, render tables and figures; then again, resumed."""
    weights = tmp_path / "mine.safetensors"
    trained = cli(
        "train", "--floorplans", "procedural:0-39", "--validate", "procedural:50010-50013",
        "--validation-plans", 4, "--samples", 96, "--validate-every", 48, "--batch", 8,
        "--threads", 1, "--out", weights,
    )  # fmt: skip
    assert trained.code == 0, trained.err
    config = tmp_path / "mine.toml"
    config.write_text(
        TINY.read_text().replace('predictor = "d1"', f'predictor = "{weights}"') + "\n"
    )
    out = tmp_path / "out"
    made = cli("experiment", config, "--out", out, "--jobs", 1)
    assert made.code == 0, made.err
    assert "out: 0 of 24 simulations are there" in made.err
    assert {path.name for path in (out / "figures").iterdir()} == {
        "performance.png", "curve.png", "calibration.png", "example.png",
    }  # fmt: skip
    results = json.loads((out / "results.json").read_text())
    arms = {
        (row["arm"]["planner"], row["arm"]["predictor"], row["plans"]) for row in results["table"]
    }
    assert ("nearest", "none", 3) in arms
    assert ("random", "mine", 3) in arms
    free = next(r for r in results["table"] if r["arm"]["predictor"] == "always-free")
    assert free["mapping_time"]["mean"] == 0  # it claims to know it all before the first move
    assert free["correct"]["mean"] < 0.9  # and shows as what it is
    assert free["f1"]["mean"] < 0.3
    assert results["infill"][-1]["arm"]["predictor"] == "infill-4"
    assert results["sweep"][0]["delta_free"] == 0.8
    assert "| planner | plans on/builds |" in made.out
    for path in (out / "rows.jsonl", out / "results.json", out / "example.mcap"):
        assert str(tmp_path).encode() not in path.read_bytes()  # a name and a hash, never a path

    rows = (out / "rows.jsonl").read_text().splitlines(keepends=True)
    (out / "rows.jsonl").write_text("".join(rows[:-3]) + rows[-3][:40])
    again = cli("experiment", config, "--out", out, "--jobs", 1)
    assert again.code == 0, again.err
    assert "of 24 simulations are there" in again.err
    assert len((out / "rows.jsonl").read_text().splitlines()) == len(rows)
    assert json.loads((out / "results.json").read_text())["table"] == results["table"]

    # The order of the rows is that in which workers ended: it is in no number.
    reports = [(out / name).read_bytes() for name in ("results.md", "results.json")]
    shuffled = (out / "rows.jsonl").read_text().splitlines(keepends=True)
    random.Random(1).shuffle(shuffled)
    (out / "rows.jsonl").write_text("".join(shuffled))
    assert cli("experiment", config, "--out", out, "--report-only").code == 0
    assert [(out / name).read_bytes() for name in ("results.md", "results.json")] == reports

    changed = tmp_path / "changed.toml"
    changed.write_text(config.read_text().replace("coverage = 0.9", "coverage = 0.8"))
    for more in ([], ["--report-only"]):
        refused = cli("experiment", changed, "--out", out, *more)
        assert refused.code == 2
        told = "another experiment is there (coverage 0.9, now 0.8); choose another --out"
        assert told in refused.err
    content = bytearray(weights.read_bytes())
    content[-1] ^= 1
    weights.write_bytes(content)
    refused = cli("experiment", config, "--out", out, "--jobs", 1)
    assert refused.code == 2
    assert "another experiment is there (weights " in refused.err


def test_other_floor_plans_or_code_are_refused_and_more_floor_plans_are_not(
    cli: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = tmp_path / "small.toml"
    config.write_text(
        'coverage = 0.9\n[[datasets]]\nname = "D1"\nfloorplans = "procedural:5"\n'
        'predictor = "none"\nwall-share = 0.1\ncurve-plans = 0\n'
        '[[planners]]\nplanner = "nearest"\n[[maps]]\nplan-on = "observed"\nbuild = "observed"\n'
    )
    command = ("experiment", config, "--out", tmp_path / "out", "--jobs", 1)
    assert cli(*command).code == 0
    assert "1 of 1 simulations are there" in cli(*command).err
    assert "1 of 2 simulations are there" in cli(*command, "--floorplans", "D1=procedural:5-6").err
    rows = [json.loads(r) for r in (tmp_path / "out" / "rows.jsonl").read_text().splitlines()]
    assert len({row["digest"] for row in rows} - {""}) == 2

    real = procedural.generate
    with monkeypatch.context() as patch:
        patch.setattr(
            procedural,
            "generate",
            lambda n, *rest: replace(real(n + 1, *rest), id=f"procedural-{n}"),
        )
        refused = cli(*command)
    assert refused.code == 2
    assert "another experiment is there (other cells of floor plan procedural-5)" in refused.err
    with monkeypatch.context() as patch:
        patch.setattr("mapreplay.analysis.experiment.origin.code_digest", lambda: 64 * "1")
        refused = cli(*command)
    assert "another experiment is there (code of mapreplay " in refused.err
    assert "now 111111111111)" in refused.err
    (tmp_path / "out" / "settings-D1.json").unlink()  # rows of elsewhere, copied into a folder
    with monkeypatch.context() as patch:
        patch.setattr("mapreplay.analysis.experiment.jobs.code_digest", lambda: 64 * "1")
        refused = cli(*command, "--floorplans", "D1=procedural:5-6")
    assert refused.code == 1
    assert "nearest on procedural-5, seed 1 was run with another configuration" in refused.err
    (tmp_path / "out" / "settings-D1.json").write_text('{"of": "an earlier version"}')
    assert "does not say what the results there were made of" in cli(*command).err


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (["nowhere"], 2, "nowhere: no such file, and no samples/experiments/nowhere.toml here"),
        (
            [TINY, "--floorplans", "D9=x"],
            2,
            "--floorplans D9=x: expected NAME=SPEC, NAME one of D1",
        ),
        ([TINY, "--dataset", "D9"], 2, "no dataset 'D9'; there are D1"),
        ([TINY, "--report-only"], 1, "holds no finished episode of an experiment"),
        ([TINY, "--floorplans", "D1=no/where.json"], 1, "no/where.json: no such file or folder"),
    ],
)
def test_what_is_wrong_is_one_line(
    cli: Run, tmp_path: Path, arguments: list[object], code: int, said: str
) -> None:
    result = cli("experiment", *arguments, "--out", tmp_path / "out")
    assert (result.code, result.err.count("\n")) == (code, 1)
    assert said in result.err


def test_a_folder_called_like_an_experiment_does_not_hide_it(
    cli: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "tiny").mkdir()
    (tmp_path / "samples" / "experiments").mkdir(parents=True)
    (tmp_path / "samples" / "experiments" / "tiny.toml").write_text("coverage = 2")
    monkeypatch.chdir(tmp_path)
    result = cli("experiment", "tiny", "--out", "out")
    assert "samples/experiments/tiny.toml" in result.err


def test_an_out_that_is_no_folder_is_refused(cli: Run, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    result = cli("experiment", TINY, "--out", tmp_path / "file")
    assert result.code == 2
    assert "file: is a file, or in one; give the name of a folder" in result.err
