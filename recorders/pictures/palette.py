"""All colours: the same in the viewer, in pictures and in reports.

They are those of Okabe and Ito (2008), which can be told apart with any kind of colour vision; a
probability is viridis. A colour means the same everywhere.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum, StrEnum
from functools import lru_cache
from typing import Final, TypeAlias

import numpy as np
import numpy.typing as npt

Colour: TypeAlias = tuple[int, int, int]
"""Red, green, blue, 0 to 255."""

ORANGE: Final = (230, 159, 0)
SKY_BLUE: Final = (86, 180, 233)
GREEN: Final = (0, 158, 115)
YELLOW: Final = (240, 228, 66)
BLUE: Final = (0, 114, 178)
VERMILION: Final = (213, 94, 0)
PURPLE: Final = (204, 121, 167)
GREY: Final = (128, 128, 128)


class CellClass(IntEnum):
    """What a cell of a map is shown as."""

    UNKNOWN = 0
    FREE = 1
    OCCUPIED = 2
    FALSE_WALL = 3
    FALSE_FREE = 4
    NOT_EXPLORABLE = 5

    @property
    def label(self) -> str:
        """Its name in a legend, and where a cell is hovered."""
        return _LABELS.get(self, self.name.lower().replace("_", " "))


_LABELS: Final = {CellClass.OCCUPIED: "wall"}

CELL_COLOURS: Final[dict[CellClass, Colour]] = {
    CellClass.UNKNOWN: GREY,
    CellClass.FREE: (240, 240, 240),
    CellClass.OCCUPIED: (25, 25, 25),
    CellClass.FALSE_WALL: VERMILION,
    CellClass.FALSE_FREE: SKY_BLUE,
    CellClass.NOT_EXPLORABLE: (66, 72, 92),
}

AGENT_COLOUR: Final = PURPLE
RAYS_COLOUR: Final = BLUE
HITS_COLOUR: Final = VERMILION
FRONTIER_COLOUR: Final = ORANGE
PLAN_COLOUR: Final = GREEN
"""Of the path and the target."""
RIVALS_COLOUR: Final = BLUE

MARK_COLOURS: Final[tuple[Colour, ...]] = (YELLOW, SKY_BLUE, GREEN, ORANGE)
"""Of marks, in the order of their names' first marks."""

EPISODE_COLOURS: Final[tuple[Colour, ...]] = (
    ORANGE, SKY_BLUE, GREEN, PURPLE, YELLOW, VERMILION, BLUE, GREY,
)  # fmt: skip
"""Of the curves of episodes that are compared, in their order."""


class Curve(StrEnum):
    """A score that is drawn over the steps: a field of `mapreplay.step.StepMetrics`."""

    F1 = "f1"
    PRECISION = "precision"
    RECALL = "recall"
    COVERAGE_OBSERVED = "coverage_observed"
    COVERAGE_FUSED = "coverage_fused"
    CORRECT_COVERAGE = "correct_coverage_fused"

    @property
    def label(self) -> str:
        """Its name in the legend."""
        return _CURVE_LABELS[self]


_CURVE_LABELS: Final[dict[Curve, str]] = {
    Curve.F1: "F1",
    Curve.PRECISION: "precision",
    Curve.RECALL: "recall",
    Curve.COVERAGE_OBSERVED: "coverage, observed",
    Curve.COVERAGE_FUSED: "coverage, fused",
    Curve.CORRECT_COVERAGE: "correct coverage",
}

CURVE_COLOURS: Final[dict[Curve, Colour]] = {
    Curve.F1: PURPLE,
    Curve.PRECISION: VERMILION,
    Curve.RECALL: BLUE,
    Curve.COVERAGE_OBSERVED: SKY_BLUE,
    Curve.COVERAGE_FUSED: ORANGE,
    Curve.CORRECT_COVERAGE: GREEN,
}


class State(StrEnum):
    """What the agent is doing, or how the episode ended."""

    EXPLORING = "exploring"
    FAIL_SAFE = "fail-safe"
    SEALED_IN = "sealed in"
    OUT_OF_STEPS = "out of steps"
    DONE = "done"


STATE_COLOURS: Final[dict[State, Colour]] = {
    State.EXPLORING: SKY_BLUE,
    State.FAIL_SAFE: ORANGE,
    State.SEALED_IN: VERMILION,
    State.OUT_OF_STEPS: PURPLE,
    State.DONE: GREEN,
}


@dataclass(frozen=True)
class Theme:
    """The colours around the maps, whose own colours are the same on dark and on light paper."""

    name: str
    paper: Colour
    ink: Colour
    faint: Colour
    """Of secondary text: units, ticks, captions."""
    line: Colour
    """Of frames and grids."""


LIGHT: Final = Theme("light", (255, 255, 255), (28, 30, 34), (98, 104, 114), (208, 212, 218))
DARK: Final = Theme("dark", (17, 19, 23), (236, 238, 242), (156, 162, 172), (58, 62, 70))
THEMES: Final = {theme.name: theme for theme in (LIGHT, DARK)}
PAGE: Final = Theme("light", (252, 252, 250), (29, 33, 38), (93, 102, 112), (213, 216, 219))
PAGE_DARK: Final = Theme("dark", (21, 24, 28), (228, 231, 234), (154, 164, 174), (58, 65, 72))
"""Of figures on a page of a report, as in its style sheet (`analysis/reporting/page.css`)."""


def hex_of(colour: Colour) -> str:
    """``#e69f00``: as matplotlib, SVG and CSS write a colour."""
    return "#{:02x}{:02x}{:02x}".format(*colour)


@lru_cache(maxsize=1)
def viridis() -> npt.NDArray[np.uint8]:
    """uint8[256, 3]: the colour of each level of P(occupied), red, green, blue."""
    import cv2

    ramp = cv2.applyColorMap(np.arange(256, dtype=np.uint8)[:, None], cv2.COLORMAP_VIRIDIS)
    colours = np.ascontiguousarray(ramp[:, 0, ::-1], np.uint8)
    colours.setflags(write=False)
    return colours


@lru_cache(maxsize=1)
def class_colours() -> npt.NDArray[np.uint8]:
    """uint8[6, 3]: the colour of each `CellClass`, red, green, blue."""
    colours = np.array([CELL_COLOURS[c] for c in CellClass], np.uint8)
    colours.setflags(write=False)
    return colours
