"""A picture of `mapreplay view`: the real viewer, rendered without a display.

    python docs/figures/view.py LOG [LOG] --step STEP -o view.png
    python docs/figures/view.py LOG --plain --step STEP -o plain.png    # what `rerun LOG` shows

Needs Vulkan; software Vulkan will do (Debian: mesa-vulkan-drivers).
"""

from __future__ import annotations

import argparse
import socket
import subprocess
import tempfile
import time
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path

import numpy as np
from PIL import Image
from rerun.experimental import ViewerClient

from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.recorders.pictures.animation import few_colours
from mapreplay.recorders.pictures.replay import replays_of
from mapreplay.recorders.viewer.recording import save_rrd
from mapreplay.recorders.viewer.servers import viewer_program

NOTICES_SECONDS = 10
"""How long notices of the viewer's start cover a part of it."""
TITLE_BAR = 37
"""Pixels at the top that belong to the window and not to the view."""
ATTEMPTS = 5


def screenshot(file: Path, timeline: str | None, step: int, size: str) -> bytes:
    """The viewer with `file` open, as PNG; with no timeline at its first moment."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    options = ["--headless", "--bind=127.0.0.1", f"--port={port}", f"--window-size={size}"]
    with subprocess.Popen([viewer_program(), *options, "--hide-welcome-screen"]) as viewer:  # noqa: S603
        try:
            client = patiently(
                lambda: ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy"), seconds=2
            )
            patiently(lambda: client.open(str(file)), seconds=2)
            time.sleep(NOTICES_SECONDS)
            if timeline:
                client.set_time(timeline, sequence=step, play_state="paused")
                time.sleep(1)
            return patiently(client.take_screenshot, seconds=1)
        finally:
            viewer.terminate()


def patiently(work, seconds):  # type: ignore[no-untyped-def]
    """What `work` gives, after some more attempts if a busy machine is slow."""
    for attempt in range(ATTEMPTS):
        try:
            return work()
        except (ConnectionError, TimeoutError):
            if attempt == ATTEMPTS - 1:
                raise
            time.sleep(seconds)
    return None


def picture_of(logs: Sequence[Path], step: int, size: str, *, plain: bool) -> bytes:
    """The viewer with our layout, or with the first log as it is."""
    if plain:
        return screenshot(logs[0].resolve(), None, step, size)
    with tempfile.TemporaryDirectory() as folder:
        rrd = Path(folder) / "episode.rrd"
        save_rrd(rrd, replays_of([EpisodeLog(log) for log in logs]))
        return screenshot(rrd, "step", step, size)


def main() -> None:
    """Take the picture and write it without the window's title bar, in few colours."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("logs", type=Path, nargs="+")
    parser.add_argument("--step", type=int, default=0)
    parser.add_argument("--plain", action="store_true")
    parser.add_argument("--size", default="1600x900")
    parser.add_argument("-o", "--output", type=Path, default=Path("view.png"))
    arguments = parser.parse_args()
    png = picture_of(arguments.logs, arguments.step, arguments.size, plain=arguments.plain)
    with Image.open(BytesIO(png)) as picture:
        cut = picture.convert("RGB").crop((0, TITLE_BAR, picture.width, picture.height))
        few_colours(np.asarray(cut)).save(arguments.output, optimize=True)


if __name__ == "__main__":
    main()
