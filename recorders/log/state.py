"""What a log is: finished, recovered, cut off, ...: decided here, and nowhere else.

Every verb takes its words and its exit code from the `LogState` of a log.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from mapreplay.recorders.log.mcap.index import Tail


class Condition(StrEnum):
    """How far a log goes. One that is damaged cannot be opened; see `recover`."""

    FINISHED = "finished"
    """Its last step is there, and says how the episode ended."""
    SCALARS_ONLY = "scalars only"
    """It is finished, and was recorded without its steps; see `scalars`."""
    RECOVERED = "recovered"
    """Made by `mapreplay recover` of a log whose end is lost, or steps in its middle."""
    UNFINISHED = "unfinished"
    """Whoever wrote it stopped before the end."""
    BEING_WRITTEN = "being written"
    """Another process writes it now."""
    CUT_OFF = "cut off"
    """It is called like a finished one, but its end is not there."""


_FINISHED: Final = (Condition.FINISHED, Condition.SCALARS_ONLY)


@dataclass(frozen=True)
class LogState:
    """The state of a log that can be opened."""

    condition: Condition
    steps: int
    """That can be read."""
    missing: tuple[range, ...] = ()
    """Steps that are not there although later ones are."""
    tail: Tail | None = None
    """What follows its end in the file."""

    @property
    def finished(self) -> bool:
        """Whether the whole episode is there, each step of it, or the scalars of each."""
        return self.condition in _FINISHED and not self.missing

    @property
    def whole(self) -> bool:
        """Whether the whole episode is there, and nothing else is in the file.

        Where it is not, verbs say why (`str` of this), and exit with code 3.
        """
        return self.finished and self.tail is None

    def __str__(self) -> str:
        said = []
        if not self.finished:
            if self.condition not in _FINISHED:
                said.append(str(self.condition))
            if self.missing:
                said.append(f"{span_words(self.missing)} missing")
            said.append(
                "1 step can be read" if self.steps == 1 else f"{self.steps} steps can be read"
            )
        if self.tail is not None:
            said.append(str(self.tail))
        return "; ".join(said) or str(self.condition)


def gaps_in(numbers: Sequence[int], last: int) -> tuple[range, ...]:
    """The runs of integers from 0 to `last` that are not among the sorted `numbers`."""
    if len(numbers) == last + 1:
        return ()
    gaps, expected = [], 0
    for number in [*numbers, last + 1]:
        if number > expected:
            gaps.append(range(expected, number))
        expected = number + 1
    return tuple(gaps)


def by_step(steps: npt.NDArray[np.integer], values: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
    """The values of some steps as float64[last + 1]; NaN at those that a log misses.

    Args:
        steps: int[n], rising.
        values: [n], of each of them.
    """
    count = int(steps[-1]) + 1 if steps.size else 0
    if count == steps.size:
        return np.asarray(values, np.float64)
    curve = np.full(count, np.nan)
    curve[steps] = values
    return curve


def span_words(spans: Sequence[range]) -> str:
    """``step 7 is``, ``steps 20 to 39 are``, ``steps 7, 20 to 39 are``."""
    words = [str(s.start) if len(s) == 1 else f"{s.start} to {s.stop - 1}" for s in spans]
    one = len(spans) == 1 and len(spans[0]) == 1
    shown = ", ".join(words[:_SHOWN]) + (
        f" and {len(words) - _SHOWN} more" if len(words) > _SHOWN else ""
    )
    return f"step {shown} is" if one else f"steps {shown} are"


_SHOWN: Final = 6
