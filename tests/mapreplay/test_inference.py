"""The compiled network is PyTorch's to four digits, and itself to the last bit."""

import subprocess
import sys

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from mapreplay.grid import Grid
from mapreplay.predictors.inference import CompiledNetwork
from mapreplay.predictors.network import EagerNetwork, MapPredictor
from mapreplay.predictors.trained import WEIGHTS, load_network
from mapreplay.predictors.weights import load_state, load_tensors


def compiled(model: MapPredictor) -> CompiledNetwork:
    return CompiledNetwork({name: t.numpy() for name, t in model.state_dict().items()})


def random_model(seed: int, gain: float = 1) -> MapPredictor:
    torch.manual_seed(seed)
    model = MapPredictor().eval()
    with torch.no_grad():
        for parameter in model.parameters():
            parameter.mul_(gain)
    return model


def shipped(name: str) -> MapPredictor:
    model = MapPredictor().eval()
    path = WEIGHTS / f"{name}.safetensors"
    load_state(model, load_tensors(path)[0], path)
    return model


def random_map(seed: int, height: int, width: int) -> Grid:
    """Patches of free, occupied and unknown cells, as large as a room or a cell."""
    rng = np.random.default_rng(seed)
    size = int(rng.integers(1, 9))
    coarse = rng.choice([-1, -1, 0, 0, 100], (-(-height // size), -(-width // size)))
    return np.kron(coarse, np.ones((size, size)))[:height, :width].astype(np.int8)


SIZES = st.integers(1, 12).map(lambda n: 8 * n)


@settings(max_examples=40, deadline=None)
@given(height=SIZES, width=SIZES, seed=st.integers(0, 2**32 - 1), gain=st.sampled_from([1, 1.5, 2]))
def test_random_weights_on_random_maps_give_what_pytorch_gives(
    height: int, width: int, seed: int, gain: float
) -> None:
    model, cells = random_model(seed, gain), random_map(seed, height, width)
    np.testing.assert_allclose(
        compiled(model).p_wall(cells), EagerNetwork(model, "cpu").p_wall(cells), rtol=0, atol=1e-4
    )


@pytest.mark.parametrize("name", ["d1", "d2"])
@pytest.mark.parametrize(("height", "width"), [(8, 8), (64, 64), (136, 72), (24, 200)])
def test_the_shipped_weights_give_what_pytorch_gives(name: str, height: int, width: int) -> None:
    model, cells = shipped(name), random_map(height, height, width)
    np.testing.assert_allclose(
        compiled(model).p_wall(cells), EagerNetwork(model, "cpu").p_wall(cells), rtol=0, atol=1e-4
    )


@settings(max_examples=30, deadline=None)
@given(order=st.lists(st.integers(0, 5), min_size=1, max_size=12))
def test_a_prediction_does_not_depend_on_what_was_predicted_before(order: list[int]) -> None:
    shapes = [(8, 8), (64, 64), (64, 64), (24, 40), (40, 24), (104, 72)]
    maps = [random_map(i, *shape) for i, shape in enumerate(shapes)]
    model = random_model(1)
    once, again = compiled(model), [compiled(model).p_wall(cells) for cells in maps]
    for i in order:
        assert once.p_wall(maps[i]).tobytes() == again[i].tobytes()


def test_another_process_predicts_the_same_bytes() -> None:
    cells = random_map(3, 72, 64)
    here = load_network(WEIGHTS / "d1.safetensors", "cpu").predict(cells)
    script = (
        "import sys, numpy as np\n"
        "from mapreplay.predictors import load_predictor\n"
        "cells = np.frombuffer(sys.stdin.buffer.read(), np.int8).reshape(72, 64)\n"
        "load_predictor('d1').predict(cells[:32])\n"
        "sys.stdout.buffer.write(load_predictor('d1').predict(cells).tobytes())\n"
    )
    there = subprocess.run(
        [sys.executable, "-c", script], input=cells.tobytes(), capture_output=True, check=True
    )
    assert there.stdout == here.tobytes()


def test_a_map_that_lies_at_the_high_ends_of_a_larger_one_is_padded_alike() -> None:
    # 61 x 50 cells are predicted as the 64 x 56 map whose other cells are unknown.
    cells = random_map(5, 61, 50)
    larger = np.full((64, 56), -1, np.int8)
    larger[:61, :50] = cells
    predictor = load_network(WEIGHTS / "d2.safetensors", "cpu")
    assert (predictor.predict(cells) == predictor.predict(larger)[:61, :50]).all()


def test_huge_weights_give_certainty_without_a_warning() -> None:
    model = random_model(0)
    with torch.no_grad():
        model.head.weight.fill_(0)
        model.head.bias.fill_(-1000)
    assert (compiled(model).p_wall(random_map(0, 16, 16)) == 0).all()
    with torch.no_grad():
        model.head.bias.fill_(1000)
    assert (compiled(model).p_wall(random_map(0, 16, 16)) == 1).all()
