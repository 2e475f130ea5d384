"""Running an experiment: every core, every finished row on disk, resumed where it was stopped."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Sequence

from mapreplay.analysis.experiment.jobs import Job, identity, run_job
from mapreplay.analysis.experiment.rows import Row, RowFile
from mapreplay.analysis.pool import WorkerError, map_unordered
from mapreplay.errors import MapreplayError


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
    for job, of_job in identities:
        rows = [there[each] for each in of_job if each in there]
        others = [row.digest for row in rows if row.digest != job.digest(row.sha256)]
        if others:
            raise MapreplayError(
                f"{file.path}: {_name(job)} was run with another configuration, floor plan or code "
                f"(digest {others[0] or 'none'}, now {job.digest(rows[0].sha256)}); choose "
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
        for rows in _in_processes(jobs, processes):
            for row in rows:
                if identity(row) not in there:  # a kill may have come between two rows of a job
                    file.append(row)
            yield rows


def _in_processes(jobs: Sequence[Job], processes: int) -> Iterator[list[Row]]:
    try:
        yield from map_unordered(_work, jobs, processes, name=_name)
    except WorkerError as error:
        raise MapreplayError(
            f"{error}; all other episodes are kept, repeat the command to go on"
        ) from None


def _name(job: Job) -> str:
    return f"{job.config.planner} on {job.floor_plan.id}, seed {job.config.seed}"


def _work(job: Job) -> list[Row]:
    return run_job(job, job.predictor())
