"""Runs a program until standard input ends; see `mapreplay.processes.workers.Program`.

    python -I -S keeper.py PROGRAM [ARGUMENT ...]

A process of its own, which imports nothing of this package: it has one thread when it starts the
program, so that Linux can be told to end the program with it, even if it is killed.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import threading
from collections.abc import Callable

SECONDS_TO_END = 5.0


def end_with_keeper() -> Callable[[], None] | None:
    """What the program's process calls before it becomes the program; nothing but on Linux."""
    if sys.platform != "linux":
        return None
    import ctypes
    import signal

    library = ctypes.CDLL(None)

    def bind() -> None:
        library.prctl(1, int(signal.SIGKILL))  # PR_SET_PDEATHSIG

    return bind


def end_with_input(process: subprocess.Popen[bytes]) -> None:
    """End the program when our parent has closed the pipe, or has ended."""
    with contextlib.suppress(OSError):
        while os.read(0, 1024):  # not sys.stdin, whose lock would be held when Python ends
            pass
    process.terminate()
    try:
        process.wait(SECONDS_TO_END)
    except subprocess.TimeoutExpired:
        process.kill()


def main() -> int:
    """Run the program; returns its exit code."""
    process = subprocess.Popen(  # noqa: S603
        sys.argv[1:],
        stdin=subprocess.DEVNULL,
        preexec_fn=end_with_keeper(),  # noqa: PLW1509 (there is one thread)
    )
    threading.Thread(target=end_with_input, args=(process,), daemon=True).start()
    code = process.wait()
    return code if code >= 0 else 128 - code


if __name__ == "__main__":
    sys.exit(main())
