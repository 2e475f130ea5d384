"""`mapreplay train`: train the paper's network."""

from __future__ import annotations

import hashlib
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mapreplay.cli.output import ForceOption, note
from mapreplay.errors import FloorPlanError, UsageError

if TYPE_CHECKING:
    from mapreplay.floorplans import FloorPlanSource
    from mapreplay.training.dataset import TrainingPlan


def train(
    floorplans: Annotated[
        str, typer.Option(help="Floor plans to train on; see `mapreplay floorplans --help`.")
    ],
    out: Annotated[Path, typer.Option(help="Weights to write: NAME.safetensors.")],
    ids: Annotated[Path | None, typer.Option(help="File with one id a line.")] = None,
    validate: Annotated[
        str | None,
        typer.Option(help="Other floor plans, for the held-out curve; this or --hold-out."),
    ] = None,
    hold_out: Annotated[
        int,
        typer.Option(min=0, help="Instead: hold out so many plans, those of least SHA-256 of id."),
    ] = 0,
    validation_plans: Annotated[
        int, typer.Option(min=1, help="How many held-out plans the curve is measured on.")
    ] = 200,
    resolution: Annotated[float | None, typer.Option(help="Metres a cell.")] = None,
    samples: Annotated[int, typer.Option(min=1, help="Observation maps to train on.")] = 400_000,
    batch: Annotated[int, typer.Option(min=1, help="Maps of 64 x 64 cells a batch.")] = 32,
    learning_rate: Annotated[float, typer.Option(help="Peak.")] = 2e-3,
    seed: Annotated[int, typer.Option(min=0, help="Of weights, order and observations.")] = 0,
    loss_region: Annotated[
        str,
        typer.Option(help="Cells that count in the loss: all (the paper's), or explorable."),
    ] = "all",
    init: Annotated[
        Path | None, typer.Option(help="Weights to start from, instead of random ones.")
    ] = None,
    validate_every: Annotated[
        int, typer.Option(min=1, help="Samples between points of the curve and checkpoints.")
    ] = 25_000,
    device: Annotated[str, typer.Option(help="cpu, cuda, ...")] = "cpu",
    threads: Annotated[int | None, typer.Option(min=1, help="CPU threads.")] = None,
    bfloat16: Annotated[
        bool, typer.Option("--bfloat16", help="Compute in bfloat16: faster where it is built in.")
    ] = False,
    resume: Annotated[bool, typer.Option("--resume", help="Go on from the checkpoint.")] = False,
    force: ForceOption = False,
) -> None:
    """Train a map predictor on floor plans.

    On simulated observations of them; with checkpoints, and a model card beside the weights.
    """
    if out.suffix != ".safetensors":
        raise UsageError(f"--out {out}: should end in .safetensors")
    if validate is None and hold_out == 0:
        raise UsageError("train: give plans to validate on, by --validate SPEC or --hold-out N")
    if out.exists() and not force:
        raise UsageError(f"{out} exists; choose another name, or --force")
    checkpoint = out.with_suffix(".checkpoint")
    if checkpoint.exists() and not (resume or force):
        raise UsageError(f"{checkpoint} exists; go on with --resume, or start anew with --force")
    if not out.parent.is_dir():
        raise UsageError(f"{out.parent}: no such folder")

    import torch

    from mapreplay.cli.progress import progress_bar
    from mapreplay.floorplans import open_source, read_ids, select
    from mapreplay.predictors.weights import file_sha256, load_tensors
    from mapreplay.training.loop import CurvePoint, LossRegion, Trainer, TrainingConfig, finish

    if loss_region not in list(LossRegion):
        raise UsageError(f"--loss-region {loss_region}: choose {' or '.join(LossRegion)}")
    if init is not None:
        load_tensors(init)  # refused now, and not when all plans are loaded
    if threads is not None:
        torch.set_num_threads(threads)
    config = TrainingConfig(
        samples=samples,
        batch=batch,
        learning_rate=learning_rate,
        seed=seed,
        validate_every=validate_every,
        loss_region=LossRegion(loss_region),
        init_sha256=file_sha256(init) if init else "",
        bfloat16=bfloat16,
    )
    source = open_source(floorplans, resolution)
    wanted = list(select(source, read_ids(ids) if ids else None, None).ids)
    if validate is not None:
        other = open_source(validate, resolution)
        held = _load("validation", other, list(other.ids())[:validation_plans])
    else:
        held_ids = sorted(wanted, key=lambda i: hashlib.sha256(i.encode()).hexdigest())[:hold_out]
        wanted = [i for i in wanted if i not in set(held_ids)]
        held = _load("validation", source, sorted(held_ids[:validation_plans]))
    if not held:
        raise UsageError("nothing to validate on: give --validate or --hold-out")
    trainer = Trainer(_load("training", source, wanted), held, config, device, checkpoint)
    if init is not None:
        trainer.start_from(init)
    if resume and checkpoint.exists():
        trainer.resume()
        note(f"goes on after {trainer.samples} samples")
    with progress_bar("rate") as bar:
        task = bar.add_task("training", total=samples, completed=trainer.samples, rate="")
        for report in trainer.run():
            if isinstance(report, CurvePoint):
                note(
                    f"{report.samples:>9} samples  train {report.train_loss:.4f}  "
                    f"validation {report.validation_loss:.4f}  F1 {report.validation_f1:.4f}"
                )
            else:
                bar.update(task, completed=report)
    card = finish(
        trainer,
        out,
        trained_on=floorplans if "/" not in floorplans else Path(floorplans).name,
        validated_on=validate or f"{len(held)} of {hold_out} held-out plans",
        command=shlex.join(["mapreplay", *(Path(a).name for a in sys.argv[1:])]),
    )
    note(f"weights: {out} (sha256 {card.sha256[:12]}), card: {out.with_suffix('.json')}")
    note(f"next: mapreplay run --predictor {out}")


def _load(what: str, source: FloorPlanSource, ids: Sequence[str]) -> list[TrainingPlan]:
    """The plans that can be read, with a progress bar; the others are counted on stderr."""
    from mapreplay.cli.progress import progress_bar
    from mapreplay.training.dataset import load_plans

    plans, refused = [], []
    with progress_bar() as bar:
        for plan in bar.track(load_plans(ids, source.load), len(ids), description=f"{what} plans"):
            if isinstance(plan, FloorPlanError):
                refused.append(str(plan))
            else:
                plans.append(plan)
    if refused:
        note(f"{len(refused)} {what} plans were refused, such as: {refused[0]}")
    if not plans and ids:
        raise FloorPlanError(f"no {what} plan is left ({refused[0]})")
    return plans
