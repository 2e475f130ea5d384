"""The exploration loop: sense, accumulate, predict, fuse, score, plan, move."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import version
from itertools import pairwise
from time import perf_counter_ns
from typing import Final

import numpy as np

from mapreplay import mapping, scores
from mapreplay.config import EpisodeConfig, MapKind
from mapreplay.errors import MapreplayError
from mapreplay.floorplan import FloorPlan, explorable
from mapreplay.grid import FREE, UNKNOWN, Cell, Grid, Mask, Quantized
from mapreplay.kernels import SQRT2
from mapreplay.planners import Choice, Planner, load_planner
from mapreplay.planning import Paths, Situation, frontier, shortest_paths
from mapreplay.predictors import Predictor, load_predictor
from mapreplay.randomness import Draws, Purpose
from mapreplay.sensor import accumulate, sense
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
    StepProfile,
)

STEPS_PER_FREE_CELL: Final = 4


@dataclass(frozen=True, eq=False)
class Episode:
    """Everything that `run_episode` needs."""

    header: EpisodeHeader
    planner: Planner
    predictor: Predictor
    explorable: Mask
    """bool[H, W], from the start."""


def prepare_episode(
    config: EpisodeConfig,
    floor_plan: FloorPlan,
    planner: Planner | None = None,
    predictor: Predictor | None = None,
) -> Episode:
    """Fill in what the configuration leaves to the floor plan, and load what it names.

    A planner or predictor given here is used instead of loading the one by that name.

    Raises:
        FloorPlanError: the start is not a free cell.
        PluginError, WeightsError: the planner or predictor cannot be loaded.
    """
    start = floor_plan.check_start(config.start_cell)
    region = explorable(floor_plan.cells, start)
    free_cells = int((region & (floor_plan.cells == FREE)).sum())
    predictor = predictor or load_predictor(config.predictor)
    header = EpisodeHeader(
        config=config,
        floor_plan=floor_plan,
        start=start,
        max_steps=config.max_steps or STEPS_PER_FREE_CELL * free_cells,
        predictor=predictor.identity,
        versions=_versions(),
    )
    return Episode(header, planner or load_planner(config.planner), predictor, region)


@lru_cache(maxsize=1)
def _versions() -> tuple[tuple[str, str], ...]:
    return tuple((name, version(name)) for name in ("mapreplay", "numba", "numpy", "torch"))


def run_episode(episode: Episode) -> Iterator[Step]:
    """Explore `episode`'s floor plan; yields a step for every pose, the first at the start.

    The last step has an outcome and no decision.

    Raises:
        MapreplayError: the predictor or planner returned something impossible.
    """
    header, sensor = episode.header, episode.header.sensor
    config, truth = header.config, header.floor_plan.cells
    agent, straight, diagonal = header.start, 0, 0
    observed: Grid = np.full(truth.shape, UNKNOWN, np.int8)
    previous: Decision | None = None
    sealed = corrected = False
    for index in range(header.max_steps + 1):
        clock = [perf_counter_ns()]
        hits = sense(truth, agent, sensor)
        observed = accumulate(observed, agent, hits, sensor)
        clock.append(perf_counter_ns())
        p_wall = _predict(episode, observed)
        clock.append(perf_counter_ns())
        fused = mapping.fuse(observed, p_wall, header.thresholds)
        clock.append(perf_counter_ns())
        path_length = (straight + diagonal * SQRT2) * header.floor_plan.resolution
        metrics = measure(header, episode.explorable, observed, p_wall, fused, path_length)
        clock.append(perf_counter_ns())
        view = look_around(config, agent, observed, fused)
        covered = metrics.coverage(config.build)
        outcome, decision = None, None
        if covered >= config.coverage:
            outcome = Outcome.MAPPED
        elif index == header.max_steps:
            outcome = Outcome.OUT_OF_STEPS
        elif not len(view.frontier):
            outcome = Outcome.SEALED_IN
        else:
            decision = decide(episode, index, agent, observed, p_wall, view, previous)
        clock.append(perf_counter_ns())

        events = []
        if (view.mode is Mode.FAIL_SAFE or outcome is Outcome.SEALED_IN) and not sealed:
            events.append(Event(EventKind.SEALED_IN, "the fused map has no frontier within reach"))
        if sealed and view.mode is Mode.NORMAL and outcome is not Outcome.SEALED_IN:
            events.append(Event(EventKind.RELEASED, "the fused map has a frontier again"))
        sealed = view.mode is Mode.FAIL_SAFE
        right = metrics.correct_coverage(config.build)
        if right >= config.correct_coverage and not corrected:
            corrected = True
            events.append(
                Event(EventKind.CORRECT_REACHED, f"correct coverage {right:.4f} of the built map")
            )
        if outcome is Outcome.MAPPED:
            events.append(
                Event(EventKind.TARGET_REACHED, f"coverage {covered:.4f} of the built map")
            )
        if outcome is not None:
            events.append(Event(EventKind.OUTCOME, f"{outcome} after {index} steps"))
        yield Step(
            index=index,
            agent=agent,
            hits=hits,
            observed=observed,
            p_wall=p_wall,
            fused=fused,
            frontier=view.frontier,
            decision=decision,
            metrics=metrics,
            events=tuple(events),
            outcome=outcome,
            profile=StepProfile(*(after - before for before, after in pairwise(clock))),
        )
        if decision is None:
            return
        if decision.next_cell.row != agent.row and decision.next_cell.col != agent.col:
            diagonal += 1
        else:
            straight += 1
        agent, previous = decision.next_cell, decision


def _predict(episode: Episode, observed: Grid) -> Quantized | None:
    raw = episode.predictor.predict(observed)
    if raw is None:
        return None
    name = episode.predictor.identity.name
    if raw.shape != observed.shape:
        raise MapreplayError(
            f"predictor {name!r} returned shape {raw.shape} for a map of {observed.shape}"
        )
    try:
        return mapping.quantize(raw, episode.header.config.prediction_dtype)
    except ValueError as error:
        raise MapreplayError(f"predictor {name!r}: {error}") from None


@dataclass(frozen=True, eq=False)
class View:
    """What the agent can go for at a step, and on which maps."""

    mode: Mode
    plan_map: Grid
    paths: Paths
    frontier: Cells


def look_around(config: EpisodeConfig, agent: Cell, observed: Grid, fused: Grid) -> View:
    """The frontier of the configured maps, or of the observed ones where that is the rule.

    When planning on observations finds no frontier of the fused map, that of the observed
    map is taken. When fused/fused finds none, the agent is sealed in; with the fail-safe it
    plans on observations until the frontier is back.
    """
    maps = {MapKind.OBSERVED: observed, MapKind.FUSED: fused}
    plan_map = maps[config.plan_on]
    paths = shortest_paths(plan_map, agent)
    cells = frontier(paths, maps[config.build])
    if len(cells):
        return View(Mode.NORMAL, plan_map, paths, cells)
    if config.plan_on is MapKind.OBSERVED:
        return View(Mode.NORMAL, plan_map, paths, frontier(paths, observed))
    if config.fail_safe and config.build is MapKind.FUSED:
        paths = shortest_paths(observed, agent)
        cells = frontier(paths, observed)
        if len(cells):
            return View(Mode.FAIL_SAFE, observed, paths, cells)
    return View(Mode.NORMAL, plan_map, paths, cells)


def decide(
    episode: Episode,
    index: int,
    agent: Cell,
    observed: Grid,
    p_wall: Quantized | None,
    view: View,
    previous: Decision | None,
) -> Decision:
    """Ask the planner, and write down what it chose and what it left.

    Raises:
        MapreplayError: the planner's answer does not fit the frontier.
    """
    config = episode.header.config
    on_fused = config.plan_on is MapKind.FUSED and view.mode is Mode.NORMAL
    situation = Situation(
        agent=agent,
        plan_map=view.plan_map,
        observed=observed,
        prediction=p_wall if on_fused else None,
        frontier=view.frontier,
        paths=view.paths,
        previous_target=previous.target if previous else None,
        draws=Draws(config.seed, Purpose.PLANNER, index),
        sensor=episode.header.sensor,
    )
    choice = episode.planner.choose(situation)
    count = len(view.frontier)
    if not (0 <= choice.index < count and len(choice.utility) == len(choice.reward) == count):
        raise MapreplayError(
            f"planner {config.planner!r} chose number {choice.index} of {count} frontier cells "
            f"and rated {len(choice.utility)}"
        )

    ranking = [choice.index]
    order = np.lexsort((situation.costs, -choice.utility))[: MAX_RIVALS + 1]
    ranking += [i for i in order.tolist() if i != choice.index][:MAX_RIVALS]
    candidates = _candidates(view, choice, ranking)
    return Decision(
        chosen=candidates[0],
        path=view.paths.to(candidates[0].cell),
        mode=view.mode,
        rivals=candidates[1:],
        random_draw=choice.random_draw,
    )


def _candidates(view: View, choice: Choice, indices: list[int]) -> tuple[Candidate, ...]:
    """The frontier cells of those numbers, with how they were rated."""
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


_NO_SCORE: Final = scores.MapScore(*[float("nan")] * 4)
_NO_CALIBRATION: Final = scores.Calibration(*[float("nan")] * 2)


def measure(
    header: EpisodeHeader,
    region: Mask,
    observed: Grid,
    p_wall: Quantized | None,
    fused: Grid,
    path_length: float,
    unknown_as: scores.UnknownAs = scores.UnknownAs.FREE,
) -> StepMetrics:
    """All scores of a step, over the cells of `region` (bool[H, W]); see `StepMetrics`."""
    truth = header.floor_plan.cells
    observed_counts = scores.tally(observed, truth, region)
    observed_score = scores.score(observed_counts, unknown_as)
    fused_counts, built_score = observed_counts, observed_score
    thresholded_score = raw_score = _NO_SCORE
    everywhere = unobserved = _NO_CALIBRATION
    if p_wall is not None:
        fused_counts = scores.tally(fused, truth, region)
        if header.config.build is MapKind.FUSED:
            built_score = scores.score(fused_counts, unknown_as)
        sure = mapping.threshold(p_wall, header.thresholds)
        thresholded_score = scores.score(scores.tally(sure, truth, region), unknown_as)
        raw = mapping.raw_classes(p_wall)
        raw_score = scores.score(scores.tally(raw, truth, region), unknown_as)
        p, step = mapping.dequantize(p_wall), mapping.quantum(p_wall)
        everywhere = scores.calibration(p, truth, region, step)
        unobserved = scores.calibration(p, truth, region & (observed == UNKNOWN), step)
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
