"""Recording many episodes, one after the other or in several processes."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Final, TypeAlias, cast

from mapreplay.config import EpisodeConfig
from mapreplay.episode import prepare_episode, run_episode
from mapreplay.errors import MapreplayError
from mapreplay.floorplan import FloorPlan
from mapreplay.predictors import kept_predictor
from mapreplay.recorders.log.writer import EpisodeWriter
from mapreplay.step import log_name

REPORT_SECONDS: Final = 0.1


@dataclass(frozen=True, eq=False)
class Task:
    """One episode to record."""

    config: EpisodeConfig
    floor_plan: FloorPlan
    folder: Path
    device: str
    profile: bool
    force: bool

    @property
    def path(self) -> Path:
        """Where its log goes."""
        return self.folder / log_name(self.floor_plan.id, self.config)


@dataclass(frozen=True)
class Progress:
    """How far an episode is."""

    task: int
    step: int
    coverage: float
    """Of the map under construction, 0 to 1."""


@dataclass(frozen=True)
class Done:
    """An episode is finished, and its log is at `path`."""

    task: int
    path: Path


@dataclass(frozen=True)
class Failed:
    """An episode could not be recorded; `reason` is one line."""

    task: int
    reason: str


Report: TypeAlias = Progress | Done | Failed


def record(number: int, task: Task) -> Iterator[Report]:
    """Simulate and record one episode; closing the generator leaves a readable ``.part``."""
    try:
        predictor = kept_predictor(task.config.predictor, task.device)
        episode = prepare_episode(task.config, task.floor_plan, predictor=predictor)
        path = task.path
        with EpisodeWriter(path, episode.header, profile=task.profile, force=task.force) as writer:
            reported = 0.0
            for step in run_episode(episode):
                writer.write(step)
                if time.monotonic() - reported > REPORT_SECONDS:
                    reported = time.monotonic()
                    covered = step.metrics.coverage(task.config.build)
                    yield Progress(number, step.index, covered)
        yield Done(number, path)
    except MapreplayError as error:
        yield Failed(number, str(error))


def record_all(tasks: Sequence[Task], jobs: int) -> Generator[Report, None, None]:
    """Record all tasks with `jobs` processes; reports come as they happen.

    The death of a worker costs its episode only. Closing the generator stops the workers;
    what they were recording stays as readable ``.part`` files.
    """
    if jobs == 1 or len(tasks) == 1:
        for number, task in enumerate(tasks):
            yield from record(number, task)
        return
    context = multiprocessing.get_context("spawn")
    waiting = list(enumerate(tasks))[::-1]
    workers: dict[Connection, _Worker] = {}
    try:
        while waiting or workers:
            while waiting and len(workers) < jobs:
                worker = _Worker.start(context)
                workers[worker.connection] = worker
                worker.give(*waiting.pop())
            for ready in wait(list(workers)):
                connection = cast("Connection", ready)
                worker = workers[connection]
                report = worker.receive()
                if report is None:
                    del workers[connection]
                    yield Failed(worker.task, worker.death())
                    continue
                if not isinstance(report, Progress):
                    if waiting:
                        worker.give(*waiting.pop())
                    else:
                        del workers[connection]
                        worker.stop()
                yield report
    finally:
        for worker in workers.values():
            worker.stop()


@dataclass(eq=False)
class _Worker:
    process: BaseProcess
    connection: Connection
    task: int = -1

    @classmethod
    def start(cls, context: multiprocessing.context.SpawnContext) -> _Worker:
        ours, theirs = context.Pipe()
        process = context.Process(target=_work, args=(theirs,), daemon=True)
        with ignoring_interrupts():
            process.start()
        theirs.close()
        return cls(process, ours)

    def give(self, number: int, task: Task) -> None:
        self.task = number
        with suppress(OSError):  # it is dead, as the next `receive` will find
            self.connection.send((number, task))

    def receive(self) -> Report | None:
        """The next report, or None if the process is dead."""
        try:
            report: Report = self.connection.recv()
        except (EOFError, OSError):
            return None
        return report

    def death(self) -> str:
        self.process.join()
        return f"its worker process died (exit code {self.process.exitcode})"

    def stop(self) -> None:
        """Ask the process to end after the step that it is at, and wait for that."""
        with suppress(OSError):  # it may have ended already
            self.connection.send(None)
        self.connection.close()
        self.process.join()


@contextmanager
def ignoring_interrupts() -> Iterator[None]:
    """What is started in here ignores Ctrl-C, from its first instruction on.

    Ctrl-C reaches the whole process group; the parent alone decides what it means.
    """
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread may change how signals are handled
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _work(connection: Connection) -> None:
    """The loop of a worker process: take a task, report, until None comes."""
    if hasattr(os, "setpgid"):
        # Out of the group that Ctrl-C reaches: Polars heeds it even where Python ignores it.
        os.setpgid(0, 0)
    try:
        while (item := connection.recv()) is not None:
            for report in record(*item):
                connection.send(report)
                if isinstance(report, Progress) and connection.poll():
                    return  # only a request to stop comes before we are done
    except (EOFError, OSError):
        return  # the parent is gone
