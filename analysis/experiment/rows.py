"""What is kept of an episode of an experiment: one row, one line of a file that only grows."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, Final

from mapreplay.errors import MapreplayError
from mapreplay.files import cannot_write, check_new
from mapreplay.recorders.log.lock import lock

ROWS_FILE: Final = "rows.jsonl"


@dataclass(frozen=True)
class Row:
    """One episode. Scores are those of the built map at its last step; NaN where undefined."""

    dataset: str
    floor_plan: str
    planner: str
    plan_on: str
    build: str
    fail_safe: bool
    seed: int
    predictor: str
    sha256: str
    """Of the predictor's weights; empty if it has none."""
    outcome: str
    """mapped, sealed_in or out_of_steps."""
    steps: int
    budget: int
    """Moves that were allowed."""
    mapping_time: int | None
    """First step at which the built map reached the target coverage."""
    correct_time: int | None
    """First step at which its correct coverage reached 95 %."""
    path_length: float
    """Metres."""
    f1: float
    precision: float
    recall: float
    coverage: float
    correct: float
    """Correct coverage."""
    sealed_step: int | None
    """First step at which the fused map had no frontier within reach."""
    fail_safe_steps: int
    seconds: float
    """CPU time."""
    digest: str = ""
    """Of all that the episode depends on: configuration, floor plan, weights and code. Empty in
    rows of versions that did not write it."""

    @property
    def key(self) -> tuple[str | bool | int, ...]:
        """What it is a row of, to sort by: rows are on disk in the order in which they ended."""
        return (
            self.dataset, self.floor_plan, self.planner, self.plan_on, self.build, self.fail_safe,
            self.seed, self.predictor, self.sha256,
        )  # fmt: skip

    def to_json(self) -> str:
        """One line of JSON; NaN is null."""
        values = {
            key: None if isinstance(value, float) and math.isnan(value) else value
            for key, value in asdict(self).items()
        }
        return json.dumps(values)

    @classmethod
    def from_json(cls, line: str) -> Row:
        """Read one line.

        Raises:
            ValueError: it is not JSON, or its keys are not those of a row.
        """
        values: Any = json.loads(line)
        known = {f.name for f in fields(cls)}
        if not isinstance(values, dict) or set(values) | {"digest"} != known:
            raise ValueError("not a row of an experiment")
        for name in _REALS:
            values[name] = math.nan if values[name] is None else float(values[name])
        return cls(**values)


_REALS: Final = tuple(f.name for f in fields(Row) if f.type == "float")


class RowFile:
    """Rows on disk: each is durable once `append` returns; a torn last line is cut off."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def read(self) -> list[Row]:
        """All whole rows.

        Raises:
            MapreplayError: a line that is not the last one is damaged.
        """
        return list(self._rows())

    def _rows(self) -> Iterator[Row]:
        if not self.path.exists():
            return
        text = self.path.read_text(encoding="utf-8", errors="replace")
        for number, line in enumerate(text.split("\n")[:-1], start=1):
            try:
                yield Row.from_json(line)
            except (ValueError, TypeError) as error:
                raise MapreplayError(f"{self.path}, line {number}: damaged ({error})") from None

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Nobody else may add rows meanwhile; the lock is gone when its process is.

        Raises:
            MapreplayError: somebody else has it.
            ExistsError, WriteError: it is no regular file, or cannot be written.
        """
        check_new(self.path, force=True)
        try:
            file = self.path.open("ab")
        except OSError as error:
            raise cannot_write(self.path, error) from None
        with file:
            if not lock(file):
                raise MapreplayError(f"{self.path}: another process is writing it")
            yield

    def repair(self) -> None:
        """Cut off what a kill left of a line, so that the next row starts a line of its own."""
        if self.path.exists():
            with self.path.open("r+b") as file:
                file.truncate(file.read().rfind(b"\n") + 1)

    def append(self, row: Row) -> None:
        """Add a row and wait until it is on the disk.

        Raises:
            MapreplayError: it cannot be written.
        """
        try:
            with self.path.open("a", encoding="utf-8") as file:
                file.write(row.to_json() + "\n")
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise cannot_write(self.path, error) from None
