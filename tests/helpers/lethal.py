"""Work that a process dies of; a module of its own, so that the process starts quickly."""

import os
import signal


def lethal(number: int) -> str:
    """The number as a text; 3 aborts, as a library in C does."""
    if number == 3:
        os.kill(os.getpid(), signal.SIGABRT)
    return str(number)
