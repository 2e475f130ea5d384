"""The stages of a step as pure functions, used by the simulator and by `verify`.

observed --predict--> p_wall --fuse--> fused --measure--> metrics      (what is known)
look_around --> outcome_of, decide, events_of                          (what follows: `make_step`)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np

from mapreplay import mapping, scores
from mapreplay.config import EpisodeConfig, MapKind
from mapreplay.errors import MapreplayError
from mapreplay.grid import UNKNOWN, Cell, Grid, Mask, Quantized
from mapreplay.kernels import SQRT2
from mapreplay.planners import Choice, Planner
from mapreplay.planning import Paths, Situation, frontier, shortest_paths
from mapreplay.predictors import Predictor
from mapreplay.randomness import Draws, Purpose
from mapreplay.sensor import Hits
from mapreplay.step import (
    MAX_RIVALS,
    Candidate,
    Cells,
    Decision,
    EpisodeHeader,
    Event,
    EventKind,
    Mode,
    Outcome,
    Step,
    StepMetrics,
)


@dataclass(frozen=True)
class Travelled:
    """The distance travelled, as an integer pair, so that equal paths have equal lengths."""

    straight: int = 0
    diagonal: int = 0

    def to(self, before: Cell, after: Cell) -> Travelled:
        """The distance after a move from one cell to another.

        Our moves are between neighbours; for external logs with larger moves, the shortest path
        over open space is added.
        """
        rows, cols = abs(after.row - before.row), abs(after.col - before.col)
        diagonal = min(rows, cols)
        return Travelled(self.straight + max(rows, cols) - diagonal, self.diagonal + diagonal)

    def metres(self, resolution: float) -> float:
        """The distance in metres; `resolution` is in metres per cell."""
        return (self.straight + self.diagonal * SQRT2) * resolution


@dataclass(frozen=True, eq=False)
class Past:
    """The state that a step takes over from the steps before."""

    index: int
    """Index of the step."""
    agent: Cell
    """Position of the agent at the step."""
    travelled: Travelled
    observed: Grid
    """int8[H, W], before the step's scan."""
    previous_target: Cell | None
    sealed: bool
    """The step before was in fail-safe mode."""
    corrected: bool
    """The target of correct coverage was reached before."""
    choice: str | None = None
    """The predictor's last reported choice; see `mapreplay.predictors.Choosing`."""

    @classmethod
    def at_start(cls, header: EpisodeHeader) -> Past:
        """Before the first step: nothing is known."""
        nothing: Grid = np.full(header.floor_plan.shape, UNKNOWN, np.int8)
        return cls(0, header.start, Travelled(), nothing, None, sealed=False, corrected=False)

    def after(self, step: Step, agent: Cell, header: EpisodeHeader) -> Past:
        """Before the step that follows `step`, with the agent moved to `agent`."""
        config = header.config
        right = step.metrics.correct_coverage(config.build)
        chosen = chosen_at(step)
        return Past(
            index=self.index + 1,
            agent=agent,
            travelled=self.travelled.to(self.agent, agent),
            observed=step.observed,
            previous_target=step.decision.target if step.decision else None,
            sealed=step.mode is Mode.FAIL_SAFE,
            corrected=self.corrected or right >= config.correct_coverage,
            choice=self.choice if chosen is None else chosen,
        )


def chosen_at(step: Step) -> str | None:
    """The choice that the predictor reported at `step`; None if there is no new one."""
    said = [event.text for event in step.events if event.kind is EventKind.PREDICTOR]
    return said[-1] if said else None


def predict(header: EpisodeHeader, predictor: Predictor, observed: Grid) -> Quantized | None:
    """The prediction in its quantized form, as used and logged.

    Raises:
        MapreplayError: the predictor returned no valid P(occupied) of that map.
    """
    raw = predictor.predict(observed)
    if raw is None:
        return None
    name = predictor.identity.name
    if raw.shape != observed.shape:
        raise MapreplayError(
            f"predictor {name!r} returned shape {raw.shape} for a map of {observed.shape}"
        )
    try:
        return mapping.quantize(raw, header.config.prediction_dtype)
    except ValueError as error:
        raise MapreplayError(f"predictor {name!r}: {error}") from None


@dataclass(frozen=True, eq=False)
class Surroundings:
    """The maps of a step, and the targets that the agent can choose."""

    mode: Mode
    plan_map: Grid
    build_map: Grid
    paths: Paths
    frontier: Cells


def look_around(config: EpisodeConfig, agent: Cell, observed: Grid, fused: Grid) -> Surroundings:
    """Find the frontier on the configured maps, or on the observed map as described here.

    If the observed planning map has no frontier of the fused target map, the frontier of the
    observed map is used. When fused/fused finds none, the agent is sealed in; with the fail-safe it
    plans on observations until the frontier is back.
    """
    maps = {MapKind.OBSERVED: observed, MapKind.FUSED: fused}
    plan_map, build_map = maps[config.plan_on], maps[config.build]
    paths = shortest_paths(plan_map, agent)
    cells = frontier(paths, build_map)
    if len(cells):
        return Surroundings(Mode.NORMAL, plan_map, build_map, paths, cells)
    if config.plan_on is MapKind.OBSERVED:
        return Surroundings(Mode.NORMAL, plan_map, observed, paths, frontier(paths, observed))
    if config.fail_safe and config.build is MapKind.FUSED:
        paths = shortest_paths(observed, agent)
        cells = frontier(paths, observed)
        if len(cells):
            return Surroundings(Mode.FAIL_SAFE, observed, observed, paths, cells)
    return Surroundings(Mode.NORMAL, plan_map, build_map, paths, cells)


def outcome_of(
    header: EpisodeHeader, index: int, metrics: StepMetrics, view: Surroundings
) -> Outcome | None:
    """The outcome of an episode that ends at step `index`, or None if it continues."""
    config = header.config
    if metrics.coverage(config.build) >= config.coverage:
        return Outcome.MAPPED
    if index >= header.max_steps:
        return Outcome.OUT_OF_STEPS
    if not len(view.frontier):
        return Outcome.SEALED_IN
    return None


def events_of(
    header: EpisodeHeader,
    past: Past,
    metrics: StepMetrics,
    view: Surroundings,
    outcome: Outcome | None,
    choice: str | None = None,
) -> tuple[Event, ...]:
    """The events of a step; `choice` is the predictor's choice."""
    config, events = header.config, []
    if choice is not None and choice != past.choice:
        events.append(Event(EventKind.PREDICTOR, choice))
    if (view.mode is Mode.FAIL_SAFE or outcome is Outcome.SEALED_IN) and not past.sealed:
        events.append(Event(EventKind.SEALED_IN, "the fused map has no frontier within reach"))
    if past.sealed and view.mode is Mode.NORMAL and outcome is not Outcome.SEALED_IN:
        events.append(Event(EventKind.RELEASED, "the fused map has a frontier again"))
    right = metrics.correct_coverage(config.build)
    if right >= config.correct_coverage and not past.corrected:
        events.append(
            Event(EventKind.CORRECT_REACHED, f"correct coverage {right:.4f} of the built map")
        )
    if outcome is Outcome.MAPPED:
        covered = metrics.coverage(config.build)
        events.append(Event(EventKind.TARGET_REACHED, f"coverage {covered:.4f} of the built map"))
    if outcome is not None:
        events.append(Event(EventKind.OUTCOME, f"{outcome} after {past.index} steps"))
    return tuple(events)


def ask(
    header: EpisodeHeader,
    planner: Planner,
    past: Past,
    observed: Grid,
    p_wall: Quantized | None,
    view: Surroundings,
) -> Choice:
    """The planner's rating of the frontier of `view`.

    Raises:
        MapreplayError: the planner's answer does not fit the frontier.
    """
    config = header.config
    on_fused = config.plan_on is MapKind.FUSED and view.mode is Mode.NORMAL
    choice = planner.choose(
        Situation(
            agent=past.agent,
            plan_map=view.plan_map,
            build_map=view.build_map,
            observed=observed,
            prediction=p_wall if on_fused else None,
            frontier=view.frontier,
            paths=view.paths,
            previous_target=past.previous_target,
            draws=Draws(config.seed, Purpose.PLANNER, past.index),
            sensor=header.sensor,
        )
    )
    count = len(view.frontier)
    if not (0 <= choice.index < count and len(choice.utility) == len(choice.reward) == count):
        raise MapreplayError(
            f"planner {config.planner!r} chose number {choice.index} of {count} frontier cells "
            f"and rated {len(choice.utility)}"
        )
    return choice


def decide(
    header: EpisodeHeader,
    planner: Planner,
    past: Past,
    observed: Grid,
    p_wall: Quantized | None,
    view: Surroundings,
) -> Decision:
    """The planner's decision, with the best alternatives.

    Raises:
        MapreplayError: the planner's answer does not fit the frontier.
    """
    choice = ask(header, planner, past, observed, p_wall, view)
    ranking = [choice.index]
    order = np.lexsort((view.paths.costs(view.frontier), -choice.utility))[: MAX_RIVALS + 1]
    ranking += [i for i in order.tolist() if i != choice.index][:MAX_RIVALS]
    candidates = _candidates(view, choice, ranking)
    return Decision(
        chosen=candidates[0],
        path=view.paths.to(candidates[0].cell),
        mode=view.mode,
        rivals=candidates[1:],
        random_draw=choice.random_draw,
    )


def _candidates(view: Surroundings, choice: Choice, indices: list[int]) -> tuple[Candidate, ...]:
    """The frontier cells with the given indices, and their ratings."""
    cells = view.frontier[indices]
    rows, cols = cells[:, 0], cells[:, 1]
    return tuple(
        Candidate(Cell(*cell), *rest)
        for cell, *rest in zip(
            cells.tolist(),
            choice.utility[indices].tolist(),
            choice.reward[indices].tolist(),
            view.paths.straight[rows, cols].tolist(),
            view.paths.diagonal[rows, cols].tolist(),
            strict=True,
        )
    )


@dataclass(frozen=True, eq=False)
class Knowledge:
    """What is known at a step, before anything is decided."""

    hits: Hits
    observed: Grid
    p_wall: Quantized | None
    """The prediction as used and logged."""
    fused: Grid
    metrics: StepMetrics
    choice: str | None = None
    """The predictor's reported choice; see `mapreplay.predictors.Choosing`."""


Decide: TypeAlias = Callable[[Surroundings], Decision | None]
"""Makes a decision; not called at the end of the episode."""


def make_step(header: EpisodeHeader, past: Past, known: Knowledge, decide: Decide) -> Step:
    """Make the step from what is known: frontier, outcome, decision and events."""
    view = look_around(header.config, past.agent, known.observed, known.fused)
    outcome = outcome_of(header, past.index, known.metrics, view)
    return Step(
        index=past.index,
        agent=past.agent,
        hits=known.hits,
        observed=known.observed,
        p_wall=known.p_wall,
        fused=known.fused,
        frontier=view.frontier,
        decision=None if outcome else decide(view),
        metrics=known.metrics,
        events=events_of(header, past, known.metrics, view, outcome, known.choice),
        outcome=outcome,
        profile=None,
    )


_NO_SCORE: Final = scores.MapScore(*[float("nan")] * 4)
_NO_PREDICTION: Final = scores.PredictionScore(*[float("nan")] * 2)


def measure(
    header: EpisodeHeader,
    observed: Grid,
    p_wall: Quantized | None,
    fused: Grid,
    path_length: float,
    unknown_as: scores.UnknownAs = scores.UnknownAs.FREE,
    region: Mask | None = None,
) -> StepMetrics:
    """All scores of a step, over the cells of `region` (bool[H, W]; the explorable ones by
    default); see `StepMetrics`.
    """
    truth = header.floor_plan.cells
    region = header.explorable if region is None else region
    observed_counts = scores.tally(observed, truth, region)
    observed_score = scores.score(observed_counts, unknown_as)
    fused_counts, built_score = observed_counts, observed_score
    thresholded_score = raw_score = _NO_SCORE
    everywhere = unobserved = _NO_PREDICTION
    if p_wall is not None:
        fused_counts = scores.tally(fused, truth, region)
        if header.config.build is MapKind.FUSED:
            built_score = scores.score(fused_counts, unknown_as)
        sure = mapping.threshold(p_wall, header.thresholds)
        thresholded_score = scores.score(scores.tally(sure, truth, region), unknown_as)
        raw = mapping.raw_classes(p_wall)
        raw_score = scores.score(scores.tally(raw, truth, region), unknown_as)
        everywhere = scores.calibration(p_wall, truth, region)
        unobserved = scores.calibration(p_wall, truth, region & (observed == UNKNOWN))
    seen, known = scores.coverage(observed_counts), scores.coverage(fused_counts)

    def four(score: scores.MapScore) -> tuple[float, float, float, float]:
        return score.precision, score.recall, score.f1, score.iou

    return StepMetrics(
        path_length,
        seen.known,
        known.known,
        seen.correct,
        known.correct,
        *four(built_score),
        *four(observed_score),
        *four(thresholded_score),
        *four(raw_score),
        everywhere.brier,
        everywhere.log_loss,
        unobserved.brier,
        unobserved.log_loss,
    )
