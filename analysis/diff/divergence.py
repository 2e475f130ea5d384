"""Where two episodes diverge: the first step at which each layer of them differs.

Layers are in causal order. What two agents observe at a step can differ only if they moved
apart before; a prediction follows from the observation, the fused map from both, the frontier
and its ranking from the maps, the decision from the ranking, the move from the decision.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final

from mapreplay.grid import Cell
from mapreplay.recorders.log.facts import HeaderDifference, header_differences
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.recorders.pictures.replay import side_by_side
from mapreplay.step import MAX_RIVALS, Cells, Decision, Step, differences


class Layer(StrEnum):
    """What of a step differs."""

    START = "start"
    OBSERVATION = "observation"
    PREDICTION = "prediction"
    FUSED = "fused map"
    RANKING = "frontier ranking"
    DECISION = "decision"
    MOVE = "move"
    END = "end"
    RECORD = "record"
    """Metrics or events, with everything else the same."""


_OF_FIELD: Final = {
    "agent": Layer.START,
    "hits": Layer.OBSERVATION,
    "observed": Layer.OBSERVATION,
    "p_wall": Layer.PREDICTION,
    "fused": Layer.FUSED,
    "frontier": Layer.RANKING,
    "outcome": Layer.END,
}
"""The decision has three layers of its own; the profile is no part of what happened."""
_RECORD: Final = {"metrics", "events"}
"""They follow from the rest, and are told only where nothing else differs."""


@dataclass(frozen=True, eq=False)
class Moment:
    """A step of both episodes, and what they wanted just before."""

    a: Step | None
    """None if A ended."""
    b: Step | None
    before_a: Decision | None
    """A's decision at the step before."""
    before_b: Decision | None

    @property
    def index(self) -> int:
        """Of the step."""
        step = self.a or self.b
        return step.index if step else 0


@dataclass(frozen=True, eq=False)
class Divergences:
    """The first step of each layer that differs; empty if all steps are the same bit for bit."""

    first: dict[Layer, Moment]
    """In causal order within a step. Layers that had not diverged when the agents did are left
    out: from there on they are in different places."""
    steps: int
    """Steps that both have."""
    headers: tuple[HeaderDifference, ...]
    """What the two logs say otherwise of the whole episode."""

    @property
    def identical(self) -> bool:
        """Whether all that the logs say is the same, bit for bit, but for the times that it
        took (the profile).
        """
        return not self.first and not self.headers

    @property
    def layer(self) -> Layer | None:
        """The layer that diverges first."""
        return next(iter(self.first), None)


def find_divergences(a: EpisodeLog, b: EpisodeLog) -> Divergences:
    """Compare two episodes on one floor plan step by step, until the agents diverge.

    Raises:
        LogError: a log cannot be read.
    """
    first: dict[Layer, Moment] = {}
    same_planner = a.header.config.planner == b.header.config.planner
    steps = 0
    for moment in _moments(a, b):
        for layer in _differing(moment, same_planner=same_planner):
            first.setdefault(layer, moment)
        if moment.a is None or moment.b is None:
            break
        steps = moment.index + 1
        if Layer.MOVE in first or Layer.START in first:
            break
    order = sorted(first.items(), key=lambda item: (item[1].index, list(Layer).index(item[0])))
    if Layer.MOVE in first:
        steps = min(a.last, b.last) + 1
    said = [*header_differences(a.header, b.header)]
    if a.state.missing != b.state.missing:
        said.append(
            HeaderDifference("missing steps", *(_spans(log.state.missing) for log in (a, b)))
        )
    return Divergences(dict(order), steps, tuple(said))


def _spans(spans: Sequence[range]) -> str:
    return ", ".join(f"{span.start} to {span.stop - 1}" for span in spans) or "none"


def _moments(a: EpisodeLog, b: EpisodeLog) -> Iterator[Moment]:
    before: tuple[Decision | None, Decision | None] = (None, None)
    following = 0
    for one, other in side_by_side(a.steps(), b.steps()):
        moment = Moment(one, other, *before)
        if moment.index != following:  # what they wanted just before is not known
            moment = Moment(one, other, None, None)
        yield moment
        following = moment.index + 1
        before = (one.decision if one else None, other.decision if other else None)


def _differing(moment: Moment, *, same_planner: bool) -> Iterator[Layer]:
    a, b = moment.a, moment.b
    if a is None or b is None:
        yield Layer.END
        return
    names = differences(a, b)
    if set(names) <= _RECORD | {"profile"}:
        yield from (Layer.RECORD for name in names if name in _RECORD)
        return
    for name in names:
        if name == "decision":
            yield from _parts_of_decision(a.decision, b.decision, same_planner=same_planner)
        elif name == "agent":
            # Apart without a logged decision that says so: external episodes.
            yield Layer.START if a.index == 0 else Layer.MOVE
        elif name in _OF_FIELD:
            yield _OF_FIELD[name]


def _parts_of_decision(
    a: Decision | None, b: Decision | None, *, same_planner: bool
) -> Iterator[Layer]:
    if a is None or b is None:
        yield Layer.END
        return
    # Other planners have other utilities; what they have in common is an order.
    ranked_alike = _rated_alike(a, b) if same_planner else _order(a) == _order(b)
    if not ranked_alike:
        yield Layer.RANKING
    if (a.target, a.mode, a.random_draw) != (b.target, b.mode, b.random_draw):
        yield Layer.DECISION
    if a.next_cell != b.next_cell:
        yield Layer.MOVE
    elif not _same_cells(a.path, b.path):
        yield Layer.DECISION


def _rated_alike(a: Decision, b: Decision) -> bool:
    """Whether one rating of the frontier can be behind what both logged of it, bit for bit.

    Each logs what it chose and the best of the others, so that after different choices, such as
    two draws, the two lists differ though the rating is the same.
    """
    of_a, of_b = _ratings(a), _ratings(b)
    if any(of_a[cell].bits != of_b[cell].bits for cell in of_a.keys() & of_b.keys()):
        return False
    return _could_be_left_out(of_a, b, of_b) and _could_be_left_out(of_b, a, of_a)


def _could_be_left_out(
    candidates: dict[Cell, _Rating], other: Decision, known: dict[Cell, _Rating]
) -> bool:
    """Whether those that `other` does not list come after all rivals that it does."""
    missing = [rating for cell, rating in candidates.items() if cell not in known]
    if not missing or not other.rivals:  # nothing is said of the others
        return True
    last = max(known[rival.cell] for rival in other.rivals)
    return len(other.rivals) == MAX_RIVALS and min(missing) >= last


@dataclass(frozen=True, order=True)
class _Rating:
    """A candidate by its place in a ranking."""

    place: tuple[float, float, Cell]
    bits: tuple[object, ...] = field(compare=False)
    """What is logged of it; NaN equals itself."""


def _ratings(decision: Decision) -> dict[Cell, _Rating]:
    return {
        c.cell: _Rating(
            (-c.utility, c.cost, c.cell), (c.utility.hex(), c.reward.hex(), c.straight, c.diagonal)
        )
        for c in (decision.chosen, *decision.rivals)
    }


def _order(decision: Decision) -> list[tuple[object, ...]]:
    ranked = sorted((decision.chosen, *decision.rivals), key=lambda c: (-c.utility, c.cost, c.cell))
    return [candidate.cell for candidate in ranked]


def _same_cells(a: Cells, b: Cells) -> bool:
    return a.shape == b.shape and bool((a == b).all())
