"""`mapreplay branch`: run an episode on from a logged step under a changed assumption."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mapreplay.cli.logs import LogArgument, WeightsOption, end_with, open_log
from mapreplay.cli.output import ForceOption, Format, FormatOption, emit, note


def branch(
    log: LogArgument,
    at: Annotated[
        int, typer.Option(metavar="STEP", help="The step that is made anew; -1 is the last.")
    ],
    change: Annotated[
        list[str],
        typer.Option(
            "--with",
            metavar="CHANGE",
            help="truth (false predictions are set right), observed (nothing is predicted), "
            "predictor=NAME, planner=NAME, delta-free=X, delta-occupied=X, fail-safe=on, seed=N "
            "or max-steps=N; can be repeated.",
        ),
    ],
    predictor: WeightsOption = None,
    device: Annotated[str, typer.Option(help="Where the predictor runs.")] = "cpu",
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="The new log (default: beside LOG, with the change)."),
    ] = None,
    form: FormatOption = Format.TABLE,
    force: ForceOption = False,
) -> None:
    """Run an episode on from a logged step under a changed assumption.

    The result is a log of its own, with the steps before, and linked to LOG: closed loop.
    """
    import polars as pl

    from mapreplay.analysis.branching import branch_path, prepare_branch
    from mapreplay.analysis.episodes.summary import brief, episode_frame, episode_row
    from mapreplay.cli.progress import progress_bar
    from mapreplay.recorders.log.writer import EpisodeWriter

    opened = open_log(log)
    branched = prepare_branch(opened, at, change, device, weights=predictor or [])
    path = out or branch_path(opened.path, branched.header)
    budget = branched.header.max_steps
    with (
        EpisodeWriter(path, branched.header, force=force) as writer,
        progress_bar("steps") as bar,
    ):
        task = bar.add_task("steps", total=budget, steps="")
        for step in branched.steps():
            writer.add(step)
            bar.update(task, completed=step.index, steps=f"step {step.index}")
    frame = episode_frame([episode_row(opened.path), episode_row(path)])
    text = brief(frame).insert_column(0, pl.Series("log", ["parent", "branch"]))
    emit(frame, "mapreplay.episodes/1", form, text=text)
    note(f"branched at step {branched.past.index} with {', '.join(change)} (closed loop): {path}")
    end_with([opened])
