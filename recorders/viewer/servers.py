"""Rerun's viewers: a window, or a browser on this machine; whole episodes or live ones."""

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
from typing import TYPE_CHECKING, Final, Self
from urllib.parse import quote

import rerun as rr
import rerun.blueprint as rrb

from mapreplay.errors import MapreplayError, UsageError
from mapreplay.processes.workers import Program
from mapreplay.recorders.pictures.replay import Replay
from mapreplay.recorders.viewer.columns import EpisodeColumns
from mapreplay.recorders.viewer.layout import TIMELINE, layout
from mapreplay.recorders.viewer.recording import (
    FLUSH_SECONDS,
    Sink,
    new_recording,
    panes_of,
    show,
)
from mapreplay.recorders.viewer.static import send_legend
from mapreplay.step import EpisodeHeader, Step

if TYPE_CHECKING:
    from rerun.experimental import ViewerClient

LOOPBACK: Final = "127.0.0.1"
VIEWER_PORT: Final = 9876
"""Where Rerun's viewers listen by default: one that is open is reused."""
_START_SECONDS: Final = 20.0


def open_viewer(
    replays: Sequence[Replay], port: int = VIEWER_PORT, step: int | None = None
) -> None:
    """Show episodes in the native viewer, from `step` on.

    Returns when all steps are sent; the viewer stays open.

    Raises:
        UsageError: there is no display, or the port is taken by something else.
        MapreplayError: the viewer does not start.
    """
    show(replays, native_viewer(port))
    if step is not None:
        go_to(port, step)


def go_to(port: int, step: int) -> None:
    """Set the time cursor of the viewer that listens at `port`."""
    from rerun.experimental import ViewerClient

    client = ViewerClient.connect(_grpc_address(port))
    # The time travels apart from the steps, and may arrive before them.
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
        show(replays, server.connect)
    except BaseException:
        server.close()
        raise
    return server


class LiveView:
    """A `StepSink` that shows an episode while it runs, with the layout of a finished one.

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
        """Send what is left and disconnect; the viewer stays open."""
        try:
            self._recording.flush(timeout_sec=FLUSH_SECONDS)
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
            with _viewer(f"--port={port}", *options):  # exits at once; the window is its child
                pass
            _await(lambda: _answers(port), "the Rerun viewer")
        elif not _speaks_grpc(port):  # sending to it would block for ever
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
        # The SDK's own servers listen on every interface, which cannot be changed.
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


def _viewer(*arguments: str) -> subprocess.Popen[bytes]:
    """Start the viewer's program, which outlives this process: a window that the user closes."""
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
    """The viewer itself; terminating the launcher of the same name would leave it running."""
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
