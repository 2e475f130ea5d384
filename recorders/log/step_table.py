"""The scalars of all steps as a table: the log's Parquet attachment.

A thousand episodes are tabulated from these without opening a grid.
"""

from __future__ import annotations

import io
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import numpy as np
import numpy.typing as npt

from mapreplay.recorders.log.codec import check_scores
from mapreplay.recorders.log.header import EpisodeSummary
from mapreplay.recorders.log.limits import MAX_ROW_BYTES, TABLE_BYTES
from mapreplay.recorders.log.parquet import Column, Kind, read_columns
from mapreplay.step import EpisodeHeader, Mode, Step, StepMetrics

if TYPE_CHECKING:
    import polars as pl

ATTACHMENT: Final = "steps.parquet"
MEDIA_TYPE: Final = "application/vnd.apache.parquet"

TableRow: TypeAlias = tuple[int | float | str | None, ...]


def row_of(step: Step) -> TableRow:
    """The scalars of a step, in the order of the table's columns; NaN becomes None."""
    decision = step.decision
    target = decision.target if decision else (None, None)
    utility = decision.chosen.utility if decision else None
    scores = [getattr(step.metrics, name) for name in StepMetrics.names()]
    reals = [None if x is None or math.isnan(x) else float(x) for x in (utility, *scores)]
    return (step.index, *step.agent, str(step.mode), *target, *reals)


_KINDS: Final = {
    "step": Kind.INT32,
    "row": Kind.INT32,
    "col": Kind.INT32,
    "mode": Kind.TEXT,
    "target_row": Kind.INT32,
    "target_col": Kind.INT32,
    "utility": Kind.FLOAT64,
} | dict.fromkeys(StepMetrics.names(), Kind.FLOAT64)
"""What is in each column."""


def _schema() -> dict[str, type[pl.DataType]]:
    import polars as pl

    dtypes = {Kind.INT32: pl.Int32, Kind.FLOAT64: pl.Float64, Kind.TEXT: pl.String}
    return {name: dtypes[kind] for name, kind in _KINDS.items()}


def table_of(rows: Sequence[TableRow]) -> pl.DataFrame:
    """One row a step: step, row, col, mode, target_row, target_col, utility, all metrics.

    Cells and the step are Int32, the mode a String, the rest Float64. What is undefined, and
    the target of a step without a decision, is null.
    """
    import polars as pl

    return pl.DataFrame(rows, schema=_schema(), orient="row")


def to_parquet(table: pl.DataFrame) -> bytes:
    """The table as a Parquet file."""
    file = io.BytesIO()
    table.write_parquet(file, compression="zstd", compression_level=9, statistics=False)
    return file.getvalue()


def from_parquet(data: bytes, steps: Sequence[int]) -> pl.DataFrame:
    """The inverse of `to_parquet`, for a table of the steps of these numbers.

    Raises:
        UnknownParquetError: the bytes may be a Parquet file, but not one of `to_parquet`.
        ValueError: they are damaged, are of other steps, have values that no step has, or unpack
            to more than those need.
    """
    import polars as pl

    rows = len(steps)
    columns = read_columns(data, _KINDS, rows, TABLE_BYTES + rows * MAX_ROW_BYTES)
    _check(columns, steps)
    schema = _schema()
    return pl.DataFrame(
        [pl.Series(name, _items(column), schema[name]) for name, column in columns.items()]
    )


def check_end(
    table: pl.DataFrame, last: Step | None, summary: EpisodeSummary, header: EpisodeHeader
) -> None:
    """Whether a table of all steps ends as the log does.

    Args:
        table: See `table_of`; not empty.
        last: The last step; None of a log without steps.
        summary: How the episode ended, as the log says it.
        header: What the log says once.

    Raises:
        ValueError: it does not, so that it is the table of another log, or was changed.
    """
    if last is not None and table.row(-1) != row_of(last):
        raise ValueError(f"{ATTACHMENT} has another last step than the log")
    if last is None and table["path_length"].item(-1) != summary.path_length:
        raise ValueError(f"{ATTACHMENT} has another path than the log")
    # Column by column: a query of the data frame takes longer than all the rest.
    scores = np.stack([table[name].to_numpy() for name in StepMetrics.names()])
    check_scores(scores, len(table), header.floor_plan)
    config = header.config
    built, steps = config.build.value, table["step"].to_numpy()
    told = {
        "mapping time": (summary.mapping_time, f"coverage_{built}", config.coverage),
        "correct time": (
            summary.correct_time, f"correct_coverage_{built}", config.correct_coverage,
        ),
    }  # fmt: skip
    for what, (time, column, target) in told.items():
        reached = np.flatnonzero(table[column].to_numpy() >= target)
        if (int(steps[reached[0]]) if len(reached) else None) != time:
            raise ValueError(f"{ATTACHMENT} has another {what} than the log")


def _items(column: Column) -> npt.NDArray[Any] | list[Any]:
    """The values with None where there is none, in a form that is quick to make a Series of."""
    values, present = column
    if values.dtype != object and present.all():
        return values
    return [x if there else None for x, there in zip(values.tolist(), present, strict=True)]


def _check(columns: Mapping[str, Column], steps: Sequence[int]) -> None:
    """Whether the rows are those of steps at all.

    Raises:
        ValueError: they are not.
    """
    for name in ("step", "row", "col", "mode"):
        if not columns[name].present.all():
            raise ValueError(f"{ATTACHMENT} has a step without {name}")
    if not np.array_equal(columns["step"].values, steps):
        raise ValueError(f"{ATTACHMENT} is not of the steps that there are")
    if not set(columns["mode"].values.tolist()) <= set(Mode):
        raise ValueError(f"{ATTACHMENT} has a step of an unknown mode")
    for name, kind in _KINDS.items():
        if kind is Kind.FLOAT64 and np.isnan(columns[name].values).any():
            raise ValueError(f"{ATTACHMENT} has a {name} that is no number")
