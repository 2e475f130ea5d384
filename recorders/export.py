"""A log's arrays as one NumPy file, and its maps as pictures."""

from __future__ import annotations

import zipfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, closing
from gzip import GzipFile
from pathlib import Path
from tempfile import SpooledTemporaryFile
from typing import IO, Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from mapreplay.errors import LogError
from mapreplay.files.whole import check_new, make_folder, whole_path, write_whole
from mapreplay.grid import FREE, OCCUPIED, Grid, Quantized
from mapreplay.mapping import dequantize
from mapreplay.pictures import png_of
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.sensor import Hits
from mapreplay.step import StepMetrics

UNKNOWN_GREY: Final = 160
FREE_GREY: Final = 250
OCCUPIED_GREY: Final = 30

MAX_SIDE: Final = 16384
"""Pixels along the longer side above which a picture is refused."""

IN_MEMORY: Final = 64 << 20
"""Bytes of each kind of map, packed, beyond which they wait on the disk."""
_BLOCK: Final = 1 << 20

Array = npt.NDArray[Any]


def export_arrays(log: EpisodeLog, path: Path, *, force: bool = False) -> None:
    """Write all arrays of a log to the ``.npz`` file `path`, n steps stacked.

    step: int32[n], their numbers; observed, fused: int8[n, H, W]; p_wall: uint8, uint16 or
    float32[m, H, W] of the m steps in p_wall_step, both only if there was a prediction; truth:
    int8[H, W]; explorable: bool[H, W]; agent, target: int32[n, 2] (row, col), the target -1 where
    there is none; hits: int16[n, rays], -1 at steps without a scan (int16[n, 0] without any); and
    a float64[n] for each of `StepMetrics`, NaN where undefined. The log is read once; maps beyond
    `IN_MEMORY` bytes wait on the disk, packed.

    Raises:
        LogError: the log is damaged.
        ExistsError, WriteError: see `mapreplay.files.whole_path`.
    """
    with (
        whole_path(path, force=force) as draft,
        zipfile.ZipFile(draft, "w", zipfile.ZIP_DEFLATED) as archive,
        ExitStack() as opened,
    ):
        stacks = [opened.enter_context(closing(_Stack(path.parent))) for _ in range(3)]
        _add_arrays(archive, log, stacks)


class _Stack:
    """Arrays that wait, packed, until it is known how many they are."""

    def __init__(self, folder: Path) -> None:
        self._file = SpooledTemporaryFile[bytes](IN_MEMORY, dir=str(folder))
        self._packed = GzipFile(fileobj=self._file, mode="wb", compresslevel=1)

    def add(self, array: Array) -> None:
        """One more."""
        self._packed.write(array.tobytes())

    def blocks(self) -> Iterator[bytes]:
        """The bytes of all of them."""
        self._packed.close()
        self._file.seek(0)
        unpacked = GzipFile(fileobj=self._file, mode="rb")
        while block := unpacked.read(_BLOCK):
            yield block

    def close(self) -> None:
        """Free what they take."""
        self._file.close()


def _add_arrays(archive: zipfile.ZipFile, log: EpisodeLog, stacks: Sequence[_Stack]) -> None:
    observed, fused, p_wall = stacks
    agents, targets, hits, metrics, predicted = [], [], [], [], []
    prediction_dtype: np.dtype[Any] | None = None
    for step in log.steps():
        agents.append(step.agent)
        targets.append(step.decision.target if step.decision else (-1, -1))
        hits.append(step.hits)
        metrics.append([getattr(step.metrics, name) for name in StepMetrics.names()])
        observed.add(step.observed)
        fused.add(step.fused)
        if step.p_wall is not None:
            if prediction_dtype not in (None, step.p_wall.dtype):
                raise LogError(
                    f"{log.path}: step {step.index}: its prediction is of another type than before"
                )
            predicted.append(step.index)
            prediction_dtype = step.p_wall.dtype
            p_wall.add(step.p_wall)
    count, shape = len(agents), log.header.floor_plan.shape
    arrays: dict[str, Array] = {
        "step": np.array(log.indices, np.int32),
        "truth": log.header.floor_plan.cells,
        "explorable": log.header.explorable,
        "agent": np.array(agents, np.int32).reshape(count, 2),
        "target": np.array(targets, np.int32).reshape(count, 2),
        "hits": _stacked(hits),
    }
    columns = np.array(metrics, np.float64).reshape(count, len(StepMetrics.names()))
    arrays |= dict(zip(StepMetrics.names(), columns.T, strict=True))
    for name, array in arrays.items():
        _add(archive, name, array.dtype, array.shape, [array.tobytes()])
    for name, stack in (("observed", observed), ("fused", fused)):
        _add(archive, name, np.dtype(np.int8), (count, *shape), stack.blocks())
    if prediction_dtype is not None:
        of_step = np.array(predicted, np.int32)
        _add(archive, "p_wall_step", of_step.dtype, of_step.shape, [of_step.tobytes()])
        _add(archive, "p_wall", prediction_dtype, (len(predicted), *shape), p_wall.blocks())


def _stacked(hits: list[Hits]) -> Array:
    """int16[n, rays]: the hits of all steps, -1 where there was no scan."""
    rays = max((len(of_step) for of_step in hits), default=0)
    stack = np.full((len(hits), rays), -1, np.int16)
    for row, of_step in zip(stack, hits, strict=True):
        row[: len(of_step)] = of_step
    return stack


def _add(
    archive: zipfile.ZipFile,
    name: str,
    dtype: np.dtype[Any],
    shape: tuple[int, ...],
    blocks: Iterable[bytes],
) -> None:
    """Write one array of `shape` whose memory is that of `blocks`, one after the other."""
    # A fixed date, so that the same log gives the same file.
    entry = zipfile.ZipInfo(f"{name}.npy", date_time=(1980, 1, 1, 0, 0, 0))
    entry.compress_type = zipfile.ZIP_DEFLATED
    with archive.open(entry, "w", force_zip64=True) as file:
        _write_npy_header(file, dtype, shape)
        for block in blocks:
            file.write(block)


def _write_npy_header(file: IO[bytes], dtype: np.dtype[Any], shape: tuple[int, ...]) -> None:
    descr = np.lib.format.dtype_to_descr(dtype)
    np.lib.format.write_array_header_1_0(
        file, {"descr": descr, "fortran_order": False, "shape": shape}
    )


def export_images(
    log: EpisodeLog, folder: Path, steps: Sequence[int], scale: int = 4, *, force: bool = False
) -> list[Path]:
    """Write the maps of some steps as PNG, `scale` pixels a cell, row 0 at the bottom.

    ``truth.png``, and ``step-<k>-observed.png``, ``-fused.png`` and, if there was a
    prediction, ``-predicted.png`` for each step: unknown is grey, free nearly white, occupied
    dark, and a prediction in between. Returns the files.

    Raises:
        LogError: there is no such step, the log is damaged, or a picture would be too large.
        ExistsError: a file is there; then none is written.
        WriteError: a file cannot be written; each of the others is whole.
    """
    side = max(log.header.floor_plan.shape)
    if not 1 <= scale <= MAX_SIDE // side:
        raise LogError(f"scale {scale}: must be 1 to {MAX_SIDE // side} for maps of {side} cells")
    for k in steps:
        if not 0 <= k <= log.last:
            raise LogError(f"{log.path}: no step {k}; it has steps 0 to {log.last}")
        log.check_step(k)
    pictures = {folder / f"{name}.png": _png(grey, scale) for name, grey in _pictures(log, steps)}
    make_folder(folder)
    for path in pictures:
        check_new(path, force=force)
    for path, data in pictures.items():
        write_whole(path, data, force=force)
    return list(pictures)


def _pictures(log: EpisodeLog, steps: Sequence[int]) -> Iterator[tuple[str, npt.NDArray[np.uint8]]]:
    yield "truth", shade(log.header.floor_plan.cells)
    for k in steps:
        step, name = log[k], f"step-{k:06d}"
        yield f"{name}-observed", shade(step.observed)
        yield f"{name}-fused", shade(step.fused)
        if step.p_wall is not None:
            yield f"{name}-predicted", shade_prediction(step.p_wall)


def shade(cells: Grid) -> npt.NDArray[np.uint8]:
    """uint8[H, W]: a map's cells as greys."""
    greys = np.full(cells.shape, UNKNOWN_GREY, np.uint8)
    greys[cells == FREE] = FREE_GREY
    greys[cells == OCCUPIED] = OCCUPIED_GREY
    return greys


def shade_prediction(p_wall: Quantized) -> npt.NDArray[np.uint8]:
    """uint8[H, W]: P(occupied) as a grey between those of free and occupied."""
    span = OCCUPIED_GREY - FREE_GREY
    return np.rint(FREE_GREY + span * dequantize(p_wall)).astype(np.uint8)


def _png(grey: npt.NDArray[np.uint8], scale: int) -> bytes:
    picture = np.flipud(grey)  # pictures have row 0 on top
    size = (picture.shape[1] * scale, picture.shape[0] * scale)
    large = cv2.resize(picture, size, interpolation=cv2.INTER_NEAREST)
    return png_of(np.asarray(large, np.uint8))
