"""The paper's network with trained weights, as a predictor."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
import torch

from mapreplay.errors import UsageError
from mapreplay.grid import Grid
from mapreplay.predictors.network import MapPredictor, one_hot, pad_to_multiple
from mapreplay.predictors.weights import file_sha256, load_state, load_tensors
from mapreplay.step import PredictorIdentity

WEIGHTS: Final = Path(__file__).parent / "weights_v1"


class TrainedPredictor:
    """Runs a `MapPredictor` on one map at a time."""

    def __init__(self, model: MapPredictor, identity: PredictorIdentity, device: str) -> None:
        self._model = model
        self._device = device
        self.identity = identity

    @torch.inference_mode()
    def predict(self, observed: Grid) -> npt.NDArray[np.float32]:
        """See `mapreplay.predictors.Predictor`."""
        height, width = observed.shape
        logits = self._model(one_hot(pad_to_multiple(observed)[None]).to(self._device))
        p_wall = torch.sigmoid(logits[0, 0, :height, :width])
        return np.ascontiguousarray(p_wall.cpu().numpy(), np.float32)


def load_network(path: Path, device: str, name: str | None = None) -> TrainedPredictor:
    """The network whose weights are in the safetensors file `path`.

    Raises:
        WeightsError: it cannot be read, or holds the weights of another network.
        UsageError: there is no such device.
    """
    torch.set_num_threads(1)  # episodes run in parallel, and a map is too small to share
    tensors, _ = load_tensors(path)
    model = MapPredictor()
    load_state(model, tensors, path)
    try:
        # torch's own annotations do not know memory_format
        model = model.eval().to(device, memory_format=torch.channels_last)  # type: ignore[call-overload]
    except (RuntimeError, AssertionError) as error:
        raise UsageError(
            f"device {device!r} cannot be used ({str(error).splitlines()[0]})"
        ) from None
    identity = PredictorIdentity(name or path.name, file_sha256(path))
    return TrainedPredictor(model, identity, device)


def d1(device: str) -> TrainedPredictor:
    """The predictor trained on procedural plans."""
    return load_network(WEIGHTS / "d1.safetensors", device, "d1")


def d2(device: str) -> TrainedPredictor:
    """The predictor trained on HouseExpo."""
    return load_network(WEIGHTS / "d2.safetensors", device, "d2")
