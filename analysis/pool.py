"""The same work on many things, in several processes."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import connection
from typing import Final, TypeVar

from mapreplay.errors import MapreplayError
from mapreplay.recorders.batch import ignoring_interrupts

_T = TypeVar("_T")
_R = TypeVar("_R")

WORTH_A_PROCESS: Final = 16
"""Pieces of work below which starting another process takes longer than it saves."""


class WorkerError(MapreplayError):
    """A process of a pool ended in the middle of its work."""


def default_jobs(pieces: int) -> int:
    """As many processes as there are cores, and work for them."""
    return max(1, min(os.cpu_count() or 1, pieces // WORTH_A_PROCESS))


def map_unordered(
    work: Callable[[_T], _R], items: Sequence[_T], jobs: int, ahead: int = 2
) -> Iterator[_R]:
    """work(item) of every item, as they are done; with one job in this process.

    At most `ahead` items a process are under way, so that results do not pile up. `work` must be
    a function of a module. What it raises is raised here and ends the rest; where the rest
    matters, what it returns should say what went wrong. Closing the generator ends the processes
    after the item that each is at.

    Raises:
        WorkerError: a process died.
    """
    if jobs == 1 or len(items) < 2:
        yield from map(work, items)
        return
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(min(jobs, len(items)), context, initializer=_begin)
    waiting, running = iter(items), set[Future[_R]]()
    try:
        while True:
            with ignoring_interrupts():  # this starts processes
                while len(running) < ahead * jobs and (item := next(waiting, None)) is not None:
                    running.add(pool.submit(work, item))
            if not running:
                return
            done, running = wait(running, return_when=FIRST_COMPLETED)
            for future in done:
                yield future.result()
    except BrokenProcessPool:
        raise WorkerError(
            "a worker process died, perhaps for want of memory; try again with --jobs 1"
        ) from None
    finally:
        pool.shutdown(cancel_futures=True)


def _begin() -> None:
    """Only the parent decides what Ctrl-C means (see `mapreplay.recorders.batch`); and a worker
    ends when its parent does, however.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(os, "setpgid"):
        os.setpgid(0, 0)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_after, args=(parent.sentinel,), daemon=True).start()


def _end_after(sentinel: int) -> None:
    connection.wait([sentinel])
    os._exit(1)
