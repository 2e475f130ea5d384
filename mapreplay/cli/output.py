"""Results on stdout: one table, as text for people or as JSON, CSV or Parquet for programs."""

from __future__ import annotations

import io
import json
import math
import sys
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mapreplay.errors import MapreplayError, UsageError

if TYPE_CHECKING:
    import polars as pl


LOST = 3
"""Exit code: done, but something was lost or could not be read."""


class Format(StrEnum):
    """How a result is printed."""

    TABLE = "table"
    JSON = "json"
    CSV = "csv"
    PARQUET = "parquet"


_BY_ENDING = {f".{form}": form for form in Format if form is not Format.TABLE}

FormatOption = Annotated[Format, typer.Option("--format", help="How to print the result.")]
OutputOption = Annotated[
    Path | None, typer.Option("--output", "-o", help="Write the result to this file.")
]
ForceOption = Annotated[bool, typer.Option("--force", help="Overwrite what is there.")]


def emit(
    frame: pl.DataFrame,
    schema: str,
    form: Format,
    output: Path | None = None,
    *,
    text: pl.DataFrame | None = None,
    force: bool = False,
) -> None:
    """Print `frame`; as a text table, `text` in its place, if that is given.

    The ending of `output` (.json, .csv, .parquet) says its format unless `form` does.

    `schema` names the kind of result and its version, such as ``mapreplay.ls/1``, in JSON.

    Raises:
        UsageError: Parquet to a terminal, or an existing `output` without `force`.
        MapreplayError: `output` cannot be written.
    """
    if output is not None and form is Format.TABLE:
        form = _BY_ENDING.get(output.suffix, form)
    if form is Format.PARQUET and output is None and sys.stdout.isatty():
        raise UsageError("Parquet is binary: name a file with -o")
    if form is Format.PARQUET:
        buffer = io.BytesIO()
        frame.write_parquet(buffer)
        data = buffer.getvalue()
    elif form is Format.CSV:
        data = frame.write_csv().encode()
    elif form is Format.JSON:
        rows = [{key: _json_value(value) for key, value in row.items()} for row in frame.to_dicts()]
        data = (json.dumps({"schema": schema, "rows": rows}, indent=1) + "\n").encode()
    else:
        data = _text_table(frame if text is None else text, wide=output is not None)
    if output is None:
        sys.stdout.buffer.write(data)
        sys.stdout.buffer.flush()
    else:
        write_file(output, data, force=force)


def write_file(path: Path, data: bytes, *, force: bool) -> None:
    """Write a whole new file.

    Raises:
        UsageError: it is there, and `force` was not given.
        MapreplayError: it cannot be written.
    """
    try:
        with path.open("wb" if force else "xb") as file:
            file.write(data)
    except FileExistsError:
        raise UsageError(f"{path} exists; choose another name, or --force") from None
    except OSError as error:
        raise MapreplayError(f"{path}: cannot be written ({error.strerror})") from None


def note(line: str) -> None:
    """Say something beside the result, on stderr."""
    typer.echo(line, err=True)


def _json_value(value: object) -> object:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _text_table(frame: pl.DataFrame, *, wide: bool) -> bytes:
    """A table for 80 columns: text that is the same in every row is said once, above it."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    same = [
        name
        for name, dtype in frame.schema.items()
        if len(frame) > 1 and not dtype.is_numeric() and frame[name].n_unique() == 1
    ]
    title = ", ".join(f"{name.replace('_', ' ')} {_text_value(frame[name][0])}" for name in same)
    frame = frame.drop(same)
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=0, header_style="bold")
    for name, dtype in frame.schema.items():
        table.add_column(
            name.replace("_", " "),
            justify="right" if dtype.is_numeric() else "left",
            overflow="fold",
        )
    for row in frame.iter_rows():
        table.add_row(*map(_text_value, row))
    buffer = io.StringIO()
    terminal = sys.stdout.isatty() and not wide
    console = Console(
        file=buffer, force_terminal=terminal, width=None if terminal else 200, highlight=False
    )
    if title:
        console.print(title)
    console.print(table)
    lines = [line.rstrip() for line in buffer.getvalue().splitlines()]
    return "\n".join(line for line in lines if line).encode() + b"\n"


def _text_value(value: object) -> str:
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.3f}" if abs(value) < 100 else f"{value:.1f}"
    return str(value)
