"""The tables of an experiment in Markdown."""

from __future__ import annotations

import math
from collections.abc import Sequence

from mapreplay.analysis.experiment.curve import OBSERVATIONS, CurveData
from mapreplay.analysis.experiment.sweep import Setting
from mapreplay.analysis.experiment.table import PAPER, ArmResult
from mapreplay.analysis.metrics.calibration import calibration_scores, decided, score_interval
from mapreplay.analysis.reporting.wording import (
    MULTIPLE,
    UNDEFINED,
    change,
    factor_digits,
    p_number,
)
from mapreplay.analysis.stats.estimates import Estimate, mean_interval

SHOWN_OBSERVATIONS = (1, 20, 50, 100, 200, 400)


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table; columns but the first are aligned to the right where they hold numbers."""
    lines = [
        "| " + " | ".join(head) + " |",
        "|" + "|".join("---" for _ in head) + "|",
        *("| " + " | ".join(row) + " |" for row in rows),
    ]
    return "\n".join(lines)


def percent(estimate: Estimate, digits: int = 1) -> str:
    """``48.7 [45.2, 51.7]``, of a share."""
    return _interval(estimate, 100, digits)


def saved(estimate: Estimate, digits: int = 1) -> str:
    """`percent` of a reduction of a time; where that is a multiple of the other's, how many times
    as long it took: ``64 times as long [31, 97]``.
    """
    if not estimate.mean < MULTIPLE:
        return percent(estimate, digits)
    if math.isnan(estimate.low):
        return change(estimate.mean)
    low, high = (factor_digits(1 - bound) for bound in (estimate.high, estimate.low))
    return f"{change(estimate.mean)} [{low}, {high}]"


def number(estimate: Estimate, digits: int = 0) -> str:
    """``212 [198, 230]``."""
    return _interval(estimate, 1, digits)


def _interval(estimate: Estimate, factor: float, digits: int) -> str:
    if math.isnan(estimate.mean):
        return UNDEFINED
    mean, low, high = (
        f"{factor * value:.{digits}f}" for value in (estimate.mean, estimate.low, estimate.high)
    )
    return mean if math.isnan(estimate.low) else f"{mean} [{low}, {high}]"


def performance(summaries: Sequence[ArmResult]) -> str:
    """What each arm was worth, a table a dataset."""
    parts = []
    for dataset in dict.fromkeys(s.arm.dataset for s in summaries):
        here = [s for s in summaries if s.arm.dataset == dataset]
        rows = [
            [
                s.arm.planner,
                _maps(s),
                s.arm.predictor,
                f"{s.plans} x {s.runs / s.plans:.3g}",
                number(s.mapping_time),
                UNDEFINED if s.arm.is_reference else saved(s.reduction),
                UNDEFINED
                if s.arm.is_reference
                else f"{saved(s.reduction_finished)} ({s.reduction_finished.plans})",
                p_number(s.p),
            ]
            for s in here
        ]
        head = ["planner", "plans on/builds", "predictor", "plans x runs", "mapping time, steps",
                "reduction, %",
                "reduction where both finished, % (plans)", "p"]  # fmt: skip
        parts.append(f"**{dataset}**, {_sizes(here)}\n\n{table(head, rows)}")
    return "\n\n".join(parts)


def quality(summaries: Sequence[ArmResult]) -> str:
    """What the maps of each arm were like, a table a dataset."""
    parts = []
    for dataset in dict.fromkeys(s.arm.dataset for s in summaries):
        rows = [
            [
                s.arm.planner,
                _maps(s),
                s.arm.predictor,
                number(s.correct_time),
                UNDEFINED if s.arm.is_reference else saved(s.correct_reduction),
                number(s.path_length, 1),
                number(s.f1, 3),
                number(s.correct, 3),
                percent(s.success, 0),
                percent(s.sealed_in, 0),
            ]
            for s in summaries
            if s.arm.dataset == dataset
        ]
        head = ["planner", "plans on/builds", "predictor", "steps to 95 % correct",
                "reduction of it, %", "path, m", "F1", "correct coverage", "success, %",
                "sealed in, %"]  # fmt: skip
        parts.append(f"**{dataset}**\n\n{table(head, rows)}")
    return "\n\n".join(parts)


def beside_the_paper(summaries: Sequence[ArmResult]) -> str:
    """The paper's four numbers and ours."""
    rows = []
    for (dataset, planner), theirs in PAPER.items():
        ours = {
            s.arm.fail_safe: s.reduction
            for s in summaries
            if (s.arm.dataset, s.arm.planner, s.arm.maps) == (dataset, planner, "fused/fused")
            and s.arm.predictor == dataset.lower()
        }
        cells = [saved(ours[safe]) if safe in ours else UNDEFINED for safe in (True, False)]
        rows.append([dataset, planner, f"{100 * theirs:.0f}", *cells])
    head = ["dataset", "planner", "paper, %", "ours with fail-safe, %", "ours without, %"]
    return table(head, rows)


def curve(curves: Sequence[CurveData]) -> str:
    """F1 after some numbers of observations."""
    rows = []
    for data in curves:
        for kind, label in (
            ("raw", "prediction, p >= .5"),
            ("thresholded", "prediction, thresholded"),
            ("observed", "observations alone"),
        ):
            columns = data.f1(kind).T
            at = [mean_interval(columns[OBSERVATIONS.index(n)]) for n in SHOWN_OBSERVATIONS]
            rows.append([data.dataset, label, *(number(estimate, 3) for estimate in at)])
    return table(["dataset", "map", *(f"{n} obs." for n in SHOWN_OBSERVATIONS)], rows)


def calibration(curves: Sequence[CurveData]) -> str:
    """Calibration on unobserved cells, in all and by distance."""
    rows = []
    for data in curves:
        counts = [plan.counts for plan in data.plans]
        total = sum(counts[1:], counts[0])
        groups = [("all", total)]
        groups += [(label, total.group(i)) for i, label in enumerate(total.labels)]
        for label, cells in groups:
            scores, sure = calibration_scores(cells), decided(cells, data.thresholds)
            if not scores.cells:
                continue
            ece = f"{100 * scores.ece:.1f}"
            if label == "all":
                ece = percent(score_interval(counts, lambda c: calibration_scores(c).ece))
            wrong = 1 - sure.right / sure.share if sure.share else math.nan
            rows.append(
                [
                    data.dataset,
                    label,
                    f"{scores.cells:,}",
                    _plain(scores.wall_share, 3),
                    ece,
                    _plain(scores.brier, 4),
                    _plain(scores.log_loss, 3),
                    _plain(scores.auroc, 3),
                    _plain(100 * sure.share, 1),
                    _plain(100 * wrong, 2),
                ]
            )
    head = ["dataset", "distance, cells", "cells", "wall share", "ECE, %", "Brier",
            "log loss, nats", "AUROC", "sure, %", "of these wrong, %"]  # fmt: skip
    return table(head, rows)


def sweep(settings: Sequence[Setting]) -> str:
    """Thresholds against each other; the largest reduction of each planner is bold."""
    arms = dict.fromkeys(
        (s.arm.dataset, s.arm.planner)
        for setting in settings
        for s in setting.summaries
        if s.arm.maps == "fused/fused" and s.arm.fail_safe
    )
    rows = []
    for dataset, planner in arms:
        found = [(setting, setting.fused(dataset, planner)) for setting in settings]
        kept = [(setting, s) for setting, s in found if s is not None]
        best = max(s.reduction.mean for _, s in kept)
        for setting, s in kept:
            mark = "**" if s.reduction.mean == best else ""
            rows.append(
                [
                    dataset,
                    planner,
                    f"{100 * setting.delta_free:g}",
                    f"{100 * setting.delta_occupied:g}",
                    f"{mark}{saved(s.reduction)}{mark}",
                    saved(s.correct_reduction),
                    number(s.f1, 3),
                    number(s.correct, 3),
                    percent(s.sealed_in, 0),
                ]
            )
    head = ["dataset", "planner", "delta free, %", "delta occupied, %", "reduction, %",
            "reduction of steps to 95 % correct, %", "F1", "correct coverage",
            "sealed at some step, %"]  # fmt: skip
    return table(head, rows)


def infill(summaries: Sequence[ArmResult]) -> str:
    """What a predictor would be worth that knew everything near the observed."""
    rows = [
        [s.arm.dataset, s.arm.planner, s.arm.predictor, saved(s.reduction),
         saved(s.correct_reduction), number(s.correct, 3), str(s.plans)]
        for s in summaries
        if not s.arm.is_reference
    ]  # fmt: skip
    head = ["dataset", "planner", "predictor", "reduction, %",
            "reduction of steps to 95 % correct, %", "correct coverage", "plans"]  # fmt: skip
    return table(head, rows)


def _maps(summary: ArmResult) -> str:
    return summary.arm.maps + (", fail-safe" if summary.arm.fail_safe else "")


def _sizes(summaries: Sequence[ArmResult]) -> str:
    plans = max(s.plans for s in summaries)
    return f"{plans} floor plans, {sum(s.runs for s in summaries):,} episodes"


def _plain(value: float, digits: int) -> str:
    return UNDEFINED if math.isnan(value) else f"{value:.{digits}f}"
