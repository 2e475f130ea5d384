"""A short tour of a planner that knows the floor plan *and* what the predictor would predict.

It ends as soon as the fused map knows enough. There is no formula for what a network will say of
what it has not seen, so the predictor is asked at every tour that is tried, and the tour that is
returned was proved by it: at its last place the fused map has the target coverage.

The search begins with an agent that plans to observe what is not predicted surely, goes a part of
that way, and looks again. That tour is improved as in `tour`: some stops are taken out, the
predictor is asked, and others are put in until it says enough.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final, TypeAlias

import numpy as np
import numpy.typing as npt

from mapreplay.analysis.limits import kernels
from mapreplay.analysis.limits.task import CoverageTask, Ints
from mapreplay.analysis.limits.tour import Tour, search

Known: TypeAlias = npt.NDArray[np.bool_]
"""bool[N]: cells that a map knows."""
Ask: TypeAlias = Callable[[Ints], Known]
"""Places (int32[n]) that were looked from -> what the fused map knows then."""

CALLS: Final = 400
"""Of the predictor, for one floor plan, at most."""
TRIALS: Final = 100
"""Times that stops are removed."""
REPAIRS: Final = 4
"""Attempts to insert others, before the search gives up."""
PLANNED: Final = 30
"""Rounds of the search of an agent that plans ahead."""
MENDED: Final = 2
"""Rounds of the search that inserts stops."""


class _OutOfCallsError(Exception):
    """The predictor was asked as often as is allowed."""


@dataclass(eq=False)
class _Asked:
    """The predictor, asked at most a given number of times, and the best tour so far."""

    task: CoverageTask
    ask: Ask
    calls: int
    best: Tour
    answers: dict[bytes, Known] = field(default_factory=dict)

    def after(self, path: Ints) -> Known:
        places = np.unique(path)
        key = places.tobytes()
        if key not in self.answers:
            if self.calls == 0:
                raise _OutOfCallsError
            self.calls -= 1
            self.answers[key] = self.ask(places)
        return self.answers[key]

    def enough(self, path: Ints) -> bool:
        return bool(self.after(path).sum() >= self.task.needed)

    def sure(self, path: Ints) -> Known:
        """Cells that are known after `path` and were not seen."""
        return self.after(path) & ~self.task.seen_along(path)

    def take(self, path: Ints, stops: Ints) -> Tour:
        """`path`, after which enough is known, as far as it is needed.

        Known cells can become unknown again, so that the end that is found by halving need not be
        the first; but it is one.
        """
        low, high = 0, len(path)
        while low < high - 1:
            middle = (low + high) // 2
            if self.enough(path[:middle]):
                high = middle
            else:
                low = middle
        path = path[:high]
        if high < len(self.best.path):
            last = int(np.isin(stops, path).nonzero()[0].max()) + 1
            self.best = Tour(path, np.append(stops[:last], path[-1]).astype(np.int32))
            return self.best
        return Tour(path, stops)


def predicted_tour(
    task: CoverageTask, ask: Ask, observing: Tour, calls: int = CALLS, seed: int = 0
) -> Tour:
    """A short tour at whose end the fused map knows enough.

    Args:
        task: what has to be known; its views are what the sensor sees (``within`` = 0).
        ask: what the fused map knows after looking from some places.
        observing: a tour that observes enough, which is the first to be tried.
        calls: times that the predictor is asked at most.
        seed: of the search.
    """
    start = np.array([task.start], np.int32)
    asked = _Asked(task, ask, calls, observing)
    random = np.random.default_rng(seed)
    try:
        if asked.enough(start):
            return Tour(start, start)
        now = asked.take(observing.path, observing.stops)
        _drive(asked)
        now = asked.best
        for _ in range(TRIALS):
            found = _try(asked, now, random)
            if found and found.moves <= asked.best.moves + random.integers(2):
                now = found
    except _OutOfCallsError:
        pass
    return asked.best


def _drive(asked: _Asked) -> None:
    """Plan to observe what is not known, go a part of that way, look again."""
    task = asked.task
    path = stops = np.array([task.start], np.int32)
    while len(path) < len(asked.best.path):
        known = asked.after(path)
        missing = task.needed - int(known.sum())
        if missing <= 0:
            asked.take(path, stops)
            return
        tour = search(task, path[-1:], known, missing, PLANNED, seed=0)
        part = tour.path[1 : 2 + tour.moves // 6]
        path = np.append(path, part)
        stops = np.append(stops, part[-1])


def _try(asked: _Asked, now: Tour, random: np.random.Generator) -> Tour | None:
    """Remove some stops of a tour and insert others; None if it would become too long."""
    task = asked.task
    keep = np.ones(len(now.stops), np.bool_)
    if len(keep) > 1:
        first = int(random.integers(1, len(keep)))
        if random.integers(2):
            keep[first : first + int(random.integers(1, 6))] = False
        else:
            keep[random.integers(1, len(keep), int(random.integers(1, 4)))] = False
    stops = now.stops[keep]
    nothing = np.zeros(len(task.cells), np.bool_)
    path = kernels.trace(
        stops, len(stops), nothing, len(nothing) + 1, task.moves, task.view_start, task.view
    )
    for _ in range(REPAIRS):
        if asked.enough(path):
            return asked.take(path, stops)
        sure = asked.sure(path)
        seed = int(random.integers(1 << 30))
        tour = search(task, stops, sure, task.needed - int(sure.sum()), MENDED, seed)
        path, stops = tour.path, tour.stops
        if tour.moves > asked.best.moves + 1:
            return None
    return asked.take(path, stops) if asked.enough(path) else None
