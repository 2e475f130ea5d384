"""Child processes that end with their parent, however it ends.

Every process is started here. A child is in its own process group, so that Ctrl-C reaches only
the parent, which decides what to do; and it watches its parent, so that it ends when the parent is
killed, its terminal is closed, or it fails. When a child dies, only the item that it was working on
is lost, and is reported.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Collection, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from multiprocessing import connection
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from multiprocessing.reduction import ForkingPickler
from pathlib import Path
from typing import Final, Generic, Self, TypeAlias, TypeVar, cast

from mapreplay.errors import MapreplayError

T = TypeVar("T")
R = TypeVar("R")

_SMALL: Final = 1 << 15
"""Bytes that always fit into a pipe, so that the writer does not wait for a worker."""
_KEEPER: Final = Path(__file__).with_name("keeper.py")
_CLOSE_SECONDS: Final = 10.0
"""Seconds that a program has to end after it was asked to."""
_STOP_SECONDS: Final = 5.0
"""Seconds that a worker has to end after it was asked to."""


class DiedError(MapreplayError):
    """A child process died in the middle of its work."""


@dataclass(frozen=True)
class Yielded(Generic[R]):
    """A result of an item, possibly not the last one."""

    item: int
    """Number of the item."""
    what: R


@dataclass(frozen=True)
class Ended:
    """An item is done."""

    item: int


@dataclass(frozen=True)
class Died:
    """The process that worked on an item has died, and the rest of the item is lost."""

    item: int
    how: str
    """``killed by SIGKILL``, ``exit code 9``."""


Event: TypeAlias = Yielded[R] | Ended | Died


@dataclass(frozen=True)
class _Raised:
    error: BaseException


class Worker(Generic[T, R]):
    """A process that does one kind of work, one item after the other.

    Args:
        work: A function of a module, which yields the results of an item.
        shares_memory: Whether the process is a copy of this one, so that `work` may hold anything,
            which is not copied (POSIX only); otherwise `work` and items are pickled.
    """

    def __init__(self, work: Callable[[T], Iterable[R]], *, shares_memory: bool = False) -> None:
        self.connection, theirs = multiprocessing.Pipe()
        context = multiprocessing.get_context("fork" if shares_memory else "spawn")
        # Linux ends a child with the *thread* that started it: only the main thread is sure to
        # live as long as its process.
        bound = threading.current_thread() is threading.main_thread()
        given = work if shares_memory else None
        self._process: BaseProcess = context.Process(  # type: ignore[attr-defined]
            target=_serve,
            args=(theirs, given, os.getpid()),
            kwargs={"by_kernel": bound},
            daemon=True,
        )
        with _ignoring_interrupts():
            self._process.start()
        theirs.close()
        self._items: deque[int] = deque()
        if not shares_memory:
            # Not with the arguments: to import what it needs takes seconds, in which the process
            # should be bound to us already.
            self._send(work)

    @property
    def pid(self) -> int | None:
        """Of the process."""
        return self._process.pid

    @property
    def items(self) -> Sequence[int]:
        """Numbers of the items that it has, the one at hand first."""
        return self._items

    def give(self, number: int, item: T) -> None:
        """Hand over an item; `number` is its number in `Event`."""
        self._items.append(number)
        self._send((item,))

    def _send(self, what: object) -> None:
        with suppress(OSError):  # it is dead, as the next `receive` will find
            self.connection.send(what)

    def receive(self) -> Event[R]:
        """Wait for the next event of the process.

        Raises:
            BaseException: what the work raised.
        """
        try:
            said: Yielded[R] | Ended | _Raised = self.connection.recv()
        except (EOFError, OSError):
            return Died(self._items.popleft() if self._items else -1, self._death())
        if isinstance(said, _Raised):
            raise said.error
        number = self._items[0]
        if isinstance(said, Ended):
            self._items.popleft()
            return Ended(number)
        return Yielded(number, said.what)

    def _death(self) -> str:
        self._process.join()
        code = self._process.exitcode
        if code is not None and code < 0:
            with suppress(ValueError):
                return f"killed by {signal.Signals(-code).name}"
        return f"exit code {code}"

    def ask_to_end(self) -> None:
        """Ask the process to end after its next event."""
        self._send(None)
        self.connection.close()

    def end(self, seconds: float = 0.0) -> None:
        """End the process, at the latest after the given number of seconds.

        One that shares our memory may hold the connections of its siblings, too, and a sibling
        that is telling us something would not notice that we have closed ours.
        """
        self._process.join(seconds)
        self._process.terminate()
        self._process.join()
        self.connection.close()


def run_each(
    work: Callable[[T], Iterable[R]], items: Sequence[T], jobs: int
) -> Generator[Event[R], None, None]:
    """Work on all items with `jobs` processes; events come as they happen.

    Closing the generator stops the processes, each after its next event, or after five seconds.

    Raises:
        BaseException: what `work` raised; it ends the rest.
    """
    waiting = deque(range(len(items)))
    workers: dict[Connection, Worker[T, R]] = {}

    def give(worker: Worker[T, R]) -> None:
        number = waiting.popleft()
        worker.give(number, items[number])

    def give_ahead(worker: Worker[T, R]) -> None:
        """The next item, so that the process does not wait for us when it is done with this; but
        not of the last ones, for which another process may be free sooner.
        """
        if len(waiting) >= jobs and len(ForkingPickler.dumps(items[waiting[0]])) < _SMALL:
            give(worker)

    try:
        while True:
            while len(workers) < jobs and waiting:
                worker = Worker[T, R](work)
                workers[worker.connection] = worker
                give(worker)
            if not workers:
                return
            for ready in connection.wait(list(workers)):
                worker = workers[cast("Connection", ready)]
                event = worker.receive()
                if isinstance(event, Yielded):
                    yield event
                    continue
                if isinstance(event, Died):
                    del workers[worker.connection]
                    waiting.extendleft(worker.items)  # what it had not begun
                    worker.connection.close()
                elif not worker.items and not waiting:
                    del workers[worker.connection]
                    _stop([worker])
                else:
                    if not worker.items:
                        give(worker)
                    give_ahead(worker)
                yield event
    finally:
        _stop(workers.values())


def _stop(workers: Collection[Worker[T, R]]) -> None:
    """What they are at may be a file, which they close."""
    for worker in workers:
        worker.ask_to_end()
    deadline = time.monotonic() + _STOP_SECONDS
    for worker in workers:
        worker.end(max(0.0, deadline - time.monotonic()))


def in_order(
    work: Callable[[T], R], items: Iterable[T], jobs: int, ahead: int
) -> Generator[R, None, None]:
    """work(item) of every item in the order of the items, by processes that share our memory.

    Args:
        work: May hold anything: it is not copied.
        items: Small ones; without end if need be.
        jobs: How many processes.
        ahead: Items that each process is given in advance.

    Raises:
        DiedError: a process died.
        BaseException: what `work` raised.
    """
    workers = [Worker[T, R](partial(once, work), shares_memory=True) for _ in range(jobs)]
    try:
        numbered = enumerate(items)
        under_way: deque[Worker[T, R]] = deque()
        while True:
            while len(under_way) < jobs * ahead and (following := next(numbered, None)):
                worker = workers[following[0] % jobs]
                worker.give(*following)
                under_way.append(worker)
            if not under_way:
                return
            worker = under_way.popleft()
            said, ended = worker.receive(), None
            if isinstance(said, Yielded):
                ended = worker.receive()
                if isinstance(ended, Ended):
                    yield said.what
                    continue
            died = ended if isinstance(ended, Died) else said
            how = died.how if isinstance(died, Died) else "it reported nothing"
            raise DiedError(f"a worker process died ({how}), perhaps out of memory")
    finally:
        for worker in workers:
            worker.end()


def once(work: Callable[[T], R], item: T) -> Iterator[R]:
    """What `Worker` takes, of a function that returns one thing."""
    yield work(item)


def _serve(
    link: Connection,
    work: Callable[[T], Iterable[R]] | None,
    parent: int,
    *,
    by_kernel: bool,
) -> None:
    """The loop of a worker process: take an item, tell what comes of it, until None comes."""
    _bind_to_parent(parent, by_kernel=by_kernel)
    waiting: deque[tuple[T]] = deque()
    try:
        work = link.recv() if work is None else work
        while True:
            taken = waiting.popleft() if waiting else link.recv()
            if taken is None:
                return
            with closing(_messages(work, taken[0])) as messages:
                for message in messages:
                    link.send(message)
                    while link.poll():
                        following = link.recv()
                        if following is None:
                            return
                        waiting.append(following)
    except (EOFError, OSError):
        return  # the parent is gone


def _messages(
    work: Callable[[T], Iterable[R]], item: T
) -> Generator[Yielded[R] | Ended | _Raised, None, None]:
    try:
        for what in work(item):
            message = Yielded(-1, what)
            ForkingPickler.dumps(message)  # here, where it is an error of the work if it cannot be
            yield message
    except GeneratorExit:
        raise
    except BaseException as error:  # noqa: BLE001 (it is raised in the parent)
        yield _Raised(_portable(error))
    else:
        yield Ended(-1)


def _portable(error: BaseException) -> BaseException:
    """The error as it can be sent, with what led to it in this process."""
    error.__notes__ = [*getattr(error, "__notes__", ()), traceback.format_exc()]
    try:
        pickle.loads(pickle.dumps(error))  # noqa: S301 (our own)
    except Exception:  # noqa: BLE001 (an error of any library may refuse in any way)
        return RuntimeError(traceback.format_exc())
    return error


def _bind_to_parent(parent: int, *, by_kernel: bool) -> None:
    """Only the parent decides what Ctrl-C means, and its end is ours."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    if hasattr(os, "setpgid"):
        # Out of the group that Ctrl-C reaches: Polars heeds it even where Python ignores it.
        os.setpgid(0, 0)
    if by_kernel:
        end_with_parent()
    if hasattr(os, "getppid") and os.getppid() != parent:  # it ended before we could watch it
        os._exit(1)
    process = multiprocessing.parent_process()
    if process is not None:
        threading.Thread(target=_end_after, args=(process.sentinel,), daemon=True).start()


def end_with_parent() -> None:
    """Have Linux kill this process when the thread that started it ends; elsewhere nothing."""
    if sys.platform == "linux":
        import ctypes

        pr_set_pdeathsig = 1
        with suppress(OSError, AttributeError):
            ctypes.CDLL(None).prctl(pr_set_pdeathsig, int(signal.SIGKILL))


def _end_after(sentinel: int) -> None:
    connection.wait([sentinel])
    os._exit(1)


@contextmanager
def _ignoring_interrupts() -> Iterator[None]:
    """Processes that are started within the block ignore Ctrl-C from the beginning."""
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread may change how signals are handled
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


class Program:
    """Another program that ends with this process, or when it is closed.

    It is started by a small keeper process (`keeper`), which holds the other end of a
    pipe of ours: the end of that pipe is the end of the program.
    """

    def __init__(
        self, arguments: Sequence[str | Path], environment: Mapping[str, str] | None = None
    ) -> None:
        """Start it without input; its output is discarded."""
        self._process = subprocess.Popen(  # noqa: S603
            [sys.executable, "-I", "-S", _KEEPER, *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env=environment,
            start_new_session=True,  # Ctrl-C is for us
        )

    @property
    def pid(self) -> int:
        """Of the keeper, whose child the program is."""
        return self._process.pid

    @property
    def ended(self) -> bool:
        """Whether the program has ended."""
        return self._process.poll() is not None

    def wait(self) -> int:
        """Its exit code, when it has ended."""
        return self._process.wait()

    def close(self) -> None:
        """End it, and wait for that."""
        if self._process.stdin is not None:
            with suppress(OSError):
                self._process.stdin.close()
        try:
            self._process.wait(_CLOSE_SECONDS)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
