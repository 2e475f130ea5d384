"""`mapreplay bundle`: pack what a colleague needs to reproduce one failure."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mapreplay.cli.logs import LogArgument, end_with, open_log
from mapreplay.cli.output import ForceOption, check_outputs, note
from mapreplay.errors import UsageError
from mapreplay.files import write_whole

LARGE = 2 << 20
"""Bytes that are too many to be mailed."""


def bundle(
    log: LogArgument,
    output: Annotated[
        Path | None, typer.Option("--out", "-o", help="The zip (default: beside LOG).")
    ] = None,
    until: Annotated[
        int | None, typer.Option(metavar="STEP", help="Only the steps up to this one.")
    ] = None,
    force: ForceOption = False,
) -> None:
    """Pack a log with its diagnosis, in words, as JSON and as a picture, into one zip.

    A manifest has the hash of everything; the same log gives the same bytes. A part of a log
    starts at step 0, like every log that can be verified: there is no window in its middle.
    """
    from mapreplay.analysis.bundling import make_bundle

    opened = open_log(log)
    name = opened.path.name.removesuffix(".part").removesuffix(".mcap")
    path = output or opened.path.with_name(f"{name}.zip")
    if path.suffix != ".zip":
        raise UsageError(f"-o {path}: a bundle's name ends in .zip")
    check_outputs(path, force=force)
    made = make_bundle(opened, until)
    write_whole(path, made.data, force=force)
    part = "" if made.whole else " (a part of the log)"
    note(f"written: {path}, {len(made.data) / 1000:.0f} kB, {made.steps} steps{part}")
    if len(made.data) > LARGE:
        note("that is more than 2 MB: pack the steps up to the sealing with --until STEP")
    end_with([opened])
