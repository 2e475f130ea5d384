"""What low thresholds with the fail-safe cost and gain, plan by plan.

    python samples/experiments/fail_safe_cost.py LOW.csv SAFE.csv PAPER.csv

The first two are what `mapreplay ls --format csv` says of the episodes without the fail-safe, and
of those of them that were sealed in, recorded again with it: the fail-safe changes nothing before
the first sealing, so that the others are the same with it. The third is what it says of the same
planner with the fail-safe at the default thresholds, from the logs of `mapreplay experiment paper`:
``mapreplay ls runs/paper/logs/D1/cost-utility__fused-fused__d1+fail-safe --format csv``.
"""

import csv
import sys
from pathlib import Path

import numpy as np

from mapreplay.analysis.reporting.wording import percent, with_interval
from mapreplay.analysis.stats.estimates import (
    mean_interval,
    paired_difference,
    paired_reduction,
    restricted_mean_difference,
)

low_file, safe_file, paper_file = (Path(name) for name in sys.argv[1:4])
low = {row["floor_plan"]: row for row in csv.DictReader(low_file.open())}
safe = {row["floor_plan"]: row for row in csv.DictReader(safe_file.open())}
first = next(iter(low.values()))
sealed = [plan for plan, row in low.items() if row["outcome"] == "sealed_in"]
if sorted(sealed) != sorted(safe):
    sys.exit(f"{safe_file}: should have the plans that are sealed in in {low_file}, and no others")
if any(row["outcome"] != "mapped" for row in safe.values()):
    print("with the fail-safe, not all were mapped: these count with all their steps")
times = {plan: float(safe.get(plan, row)["steps"]) for plan, row in low.items()}
defaults = {
    row["floor_plan"]: float(row["steps"])
    for row in csv.DictReader(paper_file.open())
    if (row["planner"], row["predictor"]) == (first["planner"], first["predictor"])
}


def said(what: str, value: str) -> None:
    """One line."""
    print(f"  {what:<52} {value}")


print(f"{first['predictor']}, {first['planner']}: {len(low)} plans, sealed in on {len(sealed)}")
of_sealed = np.array([times[plan] for plan in sealed])
budget = np.array([float(low[plan]["max_steps"]) for plan in sealed])
said("steps to map those plans, with the fail-safe", with_interval(mean_interval(of_sealed), 0))
saved = restricted_mean_difference(of_sealed, np.full(len(sealed), np.inf), budget)
said("less than without it, where it takes the budget", with_interval(saved, 0))
both = [plan for plan in low if plan in defaults]
a, b = (np.array([of[plan] for plan in both]) for of in (times, defaults))
print(f"  on the {len(both)} plans that were run at the default thresholds too:")
said("steps, low thresholds with the fail-safe", with_interval(mean_interval(a), 0))
said("steps, default thresholds with the fail-safe", with_interval(mean_interval(b), 0))
said("difference", with_interval(paired_difference(a, b), 0))
said("reduction", percent(paired_reduction(a, b)))
was = np.isin(both, sealed)
if was.any():
    said(f"reduction on {was.sum()} where low ones seal", percent(paired_reduction(a[was], b[was])))
    said(f"reduction on {(~was).sum()} others", percent(paired_reduction(a[~was], b[~was])))
