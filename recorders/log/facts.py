"""A header in words: what every verb, the viewer and a bundle say of an episode as a whole."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final, NamedTuple

from mapreplay.step import EpisodeHeader

_IN_CONFIG: Final = ("predictor", "start", "max_steps")
"""Settings that are told as what came of them."""
_NAMES: Final = {
    ("floor plan", "id"): "floor plan",
    ("predictor", "name"): "predictor",
    ("predictor", "sha256"): "weights",
}
_DIGEST: Final = re.compile(r"([0-9a-f]{12})[0-9a-f]{52}")


class Fact(NamedTuple):
    """Something that holds for a whole episode."""

    of: str
    """floor plan, agent, predictor, config, branch or version."""
    what: str
    value: str
    """``-`` where there is none."""

    @property
    def name(self) -> str:
        """What it is called where all facts stand together."""
        if self.of in ("config", "agent"):
            return self.what
        return _NAMES.get((self.of, self.what), f"{self.of} {self.what}")

    @property
    def short(self) -> str:
        """The value, of a SHA-256 its beginning."""
        digest = _DIGEST.fullmatch(self.value)
        return digest[1] if digest else self.value


def facts_of(header: EpisodeHeader) -> list[Fact]:
    """All that a header says."""
    plan, branch = header.floor_plan, header.branch
    settings = header.config.model_dump(mode="json")
    facts: list[tuple[str, str, object]] = [
        ("floor plan", "id", plan.id),
        ("floor plan", "cells", f"{plan.shape[0]} x {plan.shape[1]}"),
        ("floor plan", "resolution", f"{plan.resolution} m per cell"),
        ("floor plan", "explorable cells", int(header.explorable.sum())),
        ("floor plan", "true map", "known" if plan.has_truth else "not known"),
        ("floor plan", "sha256", plan.sha256),
        ("agent", "start", "row {}, col {}".format(*header.start)),
        ("agent", "budget", "none" if header.budget is None else f"{header.budget} steps"),
        ("agent", "simulator", header.simulator),
        ("predictor", "name", header.predictor.name),
        ("predictor", "sha256", header.predictor.sha256 or "-"),
        *(("config", key, value) for key, value in settings.items() if key not in _IN_CONFIG),
    ]
    if branch is not None:
        facts += [
            ("branch", "parent's sha256", branch.parent_sha256),
            ("branch", "step", branch.step),
            ("branch", "changes", ", ".join(branch.changes)),
        ]
    facts += [("version", name, version) for name, version in header.versions]
    return [Fact(of, what, "-" if value is None else str(value)) for of, what, value in facts]


@dataclass(frozen=True)
class HeaderDifference:
    """Something of the whole episode that two logs say otherwise."""

    what: str
    """`Fact.name`, such as "planner"."""
    a: str
    b: str


def header_differences(a: EpisodeHeader, b: EpisodeHeader) -> tuple[HeaderDifference, ...]:
    """What two headers say otherwise, fact by fact."""
    of_a, of_b = ({fact.name: fact.short for fact in facts_of(header)} for header in (a, b))
    pairs = ((name, of_a.get(name, "none"), of_b.get(name, "none")) for name in of_a | of_b)
    return tuple(HeaderDifference(*pair) for pair in pairs if pair[1] != pair[2])
