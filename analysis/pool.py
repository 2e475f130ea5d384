"""The same work on many items, in several processes."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from functools import partial
from typing import Final, TypeVar

from mapreplay.errors import MapreplayError
from mapreplay.processes.workers import Died, Yielded, once, run_each

_T = TypeVar("_T")
_R = TypeVar("_R")

WORTH_A_PROCESS: Final = 16
"""Pieces of work below which starting another process takes longer than it saves."""


class WorkerError(MapreplayError):
    """A process of a pool ended in the middle of its work."""

    def __init__(self, line: str = "") -> None:
        super().__init__(
            line or "a worker process died, perhaps for want of memory; try again with --jobs 1"
        )


def default_jobs(pieces: int) -> int:
    """As many processes as there are cores and work for them."""
    return max(1, min(cores(), pieces // WORTH_A_PROCESS))


def cores() -> int:
    """Cores that this process may use: under taskset not all of the machine."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def map_unordered(
    work: Callable[[_T], _R],
    items: Sequence[_T],
    jobs: int,
    *,
    lost: Callable[[_T, WorkerError], _R] | None = None,
    name: Callable[[_T], str] | None = None,
) -> Iterator[_R]:
    """work(item) of every item, as they are finished; with one job in this process.

    Results do not pile up: a process has at most one item in advance. `work` must be a function
    of a module. What it raises is raised here and ends the rest; where the rest matters, what it
    returns should say what went wrong. Closing the generator ends the processes, after their
    current items if these are finished soon.

    The death of a process costs its current item. All others are finished first; then it is
    raised, unless `lost` gives a result for the item.

    Args:
        work: What is done.
        items: To what.
        jobs: Processes.
        lost: The result of an item whose process died.
        name: What an item is called in the error; by default its number.

    Raises:
        WorkerError: a process died, and there is no `lost`.
    """
    if jobs == 1 or len(items) < 2:
        yield from map(work, items)
        return
    deaths = []
    with closing(run_each(partial(once, work), items, min(jobs, len(items)))) as events:
        for event in events:
            if isinstance(event, Yielded):
                yield event.what
            elif isinstance(event, Died):
                item = items[event.item]
                called = name(item) if name else f"item {event.item + 1} of {len(items)}"
                error = WorkerError(
                    f"{called}: a worker process died at it ({event.how}), perhaps for want of "
                    "memory; try again with --jobs 1"
                )
                if lost is None:
                    deaths.append(error)
                else:
                    yield lost(item, error)
    if deaths:
        more = f" (and {len(deaths) - 1} more)" if len(deaths) > 1 else ""
        raise WorkerError(f"{deaths[0]}{more}")
