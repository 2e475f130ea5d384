"""What the predictor `auto` chooses, step by step, and the time that saves: tables and a figure.

    python docs/figures/auto.py measure --floorplans procedural:50000-50039 d1.jsonl
    python docs/figures/auto.py measure --floorplans HOUSES.tar.gz --ids VALIDATION.txt d2.jsonl
    python docs/figures/auto.py show d1.jsonl d2.jsonl -o auto.png

`measure` explores every floor plan with Nearest Frontier on observations and with Cost-Utility
on fused/fused with the fail-safe and each of ``--predictors``, records no log, and appends a
line a run to a file; runs that are in the file already are not run again.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt

from mapreplay.analysis.stats.estimates import Estimate, mean_interval, paired_reduction, proportion
from mapreplay.config import EpisodeConfig, MapKind
from mapreplay.episode import prepare_episode, record
from mapreplay.floorplan import FloorPlan
from mapreplay.floorplans import open_source, read_ids, select
from mapreplay.grid import Grid
from mapreplay.predictors import Predictor, choice_of, load_predictor
from mapreplay.predictors.auto import PREDICTOR_OF
from mapreplay.stages import chosen_at
from mapreplay.step import PredictorIdentity, Step

REFERENCE = "observed"
"""Nearest Frontier on observed/observed, among the names of predictors."""
WATCHED = "watched"
"""Cost-Utility on observed/observed, while `auto` says what it would choose."""
CHOICES = (*PREDICTOR_OF.values(), "unsure")
STEPS = (0, 1, 2, 5, 10, 20, 50, 100, 200)


class Watcher:
    """Says what `auto` would choose, and predicts nothing."""

    def __init__(self) -> None:
        self._auto = load_predictor("auto")
        self.identity = PredictorIdentity(WATCHED, self._auto.identity.sha256)

    def predict(self, observed: Grid) -> None:
        """See `mapreplay.predictors.Predictor`."""

    def choice(self, observed: Grid) -> str | None:
        """See `mapreplay.predictors.Choosing`."""
        return choice_of(self._auto, observed)


def predictor_called(name: str) -> Predictor:
    """The registered one, or that of the reference or the watched run."""
    return Watcher() if name == WATCHED else load_predictor("none" if name == REFERENCE else name)


class Choices:
    """What `auto` chose, where it changed its mind: (step, choice)."""

    def __init__(self) -> None:
        self.made: list[tuple[int, str]] = []

    def add(self, step: Step) -> None:
        """See `mapreplay.episode.StepSink`."""
        chosen = chosen_at(step)
        if chosen is not None:
            self.made.append((step.index, chosen))


@dataclass(frozen=True)
class Run:
    """One episode."""

    floor_plan: str
    start: tuple[int, int] | None
    predictor: str
    sha256: str
    time: int
    """Mapping time in steps; the budget where the target was not reached."""
    outcome: str
    correct: float
    """Correct coverage at the end."""
    choices: list[tuple[int, str]]
    """(step, what was chosen from there on)."""

    def chosen(self, step: int) -> str:
        """What was chosen at `step`: one of `CHOICES`. After the end, that of the end."""
        said = [text for index, text in self.choices if index <= step]
        return said[-1].split()[0].rstrip(":") if said else ""


def explore(
    plan: FloorPlan, name: str, start: tuple[int, int] | None, max_steps: int | None
) -> Run:
    """Explore `plan` from `start` to the end."""
    predictor = predictor_called(name)
    if name == REFERENCE:
        config = EpisodeConfig(
            planner="nearest", plan_on=MapKind.OBSERVED, build=MapKind.OBSERVED, start=start,
            max_steps=max_steps,
        )  # fmt: skip
    elif name == WATCHED:
        config = EpisodeConfig(
            plan_on=MapKind.OBSERVED, build=MapKind.OBSERVED, start=start, max_steps=max_steps
        )
    else:
        config = EpisodeConfig(
            planner="cost-utility", predictor=name, fail_safe=True, start=start,
            max_steps=max_steps,
        )  # fmt: skip
    choices = Choices()
    last = record(prepare_episode(config, plan, predictor=predictor), choices)
    return Run(
        plan.id, start, name, predictor.identity.sha256, max(last.index, 1), str(last.outcome),
        last.metrics.correct_coverage_fused, choices.made,
    )  # fmt: skip


def read_runs(path: Path) -> list[Run]:
    """The runs in a file that `measure` wrote."""
    lines = path.read_text().splitlines() if path.exists() else []
    runs = [Run(**json.loads(line)) for line in lines]
    # The latest of two with one name counts: the weights may have changed.
    return list({(run.floor_plan, str(run.start), run.predictor): run for run in runs}.values())


def measure(options: argparse.Namespace) -> None:
    """Run what is not in the file yet."""
    source = open_source(options.floorplans, options.resolution)
    ids = select(source, read_ids(options.ids) if options.ids else None, options.count).ids
    done = {(r.floor_plan, str(r.start), r.predictor, r.sha256) for r in read_runs(options.file)}
    starts = [[int(part) for part in text.split(",")] for text in options.start] or [None]
    hashes = {name: predictor_called(name).identity.sha256 for name in options.predictors}
    for floor_plan_id in ids:
        plan = source.load(floor_plan_id)
        for start in starts:
            for name in options.predictors:
                if (plan.id, str(start), name, hashes[name]) in done:
                    continue
                run = explore(plan, name, start, options.max_steps)
                with options.file.open("a") as file:
                    file.write(json.dumps(asdict(run)) + "\n")
                sys.stderr.write(f"{plan.id} {start} {name}: {run.time} steps, {run.choices}\n")


def saved(runs: Sequence[Run], candidate: str, reference: str) -> Estimate:
    """Mean over floor plans of 1 - T(candidate) / T(reference), with its paired interval."""
    times = {
        name: {(r.floor_plan, str(r.start)): r.time for r in runs if r.predictor == name}
        for name in (candidate, reference)
    }
    both = [key for key in times[reference] if key in times[candidate]]
    return paired_reduction(
        [times[candidate][key] for key in both], [times[reference][key] for key in both]
    )


def percent(estimate: Estimate) -> str:
    """``12.3 [8.4, 15.0]``."""
    value, low, high = (100 * x for x in (estimate.mean, estimate.low, estimate.high))
    return f"{value:.1f} [{low:.1f}, {high:.1f}]"


def worth_table(name: str, runs: Sequence[Run]) -> Iterator[str]:
    """What each predictor saves, how correct its map is at the end, and auto compared with it."""
    yield f"| {name} | plans | time saved, % | against none, % | correct at the end | auto's time |"
    yield "|---|---|---|---|---|---|"
    for predictor in sorted({run.predictor for run in runs}):
        own = [run for run in runs if run.predictor == predictor]
        right = mean_interval([run.correct for run in own])
        cells = [
            percent(saved(runs, candidate, reference)) if candidate != reference else ""
            for candidate, reference in (
                (predictor, REFERENCE),
                (predictor, "none"),
                ("auto", predictor),
            )
        ]
        end = f"{right.mean:.3f} [{right.low:.3f}, {right.high:.3f}]"
        yield f"| {predictor} | {len(own)} | {cells[0]} | {cells[1]} | {end} | {cells[2]} |"


def choosing(runs: Sequence[Run]) -> list[Run]:
    """Those that say what was chosen."""
    return [run for run in runs if run.choices]


def choice_table(name: str, runs: Sequence[Run]) -> Iterator[str]:
    """The share of floor plans of each choice after some steps, with 95 % Wilson intervals."""
    own = choosing(runs)
    yield f"| {name}, step | " + " | ".join(f"{choice} %" for choice in CHOICES) + " |"
    yield "|---|---|---|---|"
    for step in STEPS:
        cells = []
        for choice in CHOICES:
            p = proportion(sum(run.chosen(step) == choice for run in own), len(own))
            cells.append(f"{100 * p.share:.0f} [{100 * p.low:.0f}, {100 * p.high:.0f}]")
        yield f"| {step} | " + " | ".join(cells) + " |"
    changes = [len(run.choices) - 1 for run in own]
    yield f"\nchanges of mind a plan: mean {sum(changes) / len(own):.1f}, most {max(changes)}\n"


def draw(groups: dict[str, list[Run]], path: Path) -> None:
    """The shares over the steps, a panel for each file."""
    figure, _ = plt.subplots(
        1, len(groups), figsize=(3.4 * len(groups), 3.0), sharey=True, layout="constrained"
    )
    for panel, (name, runs) in zip(figure.axes, groups.items(), strict=True):
        own = choosing(runs)
        steps = range(201)
        shares = [
            [100 * sum(run.chosen(step) == choice for run in own) / len(own) for step in steps]
            for choice in CHOICES
        ]
        panel.stackplot(
            steps, shares, labels=CHOICES,
            colors=["#1f5a92", "#d95f02", "#d9d9d9"],
        )  # fmt: skip
        panel.set(title=f"{name} ({len(own)} runs)", xlabel="step", xlim=(0, 200), ylim=(0, 100))
        panel.set_xscale("symlog", linthresh=10)
        panel.set_xticks([0, 5, 10, 50, 100, 200], ["0", "5", "10", "50", "100", "200"])
    figure.axes[0].set_ylabel("% of runs")
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels), fontsize="small")
    figure.savefig(path, dpi=130)


def show(options: argparse.Namespace) -> None:
    """Print the tables of some files, and draw the figure."""
    groups = {path.stem: read_runs(path) for path in options.files}
    for name, runs in groups.items():
        if choosing(runs):
            print(*choice_table(name, runs), sep="\n")
        if any(run.predictor == "none" for run in runs):
            print(*worth_table(name, runs), "", sep="\n")
    if options.output:
        draw(groups, options.output)


def main() -> None:
    """See the module."""
    parser = argparse.ArgumentParser(prog="auto.py", description=__doc__.partition("\n")[0])
    verbs = parser.add_subparsers(required=True)
    of_measure = verbs.add_parser("measure")
    of_measure.add_argument("--floorplans", required=True)
    of_measure.add_argument("--ids", type=Path)
    of_measure.add_argument("--count", type=int, help="floor plans at most")
    of_measure.add_argument("--resolution", type=float)
    of_measure.add_argument("--start", action="append", default=[], help="ROW,COL; repeatable")
    of_measure.add_argument("--max-steps", type=int)
    of_measure.add_argument(
        "--predictors", nargs="+", default=[REFERENCE, "none", "d1", "d2", "auto"]
    )
    of_measure.add_argument("file", type=Path)
    of_measure.set_defaults(run=measure)
    of_show = verbs.add_parser("show")
    of_show.add_argument("files", type=Path, nargs="+")
    of_show.add_argument("-o", "--output", type=Path)
    of_show.set_defaults(run=show)
    options = parser.parse_args()
    options.run(options)


if __name__ == "__main__":
    main()
