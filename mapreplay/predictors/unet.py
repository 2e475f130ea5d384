"""A second map predictor: a U-Net that sees the whole floor plan at its coarsest level.

After Ronneberger et al. 2015, for maps in which a wall is one cell thick: the map is folded to
half its size first (2 x 2 cells become channels), so that no cell is lost and the finest level
costs a quarter; then four times halved, each level with two 3x3 convolutions down and two up.
Each is followed by batch normalization, which is part of the convolution once it is trained.
"""

from __future__ import annotations

from copy import deepcopy
from itertools import pairwise
from typing import Final

import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.nn.utils.fusion import fuse_conv_bn_eval

WIDTHS: Final = (32, 48, 64, 96, 96)
"""Channels of the levels, at 1/2, 1/4, ... 1/32 of the map's size."""

CERTAIN: Final = 12.0
"""Logit of a cell that was observed to be a wall."""


class UNet(nn.Module):
    """One-hot maps float[B, 3, H, W] (occupied, free, unknown) to logits float[B, 1, H, W].

    H and W are multiples of 2. Cells outside of the floor plan's grid (`network.OUTSIDE`) are 0
    in all three channels: where the grid ends is known. Observed cells are unchanged.
    """

    def __init__(self) -> None:
        super().__init__()
        finest = WIDTHS[0]
        self.stem = _Convolution(3 * 4, finest)
        self.down = nn.ModuleList(
            nn.Sequential(_Convolution(before, width, stride), _Convolution(width, width))
            for before, width, stride in zip(
                (finest, *WIDTHS), WIDTHS, (1, *[2] * (len(WIDTHS) - 1)), strict=False
            )
        )
        self.up = nn.ModuleList(
            nn.Sequential(_Convolution(coarse + fine, fine), _Convolution(fine, fine))
            for coarse, fine in pairwise(reversed(WIDTHS))
        )
        self.head = nn.Conv2d(finest, 4, 1)

    def forward(self, one_hot: Tensor) -> Tensor:
        """See the class."""
        hidden = functional.pixel_unshuffle(one_hot, 2)
        hidden = self.stem(hidden.contiguous(memory_format=torch.channels_last))
        skips = []
        for level in self.down:
            hidden = level(hidden)
            skips.append(hidden)
        skips.pop()
        for level in self.up:
            skip = skips.pop()
            doubled = functional.interpolate(hidden, scale_factor=2.0)
            doubled = doubled[:, :, : skip.shape[2], : skip.shape[3]]  # a level of odd size
            hidden = level(torch.cat([doubled, skip], dim=1))
        logits = functional.pixel_shuffle(self.head(hidden), 2)
        seen = one_hot[:, :1] - one_hot[:, 1:2]
        return torch.where(seen == 0, logits, seen * CERTAIN)


def fused(model: nn.Module) -> nn.Module:
    """A copy of a trained `model` with its normalizations multiplied into its convolutions."""
    copy = deepcopy(model).eval()
    for module in copy.modules():
        if isinstance(module, _Convolution):
            module.fuse()
    return copy


class _Convolution(nn.Module):
    def __init__(self, before: int, after: int, stride: int = 1) -> None:
        super().__init__()
        self.convolve = nn.Conv2d(before, after, 3, stride=stride, padding=1, bias=False)
        self.normalize: nn.Module = nn.BatchNorm2d(after)

    def forward(self, hidden: Tensor) -> Tensor:
        activations: Tensor = functional.relu(self.normalize(self.convolve(hidden)))
        return activations

    def fuse(self) -> None:
        if isinstance(self.normalize, nn.BatchNorm2d):
            self.convolve = fuse_conv_bn_eval(self.convolve, self.normalize)
            self.normalize = nn.Identity()
