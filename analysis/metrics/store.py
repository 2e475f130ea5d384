"""Tables of measured episodes, kept between runs.

The key is the bytes of the log, the scope, and the code that measures. So a log that was moved or
copied is still found, and one that changed in a single bit is not.
"""

from __future__ import annotations

import io
import json
import struct
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import polars as pl

from mapreplay.analysis.cache import Cache, key_of
from mapreplay.analysis.metrics.measure import Scope
from mapreplay.errors import LogError

_SIZE: Final = struct.Struct("<Q")


@dataclass(frozen=True, eq=False)
class Tables:
    """What was measured of an episode."""

    steps: pl.DataFrame
    """A row per step."""
    episode: pl.DataFrame
    """One row, see `mapreplay.analysis.metrics.per_episode.episode_metrics`."""


@dataclass(frozen=True)
class Store:
    """A cache of measured episodes."""

    cache: Cache

    def key(self, log: Path, scope: Scope) -> str:
        """What the tables of `log` are found by.

        Raises:
            LogError: the log cannot be read.
        """
        asked = json.dumps([scope.unknown_as.value, scope.everywhere])
        try:
            return key_of("metrics", asked, log)
        except OSError as error:
            raise LogError(f"{log}: cannot be read ({error.strerror or error})") from None

    def find(self, key: str) -> Tables | None:
        """The tables, if they are there and whole."""
        content = self.cache.get(key)
        if content is None:
            return None
        try:
            (size,) = _SIZE.unpack_from(content)
            steps, episode = content[_SIZE.size :][:size], content[_SIZE.size + size :]
            return Tables(pl.read_parquet(io.BytesIO(steps)), pl.read_parquet(io.BytesIO(episode)))
        except (OSError, pl.exceptions.PolarsError, struct.error):
            return None

    def keep(self, key: str, tables: Tables) -> None:
        """Write the tables.

        Raises:
            OSError: they cannot be written.
        """
        steps, episode = _packed(tables.steps), _packed(tables.episode)
        self.cache.put(key, _SIZE.pack(len(steps)) + steps + episode)


@contextmanager
def temporary_store() -> Iterator[Store]:
    """A store that is deleted afterwards; without a folder for it, nothing is kept."""
    try:
        folder = tempfile.TemporaryDirectory(prefix="mapreplay-", ignore_cleanup_errors=True)
    except OSError:
        yield Store(Cache(None))
        return
    with folder as name:
        yield Store(Cache(Path(name)))


def _packed(frame: pl.DataFrame) -> bytes:
    file = io.BytesIO()
    frame.write_parquet(file, compression="zstd", compression_level=1)
    return file.getvalue()
