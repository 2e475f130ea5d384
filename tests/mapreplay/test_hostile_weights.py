"""Weights are safetensors and nothing else; a header that lies is refused in one line."""

import json
import pickle
import struct
from pathlib import Path
from typing import Any

import pytest
import torch

from mapreplay.errors import WeightsError
from mapreplay.predictors import load_predictor, trained, weights
from mapreplay.predictors.architectures import AUTOENCODER
from mapreplay.predictors.weights import encode_tensors


def with_header(header: bytes, data: bytes = b"", length: int | None = None) -> bytes:
    return struct.pack("<Q", len(header) if length is None else length) + header + data


def tensors(**offsets: tuple[int, int]) -> bytes:
    header = {
        name: {"dtype": "F32", "shape": [(end - start) // 4], "data_offsets": [start, end]}
        for name, (start, end) in offsets.items()
    }
    return with_header(json.dumps(header).encode(), bytes(16))


def claims(dtype: str, shape: list[int], end: int) -> bytes:
    header: dict[str, Any] = {"a": {"dtype": dtype, "shape": shape, "data_offsets": [0, end]}}
    return with_header(json.dumps(header).encode(), bytes(16))


@pytest.mark.parametrize(
    "content",
    [
        b"",
        with_header(b"{}", length=2**63),
        with_header(b"{}", length=2**64 - 1),
        with_header(b"{}", length=200 << 20),
        with_header(b"[" * 100_000),
        with_header(b'{"a":' * 100_000),
        with_header(b"\xff\xfe not text"),
        tensors(a=(0, 12), b=(8, 16)),
        tensors(a=(0, 16), b=(0, 16)),
        tensors(a=(0, 2**40)),
        tensors(a=(8, 16)),
        claims("F32", [2**62, 2**62], 16),
        claims("F32", [5], 16),
        claims("PY_OBJECT", [4], 16),
    ],
    ids=["empty", "huge", "huger", "longer-than-the-file", "nested-lists", "nested-objects",
         "no-text", "overlapping", "the-same-bytes", "beyond-the-file", "a-hole", "overflowing",
         "another-size", "another-type"],
)  # fmt: skip
def test_a_header_that_lies_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "x.safetensors"
    path.write_bytes(content)
    with pytest.raises(WeightsError, match=r"x\.safetensors: not a safetensors file") as caught:
        load_predictor(str(path))
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400


def test_nothing_is_ever_unpickled(tmp_path: Path) -> None:
    class Trap:
        def __reduce__(self) -> tuple[Any, ...]:
            return (Path.touch, (tmp_path / "sprung",))

    path = tmp_path / "x.safetensors"
    path.write_bytes(pickle.dumps(Trap()))
    with pytest.raises(WeightsError):
        load_predictor(str(path))
    torch.save({"a": torch.zeros(1)}, path)
    with pytest.raises(WeightsError):
        load_predictor(str(path))
    assert not (tmp_path / "sprung").exists()


def test_a_file_that_is_too_large_is_not_opened(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "x.safetensors"
    path.write_bytes(encode_tensors({"a": torch.zeros(1000)}, {}))
    monkeypatch.setattr(weights, "MAX_BYTES", 1000)
    with pytest.raises(WeightsError, match=r"x\.safetensors: 0 MiB; at most 0 are allowed"):
        load_predictor(str(path))


def test_weights_that_are_replaced_while_they_are_read_are_not_logged_under_another_hash(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.safetensors"
    whole = encode_tensors(AUTOENCODER.build().state_dict(), {})
    path.write_bytes(whole)
    load = trained.load_model

    def replaced(weights: Path) -> object:
        loaded = load(weights)
        path.write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]))
        return loaded

    monkeypatch.setattr(trained, "load_model", replaced)
    with pytest.raises(WeightsError, match="was replaced while it was read"):
        load_predictor(str(path))


def test_a_file_of_weights_is_a_regular_file(tmp_path: Path) -> None:
    folder = tmp_path / "folder.safetensors"
    folder.mkdir()
    with pytest.raises(WeightsError, match="it is a folder"):
        load_predictor(str(folder))
