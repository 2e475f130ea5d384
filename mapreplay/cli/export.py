"""`mapreplay export`: a log's arrays as npz, its maps as PNG."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mapreplay.cli.logs import LogArgument, end_with, open_log
from mapreplay.cli.output import ForceOption, note
from mapreplay.errors import UsageError


def export(
    log: LogArgument,
    npz: Annotated[Path | None, typer.Option(help="Write all arrays to this .npz file.")] = None,
    png: Annotated[Path | None, typer.Option(help="Write the maps to this folder.")] = None,
    step: Annotated[
        list[int] | None,
        typer.Option(help="Step to draw; -1 is the last (default); can be repeated."),
    ] = None,
    scale: Annotated[int, typer.Option(min=1, max=64, help="Pixels per cell.")] = 8,
    force: ForceOption = False,
) -> None:
    """Write a log's arrays as npz and its maps as PNG."""
    if npz is None and png is None:
        raise UsageError("export: say what to write: --npz FILE, --png FOLDER, or both")
    from mapreplay.recorders.export import export_arrays, export_images

    opened = open_log(log)
    if npz is not None:
        export_arrays(opened, npz, force=force)
        note(f"written: {npz}")
    if png is not None:
        count = opened.last + 1
        steps = []
        for wanted in step or [-1]:
            if not -count <= wanted < count:
                raise UsageError(f"--step {wanted}: {opened.path} has steps 0 to {count - 1}")
            steps.append(wanted % count)
        for path in export_images(opened, png, steps, scale, force=force):
            note(f"written: {path}")
    end_with([opened])
