"""What a browser shows of `mapreplay view --web`: Rerun's web viewer in headless Chromium."""

from __future__ import annotations

import base64
import json
import shutil
import subprocess
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from mapreplay.episode import run_episode
from mapreplay.recorders.pictures.layers import cell_classes
from mapreplay.recorders.pictures.replay import Replay
from mapreplay.recorders.viewer import servers
from mapreplay.recorders.viewer.servers import WebServer, serve_web
from recordings import three_rooms
from viewer import agreement, controls, seen_classes

pytestmark = pytest.mark.slow

SIZE = (1280, 720)
PATIENCE = 240.0
"""Seconds until the page, with software WebGL on a busy machine, shows its data."""
# Software WebGL, and nothing that calls home.
FLAGS = [
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    f"--window-size={SIZE[0]},{SIZE[1]}",
]  # fmt: skip


def ask(port: int, path: str, body: dict[str, Any] | None = None, method: str | None = None) -> Any:
    """One request of the WebDriver protocol, and its value."""
    data = None if body is None else json.dumps(body).encode()
    request = urllib.request.Request(
        f"http://127.0.0.1:{port}{path}", data, {"Content-Type": "application/json"}, method=method
    )
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    with opener.open(request, timeout=PATIENCE) as answer:
        return json.load(answer)["value"]


class Browser:
    """A page of headless Chromium."""

    def __init__(self, port: int, profile: Path) -> None:
        options = {"args": [*FLAGS, f"--user-data-dir={profile}"]}
        wanted = {"capabilities": {"alwaysMatch": {"goog:chromeOptions": options}}}
        self._port = port
        self._session = f"/session/{ask(port, '/session', wanted)['sessionId']}"

    def open(self, address: str) -> None:
        ask(self._port, f"{self._session}/url", {"url": address})

    def close(self) -> None:
        """End the browser: ending its driver would leave it running."""
        ask(self._port, self._session, method="DELETE")

    def picture(self) -> npt.NDArray[np.uint8]:
        """uint8[h, w, 3], RGB."""
        png = base64.b64decode(ask(self._port, f"{self._session}/screenshot"))
        image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
        return np.ascontiguousarray(image[..., ::-1], np.uint8)


@contextmanager
def browser(tmp_path: Path) -> Iterator[Browser]:
    driver = shutil.which("chromedriver")
    if driver is None:
        pytest.skip("Chromium's driver is missing: install chromium and chromium-driver")
    port = servers._free_port(None)
    with subprocess.Popen(
        [driver, f"--port={port}"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    ) as process:
        try:
            servers._await(lambda: servers._answers(port), "chromedriver")
            page = Browser(port, tmp_path / "profile")
            try:
                yield page
            finally:
                page.close()
        finally:
            process.terminate()


def observed_map(picture: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8] | None:
    """The largest thing in the view at the top left, with a margin around; None if nothing."""
    # Under its title, over the legend, and left of the next of four maps.
    bottom, right = int(0.38 * picture.shape[0]), picture.shape[1] // 4 - 2
    view = picture[64:bottom, :right]
    dark = view[view.max(axis=2) < 24]  # the paper of the dark theme; walls are a little lighter
    if not len(dark):
        return None
    colours, counts = np.unique(dark, axis=0, return_counts=True)
    background = colours[counts.argmax()].astype(int)
    mask = (np.abs(view.astype(int) - background).max(axis=2) > 6).astype(np.uint8)
    _, _, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    if len(stats) < 2:
        return None
    left, top, width, height, area = stats[1 + stats[1:, cv2.CC_STAT_AREA].argmax()]
    if area < 10_000:
        return None
    cut = view[top : top + height, left : left + width]
    return np.pad(cut, ((5, 5), (5, 5), (0, 0)), constant_values=255)


def test_the_browser_shows_the_observed_map_of_the_log(tmp_path: Path) -> None:
    episode = three_rooms(predictor="blur", max_steps=12)
    steps = list(run_episode(episode))
    shape = episode.header.floor_plan.shape
    with browser(tmp_path) as page, serve_web([Replay(episode.header, steps)]) as server:
        page.open(f"{server.address}&theme=dark")
        deadline = time.monotonic() + PATIENCE
        shown = None
        while shown is None and time.monotonic() < deadline:
            time.sleep(3)
            shown = observed_map(page.picture())
        assert shown is not None, "nothing was painted"
        time.sleep(3)
        picture = page.picture()
        cv2.imwrite(str(tmp_path / "browser.png"), picture[..., ::-1])
        shown = observed_map(picture)
        assert shown is not None
        seen = seen_classes(shown, shape)
    # A browser begins at the first step or at the newest, as the data comes.
    ends = [cell_classes(steps[0].observed), cell_classes(steps[-1].observed)]
    right = max(ends, key=lambda expected: agreement(seen, expected))
    assert agreement(seen, right) == 1.0
    for name, wrong in controls(right).items():
        assert agreement(seen, wrong) < 0.99, name


def test_a_browser_without_data_shows_no_map(tmp_path: Path) -> None:
    with browser(tmp_path) as page, WebServer() as server:
        page.open(f"{server.address}&theme=dark")
        time.sleep(20)
        assert observed_map(page.picture()) is None
