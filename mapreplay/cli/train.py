"""`mapreplay train`: train a map predictor."""

from __future__ import annotations

import shlex
import signal
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mapreplay.cli.output import ForceOption, note
from mapreplay.errors import UsageError
from mapreplay.files import check_new
from mapreplay.text import shell_command

if TYPE_CHECKING:
    from mapreplay.training.loop import Trainer


def train(
    out: Annotated[Path, typer.Option("--out", "-o", help="Weights to write: NAME.safetensors.")],
    floorplans: Annotated[
        str | None,
        typer.Option(help="Floor plans to train on; see `mapreplay floorplans --help`."),
    ] = None,
    from_logs: Annotated[
        list[Path] | None,
        typer.Option(
            help="Logs, folders or globs: train on what their agents observed; with --floorplans, "
            "on half of each."
        ),
    ] = None,
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
    architecture: Annotated[
        str, typer.Option(help="The network: autoencoder (the paper's), or unet.")
    ] = "autoencoder",
    loss_region: Annotated[
        str,
        typer.Option(
            help="Cells that count in the loss: all (the paper's), explorable, or nearby (unseen "
            "explorable ones, the nearer to the seen the more)."
        ),
    ] = "all",
    weight_decay: Annotated[float, typer.Option(min=0, help="Of AdamW.")] = 0.0,
    init: Annotated[
        Path | None, typer.Option(help="Weights to start from, instead of random ones.")
    ] = None,
    calibrate: Annotated[
        bool,
        typer.Option("--calibrate", help="At the end, scale the logits to fit the held-out plans."),
    ] = False,
    augment: Annotated[
        bool, typer.Option("--augment", help="Turn and mirror every batch at random.")
    ] = False,
    validate_every: Annotated[
        int, typer.Option(min=1, help="Samples between points of the curve and checkpoints.")
    ] = 25_000,
    device: Annotated[str, typer.Option(help="cpu, cuda, ...")] = "cpu",
    threads: Annotated[int | None, typer.Option(min=1, help="CPU threads of the network.")] = None,
    jobs: Annotated[
        int, typer.Option(min=1, help="Processes that load plans and make the batches.")
    ] = 1,
    bfloat16: Annotated[
        bool, typer.Option("--bfloat16", help="Compute in bfloat16: faster where it is built in.")
    ] = False,
    resume: Annotated[bool, typer.Option("--resume", help="Go on from the checkpoint.")] = False,
    force: ForceOption = False,
) -> None:
    """Train a map predictor on floor plans, or on logs.

    On simulated observations of the floor plans, or on those of the agents that were logged; with
    checkpoints, and a model card beside the weights.
    """
    if floorplans is None and not from_logs:
        raise UsageError("train: give plans to train on, by --floorplans SPEC or --from-logs LOGS")
    if floorplans is None and hold_out:
        raise UsageError("--hold-out: of --floorplans; with --from-logs alone give --validate SPEC")
    if out.suffix != ".safetensors":
        raise UsageError(f"--out {out}: should end in .safetensors")
    if validate is None and hold_out == 0:
        raise UsageError("train: give plans to validate on, by --validate SPEC or --hold-out N")
    if not learning_rate > 0:
        raise UsageError(f"--learning-rate {learning_rate}: should be above 0")
    checkpoint = out.with_suffix(".checkpoint")
    for path in (out, out.with_suffix(".json")):
        check_new(path, force=force)
    check_new(checkpoint, force=True)
    if checkpoint.exists() and not (resume or force):
        raise UsageError(f"{checkpoint} exists; go on with --resume, or start anew with --force")

    import torch

    from mapreplay.cli.training_data import load, load_logs
    from mapreplay.floorplans import by_sha256, open_source, read_ids, select
    from mapreplay.predictors.architectures import ARCHITECTURES
    from mapreplay.predictors.weights import file_sha256, load_tensors
    from mapreplay.training.dataset import LossRegion
    from mapreplay.training.loop import Trainer, TrainingConfig, finish

    if loss_region not in list(LossRegion):
        raise UsageError(f"--loss-region {loss_region}: choose {' or '.join(LossRegion)}")
    if architecture not in ARCHITECTURES:
        raise UsageError(f"--architecture {architecture}: choose {' or '.join(ARCHITECTURES)}")
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
        architecture=architecture,
        weight_decay=weight_decay,
        calibrate=calibrate,
        bfloat16=bfloat16,
        augment=augment,
    )
    wanted: list[str] = []
    if floorplans is not None:
        source = open_source(floorplans, resolution)
        wanted = list(select(source, read_ids(ids) if ids else None, None).ids)
    if validate is not None:
        other = open_source(validate, resolution)
        held_ids = list(other.ids())[:validation_plans]
        held = load("validation", other, held_ids, jobs)
    else:
        held_ids = by_sha256(wanted)[:hold_out]
        held = load("validation", source, sorted(held_ids[:validation_plans]), jobs)
    if not held:
        raise UsageError("nothing to validate on: give --validate or --hold-out")
    apart = frozenset(held_ids)
    plans = []
    if floorplans is not None:
        plans = load("training", source, [i for i in wanted if i not in apart], jobs)
    if from_logs:
        logged = load_logs(from_logs, apart, jobs)
        plans += logged.to_train_on
        held += logged.to_validate_on
    trainer = Trainer(plans, held, config, device, checkpoint, jobs)
    if init is not None:
        trainer.start_from(init)
    if resume and checkpoint.exists():
        trainer.resume()
        note(f"goes on after {trainer.samples} samples")
    elif resume:
        note(f"{checkpoint}: no checkpoint, the training starts from its beginning")
    try:
        with _terminated_like_interrupted():
            _train(trainer)
            card = finish(
                trainer,
                out,
                trained_on=_name(floorplans, from_logs),
                validated_on=validate or f"{len(held)} of {hold_out} held-out plans",
                command=shlex.join(["mapreplay", *(Path(a).name for a in sys.argv[1:])]),
                force=force,
            )
    except KeyboardInterrupt:
        there = checkpoint.exists()
        again = f"to go on, repeat the command with --resume ({checkpoint})"
        note(f"stopped; {again}" if there else "stopped before the first checkpoint")
        raise
    note(f"weights: {out} (sha256 {card.sha256[:12]}), card: {out.with_suffix('.json')}")
    note(f"next: {shell_command(['mapreplay', 'run', '--predictor', out])}")


def _train(trainer: Trainer) -> None:
    """Train to the end, with a bar, and the curve on stderr."""
    from mapreplay.cli.progress import progress_bar
    from mapreplay.training.loop import CurvePoint

    with closing(trainer.run()) as reports, progress_bar("rate") as bar:
        task = bar.add_task(
            "training", total=trainer.config.samples, completed=trainer.samples, rate=""
        )
        for report in reports:
            if isinstance(report, CurvePoint):
                note(
                    f"{report.samples:>9} samples  train {report.train_loss:.4f}  "
                    f"validation {report.validation_loss:.4f}  F1 {report.validation_f1:.4f}"
                )
            else:
                bar.update(task, completed=report)


@contextmanager
def _terminated_like_interrupted() -> Iterator[None]:
    """A queue or service that stops a training sends SIGTERM: it ends like with Ctrl-C."""

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _name(floorplans: str | None, logs: list[Path] | None) -> str:
    """What was trained on, with no folder of this machine."""
    names = [floorplans if "/" not in floorplans else Path(floorplans).name] if floorplans else []
    names += [f"logs {path.name}" for path in logs or []]
    return ", ".join(names)
