"""What goes wrong with one log costs that log: every fault becomes an error that names the file."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mapreplay.errors import LogError, MapreplayError


class UnforeseenError(LogError):
    """Something failed on a log that is not known to be damaged: a fault of ours or of a library.

    Its cause is what was raised.
    """


@contextmanager
def blaming(*logs: Path) -> Iterator[None]:
    """Work on one of many logs, or a pair: all that is raised in it becomes an error that names it.

    Libraries raise what they like; a panic of one in Rust is not even an `Exception`.

    Raises:
        UnforeseenError: something was raised that is no `MapreplayError`.
    """
    try:
        yield
    except (MapreplayError, KeyboardInterrupt, SystemExit, GeneratorExit):
        raise
    except BaseException as error:
        reason = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise UnforeseenError(
            f"{' and '.join(map(str, logs))}: cannot be worked on ({reason}); if `mapreplay "
            "verify` finds nothing wrong with it, please report this"
        ) from error
