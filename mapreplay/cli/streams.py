"""Standard streams in any state: closed, full, without a reader, or with a limited encoding."""

from __future__ import annotations

import codecs
import errno
import io
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Final, TextIO

from mapreplay.errors import WriteError

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

_PLAIN: Final = "mapreplay.plain"
"""Name of the error handler for characters that an encoding lacks; see `codecs`."""
_PLAINER: Final = {"─": "-", "…": "...", "→": "->", "≤": "<=", "≥": ">="}
STDIN: Final = 0
STDOUT: Final = 1
STDERR: Final = 2


@contextmanager
def standard_streams() -> Iterator[None]:
    """Make ``sys.stdout`` and ``sys.stderr`` fail only in well-defined ways within the block.

    Characters that the encoding lacks are replaced by plainer ones, or escaped. If stdout cannot
    be written, the first attempt raises a WriteError, or a BrokenPipeError if its reader is gone,
    and everything after that is dropped, so that there is no second error at exit. Output that
    cannot be written to stderr is dropped.
    """
    _open_closed()
    found = sys.stdout, sys.stderr
    sys.stdout = _text(_Stdout(STDOUT, "wb", closefd=False), found[0])
    sys.stderr = _text(_Stderr(STDERR, "wb", closefd=False), found[1])
    try:
        yield
    finally:
        for stream in (sys.stdout, sys.stderr):
            with suppress(WriteError, BrokenPipeError):  # was reported before
                stream.flush()
        sys.stdout, sys.stderr = found


def _open_closed() -> None:
    """Open the standard streams that are closed, so that no other file takes their descriptor.

    Stdout is opened read-only, so that writing to it fails.
    """
    for descriptor, mode in ((STDIN, os.O_RDONLY), (STDOUT, os.O_RDONLY), (STDERR, os.O_WRONLY)):
        try:
            os.fstat(descriptor)
        except OSError:
            opened = os.open(os.devnull, mode)
            if opened != descriptor:
                os.dup2(opened, descriptor)
                os.close(opened)


class _Stdout(io.FileIO):
    """Bytes to stdout; after an error they are dropped."""

    _failed = False

    def write(self, data: ReadableBuffer, /) -> int:
        if self._failed:
            return memoryview(data).nbytes
        try:
            return super().write(data) or 0
        except BrokenPipeError:
            self._failed = True
            raise
        except OSError as error:
            self._failed = True
            reason = "it is closed" if error.errno == errno.EBADF else error.strerror
            raise WriteError(f"stdout: cannot be written ({reason})") from None


class _Stderr(io.FileIO):
    """Bytes to stderr; dropped if it cannot be written."""

    def write(self, data: ReadableBuffer, /) -> int:
        try:
            return super().write(data) or 0
        except OSError:
            return memoryview(data).nbytes


def _plainer(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    lost = error.object[error.start : error.end]
    plain = (_PLAINER.get(c) or c.encode("ascii", "backslashreplace").decode() for c in lost)
    return "".join(plain), error.end


codecs.register_error(_PLAIN, _plainer)


def _text(raw: io.FileIO, found: TextIO | None) -> io.TextIOWrapper:
    """A text stream on `raw`, with the encoding of the stream `found` in its place."""
    return io.TextIOWrapper(
        io.BufferedWriter(raw),
        encoding=getattr(found, "encoding", None) or "utf-8",
        errors=_PLAIN,
        line_buffering=isinstance(raw, _Stderr) or raw.isatty(),
    )
