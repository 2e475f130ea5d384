"""`mapreplay diff`: where and why two episodes, or two folders of episodes, diverge."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, TypeAlias

import typer

from mapreplay.cli.logs import WhereOption, read_episodes
from mapreplay.cli.output import (
    LOST,
    Command,
    ForceOption,
    Format,
    FormatOption,
    OutputOption,
    check_outputs,
    emit,
    note,
)
from mapreplay.errors import MapreplayError, UsageError

if TYPE_CHECKING:
    import polars as pl

    from mapreplay.analysis.diff.folders import PairDiff
    from mapreplay.analysis.diff.pair import Both, EpisodeDiff
    from mapreplay.analysis.episodes.corpus import LoggedEpisode, Pairing

DIFFERS: Final = 1
FAILED: Final = 4
SHOWN: Final = 3
"""Episodes without a partner that are named."""

_Lines: TypeAlias = "list[str | Command | pl.DataFrame]"

Side = Annotated[Path, typer.Argument(help="A log, or a folder or glob of logs.")]


def diff(
    a: Side,
    b: Side,
    where: WhereOption = None,
    exit_code: Annotated[
        bool,
        typer.Option(
            "--exit-code", help="Exit with 1 if they differ, with 4 if the comparison failed."
        ),
    ] = False,
    form: FormatOption = Format.TABLE,
    output: OutputOption = None,
    force: ForceOption = False,
) -> None:
    """Show where and why two episodes diverge, and the consequences.

    Two folders: pairs episodes by floor plan, start and seed, and ranks them by difference.
    Episodes are identical only if they are the same, bit for bit.
    """
    check_outputs(output, force=force)
    try:
        (of_a, lost_a), (of_b, lost_b) = (read_episodes([side], where) for side in (a, b))
        if len(of_a) == len(of_b) == 1:
            frame, text, differ = _two(of_a[0], of_b[0])
            kind = "mapreplay.diff/1"
        else:
            frame, text, differ, lost = _many(of_a, of_b)
            lost_a += lost
            kind = "mapreplay.diff.pairs/1"
    except UsageError:
        raise
    except MapreplayError as error:
        if not exit_code:
            raise
        note(f"mapreplay: {error}")
        raise typer.Exit(FAILED) from None
    emit(frame, kind, form, output, text=text, force=force)
    if exit_code and differ:
        raise typer.Exit(DIFFERS)
    if lost_a or lost_b:
        raise typer.Exit(FAILED if exit_code else LOST)


def _two(
    a: LoggedEpisode, b: LoggedEpisode
) -> tuple[pl.DataFrame, list[str | Command | pl.DataFrame], bool]:
    from mapreplay.analysis.diff.pair import diff_frame, diff_logs

    result = diff_logs(a.log, b.log)
    return diff_frame(result), list(_story(a, b, result)), not result.identical


def _story(a: LoggedEpisode, b: LoggedEpisode, result: EpisodeDiff) -> _Lines:
    import polars as pl

    from mapreplay.analysis.diff.folders import view_command

    shown: _Lines = [f"A: {a.path}", f"B: {b.path}"]
    compared = len({*a.log.indices} & {*b.log.indices})
    if result.identical:
        return [*shown, f"identical: {compared} steps, bit for bit"]
    if result.headers:
        said = ", ".join(f"{s.what} {s.a} | {s.b}" for s in result.headers)
        shown.append(f"A | B: {said}")
    cause = result.cause
    if cause is None:
        return [*shown, f"All {compared} steps are the same, bit for bit."]
    shown.append("")
    shown.append(f"They diverge at step {cause.step}, in the {cause.layer}.")
    shown += [f"  step {c.step}, {c.layer}: {c.text}" for c in result.causes]
    shown.append(Command(view_command(a.path, b.path, result.causes[-1].step)))
    shown.append("")
    if not result.ends:
        return shown
    steps, *ends = result.ends
    shown.append(
        f"A: {result.outcomes[0]} after {steps.a} steps. "
        f"B: {result.outcomes[1]} after {steps.b} steps."
    )
    meanwhile = result.meanwhile[1:]
    columns = {
        "": [n.what for n in ends],
        f"A at {result.steps - 1}": [n.a for n in meanwhile],
        f"B at {result.steps - 1}": [n.b for n in meanwhile],
        "A at its end": [n.a for n in ends],
        "B at its end": [n.b for n in ends],
        "B - A": [n.difference for n in ends],
    }
    shown.append(pl.DataFrame(columns).with_columns(pl.col(pl.Float64).fill_nan(None)))
    return [*shown, "", _times(result.times)]


def _times(times: tuple[Both, ...]) -> pl.DataFrame:
    import polars as pl

    spent = [n for n in times if n.a or n.b]
    return pl.DataFrame(
        {
            "where the steps went": [n.what for n in spent],
            "A": [n.a for n in spent],
            "B": [n.b for n in spent],
            "B - A": [n.difference for n in spent],
        }
    ).with_columns(pl.col(pl.Float64).fill_nan(None).cast(pl.Int64))


def _many(
    of_a: list[LoggedEpisode], of_b: list[LoggedEpisode]
) -> tuple[pl.DataFrame, _Lines, bool, int]:
    """The whole table, what people see of it, whether the two sides differ, and how many pairs
    could not be compared; each of those is named on stderr.
    """
    import polars as pl

    from mapreplay.analysis.diff.folders import diff_pairs, pairs_frame, view_command
    from mapreplay.analysis.episodes.corpus import pair
    from mapreplay.analysis.pool import default_jobs
    from mapreplay.analysis.reporting.wording import counted
    from mapreplay.cli.progress import progress_bar

    pairing = pair(of_a, of_b)
    _tell(pairing)
    pairs = pairing.pairs
    if not pairs:
        raise MapreplayError("no two episodes have floor plan, start and seed in common")
    results: list[PairDiff] = []
    failed: list[MapreplayError] = []
    with progress_bar() as bar:
        compared = diff_pairs(pairs, default_jobs(len(pairs)))
        for result in bar.track(compared, len(pairs), description="pairs"):
            if isinstance(result, MapreplayError):
                failed.append(result)
            else:
                results.append(result)
    if not results:
        raise failed[0]
    for error in failed:
        note(f"not compared: {error}")
    frame = pairs_frame(results)
    same = int(frame["identical"].sum())
    shown: _Lines = [
        frame.select(
            "floor_plan",
            "seed",
            pl.col("time_a").alias("A"),
            pl.col("time_b").alias("B"),
            pl.col("difference").alias("B - A"),
            pl.col("f1_a").alias("F1 A"),
            pl.col("f1_b").alias("F1 B"),
            pl.col("step").alias("at step"),
            pl.when("identical")
            .then(pl.lit("identical"))
            .otherwise(pl.col("layer").fill_null("header only"))
            .alias("they diverge in"),
            pl.col("move_step").alias("move"),
        ),
        (
            f"{counted(len(frame), 'pair')}, {same} identical; mapping times, the largest "
            "difference first."
        ),
    ]
    top = frame.row(0, named=True)
    if top["step"] is not None:
        step = top["step"] if top["move_step"] is None else top["move_step"]
        shown += ["See the first:", Command(view_command(top["file_a"], top["file_b"], step))]
    differ = same < len(frame) or bool(pairing.only_a or pairing.only_b)
    return frame, shown, differ, len(failed)


def _tell(pairing: Pairing) -> None:
    """What could not be paired, on stderr."""
    for name, episodes in (("A", pairing.only_a), ("B", pairing.only_b)):
        if episodes:
            some = ", ".join(str(e.path) for e in episodes[:SHOWN])
            more = f" and {len(episodes) - SHOWN} more" if len(episodes) > SHOWN else ""
            note(f"only in {name}: {some}{more}")
    for one, other in pairing.repeated[:SHOWN]:
        note(f"left out, twice the same floor plan, start and seed: {one.path}, {other.path}")
