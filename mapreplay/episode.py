"""The exploration loop: sense, accumulate, predict, fuse, score, plan, move.

for step in run_episode(prepare_episode(config, floor_plan)): ...
record(episode, EpisodeWriter(path, episode.header), ...)
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from importlib.metadata import version
from itertools import pairwise
from time import perf_counter_ns
from typing import Final, Protocol

import numpy as np

from mapreplay import mapping
from mapreplay.config import EpisodeConfig
from mapreplay.floorplan import FloorPlan, explorable
from mapreplay.grid import FREE, Mask
from mapreplay.planners import RULES, Planner, load_planner
from mapreplay.predictors import Predictor, choice_of, registered_predictor
from mapreplay.sensor import accumulate, sense
from mapreplay.stages import Knowledge, Past, decide, make_step, measure, predict
from mapreplay.step import EpisodeHeader, Step, StepProfile

STEPS_PER_FREE_CELL: Final = 4


@dataclass(frozen=True, eq=False)
class Episode:
    """Everything that `run_episode` needs."""

    header: EpisodeHeader
    planner: Planner
    predictor: Predictor


def prepare_episode(
    config: EpisodeConfig,
    floor_plan: FloorPlan,
    planner: Planner | None = None,
    predictor: Predictor | None = None,
) -> Episode:
    """Fill in what the configuration leaves to the floor plan, and load what it names.

    A planner or predictor given here is used instead of loading the one registered by that name;
    weights of a file are loaded with `mapreplay.predictors.load_predictor` and given here.

    Raises:
        FloorPlanError: the start is not a free cell.
        PluginError, WeightsError: the planner or predictor cannot be loaded.
    """
    start = floor_plan.check_start(config.start_cell)
    region = explorable(floor_plan.cells, start)
    predictor = predictor or registered_predictor(config.predictor)
    header = EpisodeHeader(
        config=config,
        floor_plan=floor_plan,
        start=start,
        max_steps=budget(config, floor_plan, region),
        predictor=predictor.identity,
        versions=versions(),
    )
    return Episode(header, planner or load_planner(config.planner), predictor)


def budget(config: EpisodeConfig, floor_plan: FloorPlan, region: Mask) -> int:
    """Moves that are allowed; `region` (bool[H, W]) are the explorable cells."""
    free_cells = int((region & (floor_plan.cells == FREE)).sum())
    return config.max_steps or STEPS_PER_FREE_CELL * free_cells


@lru_cache(maxsize=1)
def versions() -> tuple[tuple[str, str], ...]:
    """(library, version) of what a result depends on, and the planners' rules, sorted."""
    libraries = ((name, version(name)) for name in ("mapreplay", "numba", "numpy", "torch"))
    return tuple(sorted([*libraries, ("rules", RULES)]))


def run_episode(episode: Episode, past: Past | None = None) -> Iterator[Step]:
    """Explore `episode`'s floor plan; yields a step for every pose, the first at the start.

    The last step has an outcome and no decision. With a `past` the first is the step after it.

    Raises:
        MapreplayError: the predictor or planner returned something impossible.
    """
    header, sensor = episode.header, episode.header.sensor
    plan = header.floor_plan
    past = past or Past.at_start(header)
    last: Step | None = None
    while True:
        clock = [perf_counter_ns()]
        hits = sense(plan.cells, past.agent, sensor)
        observed = accumulate(past.observed, past.agent, hits, sensor)
        # Where nothing new was seen, all that follows from the observed map is what it was.
        same = last if last and np.array_equal(last.observed, observed) else None
        clock.append(perf_counter_ns())
        p_wall = same.p_wall if same else predict(header, episode.predictor, observed)
        choice = past.choice if same else choice_of(episode.predictor, observed)
        clock.append(perf_counter_ns())
        fused = same.fused if same else mapping.fuse(observed, p_wall, header.thresholds)
        clock.append(perf_counter_ns())
        path_length = past.travelled.metres(plan.resolution)
        if same:
            metrics = replace(same.metrics, path_length=path_length)
        else:
            metrics = measure(header, observed, p_wall, fused, path_length)
        clock.append(perf_counter_ns())
        known = Knowledge(hits, observed, p_wall, fused, metrics, choice)
        step = make_step(
            header, past, known, partial(decide, header, episode.planner, past, observed, p_wall)
        )
        clock.append(perf_counter_ns())
        profile = StepProfile(*(after - before for before, after in pairwise(clock)))
        step = replace(step, profile=profile)
        yield step
        last = step
        if step.decision is None:
            return
        past = past.after(step, step.decision.next_cell, header)


class StepSink(Protocol):
    """What steps go to: the writer of a log, a table of scalars, a live view."""

    def add(self, step: Step) -> object:
        """Take the next step."""
        ...


def recorded(episode: Episode | Iterable[Step], *sinks: StepSink) -> Iterator[Step]:
    """Run an episode, and yield every step when every sink has taken it, in order.

    It is `record` for callers that do something between the steps, such as telling how far it is.

    Args:
        episode: A prepared one, or the steps of one, such as a log's.
        sinks: Closing them is their owner's business (``with EpisodeWriter(...) as writer``).

    Raises:
        MapreplayError: the predictor or planner returned something impossible, or a sink failed.
    """
    for step in run_episode(episode) if isinstance(episode, Episode) else episode:
        for sink in sinks:
            sink.add(step)
        yield step


def record(episode: Episode | Iterable[Step], *sinks: StepSink) -> Step:
    """Run an episode, and give every step to every sink, in order; returns the last step.

    Args:
        episode: As for `recorded`.
        sinks: As for `recorded`.

    Raises:
        MapreplayError: the predictor or planner returned something impossible, or a sink failed.
        ValueError: there are no steps.
    """
    last = deque(recorded(episode, *sinks), maxlen=1)
    if not last:
        raise ValueError("an episode without steps")
    return last[0]
