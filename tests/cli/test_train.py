"""`mapreplay train`: what was trained before stays until the new weights are whole."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from commands import Run

TINY = ("train", "--floorplans", "procedural:0-5", "--hold-out", 2, "--batch", 8, "--threads", 1)
SECONDS = 120


def test_a_loss_that_is_not_finite_is_one_line_and_the_old_weights_stay(
    cli: Run, tmp_path: Path
) -> None:
    out, card = tmp_path / "t.safetensors", tmp_path / "t.json"
    out.write_text("old weights")
    card.write_text("old card")
    wild = (*TINY, "--samples", 60, "--learning-rate", "inf", "--out", out)
    result = cli(*wild, "--force")
    assert (result.code, result.err.count("\n")) == (1, 1)
    assert "the loss is nan after" in result.err
    assert "is the learning rate (inf) too high?" in result.err
    assert (out.read_text(), card.read_text()) == ("old weights", "old card")
    assert {path.name for path in tmp_path.iterdir()} == {"t.safetensors", "t.json"}
    out.unlink()
    result = cli(*wild)  # a card of that name is somebody's, too
    assert (result.code, f"{card}: exists" in result.err) == (2, True)


@pytest.mark.parametrize("rate", ["0", "-1", "nan"])
def test_a_learning_rate_that_is_none_is_refused(cli: Run, tmp_path: Path, rate: str) -> None:
    result = cli(*TINY, "--learning-rate", rate, "--out", tmp_path / "t.safetensors")
    assert (result.code, "--learning-rate" in result.err) == (2, True)


@pytest.mark.skipif(sys.platform == "win32", reason="there is no SIGTERM")
def test_a_training_that_was_terminated_says_how_to_go_on_and_goes_on_with_the_same_only(
    cli: Run, tmp_path: Path
) -> None:
    out, checkpoint = tmp_path / "t.safetensors", tmp_path / "t.checkpoint"
    command = (*TINY, "--samples", 120, "--validate-every", 20, "--out", out)
    process = subprocess.Popen(
        [sys.executable, "-m", "mapreplay", *map(str, command), "--jobs", "2"],
        stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert process.stderr is not None
    said = process.stderr.readline()  # the first point of the curve, and its checkpoint
    deadline = time.monotonic() + SECONDS
    while not checkpoint.exists() and time.monotonic() < deadline:
        time.sleep(0.02)
    process.send_signal(signal.SIGTERM)
    _, err = process.communicate(timeout=SECONDS)
    assert "samples  train" in said
    if process.returncode != 0:  # 0: it was done before
        assert process.returncode == 130
        told = f"stopped; to resume, repeat the command with --resume ({checkpoint})"
        assert err.splitlines()[-2:] == [told, "mapreplay: interrupted"]
        assert not out.exists()
        others = [word if word != "procedural:0-5" else "procedural:10-15" for word in command]
        for changed, told in (
            (others, "was made with other training plans: 4 from procedural-"),
            ((*command, "--seed", 5), "was made with --seed 0 (now 5);"),
        ):
            result = cli(*changed, "--resume")
            assert (result.code, result.err.count("\n")) == (1, 1)
            assert told in result.err
        result = cli(*command, "--resume")
        assert result.code == 0, result.err
        assert "resumed after" in result.err
    assert json.loads((tmp_path / "t.json").read_text())["samples"] >= 120
    assert not checkpoint.exists()
