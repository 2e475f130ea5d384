"""The network architectures, by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Protocol

import numpy as np
import numpy.typing as npt
from torch import nn

from mapreplay.errors import WeightsError
from mapreplay.grid import UNKNOWN, Grid
from mapreplay.predictors.inference import CompiledNetwork
from mapreplay.predictors.network import OUTSIDE, EagerNetwork, MapPredictor
from mapreplay.predictors.unet import UNet, fused


class Engine(Protocol):
    """Runs one network with its weights."""

    def p_wall(self, cells: Grid) -> npt.NDArray[np.float32]:
        """P(occupied) of every cell of int8[H, W] `cells`, H and W multiples of 8."""
        ...


@dataclass(frozen=True)
class Architecture:
    """A kind of network: one-hot maps float[B, 3, H, W] to logits float[B, 1, H, W]."""

    name: str
    description: str
    """Text for the model card."""
    build: Callable[[], nn.Module]
    """With random weights."""
    padding: int
    """Cells that pad a map to multiples of 8."""
    fewest_maps: int
    """That are trained on at once; one map of 32 x 32 cells is one cell at the U-Net's coarsest
    level, and nothing to normalize by."""
    on_cpu: Callable[[nn.Module], Engine]
    """Its fastest engine there that gives the same numbers whatever else is computed."""


def _compiled(model: nn.Module) -> Engine:
    return CompiledNetwork(
        {name: value.cpu().numpy() for name, value in model.state_dict().items()}
    )


AUTOENCODER: Final = Architecture(
    "autoencoder",
    "convolutional autoencoder of Zwecher et al. 2022, 9 + 9 layers of 25 kernels",
    MapPredictor,
    UNKNOWN,
    1,
    _compiled,
)
UNET: Final = Architecture(
    "unet",
    "U-Net of five levels, from 1/2 to 1/32 of the map's size, with 32 to 96 kernels",
    UNet,
    OUTSIDE,
    2,
    lambda model: EagerNetwork(fused(model), "cpu"),
)
ARCHITECTURES: Final = {each.name: each for each in (AUTOENCODER, UNET)}

_NOTE: Final = "mapreplay.architecture"


def notes_of(architecture: Architecture) -> dict[str, str]:
    """The notes in the file of the weights, for `architecture_of`."""
    return {_NOTE: architecture.name}


def architecture_of(notes: Mapping[str, str], path: Path) -> Architecture:
    """The architecture of the weights in `path`; by default the paper's.

    Raises:
        WeightsError: it is unknown.
    """
    name = notes.get(_NOTE, AUTOENCODER.name)
    if name not in ARCHITECTURES:
        raise WeightsError(
            f"{path}: weights of the network {name[:40]!r}; known are {', '.join(ARCHITECTURES)}"
        )
    return ARCHITECTURES[name]
