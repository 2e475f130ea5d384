"""The networks by name: what holds for each of them, and what the U-Net adds."""

from pathlib import Path

import numpy as np
import pytest
import torch

from drawing import draw
from mapreplay.errors import WeightsError
from mapreplay.grid import FREE, OCCUPIED, UNKNOWN
from mapreplay.mapping import PredictionDtype, quantize
from mapreplay.predictors import load_predictor
from mapreplay.predictors.architectures import ARCHITECTURES, UNET, Architecture, notes_of
from mapreplay.predictors.network import one_hot
from mapreplay.predictors.trained import TrainedPredictor, load_network
from mapreplay.predictors.unet import fused
from mapreplay.predictors.weights import encode_tensors
from mapreplay.step import PredictorIdentity

every_architecture = pytest.mark.parametrize(
    "architecture", ARCHITECTURES.values(), ids=list(ARCHITECTURES)
)


def random_predictor(architecture: Architecture) -> TrainedPredictor:
    torch.manual_seed(0)
    model = architecture.build().eval()
    return TrainedPredictor(model, architecture, PredictorIdentity("random", ""), "cpu")


@pytest.mark.parametrize(("height", "width"), [(8, 8), (9, 17), (64, 64), (75, 62), (1, 1)])
@every_architecture
def test_any_map_size_works(architecture: Architecture, height: int, width: int) -> None:
    predictor = random_predictor(architecture)
    p = predictor.predict(np.full((height, width), UNKNOWN, np.int8))
    assert p.shape == (height, width)
    assert p.dtype == np.float32
    assert 0 <= p.min() <= p.max() <= 1


@every_architecture
def test_the_same_map_gives_the_same_numbers_again(architecture: Architecture) -> None:
    predictor = random_predictor(architecture)
    observed = np.random.default_rng(0).choice([-1, 0, 100], (40, 40)).astype(np.int8)
    assert (predictor.predict(observed) == predictor.predict(observed)).all()


@every_architecture
def test_weights_go_to_disk_and_back(architecture: Architecture, tmp_path: Path) -> None:
    torch.manual_seed(1)
    model = architecture.build().eval()
    path = tmp_path / "mine.safetensors"
    path.write_bytes(encode_tensors(model.state_dict(), notes_of(architecture)))
    loaded = load_predictor(str(path))
    assert loaded.identity.name == "mine"
    assert len(loaded.identity.sha256) == 64
    observed = draw("#..?")
    direct = TrainedPredictor(model, architecture, PredictorIdentity("random", ""), "cpu")
    assert (loaded.predict(observed) == direct.predict(observed)).all()


def test_weights_of_an_unknown_architecture_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "new.safetensors"
    path.write_bytes(
        encode_tensors({"a": torch.zeros(1)}, {"mapreplay.architecture": "transformer"})
    )
    with pytest.raises(WeightsError, match="network 'transformer'; known are autoencoder, unet"):
        load_network(path, "cpu")


def test_normalizations_are_part_of_the_unets_convolutions_when_it_runs() -> None:
    torch.manual_seed(2)
    model = UNET.build()
    for _ in range(3):  # so that there is something to normalize by
        model(torch.rand(4, 3, 32, 40))
    cells = one_hot(
        torch.from_numpy(np.random.default_rng(3).choice([-1, 0, 100], (1, 32, 40)).astype(np.int8))
    )
    before = {name: value.clone() for name, value in model.state_dict().items()}
    with torch.inference_mode():
        expected, faster = model.eval()(cells), fused(model)(cells)
    assert torch.allclose(expected, faster, atol=1e-4)
    assert not any(isinstance(part, torch.nn.BatchNorm2d) for part in fused(model).modules())
    assert all(torch.equal(value, before[name]) for name, value in model.state_dict().items())


def test_the_unet_sees_all_of_a_floor_plan_and_where_its_grid_ends() -> None:
    torch.manual_seed(4)
    model = UNET.build().double().eval()
    maps = torch.rand(1, 3, 64, 64, dtype=torch.float64, requires_grad=True)
    maps.data[0, :, 63, 63] = 0  # not observed
    torch.autograd.backward(model(maps)[0, 0, 63, 63])
    assert maps.grad is not None
    assert maps.grad[0, :, 0, 0].abs().sum() > 0
    predictor, unknown = random_predictor(UNET), np.full((64, 64), UNKNOWN, np.int8)
    smaller = predictor.predict(unknown[:, :60])
    assert (smaller != predictor.predict(unknown)[:, :60]).any()


def test_the_unet_leaves_what_was_observed_as_it_is() -> None:
    observed = draw("""
        ##??
        .#??
        ..??
    """)
    p_wall = random_predictor(UNET).predict(observed)
    assert (quantize(p_wall, PredictionDtype.UINT8)[observed == OCCUPIED] == 255).all()
    assert (quantize(p_wall, PredictionDtype.UINT8)[observed == FREE] == 0).all()
    assert (np.abs(p_wall[observed == UNKNOWN] - 0.5) < 0.4).all()
