"""Standard streams that are closed, full, read by nobody or of another encoding."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

from commands import Run
from mapreplay.cli import DEBUG, streams
from mapreplay.errors import WriteError

SEALED = Path(__file__).parents[2] / "samples" / "sealed"
LOG = next(SEALED.glob("*50053*.mcap"))
VERBS = ["--version", "ls --help", f"ls {LOG}"]
FULL = Path("/dev/full")


def shell(command: str, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run what a shell makes of it, `mapreplay` being ours."""
    return subprocess.run(
        ["bash", "-c", f'mapreplay() {{ "{sys.executable}" -m mapreplay "$@"; }}; {command}'],
        capture_output=True, text=True, check=False, timeout=120, env=os.environ | variables,
    )  # fmt: skip


@pytest.mark.parametrize("verb", VERBS)
def test_a_stdout_that_is_closed_or_full_is_one_line(verb: str) -> None:
    done = shell(f"mapreplay {verb} >&-")
    assert done.returncode == 1
    assert done.stderr == "mapreplay: stdout: cannot be written (it is closed)\n"
    if FULL.exists():
        done = shell(f"mapreplay {verb} > {FULL}")
        assert done.returncode == 1
        assert done.stderr == "mapreplay: stdout: cannot be written (No space left on device)\n"


def test_a_reader_who_has_seen_enough_is_told_nothing() -> None:
    done = shell(
        f"mapreplay metrics {LOG} --format json 2>/dev/null | true; echo ${{PIPESTATUS[0]}}"
    )
    assert (done.stdout, done.stderr) == ("1\n", "")


def test_what_stderr_would_say_is_lost_with_it(tmp_path: Path) -> None:
    assert shell("mapreplay ls nowhere 2>&-").returncode == 1
    assert shell("mapreplay ls nowhere 2>&- >&- <&-").returncode == 1
    done = shell(f"mapreplay metrics {LOG} -o {tmp_path}/a.csv 2>&- >&- <&-")
    assert done.returncode == 0, "nothing was to be printed"
    # None of the files that were opened has become standard output or error:
    assert (tmp_path / "a.csv").read_text().startswith("file,step,")


@pytest.mark.parametrize(
    "variables",
    [
        {"PYTHONIOENCODING": "ascii"},
        {"LC_ALL": "C", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0"},
    ],
    ids=["ascii", "C"],
)
def test_lines_are_dashes_where_there_are_none(variables: dict[str, str]) -> None:
    done = shell(f"mapreplay ls {LOG}", **variables)
    assert done.returncode == 0, done.stderr
    assert done.stdout.isascii()
    assert "----" in done.stdout


def test_what_has_no_plainer_way_is_an_escape() -> None:
    assert "a─…ü".encode("ascii", streams._PLAIN) == rb"a-...\xfc"


def test_after_an_error_of_stdout_nothing_more_is_tried() -> None:
    read, write = os.pipe()
    os.close(read)
    with pytest.raises(BrokenPipeError):
        (raw := streams._Stdout(write, "wb")).write(b"x")
    assert raw.write(b"xyz") == 3
    raw.close()
    closed = streams._Stdout(os.open(os.devnull, os.O_RDONLY), "wb")
    with pytest.raises(WriteError, match="it is closed"):
        closed.write(b"x")
    assert closed.write(b"xyz") == 3
    closed.close()


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (MemoryError(), "mapreplay: out of memory; free memory, or process less at a time\n"),
        (OSError(errno.EMFILE, "Too many open files", "a.mcap"), "mapreplay: a.mcap: Too many op"),
        (RecursionError("maximum depth"), "mapreplay: internal error, RecursionError: maximum"),
        (KeyError("a\nb"), "mapreplay: internal error, KeyError: 'a\\nb'; please report it"),
    ],
)
def test_an_error_that_nobody_foresaw_is_one_line(
    cli: Run, monkeypatch: pytest.MonkeyPatch, error: Exception, said: str
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr("mapreplay.cli.app", fail)
    with pytest.raises(type(error)):
        cli("ls")  # MAPREPLAY_DEBUG is set for all tests
    monkeypatch.delenv(DEBUG)
    result = cli("ls")
    assert result.code == 1
    assert result.err.startswith(said)
    assert result.err.count("\n") == 1


def test_a_folder_that_is_gone_is_named(
    cli: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        Path.cwd()

    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    monkeypatch.setattr("mapreplay.cli.app", fail)
    monkeypatch.delenv(DEBUG)
    result = cli("ls")
    assert result.code == 1
    assert "the current folder no longer exists" in result.err
