"""Figures of a comparison: coverage over steps, share mapped by a step, and pairs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from mapreplay.analysis.comparison.compare import TIME, Comparison, GroupResult
from mapreplay.analysis.episodes.curves import extended
from mapreplay.analysis.reporting.figures import LINES, MARKERS, colour, label
from mapreplay.analysis.stats.estimates import NEVER
from mapreplay.recorders.pictures.palette import Theme, hex_of
from mapreplay.text import shortened

MOST_ROWS: Final = 40
"""Floor plans that are shown by name; more become a scatter plot."""
_POINTS: Final = 200
_NAME: Final = 24
"""Characters of a floor plan's name."""


@dataclass(frozen=True, eq=False)
class CoverageFigure:
    """The median over floor plans of the coverage at each step, and the quartiles around it."""

    comparison: Comparison
    correct: bool = False
    """Of correct coverage."""

    def __call__(self, figure: Figure, theme: Theme) -> None:
        """See `figures.Draw`."""
        self.draw(figure.subplots(), theme)

    def draw(self, axes: Axes, theme: Theme) -> None:
        """The figure on given axes."""
        horizon = horizon_of(self.comparison)
        steps = np.arange(horizon + 1)
        for number, group in enumerate(self.comparison.groups):
            curves = self._curves(group, horizon)
            if np.isnan(curves).all():
                continue
            low, middle, high = np.nanpercentile(curves, (25, 50, 75), axis=0)
            shade = colour(number, theme)
            axes.fill_between(steps, low, high, color=shade, alpha=0.18, linewidth=0)
            axes.plot(steps, middle, LINES[number % len(LINES)], color=shade,
                      label=label(group.name), linewidth=1.6)  # fmt: skip
        axes.axhline(self.comparison.target, color=hex_of(theme.ink), linewidth=0.7, linestyle=":")
        axes.set_title(f"{'Correct coverage' if self.correct else 'Coverage'}: median, quartiles")
        axes.set_xlabel("steps")
        axes.yaxis.set_major_formatter(PercentFormatter(1.0))
        axes.set_ylim(0, 1.02)
        axes.set_xlim(0, horizon)
        axes.legend(loc="lower right")

    def _curves(self, group: GroupResult, horizon: int) -> npt.NDArray[np.float64]:
        """float64[plans, horizon + 1]: of each floor plan the mean of its runs."""
        plans = []
        for runs in self.comparison.episodes[group.name].values():
            curves = [e.correct if self.correct else e.coverage for e in runs]
            plans.append(np.mean([extended(c, horizon) for c in curves if c.size], axis=0))
        return np.array(plans)


@dataclass(frozen=True, eq=False)
class IncidenceFigure:
    """The share of floor plans that were mapped by each step, with its 95 % interval."""

    comparison: Comparison

    def __call__(self, figure: Figure, theme: Theme) -> None:
        """See `figures.Draw`."""
        self.draw(figure.subplots(), theme)

    def draw(self, axes: Axes, theme: Theme) -> None:
        """The figure on given axes."""
        horizon = horizon_of(self.comparison)
        at = np.unique(np.linspace(0, horizon, min(_POINTS, horizon + 1)).astype(int))
        for number, group in enumerate(self.comparison.groups):
            shares = self.comparison.incidence(group, at.astype(float).tolist())
            shade = colour(number, theme)
            if len(self.comparison.places) > 1:  # the interval of a single one is all there is
                axes.fill_between(
                    at, [s.low for s in shares], [s.high for s in shares], step="post",
                    color=shade, alpha=0.15, linewidth=0,
                )  # fmt: skip
            axes.step(at, [s.share for s in shares], where="post", color=shade,
                      label=label(group.name), linestyle=LINES[number % len(LINES)],
                      linewidth=1.6)  # fmt: skip
        axes.set_title("Share of floor plans mapped by a step")
        axes.set_xlabel("steps")
        axes.yaxis.set_major_formatter(PercentFormatter(1.0))
        axes.set_ylim(0, 1.02)
        axes.set_xlim(0, horizon)
        axes.legend(loc="upper left")


@dataclass(frozen=True, eq=False)
class PairsFigure:
    """The mapping times of each floor plan, joined; of many floor plans one against the other."""

    comparison: Comparison

    def __call__(self, figure: Figure, theme: Theme) -> None:
        """See `figures.Draw`."""
        self.draw(figure.subplots(), theme)

    def draw(self, axes: Axes, theme: Theme) -> None:
        """The figure on given axes."""
        if len(self.comparison.places) > MOST_ROWS:
            self._scatter(axes, theme)
        else:
            self._rows(axes, theme)

    def _rows(self, axes: Axes, theme: Theme) -> None:
        groups = self.comparison.groups
        order = np.argsort(groups[0].values[TIME], kind="stable")
        rows = np.arange(len(order))
        times = np.array([group.values[TIME][order] for group in groups])
        axes.hlines(
            rows, times.min(axis=0), times.max(axis=0), color=hex_of(theme.line), linewidth=1.4
        )
        for number, group in enumerate(groups):
            failed = group.times[order] == NEVER
            shade, marker = colour(number, theme), MARKERS[number % len(MARKERS)]
            axes.plot(times[number][~failed], rows[~failed], marker, color=shade,
                      markersize=5.5, label=label(group.name))  # fmt: skip
            axes.plot(times[number][failed], rows[failed], marker, markerfacecolor="none",
                      markeredgecolor=shade, markersize=5.5)  # fmt: skip
        names = [shortened(self.comparison.floor_plans[i], _NAME) for i in order]
        axes.set_yticks(rows, names)
        axes.set_title("Mapping time in steps (hollow: not mapped)")
        axes.set_xlim(left=0)
        axes.grid(visible=False, axis="y")
        axes.legend(loc="upper left", bbox_to_anchor=(0, -0.1), ncols=2)

    def _scatter(self, axes: Axes, theme: Theme) -> None:
        reference, *others = self.comparison.groups
        times = [group.values[TIME] for group in self.comparison.groups]
        top = float(np.nanmax(times, initial=1.0))
        axes.plot([0, top], [0, top], color=hex_of(theme.ink), linewidth=0.7)
        for number, group in enumerate(others, start=1):
            shade, marker = colour(number, theme), MARKERS[number % len(MARKERS)]
            failed = (group.times == NEVER) | (reference.times == NEVER)
            for chosen, face in ((~failed, shade), (failed, "none")):
                axes.plot(reference.values[TIME][chosen], group.values[TIME][chosen], marker,
                          markerfacecolor=face, markeredgecolor=shade, markersize=4, alpha=0.8,
                          label=label(group.name) if face != "none" else None)  # fmt: skip
        axes.set_title("Mapping times of floor plans (hollow: not mapped)")
        axes.set_xlabel(f"{label(reference.name)}, steps")
        axes.set_ylabel("steps")
        axes.legend(loc="upper left")

    @property
    def height(self) -> float:
        """Inches that the rows need."""
        rows = len(self.comparison.places)
        return 4.2 if rows > MOST_ROWS else 1.3 + 0.24 * max(rows, 6)


@dataclass(frozen=True, eq=False)
class Overview:
    """All figures side by side, for a file of their own."""

    comparison: Comparison

    @property
    def size(self) -> tuple[float, float]:
        """Inches."""
        return 13.5, max(4.2, PairsFigure(self.comparison).height)

    def __call__(self, figure: Figure, theme: Theme) -> None:
        """See `figures.Draw`."""
        left, middle, right = figure.subplots(1, 3)
        CoverageFigure(self.comparison).draw(left, theme)
        IncidenceFigure(self.comparison).draw(middle, theme)
        PairsFigure(self.comparison).draw(right, theme)


def horizon_of(comparison: Comparison) -> int:
    """The last step of the longest episode, within the largest budget."""
    longest = max(
        episode.coverage.size - 1
        for runs in comparison.episodes.values()
        for episodes in runs.values()
        for episode in episodes
    )
    return max(1, min(longest, max(comparison.budgets)))
