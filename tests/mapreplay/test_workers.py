"""Child processes: they end with their parent, and their death costs what they were doing."""

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from itertools import count, islice
from pathlib import Path

import psutil
import pytest

import workers_at_work as at_work
from mapreplay.analysis.pool import WorkerError, map_unordered
from mapreplay.errors import LogError
from mapreplay.processes.workers import Died, DiedError, Ended, Program, Yielded, in_order, run_each

SECONDS = 60
linux = pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")


def no_workers_are_left() -> None:
    deadline = time.monotonic() + SECONDS
    while multiprocessing.active_children() and time.monotonic() < deadline:
        time.sleep(0.02)
    assert multiprocessing.active_children() == []


@linux
@pytest.mark.parametrize("how", ["SIGTERM", "SIGKILL", "SIGHUP", "SIGINT"])
@pytest.mark.parametrize("kind", ["spawned", "forked", "program"])
def test_they_end_with_their_parent_however_it_ends(kind: str, how: str) -> None:
    parent = subprocess.Popen(
        [sys.executable, at_work.__file__, kind],
        stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, start_new_session=True,
    )  # fmt: skip
    assert parent.stdout is not None
    children: set[psutil.Process] = set()
    with parent.stdout:
        while len(children) < 2:
            children.add(psutil.Process(int(parent.stdout.readline())))
        parent.send_signal(signal.Signals[how])  # to it alone, not to its group
        _, alive = psutil.wait_procs(list(children), timeout=SECONDS)
    if alive:
        parent.kill()
    assert not alive
    parent.wait(SECONDS)


def test_a_death_costs_one_item_and_is_told_with_it() -> None:
    said: dict[int, list[str]] = {n: [] for n in range(6)}
    ended, died = set(), []
    for event in run_each(at_work.die_at_three, range(6), 2):
        if isinstance(event, Yielded):
            said[event.item].append(event.what)
        elif isinstance(event, Ended):
            ended.add(event.item)
        else:
            died.append(event)
    assert died == [Died(3, "killed by SIGABRT")]
    assert said == {n: [f"begins {n}", *([f"ends {n}"] if n != 3 else [])] for n in range(6)}
    assert ended == {0, 1, 2, 4, 5}
    no_workers_are_left()


def test_what_the_work_raises_is_raised_with_where_it_was() -> None:
    with pytest.raises(LogError, match="three is bad") as raised:
        list(run_each(at_work.fail_at_three, range(6), 2))
    assert "fail_at_three" in raised.value.__notes__[0]
    no_workers_are_left()


def test_results_larger_than_a_pipe_come_whole_and_closing_ends_the_workers() -> None:
    events = run_each(at_work.large, [1, 2, 3, 4, 5], 2)
    first = next(e for e in events if isinstance(e, Yielded))
    assert first.what == bytes([first.item + 1]) * (1 << 20)
    events.close()
    no_workers_are_left()


@pytest.mark.skipif(sys.platform == "win32", reason="there is no fork")
def test_copies_of_this_process_work_in_order_without_end() -> None:
    large = bytes(1 << 20)  # more than fits into a pipe, and never pickled

    def work(number: int) -> tuple[int, bytes]:
        return number, large

    made = in_order(work, count(), jobs=3, ahead=2)
    assert [number for number, _ in islice(made, 20)] == list(range(20))
    made.close()
    no_workers_are_left()
    with pytest.raises(DiedError, match=r"a worker process died \(exit code 7\)"):
        list(in_order(os._exit, [7], jobs=2, ahead=1))
    with pytest.raises(ZeroDivisionError):
        list(in_order(lambda n: 1 // n, [2, 1, 0], jobs=2, ahead=1))


def test_a_pool_goes_on_after_a_death(tmp_path: Path) -> None:
    def name(code: int) -> str:
        return f"the one of {code}"

    found = map_unordered(os._exit, [9, 7], 2, lost=lambda code, error: str(error), name=name)
    assert sorted(found) == [
        f"the one of {code}: a worker process died at it (exit code {code}), perhaps for want of "
        "memory; try again with --jobs 1"
        for code in (7, 9)
    ]
    with pytest.raises(WorkerError, match=r"item . of 2: .*\(and 1 more\)"):
        list(map_unordered(os._exit, [9, 7], 2))
    assert sorted(map_unordered(at_work.square, range(5), 2)) == [0, 1, 4, 9, 16]


@linux
def test_a_program_ends_when_it_is_closed_and_its_exit_code_is_known() -> None:
    with Program([sys.executable, "-c", "raise SystemExit(5)"]) as program:
        assert program.wait() == 5
    stubborn = "import signal, time; signal.signal(signal.SIGINT, signal.SIG_IGN); time.sleep(3600)"
    with Program([sys.executable, "-c", stubborn]) as program:
        keeper = psutil.Process(program.pid)
        deadline = time.monotonic() + SECONDS
        while not (children := keeper.children()) and time.monotonic() < deadline:
            time.sleep(0.02)
        assert not program.ended
    _, alive = psutil.wait_procs(children, timeout=SECONDS)
    assert not alive


@linux
def test_a_program_ends_with_its_keeper() -> None:
    with Program([sys.executable, "-c", "import time; time.sleep(3600)"]) as program:
        keeper = psutil.Process(program.pid)
        deadline = time.monotonic() + SECONDS
        while not (children := keeper.children()) and time.monotonic() < deadline:
            time.sleep(0.02)
        keeper.kill()
        _, alive = psutil.wait_procs(children, timeout=SECONDS)
        assert not alive
