"""Contact sheets, pixel by pixel where a reader can count."""

import numpy as np
import pytest

from drawing import plan
from mapreplay.errors import UsageError
from mapreplay.floorplan import FloorPlan
from mapreplay.floorplans import preview
from mapreplay.floorplans.preview import contact_sheet
from mapreplay.floorplans.procedural import generate
from mapreplay.pictures import Picture

ROOM = """
    ########
    #......#
    #......#
    #.##...#
    #.#?...#
    #......#
    #......#
    ########
    """


def tile(sheet: Picture, side: int = 240, column: int = 0) -> Picture:
    left = preview._GAP + column * (side + preview._GAP)
    return sheet[preview._GAP : preview._GAP + side, left : left + side]


def colour_of(sheet: Picture, row_from_top: int, col: int) -> tuple[int, ...]:
    """The colour in the middle of a cell of an 8 x 8 map."""
    return tuple(int(v) for v in tile(sheet)[row_from_top * 30 + 15, col * 30 + 15])


def test_row_0_is_at_the_bottom_and_each_kind_of_cell_has_its_colour() -> None:
    sheet = contact_sheet([plan(ROOM)])
    assert colour_of(sheet, 3, 3) == preview._WALL
    assert colour_of(sheet, 4, 3) == preview._UNKNOWN
    assert colour_of(sheet, 5, 3) == preview._FREE
    assert colour_of(sheet, 0, 0) == preview._WALL
    assert colour_of(sheet, 1, 1) == preview._START  # the top-left free cell


def test_what_is_not_explorable_is_paler_and_empty_margins_are_left_out() -> None:
    # What can be explored is 10 x 10 cells of 24 pixels; in it lies a closed room.
    drawn = plan("""
        ############
        ############
        #........###
        #.######.###
        #.######.###
        #.##..##.###
        #.##..##.###
        #.######.###
        #.######.###
        #........###
        ############
        """)
    picture = tile(contact_sheet([drawn]))
    row = [tuple(int(v) for v in picture[5 * 24 + 12, col * 24 + 12]) for col in range(10)]
    half = [preview._WALL, preview._FREE, preview._WALL, preview._SOLID, preview._CLOSED]
    assert row == half + half[::-1]


def test_maps_of_one_scale_keep_their_proportions() -> None:
    small, large = FloorPlan("s", np.zeros((10, 10), np.int8), 0.1), plan(ROOM, "l", 0.25)
    fitted = contact_sheet([small, large], columns=2, scale="fit")
    same = contact_sheet([small, large], columns=2, scale="same")
    paper = np.array(preview._PAPER)
    widths = [
        [int((tile(sheet, column=i)[120] != paper).any(axis=1).sum()) for i in (0, 1)]
        for sheet in (fitted, same)
    ]
    assert widths == [[240, 240], [120, 240]]  # 1 m and 2 m


def test_the_sheet_is_a_grid() -> None:
    plans = [generate(seed) for seed in range(6)]
    one_row = contact_sheet(plans, columns=6, tile_pixels=64)
    one_column = contact_sheet(plans, columns=1, tile_pixels=64)
    assert one_row.dtype == np.uint8
    assert one_row.shape[1] == 6 * (64 + preview._GAP) + preview._GAP
    assert one_column.shape[1] == 64 + 2 * preview._GAP
    assert contact_sheet(plans[:2], columns=9, tile_pixels=64).shape[1] == 2 * 80 + 16
    assert (contact_sheet(plans, columns=6, tile_pixels=64) == one_row).all()


@pytest.mark.parametrize(("tiles", "columns"), [(1, 1), (2, 2), (6, 3), (7, 4), (12, 4), (20, 5)])
def test_the_number_of_columns_fills_the_rows(tiles: int, columns: int) -> None:
    assert preview._columns(tiles) == columns


def test_a_long_id_is_cut_to_its_tile() -> None:
    sheet = contact_sheet([plan(ROOM, "x" * 128)], tile_pixels=64)
    beside = sheet[:, preview._GAP + 64 + 2 :]
    assert (beside == np.array(preview._PAPER)).all()


def test_a_map_larger_than_its_tile_keeps_its_walls() -> None:
    cells = np.zeros((1000, 1000), np.int8)
    cells[1:, 500] = 100
    picture = tile(contact_sheet([FloorPlan("thin", cells, 0.05)], tile_pixels=100), 100)
    assert picture[50, 49:51].mean(axis=1).min() < 200
    assert picture[50, 40].mean() == 255


@pytest.mark.parametrize(
    ("count", "columns", "tile_pixels", "reason"),
    [
        (0, None, 240, "at least one floor plan"),
        (1, 0, 240, "0 columns"),
        (1, None, 10, "tiles of 10 pixels"),
        (1, None, 10_000, "tiles of 10000 pixels"),
        (100, None, 2048, "over 100 megapixels"),
    ],
)
def test_a_sheet_that_makes_no_sense_is_refused(
    count: int, columns: int | None, tile_pixels: int, reason: str
) -> None:
    with pytest.raises(UsageError, match=reason):
        contact_sheet([plan(ROOM)] * count, columns, tile_pixels)
