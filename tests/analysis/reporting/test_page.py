"""The HTML page: whatever is put into it, it stays one page that fetches and runs nothing."""

from html.parser import HTMLParser

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapreplay.analysis.reporting.page import (
    Card,
    Code,
    Columns,
    CommandLine,
    Details,
    Facts,
    Heading,
    Illustration,
    Items,
    Link,
    Note,
    Numbers,
    Page,
    PageBlock,
    Paragraph,
    Table,
)
from mapreplay.text import printable

PNG = cv2.imencode(".png", np.zeros((2, 3, 3), np.uint8))[1].tobytes()
SVG = b'<?xml version="1.0"?><svg xmlns="http://www.w3.org/2000/svg"/>'
VOID = {"meta", "img", "source"}


class Reader(HTMLParser):
    """What a browser makes of a page: its tags, its attributes, its text; and whether it nests."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str]] = []
        self.text: list[str] = []
        self.open: list[str] = []
        self.feed(page)
        self.close()
        assert not self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += [(name, value or "") for name, value in attrs]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text.append(data)


def everything(word: str) -> list[PageBlock]:
    """A block of each kind, with `word` wherever a word can be."""
    table = Table([word, "n"], [[word, 1], [Code(word), None]], caption=word)
    return [
        Heading(word, anchor=word),
        Paragraph(word, Code(word), Link(word, word)),
        Note(word),
        Items([[word], [Code(word)]]),
        CommandLine(word),
        Numbers([(word, word)]),
        Facts([(word, Code(word))]),
        table,
        Illustration(PNG, alt=word, caption=word, dark=SVG),
        Columns([Paragraph(word), Card([table])]),
        Details(word, [Paragraph(word)]),
    ]


@given(st.text(st.characters(codec=None), min_size=1))
def test_words_stay_words(word: str) -> None:
    plain = Reader(Page("t", "l", everything("word"), "f").html())
    other = Reader(Page("t", "l", everything(word), "f").html())
    assert other.tags == plain.tags
    assert [name for name, _ in other.attributes] == [name for name, _ in plain.attributes]
    shown = "".join(other.text)
    assert shown.count(printable(word)) >= "".join(plain.text).count("word")
    assert all(line == printable(line) for line in shown.split("\n"))


def test_a_hostile_id_is_shown_and_not_obeyed() -> None:
    hostile = '</style></title><script>alert("1")</script><img src=x onerror=alert(1)>'
    page = Page(hostile, hostile, everything(hostile), hostile).html()
    read = Reader(page)
    assert "script" not in read.tags
    assert "onerror" not in dict(read.attributes)
    assert hostile in "".join(read.text)


def test_nothing_is_fetched() -> None:
    read = Reader(Page("title", "lead", everything("word")).html())
    for name, value in read.attributes:
        if name in {"src", "srcset"}:
            assert value.startswith("data:image/")
        elif name == "href":
            assert value.startswith("#")
    css = "".join(read.text)
    assert "url(" not in css
    assert "@import" not in css
    assert not {"script", "link", "iframe", "object"} & set(read.tags)
    assert "default-src 'none'" in " ".join(value for _, value in read.attributes)


def test_a_table_shows_what_is_undefined_as_a_dash_and_numbers_flush_right() -> None:
    table = Table(["plan", "f1", "ok"], [["a", 0.98765, True], ["b", float("nan"), None]]).html()
    read = Reader(table)
    assert read.text == ["plan", "f1", "ok", "a", "0.988", "yes", "b", "-", "-"]
    assert [value for name, value in read.attributes if value == "number"] == ["number"] * 3


def test_a_row_that_does_not_fit_is_refused() -> None:
    with pytest.raises(ValueError, match="a row of 1 values under a head of 2"):
        Table(["a", "b"], [["x"]]).html()


def test_pictures_for_light_and_dark_are_embedded() -> None:
    read = Reader(Illustration(PNG, "a map", dark=SVG).html())
    attributes = dict(read.attributes)
    assert attributes["src"].startswith("data:image/png;base64,")
    assert attributes["srcset"].startswith("data:image/svg+xml;base64,")
    assert attributes["alt"] == "a map"
    with pytest.raises(ValueError, match="PNG or SVG"):
        Illustration(b"GIF89a", "none").html()
