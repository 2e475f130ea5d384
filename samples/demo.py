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

from mapreplay.analysis.episodes import episode_row
from mapreplay.analysis.reduction import Pair, mean_reduction, pair_episodes
from mapreplay.recorders.log import find_logs

FLOOR_PLANS = "procedural:60000-60004"
OUT = Path("runs/demo")
OBSERVED = ["--planner", "nearest", "--plan-on", "observed", "--build", "observed"]
FUSED = ["--planner", "cost-utility", "--plan-on", "fused", "--build", "fused", "--fail-safe"]


def mapreplay(*arguments: str) -> None:
    """Run the command line as a user would, and show what is run."""
    print(f"$ mapreplay {shlex.join(arguments)}", flush=True)
    command = [sys.executable, "-m", "mapreplay", *arguments]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)  # noqa: S603 (our own words)


def table(pairs: list[Pair]) -> Table:
    """Both episodes of each floor plan side by side."""
    result = Table(
        "floor plan", "", "steps", "path m", "cover", "correct", "F1", "outcome", "saved",
        box=box.SIMPLE_HEAD, pad_edge=False, padding=0,
    )  # fmt: skip
    for pair in pairs:
        for label, row in (("observed", pair.reference), ("fused", pair.candidate)):
            result.add_row(
                row.floor_plan if label == "observed" else "",
                label,
                str(row.steps),
                f"{row.path_length:.1f}",
                f"{row.coverage:.3f}",
                f"{row.correct:.3f}",
                f"{row.f1:.3f}",
                row.outcome,
                f"{pair.reduction:.0%}" if label == "fused" else "",
            )
    return result


def main() -> None:
    """Record, compare, and say what to type next."""
    shutil.rmtree(OUT, ignore_errors=True)
    for name, options in (("observed", OBSERVED), ("fused", FUSED)):
        mapreplay("run", *options, "--floorplans", FLOOR_PLANS, "--out", f"{OUT}/{name}")
    rows = {
        name: [episode_row(path) for path in find_logs([OUT / name])]
        for name in ("observed", "fused")
    }
    pairs = pair_episodes(rows["observed"], rows["fused"])
    console = Console(highlight=False)
    console.print("\nNearest Frontier on observations, Cost-Utility on predictions:\n")
    console.print(table(pairs))
    saved = mean_reduction(pairs)
    console.print(
        f"Mean reduction of mapping time: {saved.mean:.0%} "
        f"(95 % interval {saved.low:.0%} to {saved.high:.0%}, {saved.plans} floor plans)."
    )
    first = pairs[0].candidate.file
    console.print(f"\nThe logs are in {OUT}. Next:", soft_wrap=True)
    for line in (f"view {first}", f"info {first}", f"metrics {first}", f"ls {OUT}"):
        console.print(f"  .venv/bin/mapreplay {line}", soft_wrap=True)


if __name__ == "__main__":
    main()
