"""Episodes as a Rerun recording: sent to a viewer, or saved as a file."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final, TypeAlias

import rerun as rr
import rerun.blueprint as rrb

from mapreplay.files.whole import whole_path
from mapreplay.recorders.pictures.replay import LETTERS, Replay, names_of
from mapreplay.recorders.viewer.columns import send_episode, send_scores
from mapreplay.recorders.viewer.layout import Pane, application_id, layout
from mapreplay.recorders.viewer.static import send_divergence, send_legend
from mapreplay.text import printable

FLUSH_SECONDS: Final = 60.0

Sink: TypeAlias = Callable[[rr.RecordingStream, rrb.Blueprint], None]
"""Connects a new recording, with its layout, to where it is shown."""


def save_rrd(path: Path, replays: Sequence[Replay], *, force: bool = False) -> None:
    """Write episodes with their layout to an .rrd file, whole or not at all.

    The compressed recording is in memory as a whole.

    Raises:
        ExistsError, WriteError: see `mapreplay.files.whole_path`.
    """
    with whole_path(path, force=force) as draft:
        draft.write_bytes(_encoded(replays))


def panes_of(replays: Sequence[Replay]) -> list[Pane]:
    """Where each episode is sent to and shown; a single one needs no name."""
    headers = [replay.header for replay in replays]
    names = names_of(headers) if len(replays) > 1 else [""]
    roots = [f"/{letter}" for letter in LETTERS] if len(replays) > 1 else [""]
    return [
        Pane(replay.header, root, name, replay.has_maps, replay.profiled)
        for replay, root, name in zip(replays, roots, names, strict=False)
    ]


def send(recording: rr.RecordingStream, replays: Sequence[Replay], panes: Sequence[Pane]) -> None:
    """Send whole episodes to their panes."""
    send_legend(recording, [replay for replay in replays if replay.has_maps])
    for replay, pane in zip(replays, panes, strict=True):
        if not replay.has_maps:
            send_scores(recording, replay, pane.root, pane.name)
            continue
        if replay.diverges_at is not None:
            send_divergence(recording, pane.name, replay.diverges_at)
        send_episode(recording, replay, pane.root, pane.name)


def show(replays: Sequence[Replay], sink: Sink) -> None:
    """Send whole episodes, with their layout, to a sink."""
    panes = panes_of(replays)
    recording = new_recording(replays, panes)
    try:
        sink(recording, layout(panes))
        send(recording, replays, panes)
        recording.flush(timeout_sec=FLUSH_SECONDS)
    finally:
        recording.disconnect()


def _encoded(replays: Sequence[Replay]) -> bytes:
    """The content of an .rrd file; Rerun's own writer waits for ever on a full disk."""
    panes = panes_of(replays)
    recording = new_recording(replays, panes)
    try:
        stream = rr.binary_stream(recording)
        recording.send_blueprint(layout(panes))
        send(recording, replays, panes)
        # One read: each appends an index, and a file has only one.
        return stream.read(flush_timeout_sec=FLUSH_SECONDS) or b""
    finally:
        recording.disconnect()


def new_recording(replays: Sequence[Replay], panes: Sequence[Pane]) -> rr.RecordingStream:
    """A recording that is named after the episodes, not yet connected to a sink."""
    recording = rr.RecordingStream(application_id(panes))
    names = [replay.header.file_name.removesuffix(".mcap") for replay in replays]
    recording.send_recording_name(
        printable(names[0]) if len(names) == 1 else f"{len(names)} episodes"
    )
    return recording
