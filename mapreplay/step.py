"""What is known of an episode: the types that the simulator makes and the log keeps.

A `Step` holds everything of one moment; an `EpisodeHeader` what holds for all of them.
Recorders take these, logs give them back bit for bit, and every analysis starts from them.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from enum import StrEnum
from functools import cached_property
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from mapreplay.config import EpisodeConfig, MapKind, predictor_name
from mapreplay.floorplan import FloorPlan, explorable
from mapreplay.grid import Cell, Grid, Mask, Quantized
from mapreplay.kernels import SQRT2
from mapreplay.mapping import Thresholds
from mapreplay.sensor import Hits, Sensor

FIRST_STAMP_NS: Final = 1_000_000_000
STEP_NS: Final = 100_000_000
OURS: Final = "mapreplay"
NO_BUDGET: Final = 10_000_000
"""So many moves are no budget: of episodes that end by themselves."""

Cells = npt.NDArray[np.int32]
"""int32[n, 2]: (row, col) of n cells."""


def in_short(array: npt.NDArray[Any] | None) -> str:
    """An array as ``int8[64, 64]``."""
    return "None" if array is None else f"{array.dtype}{list(array.shape)}"


class Mode(StrEnum):
    """Which maps the agent planned on."""

    NORMAL = "normal"
    FAIL_SAFE = "fail-safe"


class Outcome(StrEnum):
    """How an episode ended."""

    MAPPED = "mapped"
    SEALED_IN = "sealed_in"
    OUT_OF_STEPS = "out_of_steps"


class EventKind(StrEnum):
    """The kinds of events in a log."""

    SEALED_IN = "sealed_in"
    RELEASED = "released"
    TARGET_REACHED = "target_reached"
    CORRECT_REACHED = "correct_reached"
    PREDICTOR = "predictor"
    """A predictor that is one of several chose among them, or changed its mind."""
    OUTCOME = "outcome"


@dataclass(frozen=True)
class Event:
    """Something that happened at a step, with a sentence about it."""

    kind: EventKind
    text: str


@dataclass(frozen=True)
class Candidate:
    """A frontier cell as the planner rated it."""

    cell: Cell
    utility: float
    reward: float
    straight: int
    """Straight moves on the shortest path to it."""
    diagonal: int

    @property
    def cost(self) -> float:
        """Length of the shortest path, in cells."""
        return self.straight + self.diagonal * SQRT2


@dataclass(frozen=True, eq=False, repr=False)
class Decision:
    """Where the agent goes next, and what it could have done instead."""

    chosen: Candidate
    path: Cells
    """int32[n, 2] from the agent's cell to the target's, n >= 2; the move is to path[1]."""
    mode: Mode
    rivals: tuple[Candidate, ...]
    """The best other frontier cells, best first, at most `MAX_RIVALS`."""
    random_draw: int | None
    """The raw 64-bit number that decided, where chance did."""

    def __repr__(self) -> str:
        return (
            f"Decision({self.mode}, target={tuple(self.target)}, path={in_short(self.path)}, "
            f"rivals={len(self.rivals)})"
        )

    @property
    def target(self) -> Cell:
        """The chosen frontier cell."""
        return self.chosen.cell

    @property
    def next_cell(self) -> Cell:
        """Where the agent will be one step later."""
        return Cell(int(self.path[1, 0]), int(self.path[1, 1]))


MAX_RIVALS: Final = 5


@dataclass(frozen=True)
class StepMetrics:
    """Scores of a step's maps on explorable cells; NaN where undefined.

    Without a suffix: of the map under construction (`build`). `_observed`, `_thresholded`
    and `_raw`: of the observations, of the prediction after both thresholds, and of the
    prediction at p >= .5. Unknown cells count as not occupied.
    """

    path_length: float
    """Metres travelled so far."""
    coverage_observed: float
    coverage_fused: float
    correct_coverage_observed: float
    correct_coverage_fused: float
    precision: float
    recall: float
    f1: float
    iou: float
    precision_observed: float
    recall_observed: float
    f1_observed: float
    iou_observed: float
    precision_thresholded: float
    recall_thresholded: float
    f1_thresholded: float
    iou_thresholded: float
    precision_raw: float
    recall_raw: float
    f1_raw: float
    iou_raw: float
    brier: float
    log_loss: float
    brier_unobserved: float
    log_loss_unobserved: float

    def coverage(self, kind: MapKind) -> float:
        """Known share of the explorable cells of one map, 0 to 1."""
        return self.coverage_observed if kind is MapKind.OBSERVED else self.coverage_fused

    def correct_coverage(self, kind: MapKind) -> float:
        """Known and right share of the explorable cells of one map, 0 to 1."""
        if kind is MapKind.OBSERVED:
            return self.correct_coverage_observed
        return self.correct_coverage_fused

    @classmethod
    def names(cls) -> tuple[str, ...]:
        """The field names, in order: columns of every table of steps."""
        return tuple(f.name for f in fields(cls))


@dataclass(frozen=True)
class StepProfile:
    """Wall-clock nanoseconds of each stage of a step."""

    sense: int
    predict: int
    fuse: int
    score: int
    plan: int


@dataclass(frozen=True, eq=False, repr=False)
class Step:
    """The state after `index` moves, what was believed then, and what was decided."""

    index: int
    agent: Cell
    hits: Hits
    """int16[rays], see `mapreplay.sensor`; int16[0] in an external log without scans."""
    observed: Grid
    """int8[H, W]."""
    p_wall: Quantized | None
    """The prediction as used, or None without a predictor."""
    fused: Grid
    """int8[H, W]."""
    frontier: Cells
    """int32[n, 2], row-major: what the planner chose from."""
    decision: Decision | None
    """None at the last step."""
    metrics: StepMetrics
    events: tuple[Event, ...]
    outcome: Outcome | None
    """None before the last step."""
    profile: StepProfile | None
    """Not part of what happened: None in a log that was recorded without it."""

    def __repr__(self) -> str:
        names = ("hits", "observed", "p_wall", "fused", "frontier")
        arrays = ", ".join(f"{name}={in_short(getattr(self, name))}" for name in names)
        return (
            f"Step({self.index}, agent={tuple(self.agent)}, {arrays}, decision={self.decision!r}, "
            f"f1={self.metrics.f1:.3f}, events={[str(event.kind) for event in self.events]}, "
            f"outcome={self.outcome and str(self.outcome)!r})"
        )

    @property
    def stamp_ns(self) -> int:
        """Simulated time: 1 s + 0.1 s a move, in nanoseconds."""
        return FIRST_STAMP_NS + self.index * STEP_NS

    @property
    def mode(self) -> Mode:
        """The decision's mode; normal where nothing was decided."""
        return self.decision.mode if self.decision else Mode.NORMAL


@dataclass(frozen=True)
class PredictorIdentity:
    """Which predictor was used."""

    name: str
    """Never a path, see `mapreplay.config.predictor_name`."""
    sha256: str
    """Of its weights; empty if it has none."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "name", predictor_name(self.name))


@dataclass(frozen=True, eq=False, repr=False)
class EpisodeHeader:
    """All that a log says once."""

    config: EpisodeConfig
    floor_plan: FloorPlan
    start: Cell
    max_steps: int
    predictor: PredictorIdentity
    versions: tuple[tuple[str, str], ...]
    """(library, version) of what the result depends on, sorted."""
    simulator: str = OURS
    """Who made the steps: ours, or the name of another, whose steps cannot be recomputed."""
    branch: Branch | None = None
    """Origin of an episode that was resumed from a step of another log."""

    def __repr__(self) -> str:
        c, plan = self.config, self.floor_plan
        return (
            f"EpisodeHeader({plan.id!r} {in_short(plan.cells)}, start={tuple(self.start)}, "
            f"planner={c.planner!r}, predictor={self.predictor.name!r}, "
            f"maps='{c.plan_on}-{c.build}', seed={c.seed})"
        )

    @cached_property
    def explorable(self) -> Mask:
        """bool[H, W]: the cells that count, those that can be explored from the start."""
        return explorable(self.floor_plan.cells, self.start)

    @property
    def budget(self) -> int | None:
        """Moves that are allowed; None if nothing limits them."""
        return self.max_steps if self.max_steps < NO_BUDGET else None

    @property
    def sensor(self) -> Sensor:
        """The sensor that the configuration describes."""
        return Sensor(self.config.rays, self.config.reach)

    @property
    def thresholds(self) -> Thresholds:
        """The thresholds that the configuration describes."""
        return Thresholds(self.config.delta_free, self.config.delta_occupied)

    def at(self, index: int) -> EpisodeHeader:
        """What held at step `index`: before the step of a branch, what its parent says."""
        if self.branch is not None and index < self.branch.step:
            return self.branch.before.at(index)
        return self

    @property
    def file_name(self) -> str:
        """``<floor-plan>__<planner>__<plan-on>-<build>__s<seed>.mcap``."""
        return log_name(self.floor_plan.id, self.config)


@dataclass(frozen=True, eq=False)
class Branch:
    """From which log and step an episode was run on, and what was changed there.

    The steps before are those of the parent, and under its header.
    """

    parent_sha256: str
    """Of the parent's file."""
    step: int
    """The first step that is not the parent's; the agent and what it had observed are."""
    changes: tuple[str, ...]
    """As they were asked for, such as ``delta-occupied=0.97``; never with a path."""
    before: EpisodeHeader
    """The parent's."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "changes", tuple(map(_without_path, self.changes)))


def _without_path(change: str) -> str:
    key, equals, value = change.partition("=")
    return f"{key}={predictor_name(value)}" if equals and key == "predictor" else change


def log_name(floor_plan_id: str, config: EpisodeConfig) -> str:
    """The name of an episode's log, which follows from its floor plan and configuration."""
    c = config
    return f"{floor_plan_id}__{c.planner}__{c.plan_on}-{c.build}__s{c.seed}.mcap"


def differences(a: Step, b: Step) -> list[str]:
    """Names of the fields in which two steps differ, in order; NaN equals NaN."""
    return [f.name for f in fields(Step) if not _same(getattr(a, f.name), getattr(b, f.name))]


def _same(a: object, b: object) -> bool:
    if type(a) is not type(b):
        return False
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
    if isinstance(a, tuple) and isinstance(b, tuple):
        return len(a) == len(b) and all(map(_same, a, b))
    if isinstance(a, Decision | Candidate | StepMetrics | StepProfile):
        return all(_same(getattr(a, f.name), getattr(b, f.name)) for f in fields(a))
    return a == b or (a != a and b != b)
