"""An episode in one row: what was run, how it ended, and its last scores."""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, Final

import polars as pl

from mapreplay.analysis.episodes.curves import first_reached, mapping_time
from mapreplay.config import MapKind
from mapreplay.errors import UsageError
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.recorders.log.state import by_step
from mapreplay.step import Mode
from mapreplay.text import printable

UNFINISHED: Final = "unfinished"
WIDTH: Final = 16
"""Characters of a floor-plan id that a text table shows."""


@dataclass(frozen=True)
class EpisodeRow:
    """One row of `mapreplay ls`. Scores are those of the last step; NaN where undefined."""

    file: str
    floor_plan: str
    planner: str
    predictor: str
    plan_on: str
    build: str
    fail_safe: bool
    seed: int
    start_row: int
    start_col: int
    max_steps: int
    outcome: str
    """mapped, sealed_in, out_of_steps or unfinished."""
    steps: int
    """Moves made."""
    mapping_time: int | None
    """See `mapreplay.analysis.episodes.curves.mapping_time`."""
    correct_time: int | None
    """First step at which its correct coverage reached `correct_coverage`."""
    path_length: float
    """Metres."""
    coverage: float
    """Of the built map, like the next two."""
    correct: float
    f1: float
    fail_safe_steps: int
    """Steps planned in fail-safe mode."""
    branch: str = ""
    """Of an episode that was run on from a step of another: "23: planner=nearest"; else empty."""


def episode_row(path: Path) -> EpisodeRow:
    """Summarize the log at `path`, finished or not, from its scalars.

    Raises:
        LogError: it cannot be read.
    """
    return row_of_log(EpisodeLog(path), printable(str(path)))


def row_of_log(log: EpisodeLog, file: str) -> EpisodeRow:
    """Summarize an open log; `file` is what the row calls it."""
    config, table = log.header.config, log.table()
    # An episode that was killed early may have no complete step.
    last = dict.fromkeys(table.columns) if table.is_empty() else table.row(-1, named=True)
    suffix = "observed" if config.build is MapKind.OBSERVED else "fused"
    # Series and their NumPy arrays: a data-frame query takes longer than all the rest.
    steps = table["step"].to_numpy()
    known = by_step(steps, table[f"coverage_{suffix}"].to_numpy())
    right = by_step(steps, table[f"correct_coverage_{suffix}"].to_numpy())
    outcome, branch = str(log.outcome or UNFINISHED), log.header.branch
    return EpisodeRow(
        file=file,
        floor_plan=log.header.floor_plan.id,
        planner=config.planner,
        predictor=log.header.predictor.name,
        plan_on=config.plan_on,
        build=config.build,
        fail_safe=config.fail_safe,
        seed=config.seed,
        start_row=log.header.start.row,
        start_col=log.header.start.col,
        max_steps=log.header.max_steps,
        outcome=outcome,
        steps=last["step"] or 0,
        mapping_time=mapping_time(known, config.coverage, outcome),
        correct_time=first_reached(right, config.correct_coverage),
        path_length=_real(last["path_length"]),
        coverage=_real(last[f"coverage_{suffix}"]),
        correct=_real(last[f"correct_coverage_{suffix}"]),
        f1=_real(last["f1"]),
        fail_safe_steps=int((table["mode"] == Mode.FAIL_SAFE.value).sum()),
        branch=f"{branch.step}: {', '.join(branch.changes)}" if branch else "",
    )


def _real(value: float | None) -> float:
    return float("nan") if value is None else value


_DTYPES: Final = {
    "str": pl.String, "bool": pl.Boolean, "int": pl.Int64, "int | None": pl.Int64,
    "float": pl.Float64,
}  # fmt: skip


def episode_frame(rows: Sequence[EpisodeRow]) -> pl.DataFrame:
    """The rows as a data frame with the same columns even when it is empty."""
    schema = {f.name: _DTYPES[str(f.type)] for f in fields(EpisodeRow)}
    return pl.DataFrame([asdict(row) for row in rows], schema=schema)


def brief(frame: pl.DataFrame) -> pl.DataFrame:
    """What a person wants to see of an episode frame, narrow enough for a terminal.

    Long floor-plan ids are cut; where the agent plans on the map that it builds, that map is
    named once.
    """
    return frame.select(
        pl.when(pl.col("floor_plan").str.len_chars() > WIDTH)
        .then(pl.col("floor_plan").str.slice(0, WIDTH - 1) + "…")
        .otherwise("floor_plan")
        .alias("floor_plan"),
        "planner",
        pl.when(pl.col("plan_on") == pl.col("build"))
        .then("plan_on")
        .otherwise(pl.format("{}/{}", "plan_on", "build"))
        .alias("maps"),
        "outcome",
        "steps",
        pl.col("path_length").fill_nan(None).round().cast(pl.Int64).alias("path_m"),
        pl.col("coverage").alias("cover"),
        "correct",
        "f1",
    )


_OPERATORS: Final[dict[str, Callable[[Any, Any], bool]]] = {
    "=": operator.eq, "!=": operator.ne, "<": operator.lt, "<=": operator.le,
    ">": operator.gt, ">=": operator.ge,
}  # fmt: skip
_CONDITION: Final = re.compile(r"\s*(\w+)\s*(!=|<=|>=|=|<|>)\s*(.*?)\s*")


@dataclass(frozen=True)
class RowFilter:
    """A condition on a row, such as ``outcome=sealed_in`` or ``steps>300``."""

    column: str
    sign: str
    value: str

    @classmethod
    def parse(cls, text: str) -> RowFilter:
        """Read ``column OP value`` with OP one of = != < <= > >=.

        Raises:
            UsageError: it is not of this form, or there is no such column.
        """
        match = _CONDITION.fullmatch(text)
        if not match:
            raise UsageError(f"--where {text}: expected column=value, like outcome=sealed_in")
        names = [f.name for f in fields(EpisodeRow)]
        if match[1] not in names:
            raise UsageError(
                f"--where {text}: no column {match[1]!r}; there are {', '.join(names)}"
            )
        return cls(match[1], match[2], match[3])

    def holds(self, row: EpisodeRow) -> bool:
        """Whether `row` satisfies it; a value that is not there satisfies only ``!=``.

        Raises:
            UsageError: a number was compared with something that is none.
        """
        actual = getattr(row, self.column)
        if actual is None or actual != actual:  # None or NaN
            return self.sign == "!="
        if isinstance(actual, bool):
            wanted: object = self.value.lower() in ("true", "yes", "1")
        elif isinstance(actual, (int, float)):
            try:
                wanted = float(self.value)
            except ValueError:
                raise UsageError(f"--where {self.column}: {self.value!r} is no number") from None
        else:
            wanted = self.value
        return _OPERATORS[self.sign](actual, wanted)
