"""One self-contained HTML page: readable on a desk and on a phone, in light and in dark.

A page is a title, a sentence, and blocks. Everything that comes from outside (ids of floor
plans, names of files) is escaped where it is inserted; pictures are embedded; the page runs no
script and fetches nothing, and its content security policy tells the browser so.

    path.write_text(Page("Two planners", "Ten floor plans.", [Heading("Times"), Table(...)]).html())
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape
from importlib import resources
from typing import Final, Protocol, TypeAlias
from urllib.parse import quote

from mapreplay.analysis.reporting.wording import UNDEFINED
from mapreplay.text import printable


class PageBlock(Protocol):
    """A part of a page, one below the other."""

    def html(self) -> str:
        """Its HTML, with everything in it escaped."""
        ...


@dataclass(frozen=True)
class Code:
    """Something typed, or the name of a file, within a sentence."""

    text: str

    def html(self) -> str:
        """See `PageBlock`."""
        return f"<code>{_text(self.text)}</code>"


@dataclass(frozen=True)
class Link:
    """A link to another part of the same page."""

    text: str
    anchor: str

    def html(self) -> str:
        """See `PageBlock`."""
        return f'<a href="#{quote(printable(self.anchor))}">{_text(self.text)}</a>'


Inline: TypeAlias = str | Code | Link
"""What a sentence is made of; a str is plain text."""


def _text(text: str) -> str:
    """Text of whatever origin, as HTML: the one place where it is escaped."""
    return escape(printable(text))


def _inline(parts: Sequence[Inline]) -> str:
    return "".join(_text(part) if isinstance(part, str) else part.html() for part in parts)


@dataclass(frozen=True)
class Heading:
    """The title of a section; `anchor` is what a `Link` leads to."""

    text: str
    level: int = 2
    anchor: str = ""

    def html(self) -> str:
        """See `PageBlock`."""
        name = f' id="{_text(self.anchor)}"' if self.anchor else ""
        return f"<h{self.level}{name}>{_text(self.text)}</h{self.level}>"


@dataclass(frozen=True, init=False)
class Paragraph:
    """A sentence or several."""

    parts: tuple[Inline, ...]

    def __init__(self, *parts: Inline) -> None:
        object.__setattr__(self, "parts", parts)

    def html(self) -> str:
        """See `PageBlock`."""
        return f"<p>{_inline(self.parts)}</p>"


@dataclass(frozen=True, init=False)
class Note:
    """Something that the reader must not miss, in a box."""

    parts: tuple[Inline, ...]

    def __init__(self, *parts: Inline) -> None:
        object.__setattr__(self, "parts", parts)

    def html(self) -> str:
        """See `PageBlock`."""
        return f'<p class="note">{_inline(self.parts)}</p>'


@dataclass(frozen=True)
class Items:
    """A list of sentences."""

    items: Sequence[Sequence[Inline]]

    def html(self) -> str:
        """See `PageBlock`."""
        return f"<ul>{''.join(f'<li>{_inline(item)}</li>' for item in self.items)}</ul>"


@dataclass(frozen=True)
class CommandLine:
    """A command line, to be copied; a long one is wrapped."""

    text: str

    def html(self) -> str:
        """See `PageBlock`."""
        return f"<pre><code>{_text(self.text)}</code></pre>"


@dataclass(frozen=True)
class Numbers:
    """A few large numbers, each with its label: ``[("61 %", "less mapping time"), ...]``."""

    numbers: Sequence[tuple[str, str]]

    def html(self) -> str:
        """See `PageBlock`."""
        cards = "".join(
            f"<div><dd>{_text(value)}</dd><dt>{_text(name)}</dt></div>"
            for value, name in self.numbers
        )
        return f'<dl class="numbers">{cards}</dl>'


@dataclass(frozen=True)
class Facts:
    """Names and values, one per line."""

    facts: Sequence[tuple[str, Inline]]

    def html(self) -> str:
        """See `PageBlock`."""
        lines = "".join(
            f"<dt>{_text(name)}</dt><dd>{_inline([value])}</dd>" for name, value in self.facts
        )
        return f'<dl class="facts">{lines}</dl>'


Value: TypeAlias = Inline | int | float | bool | None


@dataclass(frozen=True)
class Table:
    """Rows under a head; on a narrow screen it scrolls sideways, with its first column in place.

    Columns with nothing but numbers are set flush right. None and NaN are shown as a dash, a
    float with three decimals: format it first if it needs others.
    """

    head: Sequence[str]
    rows: Sequence[Sequence[Value]]
    caption: str = ""
    right: Sequence[int] = field(default=())
    """Further columns to be set flush right, such as formatted numbers."""

    def html(self) -> str:
        """See `PageBlock`.

        Raises:
            ValueError: a row does not have as many values as the head.
        """
        right = {i for i in range(len(self.head)) if self._is_number(i)} | set(self.right)
        caption = f"<caption>{_text(self.caption)}</caption>" if self.caption else ""
        head = "".join(
            f'<th scope="col"{_aligned(i in right)}>{_text(name)}</th>'
            for i, name in enumerate(self.head)
        )
        body = "".join(f"<tr>{self._row(row, right)}</tr>" for row in self.rows)
        return (
            f'<div class="scroll" tabindex="0"><table>{caption}<thead><tr>{head}</tr></thead>'
            f"<tbody>{body}</tbody></table></div>"
        )

    def _is_number(self, column: int) -> bool:
        values = [value for row in self.rows for value in row[column : column + 1]]
        return all(
            value is None or (isinstance(value, int | float) and not isinstance(value, bool))
            for value in values
        ) and any(value is not None for value in values)

    def _row(self, row: Sequence[Value], right: set[int]) -> str:
        if len(row) != len(self.head):
            raise ValueError(f"a row of {len(row)} values under a head of {len(self.head)}")
        first, *rest = (f"{_aligned(i in right)}>{_shown(value)}</" for i, value in enumerate(row))
        return f'<th scope="row"{first}th>' + "".join(f"<td{cell}td>" for cell in rest)


def _aligned(right: bool) -> str:  # noqa: FBT001 (the only argument)
    return ' class="number"' if right else ""


def _shown(value: Value) -> str:
    if value is None or (isinstance(value, float) and value != value):
        return UNDEFINED
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.3f}"
    return _inline([value if isinstance(value, str | Code | Link) else str(value)])


@dataclass(frozen=True)
class Illustration:
    """A picture with a description; `dark` is the same for a dark page.

    Both are the bytes of a PNG or an SVG file. `pixelated` keeps the cells of a small map sharp
    when it is shown larger.
    """

    image: bytes
    alt: str
    """What it shows, for readers who cannot see it."""
    caption: str = ""
    dark: bytes | None = None
    pixelated: bool = False

    def html(self) -> str:
        """See `PageBlock`.

        Raises:
            ValueError: the bytes are neither a PNG nor an SVG.
        """
        source = (
            f'<source media="(prefers-color-scheme: dark)" srcset="{_data_uri(self.dark)}">'
            if self.dark is not None
            else ""
        )
        kind = ' class="pixelated"' if self.pixelated else ""
        image = f'<img{kind} alt="{_text(self.alt)}" src="{_data_uri(self.image)}">'
        caption = f"<figcaption>{_text(self.caption)}</figcaption>" if self.caption else ""
        return f"<figure><picture>{source}{image}</picture>{caption}</figure>"


def _data_uri(image: bytes) -> str:
    if image.startswith(b"\x89PNG"):
        kind = "image/png"
    elif b"<svg" in image[:2000]:
        kind = "image/svg+xml"
    else:
        raise ValueError("a picture must be PNG or SVG")
    return f"data:{kind};base64,{base64.b64encode(image).decode()}"


@dataclass(frozen=True)
class Columns:
    """Blocks side by side where there is room, below each other where there is none."""

    blocks: Sequence[PageBlock]
    wide: bool = False
    """At most two per row, for figures; otherwise as many as fit, each at least a map wide."""

    def html(self) -> str:
        """See `PageBlock`."""
        kind = "columns wide" if self.wide else "columns"
        inner = "".join(f"<div>{block.html()}</div>" for block in self.blocks)
        return f'<div class="{kind}">{inner}</div>'


@dataclass(frozen=True)
class Card:
    """Blocks that belong together, in a frame."""

    blocks: Sequence[PageBlock]

    def html(self) -> str:
        """See `PageBlock`."""
        return f'<section class="card">{"".join(block.html() for block in self.blocks)}</section>'


@dataclass(frozen=True)
class Details:
    """Blocks that are shown when the reader opens them."""

    summary: str
    blocks: Sequence[PageBlock]

    def html(self) -> str:
        """See `PageBlock`."""
        inner = "".join(block.html() for block in self.blocks)
        return f"<details><summary>{_text(self.summary)}</summary>{inner}</details>"


POLICY: Final = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
"""What the browser lets the page do: only show what is in it."""


@dataclass(frozen=True)
class Page:
    """A whole page."""

    title: str
    lead: str
    """One sentence below the title: the answer."""
    blocks: Sequence[PageBlock]
    footer: str = ""

    def html(self) -> str:
        """The page as one HTML document without any external resource."""
        css = (
            resources.files("mapreplay.analysis.reporting").joinpath("page.css").read_text("utf-8")
        )
        title = _text(self.title)
        body = "\n".join(block.html() for block in self.blocks)
        return (
            '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
            f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">\n'
            '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
            '<meta name="color-scheme" content="light dark">\n'
            f"<title>{title}</title>\n<style>\n{css}</style>\n</head>\n<body>\n"
            f'<header><h1>{title}</h1><p class="lead">{_text(self.lead)}</p></header>\n'
            f"<main>\n{body}\n</main>\n<footer>{_text(self.footer)}</footer>\n</body>\n</html>\n"
        )
