"""A heat map of scores by thresholds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from mapreplay.analysis.whatif.grid import WhatIf
from mapreplay.recorders.pictures.palette import VERMILION, Theme, hex_of


@dataclass(frozen=True)
class HeatMap:
    """F1 and correct coverage of the fused map at a step, by both thresholds."""

    result: WhatIf
    step: int
    logged: tuple[float, float]
    """(delta_free, delta_occupied) of the episode."""

    def __call__(self, figure: Figure, theme: Theme) -> None:  # noqa: ARG002
        """See `figures.Draw`."""
        axes = figure.subplots(1, 2, sharey=True)
        maps = {"F1": self.result.f1, "correct coverage": self.result.correct}
        for place, (name, values) in zip(axes, maps.items(), strict=True):
            edges_free = _edges(self.result.delta_free)
            edges_occupied = _edges(self.result.delta_occupied)
            mesh = place.pcolormesh(
                edges_free, edges_occupied, values[self.step].T, cmap="viridis", rasterized=True
            )
            figure.colorbar(mesh, ax=place, shrink=0.85)
            ever = self.result.sealed.any(axis=0)
            i, j = np.nonzero(ever)
            place.plot(
                np.array(self.result.delta_free)[i],
                np.array(self.result.delta_occupied)[j],
                "X",
                markerfacecolor="white",
                markeredgecolor="black",
                markersize=5,
                markeredgewidth=0.7,
                label="sealed in at some step",
            )
            place.plot(
                *self.logged,
                "o",
                markerfacecolor="none",
                markeredgecolor=hex_of(VERMILION),
                markersize=11,
                markeredgewidth=2.2,
                label="as logged",
            )
            place.set_title(f"{name} at step {self.step}")
            place.set_xlabel("delta_free")
            place.grid(visible=False)
        axes[0].set_ylabel("delta_occupied")
        axes[0].legend(loc="upper left", bbox_to_anchor=(0, -0.16), ncols=2)
        figure.suptitle("Open loop: the trajectory stays as logged", x=0.01, ha="left", size=9)


def _edges(values: tuple[float, ...]) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Half way between neighbours, and as far out."""
    if len(values) == 1:
        return np.array([values[0] - 0.005, values[0] + 0.005])
    middle = (np.array(values[1:]) + np.array(values[:-1])) / 2
    first, last = 2 * values[0] - middle[0], 2 * values[-1] - middle[-1]
    return np.concatenate([[first], middle, [last]])
