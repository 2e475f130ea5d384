"""Text that comes from files, made safe for people to read and for shells to run.

Names, ids, planners, events and other libraries' errors are data: none of it may move a cursor,
set a window's title, turn the reading direction, hide a part of a name or look like two lines.
Each medium has one place more where its own rules are kept: `mapreplay.cli.output` the terminal,
`mapreplay.analysis.reporting.figures` figures, `mapreplay.analysis.reporting.page` HTML,
`mapreplay.recorders.pictures.canvas` pictures.
"""

from __future__ import annotations

import re
import shlex
import unicodedata
from collections.abc import Iterable
from pathlib import PurePath
from typing import Final

_HIDDEN: Final = frozenset({"Cc", "Cf", "Cs", "Zl", "Zp"})
"""Categories of Unicode: controls, formats (bidi overrides, zero-width), surrogates and line ends.
"""
_BLANK: Final = frozenset("\u034f\u115f\u1160\u17b4\u17b5\u3164\uffa0")
"""Letters and marks that are drawn as nothing."""
_MARKDOWN: Final = re.compile(r"[\\`*_{}\[\]<>#|~&$]")
_SHORT: Final = {"\n": r"\n", "\r": r"\r", "\t": r"\t"}


def printable(text: str) -> str:
    r"""`text` in one line, in which everything that is not drawn is written as an escape.

    These are control characters (C0, DEL, C1, so also ESC and line ends), lone surrogates, of
    which names that are not UTF-8 have some, what turns the reading direction, zero-width
    characters and noncharacters: ``\n``, ``\x1b``, ``\u202e``, ``\udcff``, ``\U000e0001``. All
    else stays as it is, also backslashes; the same text twice is the same as once.
    """
    if text.isascii() and text.isprintable():
        return text
    return "".join(_escaped(c) if _is_hidden(c) else c for c in text)


def one_line(text: object) -> str:
    """A library's message, which may have several lines: `printable`, each white space a blank."""
    return printable(" ".join(str(text).split()))


def shortened(text: str, room: int) -> str:
    """`text`, `printable`, in at most `room` characters: a longer one loses its middle."""
    text = printable(text)
    if len(text) <= room:
        return text
    end = (room - 1) // 2
    return f"{text[: room - 1 - end]}…{text[len(text) - end :]}"


def markdown(text: str) -> str:
    """`text`, `printable`, to be put into Markdown, so that it is shown as it is."""
    return _MARKDOWN.sub(r"\\\g<0>", printable(text))


def shell_command(words: Iterable[str | PurePath]) -> str:
    r"""A command line that a shell reads as exactly these words, to be copied by people.

    A path that begins with a dash gets ``./`` before it, so that it is not taken for an option.
    Words with characters that are not `printable` are quoted as ``$'\n'``, which bash, zsh and
    POSIX of 2024 know.
    """
    return " ".join(_shell_word(word) for word in words)


def _is_hidden(character: str) -> bool:
    code = ord(character)
    return (
        unicodedata.category(character) in _HIDDEN
        or character in _BLANK
        or code & 0xFFFE == 0xFFFE
        or 0xFDD0 <= code <= 0xFDEF
    )


def _escaped(character: str) -> str:
    code = ord(character)
    if short := _SHORT.get(character):
        return short
    if code < 0x100:
        return f"\\x{code:02x}"
    return f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"


def _shell_word(word: str | PurePath) -> str:
    text = str(word)
    if isinstance(word, PurePath) and text.startswith("-"):
        text = f"./{text}"
    if printable(text) == text:
        return shlex.quote(text)
    return "$'" + "".join(_ansi_c(c) for c in text) + "'"


def _ansi_c(character: str) -> str:
    if character in "\\'":
        return f"\\{character}"
    if not _is_hidden(character):
        return character
    of_a_byte = 0xDC80 <= ord(character) <= 0xDCFF  # as in names that are not UTF-8
    code = character.encode("utf-8", "surrogateescape" if of_a_byte else "surrogatepass")
    # Byte by byte, three octal digits each: a hexadecimal escape would take following digits, too.
    return "".join(f"\\{byte:03o}" for byte in code)
