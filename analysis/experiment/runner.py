"""Running an experiment: every core, every finished log on disk, resumed where it was stopped."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from functools import partial

from mapreplay.analysis.experiment.jobs import Job, Shelf, run_job
from mapreplay.analysis.pool import WorkerError, map_unordered
from mapreplay.errors import MapreplayError


def run_jobs(jobs: Sequence[Job], shelf: Shelf, processes: int) -> Generator[str, None, None]:
    """Run all `jobs`; yields the name of each when its logs are on disk.

    Raises:
        MapreplayError: an episode failed, a process died, or another run writes the same log.
    """
    try:
        work = partial(run_job, shelf=shelf)
        yield from map_unordered(work, jobs, processes, name=lambda job: job.name)
    except WorkerError as error:
        raise MapreplayError(
            f"{error}; all other episodes are kept, repeat the command to go on"
        ) from None
