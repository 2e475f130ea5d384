"""The paper's prediction figure: F1 over the number of observations, and calibration with it.

An observation is one scan (all rays) from one cell, and the observations are those of a walk of
Nearest Frontier on observations, from the default start to 98 % coverage: what an agent sees that
explores, and the same for every predictor. A walk that has ended keeps its last values. Cells
that count are the explorable ones.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from mapreplay import mapping, scores
from mapreplay.analysis.metrics.calibration import PredictionCounts, count_cells, no_cells
from mapreplay.config import EpisodeConfig, MapKind, PredictionDtype
from mapreplay.episode import prepare_episode, run_episode
from mapreplay.errors import MapreplayError
from mapreplay.files.whole import whole_path
from mapreplay.floorplan import FloorPlan
from mapreplay.grid import Grid, Mask
from mapreplay.mapping import Thresholds
from mapreplay.predictors import Predictor
from mapreplay.step import PredictorIdentity
from mapreplay.text import one_line

OBSERVATIONS: Final = (1, 5, *range(10, 201, 10), *range(225, 501, 25))
"""Where the curve is measured."""
MAPS: Final = ("raw", "thresholded", "fused", "observed")
"""What is scored: the prediction at p >= .5, after both thresholds, that with the observations
laid over it, and the bare observations."""

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PlanCurve:
    """Of one floor plan."""

    floor_plan: str
    walk: int
    """Observations of the whole walk."""
    f1: Floats
    """float64[4, n]: of each of `MAPS`, after each of `OBSERVATIONS`; NaN where undefined."""
    counts: PredictionCounts
    """Unobserved cells at those of them that the walk has."""


@dataclass(frozen=True, eq=False)
class CurveData:
    """Of a dataset's floor plans."""

    dataset: str
    predictor: PredictorIdentity
    thresholds: Thresholds
    plans: tuple[PlanCurve, ...]

    def f1(self, kind: str) -> Floats:
        """float64[plans, n]: of one of `MAPS`."""
        return np.stack([plan.f1[MAPS.index(kind)] for plan in self.plans])

    def save(self, folder: Path) -> Path:
        """Write ``curve-<dataset>.npz``."""
        path = folder / f"curve-{self.dataset}.npz"
        about = {
            "dataset": self.dataset,
            "predictor": [self.predictor.name, self.predictor.sha256],
            "thresholds": [self.thresholds.delta_free, self.thresholds.delta_occupied],
            "observations": OBSERVATIONS,
            "plans": [plan.floor_plan for plan in self.plans],
            "distances": self.plans[0].counts.distances if self.plans else (),
        }
        with whole_path(path, force=True) as draft, draft.open("wb") as file:
            np.savez_compressed(
                file,
                about=np.array(json.dumps(about)),
                walks=np.array([plan.walk for plan in self.plans]),
                f1=np.stack([plan.f1 for plan in self.plans]),
                counts=np.stack([plan.counts.cells for plan in self.plans]),
            )
        return path


def load_curve(path: Path) -> CurveData:
    """What `CurveData.save` wrote.

    Raises:
        MapreplayError: it is something else, or of another version of this file.
    """
    try:
        with np.load(path, allow_pickle=False) as data:
            about = json.loads(str(data["about"]))
            if tuple(about["observations"]) != OBSERVATIONS:
                raise MapreplayError(f"{path}: measured at other numbers of observations")
            distances = tuple(about["distances"])
            plans = tuple(
                PlanCurve(name, int(walk), f1, PredictionCounts(counts, distances))
                for name, walk, f1, counts in zip(
                    about["plans"], data["walks"], data["f1"], data["counts"], strict=True
                )
            )
        return CurveData(
            about["dataset"],
            PredictorIdentity(*about["predictor"]),
            Thresholds(*about["thresholds"]),
            plans,
        )
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise MapreplayError(f"{path}: not the data of a curve ({one_line(error)})") from None


def measure_curve(
    dataset: str, plans: Iterable[FloorPlan], predictor: Predictor, thresholds: Thresholds
) -> CurveData:
    """The curve of a dataset's floor plans."""
    measured = tuple(measure_plan(plan, predictor, thresholds) for plan in plans)
    return CurveData(dataset, predictor.identity, thresholds, measured)


def measure_plan(plan: FloorPlan, predictor: Predictor, thresholds: Thresholds) -> PlanCurve:
    """The curve of one floor plan.

    Raises:
        MapreplayError: the predictor predicts something impossible.
    """
    f1 = np.full((len(MAPS), len(OBSERVATIONS)), np.nan)
    counts, made = no_cells(), 0
    explorable, walk = _walk(plan)
    observed: Grid
    for made, observed in enumerate(walk, start=1):
        if made in OBSERVATIONS:
            place = OBSERVATIONS.index(made)
            p_wall = _predict(predictor, observed)
            f1[:, place] = _f1(plan, explorable, observed, p_wall, thresholds)
            if p_wall is not None:
                counts += count_cells(p_wall, plan.cells, observed, explorable)
    after = [n > made for n in OBSERVATIONS]
    p_wall = _predict(predictor, observed)
    f1[:, after] = np.array(_f1(plan, explorable, observed, p_wall, thresholds))[:, None]
    return PlanCurve(plan.id, made, f1, counts)


def _walk(plan: FloorPlan) -> tuple[Mask, Iterator[Grid]]:
    """The explorable cells (bool[H, W]), and the observed map after every observation."""
    config = EpisodeConfig(planner="nearest", plan_on=MapKind.OBSERVED, build=MapKind.OBSERVED)
    episode = prepare_episode(config, plan)
    return episode.header.explorable, (step.observed for step in run_episode(episode))


def _predict(predictor: Predictor, observed: Grid) -> npt.NDArray[np.uint8] | None:
    """As it is used and logged: of 8 bits."""
    p_wall = predictor.predict(observed)
    if p_wall is None:
        return None
    try:
        return mapping.quantize(p_wall, PredictionDtype.UINT8).astype(np.uint8)
    except ValueError as error:
        raise MapreplayError(f"predictor {predictor.identity.name!r}: {error}") from None


def _f1(
    plan: FloorPlan,
    explorable: Mask,
    observed: Grid,
    p_wall: npt.NDArray[np.uint8] | None,
    thresholds: Thresholds,
) -> list[float]:
    """F1 of each of `MAPS`; unknown cells count as not occupied. NaN of no prediction."""

    def score(cells: Grid) -> float:
        return scores.score(scores.tally(cells, plan.cells, explorable)).f1

    if p_wall is None:
        alone = score(observed)
        return [np.nan, np.nan, alone, alone]
    sure = mapping.threshold(p_wall, thresholds)
    maps = (mapping.raw_classes(p_wall), sure, mapping.overlay(observed, sure), observed)
    return [score(cells) for cells in maps]
