"""Batches in the order of the training, made in advance by other processes if there are any."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from typing import Final, NamedTuple, TypeAlias

import cv2

from mapreplay.errors import MapreplayError
from mapreplay.processes.workers import in_order
from mapreplay.training.dataset import Batch, Epoch

AHEAD: Final = 4
"""Number of batches that each process makes in advance."""

BatchMaps: TypeAlias = Sequence[tuple[int, int]]
"""(index of plan, run) of each map of a batch."""


class BatchPosition(NamedTuple):
    """The position of a batch in the training."""

    epoch: int
    batch: int


def batches_from(
    epoch: Callable[[int], Epoch], first: BatchPosition, jobs: int
) -> Iterator[tuple[BatchPosition, Batch]]:
    """All batches from `first` on, without end; the same whatever the number of `jobs`.

    Raises:
        MapreplayError: there are so few maps that an epoch has no batch, or a process died.
    """

    def make(item: tuple[BatchPosition, BatchMaps]) -> tuple[BatchPosition, Batch]:
        place, group = item
        return place, epoch(place.epoch).batch(group)

    def make_there(item: tuple[BatchPosition, BatchMaps]) -> tuple[BatchPosition, Batch]:
        cv2.setNumThreads(0)  # parallelism comes from the processes
        return make(item)

    groups = _groups(epoch, first)
    if jobs == 1:
        yield from map(make, groups)
        return
    # The processes are copies of this one and share its plans.
    with closing(in_order(make_there, groups, jobs, AHEAD)) as batches:
        yield from batches


def _groups(
    epoch: Callable[[int], Epoch], first: BatchPosition
) -> Iterator[tuple[BatchPosition, BatchMaps]]:
    number, begin = first
    while True:
        groups = epoch(number).batches()
        if not groups:
            raise MapreplayError(
                "too few maps to train on: this network needs two of one size at once"
            )
        for i in range(begin, len(groups)):
            yield BatchPosition(number, i), groups[i]
        number, begin = number + 1, 0
