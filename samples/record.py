"""Records the episodes in samples/ again, and says how they ended: run it from the repository.

To be run whenever the predictor's weights or the numbers of its kernels change. How the
episodes end is also said in samples/README.md and in tests/recorders/log/test_samples.py.
"""

from __future__ import annotations

import shlex
import subprocess
import sys
from pathlib import Path

from mapreplay.recorders.log.find import find_logs
from mapreplay.recorders.log.reader import EpisodeLog

EPISODES = Path(__file__).parent / "episodes"
COMMANDS = (
    "--planner nearest --plan-on observed --build observed --floorplans procedural:60002",
    "--planner cost-utility --fail-safe --floorplans procedural:60002",
    "--planner cost-utility --delta-free .7 --delta-occupied .7 --floorplans procedural:60014",
)


def main() -> None:
    """Record over what is there."""
    for options in COMMANDS:
        print(f"$ mapreplay run {options} --out samples/episodes --force", flush=True)
        run = [sys.executable, "-m", "mapreplay", "run", *shlex.split(options)]
        subprocess.run([*run, "--out", str(EPISODES), "--force"], check=True)  # noqa: S603 (our own words)
    for path in find_logs([EPISODES]):
        log = EpisodeLog(path)
        steps = log.summary.steps if log.summary else None
        print(f'"{path.name}": ("{log.outcome}", {steps}),')


if __name__ == "__main__":
    main()
