"""The paper's network with trained weights, as a predictor."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
import torch

from mapreplay.errors import UsageError
from mapreplay.grid import Grid
from mapreplay.predictors.inference import CompiledNetwork
from mapreplay.predictors.network import EagerNetwork, MapPredictor, pad_to_multiple
from mapreplay.predictors.weights import file_sha256, load_state, load_tensors
from mapreplay.step import PredictorIdentity

WEIGHTS: Final = Path(__file__).parent / "weights_v1"


class TrainedPredictor:
    """Runs a `MapPredictor` on one map at a time: compiled on the CPU, else by PyTorch."""

    def __init__(self, model: MapPredictor, identity: PredictorIdentity, device: str) -> None:
        self.identity = identity
        self._network: CompiledNetwork | EagerNetwork
        if torch.device(device).type == "cpu":
            self._network = CompiledNetwork(
                {name: tensor.cpu().numpy() for name, tensor in model.state_dict().items()}
            )
        else:
            self._network = EagerNetwork(model, device)

    def predict(self, observed: Grid) -> npt.NDArray[np.float32]:
        """See `mapreplay.predictors.Predictor`."""
        height, width = observed.shape
        p_wall = self._network.p_wall(pad_to_multiple(observed))
        return np.ascontiguousarray(p_wall[:height, :width])


def load_model(path: Path) -> MapPredictor:
    """PyTorch's network with the weights of the safetensors file `path`.

    Raises:
        WeightsError: it cannot be read, or holds the weights of another network.
    """
    tensors, _ = load_tensors(path)
    model = MapPredictor().eval()
    load_state(model, tensors, path)
    return model


def load_network(path: Path, device: str, name: str | None = None) -> TrainedPredictor:
    """The network whose weights are in the safetensors file `path`.

    Raises:
        WeightsError: it cannot be read, or holds the weights of another network.
        UsageError: there is no such device.
    """
    model = load_model(path)
    identity = PredictorIdentity(name or path.name, file_sha256(path))
    try:
        return TrainedPredictor(model, identity, device)
    except (RuntimeError, AssertionError) as error:
        raise UsageError(
            f"device {device!r} cannot be used ({str(error).splitlines()[0]})"
        ) from None


def d1(device: str) -> TrainedPredictor:
    """The predictor trained on procedural plans."""
    return load_network(WEIGHTS / "d1.safetensors", device, "d1")


def d2(device: str) -> TrainedPredictor:
    """The predictor trained on HouseExpo."""
    return load_network(WEIGHTS / "d2.safetensors", device, "d2")
