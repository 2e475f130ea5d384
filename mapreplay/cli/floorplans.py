"""`mapreplay floorplans`: list, describe and preview any source."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

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
from mapreplay.errors import FloorPlanError
from mapreplay.files.whole import write_whole

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mapreplay.floorplan import Doubt, FloorPlan


def floorplans(
    spec: Annotated[
        str,
        typer.Argument(
            help="procedural:FIRST-LAST, a HouseExpo archive, folder or JSON file, a map_server "
            "YAML, an image, or a registered SOURCE:REST. Grey levels of images and maps: "
            "PATH:free=0.3,occupied=0.6,negate=1."
        ),
    ] = "procedural",
    ids: Annotated[Path | None, typer.Option(help="File with one floor-plan ID per line.")] = None,
    limit: Annotated[int, typer.Option(min=1, help="Maximum number of floor plans.")] = 20,
    resolution: Annotated[
        float | None,
        typer.Option(min=0.001, help="Metres per cell, for sources that are rasterized."),
    ] = None,
    preview: Annotated[
        Path | None, typer.Option(help="Draw the floor plans to this PNG file, as a contact sheet.")
    ] = None,
    form: FormatOption = Format.TABLE,
    output: OutputOption = None,
    force: ForceOption = False,
) -> None:
    """List, describe, preview and check floor plans.

    Exit code 0 if all were read, 3 if some were left out, 1 if none was read.
    """
    check_outputs(output, preview, force=force)
    import polars as pl

    from mapreplay.floorplans import load_each, open_source, read_ids, select
    from mapreplay.floorplans.plausibility import examine, warning_lines

    source = open_source(spec, resolution)
    wanted = read_ids(ids) if ids else None
    selection = select(source, wanted, limit)
    plans, refused = [], []
    for _, plan in load_each(source, selection.ids):
        if isinstance(plan, FloorPlanError):
            refused.append(str(plan))
        else:
            plans.append(plan)
    doubts = [examine(plan) for plan in plans]
    if plans:
        frame = pl.DataFrame(list(map(_row, plans, doubts)))
        text = frame.select(
            "id",
            pl.format("{} x {}", "height", "width").alias("cells"),
            pl.col("resolution").alias("m/cell"),
            pl.col("wall_share").alias("walls"),
            "explorable",
            "unknown",
        )
        emit(frame, "mapreplay.floorplans/1", form, output, text=text, force=force)
    if preview and plans:
        from mapreplay.floorplans.preview import contact_sheet
        from mapreplay.pictures import png_of

        write_whole(preview, png_of(contact_sheet(plans)), force=force)
        note(f"drawn: {preview}")
    total = len(wanted) - len(selection.missing) if wanted is not None else len(source.ids())
    if total > len(selection.ids):
        note(f"{len(selection.ids)} of {total} plans; see more with --limit")
    for line in warning_lines([p.where for p in plans], doubts):
        note(line)
    for line in refused:
        note(f"refused: {line}")
    if selection.missing:
        note(f"{len(selection.missing)} ids are not in {spec}, such as {selection.missing[0]}")
    if not plans:
        raise typer.Exit(1)
    if refused or selection.missing:
        raise typer.Exit(LOST)


def _row(plan: FloorPlan, doubts: Sequence[Doubt]) -> dict[str, Any]:
    from mapreplay.floorplans.describe import describe

    summary = describe(plan)
    fields = asdict(summary)
    del fields["start"]
    start = {"start_row": summary.start.row, "start_col": summary.start.col}
    return fields | start | {"doubts": "; ".join(doubt.text for doubt in doubts)}
