"""Progress on stderr: bars on a terminal; elsewhere nothing, or one line per minute."""

from __future__ import annotations

import sys
import time
from typing import Final

from rich.console import Console
from rich.progress import BarColumn, Progress, Task, TextColumn, TimeRemainingColumn
from rich.text import Text

from mapreplay.text import printable


class _PlainColumn(TextColumn):
    """Names and errors without interpretation as markup."""

    def render(self, task: Task) -> Text:
        return Text(printable(self.text_format.format(task=task)), style="none")


def progress_bar(*columns: str) -> Progress:
    """A bar whose tasks have a description and the named text fields."""
    return Progress(
        _PlainColumn("{task.description}"),
        BarColumn(bar_width=24),
        _PlainColumn("{task.percentage:>3.0f}%"),
        *(_PlainColumn("{task.fields[" + name + "]}") for name in columns),
        TimeRemainingColumn(),
        console=(console := Console(stderr=True)),
        transient=True,
        disable=not console.is_terminal,
    )


SECONDS_PER_LINE: Final = 60.0


class TimeLeft:
    """Progress of hours of work if stderr is a file: one line per minute; silent on a terminal."""

    def __init__(self, what: str, done: int, total: int) -> None:
        self._what, self._done, self._total = what, done, total
        self._began_with = done
        self._began = self._said = time.monotonic()

    def advance(self) -> None:
        """Count one more as done."""
        self._done += 1
        now = time.monotonic()
        if sys.stderr.isatty() or now - self._said < SECONDS_PER_LINE:
            return
        self._said = now
        pace = (now - self._began) / (self._done - self._began_with)
        minutes = pace * (self._total - self._done) / 60
        line = f"{self._done} of {self._total} {self._what}, about {minutes:.0f} min left"
        print(line, file=sys.stderr, flush=True)
