"""`mapreplay verify`: check a log's integrity and reproducibility, bit for bit."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mapreplay.cli.logs import PathsArgument, WeightsOption, WhereOption, tell_same, tell_states
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
from mapreplay.errors import MapreplayError, PluginError, UsageError
from mapreplay.text import printable

if TYPE_CHECKING:
    import polars as pl

    from mapreplay.analysis.verification import Verification
    from mapreplay.recorders.log.reader import EpisodeLog
    from mapreplay.recorders.log.state import LogState

DIFFERS = 1


def verify(
    paths: PathsArgument,
    where: WhereOption = None,
    rerun: Annotated[
        bool, typer.Option("--rerun", help="Run the episode again and compare every array.")
    ] = False,
    rerun_from: Annotated[
        int | None,
        typer.Option(
            metavar="K", help="Predict, fuse and decide again at step K, from its observed map."
        ),
    ] = None,
    predictor: WeightsOption = None,
    device: Annotated[str, typer.Option(help="Device for the predictor: cpu, cuda, ...")] = "cpu",
    form: FormatOption = Format.TABLE,
    output: OutputOption = None,
    force: ForceOption = False,
) -> None:
    """Check integrity and reproducibility of logs, bit for bit.

    Recomputes scans, maps, moves, decisions, metrics and outcome from each log alone.
    """
    check_outputs(output, force=force)
    if rerun and rerun_from is not None:
        raise UsageError("verify: choose one of --rerun and --rerun-from")
    if predictor and not rerun and rerun_from is None:
        raise UsageError("verify: --predictor is for --rerun and --rerun-from")
    from mapreplay.analysis.episodes.summary import RowFilter, row_of_log
    from mapreplay.recorders.log.blame import blaming
    from mapreplay.recorders.log.find import find_logs
    from mapreplay.recorders.log.reader import EpisodeLog

    check = _check(device, rerun_from, predictor or [], rerun=rerun)
    conditions = [RowFilter.parse(text) for text in where or []]
    results: dict[str, Verification] = {}
    problems: list[str] = []
    states: dict[Path, LogState] = {}
    for path in find_logs(paths):
        try:
            with blaming(path):
                log = EpisodeLog(path)
                if conditions:
                    row = row_of_log(log, printable(str(path)))
                    if not all(condition.holds(row) for condition in conditions):
                        continue
                results[printable(str(log.path))] = check(log)
        except PluginError as error:  # what the log names is not here
            problems.append(f"{path}: {error}")
            continue
        except UsageError:
            raise
        except MapreplayError as error:
            problems.append(str(error))
            continue
        states[log.path] = log.state
    if problems and not results:
        raise MapreplayError(problems[0])
    for problem in problems:
        note(f"not verified: {problem}")
    tell_same(list(states))
    lost = tell_states(states)
    frame = _frame(results)
    emit(frame, "mapreplay.verify/1", form, output, text=_brief(results), force=force)
    _tell(results)
    if any(not result.agrees for result in results.values()):
        raise typer.Exit(DIFFERS)
    if problems or lost:
        raise typer.Exit(LOST)


def _check(
    device: str, rerun_from: int | None, weights: list[Path], *, rerun: bool
) -> Callable[[EpisodeLog], Verification]:
    """What is to be done with each log."""
    from mapreplay.analysis import verification

    def one_step(log: EpisodeLog) -> Verification:
        index = rerun_from or 0
        if not -log.last - 1 <= index <= log.last:
            raise UsageError(f"--rerun-from {index}: {log.path} has steps 0 to {log.last}")
        return verification.verify_step(log, index, device, weights=weights)

    if rerun_from is not None:
        return one_step
    if rerun:
        return lambda log: verification.verify_rerun(log, device, weights=weights)
    return verification.verify


def _tell(results: dict[str, Verification]) -> None:
    """The differences, line by line, and the verdict."""
    from mapreplay.analysis.reporting.wording import counted

    for file, result in results.items():
        for difference in result.differences:
            note(f"{file}: {difference}")
        if result.count > len(result.differences):
            note(f"{file}: {result.count} differences; the first {len(result.differences)} shown")
        for line in result.notes:
            note(f"{file}: {line}")
    wrong = sum(not result.agrees for result in results.values())
    steps = sum(result.steps for result in results.values())
    verdict = f"{wrong} differ" if wrong else "all agree, bit for bit"
    note(f"{counted(len(results), 'log')}, {counted(steps, 'step')}: {verdict}")


def _frame(results: dict[str, Verification]) -> pl.DataFrame:
    """One row a difference that is shown; a log without any has one row."""
    import polars as pl

    from mapreplay.analysis.diff.steps import as_text

    rows = []
    for file, result in results.items():
        for d in result.differences or (None,):
            cell = d.cell if d and d.cell else (None, None)
            place = (d.step, d.topic, d.what, *cell) if d else (None,) * 5
            values = (as_text(d.logged), as_text(d.expected), d.more) if d else (None,) * 3
            rows.append((file, result.steps, result.count, *place, *values))
    schema = {
        "file": pl.String,
        "steps": pl.Int64,
        "differences": pl.Int64,
        "step": pl.Int64,
        "topic": pl.String,
        "what": pl.String,
        "row": pl.Int64,
        "col": pl.Int64,
        "logged": pl.String,
        "expected": pl.String,
        "more": pl.Int64,
    }
    return pl.DataFrame(rows, schema=schema, orient="row")


def _brief(results: dict[str, Verification]) -> pl.DataFrame:
    """One row a log."""
    import polars as pl

    return pl.DataFrame(
        {
            "file": [Path(file).name for file in results],
            "steps": [result.steps for result in results.values()],
            "differences": [result.count for result in results.values()],
        },
        schema={"file": pl.String, "steps": pl.Int64, "differences": pl.Int64},
    )
