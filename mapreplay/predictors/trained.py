"""Networks with trained weights, as predictors."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
import torch
from torch import nn

from mapreplay.errors import UsageError, WeightsError
from mapreplay.grid import Grid
from mapreplay.predictors.architectures import Architecture, architecture_of
from mapreplay.predictors.network import EagerNetwork, pad_to_multiple
from mapreplay.predictors.weights import file_sha256, load_state, load_tensors
from mapreplay.step import PredictorIdentity

WEIGHTS: Final = Path(__file__).parent / "weights_v1"


class TrainedPredictor:
    """Runs a network on one map at a time."""

    def __init__(
        self, model: nn.Module, architecture: Architecture, identity: PredictorIdentity, device: str
    ) -> None:
        self.identity = identity
        self._padding = architecture.padding
        if torch.device(device).type == "cpu":
            self._engine = architecture.on_cpu(model)
        else:
            self._engine = EagerNetwork(model, device)

    def predict(self, observed: Grid) -> npt.NDArray[np.float32]:
        """See `mapreplay.predictors.Predictor`."""
        height, width = observed.shape
        p_wall = self._engine.p_wall(pad_to_multiple(observed, self._padding))
        return np.ascontiguousarray(p_wall[:height, :width])


def load_model(path: Path) -> tuple[nn.Module, Architecture]:
    """PyTorch's network with the weights of the safetensors file `path`, and which it is.

    Raises:
        WeightsError: it cannot be read, or holds the weights of another network.
    """
    tensors, notes = load_tensors(path)
    architecture = architecture_of(notes, path)
    model = architecture.build().eval()
    load_state(model, tensors, path)
    return model, architecture


def load_network(path: Path, device: str, name: str | None = None) -> TrainedPredictor:
    """The network whose weights are in the safetensors file `path`; by default called like it.

    Raises:
        WeightsError: it cannot be read, or holds the weights of another network.
        UsageError: there is no such device.
    """
    sha256 = file_sha256(path)
    model, architecture = load_model(path)
    if file_sha256(path) != sha256:  # what is logged is what was loaded
        raise WeightsError(f"{path}: was replaced while it was read; try again")
    identity = PredictorIdentity(name or path.name, sha256)
    try:
        return TrainedPredictor(model, architecture, identity, device)
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


def d2_unet(device: str) -> TrainedPredictor:
    """The U-Net trained on HouseExpo, and on what agents observed there."""
    return load_network(WEIGHTS / "d2-unet.safetensors", device, "d2-unet")
