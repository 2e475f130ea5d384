"""`mapreplay ls`: one episode per row."""

from __future__ import annotations

import typer

from mapreplay.cli.logs import PathsArgument, WhereOption, choose
from mapreplay.cli.output import (
    LOST,
    ForceOption,
    Format,
    FormatOption,
    OutputOption,
    check_outputs,
    emit,
)


def ls(
    paths: PathsArgument,
    where: WhereOption = None,
    form: FormatOption = Format.TABLE,
    output: OutputOption = None,
    force: ForceOption = False,
) -> None:
    """List episodes with their configuration and outcome."""
    check_outputs(output, force=force)
    rows, unreadable = choose(paths, where)
    from mapreplay.analysis.episodes.summary import brief, episode_frame

    frame = episode_frame(rows)
    emit(frame, "mapreplay.episodes/1", form, output, text=brief(frame), force=force)
    if unreadable:
        raise typer.Exit(LOST)
