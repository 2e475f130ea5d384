"""`mapreplay run`: simulate episodes and record them."""

from __future__ import annotations

import sys
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mapreplay.cli.options import command_of
from mapreplay.cli.output import LOST, ForceOption, Format, FormatOption, emit, note
from mapreplay.errors import FloorPlanError, UsageError
from mapreplay.files.whole import make_folder
from mapreplay.plugins import PluginKind, find
from mapreplay.text import shell_command

if TYPE_CHECKING:
    from mapreplay.config import RunConfig
    from mapreplay.predictors import Predictor
    from mapreplay.recorders.batch import Task

TRAINED_AT = 0.2
"""Metres per cell of the floor plans that our predictors were trained on."""


def _load_model() -> type[RunConfig]:
    from mapreplay.config import RunConfig

    return RunConfig


RunCommand = command_of(_load_model)


def run(
    context: typer.Context,
    config: Annotated[
        Path | None,
        typer.Option(
            help="TOML file with these options as keys; options given here take precedence."
        ),
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Skip the episodes that are already finished in --out.")
    ] = False,
    view: Annotated[bool, typer.Option("--view", help="Watch the episode live in Rerun.")] = False,
    form: FormatOption = Format.TABLE,
    force: ForceOption = False,
) -> None:
    """Simulate episodes and record every step to MCAP."""
    settings = _settings(config, context.obj)
    find(PluginKind.PLANNERS, settings.planner)  # before the slow imports
    from mapreplay.planners import load_planner
    from mapreplay.predictors import load_predictor

    if resume and settings.out is None:
        raise UsageError("run --resume: give the folder of the stopped run with --out")
    folder = settings.out or Path("runs") / datetime.now().strftime("%Y%m%d-%H%M%S")
    tasks, lost = _plan_tasks(settings, folder, force=force)
    if not tasks:
        raise FloorPlanError(f"{settings.floorplans}: no floor plan is left to run on")
    there = [task.path for task in tasks if task.path.exists()]
    if there and not (resume or force):
        raise UsageError(
            f"{len(there)} of {len(tasks)} logs exist, such as {there[0]}; continue with --resume, "
            "overwrite with --force, or choose another --out"
        )
    # Refuse an unknown or broken planner or predictor before anything runs.
    load_planner(tasks[0].config.planner)
    loaded = load_predictor(tasks[0].predictor, settings.device)
    finished: list[Path] = []
    if resume:
        finished, tasks = _skip_finished(tasks, loaded)
    make_folder(folder)
    try:
        done = _watch(tasks) if view else _record(tasks, settings.jobs)
    except KeyboardInterrupt:
        note(f"{folder}: unfinished logs stay readable as .part; {_how_to_resume(folder)}")
        raise
    logs = sorted(finished + done)
    if logs:
        _print_results(logs, form)
        note(f"logs: {folder}")
        if sys.stdout.isatty():
            note(f"next: {shell_command(['mapreplay', 'view', logs[0]])}")
    failed = len(tasks) - len(done)
    if failed:
        note(f"{failed} of {len(tasks)} episodes failed; {_how_to_resume(folder)}")
        raise typer.Exit(1)
    if lost:
        raise typer.Exit(LOST)


def _settings(path: Path | None, given: dict[str, Any]) -> RunConfig:
    from mapreplay.config import RunConfig, read_toml

    from_file: dict[str, Any] = {}
    if path is not None:
        from_file = read_toml(path)
        RunConfig.of(from_file, str(path))  # so that its errors name the file
    return RunConfig.of(from_file | given, "run")


def _plan_tasks(settings: RunConfig, folder: Path, *, force: bool) -> tuple[list[Task], int]:
    """The episodes to run, and the number of floor plans that cannot be loaded."""
    from mapreplay.floorplans import load_each, open_source, read_ids, select
    from mapreplay.floorplans.plausibility import examine, warning_lines
    from mapreplay.recorders.batch import Task

    source = open_source(settings.floorplans, settings.resolution)
    wanted = read_ids(settings.ids) if settings.ids else None
    selection = select(source, wanted, settings.episodes)
    if selection.missing:
        note(
            f"{len(selection.missing)} ids are not in {settings.floorplans}, "
            f"such as {selection.missing[0]}"
        )
    tasks, refused = [], 0
    doubts = {}
    rounds = -(-(settings.episodes or len(selection.ids)) // max(len(selection.ids), 1))
    for _, floor_plan in load_each(source, selection.ids):
        try:
            if isinstance(floor_plan, FloorPlanError):
                raise floor_plan
            doubts[floor_plan.where] = examine(floor_plan, settings.start_cell)
        except FloorPlanError as error:
            note(f"refused: {error}")
            refused += 1
            continue
        for again in range(rounds):
            episode = settings.episode(source.default_predictor, settings.seed + again)
            tasks.append(
                Task(
                    episode,
                    floor_plan,
                    folder,
                    settings.device,
                    settings.profile,
                    force,
                    settings.weights,
                )
            )
    for line in warning_lines(list(doubts), list(doubts.values())):
        note(line)
    tasks.sort(key=lambda task: task.config.seed)
    others = {task.floor_plan.resolution for task in tasks} - {TRAINED_AT}
    if settings.predictor is None and others and tasks[0].config.predictor != "none":
        note(
            f"predictor {tasks[0].config.predictor} (the default) was trained at {TRAINED_AT} m "
            f"per cell; these floor plans have {', '.join(f'{r:g}' for r in sorted(others))} m"
        )
    return tasks[: settings.episodes], refused + len(selection.missing)


def _skip_finished(tasks: list[Task], predictor: Predictor) -> tuple[list[Path], list[Task]]:
    """The finished logs, and the remaining episodes."""
    from mapreplay.recorders.resume import resume

    resumption = resume(tasks, predictor)
    note(f"{len(resumption.finished)} of {len(tasks)} episodes are already finished")
    return resumption.finished, resumption.tasks


def _how_to_resume(folder: Path) -> str:
    return f"to resume, repeat the command with {shell_command(['--resume', '--out', folder])}"


def _record(tasks: list[Task], jobs: int) -> list[Path]:
    """Record with a progress bar; returns the paths of the finished logs."""
    from contextlib import closing

    from mapreplay.cli.progress import progress_bar
    from mapreplay.recorders.batch import Done, Failed, record_all

    done: list[Path] = []
    with (
        closing(record_all(tasks, jobs)) as reports,
        progress_bar("steps", "coverage", "episode") as bar,
    ):
        whole = bar.add_task("episodes", total=len(tasks), steps="", coverage="", episode="")
        for report in reports:
            name = tasks[report.task].floor_plan.id
            if isinstance(report, Done):
                done.append(report.path)
            elif isinstance(report, Failed):
                note(f"failed: {name}: {report.reason}")
            else:
                target = tasks[report.task].config.coverage
                bar.update(
                    whole,
                    completed=len(done) + min(report.coverage / target, 1.0),
                    steps=f"step {report.step}",
                    coverage=f"coverage {report.coverage:.2f}",
                    episode=name[:24],
                )
                continue
            bar.update(whole, completed=len(done))
    return done


def _watch(tasks: list[Task]) -> list[Path]:
    """Record one episode after the other, showing each step as it happens."""
    from mapreplay.episode import prepare_episode, record
    from mapreplay.predictors import load_predictor
    from mapreplay.recorders.log.writer import EpisodeWriter
    from mapreplay.recorders.viewer.servers import LiveView, require_display_here

    try:
        require_display_here()
    except UsageError:
        raise UsageError(
            "run --view: there is no display; run without it, then `mapreplay view LOG --web`"
        ) from None
    done = []
    for task in tasks:
        predictor = load_predictor(task.predictor, task.device)
        episode = prepare_episode(task.config, task.floor_plan, predictor=predictor)
        path = task.path
        with (
            LiveView(episode.header) as live,  # first: without a display nothing is recorded
            EpisodeWriter(path, episode.header, profile=task.profile, force=task.force) as writer,
        ):
            record(episode, writer, live)
        done.append(path)
    return done


def _print_results(paths: list[Path], form: Format) -> None:
    from mapreplay.analysis.episodes.summary import brief, episode_frame, episode_row

    frame = episode_frame([episode_row(path) for path in paths])
    emit(frame, "mapreplay.episodes/1", form, text=brief(frame))
