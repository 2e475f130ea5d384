"""The paper's network, to the letter, and its weights on disk."""

from pathlib import Path

import numpy as np
import pytest
import torch

from drawing import draw, show
from mapreplay.errors import MapreplayError, UsageError, WeightsError
from mapreplay.grid import UNKNOWN
from mapreplay.predictors import load_predictor
from mapreplay.predictors.network import OUTSIDE, MapPredictor, one_hot, pad_to_multiple
from mapreplay.predictors.trained import load_network
from mapreplay.predictors.weights import encode_tensors


@pytest.fixture
def model() -> MapPredictor:
    torch.manual_seed(0)
    return MapPredictor().eval()


def test_the_input_layer_is_one_kernel_of_1x1x3_without_bias(model: MapPredictor) -> None:
    assert model.embed.weight.shape == (1, 3, 1, 1)
    assert model.embed.bias is None


def test_nine_encoding_and_nine_decoding_layers_of_25_kernels_3x3(model: MapPredictor) -> None:
    assert len(model.encoder) == len(model.decoder) == 9
    for layer in (*model.encoder, *model.decoder):
        assert layer.out_channels == 25
        assert layer.kernel_size == (3, 3)


def test_every_third_layer_has_stride_two(model: MapPredictor) -> None:
    assert [layer.stride[0] for layer in model.encoder] == [1, 1, 2] * 3
    assert [layer.stride[0] for layer in model.decoder] == [2, 1, 1] * 3


def test_the_learned_input_is_stacked_on_to_the_last_hidden_layers_input(
    model: MapPredictor,
) -> None:
    assert model.head.in_channels == 25 + 1
    assert sum(p.numel() for p in model.parameters()) < 110_000


def test_skips_are_symmetric(model: MapPredictor) -> None:
    # Silence the decoder: only skips are left, so that the input of decoder layer i + 1 is the
    # activation of the encoder layer opposite.
    shapes: list[tuple[torch.Tensor, torch.Tensor]] = []
    encoded: list[torch.Tensor] = []
    decoded: list[torch.Tensor] = []
    for layer in model.encoder:
        layer.register_forward_hook(lambda *a: encoded.append(torch.relu(a[2])))
    for layer in model.decoder:
        torch.nn.init.zeros_(layer.weight)
        torch.nn.init.zeros_(layer.bias)
        layer.register_forward_hook(lambda *a: decoded.append(a[1][0]))
    with torch.no_grad():
        model(one_hot(torch.zeros((1, 16, 24), dtype=torch.int8)))
    shapes = list(zip(encoded[-2::-1], decoded[1:], strict=True))
    assert len(shapes) == 8
    for mirrored, received in shapes:
        assert torch.equal(mirrored, received)


def test_maps_are_padded_with_unknown_at_the_high_ends() -> None:
    padded = pad_to_multiple(
        draw("""
        ##
        ..
    """),
        UNKNOWN,
    )
    assert padded.shape == (8, 8)
    assert show(padded).splitlines()[-2:] == ["##??????", "..??????"]
    assert (padded[2:] == UNKNOWN).all()


def test_one_hot_is_occupied_vacant_unknown() -> None:
    channels = one_hot(torch.from_numpy(draw("#.?")[None]))
    assert channels[0, :, 0].tolist() == [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
    assert one_hot(torch.full((1, 1, 1), OUTSIDE, dtype=torch.int8)).sum() == 0


def test_bad_weights_are_refused_in_one_line(model: MapPredictor, tmp_path: Path) -> None:
    path = tmp_path / "bad.safetensors"
    with pytest.raises(WeightsError, match="cannot be read"):
        load_network(path, "cpu")
    path.write_bytes(b"\x80\x04pickle, surely")
    with pytest.raises(WeightsError, match="not a safetensors file"):
        load_network(path, "cpu")
    path.write_bytes(encode_tensors({"embed.weight": torch.zeros(1)}, {}))
    with pytest.raises(WeightsError, match="not the weights of this network"):
        load_network(path, "cpu")
    path.write_bytes(encode_tensors(model.state_dict(), {}))
    whole = path.read_bytes()
    for size in (0, 7, 100, len(whole) - 1):
        path.write_bytes(whole[:size])
        with pytest.raises(WeightsError):
            load_network(path, "cpu")


def test_an_impossible_device_is_refused(model: MapPredictor, tmp_path: Path) -> None:
    path = tmp_path / "mine.safetensors"
    path.write_bytes(encode_tensors(model.state_dict(), {}))
    with pytest.raises(UsageError, match="device 'abacus' cannot be used"):
        load_network(path, "abacus")


@pytest.mark.parametrize("name", ["d1", "d2", "d2-unet"])
def test_the_shipped_weights_load_and_are_small(name: str) -> None:
    predictor = load_predictor(name)
    assert predictor.identity.name == name
    p = predictor.predict(np.full((64, 64), UNKNOWN, np.int8))
    assert p is not None
    assert 0 < p.mean() < 0.5  # far from anything observed: about the share of walls


def test_an_unknown_predictor_is_named() -> None:
    with pytest.raises(MapreplayError, match="'d9'; known: auto, d1, d2, d2-unet, none, or a"):
        load_predictor("d9")
