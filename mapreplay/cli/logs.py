"""The arguments that every verb on logs has: paths, and `--where`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mapreplay.cli.output import note
from mapreplay.errors import LogError

if TYPE_CHECKING:
    from mapreplay.analysis.episodes import EpisodeRow

LOST = 3

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
    return [row for row in rows if all(c.holds(row) for c in conditions)], len(unreadable)
