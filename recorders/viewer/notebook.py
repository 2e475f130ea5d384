"""An episode in a notebook cell: Rerun's own widget with our layout."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING

from mapreplay.errors import MapreplayError
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.recorders.pictures.replay import replays_of
from mapreplay.recorders.viewer.layout import layout
from mapreplay.recorders.viewer.recording import new_recording, panes_of, send

if TYPE_CHECKING:
    from rerun.notebook import Viewer


def show(
    *logs: EpisodeLog | str | os.PathLike[str],
    maps: Sequence[int] = (),
    width: int = 1280,
    height: int = 720,
) -> Viewer:
    """Show one log, or several as ``mapreplay view`` does, in a notebook.

    ::

        mapreplay.show("runs/a.mcap")
        mapreplay.show(log_a, log_b)

    Args:
        logs: logs or their paths.
        maps: the numbers, from 0, of those whose maps are shown; by default the first two.
        width: of the widget, in pixels.
        height: likewise.

    Returns:
        Rerun's widget, which a notebook displays if it is the last value of a cell.

    Raises:
        MapreplayError: Rerun's notebook support is not installed.
        LogError: a log cannot be read.
    """
    from rerun import notebook

    if not notebook.HAS_NOTEBOOK:
        raise MapreplayError(
            "a notebook needs Rerun's widget: pip install 'mapreplay[notebook]', and start the "
            "kernel again"
        )
    opened = [log if isinstance(log, EpisodeLog) else EpisodeLog(log) for log in logs]
    replays = replays_of(opened, chosen=maps)
    panes = panes_of(replays)
    recording = new_recording(replays, panes)
    viewer = notebook.Viewer(
        width=width, height=height, recording=recording, blueprint=layout(panes)
    )
    send(recording, replays, panes)
    recording.flush()
    return viewer
