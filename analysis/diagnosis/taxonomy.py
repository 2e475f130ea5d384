"""Names for what sealed an agent in, each with a rule that can be read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from mapreplay.analysis.diagnosis.diagnosis import Sealing

UNCLASSIFIED: Final = "unclassified"


@dataclass(frozen=True)
class Kind:
    """A name and its rule; the first kind whose rule holds is taken."""

    name: str
    sentence: str
    """What happened, for a paragraph."""
    rule: str
    """In words."""
    holds: Callable[[Sealing], bool]


KINDS: Final[tuple[Kind, ...]] = ()


def classified(sealing: Sealing) -> Sealing:
    """`sealing` with its kind."""
    kind = next((kind.name for kind in KINDS if kind.holds(sealing)), UNCLASSIFIED)
    return replace(sealing, kind=kind)


def words(kind: str) -> str:
    """A sentence for a kind."""
    return next((known.sentence for known in KINDS if known.name == kind), "")
