"""Where two steps differ: topic, cell, and both values."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from itertools import zip_longest
from typing import Any, Final, TypeAlias

import numpy as np
import numpy.typing as npt

from mapreplay.grid import Cell
from mapreplay.recorders.log.topics import Topic
from mapreplay.step import Candidate, Cells, Step, differences, in_short

Value: TypeAlias = Cell | float | int | str | None


@dataclass(frozen=True)
class Difference:
    """A value in a log that is not the one it should be."""

    step: int | None
    """None if it is in what a log says once."""
    topic: str
    """Or the name of the metadata record or of the attachment."""
    what: str
    """The field, or "cell" in a map."""
    cell: Cell | None
    """Where, in a map or a frontier."""
    logged: Value
    expected: Value
    more: int = 0
    """How many further elements of the same array differ."""

    def __str__(self) -> str:
        when = "" if self.step is None else f"step {self.step}: "
        where = "" if self.cell is None else f" {as_text(self.cell)}"
        more = f" (and {self.more} more)" if self.more else ""
        return (
            f"{when}{self.topic} {self.what}{where}: logged {as_text(self.logged)}, "
            f"expected {as_text(self.expected)}{more}"
        )


def as_text(value: Value) -> str:
    """A value with all its digits; a cell as ``(row, col)``."""
    if isinstance(value, Cell):
        return f"({value.row}, {value.col})"
    if value is None:
        return "nothing"
    return repr(value) if isinstance(value, float) else str(value)


def step_differences(logged: Step, expected: Step) -> Iterator[Difference]:
    """All differences of two steps of one index but for the profile, causes first.

    Of an array the first element that differs is named, and how many more do.
    """
    for name in differences(logged, expected):
        if name in _COMPARISONS:
            yield from _COMPARISONS[name](logged, expected)


def _agent(logged: Step, expected: Step) -> Iterator[Difference]:
    yield Difference(logged.index, Topic.POSE, "agent", None, logged.agent, expected.agent)


def _hits(logged: Step, expected: Step) -> Iterator[Difference]:
    if logged.hits.shape != expected.hits.shape:
        yield _other_array(logged, Topic.SCAN, logged.hits, expected.hits)
        return
    rays = np.flatnonzero(logged.hits != expected.hits)
    ray, more = rays[0], len(rays) - 1
    ours, theirs = int(logged.hits[ray]), int(expected.hits[ray])
    yield Difference(logged.index, Topic.SCAN, f"ray {ray}", None, ours, theirs, more)


def _map(topic: Topic, field: str) -> _Comparison:
    def compare_maps(logged: Step, expected: Step) -> Iterator[Difference]:
        a, b = getattr(logged, field), getattr(expected, field)
        if a is None or b is None or (a.dtype, a.shape) != (b.dtype, b.shape):
            yield _other_array(logged, topic, a, b)
            return
        bits = f"u{a.dtype.itemsize}"  # so that NaN equals itself
        cells = np.argwhere(a.view(bits) != b.view(bits))
        first = Cell(*cells[0].tolist())
        ours, theirs, more = a[first].item(), b[first].item(), len(cells) - 1
        yield Difference(logged.index, topic, "cell", first, ours, theirs, more)

    return compare_maps


def _other_array(
    logged: Step, topic: Topic, a: npt.NDArray[Any] | None, b: npt.NDArray[Any] | None
) -> Difference:
    ours, theirs = (None if array is None else in_short(array) for array in (a, b))
    return Difference(logged.index, topic, "array", None, ours, theirs)


def _frontier(logged: Step, expected: Step) -> Iterator[Difference]:
    there, wanted = _set_of(logged.frontier), _set_of(expected.frontier)
    wrong = sorted(there ^ wanted)
    if not wrong:
        yield Difference(logged.index, Topic.FRONTIER, "order", None, "another", "row-major")
        return
    cell, more = wrong[0], len(wrong) - 1
    ours, theirs = ("frontier" if cell in cells else None for cells in (there, wanted))
    yield Difference(logged.index, Topic.FRONTIER, "cell", cell, ours, theirs, more)


def _set_of(cells: Cells) -> set[Cell]:
    return {Cell(row, col) for row, col in cells.tolist()}


def _decision(logged: Step, expected: Step) -> Iterator[Difference]:
    index, a, b = logged.index, logged.decision, expected.decision
    if a is None or b is None:
        ours, theirs = (x.target if x else None for x in (a, b))
        yield Difference(index, Topic.DECISION, "target", None, ours, theirs)
        return
    if a.mode is not b.mode:
        yield Difference(index, Topic.DECISION, "mode", None, a.mode, b.mode)
    yield from _candidates(index, "target", a.chosen, b.chosen)
    for k, (rival, wanted) in enumerate(zip_longest(a.rivals, b.rivals)):
        yield from _candidates(index, f"rival {k}", rival, wanted)
    if a.random_draw != b.random_draw:
        yield Difference(index, Topic.DECISION, "random_draw", None, a.random_draw, b.random_draw)
    for k, poses in enumerate(zip_longest(a.path.tolist(), b.path.tolist())):
        if poses[0] != poses[1]:
            ours, theirs = (Cell(*pose) if pose else None for pose in poses)
            yield Difference(index, Topic.PLAN, f"pose {k}", None, ours, theirs)
            return


def _candidates(
    index: int, name: str, a: Candidate | None, b: Candidate | None
) -> Iterator[Difference]:
    """Another cell, or the fields in which the same cell was rated differently."""
    if a is None or b is None or a.cell != b.cell:
        ours, theirs = (x.cell if x else None for x in (a, b))
        yield Difference(index, Topic.DECISION, name, None, ours, theirs)
        return
    for field in ("utility", "reward", "straight", "diagonal"):
        yield from _value(
            index, Topic.DECISION, f"{name}'s {field}", getattr(a, field), getattr(b, field), a.cell
        )


def _metrics(logged: Step, expected: Step) -> Iterator[Difference]:
    wanted = asdict(expected.metrics)
    for name, value in asdict(logged.metrics).items():
        yield from _value(logged.index, Topic.METRICS, name, value, wanted[name])


def _value(
    index: int, topic: Topic, what: str, a: float, b: float, cell: Cell | None = None
) -> Iterator[Difference]:
    if a != b and not (a != a and b != b):  # NaN equals NaN
        yield Difference(index, topic, what, cell, a, b)


def _events(logged: Step, expected: Step) -> Iterator[Difference]:
    for k, (a, b) in enumerate(zip_longest(logged.events, expected.events)):
        if a != b:
            ours, theirs = (f"{event.kind}: {event.text}" if event else None for event in (a, b))
            yield Difference(logged.index, Topic.EVENTS, f"event {k}", None, ours, theirs)
            return


def _outcome(logged: Step, expected: Step) -> Iterator[Difference]:
    outcomes = logged.outcome, expected.outcome
    yield Difference(logged.index, Topic.METRICS, "outcome", None, *outcomes)


_Comparison: TypeAlias = Callable[[Step, Step], Iterator[Difference]]

_COMPARISONS: Final[dict[str, _Comparison]] = {
    "agent": _agent,
    "hits": _hits,
    "observed": _map(Topic.OBSERVED, "observed"),
    "p_wall": _map(Topic.P_WALL, "p_wall"),
    "fused": _map(Topic.FUSED, "fused"),
    "frontier": _frontier,
    "decision": _decision,
    "metrics": _metrics,
    "events": _events,
    "outcome": _outcome,
}
"""By the field of `Step`; the profile is no part of what happened."""
