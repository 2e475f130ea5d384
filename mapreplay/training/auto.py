"""Training of the classifier that the predictor `auto` chooses by.

    python -m mapreplay.training.auto --houses HOUSES.tar.gz --ids map_id_train.txt -o auto.json

Examples are observed maps as agents make them: Nearest Frontier and Cost-Utility exploring on
observations, and the random trees of observations that the networks are trained on. The plans
are D1, D2 without the held-out houses, and others that are of neither kind.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
import torch
from torch.nn import functional

from mapreplay.config import EpisodeConfig, MapKind
from mapreplay.episode import prepare_episode, run_episode
from mapreplay.errors import FloorPlanError
from mapreplay.floorplan import FloorPlan, explorable
from mapreplay.floorplans import by_sha256, open_source, read_ids
from mapreplay.floorplans.procedural import generate
from mapreplay.grid import FREE, Grid
from mapreplay.predictors.auto import Classifier, PlanKind, save_classifier
from mapreplay.predictors.auto_features import count_words
from mapreplay.sensor import Sensor
from mapreplay.training.dataset import prepare_plan
from mapreplay.training.observations import observation_draws, simulate_observations
from mapreplay.training.other_plans import DRAWN

SNAPSHOTS: Final = (0, 1, 2, 5, 10, 20, 50, 100, 200)
"""Steps of an episode whose observed maps are examples."""
TREES: Final = 4
"""Random trees of observations per plan."""
FINE: Final = 0.1
COARSE: Final = 0.4
"""Metres per cell of the houses of neither kind; the predictors' is 0.2."""
HIDDEN: Final = 16
SURE: Final = 0.95
"""See `Classifier.sure`."""


@dataclass(frozen=True, eq=False)
class Examples:
    """Observed maps of floor plans of one sort, as counts of words."""

    counts: npt.NDArray[np.int64]
    """int64[n, 126]."""
    steps: npt.NDArray[np.int64]
    """int64[n]: the step of the episode; -1 for a tree."""
    plans: npt.NDArray[np.int64]
    """int64[n]: number of the plan."""


def observe(plans: Iterable[FloorPlan], seed: int) -> Examples:
    """The observed maps of agents on `plans` after some steps."""
    counts, steps, numbers = [], [], []
    for number, plan in enumerate(plans):
        for step, observed in snapshots(plan, number, seed):
            counts.append(count_words(observed))
            steps.append(step)
            numbers.append(number)
    return Examples(np.array(counts), np.array(steps), np.array(numbers))


def snapshots(plan: FloorPlan, number: int, seed: int) -> Iterator[tuple[int, Grid]]:
    """(step, int8[H, W] observed) of random trees on a plan (step -1) and, on every fourth, of an
    episode; half of the episodes start at a random cell.
    """
    known = prepare_plan(number, plan)
    for run in range(TREES):
        draws = observation_draws(seed, number, run)
        yield -1, simulate_observations(known.truth, known.explorable, Sensor(), draws)
    if number % 4:
        return
    start = None
    if number % 8:
        cells = np.argwhere(explorable(plan.cells, plan.default_start) & (plan.cells == FREE))
        row, col = cells[np.random.default_rng([seed, number]).integers(len(cells))].tolist()
        start = (row, col)
    config = EpisodeConfig(
        planner="cost-utility" if number % 16 < 8 else "nearest",
        plan_on=MapKind.OBSERVED,
        build=MapKind.OBSERVED,
        start=start,
        max_steps=SNAPSHOTS[-1],
    )
    steps = run_episode(prepare_episode(config, plan))
    yield from ((step.index, step.observed) for step in steps if step.index in SNAPSHOTS)


def fit(examples: Mapping[str, Examples], seed: int) -> Classifier:
    """The classifier that fits `examples`, by the name of their sort.

    Each kind weighs the same, and each sort within a kind. One hidden layer, cross-entropy with
    weight decay, Adam on all examples at once.
    """
    torch.manual_seed(seed)
    sorts = {kind: [name for name in examples if kind_of(name) is kind] for kind in PlanKind}
    inputs = np.log1p(np.concatenate([part.counts for part in examples.values()]))
    mean, scale = inputs.mean(axis=0), inputs.std(axis=0) + 0.05
    x = torch.from_numpy(((inputs - mean) / scale).astype(np.float32))
    y = torch.cat(
        [
            torch.full((len(part.counts),), list(PlanKind).index(kind_of(name)))
            for name, part in examples.items()
        ]
    )
    share = torch.cat(
        [
            torch.full((len(part.counts),), 1 / (3 * len(sorts[kind_of(name)]) * len(part.counts)))
            for name, part in examples.items()
        ]
    )
    hidden, out = torch.nn.Linear(x.shape[1], HIDDEN), torch.nn.Linear(HIDDEN, len(PlanKind))
    optimizer = torch.optim.AdamW(
        [*hidden.parameters(), *out.parameters()], lr=1e-2, weight_decay=WEIGHT_DECAY
    )
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, ROUNDS)
    for _ in range(ROUNDS):
        logits = out(functional.relu(hidden(x)))
        loss = (share * functional.cross_entropy(logits, y, reduction="none")).sum()
        optimizer.zero_grad()
        torch.autograd.backward(loss)
        optimizer.step()
        schedule.step()
    # The standardization goes into the first layer.
    first = hidden.weight.detach().double().numpy().T / scale[:, None]
    return Classifier(
        hidden=first,
        hidden_bias=hidden.bias.detach().double().numpy() - mean @ first,
        out=out.weight.detach().double().numpy().T,
        out_bias=out.bias.detach().double().numpy(),
        sure=SURE,
    )


def kind_of(sort: str) -> PlanKind:
    """The kind of the floor plans of that sort."""
    return PlanKind(sort) if sort in (PlanKind.D1, PlanKind.D2) else PlanKind.NEITHER


WEIGHT_DECAY: Final = 0.05
ROUNDS: Final = 600


def houses(archive: Path, ids: list[str], resolution: float) -> Iterator[FloorPlan]:
    """Those houses of a HouseExpo archive that can be read, in its order."""
    source, wanted = open_source(f"houseexpo:{archive}", resolution), set(ids)
    for house in source.ids():
        if house in wanted:
            try:
                yield source.load(house)
            except FloorPlanError as error:
                sys.stderr.write(f"left out: {error}\n")


def examples_of(
    archive: Path, ids: list[str], first: int, count: int, others: int, seed: int
) -> dict[str, Examples]:
    """Examples of every sort: `count` plans of D1 and of D2, `others` of each sort that is
    drawn and of coarse houses, and three times as many fine houses: the hardest to tell from D2.

    Args:
        archive: The HouseExpo archive.
        ids: Houses to take, the first ones of this list.
        first: Number of the first procedural or drawn plan.
        count: Plans of each kind.
        others: Plans of each sort that is of neither kind.
        seed: Seed of the random starts and trees.
    """
    numbers = range(first, first + count)
    found = {
        "d1": observe(map(generate, numbers), seed),
        "d2": observe(houses(archive, ids[:count], 0.2), seed),
    }
    for name, draw in DRAWN.items():
        found[name] = observe(map(draw, numbers[:others]), seed)
    found["fine houses"] = observe(houses(archive, ids[: 3 * others], FINE), seed)
    found["coarse houses"] = observe(houses(archive, ids[:others], COARSE), seed)
    return found


def main() -> None:
    """See the module."""
    parser = argparse.ArgumentParser(prog="python -m mapreplay.training.auto")
    parser.add_argument("--houses", type=Path, required=True, help="HouseExpo's json.tar.gz")
    parser.add_argument("--ids", type=Path, required=True, help="HouseExpo's map_id_train.txt")
    parser.add_argument(
        "--hold-out",
        type=int,
        default=1000,
        help="number of held-out houses, those with the lowest SHA-256",
    )
    parser.add_argument("--plans", type=int, default=600, help="number of plans of D1 and of D2")
    parser.add_argument(
        "--others", type=int, default=120, help="number of plans of each sort of neither kind"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("-o", "--out", type=Path, required=True, help="parameters to write (JSON)")
    options = parser.parse_args()
    torch.set_num_threads(1)
    ids = by_sha256(read_ids(options.ids))[options.hold_out :]
    examples = examples_of(options.houses, ids, 0, options.plans, options.others, options.seed)
    save_classifier(
        fit(examples, options.seed),
        options.out,
        {
            "trained_on": {name: len(set(e.plans.tolist())) for name, e in examples.items()},
            "examples": sum(len(e.counts) for e in examples.values()),
            "command": " ".join(["python -m mapreplay.training.auto", *sys.argv[1:]]),
        },
    )


if __name__ == "__main__":
    main()
