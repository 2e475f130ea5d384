"""Text on pictures: whatever it is, it is drawn in one line, and cut to its room quickly."""

from __future__ import annotations

import os

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st

from mapreplay.recorders.pictures.canvas import Sheet

WHITE, BLACK = (255, 255, 255), (0, 0, 0)


@given(st.text(st.characters(codec=None), max_size=60))
@example(os.fsdecode(b"bad\xff"))
@example("\x1b[31m\n\n日本")
@settings(max_examples=60)
def test_any_text_is_drawn_in_one_line(text: str) -> None:
    sheet = Sheet(400, 60, 1.0, WHITE)
    sheet.text(4, 30, text, 12, BLACK)
    sheet.wrapped(text, 12, 100)
    assert sheet.width_of(sheet.shortened(text, 12, 100), 12) <= 100
    rows = np.flatnonzero((sheet.picture < 255).any(axis=(1, 2)))
    if text.isalnum() and text.isascii():
        assert 0 < len(rows) <= 20


def test_control_characters_are_seen() -> None:
    plain, escaped = (Sheet(200, 30, 1.0, WHITE) for _ in range(2))
    plain.text(4, 15, r"a\x1bb", 12, BLACK)
    escaped.text(4, 15, "a\x1bb", 12, BLACK)
    assert (plain.picture == escaped.picture).all()


def test_a_text_of_a_million_letters_is_cut_at_once() -> None:
    sheet = Sheet(400, 60, 1.0, WHITE)
    cut = sheet.shortened("i" * 1_000_000, 12, 300)
    assert cut.endswith("…")
    assert sheet.width_of(cut, 12) <= 300
    assert len(sheet.wrapped("i" * 1_000_000, 12, 300)) == 1
