"""Running an experiment: every core, every finished row on disk, resumed where it was stopped."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Generator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import connection
from typing import Final

from mapreplay.analysis.experiment.jobs import Job, identity, run_job
from mapreplay.analysis.experiment.rows import Row, RowFile
from mapreplay.errors import MapreplayError

QUEUED_PER_PROCESS: Final = 8
"""Jobs that wait in each process's queue: enough to keep it busy, few enough to stop soon."""


def jobs_left(jobs: Sequence[Job], file: RowFile) -> list[Job]:
    """Those of `jobs` whose rows are not all in `file`.

    Raises:
        MapreplayError: the file is damaged, or holds rows that are of none of `jobs`, such as
            those of other weights: nothing is mixed.
    """
    there = {identity(row): row for row in file.read()}
    identities = [(job, job.identities()) for job in jobs]
    known = {each for _, of_job in identities for each in of_job}
    datasets = {job.dataset for job in jobs}
    for each, row in there.items():
        if row.dataset in datasets and each not in known:
            raise MapreplayError(
                f"{file.path}: holds {row.planner} on {row.floor_plan} with predictor "
                f"{row.predictor} {row.sha256[:12]}, which is not of this experiment; choose "
                "another --out"
            )
    return [job for job, of_job in identities if not all(each in there for each in of_job)]


def run_jobs(
    jobs: Sequence[Job], file: RowFile, processes: int
) -> Generator[list[Row], None, None]:
    """Run all `jobs`; yields the rows of each when they are on disk.

    Raises:
        MapreplayError: an episode failed, a process died, or another run adds to the file.
    """
    with file.locked():
        file.repair()
        there = {identity(row) for row in file.read()}
        for rows in map(_work, jobs) if processes == 1 else _in_parallel(jobs, processes):
            for row in rows:
                if identity(row) not in there:  # a kill may have come between two rows of a job
                    file.append(row)
            yield rows


def _in_parallel(jobs: Sequence[Job], processes: int) -> Generator[list[Row], None, None]:
    waiting = list(jobs)[::-1]
    running: set[Future[list[Row]]] = set()
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(processes, mp_context=context, initializer=_begin_worker)
    try:
        while waiting or running:
            while waiting and len(running) < processes * QUEUED_PER_PROCESS:
                running.add(pool.submit(_work, waiting.pop()))
            done, running = wait(running, return_when=FIRST_COMPLETED)
            for future in done:
                yield future.result()
    except BrokenProcessPool:
        raise MapreplayError(
            "a worker process died; what it finished is kept, repeat the command to go on"
        ) from None
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _begin_worker() -> None:
    """Ctrl-C is the parent's business alone; and a worker ends when its parent does, however."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_after, args=(parent.sentinel,), daemon=True).start()


def _end_after(sentinel: int) -> None:
    connection.wait([sentinel])
    os._exit(1)


def _work(job: Job) -> list[Row]:
    return run_job(job, job.predictor())
