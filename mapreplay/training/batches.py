"""Batches in the order of the training, made ahead by other processes if there are any."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple, TypeAlias

import cv2
from torch.utils.data import DataLoader, Dataset, Sampler

from mapreplay.errors import MapreplayError
from mapreplay.training.dataset import Batch, Epoch

AHEAD: Final = 4
"""Batches that each process makes ahead."""

Group: TypeAlias = Sequence[tuple[int, int]]
"""(index of plan, run) of each map of a batch."""


class Place(NamedTuple):
    """Where a batch comes in the training."""

    epoch: int
    batch: int


def batches_from(
    epoch: Callable[[int], Epoch], first: Place, jobs: int
) -> Iterator[tuple[Place, Batch]]:
    """All batches from `first` on, without end; the same whatever the number of `jobs`.

    Raises:
        MapreplayError: there are so few maps that an epoch has no batch.
    """
    # PyTorch's worker processes are copies of this one and share its plans.
    yield from DataLoader(
        _Batches(epoch),
        sampler=_Order(epoch, first),
        batch_size=None,
        collate_fn=_as_it_is,
        num_workers=jobs if jobs > 1 else 0,
        prefetch_factor=AHEAD if jobs > 1 else None,
        worker_init_fn=_begin,
        multiprocessing_context="fork" if jobs > 1 else None,
    )


@dataclass(frozen=True)
class _Order(Sampler[tuple[Place, Group]]):
    epoch: Callable[[int], Epoch]
    first: Place

    def __iter__(self) -> Iterator[tuple[Place, Group]]:
        number, begin = self.first
        while True:
            groups = self.epoch(number).batches()
            if not groups:
                raise MapreplayError(
                    "too few maps to train on: this network needs two of one size at once"
                )
            for i in range(begin, len(groups)):
                yield Place(number, i), groups[i]
            number, begin = number + 1, 0


@dataclass(frozen=True)
class _Batches(Dataset[tuple[Place, Batch]]):
    epoch: Callable[[int], Epoch]

    def __getitem__(self, item: tuple[Place, Group]) -> tuple[Place, Batch]:
        place, group = item
        return place, self.epoch(place.epoch).batch(group)


def _as_it_is(item: Any) -> Any:
    return item


def _begin(_: int) -> None:
    cv2.setNumThreads(0)  # there are as many processes as are wanted
