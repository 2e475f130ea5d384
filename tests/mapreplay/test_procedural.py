"""Procedural floor plans: what all of them have in common, and that they never change."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from mapreplay.errors import FloorPlanError, UsageError
from mapreplay.floorplan import explorable
from mapreplay.floorplans.procedural import (
    D1,
    MAX_PLANS,
    MAX_SEED,
    ProceduralSource,
    Style,
    generate,
    open_source,
)
from mapreplay.grid import FREE, OCCUPIED

SEEDS = st.integers(0, MAX_SEED)
STYLES = st.builds(
    Style,
    height=st.integers(24, 70),
    width=st.integers(24, 70),
    min_room=st.integers(6, 12),
    door=st.integers(2, 4),
)

GOLDEN = {
    0: "c98798dec7e6d6dc3bd83ff24ec67b07ae99c4901189e50525f610e6fe9813df",
    1: "aaee8b2018df419aae982e07df6eaa6871eafef724cc1ca423da49c928157fca",
    60_000: "8365933d78ba3add093f2afd4aa2aec173534d4840343057a887e41ab4a43919",
    60_999: "cebbfb10d5f347d9416845cbd1ca677c1a5406c95f229d26cfc38b48096be9a5",
    MAX_SEED: "1baa7fe9f596670c4d0979c733ba46e3db74637d75ba8a2edd39e0a137a1c854",
}


@pytest.mark.parametrize(("seed", "digest"), GOLDEN.items())
def test_a_seed_means_the_same_plan_for_ever(seed: int, digest: str) -> None:
    assert generate(seed).sha256 == digest


@given(SEEDS)
@settings(max_examples=20)
def test_a_seed_means_one_plan(seed: int) -> None:
    assert generate(seed).sha256 == generate(seed).sha256


def test_seeds_mean_different_plans() -> None:
    assert len({generate(seed).sha256 for seed in range(200)}) == 200


@given(SEEDS, STYLES)
@settings(max_examples=60, deadline=None)
def test_the_contour_is_closed_and_every_free_cell_can_be_reached(seed: int, style: Style) -> None:
    plan = generate(seed, style)
    assert plan.shape == (style.height, style.width)
    inside = np.zeros(plan.shape, bool)
    inside[1:-1, 1:-1] = True
    assert (plan.cells[~inside] == OCCUPIED).all()
    assert explorable(plan.cells, plan.default_start)[plan.cells == FREE].all()


@given(SEEDS, STYLES)
@settings(max_examples=60, deadline=None)
def test_rooms_are_large_enough_and_doors_of_one_width_join_them_as_a_tree(
    seed: int, style: Style
) -> None:
    free = generate(seed, style).cells == FREE
    # What a square of the minimal room's size cannot cover is a door: walls are one cell thick.
    rooms = ndimage.binary_opening(free, np.ones((style.min_room, style.min_room), bool))
    doors, door_count = ndimage.label(free & ~rooms)
    _, room_count = ndimage.label(rooms)
    assert door_count == room_count - 1
    for rows, cols in ndimage.find_objects(doors):
        sides = (rows.stop - rows.start, cols.stop - cols.start)
        assert sorted(sides) == [1, style.door]
        before = (rows.start - 1, cols.start) if sides[1] == 1 else (rows.start, cols.start - 1)
        after = (rows.stop, cols.start) if sides[1] == 1 else (rows.start, cols.stop)
        assert not free[before]
        assert not free[after]


def test_d1_varies_little_in_its_share_of_walls() -> None:
    shares = [generate(seed).wall_share for seed in range(60_000, 60_100)]
    assert 0.13 < np.mean(shares) < 0.15
    assert np.std(shares) < 0.01


@pytest.mark.parametrize("seed", [-1, MAX_SEED + 1, 10**30])
def test_a_seed_out_of_range_is_refused(seed: int) -> None:
    with pytest.raises(UsageError, match=f"seed {seed} is not in 0 to 4294967295"):
        generate(seed)


@pytest.mark.parametrize(
    ("spec", "first", "last", "count"),
    [
        ("", "procedural-60000", "procedural-60099", 100),
        ("7", "procedural-7", "procedural-7", 1),
        ("5-8", "procedural-5", "procedural-8", 4),
        ("4294967295", "procedural-4294967295", "procedural-4294967295", 1),
    ],
)
def test_a_spec_is_a_seed_or_a_range(spec: str, first: str, last: str, count: int) -> None:
    ids = ProceduralSource(spec).ids()
    assert (ids[0], ids[-1], len(ids)) == (first, last, count)


@pytest.mark.parametrize(
    "spec",
    ["x", "-1", "1-", "-", "8-5", "1-2-3", "1.5", "4294967296", "9" * 5000, "٣", " 7", "1 - 2"],
)
def test_a_bad_spec_is_refused(spec: str) -> None:
    with pytest.raises(UsageError, match=r"^procedural:.*seeds?"):
        ProceduralSource(spec)


def test_more_plans_than_anybody_needs_are_refused() -> None:
    assert len(ProceduralSource(f"1-{MAX_PLANS}").ids()) == MAX_PLANS
    with pytest.raises(UsageError, match="at most 1000000 seeds"):
        ProceduralSource(f"0-{MAX_PLANS}")


def test_the_source_loads_what_it_lists() -> None:
    source = open_source("3-4", None)
    assert [source.load(i).id for i in source.ids()] == ["procedural-3", "procedural-4"]
    assert source.load("procedural-4").sha256 == generate(4).sha256
    assert source.default_predictor == "d1"


@pytest.mark.parametrize("name", ["procedural-5", "procedural-03", "procedural-x", "3", ""])
def test_the_source_refuses_what_it_does_not_list(name: str) -> None:
    with pytest.raises(FloorPlanError, match="not of the seeds 3-4"):
        open_source("3-4", None).load(name)


def test_only_the_own_resolution_is_offered() -> None:
    assert open_source("3", D1.resolution).load("procedural-3").resolution == D1.resolution
    with pytest.raises(UsageError, match=r"0\.2 m per cell, not 0\.1"):
        open_source("3", 0.1)
