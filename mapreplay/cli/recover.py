"""`mapreplay recover`: finish logs that were cut off or damaged, as far as they can be read."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mapreplay.cli.logs import PathsArgument
from mapreplay.cli.output import LOST, ForceOption, Format, FormatOption, OutputOption, emit, note
from mapreplay.errors import LogError


def recover(
    paths: PathsArgument,
    remove: Annotated[
        bool, typer.Option("--remove", help="Remove the unfinished file when all of it is saved.")
    ] = False,
    form: FormatOption = Format.TABLE,
    output: OutputOption = None,
    force: ForceOption = False,
) -> None:
    """Make finished files of unfinished, cut and damaged logs; exit 3 if steps are missing."""
    import polars as pl

    from mapreplay.recorders.log.find import find_logs
    from mapreplay.recorders.log.recover import recover as recover_log

    rows, failures, lost = [], [], False
    for path in find_logs(paths):
        try:
            saved = recover_log(path, force=force)
        except LogError as error:
            failures.append(str(error))
            continue
        if saved is None:
            note(f"{path}: intact; nothing to do")
            continue
        if saved.damage:
            note(f"stopped at: {saved.damage}")
        missing = "nothing" if saved.whole else f"all after step {saved.steps - 1}"
        lost |= not saved.whole
        rows.append((str(path), str(saved.path), saved.steps, missing))
        if remove and saved.damage:
            note(f"{path}: kept, because it is damaged")
        elif remove:
            _remove(path)
    if failures and not rows:
        raise LogError(failures[0])
    for line in failures:
        note(f"failed: {line}")
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


def _remove(path: Path) -> None:
    try:
        path.unlink()
    except OSError as error:
        raise LogError(f"{path}: cannot be removed ({error.strerror})") from None
