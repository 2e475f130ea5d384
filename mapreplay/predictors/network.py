"""The paper's map predictor: a convolutional autoencoder with symmetric skip connections.

Section "Architecture": a 1x1x3 input layer without bias that turns the one-hot cell into one
learned value; nine encoding and nine decoding layers of 25 3x3 kernels, every third with
stride 2; symmetric (additive) skips. What the paper leaves open is ours: ReLU, 2D transposed
convolutions, a 3x3 output convolution to one logit. The learned input is stacked on to the
input of this output convolution; the paper stacks it on to that of the last hidden layer.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn
from torch.nn import functional

from mapreplay.grid import FREE, OCCUPIED, UNKNOWN, Grid

KERNELS: Final = 25
LAYERS: Final = 9
STRIDE_MULTIPLE: Final = 8
"""Maps are padded to a multiple of this."""
OUTSIDE: Final = -2
"""A cell that is not of the floor plan's grid: neither occupied nor free nor unknown."""


class MapPredictor(nn.Module):
    """One-hot maps float[B, 3, H, W] (occupied, free, unknown) to logits float[B, 1, H, W].

    H and W are multiples of 8.
    """

    def __init__(self) -> None:
        super().__init__()
        self.embed = nn.Conv2d(3, 1, 1, bias=False)
        self.encoder = nn.ModuleList(
            nn.Conv2d(KERNELS if i else 1, KERNELS, 3, stride=2 if i % 3 == 2 else 1, padding=1)
            for i in range(LAYERS)
        )
        self.decoder = nn.ModuleList(
            nn.ConvTranspose2d(KERNELS, KERNELS, 3, stride=2, padding=1, output_padding=1)
            if i % 3 == 0
            else nn.ConvTranspose2d(KERNELS, KERNELS, 3, padding=1)
            for i in range(LAYERS)
        )
        self.head = nn.Conv2d(KERNELS + 1, 1, 3, padding=1)

    def forward(self, one_hot: Tensor) -> Tensor:
        """See the class."""
        embedded: Tensor = self.embed(one_hot)
        hidden = embedded
        skips = []
        for layer in self.encoder:
            hidden = functional.relu(layer(hidden))
            skips.append(hidden)
        skips.pop()  # the latent code itself
        for layer in self.decoder:
            hidden = layer(hidden)
            if skips:
                hidden = hidden + skips.pop()
            hidden = functional.relu(hidden)
        logits: Tensor = self.head(torch.cat([hidden, embedded], dim=1))
        return logits


class EagerNetwork:
    """A network as PyTorch runs it, one map at a time, on any device."""

    def __init__(self, model: nn.Module, device: str) -> None:
        """Moves `model` to `device`; RuntimeError or AssertionError if there is none such."""
        torch.set_num_threads(1)  # episodes run in parallel, and a map is too small to share
        self._device = device
        # torch's own annotations do not know memory_format
        self._model = model.eval().to(device, memory_format=torch.channels_last)  # type: ignore[call-overload]

    @torch.inference_mode()
    def p_wall(self, cells: Grid) -> npt.NDArray[np.float32]:
        """P(occupied) of every cell of int8[H, W] `cells`, H and W multiples of 8."""
        maps = torch.from_numpy(np.ascontiguousarray(cells[None])).to(self._device)
        logits = self._model(one_hot(maps))
        return torch.sigmoid(logits[0, 0]).cpu().numpy().astype(np.float32, copy=False)


def pad_to_multiple(cells: Grid, padding: int) -> Grid:
    """`cells` with rows and columns of `padding` added at the high ends, to a multiple of 8."""
    height, width = cells.shape
    if height % STRIDE_MULTIPLE == width % STRIDE_MULTIPLE == 0:
        return cells
    return np.pad(
        cells,
        ((0, -height % STRIDE_MULTIPLE), (0, -width % STRIDE_MULTIPLE)),
        constant_values=padding,
    )


def one_hot(maps: Tensor) -> Tensor:
    """int8[B, H, W] cells to float32[B, 3, H, W], channels last in memory; `OUTSIDE` is 0, 0, 0."""
    channels = torch.stack([maps == OCCUPIED, maps == FREE, maps == UNKNOWN], dim=1)
    return channels.to(torch.float32).contiguous(memory_format=torch.channels_last)
