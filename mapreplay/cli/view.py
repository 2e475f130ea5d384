"""`mapreplay view`: replay episodes in Rerun, or draw them without it."""

from __future__ import annotations

import re
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mapreplay.cli.logs import end_with, open_log
from mapreplay.cli.output import LOST, ForceOption, note
from mapreplay.errors import LogError, UsageError
from mapreplay.text import shell_command

if TYPE_CHECKING:
    from mapreplay.recorders.log.reader import EpisodeLog
    from mapreplay.recorders.pictures.annotations import Mark
    from mapreplay.recorders.pictures.dashboard import Film
    from mapreplay.recorders.pictures.replay import Replay


class ThemeName(StrEnum):
    """Background of a picture."""

    LIGHT = "light"
    DARK = "dark"


def view(
    logs: Annotated[
        list[Path],
        typer.Argument(
            help="One or more logs: shows the maps of two and the curves of all.",
            show_default=False,
        ),
    ],
    maps: Annotated[
        str | None,
        typer.Option(help="Logs whose maps are shown, by letter, such as A,C (default: A,B)."),
    ] = None,
    step: Annotated[
        int | None, typer.Option(help="Start at this step; -1 is the last.", show_default=False)
    ] = None,
    diagnose: Annotated[
        bool,
        typer.Option(
            "--diagnose", help="Mark the cells that sealed the agent in, and start at that step."
        ),
    ] = False,
    save: Annotated[Path | None, typer.Option(help="Write a .rrd file with this layout.")] = None,
    web: Annotated[bool, typer.Option("--web", help="Show in a browser on this machine.")] = False,
    png: Annotated[
        Path | None, typer.Option(help="Draw --step (default: the last) as PNG, without a viewer.")
    ] = None,
    gif: Annotated[Path | None, typer.Option(help="Draw all steps as GIF.")] = None,
    mp4: Annotated[Path | None, typer.Option(help="Draw all steps as MP4.")] = None,
    every: Annotated[int, typer.Option(min=1, help="Draw every Nth step of a GIF or MP4.")] = 1,
    size: Annotated[str, typer.Option(help="Size of the picture or film in pixels.")] = "1280x720",
    theme: Annotated[
        ThemeName, typer.Option(help="Theme of the picture or film.")
    ] = ThemeName.LIGHT,
    force: ForceOption = False,
) -> None:
    """Replay episodes in Rerun, or draw them as PNG, GIF or MP4.

    Shows the observed, predicted, fused and error maps side by side, with rays, trail, frontier,
    target and curves on one timeline.
    """
    targets = {"--save": save, "--web": web or None, "--png": png, "--gif": gif, "--mp4": mp4}
    asked = [name for name, target in targets.items() if target is not None]
    if len(asked) > 1:
        raise UsageError(f"view: choose one of {', '.join(asked)}")
    if step is not None and asked and asked != ["--png"]:
        raise UsageError(f"view: --step applies to the window and --png, not to {asked[0]}")
    opened, unreadable = _open(logs)
    chosen = _chosen(maps, len(opened))
    at = None if step is None else _step(step, [opened[number] for number in chosen])
    marks, sealed_at = _diagnosed(opened, chosen) if diagnose else ([], None)
    at = sealed_at if at is None else at
    if png or gif or mp4:
        film = _film([opened[number] for number in chosen], size, theme, marks)
        _draw(film, at, png, gif, mp4, every, force=force)
        _end(opened, unreadable)
        return
    from mapreplay.recorders.pictures.replay import replays_of
    from mapreplay.recorders.viewer.servers import require_display_here

    if not asked:
        require_display_here()  # before all the reading
    by_log = dict(zip(chosen, marks, strict=False))
    all_marks = [by_log.get(number, []) for number in range(len(opened))]
    _show(replays_of(opened, all_marks, chosen), at, save, web=web, force=force)
    _end(opened, unreadable)


def _end(opened: list[EpisodeLog], unreadable: int) -> None:
    end_with(opened)
    if unreadable:
        raise typer.Exit(LOST)


def _open(paths: list[Path]) -> tuple[list[EpisodeLog], int]:
    """The logs at the paths, in their order, and the number of unreadable ones, which are
    reported on stderr.
    """
    from mapreplay.recorders.log.find import find_each

    opened: list[EpisodeLog] = []
    problems: list[LogError] = []
    for path in (log for logs in find_each(paths) for log in logs):
        try:
            opened.append(open_log(path))
        except LogError as error:
            problems.append(error)
    if problems and not opened:
        raise problems[0]
    for problem in problems:
        note(f"unreadable: {problem}")
    return opened, len(problems)


def _chosen(maps: str | None, count: int) -> list[int]:
    """The numbers of the logs whose maps are shown."""
    from mapreplay.recorders.pictures.replay import LETTERS

    if maps is None:
        return list(range(min(2, count)))
    letters = re.split(r"[,\s]+", maps.strip().upper())
    known = LETTERS[:count]
    for letter in letters:
        if len(letter) != 1 or letter not in known:
            raise UsageError(f"--maps {maps}: the logs are {known[0]} to {known[-1]}")
    return sorted({known.index(letter) for letter in letters})


def _step(step: int, logs: list[EpisodeLog]) -> int:
    count = max(log.last for log in logs) + 1
    if not -count <= step < count:
        raise UsageError(f"--step {step}: {logs[0].path} has steps 0 to {count - 1}")
    return step % count


def _diagnosed(logs: list[EpisodeLog], chosen: list[int]) -> tuple[list[list[Mark]], int | None]:
    """The marks of each log whose maps are shown, and the step of the first sealing."""
    from mapreplay.analysis.diagnosis.annotations import marks_of
    from mapreplay.analysis.diagnosis.diagnosis import diagnose

    found = [diagnose(logs[number]) for number in chosen]
    for number, diagnosis in zip(chosen, found, strict=True):
        if not diagnosis.sealings:
            note(f"{logs[number].path}: never sealed in, so that there is nothing to mark")
    steps = [sealing.first_step for diagnosis in found for sealing in diagnosis.sealings]
    return [marks_of(diagnosis) for diagnosis in found], min(steps, default=None)


def _film(logs: list[EpisodeLog], size: str, theme: ThemeName, marks: list[list[Mark]]) -> Film:
    from mapreplay.recorders.pictures.dashboard import Film, Filmed
    from mapreplay.recorders.pictures.palette import THEMES

    match = re.fullmatch(r"(\d{1,5})x(\d{1,5})", size)
    if match is None:
        raise UsageError(f"--size {size}: should be WIDTHxHEIGHT, such as 1920x1080")
    pixels = (int(match[1]), int(match[2]))
    drawn = marks or [[] for _ in logs]
    filmed = [Filmed.of(log, of) for log, of in zip(logs, drawn, strict=True)]
    return Film(filmed, pixels, THEMES[theme])


def _draw(
    film: Film,
    step: int | None,
    png: Path | None,
    gif: Path | None,
    mp4: Path | None,
    every: int,
    *,
    force: bool,
) -> None:
    from mapreplay.recorders.pictures.animation import save_gif, save_mp4, save_png

    if png:
        save_png(png, film, film.last if step is None else step, force=force)
    elif gif:
        save_gif(gif, film, every, force=force)
    elif mp4:
        save_mp4(mp4, film, every, force=force)
    note(f"written: {png or gif or mp4}")


def _show(
    replays: list[Replay], step: int | None, save: Path | None, *, web: bool, force: bool
) -> None:
    from mapreplay.recorders.viewer.recording import save_rrd
    from mapreplay.recorders.viewer.servers import open_viewer, serve_web

    if save is not None:
        save_rrd(save, replays, force=force)
        note(f"written: {save}; open it with: {shell_command(['rerun', save])}")
    elif web:
        with serve_web(replays) as served:
            typer.echo(served.address)
            note("press Ctrl-C to end")
            served.wait()
    else:
        open_viewer(replays, step=step)
