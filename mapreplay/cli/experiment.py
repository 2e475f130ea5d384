"""`mapreplay experiment`: the paper's simulations, tables and figures, from one configuration."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mapreplay.cli.output import note, say
from mapreplay.errors import UsageError
from mapreplay.files.whole import make_folder

if TYPE_CHECKING:
    from mapreplay.analysis.experiment.config import Dataset, ExperimentConfig
    from mapreplay.analysis.experiment.jobs import Job, Shelf
    from mapreplay.floorplan import FloorPlan


def experiment(
    config: Annotated[
        str,
        typer.Argument(help="TOML file, or a name: paper, validation, beaten, beaten-80-85, tiny."),
    ],
    out: Annotated[
        Path,
        typer.Option("--out", "-o", help="Folder for the results; resumes where it stopped."),
    ],
    floorplans: Annotated[
        list[str] | None,
        typer.Option(help="NAME=SPEC: source of the floor plans of a dataset; can be repeated."),
    ] = None,
    dataset: Annotated[
        list[str] | None, typer.Option(help="Only this dataset; can be repeated.")
    ] = None,
    jobs: Annotated[
        int | None, typer.Option(min=1, help="Number of processes (default: all cores).")
    ] = None,
    report_only: Annotated[
        bool, typer.Option("--report-only", help="Recreate tables and figures without simulating.")
    ] = False,
    keep_logs: Annotated[
        bool, typer.Option("--keep-logs", help="Keep every step, and not only the scalars.")
    ] = False,
    docs: Annotated[
        Path | None,
        typer.Option(help="Folder in which to update the generated parts of results.md."),
    ] = None,
) -> None:
    """Run planners on floor plans with and without prediction; tables and figures with intervals.

    Every finished episode is kept as a log: repeat the command to resume after a stop.
    """
    from mapreplay.analysis.experiment.config import ExperimentConfig
    from mapreplay.analysis.experiment.origin import check_settings
    from mapreplay.analysis.experiment.report import write_report

    settings = ExperimentConfig.read(_find(config)).only(tuple(dataset or ()))
    check_settings(out, settings)  # before floor plans are loaded
    if not report_only:
        from mapreplay.analysis.pool import cores

        places = _places(floorplans or [], settings)
        _make(settings, places, out, jobs or cores(), whole=keep_logs)
    for path in write_report(out, docs, Path(config).stem):
        note(f"wrote {path}")
    say((out / "results.md").read_text(encoding="utf-8"))


def _find(name: str) -> Path:
    """The configuration file: a path, or the name of one that comes with the package."""
    from mapreplay.analysis.experiment.config import shipped_configs

    path = Path(name)
    if path.is_file():  # and not a folder of results called like the experiment
        return path
    shipped = shipped_configs()
    if name in shipped:
        return shipped[name]
    raise UsageError(f"{name}: no such file, and no experiment; there are {', '.join(shipped)}")


def _places(given: list[str], settings: ExperimentConfig) -> dict[str, str]:
    names = {d.name for d in settings.datasets}
    places = {}
    for item in given:
        name, equals, spec = item.partition("=")
        if not equals or name not in names:
            raise UsageError(
                f"--floorplans {item}: expected NAME=SPEC, NAME one of {', '.join(sorted(names))}"
            )
        places[name] = spec
    return places


def _make(
    settings: ExperimentConfig, places: dict[str, str], out: Path, processes: int, *, whole: bool
) -> None:
    """All that is measured, into `out`."""
    from mapreplay.analysis.experiment.jobs import Shelf, jobs_of
    from mapreplay.analysis.experiment.sweep import setting_folder
    from mapreplay.floorplans.plausibility import examine, warning_lines

    plans = {d.name: d.load(places.get(d.name)) for d in settings.datasets}
    for of_dataset in plans.values():
        for line in warning_lines([p.where for p in of_dataset], list(map(examine, of_dataset))):
            note(line)
    _keep_settings(settings, plans, out)

    def simulate(what: ExperimentConfig, folder: Path) -> None:
        jobs = [job for d in what.datasets for job in jobs_of(what, d, plans[d.name])]
        # First runs of all datasets first: what was stopped is a smaller experiment on all.
        jobs.sort(key=lambda job: job.config.seed)
        _simulate(jobs, Shelf(folder, whole), processes)

    for d in settings.datasets:
        _measure_curve(settings, d, plans[d.name], out)
    if settings.example is not None:
        _record_example(settings, plans[settings.example][0], out)
    simulate(settings, out)
    for one in settings.swept():
        simulate(one, setting_folder(out, one.delta_free, one.delta_occupied))


def _keep_settings(
    settings: ExperimentConfig, plans: dict[str, list[FloorPlan]], out: Path
) -> None:
    """Write down what `out` is of, so that no other experiment is mixed with it."""
    from mapreplay.analysis.experiment.origin import ExperimentOrigin, keep_origin

    make_folder(out)
    for d in settings.datasets:
        keep_origin(out, d.name, ExperimentOrigin.of(settings, d, plans[d.name]))


def _simulate(jobs: list[Job], shelf: Shelf, processes: int) -> None:
    from contextlib import closing

    from mapreplay.analysis.experiment.runner import run_jobs
    from mapreplay.cli.progress import TimeLeft, progress_bar

    left = [job for job in jobs if not shelf.has(job)]
    total, done = len(jobs), len(jobs) - len(left)
    note(f"{shelf.folder}: {done} of {total} simulations are there")
    with closing(run_jobs(left, shelf, processes)) as finished, progress_bar("episode") as bar:
        task = bar.add_task("simulations", total=total, completed=done, episode="")
        lines = TimeLeft("simulations", done, total)
        for name in finished:
            lines.advance()
            bar.update(task, advance=1, episode=name)


def _measure_curve(
    settings: ExperimentConfig, dataset: Dataset, plans: list[FloorPlan], out: Path
) -> None:
    from mapreplay.analysis.experiment.curve import load_curve, measure_curve
    from mapreplay.mapping import Thresholds
    from mapreplay.predictors import load_predictor

    if not dataset.curve_plans:
        return
    predictor = load_predictor(dataset.predictor)
    path = out / f"curve-{dataset.name}.npz"
    thresholds = Thresholds(settings.delta_free, settings.delta_occupied)
    chosen = plans[: dataset.curve_plans]
    if path.exists():
        there = load_curve(path)
        same_plans = [plan.floor_plan for plan in there.plans] == [plan.id for plan in chosen]
        if same_plans and there.predictor == predictor.identity:
            return
    measure_curve(dataset.name, chosen, predictor, thresholds).save(out)
    note(f"wrote {path}")


def _record_example(settings: ExperimentConfig, plan: FloorPlan, out: Path) -> None:
    from mapreplay.analysis.experiment.example import record_example
    from mapreplay.predictors import load_predictor

    name = next(d.predictor for d in settings.datasets if d.name == settings.example)
    note(f"wrote {record_example(plan, load_predictor(name), out)}")
