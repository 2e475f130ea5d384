"""The wall share of procedural plans (D1) next to that of HouseExpo houses (D2).

    python docs/figures/wall_share.py HOUSEEXPO_ARCHIVE [-o wall_share.png]

The paper calls D1 the dataset of low variance, and shows it by this figure. The wall share
of a floor plan is the occupied share of the cells that are explorable from its default start.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
import numpy.typing as npt

mpl.use("Agg")

import matplotlib.pyplot as plt

from mapreplay.errors import FloorPlanError
from mapreplay.floorplans import FloorPlanSource, open_source

PLANS = 1_000
FIRST_SEED = 60_000


def wall_shares(source: FloorPlanSource) -> npt.NDArray[np.float64]:
    """float64[n]: the wall shares of the first 1,000 plans of `source` that it does not refuse."""
    shares: list[float] = []
    for floor_plan_id in source.ids():
        try:
            shares.append(source.load(floor_plan_id).wall_share)
        except FloorPlanError as error:
            sys.stderr.write(f"left out: {error}\n")
        if len(shares) == PLANS:
            break
    return np.array(shares)


def summary(shares: npt.NDArray[np.float64]) -> str:
    """Mean, standard deviation and the range of the middle 90 %, in per cent."""
    low, high = np.percentile(100 * shares, [5, 95])
    return (
        f"mean {100 * shares.mean():.1f} %, sd {100 * shares.std(ddof=1):.2f} %, "
        f"5-95 %: {low:.1f}-{high:.1f} %"
    )


def draw(d1: npt.NDArray[np.float64], d2: npt.NDArray[np.float64], path: Path) -> None:
    """Draw both distributions on one axis and write a PNG."""
    figure, axes = plt.subplots(figsize=(7, 3.2), layout="constrained")
    bins = np.arange(0, 100 * max(d1.max(), d2.max()) + 0.5, 0.5)
    for shares, colour, label in (
        (d2, "#d95f02", "HouseExpo (D2)"),
        (d1, "#1f5a92", "procedural (D1)"),
    ):
        axes.hist(
            100 * shares,
            bins.tolist(),
            color=colour,
            alpha=0.75,
            label=f"{label}\n{summary(shares)}",
        )
    axes.set_xlabel("wall share: occupied part of the explorable cells (%)")
    axes.set_ylabel(f"floor plans (of {PLANS:,} each)")
    axes.set_xlim(0, None)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, loc="upper right", fontsize=9)
    figure.savefig(path, dpi=150)


def main() -> None:
    """Draw the figure, and print its numbers."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("archive", help="HouseExpo's json.tar.gz")
    parser.add_argument("-o", "--output", type=Path, default=Path(__file__).with_suffix(".png"))
    options = parser.parse_args()
    d1 = wall_shares(open_source(f"procedural:{FIRST_SEED}-{FIRST_SEED + PLANS - 1}"))
    d2 = wall_shares(open_source(f"houseexpo:{options.archive}", resolution=0.2))
    draw(d1, d2, options.output)
    for label, shares in (("procedural (D1)", d1), ("HouseExpo (D2)", d2)):
        sys.stdout.write(f"{label}: {shares.size} floor plans, {summary(shares)}\n")


if __name__ == "__main__":
    main()
