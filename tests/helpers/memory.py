"""How much memory something takes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

MEMORY = 200 << 20
"""What reading a hostile file of a few MB may take; the bombs ask for gigabytes."""

STATUS, RESET = Path("/proc/self/status"), Path("/proc/self/clear_refs")


def status(key: str) -> int:
    (line,) = [line for line in STATUS.read_text().splitlines() if line.startswith(key)]
    return int(line.split()[1]) * 1024


@contextmanager
def bounded() -> Iterator[None]:
    """What is done in it takes at most `MEMORY`, where the peak is known."""
    if not RESET.exists():  # not Linux
        yield
        return
    RESET.write_text("5")
    before = status("VmRSS")
    yield
    assert status("VmHWM") - before < MEMORY
