"""How grey levels of an image become cells, like in Nav2's ``map_server``.

The modes are those of ``nav2_map_server`` (``map_io.cpp``) as of 2026, reduced to the three values
that our cells have: a percentage between 0 and 100 is unknown in every mode. Images without a YAML
file are read by the same rule with ``map_server``'s usual thresholds.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from mapreplay.errors import UsageError
from mapreplay.floorplans.files import exists
from mapreplay.grid import FREE, OCCUPIED, UNKNOWN

MODES: Final = ("trinary", "scale", "raw")

_OPTIONS: Final = re.compile(r"(.+?):(\w+=.*)", re.DOTALL)
_KEYS: Final = ("free", "occupied", "negate")


@dataclass(frozen=True)
class GreyThresholds:
    """P(occupied) up to which a pixel is free, and from which it is occupied.

    Raises:
        ValueError: not 0 <= free <= occupied <= 1.
    """

    occupied: float = 0.65
    free: float = 0.196

    def __post_init__(self) -> None:
        if not 0 <= self.free <= self.occupied <= 1:
            raise ValueError(
                f"free_thresh {self.free:g} and occupied_thresh {self.occupied:g}: expected "
                "0 <= free_thresh <= occupied_thresh <= 1, as fractions, not percentages"
            )


@dataclass(frozen=True)
class GreyRule:
    """How a grey level becomes a cell."""

    mode: str = "trinary"
    """One of `MODES`."""
    thresholds: GreyThresholds = field(default_factory=GreyThresholds)
    negate: bool = False
    """White is occupied; no effect in mode raw."""

    def p_occupied(self) -> npt.NDArray[np.float32]:
        """float32[256]: P(occupied) of each grey level, rounded like Nav2 does, which matters at
        thresholds.
        """
        greys = np.arange(256, dtype=np.float32)
        if self.mode == "raw":
            return greys / np.float32(100)
        light = greys / np.float32(255)
        return light if self.negate else np.float32(1) - light

    def table(self) -> npt.NDArray[np.int8]:
        """int8[256]: the cell of each grey level."""
        p = self.p_occupied()
        occupied, free = np.float32(self.thresholds.occupied), np.float32(self.thresholds.free)
        cells = np.full(256, UNKNOWN, np.int8)
        cells[p >= occupied] = OCCUPIED
        cells[p <= free] = FREE
        if self.mode == "raw":
            cells[p > 1] = UNKNOWN
        if self.mode == "scale" and free < occupied:
            between = (p > free) & (p < occupied)
            percent = np.floor((p - free) / (occupied - free) * 100 + 0.5)
            cells[between & (percent == FREE)] = FREE
            cells[between & (percent == OCCUPIED)] = OCCUPIED
        return cells


@dataclass(frozen=True)
class GreyOptions:
    """Options of a specification like ``plan.png:free=0.3,occupied=0.6``, see `GreyRule`."""

    free: float | None = None
    occupied: float | None = None
    negate: bool | None = None

    def __bool__(self) -> bool:
        """Whether any is given."""
        return self != NO_OPTIONS

    def applied_to(self, rule: GreyRule) -> GreyRule:
        """`rule` with the given values.

        Raises:
            ValueError: see `GreyThresholds`.
        """
        thresholds = GreyThresholds(
            free=rule.thresholds.free if self.free is None else self.free,
            occupied=rule.thresholds.occupied if self.occupied is None else self.occupied,
        )
        negate = rule.negate if self.negate is None else self.negate
        return replace(rule, thresholds=thresholds, negate=negate)


NO_OPTIONS: Final = GreyOptions()


def split_options(spec: str) -> tuple[str, GreyOptions]:
    """The path and the options of ``PATH:free=0.3,occupied=0.6,negate=1``; all are optional.

    If a file or folder has the whole text as its name, there are no options; nor if the text is
    not a path followed by known options.

    Raises:
        UsageError: an option or its value is invalid.
    """
    match = _OPTIONS.fullmatch(spec)
    if match is None or exists(Path(spec)):
        return spec, NO_OPTIONS
    if not exists(Path(match[1])) and match[2].partition("=")[0] not in _KEYS:
        return spec, NO_OPTIONS
    values: dict[str, float] = {}
    for item in match[2].split(","):
        key, _, text = item.partition("=")
        try:
            value = float(text)
        except ValueError:
            value = -1.0
        legal = value in (0, 1) if key == "negate" else 0 <= value <= 1
        if key not in _KEYS or not legal or key in values:
            raise UsageError(
                f"{spec}: {item!r} is not one of free=, occupied= (0 to 1) and negate= (0 or 1)"
            )
        values[key] = value
    negate = values.pop("negate", None)
    return match[1], GreyOptions(**values, negate=None if negate is None else bool(negate))
