"""The main job, in one go: what was the prediction worth?

Records the same floor plans twice, with Nearest Frontier on observations and with
Cost-Utility on predictions, and compares them plan by plan. Run it with `make demo`.
"""

from __future__ import annotations

import shlex
import shutil
import subprocess
import sys
from pathlib import Path

from rich import box
from rich.console import Console
from rich.table import Table

from mapreplay.analysis.comparison.compare import Comparison, compare
from mapreplay.analysis.comparison.groups import group_episodes
from mapreplay.analysis.episodes.corpus import read_episode
from mapreplay.recorders.log.find import find_logs

FLOOR_PLANS = "procedural:60000-60004"
OUT = Path("runs/demo")
OBSERVED = ["--planner", "nearest", "--plan-on", "observed", "--build", "observed"]
FUSED = ["--planner", "cost-utility", "--plan-on", "fused", "--build", "fused", "--fail-safe"]


def mapreplay(*arguments: str) -> None:
    """Run the command line as a user would, and show what is run."""
    print(f"$ mapreplay {shlex.join(arguments)}", flush=True)
    command = [sys.executable, "-m", "mapreplay", *arguments]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)  # noqa: S603 (our own words)


def table(comparison: Comparison) -> Table:
    """Both episodes of each floor plan side by side."""
    result = Table(
        "floor plan", "", "steps", "path m", "cover", "correct", "F1", "outcome", "saved",
        box=box.SIMPLE_HEAD, pad_edge=False, padding=0,
    )  # fmt: skip
    reference, candidate = comparison.groups
    for i, place in enumerate(comparison.places):
        times = [group.values["mapping time"][i] for group in comparison.groups]
        for group in comparison.groups:
            (episode,) = comparison.episodes[group.name][place]
            row = episode.row
            result.add_row(
                row.floor_plan if group is reference else "",
                row.build,
                str(row.steps),
                f"{row.path_length:.1f}",
                f"{row.coverage:.3f}",
                f"{row.correct:.3f}",
                f"{row.f1:.3f}",
                row.outcome,
                f"{1 - times[1] / times[0]:.0%}" if group is candidate else "",
            )
    return result


def main() -> None:
    """Record, compare, and say what to type next."""
    shutil.rmtree(OUT, ignore_errors=True)
    for name, options in (("observed", OBSERVED), ("fused", FUSED)):
        mapreplay("run", *options, "--floorplans", FLOOR_PLANS, "--out", f"{OUT}/{name}")
    episodes = [read_episode(path) for path in find_logs([OUT])]
    comparison = compare(group_episodes(episodes, ["build"]), "observed")
    console = Console(highlight=False)
    console.print("\nNearest Frontier on observations, Cost-Utility on predictions:\n")
    console.print(table(comparison))
    saved = comparison.savings[0].reduction
    console.print(
        f"Mean reduction of mapping time: {saved.mean:.0%} "
        f"(95 % interval {saved.low:.0%} to {saved.high:.0%}, {saved.plans} floor plans)."
    )
    first = comparison.episodes["fused"][comparison.places[0]][0].path
    console.print(f"\nThe logs are in {OUT}. Next:", soft_wrap=True)
    for line in (
        f"view {first}",
        f"info {first}",
        f"compare {OUT} --html runs/demo.html",
        f"ls {OUT}",
    ):
        console.print(f"  .venv/bin/mapreplay {line}", soft_wrap=True)


if __name__ == "__main__":
    main()
