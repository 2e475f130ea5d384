"""Speed of the map predictor on one core compared with PyTorch, and how far the numbers differ."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
import torch

from mapreplay.config import PredictionDtype
from mapreplay.floorplan import explorable
from mapreplay.floorplans.procedural import generate
from mapreplay.grid import Grid
from mapreplay.mapping import quantize
from mapreplay.predictors.network import one_hot
from mapreplay.predictors.trained import TrainedPredictor, load_model
from mapreplay.sensor import Sensor
from mapreplay.step import PredictorIdentity
from mapreplay.training.observations import observation_draws, simulate_observations

BATCH: Final = 32
FIRST_PLAN: Final = 50000
"""The validation plans begin here."""

Floats = npt.NDArray[np.float32]


@dataclass(frozen=True)
class PredictionSpeed:
    """One way to run the network on one core."""

    how: str
    ms_per_map: float
    """CPU time, the minimum of several rounds over all maps."""
    maps_per_second: float
    speed_up: float
    """Against PyTorch, one map at a time, as it is by default."""
    largest_difference: float
    """Of P(occupied), from the same."""
    quanta: int
    """Cells whose P(occupied) differs when it is rounded to uint8, of all maps."""


def measure_prediction(weights: Path, size: int, maps: int, rounds: int) -> list[PredictionSpeed]:
    """Predict `maps` observed maps of `size` x `size` cells in four ways, on one thread.

    The ways take turns, so that a busy machine is busy for all of them.

    Raises:
        WeightsError: `weights` cannot be read.
    """
    torch.set_num_threads(1)
    cells = [observed_map(i, size) for i in range(maps)]
    model, architecture = load_model(weights)
    plain, last = torch.contiguous_format, torch.channels_last
    ours = TrainedPredictor(model, architecture, PredictorIdentity(weights.name, ""), "cpu")
    ways: dict[str, Callable[[], list[Floats]]] = {
        "PyTorch, 1 map, NCHW": lambda: list(_eager(model, cells, 1, plain)),
        "PyTorch, 1 map, channels last": lambda: list(_eager(model, cells, 1, last)),
        f"PyTorch, {BATCH} maps, channels last": lambda: list(_eager(model, cells, BATCH, last)),
        "mapreplay, 1 map": lambda: [ours.predict(observed) for observed in cells],
    }
    predicted = {how: way() for how, way in ways.items()}
    seconds = dict.fromkeys(ways, float("inf"))
    for _ in range(rounds):
        for how, way in ways.items():
            began = time.process_time()
            way()
            seconds[how] = min(seconds[how], time.process_time() - began)
    reference = next(iter(ways))
    return [
        PredictionSpeed(
            how,
            1000 * seconds[how] / maps,
            maps / seconds[how],
            seconds[reference] / seconds[how],
            *_differences(predicted[how], predicted[reference]),
        )
        for how in ways
    ]


def observed_map(number: int, size: int) -> Grid:
    """int8[size, size]: a simulated observation of a validation plan, repeated to that size."""
    plan = generate(FIRST_PLAN + number)
    region = explorable(plan.cells, plan.check_start(None))
    draws = observation_draws(0, number, 0)
    observed = simulate_observations(plan.cells, region, Sensor(), draws)
    rows, cols = (max(0, size - side) for side in plan.shape)
    return np.pad(observed, ((0, rows), (0, cols)), mode="wrap")[:size, :size].copy()


@torch.inference_mode()
def _eager(
    model: torch.nn.Module, cells: list[Grid], batch: int, layout: torch.memory_format
) -> Iterator[Floats]:
    # torch's own annotations do not know memory_format
    model = model.to(memory_format=layout)  # type: ignore[call-overload]
    for first in range(0, len(cells), batch):
        maps = cells[first : first + batch]
        p_wall = torch.sigmoid(
            model(one_hot(torch.from_numpy(np.stack(maps))).contiguous(memory_format=layout))
        )
        yield from p_wall[:, 0].numpy()


def _differences(ours: list[Floats], theirs: list[Floats]) -> tuple[float, int]:
    pairs = list(zip(ours, theirs, strict=True))
    largest = max(float(np.abs(a - b).max()) for a, b in pairs)
    uint8 = PredictionDtype.UINT8
    return largest, sum(int((quantize(a, uint8) != quantize(b, uint8)).sum()) for a, b in pairs)
