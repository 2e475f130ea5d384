"""The figures of an experiment, drawn from its data alone; colours as everywhere else."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from mapreplay.analysis.experiment.controls import CONTROLS
from mapreplay.analysis.experiment.curve import OBSERVATIONS, CurveData
from mapreplay.analysis.experiment.example import Example
from mapreplay.analysis.experiment.table import (
    PAPER,
    PLANNERS,
    Arm,
    ArmResult,
)
from mapreplay.analysis.metrics.calibration import (
    PredictionCounts,
    calibration_scores,
    decided,
    reliability,
    score_interval,
)
from mapreplay.analysis.reporting.figures import plain, quiet
from mapreplay.analysis.stats.estimates import mean_interval
from mapreplay.files.whole import whole_path
from mapreplay.recorders.pictures.layers import MapView
from mapreplay.recorders.pictures.painter import MapPainter
from mapreplay.recorders.pictures.palette import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY_BLUE,
    VERMILION,
    Colour,
)

_FLOOR: Final = -1.0
"""Reductions below this are drawn here, and counted."""
_MAPS: Final[dict[tuple[str, bool], tuple[str, Colour]]] = {
    ("observed/observed", False): ("observed/observed", GREY),
    ("fused/observed", False): ("plan on fused, build observed", SKY_BLUE),
    ("observed/fused", False): ("plan on observed, build fused", GREEN),
    ("fused/fused", False): ("fused/fused", ORANGE),
    ("fused/fused", True): ("fused/fused, fail-safe", VERMILION),
}
_PLANNER_NAMES: Final = {
    "random": "Random\nExploration", "nearest": "Nearest\nFrontier",
    "cost-utility": "Cost-\nUtility", "informative-path": "Informative\nPath",
}  # fmt: skip
_CURVES: Final = {
    "raw": ("prediction, p ≥ .5", BLUE),
    "thresholded": ("prediction, thresholded", VERMILION),
    "observed": ("observations alone", GREY),
}


def save(figure: Figure, path: Path) -> Path:
    """Write a PNG: the same data give the same bytes."""
    plain(figure)
    with quiet(), whole_path(path, force=True) as draft:
        figure.savefig(draft, format="png", dpi=150, metadata={"Software": None})
    return path


def performance_figure(summaries: Sequence[ArmResult]) -> Figure:
    """Reduction of mapping time by dataset, planner and configuration: bars are means with 95 %
    intervals over floor plans, dots are floor plans. Controls are left to the table.
    """
    shown = {s.arm: s for s in summaries if s.arm.predictor not in CONTROLS}
    datasets = sorted({arm.dataset for arm in shown})
    figure = Figure(figsize=(1 + 4.6 * len(datasets), 4.6), layout="constrained")
    panels = figure.subplots(1, len(datasets), sharey=True, squeeze=False)[0]
    for axes, dataset in zip(panels, datasets, strict=True):
        _performance_panel(axes, {arm: s for arm, s in shown.items() if arm.dataset == dataset})
        axes.set_title(dataset)
    panels[0].set_ylabel("reduction of mapping time\nagainst observed/observed Nearest Frontier")
    used = {(arm.maps, arm.fail_safe) for arm in shown if not arm.is_reference}
    marks = [
        Line2D([], [], color=_hex(colour), marker="s", linestyle="", label=label)
        for key, (label, colour) in _MAPS.items()
        if key in used
    ]
    marks.append(
        Line2D([], [], color="black", marker="o", mfc="white", linestyle="",
               label="mean where both finished")
    )  # fmt: skip
    marks.append(
        Line2D([], [], color="black", marker="D", fillstyle="none", linestyle="",
               label="the paper, on its own data")
    )  # fmt: skip
    figure.legend(handles=marks, loc="outside lower center", ncols=4, frameon=False, fontsize=9)
    return figure


def _performance_panel(axes: Axes, summaries: Mapping[Arm, ArmResult]) -> None:
    planners = [p for p in PLANNERS if any(arm.planner == p for arm in summaries)]
    chance = np.random.default_rng(0)
    for place, planner in enumerate(planners):
        group = [a for a in summaries if a.planner == planner and not a.is_reference]
        width = 0.86 / max(len(group), 1)
        for number, arm in enumerate(group):
            x = place - 0.43 + (number + 0.5) * width
            colour = _hex(_MAPS.get((arm.maps, arm.fail_safe), ("", PURPLE))[1])
            effects = np.array(summaries[arm].reductions)
            dots = np.maximum(effects, _FLOOR)
            spread = chance.uniform(-0.3, 0.3, dots.size) * width
            axes.scatter(x + spread, dots, s=5, color=colour, alpha=0.35, linewidths=0, zorder=2)
            estimate = summaries[arm].reduction
            finished = summaries[arm].reduction_finished.mean
            axes.bar(x, estimate.mean, 0.8 * width, color=colour, alpha=0.4, zorder=1)
            axes.plot([x, x], [estimate.low, estimate.high], color="black", lw=1.6, zorder=3)
            axes.plot(x, estimate.mean, "o", color="black", ms=3.5, zorder=4)
            if abs(finished - estimate.mean) > 0.005:
                axes.plot(x, finished, "o", color="black", mfc="white", ms=4.5, zorder=4)
            below = int((effects < _FLOOR).sum())
            if below:
                axes.annotate(
                    f"{below}", (x, _FLOOR), (0, -2), textcoords="offset points",
                    ha="center", va="top", fontsize=7, zorder=5,
                    bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.5, "alpha": 0.85},
                )  # fmt: skip
            paper = PAPER.get((arm.dataset, planner))
            if paper is not None and arm.maps == "fused/fused":
                axes.plot(x, paper, "D", color="black", fillstyle="none", ms=6, zorder=4)
    axes.axhline(0, color="black", lw=0.8)
    axes.set_xticks(range(len(planners)), [_PLANNER_NAMES.get(p, p) for p in planners])
    axes.set_ylim(_FLOOR - 0.08, 1.03)
    axes.yaxis.set_major_formatter(lambda value, _: f"{100 * value:.0f} %")
    _tidy(axes)


def curve_figure(curves: Sequence[CurveData]) -> Figure:
    """F1 over the number of observations, a panel a dataset, with 95 % bands over floor plans."""
    figure = Figure(figsize=(1 + 4.2 * len(curves), 3.9), layout="constrained")
    panels = figure.subplots(1, len(curves), sharey=True, squeeze=False)[0]
    for axes, data in zip(panels, curves, strict=True):
        for kind, (label, colour) in _CURVES.items():
            estimates = [mean_interval(column) for column in data.f1(kind).T]
            axes.plot(OBSERVATIONS, [e.mean for e in estimates], color=_hex(colour), label=label)
            axes.fill_between(
                OBSERVATIONS,
                [e.low for e in estimates],
                [e.high for e in estimates],
                color=_hex(colour),
                alpha=0.2,
                linewidth=0,
            )
        axes.set_title(f"{data.dataset}, {len(data.plans)} floor plans")
        axes.set_xlabel("observations (scans along a Nearest Frontier walk)")
        axes.set_xlim(0, OBSERVATIONS[-1])
        axes.set_ylim(0, 1.02)
        _tidy(axes)
    panels[0].set_ylabel("F1 of walls, explorable cells")
    panels[-1].legend(frameon=False, loc="lower right", fontsize=8)
    return figure


def calibration_figure(curves: Sequence[CurveData]) -> Figure:
    """Reliability of p_wall on unobserved cells, and what both thresholds make of it by distance
    from the observed; a column a dataset.
    """
    figure = Figure(figsize=(1 + 4.2 * len(curves), 7.2), layout="constrained")
    upper, lower = figure.subplots(2, len(curves), squeeze=False)
    for axes, below, data in zip(upper, lower, curves, strict=True):
        counts = [plan.counts for plan in data.plans]
        total = sum(counts[1:], counts[0])
        _reliability_panel(axes, total)
        ece = score_interval(counts, lambda c: calibration_scores(c).ece)
        axes.set_title(
            f"{data.dataset}: ECE {100 * ece.mean:.1f} % "
            f"[{100 * ece.low:.1f}, {100 * ece.high:.1f}]",
            fontsize=11,
        )
        _distance_panel(below, data, total)
    upper[0].set_ylabel("share of walls among unobserved cells")
    lower[0].set_ylabel("share of unobserved cells")
    lower[-1].legend(frameon=False, fontsize=8, loc="upper right")
    return figure


def _reliability_panel(axes: Axes, counts: PredictionCounts) -> None:
    bins = [b for b in reliability(counts) if b.cells]
    total = sum(b.cells for b in bins)
    axes.plot([0, 1], [0, 1], color=_hex(GREY), lw=1, ls="--")
    axes.plot([b.mean_p for b in bins], [b.wall_share for b in bins], color=_hex(BLUE), lw=1.2)
    for b in bins:
        size = 12 + 260 * b.cells / total
        axes.scatter(b.mean_p, b.wall_share, s=size, color=_hex(BLUE), zorder=3)
    axes.set_xlabel("predicted P(wall); area: share of the cells")
    axes.set_xlim(-0.03, 1.03)
    axes.set_ylim(-0.03, 1.03)
    axes.set_aspect("equal")
    _tidy(axes)


def _distance_panel(axes: Axes, data: CurveData, total: PredictionCounts) -> None:
    groups = [decided(total.group(i), data.thresholds) for i in range(len(total.labels))]
    kept = [(label, g) for label, g in zip(total.labels, groups, strict=True) if g.cells]
    places = range(len(kept))
    right = [g.right for _, g in kept]
    wrong = [g.share - g.right for _, g in kept]
    axes.bar(places, right, color=_hex(GREEN), label="sure and right")
    axes.bar(places, wrong, bottom=right, color=_hex(VERMILION), label="sure and wrong")
    for place, (_, group) in zip(places, kept, strict=True):
        error = 1 - group.right / group.share if group.share else float("nan")
        text = f"{100 * error:.1f} %\nwrong" if group.share else "never\nsure"
        axes.annotate(text, (place, group.share), (0, 3), textcoords="offset points",
                      ha="center", fontsize=7)  # fmt: skip
    axes.set_xticks(places, [label for label, _ in kept])
    axes.set_xlabel("chessboard distance from the nearest observed cell, cells")
    axes.set_ylim(0, 1.02)
    _tidy(axes)


def example_figure(example: Example) -> Figure:
    """Observed, predicted, fused and true map at the end of an episode, with the way there."""
    painter = MapPainter(example.log.header)
    step = replace(example.last, frontier=np.empty((0, 2), np.int32))  # nobody goes there any more
    titles = {
        MapView.OBSERVED: f"observed: {100 * example.exposure_observed:.0f} % exposed",
        MapView.PREDICTED: "predicted P(wall)",
        MapView.FUSED: f"fused: {100 * example.exposure_fused:.0f} % exposed",
        MapView.TRUTH: "truth",
    }
    figure = Figure(figsize=(12, 3.5), layout="constrained")
    for axes, (view, title) in zip(figure.subplots(1, 4), titles.items(), strict=True):
        track = None if view in (MapView.PREDICTED, MapView.FUSED) else example.track
        axes.imshow(painter.draw(view, step, 640, 640, track=track))
        axes.set_title(title, fontsize=11)
        axes.set_axis_off()
    config = example.log.header.config
    figure.suptitle(
        f"{example.log.header.floor_plan.id}, {config.planner} on {config.plan_on}/{config.build}, "
        f"thresholds {100 * config.delta_free:.0f}/{100 * config.delta_occupied:.0f}: "
        f"{step.outcome} after {step.index} steps, F1 {step.metrics.f1:.3f}",
        fontsize=11,
    )
    return figure


def _hex(colour: Colour) -> str:
    return "#{:02x}{:02x}{:02x}".format(*colour)


def _tidy(axes: Axes) -> None:
    axes.spines[["top", "right"]].set_visible(False)
