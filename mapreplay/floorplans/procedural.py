"""Procedural floor plans: the paper's first dataset, D1.

A fixed rectangular contour, halved again and again into rooms; every dividing wall has one
door, of fixed width, at a fixed distance from one of its two ends. As no wall ends in a
door, all rooms are connected: the doors form a tree.

The paper says of D1 only "independently generated", "identical, convex (rectangle)" contour
and low variance in size, share of walls and topology; the rest is ours.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mapreplay.errors import FloorPlanError, UsageError
from mapreplay.floorplan import FloorPlan
from mapreplay.grid import FREE, OCCUPIED
from mapreplay.randomness import Draws, Purpose

MAX_SEED = 2**32 - 1
MAX_PLANS = 1_000_000
"""Floor plans in one source."""

_SEEDS = re.compile(r"([0-9]{1,10})(?:-([0-9]{1,10}))?")
_ID = re.compile(r"procedural-(0|[1-9][0-9]{0,9})")


@dataclass(frozen=True)
class Style:
    """Common properties of all plans of a kind; lengths in cells.

    Raises:
        ValueError: rooms are so small that a wall could end in another wall's door.
    """

    height: int = 64
    width: int = 64
    min_room: int = 10
    """Minimum width of the parts when a room is divided."""
    door: int = 4
    corner: int = 1
    """Wall cells between a door and the end of its wall."""
    shift: int = 5
    """Maximum distance of a dividing wall from the middle."""
    resolution: float = 0.2

    def __post_init__(self) -> None:
        if self.min_room < self.corner + self.door:
            raise ValueError("min_room must be at least corner + door")


D1 = Style()


@dataclass(frozen=True)
class _Room:
    """The free cells of a room; bottom and right excluded."""

    top: int
    left: int
    bottom: int
    right: int


def generate(seed: int, style: Style = D1) -> FloorPlan:
    """The procedural floor plan number `seed` (0 to 2^32 - 1), the same on every machine.

    Returns a plan of `style.height` x `style.width` cells called ``procedural-<seed>``.

    Raises:
        UsageError: `seed` is out of range.
    """
    if not 0 <= seed <= MAX_SEED:
        raise UsageError(f"procedural: seed {seed} is not in 0 to {MAX_SEED}")
    draws = Draws(seed, Purpose.FLOOR_PLAN)
    cells = np.full((style.height, style.width), OCCUPIED, np.int8)
    cells[1:-1, 1:-1] = FREE
    rooms = [_Room(1, 1, style.height - 1, style.width - 1)]
    while rooms:
        room = rooms.pop()
        tall, wide = room.bottom - room.top, room.right - room.left
        if max(tall, wide) < 2 * style.min_room + 1:
            continue
        across = tall > wide or (tall == wide and draws.below(2) == 0)
        # The transposed view turns a wall between left and right into one between top and
        # bottom, so that the rest is written once.
        view = cells if across else cells.T
        if not across:
            room = _Room(room.left, room.top, room.right, room.bottom)
        wall = _wall_row(room, style, draws)
        view[wall, room.left : room.right] = OCCUPIED
        span = room.right - room.left
        from_end = draws.below(2) == 0
        first = span - style.corner - style.door if from_end else style.corner
        view[wall, room.left + first : room.left + first + style.door] = FREE
        halves = (
            _Room(room.top, room.left, wall, room.right),
            _Room(wall + 1, room.left, room.bottom, room.right),
        )
        rooms += halves if across else [_Room(h.left, h.top, h.right, h.bottom) for h in halves]
    return FloorPlan(f"procedural-{seed}", cells, style.resolution)


def _wall_row(room: _Room, style: Style, draws: Draws) -> int:
    """A row for a wall through `room`, near its middle.

    It never ends at a door, because doors are closer to a corner than the minimum room width.
    """
    middle = (room.top + room.bottom) // 2
    rows = [
        row
        for row in range(middle - style.shift, middle + style.shift + 1)
        if row - room.top >= style.min_room and room.bottom - row - 1 >= style.min_room
    ]
    return draws.choice(rows)


class ProceduralSource:
    """Floor plans by seed: ``procedural``, ``procedural:7``, ``procedural:60000-60099``."""

    default_predictor = "d1"

    def __init__(self, spec: str, style: Style = D1) -> None:
        """Parse `spec`, a seed or an inclusive range of seeds; empty means 60000-60099.

        Raises:
            UsageError: `spec` is neither, or has too many seeds.
        """
        match = _SEEDS.fullmatch(spec or "60000-60099")
        if match is None:
            raise UsageError(
                f"procedural:{spec[:40]}: expected a seed or a range of seeds, like 60000-60099"
            )
        low, high = int(match[1]), int(match[2] or match[1])
        if not low <= high <= MAX_SEED:
            raise UsageError(f"procedural:{spec}: seeds go from 0 to {MAX_SEED}, upwards")
        if high - low >= MAX_PLANS:
            raise UsageError(f"procedural:{spec}: at most {MAX_PLANS} seeds at a time")
        self._seeds = range(low, high + 1)
        self._style = style

    def ids(self) -> Sequence[str]:
        """``procedural-<seed>`` for each seed."""
        return [f"procedural-{seed}" for seed in self._seeds]

    def load(self, floor_plan_id: str) -> FloorPlan:
        """Generate one.

        Raises:
            FloorPlanError: there is no such seed in this source.
        """
        match = _ID.fullmatch(floor_plan_id)
        if match is None or int(match[1]) not in self._seeds:
            raise FloorPlanError(
                f"procedural plan {floor_plan_id[:40]!r} is not of the seeds "
                f"{self._seeds[0]}-{self._seeds[-1]}"
            )
        return generate(int(match[1]), self._style)


def open_source(rest: str, resolution: float | None) -> ProceduralSource:
    """The source ``procedural``; see `mapreplay.plugins.PluginKind.FLOORPLANS`.

    Raises:
        UsageError: not a range of seeds, or another resolution was given.
    """
    if resolution not in (None, D1.resolution):
        raise UsageError(f"procedural plans have {D1.resolution} m per cell, not {resolution}")
    return ProceduralSource(rest)
