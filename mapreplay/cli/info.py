"""`mapreplay info`: the metadata of one log."""

from __future__ import annotations

from mapreplay.cli.logs import LogArgument, end_with, open_log
from mapreplay.cli.output import (
    ForceOption,
    Format,
    FormatOption,
    OutputOption,
    check_outputs,
    emit,
)
from mapreplay.text import printable


def info(
    log: LogArgument,
    form: FormatOption = Format.TABLE,
    output: OutputOption = None,
    force: ForceOption = False,
) -> None:
    """Show the metadata of one log.

    Configuration, floor plan, predictor, versions, how it ended, and its events.
    """
    check_outputs(output, force=force)
    import polars as pl

    from mapreplay.analysis.episodes.summary import summarize

    opened = open_log(log)
    header, plan = opened.header, opened.header.floor_plan
    facts: list[tuple[str, str, object]] = [
        ("file", "finished", opened.finished),
        ("file", "state", str(opened.state)),
        ("file", "bytes", opened.path.stat().st_size),
        ("floor plan", "id", plan.id),
        ("floor plan", "cells", f"{plan.shape[0]} x {plan.shape[1]}"),
        ("floor plan", "resolution", f"{plan.resolution} m per cell"),
        ("floor plan", "explorable cells", int(opened.header.explorable.sum())),
        ("floor plan", "true map", "known" if plan.has_truth else "not known"),
        ("floor plan", "sha256", plan.sha256),
        ("agent", "start", "row {}, col {}".format(*header.start)),
        ("agent", "budget", "none" if header.budget is None else f"{header.budget} steps"),
        ("agent", "simulator", header.simulator),
        ("predictor", "name", header.predictor.name),
        ("predictor", "sha256", header.predictor.sha256 or "-"),
    ]
    facts += [("config", key, value) for key, value in header.config.model_dump(mode="json").items()
              if key not in {"predictor", "start", "max_steps"}]  # fmt: skip
    if header.branch is not None:
        facts += [
            ("branch", "parent's sha256", header.branch.parent_sha256),
            ("branch", "step", header.branch.step),
            ("branch", "changes", ", ".join(header.branch.changes)),
        ]
    facts += [("version", name, version) for name, version in header.versions]
    row = summarize(opened, printable(str(opened.path)))
    # An unfinished log has no end yet.
    facts += [] if not opened.finished else [
        (
            "end",
            name.replace("_", " "),
            round(value, 4) if isinstance(value := getattr(row, name), float) else value,
        )
        for name in ("outcome", "steps", "mapping_time", "correct_time", "path_length", "coverage",
                     "correct", "f1", "fail_safe_steps")
    ]  # fmt: skip
    facts += [
        ("event", f"{step.index} {event.kind}", event.text)
        for step in opened.steps()
        for event in step.events
    ]
    frame = pl.DataFrame(
        {
            "of": [of for of, _, _ in facts],
            "what": [what for _, what, _ in facts],
            "value": [
                "-" if value is None or value != value else str(value) for _, _, value in facts
            ],
        }
    )
    # Hashes, the only long values, would not fit into 80 columns.
    short = pl.col("value").str.replace(r"^([0-9a-f]{12})[0-9a-f]{52}$", "$1")
    emit(frame, "mapreplay.info/1", form, output, text=frame.with_columns(short), force=force)
    end_with([opened])
