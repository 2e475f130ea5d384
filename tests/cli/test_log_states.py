"""What a log is, and what lies in a folder: every verb says the same, with the same exit code."""

from __future__ import annotations

import csv
import errno
import io
import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from mcap.opcode import Opcode
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer
from rosbags.typesys import Stores, get_typestore

from commands import Result, Run
from mapreplay.recorders.log import find, reader
from mapreplay.recorders.log.mcap.reader import read_records
from mapreplay.recorders.log.recover import recover
from mapreplay.recorders.log.writer import EpisodeWriter
from recordings import Recorded, record, three_rooms

VERBS = {
    "ls": (),
    "info": (),
    "metrics": (),
    "verify": (),
    "diagnose": ("--no-save",),
    "compare": (),
    "whatif": ("--delta-free", ".8", "--delta-occupied", ".9"),
    "view": ("--force", "--size", "640x360", "--png", "{out}/v.png"),
    "export": ("--force", "--npz", "{out}/e.npz"),
    "bundle": ("--force", "-o", "{out}/b.zip"),
}
MANY = ("ls", "metrics", "verify", "diagnose", "compare")
"""The verbs over any number of logs."""


class State(NamedTuple):
    """A log, what is said of it, and whether there is an episode to compare."""

    path: Path
    words: str
    finished: bool


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """61 steps with a prediction, in three chunks of 20 and one of the last."""
    return record(tmp_path_factory.mktemp("good"), three_rooms(predictor="blur"))


def contents(recorded: Recorded) -> dict[str, bytes]:
    """By name: what is left of a log, or follows it."""
    whole = recorded.path.read_bytes()
    with recorded.path.open("rb") as file:
        bodies = [r.body for r in read_records(file) if r.opcode == Opcode.CHUNK]
    starts = [whole.index(body) - 9 for body in bodies]
    ends = [start + 9 + len(body) for start, body in zip(starts, bodies, strict=True)]
    hurt = bytearray(whole)
    hurt[starts[2] + 300] ^= 1
    return {
        "finished.mcap": whole,
        "unfinished.mcap.part": whole[: ends[2]],
        "cut.mcap": whole[: ends[2] + 50],
        "gap.mcap.part": whole[: starts[2]] + whole[ends[2] : ends[-1]],
        "byte.mcap": whole + b"x",
        "second.mcap": whole + whole,
        "damaged.mcap": bytes(hurt),
    }


@pytest.fixture(scope="module")
def states(good: Recorded, tmp_path_factory: pytest.TempPathFactory) -> dict[str, State]:
    """All states of a log that can be opened."""
    folder = tmp_path_factory.mktemp("states")
    made = contents(good)
    for name, content in made.items():
        (folder / name).write_bytes(content)
    (folder / "recovered.mcap.part").write_bytes(made["unfinished.mcap.part"])
    for name in ("recovered.mcap.part", "damaged.mcap"):
        recover(folder / name)
    size = len(made["finished.mcap"])
    one = "1 byte follows the end of the log and was not read"
    more = f"{size} bytes follow the end of the log (another MCAP file) and were not read"
    lost = "steps 20 to 39 are missing; 41 steps can be read"
    return {
        name: State(folder / file, words, finished)
        for name, file, words, finished in (
            ("finished", "finished.mcap", "", True),
            ("unfinished", "unfinished.mcap.part", "unfinished; 40 steps can be read", False),
            ("cut off", "cut.mcap", "cut off; 40 steps can be read", False),
            ("recovered", "recovered.mcap", "recovered; 40 steps can be read", False),
            ("gap", "gap.mcap.part", f"unfinished; {lost}", False),
            ("recovered gap", "damaged.recovered.mcap", lost, False),
            ("a byte behind", "byte.mcap", one, True),
            ("a log behind", "second.mcap", more, True),
        )
    }


def run(cli: Run, verb: str, out: Path, *logs: Path) -> Result:
    result = cli(verb, *logs, *(word.format(out=out) for word in VERBS[verb]))
    assert "Traceback" not in result.err
    return result


@pytest.mark.parametrize("verb", VERBS)
def test_all_verbs_agree(cli: Run, states: dict[str, State], tmp_path: Path, verb: str) -> None:
    for name, (path, words, finished) in states.items():
        result = run(cli, verb, tmp_path, path)
        said = [line for line in result.err.splitlines() if line.startswith(f"{path}: ")]
        assert said[:1] == ([f"{path}: {words}"] if words else []), name
        if verb == "compare" and not finished:
            assert result.code == 1, name
            assert "no finished episode to compare" in result.err
        else:
            assert result.code == (3 if words else 0), name


@pytest.mark.parametrize("verb", VERBS)
def test_damage_is_said_in_the_same_words(
    cli: Run, states: dict[str, State], tmp_path: Path, verb: str
) -> None:
    path = states["finished"].path.with_name("damaged.mcap")
    told = (
        f"{path}: damaged (the checksum of its data does not match); copy it again, or save what "
        f"can be read: mapreplay recover {path}"
    )
    alone = run(cli, verb, tmp_path, path)
    assert (alone.code, alone.out, alone.err) == (1, "", f"mapreplay: {told}\n")
    if verb in MANY:
        both = run(cli, verb, tmp_path, path, states["finished"].path)
        assert both.code == 3
        assert told in both.err
        assert both.out


@pytest.mark.parametrize("name", ["gap", "recovered gap"])
def test_what_is_missing_is_in_no_number(
    cli: Run, states: dict[str, State], tmp_path: Path, name: str
) -> None:
    path, whole = states[name].path, states["finished"].path
    there = [*range(20), *range(40, 61)]
    rows, all_rows = (
        list(csv.DictReader(io.StringIO(cli("metrics", log, "--format", "csv").out)))
        for log in (path, whole)
    )
    assert [int(row["step"]) for row in rows] == there
    for row in rows:
        same = all_rows[int(row["step"])]
        assert (row["f1"], row["coverage_fused"]) == (same["f1"], same["coverage_fused"])
    assert "41 steps agree" in cli("metrics", path).err
    assert "1 log, 41 steps: all agree" in cli("verify", path).err
    assert "decisions after that not checked" in cli("verify", path).err
    for verb in ("whatif", "view"):
        result = cli(
            verb, path, "--step", "30", *(["--png", tmp_path / "v.png"] * (verb == "view"))
        )
        assert result.code == 1
        assert "steps 20 to 39 are missing, which lost 30" in result.err
    assert cli("export", path, "--npz", tmp_path / "e.npz").code == 3
    with np.load(tmp_path / "e.npz") as arrays:
        assert arrays["step"].tolist() == there
        assert len(arrays["observed"]) == len(arrays["f1"]) == 41
    different = cli("diff", path, whole)
    assert different.code == 3
    assert "missing steps 20 to 39 | none" in different.out
    assert "All 41 steps are the same, bit for bit." in different.out
    branch = cli("branch", path, "--at", "45", "--with", "delta-occupied=.9")
    assert branch.code == 1
    assert "steps 20 to 39 are missing; a branch from there needs all of them" in branch.err


def test_recover_tells_what_is_behind_the_end_and_what_is_lost(
    cli: Run, good: Recorded, tmp_path: Path
) -> None:
    for name, content in contents(good).items():
        path = tmp_path / name
        path.write_bytes(content)
        result = cli("recover", path)
        if name == "finished.mcap":
            assert (result.code, result.err) == (0, f"{path}: intact; nothing to do\n")
            continue
        assert result.code == 3
        if name in ("byte.mcap", "second.mcap"):
            assert result.err.startswith(f"{path}: ")
            assert "the end of the log" in result.err
            clean = path.with_suffix(".recovered.mcap")
            assert clean.read_bytes() == good.path.read_bytes()
            assert cli("ls", clean).code == 0
        elif name in ("gap.mcap.part", "damaged.mcap"):
            assert "20 to 39" in result.out
        else:
            assert "all after step 39" in result.out


def test_a_log_that_is_being_written_is_told(cli: Run, good: Recorded, tmp_path: Path) -> None:
    with EpisodeWriter(tmp_path / "a.mcap", good.header) as writer:
        for step in good.steps[:25]:
            writer.add(step)
        for verb in ("ls", "info", "metrics", "verify"):
            result = run(cli, verb, tmp_path, writer.part)
            assert result.code == 3
            assert f"{writer.part}: being written; 20 steps can be read" in result.err
        assert cli("recover", writer.part).code == 1


# What lies in a folder.


def as_the_shell(pattern: str) -> list[Path]:
    """What a shell makes of a pattern."""
    done = subprocess.run(
        ["bash", "-O", "globstar", "-c", f"printf '%s\\n' {pattern}"],
        check=True, capture_output=True, text=True,
    )  # fmt: skip
    return [Path(line) for line in done.stdout.splitlines()]


def assert_all_ways_agree(cli: Run, folder: Path, verb: str, *, deep: bool = False) -> Result:
    """A folder, a pattern, the pattern ``**``, and what a shell makes of both."""
    everywhere = f"{folder}/**/*.mcap*"
    ways: list[list[Path]] = [[folder], [Path(everywhere)], as_the_shell(everywhere)]
    if not deep:
        ways += [[folder / "*.mcap*"], as_the_shell(f"{folder}/*.mcap*"), [folder / "*"],
                 as_the_shell(f"{folder}/*")]  # fmt: skip
    first, *others = [run(cli, verb, folder, *paths) for paths in ways]
    for paths, other in zip(ways[1:], others, strict=True):
        assert other == first, [str(path) for path in paths]
    return first


@pytest.fixture
def folder(good: Recorded, tmp_path: Path) -> Path:
    """With one good log."""
    inside = tmp_path / "logs"
    inside.mkdir()
    shutil.copy(good.path, inside / "good.mcap")
    return inside


@pytest.fixture
def no_cache(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """So that no run is told of another's results."""
    (tmp_path / "a file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "a file"))


@pytest.mark.usefixtures("no_cache")
@pytest.mark.parametrize("verb", ["ls", "metrics", "verify", "compare"])
def test_all_states_in_a_folder(cli: Run, good: Recorded, folder: Path, verb: str) -> None:
    for name, content in contents(good).items():
        (folder / name).write_bytes(content)
    result = assert_all_ways_agree(cli, folder, verb)
    assert result.code == 3
    for name, words in (
        ("unfinished.mcap.part", "unfinished; 40 steps can be read"),
        ("cut.mcap", "cut off; 40 steps can be read"),
        ("gap.mcap.part", "unfinished; steps 20 to 39 are missing; 41 steps can be read"),
        ("byte.mcap", "1 byte follows the end of the log and was not read"),
        ("damaged.mcap", "damaged (the checksum"),
    ):
        assert f"{folder / name}: {words}" in result.err
    assert f"{folder}/good.mcap: the same file as {folder}/finished.mcap" in result.err


def broken_link(folder: Path) -> None:
    (folder / "gone.mcap").symlink_to("nowhere.mcap")


def link_to_itself(folder: Path) -> None:
    (folder / "loop.mcap").symlink_to("loop.mcap")


def pipe(folder: Path) -> None:
    os.mkfifo(folder / "pipe.mcap")


def web_page(folder: Path) -> None:
    (folder / "page.mcap").write_bytes(b"<!DOCTYPE html><html>Not found")


@pytest.mark.usefixtures("no_cache")
@pytest.mark.parametrize(
    ("make", "words"),
    [
        (broken_link, "gone.mcap: cannot be read (No such file or directory): a link to nowhere"),
        (link_to_itself, "loop.mcap: cannot be read (Too many levels of symbolic links)"),
        (pipe, "pipe.mcap: "),
        (web_page, "page.mcap: not an MCAP file: a web page"),
    ],
)
def test_what_cannot_be_read_is_told_and_the_rest_is_done(
    cli: Run, folder: Path, make: Callable[[Path], None], words: str
) -> None:
    make(folder)
    for verb in ("ls", "metrics", "verify"):
        result = assert_all_ways_agree(cli, folder, verb)
        assert result.code == 3
        assert words in result.err
        assert result.out


@pytest.mark.parametrize("what", ["file", "folder"])
def test_what_may_not_be_read_is_told(
    cli: Run, folder: Path, monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    """Also for an administrator, whom no permissions bind: the refusal is simulated."""
    secret = folder / ("secret.mcap" if what == "file" else "secret")
    if what == "file":
        secret.write_bytes(b"")
    else:
        secret.mkdir()

    def refusing(real: Callable[..., Any]) -> Callable[..., Any]:
        def call(path: Path, *rest: object, **options: object) -> object:
            if path == secret:
                raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
            return real(path, *rest, **options)

        return call

    monkeypatch.setattr(os, "scandir", refusing(os.scandir))
    monkeypatch.setattr(reader, "open_regular", refusing(reader.open_regular))
    for verb in ("ls", "verify"):
        result = run(cli, verb, folder, folder)
        assert result.code == 3
        assert f"{secret}: cannot be read (Permission denied)" in result.err
        assert result.out


@pytest.mark.usefixtures("no_cache")
def test_other_results_and_hidden_files_are_passed_over(cli: Run, folder: Path) -> None:
    for name in ("._good.mcap", ".hidden.mcap", "good.diagnosis.json", "good.zip"):
        (folder / name).write_bytes(b"no log")
    (folder / ".git").mkdir()
    (folder / ".git" / "x.mcap").write_bytes(b"no log")
    for verb in ("ls", "metrics", "verify"):
        result = assert_all_ways_agree(cli, folder, verb)
        assert result.code == 0, result.err
    fork = cli("ls", folder / "._good.mcap", folder / "good.mcap")
    assert fork.code == 0  # a shell with dotglob
    assert cli("ls", folder / "._good.mcap").code == 1


def test_links_to_folders_are_not_followed(cli: Run, folder: Path) -> None:
    (folder / "inner").mkdir()
    shutil.copy(folder / "good.mcap", folder / "inner" / "b.mcap")
    (folder / "inner" / "up").symlink_to(folder)
    (folder / "again").symlink_to("inner")
    (folder / "again.mcap").symlink_to("inner")
    result = assert_all_ways_agree(cli, folder, "verify", deep=True)
    assert "2 logs, 122 steps: all agree" in result.err
    assert result.code == 0


@pytest.mark.parametrize("make", [shutil.copy, os.link, os.symlink])
def test_two_names_of_one_file_are_told(
    cli: Run, folder: Path, make: Callable[[Path, Path], object]
) -> None:
    make(folder / "good.mcap", folder / "other.mcap")
    line = f"{folder}/other.mcap: the same file as {folder}/good.mcap"
    for verb in ("ls", "metrics", "verify", "compare", "diagnose"):
        for _ in range(2 if verb == "metrics" else 1):  # also with what is cached
            result = run(cli, verb, folder, folder)
            assert (result.code, result.err.count(line)) == (0, 1), verb


def listed_then(monkeypatch: pytest.MonkeyPatch, change: Callable[[], object]) -> None:
    """`change` happens after the folder is listed."""
    real = find.find_each

    def find_each(paths: list[Path]) -> list[list[Path]]:
        found = real(paths)
        change()
        return found

    monkeypatch.setattr(find, "find_each", find_each)


@pytest.mark.parametrize("verb", MANY)
def test_a_log_that_is_removed_meanwhile_is_told(
    cli: Run, folder: Path, monkeypatch: pytest.MonkeyPatch, verb: str
) -> None:
    gone = folder / "gone.mcap"
    shutil.copy(folder / "good.mcap", gone)
    listed_then(monkeypatch, lambda: gone.unlink(missing_ok=True))
    result = run(cli, verb, folder, folder)
    assert result.code == 3
    assert f"{gone}: cannot be read (No such file or directory)" in result.err


@pytest.mark.parametrize("verb", MANY)
def test_a_log_that_is_finished_meanwhile_is_read_under_its_new_name(
    cli: Run, folder: Path, monkeypatch: pytest.MonkeyPatch, verb: str
) -> None:
    part = (folder / "good.mcap").rename(folder / "good.mcap.part")

    def finish() -> None:
        if part.exists():
            part.rename(folder / "good.mcap")

    listed_then(monkeypatch, finish)
    result = run(cli, verb, folder, folder)
    assert result.code == 0, result.err
    assert ".part" not in result.out + result.err


def test_a_log_that_was_finished_before_is_found_under_its_old_name(cli: Run, folder: Path) -> None:
    for verb in ("ls", "info", "verify"):
        old, new = (run(cli, verb, folder, folder / f"good.mcap{end}") for end in (".part", ""))
        assert old == new
        assert old.code == 0


def test_a_log_that_is_finished_while_the_folder_is_listed_is_found_once(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    part = (folder / "good.mcap").rename(folder / "good.mcap.part")
    real, count = find._listed, 0

    def listed(path: Path) -> set[Path]:
        nonlocal count
        found, count = real(path), count + 1
        if count == 1:
            part.rename(folder / "good.mcap")
        return found

    monkeypatch.setattr(find, "_listed", listed)
    assert find.find_logs([folder]) == [folder / "good.mcap"]


@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_a_folder_with_another_bag_says_so(cli: Run, tmp_path: Path, plugin: StoragePlugin) -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)
    text = store.types["std_msgs/msg/String"]
    with Rosbag2Writer(tmp_path / "bag", version=9, storage_plugin=plugin) as bag:
        connection = bag.add_connection("/odom", text.__msgtype__, typestore=store)
        bag.write(connection, 1, store.serialize_cdr(text("hello"), text.__msgtype__))
    words = {
        StoragePlugin.MCAP: "a ROS 2 bag with topics /odom: not a log of mapreplay",
        StoragePlugin.SQLITE3: "no .mcap or .mcap.part file in it; bag.db3 is a SQLite database",
    }
    for verb in ("ls", "info", "verify", "recover"):
        result = cli(verb, tmp_path / "bag")
        assert result.code == 1
        assert words[plugin] in result.err
        assert "damaged" not in result.err
