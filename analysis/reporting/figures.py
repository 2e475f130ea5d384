"""What all figures share: their style, for a light and for a dark page, and their files."""

from __future__ import annotations

import io
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Final

from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.text import Text

from mapreplay.recorders.pictures.palette import (
    BLUE,
    GREEN,
    ORANGE,
    PAGE,
    PAGE_DARK,
    PURPLE,
    SKY_BLUE,
    VERMILION,
    Theme,
    hex_of,
)
from mapreplay.text import printable, shortened

COLOURS: Final = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY_BLUE)
"""Of groups, in their order; the next one has the colour of the ink."""
MARKERS: Final = ("o", "s", "^", "D", "v", "P", "X")
LINES: Final = ("-", "--", "-.", ":", (0, (5, 1)), (0, (3, 1, 1, 1)), (0, (1, 1)))
"""So that a figure is readable without its colours."""
_LONGEST: Final = 60
"""Characters of a name."""


Draw = Callable[[Figure, Theme], None]
"""Draws into an empty figure."""


def colour(number: int, theme: Theme) -> str:
    """The colour of the n-th group, as matplotlib takes it."""
    return hex_of((*COLOURS, theme.ink)[number % (len(COLOURS) + 1)])


def label(name: str) -> str:
    """A name from outside, for a legend, an axis or a title: printable, and not too long."""
    text = shortened(name, _LONGEST)
    # matplotlib leaves names that begin with an underscore out of a legend.
    return f" {text}" if text.startswith("_") else text


def plain(figure: Figure) -> None:
    """Draw all text as it is, never as TeX, and let no control character into a file."""
    for text in figure.findobj(Text):
        if isinstance(text, Text):
            text.set_parse_math(False)
            text.set_text("\n".join(map(printable, text.get_text().split("\n"))))


@contextmanager
def quiet() -> Iterator[None]:
    """Silence matplotlib's warnings on looks: letters that its font does not have (in an SVG the
    reader's font has them), too little room.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        yield


def render(draw: Draw, size: tuple[float, float], theme: Theme = PAGE, form: str = "svg") -> bytes:
    """The figure as the bytes of an SVG or PNG file; the same figure gives the same bytes.

    Args:
        draw: draws into an empty figure.
        size: width and height in inches.
        theme: of the page that it is for.
        form: "svg" or "png".
    """
    paper, ink = hex_of(theme.paper), hex_of(theme.ink)
    style: dict[Any, Any] = {  # matplotlib's keys are a Literal of 300 names
        "axes.edgecolor": ink,
        "axes.facecolor": paper,
        "axes.grid": True,
        "axes.labelcolor": ink,
        "axes.spines.right": False,
        "axes.spines.top": False,
        "axes.titlelocation": "left",
        "axes.titlesize": 10,
        "figure.facecolor": paper,
        "font.family": "sans-serif",
        "font.size": 9,
        "grid.color": hex_of(theme.line),
        "grid.linewidth": 0.6,
        "legend.frameon": False,
        "savefig.facecolor": paper,
        "svg.fonttype": "none",  # text stays text: small, and searchable
        "svg.hashsalt": "mapreplay",
        "text.color": ink,
        "xtick.color": ink,
        "ytick.color": ink,
    }
    file = io.BytesIO()
    with rc_context(style), quiet():
        figure = Figure(figsize=size, layout="constrained")
        draw(figure, theme)
        plain(figure)
        metadata = {"Date": None} if form == "svg" else {"Software": None}
        figure.savefig(file, format=form, dpi=150, metadata=metadata)
    return file.getvalue()


def in_the_dark(svg: bytes) -> bytes:
    """An SVG that was rendered for a light page, in the colours of a dark one."""
    for part in ("paper", "ink", "faint", "line"):
        light, dark = (hex_of(getattr(theme, part)) for theme in (PAGE, PAGE_DARK))
        svg = svg.replace(light.encode(), dark.encode())
    return svg
