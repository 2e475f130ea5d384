"""Names for what sealed an agent in, each with a readable rule.

The rules were made by looking at sealings on validation plans (procedural 50000 to 50999, and the
1,000 training houses with the smallest SHA-256 of their id), and are reported on test plans.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from mapreplay.analysis.diagnosis.diagnosis import Sealing
    from mapreplay.analysis.diagnosis.passage import Passage

UNCLASSIFIED: Final = "unclassified"
DOOR_WIDTH: Final = 6
"""Cells; at 0.2 m a cell, 1.2 m."""
DOOR_LENGTH: Final = 4
"""Cells: the length of a door at most."""
CORRIDOR_WIDTH: Final = 10
"""Cells."""
NOOK: Final = 12
"""Hidden cells, at most, of a corner."""


@dataclass(frozen=True)
class SealingKind:
    """A name and its rule; the first kind whose rule holds is taken."""

    name: str
    sentence: str
    """What happened, for a paragraph."""
    rule: str
    """In words."""
    holds: Callable[[Sealing, Passage], bool]


def _is_nook(sealing: Sealing, passage: Passage) -> bool:  # noqa: ARG001
    return sealing.hidden <= NOOK


def _is_door(passage: Passage) -> bool:
    return passage.gap <= DOOR_WIDTH and passage.length <= DOOR_LENGTH


def _are_doors(sealing: Sealing, passage: Passage) -> bool:
    return _is_door(passage) and sealing.opening is not None and sealing.opening.parts > 1


KINDS: Final[tuple[SealingKind, ...]] = (
    SealingKind(
        "corner_leak",
        "Only the last corner was left, and it was closed.",
        f"at most {NOOK} explorable cells are hidden",
        _is_nook,
    ),
    SealingKind(
        "closed_doors",
        "All of several doors were predicted shut.",
        "as a closed door, and the opening has several parts",
        _are_doors,
    ),
    SealingKind(
        "closed_door",
        "A door was predicted shut.",
        f"the passage at the first blocking cell is at most {DOOR_WIDTH} cells wide and "
        f"{DOOR_LENGTH} long",
        lambda _, passage: _is_door(passage),
    ),
    SealingKind(
        "corridor_cut",
        "A corridor was predicted to end.",
        f"the passage at the first blocking cell is at most {CORRIDOR_WIDTH} cells wide and longer "
        "than it is wide",
        lambda _, passage: passage.gap <= CORRIDOR_WIDTH and passage.length > passage.gap,
    ),
    SealingKind(
        "phantom_wall",
        "A wall was predicted across open space.",
        "wider than that, and the false wall is at least half as long as the passage is wide",
        lambda _, passage: 2 * passage.span >= passage.gap,
    ),
)


def classified(sealing: Sealing) -> Sealing:
    """`sealing` with its kind."""
    passage = sealing.passage
    if passage is None:
        return sealing
    kind = next((kind.name for kind in KINDS if kind.holds(sealing, passage)), UNCLASSIFIED)
    return replace(sealing, kind=kind)


def words(kind: str) -> str:
    """A sentence for a kind."""
    return next((known.sentence for known in KINDS if known.name == kind), "")
