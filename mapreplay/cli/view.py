"""`mapreplay view`: replay an episode in Rerun."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mapreplay.cli.logs import LogArgument, open_log
from mapreplay.cli.output import ForceOption, note
from mapreplay.errors import UsageError


def view(
    log: LogArgument,
    save: Annotated[
        Path | None, typer.Option(help="Write a .rrd that opens with this layout instead.")
    ] = None,
    web: Annotated[bool, typer.Option("--web", help="Show in a browser, on this machine.")] = False,
    force: ForceOption = False,
) -> None:
    """Replay an episode in Rerun.

    Observed, predicted, fused and error maps side by side, with rays, trail, frontier, target
    and curves on one timeline.
    """
    if save and web:
        raise UsageError("view: choose one of --save and --web")
    from mapreplay.recorders.rerun_view import open_viewer, save_rrd, serve_web

    opened = open_log(log)
    if save is not None:
        save_rrd(save, opened.header, opened.steps(), force=force)
        note(f"written: {save}; open it with `rerun {save}`")
    elif web:
        with serve_web(opened.header, opened.steps()) as served:
            typer.echo(served.address)
            note("press Ctrl-C to end")
            served.wait()
    else:
        open_viewer(opened.header, opened.steps())
