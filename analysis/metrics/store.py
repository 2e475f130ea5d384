"""Measured episodes on disk: tables that are larger than memory, and a cache of them.

A stored table is found again by what it is made of: the bytes of the log, the scope, and the
code that measures. So a log that was moved or copied is still known, one that changed in a
single bit is not, and no clock or name of a file is trusted.
"""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final

import polars as pl

from mapreplay.analysis.metrics.measure import Scope
from mapreplay.analysis.user_cache import code_digest
from mapreplay.errors import LogError

MAX_BYTES: Final = 1 << 30
"""Of a cache; beyond, what was not used for longest is removed."""
_BLOCK: Final = 1 << 20
_CODE: Final = {
    "mapreplay": ("episode.py", "floorplan.py", "kernels.py", "mapping.py", "scores.py"),
    "mapreplay.analysis.episodes": ("curves.py", "summary.py"),
    "mapreplay.analysis.metrics": (
        "calibration.py",
        "per_episode.py",
        "kernels.py",
        "measure.py",
    ),
    "mapreplay.recorders.log": ("mcap/reader.py", "messages.py", "reader.py", "step_table.py"),
}
"""What the numbers depend on beside the log."""


@dataclass(frozen=True)
class Stored:
    """Where the tables of a measured episode are."""

    steps: Path
    """Parquet, one row a step."""
    episode: Path
    """Parquet, one row."""


@dataclass(frozen=True)
class Store:
    """A folder of measured episodes."""

    folder: Path

    def key(self, log: Path, scope: Scope) -> str:
        """What the tables of `log` are found by.

        Raises:
            LogError: the log cannot be read.
        """
        digest = hashlib.sha256(_code_digest())
        digest.update(json.dumps([scope.unknown_as.value, scope.everywhere]).encode())
        try:
            with log.open("rb") as file:
                while block := file.read(_BLOCK):
                    digest.update(block)
        except OSError as error:
            raise LogError(f"{log}: cannot be read ({error.strerror or error})") from None
        return digest.hexdigest()

    def find(self, key: str) -> Stored | None:
        """The tables, if they are there and can be read."""
        stored = self._place(key)
        try:
            for path in (stored.steps, stored.episode):
                pl.read_parquet_schema(path)
                os.utime(path)  # used just now
        except (OSError, pl.exceptions.PolarsError):
            return None
        return stored

    def keep(self, key: str, steps: pl.DataFrame, episode: pl.DataFrame) -> Stored:
        """Write the tables; whoever reads meanwhile finds the old ones or the new ones, whole.

        Raises:
            OSError: they cannot be written.
        """
        stored = self._place(key)
        stored.steps.parent.mkdir(parents=True, exist_ok=True)
        for frame, path in ((steps, stored.steps), (episode, stored.episode)):
            handle, part = tempfile.mkstemp(dir=path.parent, suffix=".part")
            os.close(handle)
            try:
                frame.write_parquet(part, compression="zstd", compression_level=1)
                Path(part).replace(path)
            finally:
                with suppress(OSError):  # it has become the table
                    Path(part).unlink()
        return stored

    def trim(self, limit: int = MAX_BYTES) -> None:
        """Remove what was not used for longest, until at most `limit` bytes are left."""
        files = []
        for path in self.folder.glob("*/*"):
            with suppress(OSError):  # another process was here first
                stat = path.stat()
                files.append((stat.st_mtime_ns, stat.st_size, path))
        total = sum(size for _, size, _ in files)
        for _, size, path in sorted(files):
            if total <= limit:
                return
            with suppress(OSError):
                path.unlink()
                total -= size

    def _place(self, key: str) -> Stored:
        folder = self.folder / key[:2]
        return Stored(folder / f"{key}.steps.parquet", folder / f"{key}.episode.parquet")


@contextmanager
def temporary_store() -> Iterator[Store]:
    """A store that is gone afterwards."""
    with tempfile.TemporaryDirectory(prefix="mapreplay-") as folder:
        yield Store(Path(folder))


@cache
def _code_digest() -> bytes:
    return code_digest(_CODE)
