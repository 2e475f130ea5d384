"""Names, planners and ids of a log are text: they reach people as they are, escaped, and no more.

Nothing of them is markup of Rich, TeX, HTML or Markdown, and nothing drives a terminal.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from commands import Run
from mapreplay import EpisodeWriter, ExternalEpisode, unknown_floor_plan
from mapreplay.cli import _fail
from mapreplay.cli.output import Command, Format, emit, note, say
from mapreplay.cli.progress import progress_bar
from mapreplay.text import printable, shell_command

ANY_TEXT = st.text(st.characters(codec="utf-8"), max_size=40)
PLANNERS = (
    "nearest[/x]",
    "a[red]b[/red]:smile:",
    "\x1b]0;pwned\x07\x1b[2J",
    r"$\frac{$",
    "_a\u202eb",
    "<script>",
    "x What if: rm -rf ~",
)


def only_text(written: str) -> bool:
    """Nothing but what is drawn, and line ends."""
    return all(line == printable(line) for line in written.split("\n"))


@pytest.fixture(scope="module")
def hostile(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a log of each of the planners; the files have names of the same kind."""
    folder = tmp_path_factory.mktemp("hostile")
    observed = np.zeros((4, 5), np.int8)
    for number, planner in enumerate(PLANNERS):
        plan = unknown_floor_plan("lab", (4, 5), 0.05)
        episode = ExternalEpisode(plan, (1, 1), planner=planner, simulator=planner)
        path = folder / f"run[final]$_{number}\x1b[1m.mcap"
        with EpisodeWriter(path, episode.header) as writer:
            writer.add(episode.step((1, 1), observed, target=(1, 2)))
            writer.add(episode.step((1, 2), observed, outcome="mapped"))
    return folder


@pytest.mark.parametrize(
    "verb",
    [["ls"], ["verify"], ["metrics"], ["diagnose"], ["compare"], ["ls", "--where", "planner=[/x]"]],
    ids=" ".join,
)
def test_verbs_on_many_logs(cli: Run, hostile: Path, verb: list[str]) -> None:
    done = cli(verb[0], hostile, *verb[1:])
    assert done.code == 0, done.err
    assert only_text(done.out)
    assert only_text(done.err)


def test_each_planner_and_name_is_shown_as_it_is(cli: Run, hostile: Path) -> None:
    shown = cli("ls", hostile).out
    for planner in PLANNERS:
        assert printable(planner) in shown
    files = cli("verify", hostile).out
    assert r"run[final]$_3\x1b[1m.mcap" in files


def test_json_is_exact(cli: Run, hostile: Path) -> None:
    rows = json.loads(cli("ls", hostile, "--format", "json").out)["rows"]
    assert {row["planner"] for row in rows} == set(PLANNERS)


def test_csv_is_exact_but_on_a_terminal(
    cli: Run, hostile: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert "\x1b]0;pwned\x07" in cli("ls", hostile, "--format", "csv").out
    monkeypatch.setattr("mapreplay.cli.output._goes_to_terminal", lambda _: True)
    shown = cli("ls", hostile, "--format", "csv").out
    assert only_text(shown)
    assert r"\x1b]0;pwned\x07" in shown


def test_figures_and_pages_of_them(cli: Run, hostile: Path, tmp_path: Path) -> None:
    page, plot, told = tmp_path / "c.html", tmp_path / "c.svg", tmp_path / "d.html"
    done = cli("compare", hostile, "--html", page, "--plot", plot)
    assert done.code == 0, done.err
    assert cli("diagnose", hostile, "--html", told).code == 0
    drawn = plot.read_text("utf-8")
    for name in (r"$\frac{$", "_a\\u202eb", "nearest[/x]", "&lt;script&gt;"):
        assert name in drawn, name  # letters, not formulas, also in the legend
    for file in (page, plot, told):
        text = file.read_text("utf-8")
        assert "\x1b" not in text
        assert "<script" not in text


@pytest.mark.parametrize("number", range(len(PLANNERS)))
def test_one_log_is_told_and_drawn(cli: Run, hostile: Path, tmp_path: Path, number: int) -> None:
    log = hostile / f"run[final]$_{number}\x1b[1m.mcap"
    for verb in (["info", log], ["diagnose", log], ["view", log, "--png", tmp_path / "a.png"]):
        done = cli(*verb)
        assert done.code == 0, done.err
        assert only_text(done.out + done.err)


def test_words_of_a_log_are_no_command(cli: Run, hostile: Path) -> None:
    told = cli("diagnose", hostile / "run[final]$_6\x1b[1m.mcap").out
    assert "\n  What if: " not in told


def test_an_unknown_file_is_named_as_it_is(cli: Run, tmp_path: Path) -> None:
    done = cli("info", tmp_path / "no  such\n[bold]\x1b[31m.mcap")
    assert done.code == 1
    assert r"no  such\n[bold]\x1b[31m.mcap" in done.err
    assert done.err.count("\n") == 1


def test_wrong_usage_says_what_was_typed(cli: Run) -> None:
    done = cli("ls", "--\x1b[31mno", ".")
    assert done.code == 2
    assert only_text(done.err)


def emitted(frame: pl.DataFrame, text: object = None) -> str:
    """What `emit` prints of a table."""
    raw = io.BytesIO()
    with contextlib.redirect_stdout(io.TextIOWrapper(raw, "utf-8")) as out:
        emit(frame, "x/1", Format.TABLE, text=text)  # type: ignore[arg-type]
        out.flush()
        return raw.getvalue().decode()


@given(st.lists(st.tuples(ANY_TEXT, ANY_TEXT), min_size=1, max_size=3), ANY_TEXT.filter(bool))
@example([("[/x]", "[red]"), ("\x9b31m", "[/]")], "[bold]")
@settings(max_examples=60)
def test_no_table_drives_a_terminal(rows: list[tuple[str, str]], head: str) -> None:
    frame = pl.DataFrame(rows, schema=[head, f"{head}2"], orient="row")
    shown = emitted(frame, [*map(str, rows), *(row[0] for row in rows), frame])
    assert only_text(shown)
    for text, _ in rows:
        if text.isalnum():
            assert text in shown


def test_a_long_name_does_not_destroy_a_table() -> None:
    rows = [("a" * 10_000, 1), ("short", 2)]
    shown = emitted(pl.DataFrame(rows, schema=["name", "number"], orient="row"))
    assert len(shown.splitlines()) < 8
    assert "short" in shown


def test_a_name_of_a_file_is_never_shortened() -> None:
    name = "n" * 250 + ".mcap"
    shown = emitted(pl.DataFrame({"file": [name, "b"]}))
    assert name in "".join(shown.split())


@given(ANY_TEXT | st.just(os.fsdecode(b"\xff\x1b")))
@settings(max_examples=60)
def test_a_line_is_one_line(text: str) -> None:
    err = io.StringIO()
    with contextlib.redirect_stderr(err):
        note(text)
        with contextlib.suppress(SystemExit):
            _fail(text, 1)
    assert err.getvalue() == f"{printable(text)}\nmapreplay: {printable(text)}\n"
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        say(text)
    assert only_text(out.getvalue())


@given(ANY_TEXT)
@settings(max_examples=30)
def test_progress_has_no_markup(text: str) -> None:
    bar = progress_bar("episode")
    task = bar.add_task(text, total=1, episode=text)
    cells = [
        column.render(bar.tasks[task]) for column in bar.columns if hasattr(column, "text_format")
    ]
    assert [str(cell) for cell in (cells[0], cells[2])] == [printable(text)] * 2


def test_a_command_can_be_copied() -> None:
    words = ["mapreplay", "view", Path("-a b$(id)\x1b.mcap")]
    shown = emitted(pl.DataFrame(), [Command(words)])
    assert shown == shell_command(words) + "\n"
