"""Text from files: nothing of it moves a cursor, hides itself, or is more than one line."""

from __future__ import annotations

import os
import subprocess
import unicodedata
from pathlib import Path, PurePosixPath

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from mapreplay.text import markdown, one_line, printable, shell_command, shortened

ANY_TEXT = st.text(st.characters(codec=None))


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("run[final].mcap", "run[final].mcap"),
        ("[red]a[/x] $x_$ C:\\plans", "[red]a[/x] $x_$ C:\\plans"),
        ("grüße 日本 🙂 é", "grüße 日本 🙂 é"),
        ("\x1b]0;pwned\x07\x1b[2J", r"\x1b]0;pwned\x07\x1b[2J"),
        ("a\nb\r\tc", r"a\nb\r\tc"),
        ("\x7f\x85\x9b31m", r"\x7f\x85\x9b31m"),
        (os.fsdecode(b"bad\xff.mcap"), r"bad\udcff.mcap"),
        ("a\u202egnp.exe\u2066\u200b\u2028\ufeff", r"a\u202egnp.exe\u2066\u200b\u2028\ufeff"),
        ("\U000e0041\uffff\u3164", r"\U000e0041\uffff\u3164"),
    ],
)
def test_what_is_not_drawn_is_escaped_and_all_else_stays(text: str, shown: str) -> None:
    assert printable(text) == shown


@given(ANY_TEXT)
@example("\udc80\ud800")
def test_printable_text_is_one_line_of_what_is_drawn(text: str) -> None:
    shown = printable(text)
    assert not {unicodedata.category(c) for c in shown} & {"Cc", "Cf", "Cs", "Zl", "Zp"}
    assert printable(shown) == shown
    shown.encode()  # also where a strict encoder is on the way
    if text.isascii() and text.isprintable():
        assert shown == text


def test_a_message_of_several_lines_becomes_one() -> None:
    assert one_line(ValueError("not this:\n   \x1b[31mthat\n")) == r"not this: \x1b[31mthat"


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["mapreplay", "view", PurePosixPath("a b.mcap")], "mapreplay view 'a b.mcap'"),
        (["rm", PurePosixPath("-rf")], "rm ./-rf"),
        (["view", "--step", "-1"], "view --step -1"),
        (["view", PurePosixPath("$(id)`;.mcap")], "view '$(id)`;.mcap'"),
        (["view", PurePosixPath("it's\n.mcap")], r"view $'it\'s\012.mcap'"),
        (["\ud800"], r"$'\355\240\200'"),
    ],
)
def test_a_command_is_quoted_to_be_copied(words: list[str | PurePosixPath], line: str) -> None:
    assert shell_command(words) == line


@pytest.mark.skipif(not Path("/bin/bash").exists(), reason="needs bash")
def test_a_shell_reads_the_words_that_were_meant() -> None:
    words = ["a", "", "it's", "$x `id` \\n", "\x1b]0;x\x07", "a\nb", "1\x012", "é\u202e日",
             os.fsdecode(b"bad\xff")]  # fmt: skip
    line = "printf '%s\\0' " + shell_command(words)
    done = subprocess.run(["/bin/bash", "-c", line], capture_output=True, check=True)
    assert done.stdout.split(b"\0")[:-1] == [os.fsencode(word) for word in words]


@pytest.mark.parametrize(
    ("text", "source"),
    [
        ("nearest", "nearest"),
        ("a|b", r"a\|b"),
        ("![x](http://y)", r"!\[x\](http://y)"),
        ("<b>_a_**", r"\<b\>\_a\_\*\*"),
        ("a\n# b", r"a\\n\# b"),
    ],
)
def test_text_in_markdown_is_shown_as_it_is(text: str, source: str) -> None:
    assert markdown(text) == source


@given(ANY_TEXT, st.integers(3, 30))
def test_a_long_text_loses_its_middle(text: str, room: int) -> None:
    shown, whole = shortened(text, room), printable(text)
    assert len(shown) <= room
    if len(whole) <= room:
        assert shown == whole
    else:
        begin, _, end = shown.partition("…")
        assert whole.startswith(begin)
        assert whole.endswith(end)
