"""`mapreplay train`: train a map predictor."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from mapreplay.cli.output import ForceOption, note
from mapreplay.errors import UsageError
from mapreplay.files.whole import check_new
from mapreplay.text import shell_command


def train(
    out: Annotated[Path, typer.Option("--out", "-o", help="Weights to write: NAME.safetensors.")],
    floorplans: Annotated[
        str | None,
        typer.Option(help="Floor plans to train on; see `mapreplay floorplans --help`."),
    ] = None,
    from_logs: Annotated[
        list[Path] | None,
        typer.Option(
            help="Logs, folders or globs: train on the observed maps of their agents; together "
            "with --floorplans, half of the maps are from each."
        ),
    ] = None,
    ids: Annotated[Path | None, typer.Option(help="File with one floor-plan ID per line.")] = None,
    validate: Annotated[
        str | None,
        typer.Option(help="Other floor plans to validate on; alternative to --hold-out."),
    ] = None,
    hold_out: Annotated[
        int,
        typer.Option(
            min=0,
            help="Number of floor plans held out for validation: those whose IDs have the lowest "
            "SHA-256.",
        ),
    ] = 0,
    validation_plans: Annotated[
        int, typer.Option(min=1, help="Maximum number of validation plans.")
    ] = 200,
    resolution: Annotated[
        float | None, typer.Option(help="Metres per cell, for sources that are rasterized.")
    ] = None,
    samples: Annotated[
        int, typer.Option(min=1, help="Number of observed maps to train on.")
    ] = 400_000,
    batch: Annotated[int, typer.Option(min=1, help="Batch size in maps of 64 x 64 cells.")] = 32,
    learning_rate: Annotated[float, typer.Option(help="Peak learning rate.")] = 2e-3,
    seed: Annotated[int, typer.Option(min=0, help="Seed of weights, order and observations.")] = 0,
    architecture: Annotated[
        str, typer.Option(help="Network architecture: autoencoder (the paper's) or unet.")
    ] = "autoencoder",
    loss_region: Annotated[
        str,
        typer.Option(
            help="Cells that count in the loss: all (the paper's), explorable, or nearby "
            "(unobserved explorable cells, weighted by their closeness to observed ones)."
        ),
    ] = "all",
    weight_decay: Annotated[float, typer.Option(min=0, help="AdamW weight decay.")] = 0.0,
    init: Annotated[Path | None, typer.Option(help="Initial weights (default: random).")] = None,
    calibrate: Annotated[
        bool,
        typer.Option("--calibrate", help="Finally scale the logits to fit the validation plans."),
    ] = False,
    augment: Annotated[
        bool, typer.Option("--augment", help="Rotate and mirror every batch at random.")
    ] = False,
    validate_every: Annotated[
        int, typer.Option(min=1, help="Samples between validations, each with a checkpoint.")
    ] = 25_000,
    device: Annotated[str, typer.Option(help="Device to train on: cpu, cuda, ...")] = "cpu",
    threads: Annotated[
        int | None, typer.Option(min=1, help="Number of CPU threads of the network.")
    ] = None,
    jobs: Annotated[
        int, typer.Option(min=1, help="Number of processes that load plans and make batches.")
    ] = 1,
    bfloat16: Annotated[
        bool,
        typer.Option(
            "--bfloat16", help="Compute in bfloat16, which is faster on hardware that supports it."
        ),
    ] = False,
    resume: Annotated[bool, typer.Option("--resume", help="Resume from the checkpoint.")] = False,
    force: ForceOption = False,
) -> None:
    """Train a map predictor on floor plans, or on logs.

    The network learns from simulated observations of floor plans, or from the observed maps of
    logged agents. Writes checkpoints, and a model card next to the weights.
    """
    if floorplans is None and not from_logs:
        raise UsageError("train: nothing to train on; use --floorplans SPEC or --from-logs LOGS")
    if floorplans is None and hold_out:
        raise UsageError(
            "--hold-out applies to --floorplans; with --from-logs alone use --validate SPEC"
        )
    if out.suffix != ".safetensors":
        raise UsageError(f"--out {out}: should end in .safetensors")
    if validate is None and hold_out == 0:
        raise UsageError("train: nothing to validate on; use --validate SPEC or --hold-out N")
    if not learning_rate > 0:
        raise UsageError(f"--learning-rate {learning_rate}: should be above 0")
    checkpoint = out.with_suffix(".checkpoint")
    for path in (out, out.with_suffix(".json")):
        check_new(path, force=force)
    check_new(checkpoint, force=True)
    if checkpoint.exists() and not (resume or force):
        raise UsageError(f"{checkpoint} exists; continue with --resume, or start over with --force")

    import torch

    from mapreplay.cli.training_environment import environment
    from mapreplay.predictors.architectures import ARCHITECTURES
    from mapreplay.predictors.weights import file_sha256, load_tensors
    from mapreplay.recorders.log.find import find_logs
    from mapreplay.training.dataset import LossRegion
    from mapreplay.training.job import TrainingJob, run_training
    from mapreplay.training.loop import TrainingConfig

    if loss_region not in list(LossRegion):
        raise UsageError(f"--loss-region {loss_region}: choose {' or '.join(LossRegion)}")
    if architecture not in ARCHITECTURES:
        raise UsageError(f"--architecture {architecture}: choose {' or '.join(ARCHITECTURES)}")
    if init is not None:
        load_tensors(init)  # fail before all plans are loaded
    if threads is not None:
        torch.set_num_threads(threads)
    job = TrainingJob(
        TrainingConfig(
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
        ),
        out=out,
        floorplans=floorplans,
        logs=find_logs(from_logs) if from_logs else [],
        ids=ids,
        validate=validate,
        hold_out=hold_out,
        validation_plans=validation_plans,
        resolution=resolution,
        init=init,
        trained_on=_name(floorplans, from_logs),
        command=["mapreplay", *(Path(word).name for word in sys.argv[1:])],
        device=device,
        jobs=jobs,
        resume=resume,
        force=force,
    )
    try:
        with _terminated_like_interrupted():
            card = run_training(job, environment())
    except KeyboardInterrupt:
        there = checkpoint.exists()
        again = f"to resume, repeat the command with --resume ({checkpoint})"
        note(f"stopped; {again}" if there else "stopped before the first checkpoint")
        raise
    note(f"weights: {out} (sha256 {card.sha256[:12]}), card: {out.with_suffix('.json')}")
    note(f"next: {shell_command(['mapreplay', 'run', '--predictor', out])}")


@contextmanager
def _terminated_like_interrupted() -> Iterator[None]:
    """Treat SIGTERM, which queues and services send to stop a process, like Ctrl-C."""

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _name(floorplans: str | None, logs: list[Path] | None) -> str:
    """The training data, without folders of this machine."""
    names = [floorplans if "/" not in floorplans else Path(floorplans).name] if floorplans else []
    names += [f"logs {path.name}" for path in logs or []]
    return ", ".join(names)
