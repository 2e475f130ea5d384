"""From the data of an experiment to its tables and figures, as often as one likes.

A results folder holds the data: ``logs/<dataset>/`` (a log per episode), ``curve-<dataset>.npz``,
``example.mcap``, and logs below ``sweep/``. What is made of it lies next to them: ``results.json``,
``table.parquet``, ``results.md`` and ``figures/``. A page of documentation has its generated parts
between ``<!-- begin EXPERIMENT/PART -->`` and ``<!-- end EXPERIMENT/PART -->``; what stands around
them is written by hand and left alone. So a page can have parts of several experiments, and no
experiment touches those of another.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from matplotlib.figure import Figure

from mapreplay.analysis.episodes.corpus import LoggedEpisode
from mapreplay.analysis.experiment import figures, markdown
from mapreplay.analysis.experiment.controls import CONTROLS
from mapreplay.analysis.experiment.curve import OBSERVATIONS, CurveData, load_curve
from mapreplay.analysis.experiment.example import EXAMPLE_FILE, Example, read_example
from mapreplay.analysis.experiment.infill import PREFIX as INFILL_PREFIX
from mapreplay.analysis.experiment.sweep import Setting, read_sweep
from mapreplay.analysis.experiment.table import (
    Arm,
    ArmResult,
    Episodes,
    compare_arms,
    read_episodes,
    summary_frame,
)
from mapreplay.analysis.metrics.calibration import calibration_scores, decided, reliability
from mapreplay.analysis.stats.estimates import mean_interval
from mapreplay.errors import MapreplayError
from mapreplay.files.whole import make_folder, whole_path, write_whole

CAPTIONS: Final = {
    "performance": "Reduction of mapping time by dataset, planner and configuration",
    "curve": "F1 over the number of observations",
    "calibration": "Reliability, and what both thresholds make of it by distance from the observed",
    "example": "Observed, predicted, fused and true map at the end",
}
"""What each figure shows, for those who cannot see it."""
SCHEMA: Final = "mapreplay.experiment/1"
PAGE: Final = "results.md"


@dataclass(frozen=True, eq=False)
class Results:
    """All data of a results folder; what was not measured is empty."""

    episodes: Episodes
    summaries: tuple[ArmResult, ...]
    curves: tuple[CurveData, ...]
    example: Example | None
    sweep: tuple[Setting, ...]
    infill: tuple[ArmResult, ...]


def read_results(folder: Path) -> Results:
    """Read what there is.

    Raises:
        MapreplayError: no episode was finished there, or a file is damaged.
    """
    every, sweep = read_episodes(folder), read_sweep(folder)
    if not (every or sweep):
        raise MapreplayError(f"{folder}: holds no finished episode of an experiment")
    example = folder / EXAMPLE_FILE
    main: dict[str, list[LoggedEpisode]] = {}
    bounds: dict[str, list[LoggedEpisode]] = {}
    for dataset, found in every.items():
        kept = [episode for episode in found if not _said_twice(episode)]
        oracle = [e for e in kept if e.row.predictor.startswith(INFILL_PREFIX)]
        main[dataset] = [e for e in kept if not e.row.predictor.startswith(INFILL_PREFIX)]
        if oracle:
            baseline = [e for e in main[dataset] if Arm.of(dataset, e).is_reference]
            bounds[dataset] = baseline + oracle
    return Results(
        episodes=main,
        summaries=tuple(compare_arms(main)),
        curves=tuple(load_curve(path) for path in sorted(folder.glob("curve-*.npz"))),
        example=read_example(example) if example.exists() else None,
        sweep=tuple(sweep),
        infill=tuple(compare_arms(bounds)),
    )


def _said_twice(episode: LoggedEpisode) -> bool:
    """Whether a control or oracle has another log, with fail-safe, that says it better."""
    row = episode.row
    special = row.predictor in CONTROLS or row.predictor.startswith(INFILL_PREFIX)
    return special and not row.fail_safe


def write_report(folder: Path, docs: Path | None = None, name: str = "paper") -> list[Path]:
    """Make all tables and figures of a results folder; returns the files written.

    With `docs`, also the generated parts of ``results.md`` in that folder that are of the
    experiment `name`, and the figures among them: ``figures/<name>-<figure>.png``.

    Raises:
        MapreplayError: there is nothing to report, a file is damaged, or `docs` has no page.
        WriteError: a file cannot be written; each of the others is whole, or as it was.
    """
    results = read_results(folder)
    written = [folder / "results.json", folder / PAGE]
    document = json.dumps(_finite(to_json(results)), indent=1) + "\n"
    write_whole(written[0], document.encode(), force=True)
    parts = blocks(results)
    pictures = folder / "figures"
    make_folder(pictures)
    drawn = {
        kind: figures.save(figure, pictures / f"{kind}.png")
        for kind, figure in draw(results).items()
    }
    here = parts | {f"{kind}-figure": _picture(kind, f"{kind}.png") for kind in drawn}
    text = "\n\n".join(f"## {heading}\n\n{part}" for heading, part in here.items())
    write_whole(written[1], f"{text}\n".encode(), force=True)
    if results.summaries:
        written.append(folder / "table.parquet")
        with whole_path(written[-1], force=True) as draft, draft.open("wb") as file:
            summary_frame(results.summaries).write_parquet(file)
    written += drawn.values()
    if docs is not None:
        there = parts | {f"{kind}-figure": _picture(kind, f"{name}-{kind}.png") for kind in drawn}
        page = update_page(docs / PAGE, {f"{name}/{part}": t for part, t in there.items()})
        written.append(page)
        shown = page.read_text(encoding="utf-8")
        make_folder(docs / "figures")
        for kind, path in drawn.items():
            copy = docs / "figures" / f"{name}-{kind}.png"
            if f"(figures/{copy.name})" in shown:
                write_whole(copy, path.read_bytes(), force=True)
                written.append(copy)
    return written


def _picture(kind: str, file: str) -> str:
    return f"![{CAPTIONS[kind]}](figures/{file})"


def blocks(results: Results) -> dict[str, str]:
    """The generated parts by name, in Markdown."""
    found: dict[str, str] = {}
    if results.summaries:
        found["paper"] = markdown.beside_the_paper(results.summaries)
        found["performance"] = markdown.performance(results.summaries)
        found["quality"] = markdown.quality(results.summaries)
        found["provenance"] = _provenance(results.episodes)
    if results.curves:
        found["curve"] = markdown.curve(results.curves)
        found["calibration"] = markdown.calibration(results.curves)
    if results.example:
        found["example"] = _example_text(results.example)
    if results.sweep:
        found["sweep"] = markdown.sweep(results.sweep)
    if results.infill:
        found["infill"] = markdown.infill(results.infill)
    return found


def draw(results: Results) -> dict[str, Figure]:
    """The figures by name."""
    drawn: dict[str, Figure] = {}
    if results.summaries:
        drawn["performance"] = figures.performance_figure(results.summaries)
    if results.curves:
        drawn["curve"] = figures.curve_figure(results.curves)
        drawn["calibration"] = figures.calibration_figure(results.curves)
    if results.example:
        drawn["example"] = figures.example_figure(results.example)
    return drawn


def update_page(page: Path, parts: Mapping[str, str]) -> Path:
    """Replace the generated parts of a page; those that were not made stay as they are.

    Raises:
        MapreplayError: there is no such page, it cannot be written, or a part never ends.
    """
    try:
        text = page.read_text(encoding="utf-8")
        for name, part in parts.items():
            begin, end = f"<!-- begin {name} -->", f"<!-- end {name} -->"
            if begin not in text:
                continue
            pattern = re.compile(f"{re.escape(begin)}.*?{re.escape(end)}", re.DOTALL)
            text, count = pattern.subn(lambda _, t=f"{begin}\n{part}\n{end}": t, text)  # type: ignore[misc]
            if not count:
                raise MapreplayError(f"{page}: {begin} has no {end}")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise MapreplayError(f"{page}: cannot be read ({reason})") from None
    write_whole(page, text.encode(), force=True)
    return page


def to_json(results: Results) -> dict[str, Any]:
    """Everything measured, for programs."""
    example = results.example
    return {
        "schema": SCHEMA,
        "table": [asdict(summary) for summary in results.summaries],
        "curve": [_curve_json(data) for data in results.curves],
        "sweep": [asdict(setting) for setting in results.sweep],
        "infill": [asdict(summary) for summary in results.infill],
        "example": example
        and {
            "floor_plan": example.log.header.floor_plan.id,
            "config": example.log.header.config.model_dump(mode="json"),
            "steps": example.last.index,
            "outcome": example.last.outcome,
            "exposure_observed": example.exposure_observed,
            "exposure_fused": example.exposure_fused,
            "f1": example.last.metrics.f1,
        },
    }


def _curve_json(data: CurveData) -> dict[str, Any]:
    counts = [plan.counts for plan in data.plans]
    total = sum(counts[1:], counts[0])
    by_distance = {
        label: asdict(calibration_scores(total.group(i)))
        | asdict(decided(total.group(i), data.thresholds))
        for i, label in enumerate(total.labels)
    }
    return {
        "dataset": data.dataset,
        "predictor": asdict(data.predictor),
        "plans": [plan.floor_plan for plan in data.plans],
        "observations": OBSERVATIONS,
        "f1": {
            kind: [asdict(mean_interval(column)) for column in data.f1(kind).T]
            for kind in ("raw", "thresholded", "fused", "observed")
        },
        "calibration": asdict(calibration_scores(total)),
        "reliability": [asdict(b) for b in reliability(total)],
        "by_distance": by_distance,
    }


def _finite(value: Any) -> Any:
    """The same with null for NaN, which JSON does not have."""
    if isinstance(value, dict):
        return {key: _finite(part) for key, part in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(part) for part in value]
    return None if isinstance(value, float) and math.isnan(value) else value


def _provenance(episodes: Episodes) -> str:
    every = [episode for found in episodes.values() for episode in found]
    used = {episode.header.predictor for episode in every}
    weights = sorted((predictor.name, predictor.sha256) for predictor in used if predictor.sha256)
    lines = [f"- `{name}`: weights with SHA-256 `{sha}`" for name, sha in weights]
    lines.append(f"- {len(every):,} episodes")
    return "\n".join(lines)


def _example_text(example: Example) -> str:
    header, last = example.log.header, example.last
    return (
        f"`{header.floor_plan.id}`: {last.outcome} after {last.index} steps and "
        f"{last.metrics.path_length:.1f} m. At its end the observed map shows "
        f"{100 * example.exposure_observed:.1f} % of the explorable cells and the fused map "
        f"{100 * example.exposure_fused:.1f} %, {100 * last.metrics.correct_coverage_fused:.1f} % "
        f"rightly (F1 {last.metrics.f1:.3f})."
    )
