"""Quantizing, thresholding and fusing, at their exact edges."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drawing import draw, show
from mapreplay.grid import FREE, OCCUPIED, UNKNOWN, Quantized
from mapreplay.mapping import (
    PredictionDtype,
    Thresholds,
    dequantize,
    fuse,
    quantize,
    raw_classes,
    threshold,
)


def classes(quantized: Quantized, free: float, occupied: float) -> list[int]:
    return threshold(quantized[None], Thresholds(free, occupied))[0].tolist()


def test_the_default_thresholds_are_the_papers() -> None:
    assert Thresholds().free_at_most == Thresholds(0.93, 0.95).free_at_most
    assert float(Thresholds().free_at_most) == 0.035
    assert float(Thresholds().occupied_at_least) == 0.975


def test_a_float_at_the_edge_is_sure_and_one_beside_it_is_not() -> None:
    low, high = np.float32(0.035), np.float32(0.975)
    row = np.array([low, np.nextafter(low, np.float32(1)), np.nextafter(high, np.float32(0)), high])
    assert classes(row, 0.93, 0.95) == [FREE, UNKNOWN, UNKNOWN, OCCUPIED]


def test_integer_predictions_are_compared_exactly() -> None:
    # (1 - .6) / 2 = .2 = 51/255 and (1 + .6) / 2 = .8 = 204/255, with nothing rounded.
    row = np.array([51, 52, 203, 204], np.uint8)
    assert classes(row, 0.6, 0.6) == [FREE, UNKNOWN, UNKNOWN, OCCUPIED]
    row = np.array([13107, 13108, 52427, 52428], np.uint16)
    assert classes(row, 0.6, 0.6) == [FREE, UNKNOWN, UNKNOWN, OCCUPIED]


def test_free_wins_a_tie() -> None:
    # With both confidences 0, p = 1/2 is free and occupied at once.
    assert classes(np.array([0.5], np.float32), 0, 0) == [FREE]
    assert classes(np.array([127, 128], np.uint8), 0, 0) == [FREE, OCCUPIED]


def test_full_confidence_accepts_only_certainty() -> None:
    assert classes(np.array([0, 1, 254, 255], np.uint8), 1, 1) == [
        FREE, UNKNOWN, UNKNOWN, OCCUPIED,
    ]  # fmt: skip


def test_the_raw_prediction_is_occupied_from_one_half_on() -> None:
    assert raw_classes(np.array([[0.49, 0.5]], np.float32)).tolist() == [[FREE, OCCUPIED]]
    assert raw_classes(np.array([[127, 128]], np.uint8)).tolist() == [[FREE, OCCUPIED]]


def test_what_was_observed_always_wins() -> None:
    observed = draw("""
        .#?
        .#?
        .#?
    """)
    p_wall = np.array([[255, 255, 255], [0, 0, 0], [99, 99, 99]], np.uint8)[::-1]
    assert show(fuse(observed, p_wall, Thresholds())) == show(
        draw("""
        .##
        .#.
        .#?
    """)
    )


def test_without_a_prediction_the_fused_map_is_the_observed_one() -> None:
    observed = draw("?.#")
    assert fuse(observed, None, Thresholds()) is observed


@pytest.mark.parametrize(
    ("dtype", "error"),
    [
        (PredictionDtype.UINT8, 0.5 / 255),
        (PredictionDtype.UINT16, 0.5 / 65535),
        (PredictionDtype.FLOAT32, 0),
    ],
)
def test_quantizing_rounds_to_the_nearest_value(dtype: PredictionDtype, error: float) -> None:
    p = np.linspace(0, 1, 1001, dtype=np.float32)[None]
    quantized = quantize(p, dtype)
    assert quantized.dtype == dtype.value
    assert np.abs(dequantize(quantized) - p).max() <= error + 1e-9
    # Quantizing what is quantized changes nothing: what is logged is what was used.
    assert (quantize(dequantize(quantized).astype(np.float32), dtype) == quantized).all()


@pytest.mark.parametrize("bad", [np.nan, -0.01, 1.01])
def test_a_prediction_that_is_no_probability_is_refused(bad: float) -> None:
    with pytest.raises(ValueError, match="must be in"):
        quantize(np.array([[0.5, bad]], np.float32), PredictionDtype.UINT8)


@given(
    cells=st.lists(st.sampled_from([-1, 0, 100]), min_size=12, max_size=12),
    p=st.lists(st.integers(0, 255), min_size=12, max_size=12),
    free=st.floats(0, 1),
    occupied=st.floats(0, 1),
)
def test_the_fused_map_never_contradicts_the_observed_one(
    cells: list[int], p: list[int], free: float, occupied: float
) -> None:
    observed = np.array(cells, np.int8).reshape(3, 4)
    quantized = np.array(p, np.uint8).reshape(3, 4)
    fused = fuse(observed, quantized, Thresholds(free, occupied))
    known = observed != UNKNOWN
    assert (fused[known] == observed[known]).all()
    # Where nothing was observed: the definition, in exact arithmetic.
    limits = Thresholds(free, occupied)
    for said, q in zip(fused[~known].tolist(), quantized[~known].tolist(), strict=True):
        expected = (
            FREE
            if q <= limits.free_at_most * 255
            else OCCUPIED
            if q >= limits.occupied_at_least * 255
            else UNKNOWN
        )
        assert said == expected
