"""`mapreplay metrics`: recompute every metric of any number of logs from their maps."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from mapreplay.cli.logs import PathsArgument, WhereOption, read_episodes, tell_same, tell_states
from mapreplay.cli.output import (
    LOST,
    ForceOption,
    Format,
    FormatOption,
    OutputOption,
    check_outputs,
    emit,
    emit_parts,
    note,
)
from mapreplay.errors import LogError, UsageError

if TYPE_CHECKING:
    import polars as pl

    from mapreplay.analysis.metrics.many import MeasuredLog
    from mapreplay.analysis.metrics.measure import Scope
    from mapreplay.analysis.metrics.store import Store

STEP_COLUMNS: Final = ("step", "coverage_observed", "coverage_fused", "correct_coverage_fused",
                       "f1", "iou", "ece_unobserved", "auroc_unobserved")  # fmt: skip
SHOWN: Final = 3
"""Maximum number of copies that are named."""
SHORT: Final = {
    "coverage_observed": "observed",
    "coverage_fused": "fused",
    "correct_coverage_fused": "correct",
    "ece_unobserved": "ece",
    "auroc_unobserved": "auroc",
}


class Per(StrEnum):
    """What a row of the table describes."""

    STEP = "step"
    EPISODE = "episode"


def metrics(
    paths: PathsArgument,
    where: WhereOption = None,
    per: Annotated[Per, typer.Option(help="One row per step or per episode.")] = Per.STEP,
    metric: Annotated[
        list[str] | None, typer.Option(help="Name of an additional metric; can be repeated.")
    ] = None,
    unknown_as: Annotated[
        str, typer.Option(help="How unknown cells are counted: free, occupied or ignored.")
    ] = "free",
    region: Annotated[
        str, typer.Option(help="Cells that are scored: explorable or all.")
    ] = "explorable",
    jobs: Annotated[
        int | None,
        typer.Option(
            min=1, show_default="all cores if there are many logs", help="Number of processes."
        ),
    ] = None,
    no_cache: Annotated[
        bool, typer.Option("--no-cache", help="Recompute everything and cache nothing.")
    ] = False,
    form: FormatOption = Format.TABLE,
    output: OutputOption = None,
    force: ForceOption = False,
) -> None:
    """Recompute all metrics, per step or per episode.

    From the logged maps: scores, coverage and its milestones, calibration on unobserved cells
    (also by distance from the observed ones), and the stability of the prediction. With the
    default options the result is compared with the recorded metrics, bit for bit.
    """
    check_outputs(output, force=force)
    from mapreplay.analysis.metrics.measure import Scope
    from mapreplay.recorders.log.find import find_logs
    from mapreplay.scores import UnknownAs

    if unknown_as not in set(UnknownAs):
        raise UsageError(f"--unknown-as {unknown_as}: should be {', '.join(UnknownAs)}")
    if region not in {"explorable", "all"}:
        raise UsageError(f"--region {region}: should be explorable or all")
    scope = Scope(UnknownAs(unknown_as), everywhere=region == "all")
    unreadable = 0
    if where:
        chosen, unreadable = read_episodes(paths, where)
        logs = [episode.path for episode in chosen]
    else:
        logs = find_logs(paths)
    if not logs:
        return
    further = metric or []
    with _store(no_cache=no_cache or bool(further)) as store:
        measured, lost = _measure(logs, store, scope, further, jobs)
        _tell_lost_results(store, measured)
        import polars as pl

        episodes = pl.concat([log.episode() for log in measured])
        if per is Per.EPISODE:
            brief = _brief(episodes, further)
            emit(episodes, "mapreplay.metrics.episodes/1", form, output, text=brief, force=force)
        else:
            steps = [log.steps() for log in measured]
            shown = [*STEP_COLUMNS, *further]
            text = pl.concat(steps).select("file", *shown).rename(SHORT)
            if len(measured) == 1:
                text = text.drop("file")
            emit_parts(steps, "mapreplay.metrics/2", form, output, text=text, force=force)
    if not where:  # otherwise it was said when they were chosen
        tell_same([log.log for log in measured])
        lost += tell_states({log.log: log.state for log in measured})
    read = sum(log.state.steps for log in measured)
    _tell(episodes, scope, read, 0 if no_cache or further else _known_before(measured))
    if unreadable or lost:
        raise typer.Exit(LOST)


@contextmanager
def _store(*, no_cache: bool) -> Iterator[Store]:
    """The cache, or a temporary store."""
    from mapreplay.analysis.cache import user_cache
    from mapreplay.analysis.metrics.store import Store, temporary_store

    kept = user_cache("metrics")
    problem = None if no_cache else kept.problem()
    if problem is not None:
        note(problem)
    if no_cache or problem is not None:
        with temporary_store() as store:
            yield store
        return
    yield Store(kept)
    kept.trim()


def _tell_lost_results(store: Store, measured: list[MeasuredLog]) -> None:
    """Report results that could not be cached, for example because the disk is full."""
    from mapreplay.analysis.cache import user_cache

    lost = sum(not log.kept for log in measured)
    if lost and store.cache == user_cache("metrics"):
        note(f"{store.cache.folder}: cannot be written; {lost} results are not cached")


def _measure(
    logs: list[Path], store: Store, scope: Scope, further: list[str], jobs: int | None
) -> tuple[list[MeasuredLog], int]:
    """The measured logs in order, and the number of unreadable ones; each is reported on stderr."""
    from mapreplay.analysis.metrics.many import MeasuredLog, measure_logs
    from mapreplay.analysis.pool import default_jobs
    from mapreplay.cli.progress import progress_bar

    measured, lost = [], []
    results = measure_logs(
        logs, store, scope=scope, metrics=further, jobs=jobs or default_jobs(len(logs))
    )
    with progress_bar() as bar:
        for result in bar.track(results, len(logs), description="episodes"):
            if isinstance(result, MeasuredLog):
                measured.append(result)
            else:
                lost.append(result)
    if not measured:
        raise lost[0].error
    for failed in lost:
        note(f"unreadable: {failed.error}")
    return sorted(measured, key=lambda result: result.log), len(lost)


def _known_before(measured: Sequence[MeasuredLog]) -> int:
    """Number of logs whose tables were cached before this run; the first of copies may be new."""
    groups: dict[str, list[MeasuredLog]] = {}
    for log in measured:
        groups.setdefault(log.key, []).append(log)
    return sum(len(same) for same in groups.values() if all(log.known for log in same))


def _brief(episodes: pl.DataFrame, further: list[str]) -> pl.DataFrame:
    """A table that is narrow enough for a terminal."""
    import polars as pl

    from mapreplay.analysis.episodes.summary import brief

    frame = brief(episodes).select("floor_plan", "planner", "maps", "outcome", "steps")
    numbers = episodes.select(
        "correct",
        "f1",
        pl.col("ece_pooled").alias("ece"),
        *further,
    )
    return pl.concat([frame, numbers], how="horizontal")


def _tell(episodes: pl.DataFrame, scope: Scope, steps: int, known: int) -> None:
    """Report whether the metrics agree with the recorded ones."""
    wrong = episodes.filter(episodes["disagreements"] > 0)
    if len(wrong):
        file, first = wrong.select("file", "first_disagreement").row(0)
        raise LogError(f"{file}: {first} ({wrong['disagreements'].sum()} values disagree)")
    if scope.as_recorded:
        note(f"{steps} steps agree with the recorded metrics, bit for bit")
    if known:
        note(f"{known} of {len(episodes)} episodes were unchanged and taken from the cache")
