"""The range sensor: rays at fixed angles of the map frame, each ending at the first wall."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from mapreplay import kernels
from mapreplay.grid import Cell, Grid


@dataclass(frozen=True)
class Sensor:
    """A ring of range rays, `360 / rays` degrees apart (paper, section "Simulation Testbed").

    Ray i points to angle i * 2 pi / rays, counter-clockwise from +x, fixed to the map frame.
    """

    rays: int = 16
    """Number of rays, a multiple of 8, so that all eight neighbours are always seen."""
    reach: int = 20
    """Range in cells."""

    @property
    def offsets(self) -> npt.NDArray[np.int64]:
        """int64[rays, reach, 2]: (row, col) of cell k = 1..reach of each ray, from the agent."""
        return _offsets(self.rays, self.reach)

    def angles(self) -> list[float]:
        """The angle of each ray, radians in [0, 2 pi)."""
        return [2 * math.pi * i / self.rays for i in range(self.rays)]


@lru_cache(maxsize=8)
def _offsets(rays: int, reach: int) -> npt.NDArray[np.int64]:
    angle = 2 * np.pi * np.arange(rays) / rays
    k = np.arange(1, reach + 1)
    exact = np.stack([np.outer(np.sin(angle), k), np.outer(np.cos(angle), k)], axis=-1)
    # Half is rounded away from zero, with room for the last bit of sin and cos, so that
    # opposite rays are mirror images and every machine agrees.
    offsets: npt.NDArray[np.int64] = (np.sign(exact) * np.floor(np.abs(exact) + 0.5 + 1e-9)).astype(
        np.int64
    )
    offsets.setflags(write=False)
    return offsets


@lru_cache(maxsize=8)
def _distances(rays: int, reach: int) -> npt.NDArray[np.float64]:
    """float64[rays, reach]: distance of each cell of each ray from the agent, in cells."""
    offsets = _offsets(rays, reach)
    distances: npt.NDArray[np.float64] = np.hypot(offsets[..., 0], offsets[..., 1])
    distances.setflags(write=False)
    return distances


Hits = npt.NDArray[np.int16]
"""int16[rays]: the k in 1..reach of the cell that stopped each ray, 0 if none did."""


def sense(truth: Grid, agent: Cell, sensor: Sensor) -> Hits:
    """The hits of the rays from `agent` (a free cell); cells that are not free stop a ray.

    A ray that leaves the grid hits nothing.
    """
    hits = np.empty(sensor.rays, np.int16)
    kernels.cast_rays(truth, agent.row, agent.col, sensor.offsets, hits)
    return hits


def accumulate(observed: Grid, agent: Cell, hits: Hits, sensor: Sensor) -> Grid:
    """Sigma of the paper's block diagram: `observed` with one more scan written into it.

    The agent's own cell becomes free, each ray's cells free up to the hit, the hit occupied.
    Returns a new int8[H, W]; what was observed before is never contradicted, because the
    sensor has no noise.
    """
    result = observed.copy()
    kernels.mark_rays(result, agent.row, agent.col, sensor.offsets, hits)
    return result


def ranges(hits: Hits, sensor: Sensor, resolution: float) -> npt.NDArray[np.float32]:
    """float32[rays]: metres from the agent's centre to the hit cell's, inf where nothing hit."""
    distances = _distances(sensor.rays, sensor.reach)
    metres = distances[np.arange(sensor.rays), np.maximum(hits, 1) - 1] * resolution
    return np.where(hits > 0, metres, np.inf).astype(np.float32)


def hits_from_ranges(metres: npt.NDArray[np.floating], sensor: Sensor, resolution: float) -> Hits:
    """The inverse of `ranges`: the first cell of each ray whose distance is that range."""
    distances = _distances(sensor.rays, sensor.reach) * resolution
    finite = np.isfinite(metres)
    gaps = np.abs(distances - np.where(finite, metres, 0.0)[:, None])
    return np.where(finite, np.argmin(gaps, axis=1) + 1, 0).astype(np.int16)
