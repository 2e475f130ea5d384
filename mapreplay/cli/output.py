"""Results on stdout: one table, as text, JSON, CSV or Parquet."""

from __future__ import annotations

import io
import json
import math
import shutil
import sys
import tempfile
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path, PurePath
from typing import IO, TYPE_CHECKING, Annotated, Final, TypeAlias

import typer

from mapreplay.errors import UsageError, WriteError
from mapreplay.files.whole import check_new, whole_path, write_whole
from mapreplay.text import one_line, printable, shell_command, shortened

if TYPE_CHECKING:
    import polars as pl


WIDTH: Final = 80
"""Maximum width of a text line in columns."""
_LONGEST: Final = 300
"""Maximum length of a table cell in characters; file names have up to 255."""
LOST = 3
"""Exit code: done, but something was left out or could not be read."""


class Format(StrEnum):
    """How a result is printed."""

    TABLE = "table"
    JSON = "json"
    CSV = "csv"
    PARQUET = "parquet"


_BY_ENDING = {f".{form}": form for form in Format if form is not Format.TABLE}

FormatOption = Annotated[Format, typer.Option("--format", help="Output format.")]
OutputOption = Annotated[
    Path | None, typer.Option("--out", "-o", help="Write the result to this file.")
]
ForceOption = Annotated[bool, typer.Option("--force", help="Overwrite existing files.")]


def emit(
    frame: pl.DataFrame,
    schema: str,
    form: Format,
    output: Path | None = None,
    *,
    text: pl.DataFrame | Shown | None = None,
    force: bool = False,
) -> None:
    """Print `frame`; as text, print `text` instead if given: a narrower table, or tables and lines.

    The ending of `output` (.json, .csv, .parquet) determines the format unless `form` does.

    `schema` names the kind of result and its version, such as ``mapreplay.ls/1``, in JSON.

    Raises:
        UsageError: Parquet to a terminal, or an existing `output` without `force`.
        WriteError: `output`, or stdout, cannot be written.
    """
    form = _resolve(form, output)
    if form is Format.PARQUET:
        buffer = io.BytesIO()
        frame.write_parquet(buffer)
        data = buffer.getvalue()
    elif form is Format.CSV:
        data = _csv(frame, output)
    elif form is Format.JSON:
        data = (_json_head(schema) + ",".join(_json_rows(frame)) + _JSON_TAIL).encode()
    else:
        _deliver_text(frame if text is None else text, output, force=force)
        return
    _deliver([data], output, force=force)


def emit_parts(
    parts: Sequence[pl.LazyFrame],
    schema: str,
    form: Format,
    output: Path | None = None,
    *,
    text: pl.LazyFrame,
    force: bool = False,
) -> None:
    """Like `emit`, for a table that may not fit into memory: prints its `parts` in turn.

    Raises:
        UsageError, WriteError: see `emit`.
    """
    form = _resolve(form, output)
    if form is Format.TABLE:
        _deliver_text(text.collect(), output, force=force)
    elif form is Format.PARQUET:
        if output is not None:
            with whole_path(output, force=force) as draft, draft.open("wb") as file:
                _sink_parquet(parts, file, str(output))
            return
        with tempfile.TemporaryFile() as file:
            _sink_parquet(parts, file, tempfile.gettempdir())
            file.seek(0)
            _deliver(iter(lambda: file.read(1 << 20), b""), None, force=force)
    elif form is Format.CSV:
        frames = (part.collect() for part in parts)
        _deliver(
            (_csv(f, output, head=i == 0) for i, f in enumerate(frames)),
            output,
            force=force,
        )
    else:
        _deliver(_json_parts(parts, schema), output, force=force)


def _sink_parquet(parts: Sequence[pl.LazyFrame], file: IO[bytes], where: str) -> None:
    import polars as pl

    try:
        pl.concat(parts).sink_parquet(file)
    except pl.exceptions.ComputeError as error:  # also of a full disk
        raise WriteError(f"{where}: cannot be written (a full disk? {one_line(error)})") from None


def check_outputs(*paths: Path | None, force: bool) -> None:
    """Refuse outputs that cannot be written or are given twice, before any work is done.

    Raises:
        UsageError: one exists and `force` is not given, or two are the same file.
        WriteError: one cannot be written.
    """
    named = [path for path in paths if path is not None]
    for path in named:
        check_new(path, force=force)
    if twice := [path for path in named if named.count(path) > 1]:
        raise UsageError(f"{twice[0]}: given twice as an output; choose different names")


def _resolve(form: Format, output: Path | None) -> Format:
    """The requested format; by default that of the file's ending.

    Raises:
        UsageError: Parquet to a terminal.
    """
    if output is not None and form is Format.TABLE:
        form = _BY_ENDING.get(output.suffix, form)
    if form is Format.PARQUET and _goes_to_terminal(output):
        raise UsageError("Parquet is binary; write it to a file with -o")
    return form


def _deliver(blocks: Iterable[bytes], output: Path | None, *, force: bool) -> None:
    """Write bytes to stdout or to a file, as they come."""
    if output is not None:
        write_whole(output, blocks, force=force)
        return
    for block in blocks:
        sys.stdout.buffer.write(block)
    sys.stdout.buffer.flush()


def _goes_to_terminal(output: Path | None) -> bool:
    return output is None and sys.stdout.isatty()


def _csv(frame: pl.DataFrame, output: Path | None, *, head: bool = True) -> bytes:
    """CSV as it is; control characters are escaped only where it goes to a terminal."""
    text = frame.write_csv(include_header=head)
    if _goes_to_terminal(output):
        text = "\n".join(map(printable, text.split("\n")))
    return text.encode()


def _deliver_text(text: pl.DataFrame | Shown, output: Path | None, *, force: bool) -> None:
    """Write text to stdout in its encoding, or to a file in UTF-8."""
    shown = _for_people(text, wide=output is not None)
    if output is None:
        print(shown, flush=True)
    else:
        write_whole(output, f"{shown}\n".encode(), force=force)


def note(line: str) -> None:
    """Print a message on stderr, in one line."""
    print(printable(line), file=sys.stderr)


def say(text: str) -> None:
    """Print text on stdout: everything except its line ends is `printable`."""
    print("\n".join(map(printable, text.split("\n"))), flush=True)


def _json_head(schema: str) -> str:
    return f'{{\n "schema": {json.dumps(schema)},\n "rows": ['


_JSON_TAIL: Final = "\n ]\n}\n"


def _json_rows(frame: pl.DataFrame) -> Iterator[str]:
    """Each row as an object on lines of its own."""
    for row in frame.iter_rows(named=True):
        values = {key: _json_value(value) for key, value in row.items()}
        yield "\n" + textwrap.indent(json.dumps(values, indent=1), "  ")


def _json_parts(parts: Iterable[pl.LazyFrame], schema: str) -> Iterator[bytes]:
    yield _json_head(schema).encode()
    separator = ""
    for part in parts:
        for row in _json_rows(part.collect()):
            yield (separator + row).encode()
            separator = ","
    yield _JSON_TAIL.encode()


def _json_value(value: object) -> object:
    return None if isinstance(value, float) and not math.isfinite(value) else value


@dataclass(frozen=True)
class Command:
    """A command line in a text; it is never wrapped, so that it can be copied."""

    words: Sequence[str | PurePath]


Shown: TypeAlias = "Sequence[str | Command | pl.DataFrame]"
"""A text: lines, commands and tables."""


def _for_people(text: pl.DataFrame | Shown, *, wide: bool) -> str:
    """Tables as they are, and lines wrapped to 80 columns."""
    import polars as pl

    blocks = []
    for part in [text] if isinstance(text, pl.DataFrame) else text:
        if isinstance(part, pl.DataFrame):
            blocks.append(_text_table(part, wide=wide))
            continue
        line = (
            shell_command(part.words)
            if isinstance(part, Command)
            else textwrap.fill(
                printable(part),
                WIDTH,
                subsequent_indent="  ",
                break_on_hyphens=False,
                break_long_words=False,
            )
        )
        blocks.append(line)
    return "\n".join(blocks)


def _text_table(frame: pl.DataFrame, *, wide: bool) -> str:
    """A table for 80 columns; text that is the same in every row is printed once, above it."""
    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    same = [
        name
        for name, dtype in frame.schema.items()
        if len(frame) > 1 and not dtype.is_numeric() and frame[name].n_unique() == 1
    ]
    title = ", ".join(f"{_head(name)} {_text_value(frame[name][0])}" for name in same)
    frame = frame.drop(same)
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=0, header_style="bold")
    for name, dtype in frame.schema.items():
        table.add_column(
            Text(_head(name)),
            justify="right" if dtype.is_numeric() else "left",
            overflow="fold",
        )
    for row in frame.iter_rows():
        table.add_row(*(Text(_text_value(value)) for value in row))
    buffer = io.StringIO()
    terminal = sys.stdout.isatty() and not wide
    # A terminal that is narrower breaks the lines: better than letters below each other.
    width = max(shutil.get_terminal_size().columns, WIDTH) if terminal else 200
    console = Console(file=buffer, force_terminal=terminal, width=width, highlight=False)
    if title:
        console.print(Text(title))
    console.print(table)
    lines = [line.rstrip() for line in buffer.getvalue().splitlines()]
    return "\n".join(line for line in lines if line)


def _head(column: str) -> str:
    return _shown(column.replace("_", " "))


def _text_value(value: object) -> str:
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.3f}" if abs(value) < 100 else f"{value:.1f}"
    return _shown(str(value))


def _shown(text: str) -> str:
    """The text of a table cell."""
    return shortened(text, _LONGEST)
