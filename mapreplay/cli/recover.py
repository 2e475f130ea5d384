"""`mapreplay recover`: finish logs that were cut off or damaged, as far as they can be read."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from mapreplay.cli.logs import PathsArgument
from mapreplay.cli.output import (
    LOST,
    ForceOption,
    Format,
    FormatOption,
    OutputOption,
    check_outputs,
    emit,
    note,
)
from mapreplay.errors import LogError, MapreplayError
from mapreplay.text import printable

if TYPE_CHECKING:
    from mapreplay.recorders.log.recover import Recovered

SHOWN: Final = 5
"""Lines on what is damaged in a log."""


def recover(
    paths: PathsArgument,
    remove: Annotated[
        bool,
        typer.Option(
            "--remove", help="Remove the unfinished file after everything in it was recovered."
        ),
    ] = False,
    form: FormatOption = Format.TABLE,
    output: OutputOption = None,
    force: ForceOption = False,
) -> None:
    """Recover unfinished, truncated and damaged logs; exit with 3 if anything is missing.

    Every readable step is kept under its number, also after damage. LOG is not changed.
    """
    check_outputs(output, force=force)
    import polars as pl

    from mapreplay.recorders.log.find import find_logs
    from mapreplay.recorders.log.recover import recover as recover_log

    rows, failures, lost = [], list[MapreplayError](), False
    intact = False
    for path in find_logs(paths):
        try:
            saved = recover_log(path, force=force)
        except MapreplayError as error:
            failures.append(error)
            continue
        if saved is None:
            note(f"{path}: intact; nothing to do")
            intact = True
            continue
        for line in saved.damages[:SHOWN]:
            note(f"{path}: damaged: {line}")
        if len(saved.damages) > SHOWN:
            note(f"{path}: and {len(saved.damages) - SHOWN} more")
        if saved.tail is not None:
            note(f"{path}: {saved.tail}")
        lost |= not saved.whole or saved.tail is not None
        rows.append(
            (printable(str(path)), printable(str(saved.path)), saved.steps, _missing(saved))
        )
        if remove and (saved.damages or saved.tail):
            note(f"{path}: kept, because not all of it could be read")
        elif remove:
            _remove(path)
    if failures and not rows and not intact:
        raise failures[0]
    for failure in failures:
        note(f"failed: {failure}")
    if rows:
        schema = {
            "file": pl.String,
            "recovered": pl.String,
            "steps": pl.Int64,
            "missing": pl.String,
        }
        frame = pl.DataFrame(rows, schema=schema, orient="row")
        emit(frame, "mapreplay.recover/1", form, output, force=force)
    if failures or lost:
        raise typer.Exit(LOST)


def _missing(saved: Recovered) -> str:
    """What is not in the new file, in words."""
    from mapreplay.recorders.log.state import span_words

    said = []
    if saved.missing:
        said.append(span_words(saved.missing).removesuffix(" are").removesuffix(" is"))
    if saved.outcome is None:
        said.append(f"all after step {saved.last}")
    return ", ".join(said) or "nothing"


def _remove(path: Path) -> None:
    try:
        path.unlink()
    except OSError as error:
        raise LogError(f"{path}: cannot be removed ({error.strerror})") from None
