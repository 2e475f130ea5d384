"""`mapreplay branch`: resume an episode from a logged step with a changed assumption."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mapreplay.cli.logs import LogArgument, WeightsOption, end_with, open_log
from mapreplay.cli.output import ForceOption, Format, FormatOption, emit, note


def branch(
    log: LogArgument,
    at: Annotated[
        int, typer.Option(metavar="STEP", help="First step to recompute; -1 is the last.")
    ],
    change: Annotated[
        list[str],
        typer.Option(
            "--with",
            metavar="CHANGE",
            help="truth (false predictions are corrected with the ground truth), observed (no "
            "prediction), predictor=NAME, planner=NAME, delta-free=X, delta-occupied=X, "
            "fail-safe=on, seed=N or max-steps=N; can be repeated.",
        ),
    ],
    predictor: WeightsOption = None,
    device: Annotated[str, typer.Option(help="Device for the predictor: cpu, cuda, ...")] = "cpu",
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", "-o", help="The new log (default: next to LOG, named after the change)."
        ),
    ] = None,
    form: FormatOption = Format.TABLE,
    force: ForceOption = False,
) -> None:
    """Resume an episode from a logged step with a changed assumption (closed loop).

    The result is a separate log, which contains the steps before and refers to LOG.
    """
    import polars as pl

    from mapreplay.analysis.branching import branch, branch_path
    from mapreplay.analysis.episodes.summary import brief, episode_frame, episode_row
    from mapreplay.cli.progress import progress_bar
    from mapreplay.recorders.log.writer import EpisodeWriter

    opened = open_log(log)
    branched = branch(opened, at, change, device, weights=predictor or [])
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
