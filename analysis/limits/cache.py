"""Numbers of floor plans are kept between runs: they depend only on their key."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Final

from mapreplay.analysis.cache import key_of, user_cache

_DIGITS: Final = 20
"""That a number of moves never has."""


def remembered(key: tuple[object, ...], compute: Callable[[], int]) -> int:
    """The number of that key, from ``mapreplay/limits`` in the user's cache folder if it is there.

    The key is anything that its repr tells apart. A cache that cannot be written does not matter.
    """
    kept, digest = user_cache("limits"), key_of("limits", repr(key))
    content = kept.get(digest) or b""
    if content.isdigit() and len(content) < _DIGITS:
        return int(content)
    moves = compute()
    with suppress(OSError):
        kept.put(digest, str(moves).encode())
    return moves
