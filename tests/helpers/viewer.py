"""The real Rerun viewer without a window, and what is seen in it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from mapreplay.recorders.pictures.palette import CELL_COLOURS, CellClass, viridis
from mapreplay.recorders.viewer import servers

Screenshot = Callable[[int, str], npt.NDArray[np.uint8]]
"""(step, name of a view) -> uint8[h, w, 3], RGB."""

LATTICE = 9
"""Pixels along a cell: enough to find some between the rays in the agent's own cell."""


@contextmanager
def viewer_on(rrd: Path, size: str = "1600x900") -> Iterator[Screenshot]:
    """Open a file in the viewer; skips the test where there is no Vulkan."""
    from rerun.experimental import ViewerClient

    port = servers._free_port(None)
    options = ("--headless", f"--window-size={size}", "--hide-welcome-screen")
    with servers._viewer(f"--port={port}", *options) as process:
        try:
            servers._await(
                lambda: process.poll() is not None or servers._answers(port), "the viewer"
            )
            time.sleep(1)  # without a graphics adapter it ends a moment after it listens
            if process.poll() is not None:
                pytest.skip("the Rerun viewer needs Vulkan: install mesa-vulkan-drivers")
            client = ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
            client.open(str(rrd))
            views = {view.name: view.view_id for view in client.get_state().views}

            def shoot(step: int, view: str) -> npt.NDArray[np.uint8]:
                client.set_time("step", sequence=step, play_state="paused")
                png = np.frombuffer(_patiently(client.take_screenshot, views[view]), np.uint8)
                image: npt.NDArray[np.uint8] = cv2.imdecode(png, cv2.IMREAD_COLOR)[..., ::-1]
                return image

            time.sleep(7)  # notices of the start cover a part of the views
            yield shoot
        finally:
            process.terminate()


def _patiently(take: Callable[[Any], bytes], view: Any) -> bytes:
    """A busy machine may not paint within the viewer's own limit of 15 seconds."""
    for _ in range(3):
        try:
            return take(view)
        except TimeoutError:
            continue
    return take(view)


def samples(image: npt.NDArray[np.uint8], shape: tuple[int, int]) -> npt.NDArray[np.int64]:
    """int64[H, W, LATTICE**2, 3]: a lattice of pixels in each cell, row 0 on top.

    The picture is found as the bounding box of all that is not the view's background.
    """
    rows, cols = np.nonzero((image != image[0, 0]).any(axis=2))
    top, left = rows.min(), cols.min()
    height, width = rows.max() + 1 - top, cols.max() + 1 - left
    assert width / height == pytest.approx(shape[1] / shape[0], rel=0.02)
    inner = np.linspace(0.1, 0.9, LATTICE)
    ys = (top + (np.arange(shape[0])[:, None] + inner) * height / shape[0]).astype(int)
    xs = (left + (np.arange(shape[1])[:, None] + inner) * width / shape[1]).astype(int)
    lattice = image[ys[:, None, :, None], xs[None, :, None, :]]
    return lattice.reshape(*shape, LATTICE**2, 3).astype(np.int64)


def seen_classes(image: npt.NDArray[np.uint8], shape: tuple[int, int]) -> npt.NDArray[np.int64]:
    """int64[H, W], row 0 at the bottom: the class whose colour most of a cell's pixels have.

    Pixels of rays, points and lines have none of these colours, and do not count.
    """
    palette = np.array([CELL_COLOURS[c] for c in CellClass])
    near = np.abs(samples(image, shape)[..., None, :] - palette).max(axis=-1) <= 2
    votes = near.sum(axis=2)
    return np.where(votes.max(axis=-1) > 0, votes.argmax(axis=-1), -1)[::-1]


def seen_levels(image: npt.NDArray[np.uint8], shape: tuple[int, int]) -> npt.NDArray[np.float64]:
    """float64[H, W], row 0 at the bottom: the level of viridis that each cell has."""
    ramp = viridis().astype(np.int64)
    distances = np.abs(samples(image, shape)[..., None, :] - ramp).max(axis=-1)
    levels = np.where(distances.min(axis=-1) <= 12, distances.argmin(axis=-1), -1000)
    return np.asarray(np.median(levels, axis=-1)[::-1])  # lines cover less than half of a cell


def agreement(seen: npt.NDArray[Any], expected: npt.NDArray[Any], tolerance: int = 0) -> float:
    return float((np.abs(seen.astype(int) - expected.astype(int)) <= tolerance).mean())


def controls(expected: npt.NDArray[Any]) -> dict[str, npt.NDArray[Any]]:
    """What a wrong view would show."""
    side = min(expected.shape)
    transposed = expected.copy()
    transposed[:side, :side] = expected[:side, :side].T
    return {
        "flipped": expected[::-1],
        "mirrored": expected[:, ::-1],
        "turned": expected[::-1, ::-1],
        "transposed": transposed,
        "a row higher": np.roll(expected, 1, axis=0),
        "a column to the right": np.roll(expected, 1, axis=1),
    }
