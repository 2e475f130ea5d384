"""The paper's network on the CPU, several times as fast as PyTorch runs it.

One map at a time, with the compiled layers of `kernels`: what a map's prediction is depends on
the map and the weights alone, not on what else is computed, in which order, or in which process.
It differs from PyTorch's in the last digits (see docs/predictors.md).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from threading import Lock
from typing import Final, TypeAlias

import numpy as np
import numpy.typing as npt

from mapreplay.grid import FREE, OCCUPIED, Grid
from mapreplay.predictors import kernels
from mapreplay.predictors.kernels import GROUP, KERNELS, LANES, SPOTS, TILE

Floats: TypeAlias = npt.NDArray[np.float32]

LAYERS: Final = 9
"""Of the encoder, and of the decoder; every third changes the size."""

WINOGRAD_KERNEL: Final = np.array(
    [
        [1 / 4, 0, 0],
        [-1 / 6, -1 / 6, -1 / 6],
        [-1 / 6, 1 / 6, -1 / 6],
        [1 / 24, 1 / 12, 1 / 6],
        [1 / 24, -1 / 12, 1 / 6],
        [0, 0, 1],
    ]
)
"""G of F(4x4, 3x3) (Lavin and Gray 2016, section 4.3): a kernel g becomes G g G^T."""

DOUBLING_TAPS: Final = (
    ((1, 1),),
    ((1, 0), (1, 2)),
    ((2, 1), (0, 1)),
    ((2, 0), (2, 2), (0, 2), (0, 0)),
)
"""Of a transposed convolution of stride 2: the taps that reach the cells (2 r + i, 2 c + j) for
(i, j) = (0, 0), (0, 1), (1, 0), (1, 1), in the order of `kernels.doubling_layer`."""


@dataclass(frozen=True, eq=False)
class _Layer:
    weights: Floats
    """Packed for its kernel, flat."""
    bias: Floats
    """float32[25]."""


@dataclass(frozen=True, eq=False)
class _Scratch:
    """Memory for maps of one shape, kept from one map to the next."""

    image: Floats
    """float32[1 + H + 1, 1 + W + 1]: the learned input; the border stays 0."""
    activations: tuple[Floats, ...]
    """Of the encoder's layers, see `kernels`. The decoder adds to what it finds there: that is
    the skip, and no other memory is needed."""
    block: Floats
    """float32[2, 36 * 25 * 16]."""

    @classmethod
    def of_shape(cls, height: int, width: int) -> _Scratch:
        def activation(level: int) -> Floats:
            rows, cols = (-(-(size >> level) // TILE) * TILE + 2 for size in (height, width))
            return np.zeros((KERNELS, rows, cols), np.float32)

        return cls(
            np.zeros((height + 2, width + 2), np.float32),
            tuple(activation((i + 1) // 3) for i in range(LAYERS)),
            np.zeros((2, SPOTS * KERNELS * LANES), np.float32),
        )


class CompiledNetwork:
    """`network.MapPredictor`, computed by compiled kernels."""

    def __init__(self, weights: Mapping[str, Floats]) -> None:
        """`weights` by the names of `MapPredictor.state_dict()`."""
        arrays = {name: np.array(value, np.float32) for name, value in weights.items()}
        self._embed = arrays["embed.weight"].ravel()
        self._first = _Layer(arrays["encoder.0.weight"][:, 0].copy(), arrays["encoder.0.bias"])
        self._encoder, self._decoder = [], []
        for i in range(1, LAYERS):
            weight, bias = arrays[f"encoder.{i}.weight"], arrays[f"encoder.{i}.bias"]
            packed = pack_halving(weight) if _halves(i) else pack_plain(weight)
            self._encoder.append(_Layer(packed, bias))
        for i in range(LAYERS):
            weight, bias = arrays[f"decoder.{i}.weight"], arrays[f"decoder.{i}.bias"]
            # A transposed convolution of stride 1 is a convolution with the kernel turned round.
            turned = weight.transpose(1, 0, 2, 3)[:, :, ::-1, ::-1]
            packed = pack_doubling(weight) if _doubles(i) else pack_plain(turned)
            self._decoder.append(_Layer(packed, bias))
        self._head = arrays["head.weight"][0].copy()
        self._head_bias = arrays["head.bias"][0]
        self._lock = Lock()
        self._scratch: _Scratch | None = None

    def p_wall(self, cells: Grid) -> Floats:
        """P(occupied) of every cell of int8[H, W] `cells`, H and W multiples of 8."""
        with np.errstate(over="ignore"):  # exp of a huge number is infinite, and 1 / that is 0
            odds = np.exp(-self.logits(cells))
        return np.asarray(1 / (1 + odds), np.float32)

    def logits(self, cells: Grid) -> Floats:
        """float32[H, W], for int8[H, W] `cells`, H and W multiples of 8."""
        height, width = cells.shape
        logits = np.empty((height, width), np.float32)
        with self._lock:
            if self._scratch is None or self._scratch.image.shape != (height + 2, width + 2):
                self._scratch = _Scratch.of_shape(height, width)
            self._forward(cells, self._scratch, logits)
        return logits

    def _forward(self, cells: Grid, scratch: _Scratch, logits: Floats) -> None:
        (height, width), hidden, block = cells.shape, scratch.activations, scratch.block
        occupied, free, unknown = self._embed
        learned = np.where(cells == OCCUPIED, occupied, np.where(cells == FREE, free, unknown))
        scratch.image[1:-1, 1:-1] = learned
        kernels.first_layer(scratch.image, self._first.weights, self._first.bias, hidden[0])
        for i, layer in enumerate(self._encoder, 1):
            level = (i + 1) // 3
            rows, cols = height >> level, width >> level
            source, out, w, b = hidden[i - 1], hidden[i], layer.weights, layer.bias
            if _halves(i):
                kernels.halving_layer(source, rows, cols, w, b, out, block)
            else:
                out.fill(0)  # there is no skip to add to
                kernels.plain_layer(source, rows, cols, w, b, out, block)
        source = hidden[-1]
        for i, layer in enumerate(self._decoder):
            level = (LAYERS - i) // 3
            rows, cols = height >> level, width >> level
            out, w, b = hidden[LAYERS - 2 - i], layer.weights, layer.bias
            if i == LAYERS - 1:  # no skip is left: any memory of that size
                out = hidden[1]
                out.fill(0)
            if _doubles(i):
                kernels.doubling_layer(source, rows, cols, w, b, out, block)
            else:
                kernels.plain_layer(source, rows, cols, w, b, out, block)
            source = out
        kernels.last_layer(source, scratch.image, self._head, self._head_bias, logits)


def _halves(layer: int) -> bool:
    return layer % 3 == 2


def _doubles(layer: int) -> bool:
    return layer % 3 == 0


def _pack(matrices: npt.NDArray[np.floating]) -> Floats:
    """[n, 25, depth] matrices as the kernels read them: flat [n, 25 / 5, depth, 5]."""
    n, _, depth = matrices.shape
    groups = matrices.reshape(n, KERNELS // GROUP, GROUP, depth).transpose(0, 1, 3, 2)
    return np.ascontiguousarray(groups, np.float32).ravel()


def pack_plain(weight: Floats) -> Floats:
    """Convolution weights [out, in, 3, 3] in Winograd's domain, for `kernels.plain_layer`."""
    g = WINOGRAD_KERNEL
    turned = np.einsum("ia,ocab,jb->ijoc", g, weight.astype(np.float64), g)
    return _pack(turned.reshape(SPOTS, KERNELS, KERNELS))


def pack_halving(weight: Floats) -> Floats:
    """Convolution weights [out, in, 3, 3], for `kernels.halving_layer`."""
    return _pack(weight.transpose(0, 2, 3, 1).reshape(1, KERNELS, 9 * KERNELS))


def pack_doubling(weight: Floats) -> Floats:
    """Transposed convolution's weights [in, out, 3, 3], for `kernels.doubling_layer`."""
    taps = weight.transpose(1, 0, 2, 3)
    cases = [np.concatenate([taps[:, :, y, x] for y, x in case], axis=1) for case in DOUBLING_TAPS]
    return np.concatenate([_pack(case[None]) for case in cases])
