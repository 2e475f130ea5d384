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

    from mapreplay.analysis.episodes.summary import row_of_log
    from mapreplay.recorders.log.facts import facts_of

    opened = open_log(log)
    header = opened.header
    facts: list[tuple[str, str, object]] = [
        ("file", "finished", opened.finished),
        ("file", "state", str(opened.state)),
        ("file", "bytes", opened.path.stat().st_size),
        *facts_of(header),
    ]
    row = row_of_log(opened, printable(str(opened.path)))
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
    if opened.has_steps:
        facts += [("event", f"{step} {event.kind}", event.text) for step, event in opened.events()]
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
