"""`mapreplay bundle`: pack what a colleague needs to reproduce one failure."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mapreplay.cli.logs import LogArgument, end_with, open_log
from mapreplay.cli.output import ForceOption, check_outputs, note
from mapreplay.errors import UsageError
from mapreplay.files.whole import write_whole

LARGE = 2 << 20
"""Size in bytes above which a bundle is too large for an e-mail."""


def bundle(
    log: LogArgument,
    output: Annotated[
        Path | None, typer.Option("--out", "-o", help="Zip file to write (default: next to LOG).")
    ] = None,
    until: Annotated[
        int | None, typer.Option(metavar="STEP", help="Last step to include (default: all steps).")
    ] = None,
    force: ForceOption = False,
) -> None:
    """Pack a log and its diagnosis (text, JSON and picture) into one zip file.

    A manifest has the hash of every file; the same log gives the same bytes. With --until the
    bundle has the steps from 0 up to that one, so that it can be verified like every log.
    """
    from mapreplay.analysis.bundling import bundle

    opened = open_log(log)
    name = opened.path.name.removesuffix(".part").removesuffix(".mcap")
    path = output or opened.path.with_name(f"{name}.zip")
    if path.suffix != ".zip":
        raise UsageError(f"-o {path}: a bundle's name ends in .zip")
    check_outputs(path, force=force)
    made = bundle(opened, until)
    write_whole(path, made.data, force=force)
    part = "" if made.whole else " (a part of the log)"
    note(f"written: {path}, {len(made.data) / 1000:.0f} kB, {made.steps} steps{part}")
    if len(made.data) > LARGE:
        note("larger than 2 MB; use --until STEP to pack only the steps up to the sealing")
    end_with([opened])
