"""Episodes shown in Rerun: in a file, a window, or a browser; whole or while they happen."""

from __future__ import annotations

import http.client
import importlib.util
import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Final, Self, TypeAlias
from urllib.parse import quote

import rerun as rr
import rerun.blueprint as rrb

from mapreplay.errors import MapreplayError, UsageError
from mapreplay.files import whole_path
from mapreplay.recorders.pictures.replay import LETTERS, Replay, names_of
from mapreplay.recorders.viewer.columns import EpisodeColumns, send_episode, send_scores
from mapreplay.recorders.viewer.layout import TIMELINE, Pane, application_id, layout
from mapreplay.recorders.viewer.static import send_legend, send_parting
from mapreplay.step import EpisodeHeader, Step
from mapreplay.text import printable
from mapreplay.workers import Program

if TYPE_CHECKING:
    from rerun.experimental import ViewerClient

LOOPBACK: Final = "127.0.0.1"
VIEWER_PORT: Final = 9876
"""Where Rerun's viewers listen by convention: one that is open is used again."""
_START_SECONDS: Final = 20.0
_FLUSH_SECONDS: Final = 60.0

Sink: TypeAlias = Callable[[rr.RecordingStream, rrb.Blueprint], None]
"""Connects a new recording, with its layout, to where it is shown."""


def save_rrd(path: Path, replays: Sequence[Replay], *, force: bool = False) -> None:
    """Write episodes with their layout to an .rrd file, whole or not at all.

    All that is written, which is compressed, is in memory at one time.

    Raises:
        ExistsError, WriteError: see `mapreplay.files.whole_path`.
    """
    with whole_path(path, force=force) as draft:
        draft.write_bytes(_encoded(replays))


def open_viewer(
    replays: Sequence[Replay], port: int = VIEWER_PORT, step: int | None = None
) -> None:
    """Show episodes in the native viewer, from `step` on.

    Returns when all steps are sent; the viewer stays.

    Raises:
        UsageError: there is no display, or the port is taken by something else.
        MapreplayError: the viewer does not start.
    """
    _show(replays, native_viewer(port))
    if step is not None:
        go_to(port, step)


def go_to(port: int, step: int) -> None:
    """Set the time cursor of the viewer that listens at `port`."""
    from rerun.experimental import ViewerClient

    client = ViewerClient.connect(_grpc_address(port))
    # It is told apart from the steps that were sent, and may hear of it before it has them.
    _await(lambda: _reaches(client, step), "the Rerun viewer")
    client.set_time(TIMELINE, sequence=step, play_state="paused")


def _reaches(client: ViewerClient, step: int) -> bool:
    return any(
        timeline.name == TIMELINE and (timeline.end or 0) >= step
        for recording in client.get_state().recordings
        for timeline in recording.timelines
    )


def serve_web(
    replays: Sequence[Replay], web_port: int | None = None, grpc_port: int | None = None
) -> WebServer:
    """Show episodes to browsers on this machine; see `WebServer`.

    Returns when all steps are sent; the caller closes the server.

    Raises:
        UsageError: a port is not free.
        MapreplayError: the server does not start.
    """
    server = WebServer(web_port, grpc_port)
    try:
        _show(replays, server.connect)
    except BaseException:
        server.close()
        raise
    return server


class LiveView:
    """Shows an episode while it happens, laid out as a finished one.

    `sink` is by default `native_viewer()`; the other is the `connect` of a `WebServer`.

    Raises:
        UsageError: by default, where there is no display.
    """

    def __init__(self, header: EpisodeHeader, sink: Sink | None = None) -> None:
        sink = sink or native_viewer()
        replay = Replay(header)
        panes = panes_of([replay])
        self._recording = new_recording([replay], panes)
        sink(self._recording, layout(panes, rrb.components.PlayState.Following))
        send_legend(self._recording, [replay])
        self._columns = EpisodeColumns(self._recording, header)

    def add(self, step: Step) -> None:
        """Show the next step."""
        self._columns.send([step])

    def close(self) -> None:
        """Send what is left and let go of the viewer, which stays."""
        try:
            self._recording.flush(timeout_sec=_FLUSH_SECONDS)
        finally:
            self._recording.disconnect()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()


def native_viewer(port: int = VIEWER_PORT) -> Sink:
    """A `Sink` that opens a window, or uses the viewer that already listens at `port`.

    Raises:
        UsageError: there is no display.
    """
    require_display_here()

    def connect(recording: rr.RecordingStream, blueprint: rrb.Blueprint) -> None:
        if not _answers(port):
            options = ("--hide-welcome-screen", "--expect-data-soon", "--detach-process")
            with _viewer(f"--port={port}", *options):  # ends at once; the window is its child
                pass
            _await(lambda: _answers(port), "the Rerun viewer")
        elif not _speaks_grpc(port):  # to send to it would wait without end
            raise UsageError(
                f"port {port} is used by something that is not a Rerun viewer; use --web or --save"
            )
        recording.connect_grpc(_grpc_address(port), default_blueprint=blueprint)

    return connect


def require_display_here() -> None:
    """Check that a window can be opened on this machine.

    Raises:
        UsageError: there is no display.
    """
    require_display(sys.platform, os.environ)


def require_display(platform: str, environment: Mapping[str, str]) -> None:
    """Check that a window can be opened.

    Raises:
        UsageError: this is Linux without an X11 or Wayland display.
    """
    displays = ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET")
    if platform == "linux" and not any(environment.get(name) for name in displays):
        raise UsageError(
            "no display to open the viewer on; use --web for a browser, --save FILE.rrd, or "
            "--png FILE.png --step N for a picture"
        )


class WebServer:
    """Rerun's web viewer and the gRPC server that feeds it, reachable from this machine only.

    Both end when this is closed, and with this process, however it ends.

    Args:
        web_port: of the page; None takes a free one.
        grpc_port: of the data; None takes a free one.

    Raises:
        UsageError: a port is not free.
        MapreplayError: the server does not start.
    """

    def __init__(self, web_port: int | None = None, grpc_port: int | None = None) -> None:
        web, grpc = _free_port(web_port), _free_port(grpc_port)
        self._grpc_address = _grpc_address(grpc)
        self.address = f"http://{LOOPBACK}:{web}?url={quote(self._grpc_address, safe='')}"
        # The SDK's own servers listen on every interface, and cannot be told otherwise.
        options = (
            "--serve-web",
            f"--web-viewer-port={web}",
            f"--port={grpc}",
            "--server-memory-limit=50%",
        )
        self._program = Program(_command(*options), _environment())
        try:
            _await(
                lambda: self._program.ended or (_answers(web) and _answers(grpc)), "the web server"
            )
            if self._program.ended:
                raise MapreplayError("the web server ended at once; use --save FILE.rrd")
        except BaseException:
            self.close()
            raise

    def connect(self, recording: rr.RecordingStream, blueprint: rrb.Blueprint) -> None:
        """The `Sink` that sends to this server."""
        recording.connect_grpc(self._grpc_address, default_blueprint=blueprint)

    def wait(self) -> None:
        """Return when the server has ended."""
        self._program.wait()

    def close(self) -> None:
        """End the server."""
        self._program.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()


def _await(ready: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + _START_SECONDS
    while not ready():
        if time.monotonic() > deadline:
            raise MapreplayError(f"{what} does not start; use --save FILE.rrd")
        time.sleep(0.05)


def panes_of(replays: Sequence[Replay]) -> list[Pane]:
    """Where each of the episodes is sent to and shown; a single one needs no name."""
    headers = [replay.header for replay in replays]
    names = names_of(headers) if len(replays) > 1 else [""]
    roots = [f"/{letter}" for letter in LETTERS] if len(replays) > 1 else [""]
    return [
        Pane(replay.header, root, name, replay.has_maps, replay.profiled)
        for replay, root, name in zip(replays, roots, names, strict=False)
    ]


def send(recording: rr.RecordingStream, replays: Sequence[Replay], panes: Sequence[Pane]) -> None:
    """Send whole episodes to where their panes are."""
    send_legend(recording, [replay for replay in replays if replay.has_maps])
    for replay, pane in zip(replays, panes, strict=True):
        if not replay.has_maps:
            send_scores(recording, replay, pane.root, pane.name)
            continue
        if replay.parts_at is not None:
            send_parting(recording, pane.name, replay.parts_at)
        send_episode(recording, replay, pane.root, pane.name)


def _show(replays: Sequence[Replay], sink: Sink) -> None:
    panes = panes_of(replays)
    recording = new_recording(replays, panes)
    try:
        sink(recording, layout(panes))
        send(recording, replays, panes)
        recording.flush(timeout_sec=_FLUSH_SECONDS)
    finally:
        recording.disconnect()


def _encoded(replays: Sequence[Replay]) -> bytes:
    """What an .rrd file contains. To let Rerun write it would wait for ever on a full disk."""
    panes = panes_of(replays)
    recording = new_recording(replays, panes)
    try:
        stream = rr.binary_stream(recording)
        recording.send_blueprint(layout(panes))
        send(recording, replays, panes)
        # One read: each adds an index of its own to the end, and a file has one.
        return stream.read(flush_timeout_sec=_FLUSH_SECONDS) or b""
    finally:
        recording.disconnect()


def new_recording(replays: Sequence[Replay], panes: Sequence[Pane]) -> rr.RecordingStream:
    """A recording that is named after the episodes, and goes nowhere yet."""
    recording = rr.RecordingStream(application_id(panes))
    names = [replay.header.file_name.removesuffix(".mcap") for replay in replays]
    recording.send_recording_name(
        printable(names[0]) if len(names) == 1 else f"{len(names)} episodes"
    )
    return recording


def _viewer(*arguments: str) -> subprocess.Popen[bytes]:
    """Start the viewer's program, which stays when we end: a window that the user closes."""
    return subprocess.Popen(  # noqa: S603
        _command(*arguments),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=_environment(),
    )


def _command(*arguments: str) -> list[str | Path]:
    """The viewer's program, listening on loopback only: its default is every interface."""
    return [viewer_program(), f"--bind={LOOPBACK}", *arguments]


def _environment() -> dict[str, str]:
    return {**os.environ, "RERUN_APP_ONLY": "true"}


def viewer_program() -> Path:
    """The viewer itself: ending the launcher of the same name would leave it running."""
    spec = importlib.util.find_spec("rerun_cli")
    folder = Path(spec.origin).parent if spec and spec.origin else Path()
    for name in ("Rerun.app/Contents/MacOS/Rerun", "rerun", "rerun.exe"):
        if (folder / name).is_file():
            return folder / name
    raise MapreplayError("the Rerun viewer is missing; install rerun-sdk from a wheel")


def _free_port(wanted: int | None) -> int:
    with socket.socket() as probe:
        try:
            probe.bind((LOOPBACK, wanted or 0))
        except OSError as error:
            raise UsageError(f"port {wanted} cannot be used ({error.strerror})") from None
        return int(probe.getsockname()[1])


def _grpc_address(port: int) -> str:
    return f"rerun+http://{LOOPBACK}:{port}/proxy"


def _speaks_grpc(port: int) -> bool:
    connection = http.client.HTTPConnection(LOOPBACK, port, timeout=2.0)
    try:
        connection.request("POST", "/", headers={"Content-Type": "application/grpc-web"})
        return connection.getresponse().getheader("grpc-status") is not None
    except (OSError, http.client.HTTPException):
        return False
    finally:
        connection.close()


def _answers(port: int) -> bool:
    with socket.socket() as probe:
        probe.settimeout(1.0)
        return probe.connect_ex((LOOPBACK, port)) == 0
