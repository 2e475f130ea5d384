"""The arguments that every verb on logs has: paths, and `--where`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mapreplay.cli.output import note
from mapreplay.errors import LogError, UsageError

if TYPE_CHECKING:
    from mapreplay.analysis.episodes import EpisodeRow
    from mapreplay.recorders.log import EpisodeLog


PathsArgument = Annotated[
    list[Path], typer.Argument(help="Logs, folders of logs, or globs.", show_default=False)
]
WhereOption = Annotated[
    list[str] | None,
    typer.Option("--where", help="Only episodes like this: outcome=sealed_in, steps>300, ..."),
]


def choose(paths: list[Path], where: list[str] | None) -> tuple[list[EpisodeRow], int]:
    """The episodes found at `paths` that satisfy all conditions, and how many files could not
    be read; each of those is named on stderr.

    Raises:
        LogError: nothing is there, or nothing that can be read.
    """
    from mapreplay.analysis.episodes import Condition, episode_row
    from mapreplay.recorders.log import find_logs

    conditions = [Condition.parse(text) for text in where or []]
    rows, unreadable = [], []
    for path in find_logs(paths):
        try:
            rows.append(episode_row(path))
        except LogError as error:
            unreadable.append(str(error))
    if unreadable and not rows:
        raise LogError(unreadable[0])
    for line in unreadable:
        note(f"unreadable: {line}")
    chosen = [row for row in rows if all(c.holds(row) for c in conditions)]
    if rows and not chosen:
        note(f"none of {len(rows)} episodes is like that")
    return chosen, len(unreadable)


def open_log(path: Path) -> EpisodeLog:
    """The log at `path`, or the only one in that folder or of that pattern.

    That it is unfinished is said on stderr.

    Raises:
        LogError: there is none, or it cannot be read.
        UsageError: there are several.
    """
    from mapreplay.recorders.log import EpisodeLog, find_logs

    logs = find_logs([path])
    if len(logs) > 1:
        raise UsageError(f"{path}: {len(logs)} logs; name one of them, such as {logs[0]}")
    log = EpisodeLog(logs[0])
    if not log.finished:
        note(f"{log.path}: unfinished; {len(log)} steps can be read")
    return log


LogArgument = Annotated[
    Path, typer.Argument(help="The log, or a folder with one log.", show_default=False)
]
