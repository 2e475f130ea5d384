"""`mapreplay whatif`: the effect of other thresholds on the logged predictions."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from mapreplay.cli.logs import LogArgument, end_with, open_log
from mapreplay.cli.output import (
    Command,
    ForceOption,
    Format,
    FormatOption,
    OutputOption,
    check_outputs,
    emit,
    note,
)
from mapreplay.errors import UsageError
from mapreplay.files.whole import write_whole

if TYPE_CHECKING:
    import polars as pl

    from mapreplay.analysis.whatif.grid import WhatIf
    from mapreplay.recorders.log.reader import EpisodeLog

COUNT: Final = 20
"""Default number of thresholds in a range."""
MAX_COUNT: Final = 200
COLUMNS: Final = 8
"""Columns of the heat map in a terminal."""
FINE: Final = 99
"""Number of thresholds tried to find one that keeps the agent free: .01, .02, ..., .99, 1."""


def whatif(
    log: LogArgument,
    delta_free: Annotated[
        str, typer.Option(help="Confidence threshold, or FIRST:LAST[:COUNT].")
    ] = ".5:.99",
    delta_occupied: Annotated[
        str, typer.Option(help="Confidence threshold, or FIRST:LAST[:COUNT].")
    ] = ".5:.99",
    step: Annotated[
        int, typer.Option(help="Step at which scores are reported; -1 is the last.")
    ] = -1,
    plot: Annotated[
        Path | None, typer.Option(help="Draw a heat map to this .png or .svg file.")
    ] = None,
    form: FormatOption = Format.TABLE,
    output: OutputOption = None,
    force: ForceOption = False,
) -> None:
    """Try other thresholds on a log, open loop.

    Fuses the logged predictions again, and reports F1 and coverage for every pair of thresholds,
    and when the agent would have been sealed in and freed. The trajectory stays as logged; use
    `branch` to resume the episode instead.
    """
    check_outputs(output, plot, force=force)
    from mapreplay.analysis.whatif.grid import what_if, what_if_frame

    free, occupied = (
        _values(name, text)
        for name, text in (("--delta-free", delta_free), ("--delta-occupied", delta_occupied))
    )
    if plot is not None and plot.suffix not in {".png", ".svg"}:
        raise UsageError(f"--plot {plot}: should end in .png or .svg")
    opened = open_log(log)
    count = opened.last + 1
    if not -count <= step < count:
        raise UsageError(f"--step {step}: {opened.path} has steps 0 to {count - 1}")
    opened.check_step(step % count)
    result = what_if(opened, free, occupied)
    at = step % count
    frame = what_if_frame(result, at)
    if plot is not None:
        _plot(plot, opened, result, at, force=force)
    logged = opened.header.at(at).config
    heat = _heat(result, at, logged.delta_free, logged.delta_occupied)
    text: list[str | Command | pl.DataFrame] = [*_story(opened, at), "", *heat]
    emit(frame, "mapreplay.whatif/2", form, output, text=text, force=force)
    end_with([opened])


def _values(option: str, text: str) -> list[float]:
    """The thresholds of an option."""
    import numpy as np

    first, *rest = text.split(":")
    try:
        low = float(first)
        high = float(rest[0]) if rest else low
        count = int(rest[1]) if len(rest) > 1 else COUNT if rest else 1
        if len(rest) > 2 or not 0 < low <= high <= 1 or not 1 <= count <= MAX_COUNT:
            raise ValueError
    except ValueError:
        raise UsageError(
            f"{option} {text}: expected a threshold, or FIRST:LAST[:COUNT] with 0 < FIRST <= LAST "
            f"<= 1 and COUNT at most {MAX_COUNT}, such as .5:.99:20"
        ) from None
    return sorted(set(np.linspace(low, high, count).round(6).tolist()))


def _story(log: EpisodeLog, step: int) -> list[str | Command | pl.DataFrame]:
    """The effect of the logged thresholds, and which others would have kept the agent free."""
    from mapreplay.analysis.whatif.grid import sufficient_thresholds, what_if

    config = log.header.at(step).config
    as_logged = what_if(log, [config.delta_free], [config.delta_occupied])
    course = as_logged.course(0, 0)
    lines: list[str | Command | pl.DataFrame] = [
        "Open loop: trajectory, observations and predictions stay as they were logged.",
        (
            f"As logged (delta_free {config.delta_free}, delta_occupied {config.delta_occupied}): "
            f"F1 {as_logged.f1[step, 0, 0]:.3f}, coverage {as_logged.coverage[step, 0, 0]:.3f}, "
            f"correct {as_logged.correct[step, 0, 0]:.3f} at step {step}."
        ),
    ]
    if course.sealed is None:
        return [*lines, "The agent is never sealed in with these thresholds."]
    until = "" if course.freed is None else f", freed at step {course.freed}"
    lines.append(f"It is sealed in at step {course.sealed}{until}.")
    found = sufficient_thresholds(log, course.sealed, [k / (FINE + 1) for k in range(1, FINE + 2)])
    ways = [
        f"{name} of {value} or more"
        for name, value in (
            ("delta_occupied", found.delta_occupied), ("delta_free", found.delta_free),
        )
        if value is not None
    ]  # fmt: skip
    if not ways:
        return [*lines, "Changing a single threshold would not have kept a way open there."]
    lines.append(
        f"A {' or a '.join(ways)} (the other one unchanged) would have kept a way open there."
    )
    name, value = (
        ("delta-occupied", found.delta_occupied)
        if found.delta_occupied is not None
        else ("delta-free", found.delta_free)
    )
    lines.append("Resume the episode with it, closed loop:")
    lines.append(
        Command(["mapreplay", "branch", log.path, "--at", str(course.sealed),
                 "--with", f"{name}={value}"])
    )  # fmt: skip
    return lines


def _heat(
    result: WhatIf, step: int, logged_free: float, logged_occupied: float
) -> list[str | Command | pl.DataFrame]:
    """Scores for some of the pairs, including those nearest to the logged thresholds, with a mark
    where the agent would have been sealed in.
    """
    import numpy as np
    import polars as pl

    ever = np.asarray(result.sealed.any(axis=0))
    mark = ", x where it would have been sealed in" if ever.any() else "; never sealed in"
    rows = _some(result.delta_occupied, logged_occupied)
    across = _some(result.delta_free, logged_free)
    shown = list[str | Command | pl.DataFrame]()
    for name, values in (("F1", result.f1), ("Correct coverage", result.correct)):
        columns = {"occupied/free": [f"{result.delta_occupied[j]:.3f}" for j in rows]}
        for i in across:
            columns[f"{result.delta_free[i]:.3f}"] = [
                f"{values[step, i, j]:.3f}{'x' if ever[i, j] else ''}" for j in rows
            ]
        shown += [f"{name} at step {step}{mark}", pl.DataFrame(columns), ""]
    parts = [
        f"{len(some)} of {len(all_)} values of {name}"
        for name, some, all_ in (
            ("delta_occupied", rows, result.delta_occupied),
            ("delta_free", across, result.delta_free),
        )
        if len(some) < len(all_)
    ]
    return [*shown, f"{', '.join(parts)}; all with --format csv"] if parts else shown[:-1]


def _some(values: tuple[float, ...], logged: float) -> list[int]:
    """Indices of at most `COLUMNS` values, including both ends and the one nearest to `logged`."""
    count = min(COLUMNS, len(values))
    if count == 1:
        return [0]
    chosen = [round(k * (len(values) - 1) / (count - 1)) for k in range(count)]
    nearest = min(range(len(values)), key=lambda i: abs(values[i] - logged))
    if nearest not in chosen:  # in place of a neighbour that is no end
        inner = range(1, count - 1)
        chosen[min(inner, key=lambda k: abs(chosen[k] - nearest))] = nearest
    return chosen


def _plot(path: Path, log: EpisodeLog, result: WhatIf, step: int, *, force: bool) -> None:
    from mapreplay.analysis.reporting.figures import render
    from mapreplay.analysis.whatif.figure import HeatMap

    config = log.header.at(step).config
    picture = HeatMap(result, step, (config.delta_free, config.delta_occupied))
    write_whole(path, render(picture, (9, 4.2), form=path.suffix[1:]), force=force)
    note(f"drawn: {path}")
