"""Logs, tables and caches with any damage: a result or one line, whatever the verb."""

from __future__ import annotations

import errno
import importlib
import os
import random
import re
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

import polars as pl
import pytest
from mcap.opcode import Opcode
from typer import Exit
from typer.main import get_command

import sealing
from commands import Run
from damage import attachment_of, damaged, damaged_log, log_of, pieces_of, with_attachment
from mapreplay.analysis.cache import Cache
from mapreplay.cli import app
from mapreplay.errors import MapreplayError
from mapreplay.recorders.log.blame import UnforeseenError
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.recorders.log.step_table import to_parquet
from memory import bounded
from recordings import record, three_rooms

QUICK, MANY = 40, 2000
COMMAND = get_command(app)
VERBS = (
    ("ls", "{log}"),
    ("info", "{log}"),
    ("metrics", "{log}", "--format", "csv"),
    ("verify", "{log}"),
    ("diagnose", "{log}", "--no-save"),
    ("compare", "{log}", "{honest}"),
    ("diff", "{log}", "{honest}"),
    ("bundle", "{log}", "--force", "-o", "{out}/b.zip"),
    ("view", "{log}", "--force", "--size", "640x360", "--png", "{out}/v.png"),
    ("export", "{log}", "--force", "--npz", "{out}/e.npz"),
    ("recover", "{log}", "--force"),
)
"""What is done with each damaged log."""


@pytest.fixture(scope="module")
def originals(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Logs with and without a prediction, of an agent that is sealed in, and of several chunks."""
    folder = tmp_path_factory.mktemp("originals")
    (folder / "blurred").mkdir()
    blurred = record(folder / "blurred", three_rooms(predictor="blur", max_steps=25)).path
    sealed = folder / "sealed.mcap"
    always = sealing.always(sealing.LEFT_ROOM)
    sealing.recorded(sealed, sealing.episode(always, fail_safe=True))
    real = folder / "real.mcap"
    floats = sealing.episode(always, prediction_dtype="float32", fail_safe=True)
    sealing.recorded(real, floats)
    plain = folder / "plain.mcap"
    sealing.recorded(
        plain,
        sealing.episode(sealing.always(sealing.LEFT_ROOM), plan_on="observed", build="observed"),
    )
    return [blurred, sealed, real, plain]


def run(*arguments: object) -> str | None:
    """What a verb says that fails; everything but an error of ours is raised."""
    try:
        COMMAND.main([*map(str, arguments)], prog_name="mapreplay", standalone_mode=False)
    except UnforeseenError:
        raise
    except MapreplayError as error:
        return str(error)
    except (Exit, SystemExit):
        return None
    return None


def try_verb(
    words: Sequence[str], log: Path, honest: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    command = [word.format(log=log, honest=honest, out=log.parent) for word in words]
    said = run(*command)
    assert "cannot be worked on" not in capfd.readouterr().err, command
    assert said is None or "\n" not in said, command


@pytest.mark.parametrize("seed", range(QUICK))
def test_a_damaged_log(
    originals: list[Path], tmp_path: Path, capfd: pytest.CaptureFixture[str], seed: int
) -> None:
    draw = random.Random(seed)
    log = tmp_path / "damaged.mcap"
    log.write_bytes(damaged_log(draw.choice(originals).read_bytes(), draw))
    try_verb(VERBS[seed % len(VERBS)], log, originals[1], capfd)


@pytest.mark.slow
@pytest.mark.parametrize("first", range(0, MANY, 100))
def test_many_damaged_logs(
    originals: list[Path], tmp_path: Path, capfd: pytest.CaptureFixture[str], first: int
) -> None:
    contents = [path.read_bytes() for path in originals]
    log = tmp_path / "damaged.mcap"
    for words in VERBS:  # whatever a verb keeps for good is made now
        try_verb(words, originals[0], originals[1], capfd)
    for seed in range(first, first + 100):
        draw = random.Random(seed)
        log.write_bytes(damaged_log(draw.choice(contents), draw))
        for words in VERBS:
            try:
                with bounded():
                    try_verb(words, log, originals[1], capfd)
            except BaseException as error:
                error.add_note(f"seed {seed}")
                raise


@pytest.mark.parametrize("verb", ["ls", "metrics", "verify", "diagnose", "compare"])
def test_one_damaged_table_costs_its_log(
    cli: Run, originals: list[Path], tmp_path: Path, verb: str
) -> None:
    """Whatever bit of a table is flipped: the other log is worked on, and nothing is invented."""
    good = originals[3]
    shutil.copy(good, tmp_path / "good.mcap")
    pieces = pieces_of(good.read_bytes())
    (k,) = (k for k, piece in enumerate(pieces) if piece.opcode == Opcode.ATTACHMENT)
    whole = attachment_of(pieces[k])
    honest = cli(verb, tmp_path / "good.mcap")
    draw = random.Random(1)
    refused = 0
    for _ in range(4):
        changed = bytearray(whole)
        changed[draw.randrange(len(whole) // 2)] ^= 1 << draw.randrange(8)
        pieces[k] = with_attachment(bytes(changed))
        (tmp_path / "bad.mcap").write_bytes(log_of(pieces))
        result = cli(verb, tmp_path)
        assert result.code in (0, 1, 3)
        assert "Traceback" not in result.err
        if result.code == 3:
            refused += 1
            assert re.search(r"bad\.mcap: damaged \(", result.err)
            if verb == "ls":
                assert result.out == honest.out
    if verb in ("ls", "compare"):
        assert refused


def test_recover_writes_a_damaged_table_anew(
    cli: Run, originals: list[Path], tmp_path: Path
) -> None:
    pieces = pieces_of(originals[3].read_bytes())
    (k,) = (k for k, piece in enumerate(pieces) if piece.opcode == Opcode.ATTACHMENT)
    pieces[k] = with_attachment(attachment_of(pieces[k])[:-1])
    (tmp_path / "bad.mcap").write_bytes(log_of(pieces))
    assert cli("recover", tmp_path / "bad.mcap").code == 0
    made = tmp_path / "bad.recovered.mcap"
    assert EpisodeLog(made).finished
    assert EpisodeLog(made).table().equals(EpisodeLog(originals[3]).table())


@pytest.mark.parametrize("make", [lambda _: None, lambda frame: frame.drop("f1")])
def test_a_log_whose_table_is_not_ours_is_tabulated_from_its_steps(
    cli: Run, originals: list[Path], tmp_path: Path, make: Callable[[pl.DataFrame], object]
) -> None:
    log = tmp_path / originals[3].name
    pieces = pieces_of(originals[3].read_bytes())
    (k,) = (k for k, piece in enumerate(pieces) if piece.opcode == Opcode.ATTACHMENT)
    other = make(EpisodeLog(originals[3]).table())
    pieces[k : k + 1] = (
        [with_attachment(to_parquet(other))] if isinstance(other, pl.DataFrame) else []
    )
    log.write_bytes(log_of(pieces))
    assert EpisodeLog(log).table().equals(EpisodeLog(originals[3]).table())
    for verb in ("ls", "verify"):
        result, honest = cli(verb, log), cli(verb, originals[3])
        assert (result.code, result.out) == (0, honest.out), result.err


@pytest.mark.parametrize("row", [0, 7, -1])
@pytest.mark.parametrize("column", ["coverage_observed", "path_length", "f1", "row"])
def test_verify_names_a_value_of_the_table_that_is_not_its_steps(
    cli: Run, originals: list[Path], tmp_path: Path, column: str, row: int
) -> None:
    frame = EpisodeLog(originals[3]).table()
    values = frame[column].to_list()
    values[row] = 3 if column == "row" and values[row] != 3 else values[row] / 2 + 0.001
    if column == "row":
        values[row] = int(values[row])
    lying = frame.with_columns(pl.Series(column, values, frame.schema[column]))
    pieces = pieces_of(originals[3].read_bytes())
    (k,) = (k for k, piece in enumerate(pieces) if piece.opcode == Opcode.ATTACHMENT)
    pieces[k] = with_attachment(to_parquet(lying))
    log = tmp_path / "lying.mcap"
    log.write_bytes(log_of(pieces))
    step = row % len(frame)
    result = cli("verify", log)
    assert result.code == 1
    assert f"step {step}: steps.parquet {column}" in result.err
    if row == -1:
        assert (
            f"{log}: damaged (steps.parquet has another last step than the log); copy it again, or "
            f"save what can be read: mapreplay recover {log}\n"
        ) in cli("ls", log).err


def test_any_damage_to_the_cache_changes_nothing(
    cli: Run, originals: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    command = ("metrics", originals[1], "--format", "csv")
    honest = cli(*command)
    (kept,) = (path for path in tmp_path.rglob("*") if path.is_file())
    whole, draw = kept.read_bytes(), random.Random(1)
    assert "taken from the cache" in cli(*command).err
    for _ in range(8):
        kept.write_bytes(damaged(whole, draw))
        result = cli(*command)
        assert (result.code, result.out, result.err) == (honest.code, honest.out, honest.err)
        assert kept.read_bytes() == whole  # made anew


@pytest.mark.parametrize("place", ["a file", "a link to nowhere", "relative", "/dev/full"])
def test_metrics_without_a_cache(
    cli: Run, originals: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: str
) -> None:
    honest = cli("metrics", originals[1], "--no-cache")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a file").write_text("")
    (tmp_path / "a link to nowhere").symlink_to("nowhere/at/all")
    where = place if place in ("relative", "/dev/full") else str(tmp_path / place)
    monkeypatch.setenv("XDG_CACHE_HOME", where)
    result = cli("metrics", originals[1])
    assert (result.code, result.out) == (0, honest.out)
    assert result.err.count("nothing is kept") == 1
    assert not (tmp_path / "relative").exists()


def test_metrics_with_a_full_disk(
    cli: Run, originals: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(self: Cache, key: str, content: bytes) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    honest = cli("metrics", originals[1], "--no-cache")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(Cache, "put", full)
    result = cli("metrics", originals[1])
    assert (result.code, result.out) == (0, honest.out)
    assert result.err.count("cannot be written; 1 results are not cached") == 1


def test_copies_are_named(cli: Run, originals: list[Path], tmp_path: Path) -> None:
    for name in "abc":
        shutil.copy(originals[1], tmp_path / f"{name}.mcap")
    for options in (["--no-cache"], [], []):
        result = cli("metrics", tmp_path, "--per", "episode", *options)
        for name in "bc":
            line = f"{tmp_path}/{name}.mcap: the same file as {tmp_path}/a.mcap"
            assert line in result.err.splitlines()
        assert result.code == 0
    assert "3 of 3 episodes were unchanged and taken from the cache" in result.err


class Panic(BaseException):
    """What a library in Rust raises where it cannot go on."""


@pytest.mark.parametrize(
    ("verb", "broken"),
    [
        ("ls", "mapreplay.analysis.episodes.corpus.read_episode"),
        ("compare", "mapreplay.analysis.episodes.corpus.read_episode"),
        ("metrics", "mapreplay.analysis.metrics.many.measure_log"),
        ("verify", "mapreplay.analysis.verification.verify"),
        ("diagnose", "mapreplay.analysis.diagnosis.diagnosis.diagnose"),
    ],
)
def test_a_panic_on_one_log_costs_that_log(
    cli: Run, originals: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    verb: str, broken: str,
) -> None:  # fmt: skip
    shutil.copy(originals[1], tmp_path / "a.mcap")
    shutil.copy(originals[3], tmp_path / "b.mcap")
    module, _, name = broken.rpartition(".")
    real = getattr(importlib.import_module(module), name)

    def panics(log: EpisodeLog | Path, *arguments: object) -> object:
        path = log.path if isinstance(log, EpisodeLog) else log
        if path.name == "a.mcap":
            raise Panic("index out of bounds:\nthe len is 3")
        return real(log, *arguments)

    monkeypatch.setattr(broken, panics)
    result = cli(verb, tmp_path, *(["--no-cache"] if verb == "metrics" else []))
    assert result.code == 3
    assert result.out
    (line,) = (line for line in result.err.splitlines() if "a.mcap" in line)
    assert "cannot be worked on (Panic: index out of bounds: the len is 3)" in line
