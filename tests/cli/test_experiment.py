"""`mapreplay experiment`: from training to tables and figures, and what can be wrong with it."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from commands import Run
from mapreplay.analysis.experiment.config import shipped_configs
from mapreplay.floorplans import procedural
from mapreplay.recorders.log.reader import EpisodeLog

TINY = shipped_configs()["tiny"]


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
    logs = sorted((out / "logs").rglob("*.mcap"))
    for path in (*logs, out / "results.json", out / "example.mcap"):
        assert str(tmp_path).encode() not in path.read_bytes()  # a name and a hash, never a path

    # The table says what the ends of the logs say.
    times = dict[tuple[str, str, bool], dict[str, list[int]]]()
    for log in map(EpisodeLog, logs):
        header, end = log.header, log.summary
        assert end is not None
        arm = (header.config.planner, header.predictor.name, header.config.fail_safe)
        time = header.max_steps if end.mapping_time is None else end.mapping_time
        times.setdefault(arm, {}).setdefault(header.floor_plan.id, []).append(time)
    mean = {
        arm: {name: sum(runs) / len(runs) for name, runs in plans.items()}
        for arm, plans in times.items()
    }
    reference = mean["nearest", "none", False]
    for row in results["table"]:
        ours = mean[tuple(row["arm"][key] for key in ("planner", "predictor", "fail_safe"))]
        saved = [1 - ours[name] / reference[name] for name in sorted(reference)]
        assert row["mapping_time"]["mean"] == pytest.approx(sum(ours.values()) / 3)
        assert row["reductions"] == pytest.approx(saved)
        assert row["reduction"]["mean"] == pytest.approx(sum(saved) / 3)

    # A kill costs the episodes that were not finished, and changes nothing.
    reports = {name: (out / name).read_bytes() for name in ("results.md", "results.json")}
    whole = {path: path.read_bytes() for path in logs}
    for path in logs[-3:]:
        path.rename(f"{path}.part")
    again = cli("experiment", config, "--out", out, "--jobs", 1)
    assert again.code == 0, again.err
    assert "out: 21 of 24 simulations are there" in again.err
    assert {path: path.read_bytes() for path in whole} == whole
    for name in reports:
        (out / name).unlink()
    assert cli("experiment", config, "--out", out, "--report-only").code == 0
    assert {name: (out / name).read_bytes() for name in reports} == reports

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
    (log,) = (tmp_path / "out" / "logs").rglob("*.mcap")
    told = cli("verify", log)
    assert (told.code, "run the experiment again with --keep-logs" in told.err) == (1, True)
    assert cli("verify", "--rerun", log).code == 0
    assert "scalars only" in cli("info", log).out
    report = (tmp_path / "out" / "results.md").read_bytes()
    assert "0 of 1 simulations are there" in cli(*command, "--keep-logs").err
    assert (tmp_path / "out" / "results.md").read_bytes() == report
    assert cli("verify", log).code == 0
    assert "1 of 2 simulations are there" in cli(*command, "--floorplans", "D1=procedural:5-6").err
    assert len(list((tmp_path / "out" / "logs").rglob("*.mcap"))) == 2

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
    (tmp_path / "out" / "settings-D1.json").unlink()  # logs of elsewhere, copied into a folder
    other = tmp_path / "other.toml"
    other.write_text(config.read_text().replace("coverage = 0.9", "coverage = 0.8"))
    refused = cli("experiment", other, *command[2:])
    assert refused.code == 1
    assert "procedural-5__nearest__observed-observed__s1.mcap: a log of another ep" in refused.err
    (tmp_path / "out" / "settings-D1.json").write_text('{"of": "an earlier version"}')
    assert "does not say what the results there were made of" in cli(*command).err


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (
            ["nowhere"],
            2,
            "nowhere: no such file, and no experiment; there are beaten, beaten-80-85, paper, tiny",
        ),
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
    monkeypatch.chdir(tmp_path)
    result = cli("experiment", "tiny", "--out", "out", "--dataset", "D9")
    assert "no dataset 'D9'; there are D1" in result.err  # it was read


def test_an_out_that_is_no_folder_is_refused(cli: Run, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    result = cli("experiment", TINY, "--out", tmp_path / "file")
    assert result.code == 2
    assert "file: is a file, or in one; give the name of a folder" in result.err
