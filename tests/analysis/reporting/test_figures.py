"""Names in figures are letters: never TeX, never too long, never a reason for a warning."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from matplotlib.figure import Figure

from mapreplay.analysis.reporting.figures import label, render
from mapreplay.recorders.pictures.palette import Theme
from mapreplay.text import printable


class Named:
    """A figure that puts a name everywhere where ours do."""

    def __init__(self, name: str) -> None:
        self.name = name

    def __call__(self, figure: Figure, theme: Theme) -> None:
        axes = figure.subplots()
        axes.plot([0, 1], [0, 1], label=label(self.name))
        axes.set_yticks([0, 1], [label(self.name), "other"])
        axes.set_title(self.name)
        axes.set_xlabel(label(self.name))
        axes.legend()


def letters(svg: bytes) -> list[str]:
    """The texts of an SVG."""
    return ["".join(e.itertext()) for e in ET.fromstring(svg).iter() if e.tag.endswith("}text")]


@pytest.mark.parametrize("name", ["$a_b$", r"$\frac{$", "_hidden", "<b>&amp;", r"100 \$ %"])
def test_a_name_is_drawn_as_it_is_everywhere(name: str) -> None:
    drawn = [text.strip() for text in letters(render(Named(name), (4, 3)))]
    assert drawn.count(name) == 4


@given(st.text(st.characters(codec="utf-8"), max_size=200))
@example("\x1b[2J\x00\uffff")
@example("日本🙂")
@example("a" * 10_000)
@settings(max_examples=12)
def test_any_name_is_drawn(name: str) -> None:
    svg = render(Named(name), (4, 3))
    for text in letters(svg):
        assert text == printable(text)
    assert render(Named(name), (4, 3), form="png").startswith(b"\x89PNG")
