"""Training: the loop, its checkpoints, and the held-out curve."""

from __future__ import annotations

import hashlib
import json
import math
import time
from collections.abc import Generator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from scipy.optimize import minimize_scalar
from torch import nn
from torch.nn import functional

from mapreplay import scores
from mapreplay.errors import MapreplayError, WeightsError
from mapreplay.files.whole import write_whole
from mapreplay.predictors.architectures import (
    ARCHITECTURES,
    AUTOENCODER,
    architecture_of,
    notes_of,
)
from mapreplay.predictors.network import one_hot
from mapreplay.predictors.weights import (
    ModelCard,
    encode_tensors,
    load_state,
    load_tensors,
    save_weights,
    tensors_sha256,
)
from mapreplay.training.batches import BatchPosition, batches_from
from mapreplay.training.dataset import (
    Batch,
    Epoch,
    Layout,
    LossRegion,
    TrainingPlan,
    make_batch,
    padded_shape,
)
from mapreplay.training.origin import TrainingOrigin

CHECKED_EVERY: Final = 100
"""Number of batches between checks of the loss on a GPU, which have to wait for it."""
VALIDATION_SEED: Final = 2**63
"""Apart from every training seed, so that no validation observation was trained on."""


class TrainingError(MapreplayError):
    """The training cannot continue."""


@dataclass(frozen=True)
class TrainingConfig:
    """Everything that the result depends on, except the floor plans."""

    samples: int = 400_000
    """Total number of observed maps to train on."""
    batch: int = 32
    """Maps of 64 x 64 cells per batch; larger maps come in smaller batches."""
    learning_rate: float = 2e-3
    """Peak; warmed up over the first hundredth, then a cosine to zero."""
    seed: int = 0
    validate_every: int = 25_000
    """Samples between two points of the held-out curve."""
    loss_region: LossRegion = LossRegion.ALL
    init_sha256: str = ""
    """SHA-256 of the initial weights; empty for random ones."""
    architecture: str = AUTOENCODER.name
    weight_decay: float = 0.0
    """Weight decay of AdamW."""
    calibrate: bool = False
    """Divide the last layer by the temperature that fits the held-out plans best."""
    bfloat16: bool = False
    """Compute in bfloat16 where that is allowed: over twice as fast on a CPU with AMX."""
    augment: bool = False
    """Turn and mirror every batch at random."""


@dataclass(frozen=True)
class CurvePoint:
    """One point of the held-out curve."""

    samples: int
    train_loss: float
    """Mean binary cross-entropy per cell since the last point, nats."""
    validation_loss: float
    validation_f1: float
    """F1 of the raw prediction (p >= .5) on explorable cells, pooled over the plans."""
    seconds: float
    """Training time so far, over all resumptions."""


@dataclass
class _State:
    """The progress of the training, which is in the checkpoint."""

    samples: int = 0
    epoch: int = 0
    batch: int = 0
    seconds: float = 0.0
    curve: list[CurvePoint] = field(default_factory=list)


class Trainer:
    """Trains one network; `run` yields a curve point now and then until it is done."""

    def __init__(
        self,
        plans: Sequence[TrainingPlan],
        validation: Sequence[TrainingPlan],
        config: TrainingConfig,
        device: str,
        checkpoint: Path,
        jobs: int = 1,
    ) -> None:
        """`jobs` processes make the batches, for one of which a GPU would wait. The result does not
        depend on it.
        """
        torch.manual_seed(config.seed)
        self.plans = plans
        self.config = config
        self.device = torch.device(device)
        self.checkpoint = checkpoint
        self.jobs = jobs
        self.architecture = ARCHITECTURES[config.architecture]
        # torch's own annotations do not know memory_format
        self.model: nn.Module = self.architecture.build().to(  # type: ignore[call-overload]
            self.device, memory_format=torch.channels_last
        )
        self.optimizer = torch.optim.AdamW(
            self.model.parameters(), lr=config.learning_rate, weight_decay=config.weight_decay
        )
        self._layout = Layout(
            self.architecture.padding, config.loss_region, self.architecture.fewest_maps
        )
        self.validation = _validation_batches(validation, config, self._layout)
        self.origin = TrainingOrigin.of(asdict(config), plans, validation)
        self.state = _State()
        self._losses: list[torch.Tensor] = []

    @property
    def samples(self) -> int:
        """Observation maps trained on so far."""
        return self.state.samples

    @property
    def curve(self) -> list[CurvePoint]:
        """The held-out curve so far."""
        return self.state.curve

    def run(self) -> Generator[CurvePoint | int, None, None]:
        """Train to the end; yields the samples done after each batch, and the curve's points.

        The checkpoint is written with every point of the curve.

        Raises:
            TrainingError: the loss is not finite; the checkpoint is the last good one.
            WriteError: the checkpoint cannot be written; the one before stays.
            MapreplayError: a process that makes batches died.
        """
        config, state = self.config, self.state
        if state.samples >= config.samples:  # it goes on after its end
            return
        began = time.monotonic()
        for place, batch in batches_from(
            self._epoch, BatchPosition(state.epoch, state.batch), self.jobs
        ):
            self._step(batch)
            before = state.samples
            state.samples += len(batch.observed)
            state.epoch, state.batch = place.epoch, place.batch + 1
            state.seconds += time.monotonic() - began
            done = state.samples >= config.samples
            if self.device.type == "cpu" or len(self._losses) % CHECKED_EVERY == 0:
                self._check_finite(self._losses[-1].item())
            yield state.samples
            if done or before // config.validate_every != state.samples // config.validate_every:
                yield self._curve_point()
                self.save()
            if done:
                return
            began = time.monotonic()

    def _epoch(self, number: int) -> Epoch:
        config = self.config
        cells = config.batch * 64 * 64
        return Epoch(self.plans, cells, config.seed, number, self._layout, config.augment)

    def _step(self, batch: Batch) -> None:
        self.model.train()
        share = self.state.samples / self.config.samples
        warm = min(1.0, share * 100 + 1e-3)
        for group in self.optimizer.param_groups:
            group["lr"] = (
                self.config.learning_rate * warm * 0.5 * (1 + math.cos(math.pi * min(share, 1.0)))
            )
        loss = self._loss(batch)
        self.optimizer.zero_grad(set_to_none=True)
        torch.autograd.backward(loss)
        torch.nn.utils.clip_grad_norm_(self.model.parameters(), 1.0)
        self.optimizer.step()
        self._losses.append(loss.detach())  # not read now, for which a GPU would have to wait

    def _logits(self, batch: Batch) -> torch.Tensor:
        with torch.autocast(self.device.type, dtype=torch.bfloat16, enabled=self.config.bfloat16):
            cells = torch.from_numpy(batch.observed).to(self.device)
            logits: torch.Tensor = self.model(one_hot(cells))
        return logits[:, 0].float()

    def _loss(self, batch: Batch) -> torch.Tensor:
        """Binary cross-entropy (paper, section "Optimization"), mean over the loss region."""
        truth = torch.from_numpy(batch.truth).to(self.device)
        loss = functional.binary_cross_entropy_with_logits(
            self._logits(batch), (truth > 0).float(), reduction="none"
        )
        counted = torch.from_numpy(batch.weights).to(self.device)
        # A map of which everything was seen has no cell that counts.
        return (loss * counted).sum() / counted.sum().clamp(min=1e-6)

    def _check_finite(self, *losses: float) -> None:
        for loss in losses:
            if not math.isfinite(loss):
                raise TrainingError(
                    f"the loss is {loss} after {self.samples} samples; is the learning rate "
                    f"({self.config.learning_rate:g}) too high? No weights were written"
                )

    def _curve_point(self) -> CurvePoint:
        state = self.state
        train_loss = torch.stack(self._losses).mean().item()
        loss = self._validate()
        self._check_finite(train_loss, loss[0])
        point = CurvePoint(state.samples, train_loss, *loss, round(state.seconds, 1))
        state.curve.append(point)
        self._losses = []
        return point

    @torch.inference_mode()
    def _validate(self) -> tuple[float, float]:
        self.model.eval()
        losses, sizes = [], []
        counts = np.zeros((3, 3), np.int64)
        for batch in self.validation:
            losses.append(self._loss(batch).item())
            sizes.append(len(batch.truth))
            raw = np.where(self._logits(batch).cpu().numpy() >= 0, 100, 0).astype(np.int8)
            for said, truth, region in zip(raw, batch.truth, batch.explorable, strict=True):
                counts += scores.tally(said, truth, region)
        return float(np.average(losses, weights=sizes)), scores.score(counts).f1

    @torch.inference_mode()
    def temperature(self) -> float:
        """The divisor of the logits that fits the held-out plans best.

        Temperature scaling (Guo et al. 2017): 1 if the network is calibrated, more if it is
        overconfident. In [1/4, 4].
        """
        self.model.eval()
        logits, walls, weights = [], [], []
        for batch in self.validation:
            counted = batch.weights
            logits.append(self._logits(batch).cpu().numpy()[counted > 0])
            walls.append(batch.truth[counted > 0] > 0)
            weights.append(counted[counted > 0])
        said, wall = np.concatenate(logits).astype(np.float64), np.concatenate(walls)
        weight = np.concatenate(weights)

        def loss(exponent: float) -> float:
            scaled = said / 4**exponent
            return float((weight * (np.logaddexp(0, scaled) - scaled * wall)).sum())

        return float(4 ** minimize_scalar(loss, bounds=(-1, 1), method="bounded").x)

    @torch.no_grad()
    def divide_logits(self, temperature: float) -> None:
        """Divide the last layer by `temperature`, which makes the network less confident."""
        for parameter in self.model.get_submodule("head").parameters():
            parameter.div_(temperature)

    def start_from(self, weights: Path) -> None:
        """Start from trained weights (`TrainingConfig.init_sha256`) instead of random ones.

        Raises:
            WeightsError: they cannot be read, or are of another network.
        """
        tensors, notes = load_tensors(weights)
        if (theirs := architecture_of(notes, weights)) is not self.architecture:
            raise WeightsError(
                f"{weights}: weights of the network {theirs.name}, not {self.architecture.name}"
            )
        load_state(self.model, tensors, weights)

    def save(self) -> None:
        """Write the checkpoint: weights, optimizer and position, nothing pickled.

        Raises:
            WeightsError: a value is not finite.
            WriteError: it cannot be written; the one before stays.
        """
        tensors = {f"model.{name}": value for name, value in self.model.state_dict().items()}
        for i, slots in self.optimizer.state_dict()["state"].items():
            tensors |= {f"adam.{i}.{name}": torch.as_tensor(slots[name]) for name in sorted(slots)}
        about = {
            "origin": self.origin.to_json(),
            "state": asdict(self.state),
            "tensors": tensors_sha256(tensors),
        }
        content = encode_tensors(tensors, {"mapreplay.training": json.dumps(about)})
        write_whole(self.checkpoint, content, force=True)

    def resume(self) -> None:
        """Resume from the checkpoint.

        Raises:
            WeightsError: it cannot be read, is damaged, or was made with other plans, options,
                code or weights.
        """
        tensors, notes = load_tensors(self.checkpoint)
        if "mapreplay.training" not in notes:
            raise WeightsError(f"{self.checkpoint}: not a training checkpoint")
        try:
            about = json.loads(notes["mapreplay.training"])
            if "origin" not in about:
                raise WeightsError(
                    f"{self.checkpoint}: of an earlier version, which did not record its origin; "
                    "start over with --force, or choose another --out"
                )
            differences = TrainingOrigin.from_json(about["origin"]).differences(self.origin)
            if differences:
                raise WeightsError(
                    f"{self.checkpoint}: was made with {'; '.join(differences)}; resume with the "
                    "same, start over with --force, or choose another --out"
                )
            if about["tensors"] != tensors_sha256(tensors):
                raise ValueError("its checksum does not match")
            self._load(about["state"], tensors)
        except (ValueError, KeyError, TypeError, AttributeError, RuntimeError) as error:
            reason = " ".join(str(error).split())[:120]
            raise WeightsError(
                f"{self.checkpoint}: a damaged checkpoint ({reason}); start over with --force"
            ) from None

    def _load(self, state: dict[str, Any], tensors: Mapping[str, torch.Tensor]) -> None:
        curve = [CurvePoint(**point) for point in state.pop("curve")]
        self.state = _State(**state, curve=curve)
        self.model.load_state_dict(
            {k.removeprefix("model."): v for k, v in tensors.items() if k.startswith("model.")}
        )
        slots: dict[int, dict[str, torch.Tensor]] = {}
        for key, value in tensors.items():
            if key.startswith("adam."):
                _, number, name = key.split(".")
                slots.setdefault(int(number), {})[name] = value
        groups = self.optimizer.state_dict()["param_groups"]
        self.optimizer.load_state_dict({"state": slots, "param_groups": groups})


def finish(
    trainer: Trainer,
    out: Path,
    *,
    trained_on: str,
    validated_on: str,
    command: str,
    force: bool = False,
) -> ModelCard:
    """Write the trained weights to `out` and their card next to it; the checkpoint is removed.

    The card has the given texts about the plans and the command that reproduces the weights.

    Raises:
        ExistsError: weights or card exist and `force` is not given; the checkpoint stays.
        WriteError: they cannot be written; existing files and the checkpoint stay.
        WeightsError: a value is not finite.
    """
    temperature = trainer.temperature()
    if trainer.config.calibrate:
        trainer.divide_logits(temperature)
    content = encode_tensors(trainer.model.state_dict(), notes_of(trainer.architecture))
    last = trainer.curve[-1]
    card = ModelCard(
        name=out.stem,
        architecture=trainer.architecture.description,
        trained_on=trained_on,
        validated_on=validated_on,
        plans=len(trainer.plans),
        samples=last.samples,
        seed=trainer.config.seed,
        loss_region=trainer.config.loss_region,
        init_sha256=trainer.config.init_sha256,
        seconds=last.seconds,
        device=str(trainer.device),
        train_loss=last.train_loss,
        validation_loss=last.validation_loss,
        validation_f1=last.validation_f1,
        temperature=round(temperature, 4),
        calibrated=trainer.config.calibrate,
        sha256=hashlib.sha256(content).hexdigest(),
        command=command,
        curve=[asdict(point) for point in trainer.curve],
    )
    save_weights(out, content, card, force=force)
    trainer.checkpoint.unlink(missing_ok=True)
    return card


def _validation_batches(
    plans: Sequence[TrainingPlan], config: TrainingConfig, layout: Layout
) -> list[Batch]:
    """One simulated observation of each plan, or all logged ones; at every point the same."""
    by_shape: dict[tuple[int, int], list[tuple[TrainingPlan, int]]] = {}
    for plan in plans:
        runs = range(len(plan.logged) or 1)
        by_shape.setdefault(padded_shape(plan), []).extend((plan, run) for run in runs)
    batches = []
    for (height, width), group in sorted(by_shape.items()):
        size = max(1, config.batch * 64 * 64 // (height * width))
        for i in range(0, len(group), size):
            part = group[i : i + size]
            observed_of, runs_of = [plan for plan, _ in part], [run for _, run in part]
            batches.append(make_batch(observed_of, runs_of, VALIDATION_SEED, layout))
    return batches
