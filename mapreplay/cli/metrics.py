"""`mapreplay metrics`: recompute every metric of every step from a log's maps."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mapreplay.cli.logs import PathsArgument, WhereOption, choose
from mapreplay.cli.output import LOST, ForceOption, Format, FormatOption, OutputOption, emit, note
from mapreplay.errors import LogError, UsageError

SHOWN = ("step", "coverage_observed", "coverage_fused", "correct_coverage_fused", "precision",
         "recall", "f1", "iou")  # fmt: skip


def metrics(
    paths: PathsArgument,
    where: WhereOption = None,
    metric: Annotated[
        list[str] | None, typer.Option(help="A further metric by name; can be repeated.")
    ] = None,
    unknown_as: Annotated[
        str, typer.Option(help="What unknown cells count as: free, occupied or ignored.")
    ] = "free",
    region: Annotated[
        str, typer.Option(help="Cells that count: explorable or all.")
    ] = "explorable",
    form: FormatOption = Format.TABLE,
    output: OutputOption = None,
    force: ForceOption = False,
) -> None:
    """Recompute the metrics of every step.

    From the logged maps alone; with the default options they are compared with what was
    recorded, bit for bit.
    """
    import numpy as np
    import polars as pl

    from mapreplay.analysis.metrics import (
        Measured,
        disagreements,
        load_metric,
        metrics_frame,
        recompute,
    )
    from mapreplay.recorders.log import EpisodeLog
    from mapreplay.scores import UnknownAs

    if unknown_as not in set(UnknownAs):
        raise UsageError(f"--unknown-as {unknown_as}: should be {', '.join(UnknownAs)}")
    if region not in {"explorable", "all"}:
        raise UsageError(f"--region {region}: should be explorable or all")
    extra = {name: load_metric(name) for name in metric or []}
    as_recorded = unknown_as == "free" and region == "explorable"
    rows, unreadable = choose(paths, where)
    frames, wrong = [], []
    for row in rows:
        log = EpisodeLog(Path(row.file))
        everywhere = np.ones(log.header.floor_plan.shape, np.bool_)
        measured: list[Measured] = list(
            recompute(
                log,
                unknown_as=UnknownAs(unknown_as),
                region=None if region == "explorable" else everywhere,
                extra=extra,
            )
        )
        if as_recorded:
            wrong += [f"{row.file}: {d}" for step in measured for d in disagreements(step)]
        frame = metrics_frame(measured, list(extra))
        frames.append(frame.insert_column(0, pl.Series("file", [row.file] * len(frame))))
    if not frames:
        note("no episode is like that")
        return
    table = pl.concat(frames)
    shown = [*SHOWN, *extra] if len(frames) == 1 else ["file", *SHOWN, *extra]
    emit(table, "mapreplay.metrics/1", form, output, text=table.select(shown), force=force)
    if wrong:
        raise LogError(f"{wrong[0]} ({len(wrong)} values disagree)")
    if as_recorded:
        note(f"{len(table)} steps agree with what was recorded, bit for bit")
    if unreadable:
        raise typer.Exit(LOST)
