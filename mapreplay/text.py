"""Makes text from files safe to print and to paste into a shell.

Names, IDs, planners, events and errors of libraries are data: they must not move the cursor, set
a window's title, change the reading direction, hide a part of a name or look like two lines.
Each medium has one module for its own rules: `mapreplay.cli.output` the terminal,
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
"""Letters and marks that are invisible."""
_MARKDOWN: Final = re.compile(r"[\\`*_{}\[\]<>#|~&$]")
_SHORT: Final = {"\n": r"\n", "\r": r"\r", "\t": r"\t"}


def printable(text: str) -> str:
    r"""`text` in one line, with everything invisible escaped.

    These are control characters (C0, DEL, C1, so also ESC and line ends), lone surrogates
    (in names that are not UTF-8), changes of the reading direction, zero-width characters and
    noncharacters: ``\n``, ``\x1b``, ``\u202e``, ``\udcff``, ``\U000e0001``. The
    rest is unchanged, including backslashes, so that the function is idempotent.
    """
    if text.isascii() and text.isprintable():
        return text
    return "".join(_escaped(c) if _is_hidden(c) else c for c in text)


def one_line(text: object) -> str:
    """A library's message in one line: `printable`, with white space replaced by blanks."""
    return printable(" ".join(str(text).split()))


def shortened(text: str, room: int) -> str:
    """`printable` text of at most `room` characters; the middle of longer texts is left out."""
    text = printable(text)
    if len(text) <= room:
        return text
    end = (room - 1) // 2
    return f"{text[: room - 1 - end]}…{text[len(text) - end :]}"


def markdown(text: str) -> str:
    """`printable` text, escaped so that Markdown shows it as it is."""
    return _MARKDOWN.sub(r"\\\g<0>", printable(text))


def shell_command(words: Iterable[str | PurePath]) -> str:
    r"""A command line that a shell reads as exactly these words.

    A path that begins with a dash gets ``./`` before it, so that it is not taken for an option.
    Words with characters that are not `printable` are quoted as ``$'\n'``, which bash, zsh and
    POSIX 2024 support.
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
