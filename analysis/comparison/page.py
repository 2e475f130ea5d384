"""A comparison as one HTML page: the answer, figures, tables, and the floor plans to look at."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from mapreplay.analysis.comparison.compare import (
    TIME,
    Comparison,
    GroupResult,
    GroupSaving,
)
from mapreplay.analysis.comparison.figures import CoverageFigure, IncidenceFigure, PairsFigure
from mapreplay.analysis.diff.folders import view_command
from mapreplay.analysis.episodes.corpus import LoggedEpisode
from mapreplay.analysis.reporting import page
from mapreplay.analysis.reporting.figures import Draw, in_the_dark, render
from mapreplay.analysis.reporting.wording import (
    change,
    counted,
    number,
    p_number,
    p_value,
    reduction,
    with_interval,
)
from mapreplay.config import MapKind
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.recorders.pictures.layers import MapView
from mapreplay.recorders.pictures.painter import map_pngs
from mapreplay.text import shell_command

EACH: Final = 2
"""Worst and best floor plans that are shown of each group."""
MOST_GROUPS: Final = 3
"""Groups whose floor plans are shown."""
PIXELS: Final = 320
"""Side of a map's picture."""


def comparison_page(comparison: Comparison) -> page.Page:
    """The page of a comparison.

    Raises:
        LogError: a log that is pictured can no longer be read.
    """
    groups = comparison.groups
    title = " against ".join(group.name for group in groups[::-1])
    if len(groups) > 2:
        title = f"{len(groups)} groups by {', '.join(comparison.by)}"
    blocks: list[page.PageBlock] = list(_headlines(comparison))
    blocks += [page.Note(line) for line in comparison.notes]
    blocks += [
        page.Heading("Coverage and time"),
        page.Columns(
            [
                _figure(CoverageFigure(comparison), 4.0, "Coverage of the map under construction",
                        "Median over floor plans and quartiles; an ended episode keeps its last "
                        "value. Dotted: the target."),
                _figure(CoverageFigure(comparison, correct=True), 4.0, "Correct coverage",
                        "The same for cells that are known and correct."),
                _figure(IncidenceFigure(comparison), 4.0, "Cumulative share of floor plans mapped",
                        "Being sealed in is a competing event: such floor plans are never mapped. "
                        + ("Bands: 95 % Wilson intervals." if len(comparison.places) > 1 else "")),
                _figure(PairsFigure(comparison), PairsFigure(comparison).height,
                        "Mapping times of each floor plan",
                        "Hollow: the target was not reached; drawn at the whole budget."),
            ],
            wide=True,
        ),
        page.Heading("Groups"),
        _groups_table(comparison),
    ]  # fmt: skip
    if comparison.effects:
        blocks += [
            page.Heading(f"Against {comparison.baseline}"),
            page.Paragraph(
                "Mean paired differences over floor plans with 95 % BCa bootstrap intervals; p by "
                f"the {comparison.effects[0].test.name} test, and corrected for all tests (Holm)."
            ),
            _effects_table(comparison),
            *(page.Paragraph(_success(s, comparison)) for s in comparison.savings),
        ]
    for saving in comparison.savings[:MOST_GROUPS]:
        blocks += _extremes(comparison, saving.group)
    blocks += [page.Heading("Every floor plan"), _plans_table(comparison)]
    return page.Page(title, _lead(comparison), blocks, "Made by mapreplay compare.")


def _lead(comparison: Comparison) -> str:
    plans = len(comparison.places)
    many = counted(plans, "floor plan")
    if not comparison.savings:
        (group, *_) = comparison.groups
        return (
            f"{group.name} on {many}: mapping time {with_interval(group.estimates[TIME], 0)} steps."
        )
    saving = comparison.savings[0]
    return (
        f"On {many} the mapping time of {saving.group}, compared with that of "
        f"{comparison.baseline}, is {reduction(saving.reduction)}."
    )


def _headlines(comparison: Comparison) -> Iterator[page.PageBlock]:
    numbers = [
        (change(saving.reduction.mean), f"mapping time: {saving.group}")
        for saving in comparison.savings[:MOST_GROUPS]
    ]
    for group in comparison.groups[:MOST_GROUPS]:
        success = group.success
        numbers.append((f"{success.count} of {success.of}", f"floor plans mapped: {group.name}"))
    yield page.Numbers(numbers)


def _figure(draw: Draw, height: float, alt: str, caption: str) -> page.Illustration:
    svg = render(draw, (6.0, height))
    return page.Illustration(svg, alt, caption, in_the_dark(svg))


def _groups_table(comparison: Comparison) -> page.Table:
    head = ["group", "runs", *dict(comparison.groups[0].outcomes), *_measure_names(comparison)]
    rows: list[list[page.Value]] = [
        [
            group.name,
            group.episodes,
            *dict(group.outcomes).values(),
            *(with_interval(group.estimates[m.name], m.digits) for m in comparison.measures),
        ]
        for group in comparison.groups
    ]
    return page.Table(
        [name.replace("_", " ") for name in head],
        rows,
        "Means over floor plans with 95 % intervals; the mapping time is restricted to the budget.",
        right=range(5, 5 + len(comparison.measures)),
    )


def _measure_names(comparison: Comparison) -> list[str]:
    return [f"{m.name}, {m.unit}" if m.unit != "1" else m.name for m in comparison.measures]


def _effects_table(comparison: Comparison) -> page.Table:
    digits = {measure.name: measure.digits for measure in comparison.measures}
    rows: list[list[page.Value]] = [
        [
            effect.group,
            effect.measure,
            with_interval(effect.difference, digits[effect.measure]),
            effect.difference.plans,
            p_number(effect.test.p),
            p_number(effect.p_holm),
        ]
        for effect in comparison.effects
    ]
    head = ["group", "measure", "difference", "floor plans", "p", "p (Holm)"]
    return page.Table(head, rows, right=[2, 4, 5])


def _success(saving: GroupSaving, comparison: Comparison) -> str:
    m = saving.success
    return (
        f"Mapping time of {saving.group}: {reduction(saving.reduction)}; on the "
        f"{counted(saving.both.plans, 'floor plan')} that both mapped {reduction(saving.both)}. "
        f"Mapped only by {saving.group}: {m.only_candidate}, only by {comparison.baseline}: "
        f"{m.only_reference} "
        f"(McNemar, exact: {p_value(m.p)}, Holm: {p_value(saving.success_p_holm)})."
    )


def _extremes(comparison: Comparison, name: str) -> Iterator[page.PageBlock]:
    """The floor plans with the worst and the best result of a group against the baseline."""
    reference, group = (
        next(g for g in comparison.groups if g.name == n) for n in (comparison.baseline, name)
    )
    gain = 1 - group.values[TIME] / np.maximum(reference.values[TIME], 1)
    order = np.argsort(gain, kind="stable").tolist()
    worst = order[: min(EACH, (len(order) + 1) // 2)]
    best = [i for i in order[::-1][:EACH] if i not in worst]
    for title, chosen in (("worst", worst), ("best", best)):
        if not chosen:
            continue
        yield page.Heading(f"The {title} floor plans of {name}")
        for i in chosen:
            yield _card(comparison, reference, group, i, float(gain[i]))


def _card(
    comparison: Comparison, reference: GroupResult, group: GroupResult, i: int, gain: float
) -> page.Card:
    place = comparison.places[i]
    pictures: list[page.PageBlock] = []
    shown = []
    for result in (reference, group):
        episode = comparison.episodes[result.name][place][0]
        shown.append(episode)
        pictures += _pictures(result.name, episode)
    files = [episode.path for episode in shown]
    last = min(max(episode.row.steps, 0) for episode in shown)
    times = " and ".join(f"{r.name} {number(r.values[TIME][i])}" for r in (reference, group))
    sentence = f"Mapping time in steps: {times} ({change(gain)})."
    return page.Card(
        [
            page.Heading(comparison.floor_plans[i], 3),
            page.Paragraph(sentence),
            page.Columns(pictures),
            page.CommandLine(shell_command(view_command(files[0], files[1], last))),
        ]
    )


def _pictures(name: str, episode: LoggedEpisode) -> list[page.PageBlock]:
    """The map at the end of an episode, and its errors."""
    log = EpisodeLog(episode.path)
    if len(log) == 0:
        return []
    step = log[-1]
    built = MapView.FUSED if log.header.config.build is MapKind.FUSED else MapView.OBSERVED
    captions = {built: f"{name}: built map after {step.index} steps, {episode.row.outcome}"}
    if log.header.floor_plan.has_truth:
        captions[MapView.ERROR] = f"{name}: errors of its fused map"
    pngs = map_pngs(log, step, captions, PIXELS)
    return [
        page.Illustration(png, caption, caption)
        for png, caption in zip(pngs, captions.values(), strict=True)
    ]


def _plans_table(comparison: Comparison) -> page.PageBlock:
    head = ["floor plan"]
    for group in comparison.groups:
        head += [f"{group.name}: steps", "F1"]
    if len(comparison.groups) == 2:
        head.append("mapping time")
    rows: list[list[page.Value]] = []
    for i, name in enumerate(comparison.floor_plans):
        row: list[page.Value] = [name]
        for group in comparison.groups:
            row += [round(float(group.values[TIME][i]), 1), float(group.values["F1"][i])]
        if len(comparison.groups) == 2:
            reference, other = (g.values[TIME][i] for g in comparison.groups)
            row.append(change(float(1 - other / max(reference, 1))))
        rows.append(row)
    table = page.Table(head, rows, right=[len(head) - 1])
    return page.Details(counted(len(rows), "floor plan"), [table])
