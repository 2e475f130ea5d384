"""Why two episodes diverge, in words: what each of them had at the step where a layer differs."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from mapreplay import plugins
from mapreplay.analysis.diff.divergence import Divergences, Layer, Moment
from mapreplay.analysis.diff.steps import as_text, step_differences
from mapreplay.analysis.reporting.wording import counted
from mapreplay.errors import MapreplayError
from mapreplay.grid import UNKNOWN, Cell
from mapreplay.mapping import dequantize
from mapreplay.planners import planner_of
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.stages import Past, Travelled, ask, look_around
from mapreplay.step import Candidate, Decision, Step


@dataclass(frozen=True)
class Cause:
    """The first step at which a layer differs."""

    layer: Layer
    step: int
    text: str
    """What each of the two had there."""


def causes(a: EpisodeLog, b: EpisodeLog, divergences: Divergences) -> Iterator[Cause]:
    """What each of the two had where a layer first differs, in words."""
    for layer, moment in divergences.first.items():
        yield Cause(layer, moment.index, _TEXTS[layer](a, b, moment))


def outcome_name(log: EpisodeLog) -> str:
    """How it ended, or that it did not."""
    return str(log.outcome or "unfinished")


def _start(_a: EpisodeLog, _b: EpisodeLog, moment: Moment) -> str:
    a, b = _steps(moment)
    return f"A starts at {as_text(a.agent)}, B at {as_text(b.agent)}"


def _observation(_a: EpisodeLog, _b: EpisodeLog, moment: Moment) -> str:
    a, b = _steps(moment)
    cells = np.argwhere(a.observed != b.observed)
    if not len(cells):
        return f"both stand at {as_text(a.agent)}; their rays differ"
    first = Cell(*cells[0].tolist())
    return (
        f"both stand at {as_text(a.agent)}; {counted(len(cells), 'observed cell')} "
        f"{'differs' if len(cells) == 1 else 'differ'}, the first is {as_text(first)}: "
        f"{_name(a.observed[first])} in A, {_name(b.observed[first])} in B"
    )


def _prediction(_a: EpisodeLog, _b: EpisodeLog, moment: Moment) -> str:
    a, b = _steps(moment)
    if a.p_wall is None or b.p_wall is None:
        without, with_one = ("A", "B") if a.p_wall is None else ("B", "A")
        return f"both observed the same; {without} predicts nothing, {with_one} does"
    gap = np.abs(dequantize(a.p_wall) - dequantize(b.p_wall))
    most = Cell(*(int(i) for i in np.unravel_index(int(gap.argmax()), gap.shape)))
    p_a, p_b = dequantize(a.p_wall)[most], dequantize(b.p_wall)[most]
    return (
        f"both observed the same; {counted(int((gap > 0).sum()), 'predicted cell')} differ, most "
        f"at {as_text(most)}: p_wall {p_a:.3f} in A, {p_b:.3f} in B"
    )


def _fused(a: EpisodeLog, b: EpisodeLog, moment: Moment) -> str:
    step_a, step_b = _steps(moment)
    differ = step_a.fused != step_b.fused
    known = differ & (step_a.observed != UNKNOWN)
    first = Cell(*np.argwhere(differ)[0].tolist())
    t_a, t_b = (log.header.at(moment.index).thresholds for log in (a, b))
    limits = ""
    if t_a != t_b and not known.any():
        limits = (
            f" (thresholds free {t_a.delta_free}, occupied {t_a.delta_occupied} in A, "
            f"{t_b.delta_free}, {t_b.delta_occupied} in B)"
        )
    return (
        f"{counted(int(differ.sum()), 'fused cell')} differ, the first is {as_text(first)}: "
        f"{_name(step_a.fused[first])} in A, {_name(step_b.fused[first])} in B{limits}"
    )


def _ranking(_a: EpisodeLog, _b: EpisodeLog, moment: Moment) -> str:
    a, b = _steps(moment)
    if a.frontier.shape != b.frontier.shape or (a.frontier != b.frontier).any():
        counts = f"A chooses from {len(a.frontier)} frontier cells, B from {len(b.frontier)}"
    else:
        counts = f"both choose from the same {counted(len(a.frontier), 'frontier cell')}"
    best = [_best(step.decision) for step in (a, b)]
    if best[0] is None or best[1] is None:
        return counts
    return (
        f"{counts}; A rates {as_text(best[0].cell)} best ({_number(best[0].utility)}), B "
        f"{as_text(best[1].cell)} ({_number(best[1].utility)})"
    )


def _decision(a: EpisodeLog, b: EpisodeLog, moment: Moment) -> str:
    step_a, step_b = _steps(moment)
    one, other = step_a.decision, step_b.decision
    if one is None or other is None:
        return "only one of them decides"
    same_map = (step_a.fused == step_b.fused).all() and (step_a.observed == step_b.observed).all()
    seen = "both saw the same map; " if same_map else ""
    if one.mode is not other.mode:
        seen += f"A is in {one.mode} mode, B in {other.mode} mode; "
    if one.random_draw != other.random_draw and None not in (one.random_draw, other.random_draw):
        seeds = [log.header.at(moment.index).config.seed for log in (a, b)]
        by = f" (seed {seeds[0]} in A, {seeds[1]} in B)" if seeds[0] != seeds[1] else ""
        return (
            f"{seen}the draw differs{by}: A drew {as_text(one.target)}, B {as_text(other.target)}"
        )
    if one.target == other.target:
        return f"{seen}both chose {as_text(one.target)}, on other paths or by another draw"
    theirs = rating(b, step_b, moment.before_b, one.target)
    if theirs is None:
        there = ", which B could not choose"
    else:
        there = f"; B's gain there was {_number(theirs.reward)}, its utility "
        there += _number(theirs.utility)
    return (
        f"{seen}A chose {as_text(one.target)} by {_margin(one)}{there}; "
        f"B chose {as_text(other.target)} by {_margin(other)}"
    )


def _move(_a: EpisodeLog, _b: EpisodeLog, moment: Moment) -> str:
    a, b = _steps(moment)
    if a.decision is None or b.decision is None:
        return f"A is at {as_text(a.agent)}, B at {as_text(b.agent)}"
    return (
        f"from {as_text(a.agent)} A moves to {as_text(a.decision.next_cell)}, "
        f"B to {as_text(b.decision.next_cell)}"
    )


def _end(a: EpisodeLog, b: EpisodeLog, moment: Moment) -> str:
    ended = {
        name: log
        for name, log, step in (("A", a, moment.a), ("B", b, moment.b))
        if step is None or step.outcome is not None
    }
    if not ended:
        return "one of them decides nothing"
    said = [f"{name} ended ({outcome_name(log)})" for name, log in ended.items()]
    return "; ".join(said) + (", the other continues" if len(ended) == 1 else "")


def _record(_a: EpisodeLog, _b: EpisodeLog, moment: Moment) -> str:
    a, b = _steps(moment)
    first = next(iter(step_differences(a, b)), None)
    if first is None:
        return "the same happened, and is recorded otherwise"
    return (
        f"the same happened, but {first.what} is {as_text(first.logged)} in A, "
        f"{as_text(first.expected)} in B"
    )


_TEXTS: Final = {
    Layer.START: _start,
    Layer.OBSERVATION: _observation,
    Layer.PREDICTION: _prediction,
    Layer.FUSED: _fused,
    Layer.RANKING: _ranking,
    Layer.DECISION: _decision,
    Layer.MOVE: _move,
    Layer.END: _end,
    Layer.RECORD: _record,
}


def rating(log: EpisodeLog, step: Step, before: Decision | None, cell: Cell) -> Candidate | None:
    """How the planner of `log` rated a frontier cell at `step`; None if it is none of its own.

    Logged for the chosen one and its best rivals; for others the planner is asked again, if it
    is installed and gives the same answer as then. `before` is the decision before.
    """
    decision = step.decision
    if decision is None:
        return None
    for candidate in (decision.chosen, *decision.rivals):
        if candidate.cell == cell:
            return candidate
    header = log.header.at(step.index)
    if header.config.planner not in plugins.available(plugins.PluginKind.PLANNERS):
        return None
    view = look_around(header.config, step.agent, step.observed, step.fused)
    there = np.flatnonzero((view.frontier == cell).all(axis=1))
    if not len(there):
        return None
    past = Past(
        step.index,
        step.agent,
        Travelled(),
        step.observed,
        before.target if before else None,
        sealed=False,
        corrected=False,
    )
    try:
        planner = planner_of(header)
        choice = ask(header, planner, past, step.observed, step.p_wall, view)
    except MapreplayError:
        return None
    i = int(there[0])
    if choice.utility[choice.index] != decision.chosen.utility:
        return None  # it is not the planner that it was
    row, col = cell
    straight, diagonal = view.paths.straight[row, col], view.paths.diagonal[row, col]
    utility, reward = float(choice.utility[i]), float(choice.reward[i])
    return Candidate(cell, utility, reward, int(straight), int(diagonal))


def _steps(moment: Moment) -> tuple[Step, Step]:
    if moment.a is None or moment.b is None:
        raise ValueError("one of the episodes ended")
    return moment.a, moment.b


def _best(decision: Decision | None) -> Candidate | None:
    if decision is None:
        return None
    return max((decision.chosen, *decision.rivals), key=lambda c: (c.utility, -c.cost))


def _margin(decision: Decision) -> str:
    """The utility of what was chosen over that of the best rival."""
    chosen = decision.chosen.utility
    if decision.random_draw is not None:
        return "chance"
    if not decision.rivals:
        return f"{_number(chosen)}, without a rival"
    return f"{_number(chosen)} over {_number(max(r.utility for r in decision.rivals))}"


def _number(value: float) -> str:
    """Short, but with digits enough to see that two differ."""
    return f"{value:.4g}"


def _name(cell: object) -> str:
    return {-1: "unknown", 0: "free"}.get(int(str(cell)), "occupied")
