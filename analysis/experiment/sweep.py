"""Thresholds by trial and error, as the paper chose its own, in closed loop on validation plans.

A sweep is the same experiment once for each pair of thresholds; the logs of each lie in a folder
of its own, ``sweep/<delta free>-<delta occupied>/logs``. Everything is run again for each:
what a threshold does to the way of an agent cannot be had from logs of another.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

from mapreplay.analysis.experiment.jobs import LOGS
from mapreplay.analysis.experiment.table import ArmResult, compare_arms, read_episodes
from mapreplay.errors import MapreplayError

SWEEP_FOLDER: Final = "sweep"


@dataclass(frozen=True)
class Setting:
    """A pair of thresholds, and what came of it."""

    delta_free: float
    delta_occupied: float
    summaries: tuple[ArmResult, ...]

    def fused(self, dataset: str, planner: str) -> ArmResult | None:
        """That of a planner on fused/fused with fail-safe, if it was run."""
        for summary in self.summaries:
            arm = summary.arm
            if (arm.dataset, arm.planner) == (dataset, planner) and (
                arm.maps == "fused/fused" and arm.fail_safe
            ):
                return summary
        return None


def setting_folder(folder: Path, delta_free: float, delta_occupied: float) -> Path:
    """Where the logs of a pair of thresholds go."""
    return folder / SWEEP_FOLDER / f"{delta_free:g}-{delta_occupied:g}"


def read_sweep(folder: Path) -> list[Setting]:
    """All pairs of thresholds that were tried, by delta free, then delta occupied.

    Raises:
        MapreplayError: a folder is named otherwise, or a log in it is damaged.
    """
    settings = []
    for path in (folder / SWEEP_FOLDER).glob(f"*/{LOGS}"):
        free, _, occupied = path.parent.name.partition("-")
        try:
            pair = float(free), float(occupied)
        except ValueError:
            raise MapreplayError(f"{path.parent}: not a pair of thresholds") from None
        settings.append(Setting(*pair, tuple(compare_arms(read_episodes(path.parent)))))
    return sorted(settings, key=lambda s: (s.delta_free, s.delta_occupied))
