"""Weights on disk: safetensors and a model card beside it. Nothing is ever unpickled."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Final

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save

from mapreplay.errors import WeightsError

MAX_BYTES: Final = 256 << 20


@dataclass(frozen=True)
class ModelCard:
    """What is known of a trained predictor; ``<name>.json`` beside the weights."""

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
    """Of the safetensors file."""
    command: str
    loss_region: str = "all"
    """Cells that counted in the loss: all, or the explorable ones."""
    init_sha256: str = ""
    """Of the weights that the training started from; empty: random ones."""
    temperature: float | None = None
    """What the trained network's logits have to be divided by to fit the held-out plans best;
    more than 1 where it is too sure. None: not measured."""
    calibrated: bool = False
    """Whether they were, in its last layer."""
    curve: list[dict[str, float]] = field(default_factory=list)

    def write(self, path: Path) -> None:
        """Write as JSON."""
        path.write_text(json.dumps(asdict(self), indent=1) + "\n", encoding="utf-8")


def file_sha256(path: Path) -> str:
    """Hex digest of a file's bytes."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def save_tensors(path: Path, tensors: Mapping[str, torch.Tensor], notes: Mapping[str, str]) -> None:
    """Write a safetensors file, whole or not at all."""
    part = path.with_name(path.name + ".part")
    flat = {name: value.detach().cpu().contiguous() for name, value in tensors.items()}
    # Not `save_file`: what that writes only its owner may read.
    part.write_bytes(save(flat, metadata=dict(notes)))
    part.replace(path)


def load_tensors(path: Path) -> tuple[dict[str, torch.Tensor], dict[str, str]]:
    """The tensors and notes of a safetensors file.

    Raises:
        WeightsError: missing, too large, or not a safetensors file.
    """
    try:
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise WeightsError(f"{path}: {size >> 20} MiB; at most {MAX_BYTES >> 20} are allowed")
        with safe_open(path, framework="pt") as file:
            names = file.keys()
            return {name: file.get_tensor(name) for name in names}, file.metadata() or {}
    except OSError as error:
        raise WeightsError(f"{path}: cannot be read ({error.strerror or error})") from None
    except (SafetensorError, ValueError) as error:
        reason = " ".join(str(error).split())[:120]
        raise WeightsError(f"{path}: not a safetensors file ({reason})") from None


def load_state(model: torch.nn.Module, tensors: Mapping[str, torch.Tensor], path: Path) -> None:
    """Put `tensors`, read from `path`, into `model`.

    Raises:
        WeightsError: they are those of another network.
    """
    try:
        model.load_state_dict(tensors)
    except RuntimeError as error:
        reason = " ".join(str(error).split())[:120]
        raise WeightsError(f"{path}: not the weights of this network ({reason})") from None
