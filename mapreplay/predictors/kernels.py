"""Compiled layers of the paper's network: every 3x3 convolution with 25 kernels, on one map.

All of them are small matrix products on blocks of 16 positions (`_multiply`): a layer gathers
what 16 positions see into columns, multiplies, and writes the sum with bias, skip and ReLU.
Layers of stride 1 are done by Winograd's minimal filtering F(4x4, 3x3), where a position is a
tile of 4x4 cells and costs 36 multiplications instead of 144 (Lavin and Gray 2016,
arXiv:1509.09308, section 4.3).

An activation is float32[25, 1 + rows + 1, 1 + cols + 1] with a border of zeros, its rows and
columns rounded up to whole tiles. One map is computed at a time and each sum is made in a
fixed order, without `fastmath`: the numbers depend on the map and nothing else.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from mapreplay.compiled import njit

KERNELS: Final = 25
LANES: Final = 16
"""Positions of a block."""
GROUP: Final = 5
"""Kernels that are summed at a time: 5 x 16 sums fill the vector registers."""
TILE: Final = 4
SPOTS: Final = 36
"""Of a tile in Winograd's domain."""
_VECTOR: Final = 8


@intrinsic
def _multiply_group(
    _: Any, weights: Any, w: Any, columns: Any, c: Any, sums: Any, s: Any, depth: Any
) -> Any:
    """sums[s + 16 g + l] = sum over k < depth of weights[w + 5 k + g] * columns[c + 16 k + l].

    For the 5 kernels g and 16 positions l; all flat float32. Written as LLVM vectors because
    no loop that numba compiles keeps its 80 sums in registers.
    """
    signature = types.void(weights, w, columns, c, sums, s, depth)

    def generate(context: Any, builder: Any, _: Any, arguments: Any) -> Any:
        vector = ir.VectorType(ir.FloatType(), _VECTOR)
        whole = arguments[1].type
        fma = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(vector, [vector] * 3), f"llvm.fmuladd.v{_VECTOR}f32"
        )

        def data(array: int) -> Any:
            kind, value = signature.args[array], arguments[array]
            start = context.make_array(kind)(context, builder, value=value).data
            return builder.gep(start, [arguments[array + 1]])

        def at(start: Any, index: Any) -> Any:
            return builder.bitcast(builder.gep(start, [index]), vector.as_pointer())

        factors, inputs, out = data(0), data(2), data(4)
        halves = [ir.Constant(whole, half) for half in range(0, LANES, _VECTOR)]
        zero = ir.Constant(vector, [0.0] * _VECTOR)
        lanes = ir.Constant(ir.VectorType(ir.IntType(32), _VECTOR), [0] * _VECTOR)
        totals = [cgutils.alloca_once_value(builder, zero) for _ in range(GROUP * len(halves))]
        with cgutils.for_range(builder, arguments[6], intp=whole) as loop:
            column = builder.mul(loop.index, ir.Constant(whole, LANES))
            x = [builder.load(at(inputs, builder.add(column, h)), align=4) for h in halves]
            first = builder.mul(loop.index, ir.Constant(whole, GROUP))
            for g in range(GROUP):
                place = builder.add(first, ir.Constant(whole, g))
                factor = builder.load(builder.gep(factors, [place]), align=4)
                one = builder.insert_element(zero, factor, ir.Constant(ir.IntType(32), 0))
                factor = builder.shuffle_vector(one, zero, lanes)
                for total, value in zip(totals[g * len(x) :], x, strict=False):
                    builder.store(builder.call(fma, [factor, value, builder.load(total)]), total)
        for i, total in enumerate(totals):
            place = ir.Constant(whole, i * _VECTOR)
            builder.store(builder.load(total), at(out, place), align=4)
        return context.get_dummy_value()

    return signature, generate


@njit
def _multiply(weights: Any, w: int, columns: Any, c: int, sums: Any, s: int, depth: int) -> None:
    """sums[25, 16] at s = weights[25, depth] at w, packed, times columns[depth, 16] at c."""
    for group in range(KERNELS // GROUP):
        w_group, s_group = w + group * depth * GROUP, s + group * GROUP * LANES
        _multiply_group(weights, w_group, columns, c, sums, s_group, depth)  # type: ignore[call-arg]


@njit
def first_layer(image: Any, weights: Any, bias: Any, out: Any) -> None:
    """ReLU(3x3 convolution) of one channel, float32[1 + H + 1, 1 + W + 1], into 25."""
    rows, cols = image.shape[0] - 2, image.shape[1] - 2
    for o in range(KERNELS):
        k0, k1, k2 = weights[o, 0, 0], weights[o, 0, 1], weights[o, 0, 2]
        k3, k4, k5 = weights[o, 1, 0], weights[o, 1, 1], weights[o, 1, 2]
        k6, k7, k8 = weights[o, 2, 0], weights[o, 2, 1], weights[o, 2, 2]
        b = bias[o]
        for r in range(rows):
            above, here, below = image[r], image[r + 1], image[r + 2]
            target = out[o, r + 1, 1 : cols + 1]
            for x in range(cols):
                total = b + k0 * above[x] + k1 * above[x + 1] + k2 * above[x + 2]
                total += k3 * here[x] + k4 * here[x + 1] + k5 * here[x + 2]
                total += k6 * below[x] + k7 * below[x + 1] + k8 * below[x + 2]
                target[x] = max(total, np.float32(0))


@njit
def last_layer(hidden: Any, image: Any, weights: Any, bias: Any, logits: Any) -> None:
    """3x3 convolution of 25 channels and the input itself into logits float32[H, W]."""
    rows, cols = logits.shape
    for r in range(rows):
        target = logits[r]
        target[:] = bias
        for c in range(KERNELS + 1):
            if c < KERNELS:
                above, here, below = hidden[c, r], hidden[c, r + 1], hidden[c, r + 2]
            else:
                above, here, below = image[r], image[r + 1], image[r + 2]
            k0, k1, k2 = weights[c, 0, 0], weights[c, 0, 1], weights[c, 0, 2]
            k3, k4, k5 = weights[c, 1, 0], weights[c, 1, 1], weights[c, 1, 2]
            k6, k7, k8 = weights[c, 2, 0], weights[c, 2, 1], weights[c, 2, 2]
            for x in range(cols):
                total = k0 * above[x] + k1 * above[x + 1] + k2 * above[x + 2]
                total += k3 * here[x] + k4 * here[x + 1] + k5 * here[x + 2]
                total += k6 * below[x] + k7 * below[x + 1] + k8 * below[x + 2]
                target[x] += total


@njit
def _tile_rows(source: Any, first: int, count: int, strips: Any) -> None:
    """B^T of Winograd's input, on the rows: source float32[6, cols], strips flat [6, 80].

    `count` tiles from tile `first` on.
    """
    n = TILE * count + 2
    x = TILE * first
    d0, d1, d2 = source[0, x : x + n], source[1, x : x + n], source[2, x : x + n]
    d3, d4, d5 = source[3, x : x + n], source[4, x : x + n], source[5, x : x + n]
    four, five, two = np.float32(4), np.float32(5), np.float32(2)
    for i in range(n):
        a, b = d4[i] - four * d2[i], d3[i] - four * d1[i]
        c, d = d4[i] - d2[i], two * (d3[i] - d1[i])
        strips[i] = four * d0[i] - five * d2[i] + d4[i]
        strips[80 + i] = a + b
        strips[160 + i] = a - b
        strips[240 + i] = c + d
        strips[320 + i] = c - d
        strips[400 + i] = four * d1[i] - five * d3[i] + d5[i]


@njit
def _tile_cols(strips: Any, count: int, columns: Any) -> None:
    """B^T on the columns: strips flat [6, 80] to columns flat [36, 25, 16], from its start."""
    four, five, two = np.float32(4), np.float32(5), np.float32(2)
    for i in range(6):
        s = strips[80 * i : 80 * i + 80]
        v = columns[6 * i * KERNELS * LANES :]
        for t in range(count):
            d0, d1, d2 = s[4 * t], s[4 * t + 1], s[4 * t + 2]
            d3, d4, d5 = s[4 * t + 3], s[4 * t + 4], s[4 * t + 5]
            a, b = d4 - four * d2, d3 - four * d1
            c, d = d4 - d2, two * (d3 - d1)
            v[t] = four * d0 - five * d2 + d4
            v[t + KERNELS * LANES] = a + b
            v[t + 2 * KERNELS * LANES] = a - b
            v[t + 3 * KERNELS * LANES] = c + d
            v[t + 4 * KERNELS * LANES] = c - d
            v[t + 5 * KERNELS * LANES] = four * d1 - five * d3 + d5


@njit
def _untile(sums: Any, half: Any, cells: Any) -> None:
    """A^T m A of Winograd's output: sums flat [36, 25, 16] from a kernel's start to cells
    flat [4, 64], the rows of 16 tiles side by side; half: flat [24, 16], scratch.
    """
    step = KERNELS * LANES
    two, four, eight = np.float32(2), np.float32(4), np.float32(8)
    for j in range(6):
        m = sums[j * step :]
        h = half[j * LANES :]
        for t in range(LANES):
            m0, m1, m2 = m[t], m[t + 6 * step], m[t + 12 * step]
            m3, m4, m5 = m[t + 18 * step], m[t + 24 * step], m[t + 30 * step]
            a, b, c, d = m1 + m2, m1 - m2, m3 + m4, m3 - m4
            h[t] = m0 + a + c
            h[t + 6 * LANES] = b + two * d
            h[t + 12 * LANES] = a + four * c
            h[t + 18 * LANES] = b + eight * d + m5
    for i in range(TILE):
        h = half[6 * i * LANES :]
        y = cells[64 * i :]
        for t in range(LANES):
            m0, m1, m2 = h[t], h[t + LANES], h[t + 2 * LANES]
            m3, m4, m5 = h[t + 3 * LANES], h[t + 4 * LANES], h[t + 5 * LANES]
            a, b, c, d = m1 + m2, m1 - m2, m3 + m4, m3 - m4
            y[4 * t] = m0 + a + c
            y[4 * t + 1] = b + two * d
            y[4 * t + 2] = a + four * c
            y[4 * t + 3] = b + eight * d + m5


@njit
def plain_layer(
    source: Any, rows: int, cols: int, weights: Any, bias: Any, out: Any, scratch: Any
) -> None:
    """ReLU(3x3 convolution of stride 1, plus what is in `out`), into `out`.

    weights: flat [36, 25 / 5, 25, 5] in Winograd's domain; see `inference.pack`.
    scratch: float32[2, 36 * 25 * 16].
    """
    across = (cols + TILE - 1) // TILE
    tiles = across * ((rows + TILE - 1) // TILE)
    columns, sums = scratch[0], scratch[1]
    strips = np.empty(6 * 80, np.float32)
    half = np.empty(24 * LANES, np.float32)
    cells = np.empty(4 * 64, np.float32)
    zero = np.float32(0)
    for block in range(0, tiles, LANES):
        end = min(block + LANES, tiles)
        tile = block
        while tile < end:  # the tiles of a block may lie in several rows of tiles
            r, first = tile // across, tile % across
            count = min(across - first, end - tile)
            for c in range(KERNELS):
                _tile_rows(source[c, TILE * r : TILE * r + 6], first, count, strips)
                _tile_cols(strips, count, columns[c * LANES + tile - block :])
            tile += count
        for spot in range(SPOTS):
            at = spot * KERNELS * LANES
            _multiply(weights, spot * KERNELS * KERNELS, columns, at, sums, at, KERNELS)
        for o in range(KERNELS):
            _untile(sums[o * LANES :], half, cells)
            b = bias[o]
            tile = block
            while tile < end:
                r, first = tile // across, tile % across
                count = min(across - first, end - tile)
                n = min(TILE * count, cols - TILE * first)
                x = TILE * first + 1
                for i in range(min(TILE, rows - TILE * r)):
                    target = out[o, TILE * r + i + 1, x : x + n]
                    y = cells[64 * i + TILE * (tile - block) :]
                    for k in range(n):
                        target[k] = max(target[k] + (y[k] + b), zero)
                tile += count


@njit
def halving_layer(
    source: Any, rows: int, cols: int, weights: Any, bias: Any, out: Any, scratch: Any
) -> None:
    """ReLU(3x3 convolution of stride 2) into `out`, which has `rows` x `cols` cells.

    weights: flat [25 / 5, 9 * 25, 5]. scratch: as for `plain_layer`.
    """
    columns, sums = scratch[0], scratch[1]
    cells = rows * cols
    zero = np.float32(0)
    for block in range(0, cells, LANES):
        end = min(block + LANES, cells)
        cell = block
        while cell < end:
            r, first = cell // cols, cell % cols
            count = min(cols - first, end - cell)
            for tap in range(9):
                x = 2 * first + tap % 3
                for c in range(KERNELS):
                    seen = source[c, 2 * r + tap // 3, x : x + 2 * count]
                    column = columns[(tap * KERNELS + c) * LANES + cell - block :]
                    for k in range(count):
                        column[k] = seen[2 * k]
            cell += count
        _multiply(weights, 0, columns, 0, sums, 0, 9 * KERNELS)
        for o in range(KERNELS):
            b = bias[o]
            cell = block
            while cell < end:
                r, first = cell // cols, cell % cols
                count = min(cols - first, end - cell)
                target = out[o, r + 1, first + 1 : first + 1 + count]
                y = sums[o * LANES + cell - block :]
                for k in range(count):
                    target[k] = max(y[k] + b, zero)
                cell += count


@njit
def doubling_layer(
    source: Any, rows: int, cols: int, weights: Any, bias: Any, out: Any, scratch: Any
) -> None:
    """ReLU(transposed 3x3 convolution of stride 2, plus what is in `out`) into `out`.

    `source` has `rows` x `cols` cells, `out` twice as many each way. Cell (2 r + i, 2 c + j)
    sees 1, 2, 2 or 4 of the cells at (r, c + 1), (r, c), (r + 1, c), (r + 1, c + 1): always
    neighbours in this list. weights: flat, the packed ones of these four cases in a row.
    """
    columns, sums = scratch[0], scratch[1]
    cells = rows * cols
    zero = np.float32(0)
    size = KERNELS * KERNELS
    for block in range(0, cells, LANES):
        end = min(block + LANES, cells)
        cell = block
        while cell < end:
            r, first = cell // cols, cell % cols
            count = min(cols - first, end - cell)
            for tap in range(4):
                y, x = r + 1 + tap // 2, first + 1 + (1 if tap in (0, 3) else 0)
                for c in range(KERNELS):
                    seen = source[c, y, x : x + count]
                    column = columns[(tap * KERNELS + c) * LANES + cell - block :]
                    for k in range(count):
                        column[k] = seen[k]
            cell += count
        step = KERNELS * LANES
        _multiply(weights, 0, columns, step, sums, 0, KERNELS)
        _multiply(weights, size, columns, 0, sums, step, 2 * KERNELS)
        _multiply(weights, 3 * size, columns, step, sums, 2 * step, 2 * KERNELS)
        _multiply(weights, 5 * size, columns, 0, sums, 3 * step, 4 * KERNELS)
        for o in range(KERNELS):
            b = bias[o]
            cell = block
            while cell < end:
                r, first = cell // cols, cell % cols
                count = min(cols - first, end - cell)
                for i in range(2):
                    x = 2 * first + 1
                    target = out[o, 2 * r + i + 1, x : x + 2 * count]
                    even = sums[2 * i * step + o * LANES + cell - block :]
                    odd = sums[(2 * i + 1) * step + o * LANES + cell - block :]
                    for k in range(count):
                        target[2 * k] = max(target[2 * k] + (even[k] + b), zero)
                        target[2 * k + 1] = max(target[2 * k + 1] + (odd[k] + b), zero)
                cell += count
