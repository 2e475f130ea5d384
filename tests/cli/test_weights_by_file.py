"""Weights of a file: only the user says which is opened; logs say a name and a hash."""

import json
import os
import zipfile
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from commands import Run
from mapreplay.config import EpisodeConfig, predictor_name
from mapreplay.predictors.architectures import AUTOENCODER, notes_of
from mapreplay.predictors.weights import encode_tensors, file_sha256
from mapreplay.recorders.log.header import episode_pairs
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.recorders.log.writer import EpisodeWriter
from mapreplay.step import PredictorIdentity

RUN = ("run", "--planner", "nearest", "--floorplans", "procedural:7", "--max-steps", 4)


def random_weights(path: Path, seed: int) -> Path:
    torch.manual_seed(seed)
    path.write_bytes(encode_tensors(AUTOENCODER.build().state_dict(), notes_of(AUTOENCODER)))
    return path


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return random_weights(tmp_path_factory.mktemp("somewhere") / "mine.safetensors", 1)


@pytest.fixture
def log(cli: Run, tmp_path: Path, weights: Path) -> Path:
    result = cli(*RUN, "--predictor", weights, "--out", tmp_path / "logs")
    assert result.code == 0, result.err
    return next((tmp_path / "logs").iterdir())


def with_a_path(log: Path, path: Path, to: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The log as an earlier version or an attacker would have written it: it names a file."""
    header = EpisodeLog(log).header
    config = header.config.model_copy(update={"predictor": str(path)})  # which checks nothing
    with monkeypatch.context() as patch:
        patch.setattr("mapreplay.step.predictor_name", str)
        identity = PredictorIdentity(path.name, header.predictor.sha256)
        with EpisodeWriter(to, replace(header, config=config, predictor=identity)) as writer:
            for step in EpisodeLog(log):
                writer.add(step)
    assert str(path).encode() in to.read_bytes()
    return to


@pytest.mark.parametrize(
    ("word", "name"),
    [
        ("d1", "d1"),
        ("acme/net", "acme/net"),
        ("/home/me/mine.safetensors", "mine"),
        ("../mine.safetensors", "mine"),
        (r"C:\\Users\\me\\mine.safetensors", "mine"),
        ("mine.safetensors set right", "mine set right"),
        ("/home/me/model.onnx", "model.onnx"),
        ("~/model", "model"),
        ("/", "unnamed"),
    ],
)
def test_a_path_is_cut_to_a_name(word: str, name: str) -> None:
    assert predictor_name(word) == name
    assert EpisodeConfig(predictor=word).predictor == name
    assert PredictorIdentity(word, "").name == name


def test_a_log_says_name_and_hash_and_is_run_again_with_the_users_file(
    cli: Run, log: Path, weights: Path, tmp_path: Path
) -> None:
    sha256 = file_sha256(weights)
    header = EpisodeLog(log).header
    assert header.config.predictor == "mine"
    assert header.predictor == PredictorIdentity("mine", sha256)
    assert str(weights.parent).encode() not in log.read_bytes()
    told = f"the log's predictor is mine (sha256 {sha256[:12]}), not registered here; give its "
    result = cli("verify", "--rerun", log)
    assert (result.code, result.err.count("\n")) == (1, 1)
    assert f"{told}weights with --predictor FILE" in result.err
    renamed = tmp_path / "renamed.safetensors"
    renamed.write_bytes(weights.read_bytes())
    for more in (["--rerun"], ["--rerun-from", 2]):
        assert cli("verify", *more, log, "--predictor", renamed).code == 0
    other = random_weights(tmp_path / "other.safetensors", 2)
    result = cli("verify", "--rerun", log, "--predictor", other)
    assert result.code == 1
    assert f"{told}weights with --predictor FILE ({other} has {file_sha256(other)[:12]})" in (
        result.err
    )
    given = ["--predictor", other, "--predictor", weights]
    assert cli("verify", "--rerun", log, *given).code == 0
    result = cli("verify", log, "--predictor", weights)
    assert (result.code, "--predictor is for --rerun" in result.err) == (2, True)


def test_a_branch_is_run_with_the_users_file_and_says_no_path(
    cli: Run, log: Path, weights: Path, tmp_path: Path
) -> None:
    branch = tmp_path / "branch.mcap"
    what = ("branch", log, "--at", 2, "-o", branch)
    result = cli(*what, "--with", "seed=7")
    assert result.code == 2
    assert "give its weights with --predictor FILE" in result.err
    assert cli(*what, "--with", "seed=7", "--predictor", weights).code == 0
    other = random_weights(tmp_path / "other.safetensors", 2)
    assert cli(*what, "--with", f"predictor={other}", "--force").code == 0
    made = EpisodeLog(branch).header
    assert made.branch is not None
    assert made.branch.changes == ("predictor=other",)
    assert made.predictor == PredictorIdentity("other", file_sha256(other))
    assert str(tmp_path).encode() not in branch.read_bytes()
    both = ["--predictor", weights, "--predictor", other]
    assert cli("verify", "--rerun", branch, *both).code == 0


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no named pipes")
def test_a_named_pipe_that_a_log_names_is_not_opened(
    cli: Run, log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To open one would wait for ever."""
    fifo = tmp_path / "fifo.safetensors"
    os.mkfifo(fifo)
    hostile = with_a_path(log, fifo, tmp_path / "hostile.mcap", monkeypatch)
    sha256 = EpisodeLog(log).header.predictor.sha256
    for verb in (
        ["verify", "--rerun"], ["verify", "--rerun-from", 0],
        ["branch", "--at", 1, "--with", "seed=7"],
    ):  # fmt: skip
        result = cli(*verb, hostile)
        assert result.code in (1, 2)
        assert f"the log's predictor is fifo (sha256 {sha256[:12]}), not registered" in result.err
    for verb in (
        ["verify"],
        ["diagnose"],
        ["info"],
        ["ls"],
        ["whatif"],
        ["metrics"],
        ["diff", log],
    ):
        result = cli(*verb, hostile)
        assert result.code == 0, result.err
        assert str(tmp_path / "fifo") not in result.out
    # The user may name it, and is told what it is.
    result = cli("verify", "--rerun", hostile, "--predictor", fifo)
    assert "fifo.safetensors: not a file of weights (it is not a regular file)" in result.err
    result = cli(*RUN, "--predictor", fifo, "--out", tmp_path / "out")
    assert (result.code, "not a regular file" in result.err) == (1, True)


def test_an_old_log_is_verified_with_the_users_file_and_bundled_without_its_path(
    cli: Run, log: Path, weights: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    old = with_a_path(log, weights, tmp_path / "old.mcap", monkeypatch)
    assert cli("verify", "--rerun", old, "--predictor", weights).code == 0
    assert EpisodeLog(old).header.predictor.name == "mine"
    assert cli("bundle", old).code == 0
    with zipfile.ZipFile(tmp_path / "old.zip") as packed:
        for name in packed.namelist():
            assert str(weights.parent).encode() not in packed.read(name)
        assert json.loads(packed.read("config.json"))["config"]["predictor"] == "mine"
        packed.extract("episode.mcap", tmp_path)
    again = EpisodeLog(tmp_path / "episode.mcap")
    assert again.finished
    assert episode_pairs(again.header) == episode_pairs(EpisodeLog(log).header)
    assert cli("verify", "--rerun", again.path, "--predictor", weights).code == 0


def test_a_file_called_like_a_registered_predictor_is_not_taken_for_it(
    cli: Run, tmp_path: Path
) -> None:
    weights = random_weights(tmp_path / "d1.safetensors", 3)
    assert cli(*RUN, "--predictor", weights, "--out", tmp_path / "logs").code == 0
    (log,) = (tmp_path / "logs").iterdir()
    result = cli("verify", "--rerun", log)
    assert (result.code, "predictor_sha256" in result.err) == (1, True)
    assert cli("verify", "--rerun", log, "--predictor", weights).code == 0
