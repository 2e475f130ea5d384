"""A picture of `mapreplay view`: the real viewer, rendered without a display.

    python docs/figures/view.py LOG STEP [-o view.png]

Needs Vulkan; software Vulkan will do (Debian: mesa-vulkan-drivers).
"""

from __future__ import annotations

import argparse
import socket
import subprocess
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np
import rerun_cli
from rerun.experimental import ViewerClient

from mapreplay.recorders.log import EpisodeLog
from mapreplay.recorders.replay import Replay
from mapreplay.recorders.rerun_view import save_rrd

NOTICES_SECONDS = 8
"""How long notices of the viewer's start cover a part of it."""
TITLE_BAR = 34
"""Pixels at the top that belong to the window and not to the view."""


def screenshot(log: EpisodeLog, step: int) -> bytes:
    """The viewer at `step`, 1600 x 900 pixels, as PNG."""
    with tempfile.TemporaryDirectory() as folder, socket.socket() as probe:
        rrd = Path(folder) / "episode.rrd"
        save_rrd(rrd, [Replay.of(log)])
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
        probe.close()
        program = Path(rerun_cli.__file__).parent / "rerun"
        options = ["--headless", "--bind=127.0.0.1", f"--port={port}", "--window-size=1600x900"]
        with subprocess.Popen([program, *options, "--hide-welcome-screen"]) as viewer:  # noqa: S603
            time.sleep(2)
            client = ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
            client.open(str(rrd))
            client.set_time("step", sequence=step, play_state="paused")
            time.sleep(NOTICES_SECONDS)
            png = client.take_screenshot()
            viewer.terminate()
    return png


def main() -> None:
    """Take the picture and write it without the window's title bar."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("log", type=Path)
    parser.add_argument("step", type=int)
    parser.add_argument("-o", "--output", type=Path, default=Path("view.png"))
    arguments = parser.parse_args()
    png = np.frombuffer(screenshot(EpisodeLog(arguments.log), arguments.step), np.uint8)
    picture = cv2.imdecode(png, cv2.IMREAD_COLOR)
    if picture is None:
        raise SystemExit("the viewer gave no picture")
    cv2.imwrite(str(arguments.output), picture[TITLE_BAR:])


if __name__ == "__main__":
    main()
