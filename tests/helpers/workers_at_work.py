"""Work for worker processes, and a parent whose children never end by themselves.

    python workers_at_work.py spawned|forked|program

It prints the ids of its children, and then waits for them.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator
from itertools import count
from pathlib import Path

from mapreplay.errors import LogError
from mapreplay.processes.workers import Program, Yielded, in_order, run_each


def square(number: int) -> int:
    """Its square, with the id of the process."""
    return number * number


def die_at_three(number: int) -> Iterator[str]:
    """Says two things of every number but three."""
    yield f"begins {number}"
    if number == 3:
        os.abort()
    yield f"ends {number}"


def fail_at_three(number: int) -> Iterator[int]:
    """Raises an error of ours at three."""
    if number == 3:
        raise LogError("three is bad")
    yield number


def large(number: int) -> Iterator[bytes]:
    """More than fits into a pipe."""
    yield bytes([number]) * (1 << 20)


def tell_and_sleep(number: int) -> Iterator[int]:
    """The id of the process; and then nothing more for an hour."""
    yield os.getpid()
    time.sleep(3600)


def sleep_after_telling(number: int) -> int:
    """The id of the process, and from the fourth call on nothing."""
    if number > 3:
        time.sleep(3600)
    return os.getpid()


def wait_for_children(kind: str) -> None:
    """See the module."""
    if kind == "spawned":
        for event in run_each(tell_and_sleep, range(2), 2):
            if isinstance(event, Yielded):
                print(event.what, flush=True)
    elif kind == "forked":
        for pid in in_order(sleep_after_telling, count(), 2, 2):
            print(pid, flush=True)
    else:
        with Program([sys.executable, "-c", "import time; time.sleep(3600)"]) as program:
            children = Path(f"/proc/{program.pid}/task/{program.pid}/children")
            while not (found := children.read_text().split()):
                time.sleep(0.05)
            print(program.pid, *found, sep="\n", flush=True)
            program.wait()


if __name__ == "__main__":
    wait_for_children(sys.argv[1])
