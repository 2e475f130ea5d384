"""`mapreplay bench`: speed of simulator, predictor and log; time that a predictor saves."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated

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
    say,
)
from mapreplay.errors import FloorPlanError, UsageError
from mapreplay.files.whole import write_whole

if TYPE_CHECKING:
    from mapreplay.analysis.benchmarks.simulator import Saving
    from mapreplay.analysis.limits.measure import PlanLimit
    from mapreplay.floorplan import FloorPlan

bench_app = typer.Typer(
    invoke_without_command=True,
    rich_markup_mode=None,
    help="Measure speed, and the mapping time that a predictor saves.",
)


@bench_app.callback()
def _bench(context: typer.Context) -> None:
    if context.invoked_subcommand is None:
        say(context.get_help())


SpecOption = Annotated[
    str, typer.Option("--floorplans", help="Source, see `mapreplay floorplans --help`.")
]
IdsOption = Annotated[Path | None, typer.Option(help="File with one floor-plan ID per line.")]


@bench_app.command()
def sim(
    floorplans: SpecOption = "procedural:60000-60099",
    ids: IdsOption = None,
    limit: Annotated[int, typer.Option(min=1, help="Maximum number of floor plans.")] = 100,
    form: FormatOption = Format.TABLE,
) -> None:
    """Simulated steps per second on one core, without recording.

    Nearest Frontier with observed planning and target maps.
    """
    import polars as pl

    from mapreplay.analysis.benchmarks.simulator import median_rate, time_simulation

    timings = list(time_simulation(_plans(floorplans, ids, limit)))
    rows = [asdict(t) | {"steps_per_second": t.steps_per_second} for t in timings]
    if form is not Format.TABLE:
        emit(pl.DataFrame(rows), "mapreplay.bench.sim/1", form)
    else:
        say(
            f"{median_rate(timings):.0f} steps/s, median of {len(timings)} episodes "
            f"({sum(t.steps for t in timings)} steps in {sum(t.seconds for t in timings):.1f} s)"
        )


@bench_app.command()
def view(
    steps: Annotated[int, typer.Option(min=2, help="Maximum number of steps.")] = 1000,
    size: Annotated[int, typer.Option(help="Cells per side: 64, 128, 256 or 512.")] = 128,
    predictor: Annotated[str, typer.Option(help="d1, d2, or a .safetensors file.")] = "d1",
    rounds: Annotated[int, typer.Option(min=1, help="Repetitions; the best is printed.")] = 3,
    form: FormatOption = Format.TABLE,
) -> None:
    """Time to convert a log for the viewer, compared with Rerun's own importer, and its size."""
    import polars as pl

    from mapreplay.analysis.benchmarks.view import floor_plan_of, measure_view, record_long
    from mapreplay.predictors import load_predictor

    with TemporaryDirectory() as folder:
        log = Path(folder) / "episode.mcap"
        plan = floor_plan_of(size)
        count = record_long(log, plan, steps, load_predictor(predictor, "cpu"))
        note(f"{count} steps of {size} x {size} cells, predictor {predictor}")
        rows = [asdict(row) for row in measure_view(log, rounds)]
    emit(pl.DataFrame(rows), "mapreplay.bench.view/1", form)


@bench_app.command()
def savings(
    predictor: Annotated[str, typer.Option(help="Predictor name or .safetensors file.")],
    floorplans: SpecOption = "procedural:50000-50049",
    ids: IdsOption = None,
    limit: Annotated[int, typer.Option(min=1, help="Maximum number of floor plans.")] = 50,
    planner: Annotated[
        str, typer.Option(help="Planner of the episodes with prediction.")
    ] = "nearest",
    device: Annotated[str, typer.Option(help="Device for the predictor: cpu, cuda, ...")] = "cpu",
    form: FormatOption = Format.TABLE,
) -> None:
    """Mapping time that a predictor saves, and the quality of its predictions.

    PLANNER on fused maps with fail-safe, compared with Nearest Frontier on observed maps. The
    predictions are scored on the maps of the latter, which are the same for every predictor.
    """
    import polars as pl

    from mapreplay.analysis.benchmarks.simulator import mean_saving, measure_savings
    from mapreplay.analysis.reporting.wording import counted, percent, reduction, with_interval
    from mapreplay.cli.progress import progress_bar
    from mapreplay.predictors import load_predictor

    loaded = load_predictor(predictor, device)
    plans = list(_plans(floorplans, ids, limit))
    with progress_bar() as bar:
        rows = list(
            bar.track(
                measure_savings(plans, planner, loaded),
                len(plans),
                description=f"{predictor} episodes",
            )
        )
    emit(pl.DataFrame([_columns(row) for row in rows]), "mapreplay.bench.savings/1", form)
    if not rows:
        raise FloorPlanError(f"{floorplans}: no floor plan to measure on")
    mean = mean_saving(rows)
    note(
        f"{counted(mean.reduction.plans, 'floor plan')}: mapping time {reduction(mean.reduction)}, "
        f"correct coverage {with_interval(mean.correct, 3)}, F1 {with_interval(mean.f1, 3)}"
    )
    note(
        f"predictions of unobserved cells: ECE {percent(mean.ece)}, log loss "
        f"{with_interval(mean.log_loss, 3)} nats, confident about {percent(mean.decided)}"
    )


def _columns(row: Saving) -> dict[str, object]:
    from mapreplay.analysis.metrics.calibration import calibration_scores

    scores = calibration_scores(row.counts)
    return {
        "floor_plan": row.floor_plan,
        "reference_time": row.reference_time,
        "time": row.time,
        "reduction": row.reduction,
        "outcome": row.outcome,
        "correct": row.correct,
        "f1": row.f1,
        "ece": scores.ece,
        "log_loss": scores.log_loss,
    }


@bench_app.command()
def limits(
    floorplans: SpecOption = "procedural:50000-50049",
    ids: IdsOption = None,
    limit: Annotated[int, typer.Option(min=1, help="Maximum number of floor plans.")] = 50,
    predictor: Annotated[
        list[str] | None,
        typer.Option(
            help="Also bound agents that know the predictions of this predictor; can be repeated."
        ),
    ] = None,
    infill: Annotated[
        list[int] | None,
        typer.Option(
            min=1,
            help="Also bound predictions that are correct within this many cells; can be repeated.",
        ),
    ] = None,
    target: Annotated[float, typer.Option(help="Target coverage, above 0 and at most 1.")] = 0.98,
    delta_free: Annotated[float, typer.Option(min=0, max=1)] = 0.93,
    delta_occupied: Annotated[float, typer.Option(min=0, max=1)] = 0.95,
    jobs: Annotated[int, typer.Option(min=1, help="Number of processes.")] = 1,
    markdown: Annotated[
        Path | None, typer.Option(help="Write the table to this file as Markdown.")
    ] = None,
    form: FormatOption = Format.TABLE,
    output: OutputOption = None,
    force: ForceOption = False,
) -> None:
    """Limits of the mapping time: oracle tours (full map) and proven lower bounds.

    With the reduction compared to Nearest Frontier on observed maps. Results are cached, so that
    a stopped run resumes where it stopped.
    """
    check_outputs(output, markdown, force=force)
    if not 0 < target <= 1:
        raise UsageError(f"--target {target}: should be above 0 and at most 1")
    from mapreplay.analysis.limits.measure import (
        Question,
        limits_frame,
        limits_markdown,
        limits_summary,
        measure_limits,
    )
    from mapreplay.cli.progress import progress_bar
    from mapreplay.mapping import Thresholds
    from mapreplay.predictors import load_predictor

    for name in predictor or ():
        load_predictor(name)  # fail before hours of work
    thresholds = Thresholds(delta_free, delta_occupied)
    question = Question(target, thresholds, tuple(predictor or ()), tuple(infill or ()))
    plans = list(_plans(floorplans, ids, limit))
    rows: list[PlanLimit] = []
    failed = 0
    with progress_bar() as bar:
        found = measure_limits(plans, question, jobs)
        for result in bar.track(found, len(plans), description="floor plans"):
            if isinstance(result, list):
                rows += result
            else:
                note(f"left out: {result}")
                failed += 1
    if not rows:
        raise FloorPlanError(f"{floorplans}: no floor plan to measure on")
    order = {plan.id: number for number, plan in enumerate(plans)}
    rows.sort(
        key=lambda row: order[row.floor_plan]
    )  # they arrive in the order in which they finished
    if markdown is not None:
        write_whole(markdown, limits_markdown(rows).encode(), force=force)
        note(f"written: {markdown}")
    emit(limits_frame(rows), "mapreplay.bench.limits/1", form, output, text=limits_summary(rows),
         force=force)  # fmt: skip
    if failed:
        raise typer.Exit(LOST)


@bench_app.command()
def predict(
    predictor: Annotated[str, typer.Option(help="d1, d2, or a .safetensors file.")] = "d1",
    size: Annotated[int, typer.Option(min=8, help="Cells per side, a multiple of 8.")] = 64,
    maps: Annotated[int, typer.Option(min=1, help="Observed maps to predict.")] = 64,
    rounds: Annotated[int, typer.Option(min=1, help="Repetitions; the best is printed.")] = 5,
    form: FormatOption = Format.TABLE,
) -> None:
    """Prediction time per map on one core, compared with PyTorch, and numerical differences."""
    if size % 8:
        raise UsageError(f"--size {size}: not a multiple of 8")
    import polars as pl

    from mapreplay.analysis.benchmarks.predict import measure_prediction
    from mapreplay.predictors.trained import WEIGHTS

    named = WEIGHTS / f"{predictor}.safetensors"
    weights = named if named.exists() else Path(predictor)
    lines = [asdict(line) for line in measure_prediction(weights, size, maps, rounds)]
    text = pl.DataFrame(
        [
            {
                "how": line["how"],
                "ms per map": f"{line['ms_per_map']:.2f}",
                "maps/s": f"{line['maps_per_second']:.0f}",
                "speed-up": f"{line['speed_up']:.2f}",
                "max diff": f"{line['largest_difference']:.1e}",
                "uint8 that differ": f"{line['quanta']} of {maps * size * size}",
            }
            for line in lines
        ]
    )
    emit(pl.DataFrame(lines), "mapreplay.bench.predict/1", form, text=text)


@bench_app.command()
def log(
    floorplans: SpecOption = "procedural:60000-60099",
    ids: IdsOption = None,
    steps: Annotated[int, typer.Option(min=2, help="Maximum number of steps per episode.")] = 300,
    rounds: Annotated[int, typer.Option(min=1, help="Repetitions; medians are printed.")] = 9,
    predictor: Annotated[
        str, typer.Option(help="blur (cheap), or a predictor name or file.")
    ] = "blur",
    folder: Annotated[
        Path | None,
        typer.Option(
            exists=True,
            file_okay=False,
            help="Folder for the files; use one in memory to exclude the disk.",
        ),
    ] = None,
    form: FormatOption = Format.TABLE,
) -> None:
    """Recording, reading and size of a log, compared with other libraries.

    On one floor plan and on four in a square. Recording is timed between opening and closing the
    file; ours includes flushing it to the disk every 20 steps. Reading is timed from opening to
    the last array, ours with all checks. `ours` is our value divided by that of the row: below 1
    we are better.
    """
    import polars as pl

    from mapreplay.analysis.benchmarks.log import four_in_a_square, measure_log, simulate

    plans = list(_plans(floorplans, ids, 4))
    if not plans:
        raise FloorPlanError(f"{floorplans}: no floor plan to measure on")
    places = plans[:1]
    if len(plans) == 4 and len({plan.shape for plan in plans}) == 1:
        places.append(four_in_a_square(plans))
    else:
        note("the larger map is left out: it needs four floor plans of the same size")
    rows = []
    for place in places:
        run = simulate(place, predictor, steps)
        height, width = place.shape
        data = f"{height} x {width}, {len(run.steps)} steps, {predictor}"
        rows += [{"data": data, **asdict(line)} for line in measure_log(run, rounds, folder)]
    for how in sorted({row["how"] for row in rows if row["value"] is None}):
        note(f"not installed: {how.partition(',')[0]}")
    emit(pl.DataFrame(rows), "mapreplay.bench.log/1", form)


def _plans(spec: str, ids: Path | None, limit: int) -> Iterator[FloorPlan]:
    from mapreplay.floorplans import load_each, open_source, read_ids, select
    from mapreplay.floorplans.plausibility import examine, warning_lines

    source = open_source(spec)
    wanted = read_ids(ids) if ids else None
    plans = []
    for _, plan in load_each(source, select(source, wanted, limit).ids):
        if isinstance(plan, FloorPlanError):
            note(f"refused: {plan}")
        else:
            plans.append(plan)
    for line in warning_lines([p.where for p in plans], [examine(p) for p in plans]):
        note(line)
    yield from plans
