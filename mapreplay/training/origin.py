"""The origin of a training, which can only be resumed with the same origin."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final, Self

import torch

from mapreplay.source_digest import source_digest
from mapreplay.training.dataset import TrainingPlan

_SHOWN: Final = 12
"""Hex digits of a digest that are shown."""


@dataclass(frozen=True)
class PlanSet:
    """A digest of a list of floor plans: number, IDs and cells."""

    count: int
    first: str
    last: str
    sha256: str
    """Digest of all cells, logged maps, and their order."""

    @classmethod
    def of(cls, plans: Sequence[TrainingPlan]) -> Self:
        """The digest of `plans`."""
        digest = hashlib.sha256()
        for plan in plans:
            digest.update(f"{plan.number} {plan.id!r} {plan.truth.shape}\n".encode())
            for cells in (plan.truth, plan.explorable, *plan.logged):
                digest.update(cells.tobytes())
        ids = [plan.id for plan in plans] or [""]
        return cls(len(plans), ids[0], ids[-1], digest.hexdigest())

    def __str__(self) -> str:
        return f"{self.count} from {self.first} to {self.last}, sha256 {self.sha256[:_SHOWN]}"


@dataclass(frozen=True)
class TrainingOrigin:
    """Everything that the result of a training depends on."""

    options: Mapping[str, Any]
    """By name, with ``init_sha256`` for the weights that it starts from."""
    plans: PlanSet
    validation: PlanSet
    code: str
    """Digest of our code that trains."""
    torch: str
    """Version of PyTorch."""

    @classmethod
    def of(
        cls,
        options: Mapping[str, Any],
        plans: Sequence[TrainingPlan],
        validation: Sequence[TrainingPlan],
    ) -> Self:
        """The origin of a training that starts now."""
        code = source_digest("mapreplay.training.loop")
        return cls(
            dict(options), PlanSet.of(plans), PlanSet.of(validation), code, torch.__version__
        )

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return asdict(self)

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> Self:
        """The inverse of `to_json`.

        Raises:
            KeyError, TypeError: it is something else.
        """
        return cls(
            dict(values["options"]),
            PlanSet(**values["plans"]),
            PlanSet(**values["validation"]),
            str(values["code"]),
            str(values["torch"]),
        )

    def differences(self, now: TrainingOrigin) -> list[str]:
        """The differences to `now`, each in a few words."""
        found = [
            f"{_option(key)} {_short(self.options.get(key))} (now {_short(now.options.get(key))})"
            for key in sorted({*self.options, *now.options})
            if self.options.get(key) != now.options.get(key)
        ]
        for what, then, here in (
            ("training", self.plans, now.plans),
            ("validation", self.validation, now.validation),
        ):
            if then != here:
                found.append(f"other {what} plans: {then} (now {here})")
        if self.code != now.code:
            found.append(f"other code of mapreplay: {_short(self.code)} (now {_short(now.code)})")
        if self.torch != now.torch:
            found.append(f"PyTorch {self.torch} (now {now.torch})")
        return found


def _option(key: str) -> str:
    return "other --init weights: sha256" if key == "init_sha256" else f"--{key.replace('_', '-')}"


def _short(value: object) -> str:
    if value is None or value == "":
        return "none"
    text = str(value)
    return text[:_SHOWN] if len(text) == hashlib.sha256().digest_size * 2 else text
