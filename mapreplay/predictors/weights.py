"""Weights on disk: safetensors and a model card. Nothing is ever unpickled."""

from __future__ import annotations

import hashlib
import json
import os
import stat
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Final

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save

from mapreplay.errors import WeightsError
from mapreplay.files.identify import SAFETENSORS, identify_file
from mapreplay.files.whole import whole_path

MAX_BYTES: Final = 256 << 20


@dataclass(frozen=True)
class ModelCard:
    """Facts about a trained predictor; ``<name>.json`` next to the weights."""

    name: str
    architecture: str
    trained_on: str
    validated_on: str
    plans: int
    samples: int
    seed: int
    seconds: float
    device: str
    train_loss: float
    validation_loss: float
    validation_f1: float
    sha256: str
    """Hash of the safetensors file."""
    command: str
    loss_region: str = "all"
    """Cells that counted in the loss: all, or the explorable ones."""
    init_sha256: str = ""
    """SHA-256 of the initial weights; empty for random ones."""
    temperature: float | None = None
    """The divisor of the trained network's logits that fits the held-out plans best; more than 1
    if it is overconfident. None: not measured."""
    calibrated: bool = False
    """Whether they were divided by it, in the last layer."""
    curve: list[dict[str, float]] = field(default_factory=list)

    def to_json(self) -> bytes:
        """The JSON text of the card."""
        return (json.dumps(asdict(self), indent=1) + "\n").encode()


def file_sha256(path: Path) -> str:
    """Hex digest of a file's bytes.

    Raises:
        WeightsError: it cannot be read, or is not a regular file.
    """
    _check_regular(path)
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise WeightsError(f"{path}: cannot be read ({error.strerror or error})") from None


def encode_tensors(tensors: Mapping[str, torch.Tensor], notes: Mapping[str, str]) -> bytes:
    """A safetensors file.

    Raises:
        WeightsError: a value is not finite.
    """
    for name, value in tensors.items():
        if not bool(torch.isfinite(value).all()):
            raise WeightsError(f"{name} is not finite; is the learning rate too high?")
    flat = {name: value.detach().cpu().contiguous() for name, value in tensors.items()}
    return save(flat, metadata=dict(notes))


def tensors_sha256(tensors: Mapping[str, torch.Tensor]) -> str:
    """Hex digest of names and values: safetensors files have no checksum of their own."""
    digest = hashlib.sha256()
    for name in sorted(tensors):
        values = tensors[name].detach().cpu().contiguous().numpy()
        digest.update(f"{name} {values.dtype} {values.shape}\n".encode() + values.tobytes())
    return digest.hexdigest()


def card_path(weights: Path) -> Path:
    """The path of the model card of weights."""
    return weights.with_suffix(".json")


def save_weights(path: Path, content: bytes, card: ModelCard, *, force: bool = False) -> None:
    """Write a safetensors file and its card; on failure both are unchanged.

    Raises:
        ExistsError, WriteError: see `mapreplay.files.whole_path`.
    """
    card_file = card_path(path)
    with (
        whole_path(card_file, force=force) as card_draft,
        whole_path(path, force=force) as draft,
    ):
        for each, data in ((card_draft, card.to_json()), (draft, content)):
            with each.open("wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())  # a full disk shows here, before the first is renamed


def load_tensors(path: Path) -> tuple[dict[str, torch.Tensor], dict[str, str]]:
    """The tensors and notes of a safetensors file.

    Raises:
        WeightsError: missing, too large, or not a safetensors file.
    """
    try:
        _check_regular(path)
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise WeightsError(f"{path}: {size >> 20} MiB; at most {MAX_BYTES >> 20} are allowed")
        with safe_open(path, framework="pt") as file:
            names = file.keys()
            return {name: file.get_tensor(name) for name in names}, file.metadata() or {}
    except OSError as error:
        raise WeightsError(f"{path}: cannot be read ({error.strerror or error})") from None
    except (SafetensorError, ValueError) as error:
        what = identify_file(path)
        reason = " ".join(str(error).split())[:120] if what in (None, SAFETENSORS) else what
        raise WeightsError(f"{path}: not a safetensors file ({reason})") from None


def load_state(model: torch.nn.Module, tensors: Mapping[str, torch.Tensor], path: Path) -> None:
    """Put `tensors`, read from `path`, into `model`.

    Raises:
        WeightsError: they belong to another network.
    """
    try:
        model.load_state_dict(tensors)
    except RuntimeError as error:
        reason = " ".join(str(error).split())[:120]
        raise WeightsError(f"{path}: not the weights of this network ({reason})") from None


def _check_regular(path: Path) -> None:
    """Reading a named pipe or a device would never end."""
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise WeightsError(f"{path}: cannot be read ({reason})") from None
    if not stat.S_ISREG(mode):
        kind = "a folder" if stat.S_ISDIR(mode) else "not a regular file"
        raise WeightsError(f"{path}: not a file of weights (it is {kind})")
