"""Results that are kept from one run to the next, and are believed only if they are whole.

A kept result begins with a digest of its key and of what it is. One that is cut off, that a single
bit changed, or that lies under the key of another is as good as none, and is made anew. The keys
are digests, too: of what a result is of, of all code of this package, and of the versions of the
libraries that it computes with. So neither names nor clocks nor lists kept by hand are trusted.

Nothing depends on a cache. Where there is no folder for it, where that cannot be read or written,
or where the disk is full, all is computed as if nothing had been kept.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Final

from mapreplay.files.whole import open_regular
from mapreplay.source_digest import code_digest

MAX_BYTES: Final = 1 << 30
"""Of a cache; beyond, what was not used for longest is removed."""
_FORMAT: Final = b"mapreplay cache 1\0"
_BLOCK: Final = 1 << 20


@dataclass(frozen=True)
class Cache:
    """A folder of results by their keys."""

    folder: Path | None
    """None: nothing is kept, and nothing is known."""
    limit: int = MAX_BYTES
    """Bytes of all results together, and so of each."""

    def get(self, key: str) -> bytes | None:
        """What was kept under `key`, a hexadecimal digest; None unless it is there and whole."""
        if self.folder is None:
            return None
        try:
            with open_regular(_place(self.folder, key)) as file:
                if os.fstat(file.fileno()).st_size > self.limit:
                    return None
                data = file.read(self.limit + 1)
                _mark_used(file)
        except (OSError, ValueError):
            return None
        size = hashlib.sha256().digest_size
        seal, content = data[:size], data[size:]
        return content if seal == _seal(key, content) else None

    def put(self, key: str, content: bytes) -> None:
        """Keep `content`; whoever reads meanwhile finds what was there, or this, whole.

        Raises:
            OSError: it cannot be written.
        """
        if self.folder is None:
            return
        path = _place(self.folder, key)
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, part = tempfile.mkstemp(dir=path.parent, suffix=".part")
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(_seal(key, content))
                file.write(content)
            Path(part).replace(path)
        finally:
            with suppress(OSError):  # it has its name
                Path(part).unlink()

    def trim(self) -> None:
        """Remove what was not used for longest, until at most `limit` bytes are left."""
        files = []
        for path in self.folder.glob("*/*") if self.folder else ():
            with suppress(OSError):  # another process was here first
                status = path.lstat()
                files.append((status.st_mtime_ns, status.st_size, path))
        total = sum(size for _, size, _ in files)
        for _, size, path in sorted(files):
            if total <= self.limit:
                return
            with suppress(OSError):
                path.unlink()
                total -= size

    def problem(self) -> str | None:
        """Why nothing can be kept, as a line; None if it can."""
        if self.folder is None:
            return "there is no home, and so no cache; nothing is kept"
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=self.folder) as file:
                file.write(bytes(4096))
        except OSError as error:
            return f"{self.folder}: cannot be written ({error.strerror}); nothing is kept"
        return None


def user_cache(what: str) -> Cache:
    """The cache ``mapreplay/<what>`` in the user's cache folder."""
    base = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")  # noqa: PTH111
    # Without a home, "~" stays, and would be a folder here.
    if not os.path.isabs(base) or code_digest() is None:  # noqa: PTH117
        return Cache(None)
    return Cache(Path(base) / "mapreplay" / what)


def key_of(*parts: str | Path) -> str:
    """The key of a result: a digest of its code and of what it is of.

    Args:
        parts: Texts, and files whose bytes count, not their names.

    Raises:
        OSError: a file cannot be read.
    """
    digest = hashlib.sha256(code_digest() or b"")
    for part in parts:
        inner = hashlib.sha256()
        if isinstance(part, str):
            inner.update(part.encode("utf-8", "surrogatepass"))
        else:
            with part.open("rb") as file:
                while block := file.read(_BLOCK):
                    inner.update(block)
        digest.update(inner.digest())
    return digest.hexdigest()


def _place(folder: Path, key: str) -> Path:
    return folder / key[:2] / key


def _seal(key: str, content: bytes) -> bytes:
    digest = hashlib.sha256(_FORMAT + key.encode() + b"\0")
    digest.update(content)
    return digest.digest()


def _mark_used(file: BinaryIO) -> None:
    with suppress(OSError, TypeError):  # read-only; or a system that knows only names
        os.utime(file.fileno())
