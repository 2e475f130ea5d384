"""Arguments that the verbs on logs share: paths and `--where`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from mapreplay.cli.output import LOST, note
from mapreplay.errors import UsageError

if TYPE_CHECKING:
    from mapreplay.analysis.episodes.corpus import LoggedEpisode
    from mapreplay.analysis.episodes.summary import EpisodeRow
    from mapreplay.recorders.log.reader import EpisodeLog
    from mapreplay.recorders.log.state import LogState


PathsArgument = Annotated[
    list[Path], typer.Argument(help="Logs, folders of logs, or globs.", show_default=False)
]
WeightsOption = Annotated[
    list[Path] | None,
    typer.Option(
        "--predictor",
        metavar="FILE",
        help="Weights of the log's predictor if it is not registered; can be repeated.",
    ),
]
WhereOption = Annotated[
    list[str] | None,
    typer.Option(
        "--where",
        help="Only episodes that match, such as outcome=sealed_in or steps>300; can be repeated.",
    ),
]


def choose(paths: list[Path], where: list[str] | None) -> tuple[list[EpisodeRow], int]:
    """The rows of `read_episodes`, and the number of files that are unreadable or incomplete.

    Raises:
        LogError: there is no log, or none can be read.
    """
    episodes, unreadable = read_episodes(paths, where)
    return [episode.row for episode in episodes], unreadable


def read_episodes(
    paths: list[Path], where: list[str] | None, *, parallel: bool = False
) -> tuple[list[LoggedEpisode], int]:
    """The episodes at `paths` that satisfy all conditions, in order, and the number of files that
    are unreadable or incomplete; these are reported on stderr.

    Args:
        paths: Logs, folders and patterns.
        where: The conditions.
        parallel: Read many logs in several processes.

    Raises:
        LogError: there is no log, or none can be read.
    """
    from mapreplay.recorders.log.find import find_logs

    logs = find_logs(paths)  # before the slow imports
    from mapreplay.analysis.episodes.corpus import LoggedEpisode, read_corpus
    from mapreplay.analysis.episodes.summary import RowFilter
    from mapreplay.analysis.pool import default_jobs
    from mapreplay.cli.progress import progress_bar

    jobs = default_jobs(len(logs) // LOGS_A_PIECE) if parallel else 1
    conditions = [RowFilter.parse(text) for text in where or []]
    episodes, unreadable = [], []
    with progress_bar() as bar:
        for found in bar.track(read_corpus(logs, jobs), len(logs), description="episodes"):
            if isinstance(found, LoggedEpisode):
                episodes.append(found)
            else:
                unreadable.append(found)
    if unreadable and not episodes:
        raise unreadable[0].error
    for failed in unreadable:
        note(f"unreadable: {failed.error}")
    episodes.sort(key=lambda episode: episode.path)
    chosen = [e for e in episodes if all(c.holds(e.row) for c in conditions)]
    if episodes and not chosen:
        note(f"none of {len(episodes)} episodes matches --where")
    branches = sum(e.row.branch != "" for e in chosen)
    if 0 < branches < len(chosen):
        note(f"{branches} of {len(chosen)} episodes are branches; without them: --where branch=")
    tell_same([episode.path for episode in chosen])
    return chosen, len(unreadable) + tell_states({e.path: e.state for e in chosen})


LOGS_A_PIECE: Final = 8
"""Logs that are one piece of work for `default_jobs`: a log takes a few milliseconds."""
SHOWN: Final = 10
"""Maximum number of incomplete or duplicate logs that are named."""


def tell_states(states: Mapping[Path, LogState]) -> int:
    """Report the incomplete logs on stderr; returns their number."""
    lines = [f"{path}: {state}" for path, state in states.items() if not state.whole]
    _tell(lines, "logs that are not whole")
    return len(lines)


def tell_same(logs: Sequence[Path]) -> dict[Path, Path]:
    """Report on stderr the logs that are copies of an earlier one; returns copy -> original."""
    from mapreplay.recorders.log.find import find_same

    same = find_same(logs)
    _tell([f"{log}: the same file as {first}" for log, first in same.items()], "copies")
    return same


def _tell(lines: Sequence[str], what: str) -> None:
    for line in lines[:SHOWN]:
        note(line)
    if len(lines) > SHOWN:
        note(f"and {len(lines) - SHOWN} more {what}")


def end_with(logs: Iterable[EpisodeLog]) -> None:
    """End a verb on these logs, with exit code 3 if one of them is incomplete."""
    if not all(log.state.whole for log in logs):
        raise typer.Exit(LOST)


def open_log(path: Path) -> EpisodeLog:
    """The log at `path`, or the only one in that folder or of that pattern.

    An incomplete log is reported on stderr; see `end_with`.

    Raises:
        LogError: there is none, or it cannot be read.
        UsageError: there are several.
    """
    from mapreplay.recorders.log.find import find_logs

    logs = find_logs([path])
    if len(logs) > 1:
        raise UsageError(f"{path}: {len(logs)} logs; name one of them, such as {logs[0]}")
    from mapreplay.recorders.log.reader import EpisodeLog

    log = EpisodeLog(logs[0])
    tell_states({log.path: log.state})
    return log


LogArgument = Annotated[
    Path, typer.Argument(help="The log, or a folder with one log.", show_default=False)
]
