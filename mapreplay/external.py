"""Episodes of external simulators and of real robots, converted to steps for the log.

Only poses and observed maps are needed. A true map, predictions, scans and targets are optional:

======================  ==================================================================
missing                 consequence
======================  ==================================================================
the true map            unknown everywhere, nothing is explorable, scores are NaN
a prediction            no ``/map/p_wall``; the fused map is the observed one
a scan                  no ``/scan``
a target                no ``/decision`` and ``/plan``; nothing to explain
======================  ==================================================================
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, SupportsIndex

import numpy as np
import numpy.typing as npt

from mapreplay import mapping
from mapreplay.config import EpisodeConfig
from mapreplay.episode import versions
from mapreplay.errors import UsageError
from mapreplay.floorplan import FloorPlan
from mapreplay.grid import FREE, UNKNOWN, Cell, Grid, Origin, check_grid
from mapreplay.planning import shortest_paths
from mapreplay.sensor import Hits
from mapreplay.stages import Travelled, measure
from mapreplay.step import (
    NO_BUDGET,
    Candidate,
    Cells,
    Decision,
    EpisodeHeader,
    Event,
    EventKind,
    Mode,
    Outcome,
    PredictorIdentity,
    Step,
)

NO_PREDICTOR = PredictorIdentity("none", "")


def unknown_floor_plan(
    name: str, shape: tuple[int, int], resolution: float, origin: tuple[float, float] = (0.0, 0.0)
) -> FloorPlan:
    """A floor plan of unknown cells: `shape` is (height, width), `resolution` in metres per cell.

    Raises:
        FloorPlanError: the name, size or resolution is invalid.
    """
    cells = np.full(shape, UNKNOWN, np.int8)
    return FloorPlan(name, cells, resolution, Origin(*origin), has_truth=False)


class ExternalEpisode:
    """Turns what an external simulator knows at each step into a `Step` for the log.

    ::

        episode = ExternalEpisode(unknown_floor_plan("lab", (80, 60), 0.05), start, planner="mine")
        with EpisodeWriter(Path("lab.mcap"), episode.header) as writer:
            writer.add(episode.step(agent, observed))
    """

    def __init__(
        self,
        floor_plan: FloorPlan,
        start: tuple[int, int],
        planner: str,
        simulator: str = "external simulator",
        predictor: PredictorIdentity = NO_PREDICTOR,
        max_steps: int = NO_BUDGET,
        **config: Any,
    ) -> None:
        """Describe the episode.

        Args:
            floor_plan: The true map, or an `unknown_floor_plan`.
            start: (row, col) of the first pose, integers.
            planner: Name of the planner.
            simulator: Name of the simulator or robot.
            predictor: Name of the predictor and hash of its weights.
            max_steps: The step budget; unlimited by default.
            **config: Further keys of `EpisodeConfig`, such as ``seed`` or ``coverage``.

        Raises:
            ConfigError: a key is unknown or out of range.
            FloorPlanError: the start is not free in the true map.
            UsageError: the start is outside, or not in whole numbers.
        """
        values = {"planner": planner, "predictor": predictor.name, "max_steps": max_steps}
        self.header = EpisodeHeader(
            config=EpisodeConfig.of(values | config),
            floor_plan=floor_plan,
            start=floor_plan.check_start(_cell("start", start, floor_plan.shape)),
            max_steps=max_steps,
            predictor=predictor,
            versions=versions(),
            simulator=simulator,
        )
        self._index = 0
        self._agent = self.header.start
        self._travelled = Travelled()

    def step(
        self,
        agent: tuple[int, int],
        observed: Grid,
        *,
        p_wall: npt.NDArray[np.floating] | None = None,
        fused: Grid | None = None,
        hits: Hits | None = None,
        target: tuple[int, int] | None = None,
        frontier: Cells | None = None,
        outcome: str | None = None,
    ) -> Step:
        """Create the next step; steps are numbered from 0 and stamped 0.1 s apart.

        Args:
            agent: (row, col), integers.
            observed: int8[H, W] of -1, 0, 100.
            p_wall: float[H, W], P(occupied) in [0, 1].
            fused: int8[H, W]; by default the observed map completed by `p_wall`.
            hits: int16[rays], see `mapreplay.sensor`.
            target: (row, col) of the agent's target; None at the last step.
            frontier: int32[n, 2], the cells that it chose from.
            outcome: ``mapped``, ``sealed_in`` or ``out_of_steps`` at the last step.

        Raises:
            UsageError: a map has a wrong size or wrong values, a cell is outside or not two
                integers, the first pose is not the start, or the outcome is unknown.
        """
        header = self.header
        cell = self._check_cell("agent", agent)
        if self._index == 0 and cell != header.start:
            raise UsageError(
                f"agent {tuple(cell)} at step 0: the episode starts at {tuple(header.start)}; "
                "give the first pose as start"
            )
        self._check_map("observed", observed)
        quantized = None
        if p_wall is not None:
            if not isinstance(p_wall, np.ndarray) or p_wall.dtype.kind not in "fiu":
                raise UsageError(f"p_wall: expected float{list(observed.shape)} of NumPy")
            if p_wall.shape != observed.shape:
                raise UsageError(f"p_wall: shape {p_wall.shape} on a map of {observed.shape}")
            try:
                quantized = mapping.quantize(p_wall, header.config.prediction_dtype)
            except ValueError as error:
                raise UsageError(f"p_wall: {error}") from None
        if fused is None:
            fused = mapping.fuse(observed, quantized, header.thresholds)
        self._check_map("fused", fused)
        self._travelled = self._travelled.to(self._agent, cell)
        length = self._travelled.metres(header.floor_plan.resolution)
        ended = None if outcome is None else _outcome(outcome)
        step = Step(
            index=self._index,
            agent=cell,
            hits=self._check_hits(hits),
            observed=observed,
            p_wall=quantized,
            fused=fused,
            frontier=self._check_frontier(frontier),
            decision=None if target is None or ended else self._decision(cell, target, fused),
            metrics=measure(header, observed, quantized, fused, length),
            events=_ending(ended, self._index),
            outcome=ended,
            profile=None,
        )
        self._index += 1
        self._agent = cell
        return step

    def _decision(self, agent: Cell, target: tuple[int, int], plan_map: Grid) -> Decision:
        goal = self._check_cell("target", target)
        path = np.array([agent, goal], np.int32)
        way = Travelled().to(agent, goal)
        straight, diagonal = way.straight, way.diagonal
        if plan_map[agent] == FREE:
            paths = shortest_paths(plan_map, agent)
            if paths.reaches(goal) and goal != agent:
                path = paths.to(goal)
                straight, diagonal = int(paths.straight[goal]), int(paths.diagonal[goal])
        unrated = float("nan")
        chosen = Candidate(goal, unrated, unrated, straight, diagonal)
        return Decision(chosen, path, Mode.NORMAL, (), None)

    def _check_cell(self, what: str, cell: Sequence[SupportsIndex | float]) -> Cell:
        return _cell(what, cell, self.header.floor_plan.shape)

    def _check_map(self, what: str, cells: Grid) -> None:
        problem = check_grid(cells) if isinstance(cells, np.ndarray) else f"got {type(cells)}"
        if problem is None and cells.shape != self.header.floor_plan.shape:
            problem = f"shape {cells.shape} on a floor plan of {self.header.floor_plan.shape}"
        if problem is not None:
            raise UsageError(f"{what}: {problem}")

    def _check_hits(self, hits: Hits | None) -> Hits:
        if hits is None:
            return np.empty(0, np.int16)
        config, given = self.header.config, np.asarray(hits)
        if given.shape != (config.rays,) or given.dtype.kind not in "iu":
            raise UsageError(
                f"hits: expected {config.rays} whole numbers, one for each ray, got "
                f"{given.dtype}{list(given.shape)}"
            )
        if given.min() < 0 or given.max() > config.reach:
            raise UsageError(f"hits: should be 0 to {config.reach}, the reach in cells")
        return given.astype(np.int16)

    def _check_frontier(self, frontier: Cells | None) -> Cells:
        if frontier is None or not len(frontier):
            return np.empty((0, 2), np.int32)
        given, shape = np.asarray(frontier), self.header.floor_plan.shape
        if given.ndim != 2 or given.shape[1] != 2 or given.dtype.kind not in "iu":
            raise UsageError(
                f"frontier: expected (row, col) in whole numbers, got {given.dtype}"
                f"{list(given.shape)}"
            )
        outside = given[((given < 0) | (given >= shape)).any(axis=1)]
        if len(outside):
            raise UsageError(
                f"frontier: {tuple(outside[0].tolist())} lies outside of {shape[0]} x {shape[1]}"
            )
        return given.astype(np.int32)


def _cell(what: str, cell: Sequence[SupportsIndex | float], shape: tuple[int, int]) -> Cell:
    """Check a cell of a map of `shape`; nothing is truncated or rounded.

    Raises:
        UsageError: it is not two whole numbers, or outside.
    """
    try:
        row, col = (_whole(value) for value in cell)
    except (TypeError, ValueError):
        raise UsageError(f"{what} {cell!r}: expected (row, col), two whole numbers") from None
    height, width = shape
    if not (0 <= row < height and 0 <= col < width):
        raise UsageError(f"{what} ({row}, {col}) lies outside of {height} x {width}")
    return Cell(row, col)


def _whole(value: object) -> int:
    """An integer of Python or NumPy, or a float with an integer value, such as 5.0.

    Raises:
        ValueError: it is not an integer.
    """
    if isinstance(value, int | np.integer) and not isinstance(value, bool):
        return int(value)
    if isinstance(value, float | np.floating) and float(value).is_integer():
        return int(value)
    raise ValueError(f"{value!r} is not a whole number")


def _outcome(name: str) -> Outcome:
    try:
        return Outcome(name)
    except ValueError:
        raise UsageError(f"outcome {name!r}: should be {', '.join(Outcome)}") from None


def _ending(outcome: Outcome | None, index: int) -> tuple[Event, ...]:
    return () if outcome is None else (Event(EventKind.OUTCOME, f"{outcome} after {index} steps"),)
