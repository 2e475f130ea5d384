"""A step in words: its decision and its events."""

from __future__ import annotations

import math

from mapreplay.step import Candidate, Event, EventKind, Mode, Step
from mapreplay.text import printable


def event_words(event: Event) -> str:
    """An event as a line: ``sealed in: the fused map has no frontier within reach``."""
    return printable(f"{event.kind}: {event.text}".replace("_", " "))


def decision_words(step: Step) -> str:
    """Why the agent chose its target, in a sentence; at the last step, how the episode ended."""
    decision = step.decision
    if decision is None:
        ended = [event.text for event in step.events if event.kind is EventKind.OUTCOME]
        return ended[-1].replace("_", " ") if ended else "no target is logged"
    words = f"went to {_cell(decision.chosen)}"
    if decision.mode is Mode.FAIL_SAFE:
        words += " by the fail-safe"
    if decision.random_draw is not None:
        return f"{words}: drawn at random, {decision.chosen.cost:.1f} cells away"
    if decision.chosen.utility == decision.chosen.reward == 1:  # nothing was compared
        return f"{words}: its target as before, {decision.chosen.cost:.1f} cells away"
    words += f": {_rating(decision.chosen)}"
    if decision.rivals:
        words += f"; runner-up {_cell(decision.rivals[0])} {_utility(decision.rivals[0])}"
    return words


def _rating(candidate: Candidate) -> str:
    utility, reward, cost = candidate.utility, candidate.reward, candidate.cost
    if math.isnan(utility):
        return f"{cost:.1f} cells away"
    rated = f"utility {_utility(candidate)}"
    # A planner of a plug-in may define utility in another way.
    if math.isclose(utility, reward / (1 + cost), rel_tol=1e-6):
        return f"{rated} = gain {reward:.1f} / (1 + {cost:.1f})"
    return f"{rated}, gain {reward:.1f}, {cost:.1f} cells away"


def _utility(candidate: Candidate) -> str:
    return three_digits(candidate.utility)


def three_digits(number: float) -> str:
    """The number with three significant digits: 1.70, 48.2, 0.0625, 1.23e+03."""
    return f"{number:#.3g}".rstrip(".")


def _cell(candidate: Candidate) -> str:
    return f"({candidate.cell.row}, {candidate.cell.col})"
