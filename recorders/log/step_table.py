"""The scalars of all steps as a table: the log's Parquet attachment.

A thousand episodes are tabulated from these without opening a grid.
"""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final, TypeAlias

from mapreplay.recorders.log.limits import MAX_ROW_BYTES, TABLE_BYTES
from mapreplay.recorders.log.parquet import check_pages
from mapreplay.step import Step, StepMetrics

if TYPE_CHECKING:
    import polars as pl

ATTACHMENT: Final = "steps.parquet"
MEDIA_TYPE: Final = "application/vnd.apache.parquet"

Row: TypeAlias = tuple[int | float | str | None, ...]


def row_of(step: Step) -> Row:
    """The scalars of a step, in the order of the table's columns; NaN becomes None."""
    decision = step.decision
    target = decision.target if decision else (None, None)
    utility = decision.chosen.utility if decision else None
    scores = [getattr(step.metrics, name) for name in StepMetrics.names()]
    reals = [None if x is None or math.isnan(x) else float(x) for x in (utility, *scores)]
    return (step.index, *step.agent, str(step.mode), *target, *reals)


def table_of(rows: Sequence[Row]) -> pl.DataFrame:
    """One row a step: step, row, col, mode, target_row, target_col, utility, all metrics.

    Cells and the step are Int32, the mode a String, the rest Float64. What is undefined, and
    the target of a step without a decision, is null.
    """
    import polars as pl

    schema = {
        "step": pl.Int32,
        "row": pl.Int32,
        "col": pl.Int32,
        "mode": pl.String,
        "target_row": pl.Int32,
        "target_col": pl.Int32,
        "utility": pl.Float64,
    } | dict.fromkeys(StepMetrics.names(), pl.Float64)
    return pl.DataFrame(rows, schema=schema, orient="row")


def to_parquet(table: pl.DataFrame) -> bytes:
    """The table as a Parquet file."""
    file = io.BytesIO()
    table.write_parquet(file, compression="zstd", compression_level=9, statistics=False)
    return file.getvalue()


def from_parquet(data: bytes, rows: int) -> pl.DataFrame:
    """The inverse of `to_parquet`, for a table of `rows` rows.

    Raises:
        ValueError, LookupError, TypeError: the bytes are not a Parquet file of that many rows
            with our columns, or unpack to more than those need.
    """
    import polars as pl

    check_pages(data, rows, TABLE_BYTES + rows * MAX_ROW_BYTES)
    try:
        table = pl.read_parquet(io.BytesIO(data))
    except pl.exceptions.PolarsError as error:
        raise ValueError(f"{ATTACHMENT}: {error}") from None
    if table.schema != table_of([]).schema:
        raise ValueError(f"{ATTACHMENT} has other columns than a table of steps")
    return table
