"""Documents and messages: links lead somewhere, commands exist, words are those of the field."""

import ast
import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer
import typer.main

from mapreplay.cli import app

ROOT = Path(__file__).parents[1]
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    ROOT / "CHANGELOG.md",
    ROOT / "samples/README.md",
    *sorted((ROOT / "docs").rglob("*.md")),
]
OUR_FOLDERS = "mapreplay|recorders|analysis|tests|samples|docs"
NOT_OUR_WORDS = [
    r"let out", r"is worth", r"was worth", r"are worth", r"set right", r"made anew", r"made again",
    r"run on from", r"to and fro", r"scraps", r"culprits?", r"doorways?", r"foreign", r"dearest",
    r"partings?", r"seldom", r"so many-th", r"had no part in", r"whoever", r"of least",
    r"(?:a row|one row|rows) an? (?:step|episode|sealing)", r"(?:metres?|nats|m) a cell", r"beside",
]  # fmt: skip
"""What a native speaker would have to read twice; see also CONTRIBUTING.md."""


def name(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


every_page = pytest.mark.parametrize("page", PAGES, ids=name)


def prose(page: Path) -> str:
    """The text without code: blocks, words in backticks, and where links lead."""
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    text = re.sub(r"`[^`]*`", "", text)
    return re.sub(r"\]\([^)]*\)", "]", text)


def anchors(page: Path) -> set[str]:
    """What a link can lead to in a page: its headings, as GitHub names them."""
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    headings = re.findall(r"^#+ +(.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@every_page
def test_every_link_leads_somewhere(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if target.startswith(("https://", "http://")):
            continue
        path, _, anchor = target.partition("#")
        there = page.parent / path if path else page
        assert there.exists(), target
        assert not anchor or anchor in anchors(there), target


@every_page
def test_every_path_in_the_text_is_there(page: Path) -> None:
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    for path in re.findall(rf"`((?:{OUR_FOLDERS})/[\w./*-]*)`", text):
        assert any(ROOT.glob(path.rstrip("/"))), path


@pytest.fixture(scope="module")
def command_line() -> Any:
    return typer.main.get_command(app)


def commands(page: Path) -> Iterator[list[str]]:
    """The words of each ``mapreplay`` command in the shell blocks of a page."""
    blocks = re.findall(r"```sh\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    for block in blocks:
        for line in block.replace("\\\n", " ").splitlines():
            if line.strip().startswith("mapreplay "):
                alone = re.split(r" [|>&;]", line)[0]  # without what the shell does with its output
                yield shlex.split(alone, comments=True)[1:]


def named(page: Path) -> Iterator[list[str]]:
    """The words of each command that the text names in backticks."""
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    for said in re.findall(r"`mapreplay ([^`]+)`", text):
        yield said.split()


@every_page
def test_every_command_has_its_verb_and_options(page: Path, command_line: Any) -> None:
    for words in (*commands(page), *named(page)):
        command, at = command_line, 0
        while hasattr(command, "commands") and at < len(words) and not words[at].startswith("-"):
            assert words[at] in command.commands, " ".join(words)
            command, at = command.commands[words[at]], at + 1
        known = {"--help", "-h"}
        for option in command.get_params(typer.Context(command)):
            known |= {*option.opts, *option.secondary_opts}
        for word in words[at:]:
            if re.match(r"--?[a-z]", word):
                assert word.partition("=")[0] in known, " ".join(words)


def assert_plain(text: str) -> None:
    for word in NOT_OUR_WORDS:
        found = re.search(rf"\b{word}\b", text, re.IGNORECASE)
        assert found is None, text[max(found.start() - 40, 0) : found.end() + 40]


@every_page
def test_the_words_are_plain(page: Path) -> None:
    assert_plain(" ".join(prose(page).split()))


def test_the_words_of_help_messages_and_docstrings_are_plain() -> None:
    for path in (ROOT / "mapreplay").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                assert_plain(" ".join(node.value.split()))
