"""`mapreplay compare`: which group is better on the same floor plans, with intervals and tests."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from mapreplay.cli.logs import PathsArgument, WhereOption, read_episodes
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
from mapreplay.errors import UsageError
from mapreplay.files.whole import write_whole

if TYPE_CHECKING:
    import polars as pl

    from mapreplay.analysis.comparison.compare import Comparison, Effect, Measure
    from mapreplay.analysis.episodes.corpus import LoggedEpisode


GROUP_WIDTH: Final = 20
"""Width of a group's name in a table, in columns."""
SHORT: Final = {
    "mapping time": "time",
    "path to target": "path m",
    "F1": "F1",
    "correct coverage": "correct",
    "coverage area": "area",
    "regret": "regret",
}
"""Short names of measures for column heads."""


def compare(
    paths: PathsArgument,
    by: Annotated[
        list[str] | None,
        typer.Option(
            help="Key to group by: planner, predictor, maps, thresholds, configuration, or one of "
            "its keys; can be repeated."
        ),
    ] = None,
    baseline: Annotated[
        str | None, typer.Option(help="Group with which the others are compared.")
    ] = None,
    where: WhereOption = None,
    target: Annotated[
        float | None,
        typer.Option(help="Coverage that counts as mapped (default: the recorded target)."),
    ] = None,
    budget: Annotated[
        int | None,
        typer.Option(help="Step budget for all episodes (default: the recorded budget)."),
    ] = None,
    test: Annotated[
        str, typer.Option(help="Test of significance: sign-flip or wilcoxon.")
    ] = "sign-flip",
    regret: Annotated[
        bool,
        typer.Option(
            "--regret",
            help="Also compare with an oracle planner (full map); takes about a second per floor "
            "plan the first time.",
        ),
    ] = False,
    plot: Annotated[
        Path | None, typer.Option(help="Draw the figures to this .png or .svg file.")
    ] = None,
    html: Annotated[Path | None, typer.Option(help="Write a self-contained HTML report.")] = None,
    form: FormatOption = Format.TABLE,
    output: OutputOption = None,
    force: ForceOption = False,
) -> None:
    """Compare groups of episodes on the same floor plans.

    Episodes are paired by floor plan, start and seed; a failure counts as the whole budget.
    Differences from the baseline have 95 % intervals over floor plans, and p-values are corrected
    for multiple tests (Holm).
    """
    check_outputs(output, plot, html, force=force)
    if plot is not None and plot.suffix not in {".png", ".svg"}:
        raise UsageError(f"--plot {plot}: should end in .png or .svg")
    from mapreplay.analysis.comparison import compare as of
    from mapreplay.analysis.comparison.groups import group_episodes

    episodes, unreadable = read_episodes(paths, where, parallel=True)
    if not episodes:
        return
    grouping = group_episodes(episodes, by or ["planner"])
    measures = [*of.MEASURES, *([_regret(episodes, target)] if regret else [])]
    result = of.compare(
        grouping, baseline, budget=budget, target=target, test=test, measures=measures
    )
    if plot is not None:
        from mapreplay.analysis.comparison.figures import Overview
        from mapreplay.analysis.reporting.figures import render

        overview = Overview(result)
        write_whole(plot, render(overview, overview.size, form=plot.suffix[1:]), force=force)
        note(f"drawn: {plot}")
    if html is not None:
        from mapreplay.analysis.comparison.page import comparison_page

        write_whole(html, comparison_page(result).html().encode(), force=force)
        note(f"written: {html}")
    emit(of.comparison_frame(result), "mapreplay.compare/1", form, output, text=_text(result),
         force=force)  # fmt: skip
    if unreadable:
        raise typer.Exit(LOST)


def _regret(episodes: list[LoggedEpisode], target: float | None) -> Measure:
    """The measure, after computing the reference times with a progress bar."""
    from mapreplay.analysis.limits.regret import REGRET, reference_times
    from mapreplay.cli.progress import progress_bar

    target = target or min(episode.header.config.coverage for episode in episodes)
    count = len({episode.start for episode in episodes})
    with progress_bar() as bar:
        for _ in bar.track(reference_times(episodes, target), count, description="references"):
            pass
    return REGRET


def _text(result: Comparison) -> list[str | Command | pl.DataFrame]:
    import polars as pl

    from mapreplay.analysis.comparison.compare import MEASURES
    from mapreplay.analysis.reporting.wording import counted, p_value, reduction

    plans = len(result.places)
    more = sum(1 + len(SHORT[m.name]) for m in result.measures if m not in MEASURES)
    by = ", ".join(result.by)
    shown: list[str | Command | pl.DataFrame] = [
        f"Groups by {by}: {len(result.groups)}. Floor plans: {plans}. Target: {result.target}.",
        pl.DataFrame(
            {
                "group": [
                    textwrap.fill(group.name, GROUP_WIDTH - more, break_on_hyphens=False)
                    for group in result.groups
                ],
                "runs": [group.episodes for group in result.groups],
                **{
                    outcome.split("_")[0]: [dict(g.outcomes)[outcome] for g in result.groups]
                    for outcome in dict(result.groups[0].outcomes)
                },
                **{
                    SHORT[m.name]: [group.estimates[m.name].mean for group in result.groups]
                    for m in result.measures
                },
            }
        ).with_columns(pl.col(pl.Float64).fill_nan(None)),
    ]
    for saving in result.savings:
        effects = [effect for effect in result.effects if effect.group == saving.group]
        both = saving.both
        shown += [
            "",
            f"{saving.group} against {result.baseline}: mapping time "
            + reduction(saving.reduction),
        ]
        if both.plans < plans:
            shown.append(
                f"On the {counted(both.plans, 'floor plan')} that both mapped: {reduction(both)}"
            )
        shown.append(_against(effects))
        m = saving.success
        if m.only_candidate or m.only_reference:
            sure = f"{p_value(m.p)}, Holm: {p_value(saving.success_p_holm)}"
            shown.append(
                f"Mapped only by {saving.group}: {m.only_candidate}, only by {result.baseline}: "
                f"{m.only_reference} (McNemar, exact: {sure})"
            )
    if result.all_alike is not None:
        shown += ["", f"Friedman's test of the mapping times: {p_value(result.all_alike.p)}"]
    if result.notes:
        shown += ["", *(f"- {line}" for line in result.notes)]
    return shown


def _against(effects: list[Effect]) -> pl.DataFrame:
    import polars as pl

    from mapreplay.analysis.reporting.wording import p_number

    return pl.DataFrame(
        {
            "difference": [e.measure for e in effects],
            "mean": [e.difference.mean for e in effects],
            "from": [e.difference.low for e in effects],
            "to": [e.difference.high for e in effects],
            "plans": [e.difference.plans for e in effects],
            "p": [p_number(e.test.p) for e in effects],
            "p Holm": [p_number(e.p_holm) for e in effects],
        }
    ).with_columns(pl.col(pl.Float64).fill_nan(None))
