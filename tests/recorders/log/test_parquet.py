"""Tables of steps as Parquet: what Polars writes and reads is the oracle, and damage is refused."""

import io
import random
from collections.abc import Callable
from contextlib import suppress

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapreplay.recorders.log import step_table
from mapreplay.recorders.log.parquet import UnknownParquetError
from mapreplay.step import Mode

INT32 = st.none() | st.integers(-(2**31), 2**31 - 1)
SMALL = st.none() | st.integers(0, 3)
REAL = st.none() | st.floats(allow_nan=False)
FEW = st.none() | st.sampled_from([0.0, -0.0, 0.5, 1 / 3])


@st.composite
def tables(draw: st.DrawFn) -> pl.DataFrame:
    """Tables of steps with any numbers, with few and with many different ones in a column."""
    count = draw(st.integers(0, 40))
    columns: dict[str, object] = {}
    for name, dtype in step_table.table_of([]).schema.items():
        values: st.SearchStrategy[object]
        if name == "step":
            columns[name] = list(range(count))
            continue
        if name == "mode":
            values = st.sampled_from([str(mode) for mode in Mode])
        elif name in ("row", "col"):
            values = st.integers(0, 4095)
        else:
            values = draw(st.sampled_from([INT32, SMALL] if dtype == pl.Int32 else [REAL, FEW]))
        columns[name] = draw(st.lists(values, min_size=count, max_size=count))
    return pl.DataFrame(columns, schema=step_table.table_of([]).schema)


def some_table(rows: int, seed: int = 1) -> pl.DataFrame:
    """Columns without any value, with few different ones, and with as many as rows."""
    draw = np.random.default_rng(seed)
    columns: dict[str, object] = {}
    for k, (name, dtype) in enumerate(step_table.table_of([]).schema.items()):
        if name == "step":
            columns[name] = np.arange(rows, dtype=np.int32)
        elif name == "mode":
            columns[name] = ["fail-safe" if k % 7 == 0 else "normal" for k in range(rows)]
        elif name in ("row", "col"):
            columns[name] = draw.integers(0, 50, rows)
        elif dtype == pl.Int32:
            columns[name] = [*range(rows - 1), None] if rows else []
        elif k % 3 == 0:
            columns[name] = [None] * rows
        else:
            columns[name] = draw.random(rows).round(1) if k % 3 == 1 else draw.random(rows)
    return pl.DataFrame(columns, schema=step_table.table_of([]).schema)


def written(frame: pl.DataFrame, **options: object) -> bytes:
    file = io.BytesIO()
    frame.write_parquet(file, **{"compression": "zstd", "statistics": False} | options)  # type: ignore[arg-type]
    return file.getvalue()


@settings(max_examples=30)
@given(tables())
def test_a_table_is_read_as_polars_reads_it(frame: pl.DataFrame) -> None:
    data = step_table.to_parquet(frame)
    assert step_table.from_parquet(data, range(len(frame))).equals(frame)
    assert pl.read_parquet(io.BytesIO(data)).equals(frame)


@pytest.mark.parametrize(
    "options",
    [{}, {"statistics": True}, {"row_group_size": 100}, {"data_page_size": 500},
     {"row_group_size": 700, "data_page_size": 64, "compression_level": 19}],
)  # fmt: skip
@pytest.mark.parametrize("rows", [0, 1, 9, 2000])
def test_groups_and_pages_may_be_of_any_size(rows: int, options: dict[str, object]) -> None:
    frame = some_table(rows)
    assert step_table.from_parquet(written(frame, **options), range(rows)).equals(frame)


@pytest.mark.parametrize("compression", ["uncompressed", "snappy", "lz4", "gzip"])
def test_what_is_compressed_in_another_way_is_not_called_damaged(compression: str) -> None:
    with pytest.raises(UnknownParquetError):
        step_table.from_parquet(written(some_table(20), compression=compression), range(20))


@pytest.mark.parametrize(
    "change",
    [
        lambda frame: frame.drop("f1"),
        lambda frame: frame.select(reversed(frame.columns)),
        lambda frame: frame.with_columns(pl.col("f1").cast(pl.Float32)),
        lambda frame: frame.with_columns(pl.col("row").cast(pl.Int64)),
        lambda frame: frame.with_columns(pl.struct("f1").alias("f1")),
        lambda frame: frame.with_columns(pl.lit(1).alias("more")),
    ],
)
def test_other_columns_are_not_called_damaged(change: Callable[[pl.DataFrame], object]) -> None:
    other = change(some_table(20))
    assert isinstance(other, pl.DataFrame)
    with pytest.raises(UnknownParquetError):
        step_table.from_parquet(written(other), range(20))


@pytest.mark.parametrize(
    ("column", "value", "reason"),
    [
        ("step", pl.col("step") + 1, "not of the steps that there are"),
        ("row", pl.lit(None, pl.Int32), "without row"),
        ("mode", pl.lit("upside-down"), "an unknown mode"),
        ("f1", pl.lit(float("nan")), "a f1 that is no number"),
    ],
)
def test_rows_that_no_step_has_are_refused(column: str, value: pl.Expr, reason: str) -> None:
    frame = some_table(20).with_columns(value.alias(column))
    with pytest.raises(ValueError, match=reason):
        step_table.from_parquet(written(frame), range(20))


def flipped(data: bytes, place: int, bit: int) -> bytes:
    changed = bytearray(data)
    changed[place] ^= 1 << bit
    return bytes(changed)


def read_flipped(data: bytes, rows: int, place: int, bit: int) -> None:
    with suppress(ValueError):  # a number may be any number
        frame = step_table.from_parquet(flipped(data, place, bit), range(rows))
        assert frame.schema == step_table.table_of([]).schema
        assert len(frame) == rows


def test_a_flipped_bit_is_an_error_or_another_number() -> None:
    data = step_table.to_parquet(some_table(9))
    draw = random.Random(1)
    for _ in range(400):
        read_flipped(data, 9, draw.randrange(len(data)), draw.randrange(8))


@pytest.mark.slow
def test_every_flipped_bit_is_an_error_or_another_number() -> None:
    for rows in (2, 300):
        data = step_table.to_parquet(some_table(rows))
        for place in range(len(data)):
            for bit in range(8):
                read_flipped(data, rows, place, bit)


def test_spliced_and_cut_tables_are_errors_or_other_numbers() -> None:
    data, draw = step_table.to_parquet(some_table(9)), random.Random(2)
    for _ in range(150):
        a, b = sorted(draw.randrange(len(data)) for _ in range(2))
        c = draw.randrange(len(data))
        for changed in (data[:a] + data[b:], data[:b] + data[a:], data[:c] + draw.randbytes(9) +
                        data[c + 9:], data[:c], data[c:]):  # fmt: skip
            with suppress(ValueError):
                assert len(step_table.from_parquet(changed, range(9))) == 9
