"""Floor plans that can be read and cannot be what was meant: refused, or doubted with numbers."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drawing import draw, plan
from mapreplay.errors import FloorPlanError, UsageError
from mapreplay.floorplan import Doubt, FloorPlan
from mapreplay.floorplans import load_each, open_source
from mapreplay.floorplans.greys import GreyOptions, GreyRule, split_options
from mapreplay.floorplans.plausibility import check_explorable, examine, warning_lines
from mapreplay.floorplans.procedural import generate
from mapreplay.grid import FREE, OCCUPIED, Cell

Image = npt.NDArray[np.uint8]


def building(outside: int, wall: int = 0, free: int = 255) -> Image:
    """Two rooms with a door between them, and a strip around the building: 60 x 80 pixels."""
    image = np.full((60, 80), outside, np.uint8)
    image[8:52, 8:72] = wall
    image[10:50, 10:70] = free
    image[10:50, 40] = wall
    image[20:26, 40] = free
    return image


def read(
    folder: Path, image: npt.NDArray[np.generic], options: str = "", **keys: object
) -> FloorPlan:
    """What is loaded of an image; by a YAML file if there are keys of one."""
    assert cv2.imwrite(str(folder / "plan.png"), image)
    path = folder / "plan.png"
    if keys:
        path = folder / "plan.yaml"
        values = {"image": "plan.png", "resolution": 0.05, "origin": [0, 0, 0], "negate": 0,
                  "occupied_thresh": 0.65, "free_thresh": 0.196} | keys  # fmt: skip
        path.write_text("".join(f"{key}: {value}\n" for key, value in values.items()))
    ((_, found),) = load_each(open_source(f"{path}{options}"), ["plan"])
    if isinstance(found, FloorPlanError):
        raise found
    return found


def kinds(floor_plan: FloorPlan, start: Cell | None = None) -> list[str]:
    return [doubt.kind for doubt in examine(floor_plan, start)]


def text(floor_plan: FloorPlan) -> str:
    return "; ".join(doubt.text for doubt in examine(floor_plan))


# What is as it should be ---------------------------------------------------------------------


@pytest.mark.parametrize(
    "image",
    [
        building(205),
        building(0),
        building(255),  # the rooms are larger than the strip outside
        building(128),  # some programs' unknown
        building(205).astype(np.uint16) * 257,
    ],
    ids=["205", "black", "white", "128", "16 bits"],
)
def test_a_building_is_not_doubted(tmp_path: Path, image: npt.NDArray[np.generic]) -> None:
    assert kinds(read(tmp_path, image)) == []
    assert kinds(read(tmp_path, image, mode="trinary")) == []


@given(st.integers(0, 2**32 - 1))
def test_procedural_plans_are_not_doubted(seed: int) -> None:
    assert examine(generate(seed)) == ()


# Greys ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("mark", [0, 16], ids=["no mark", "start mark"])
def test_a_map_of_greys_between_the_thresholds_is_refused(tmp_path: Path, mark: int) -> None:
    image = building(127, 127, 195)
    image[20:24, 20 : 20 + mark // 4] = 208
    walls, free = int((image == 127).sum()), int((image == 195).sum())
    with pytest.raises(FloorPlanError) as caught:
        read(tmp_path, image)
    line = str(caught.value)
    assert line.startswith(f"{tmp_path}/plan.png: no {'wall' if mark else 'free cell'}; ")
    assert f"{walls + free} of 4800 pixels have the grey 127 or 195, between free (above 205)" in (
        line
    )
    assert "occupied (below 90)" in line
    options = line.partition("plan.png:free=")[2]
    cured = read(tmp_path, image, f":free={options}")
    assert (cured.cells == FREE).sum() == free + mark
    assert (cured.cells == OCCUPIED).sum() == walls


@pytest.mark.parametrize(
    ("levels", "options"),
    [
        ((127, 60, 195), "free=0.37,occupied=0.63"),  # unknown, walls, free
        ((205, 0, 127), "free=0.75,occupied=0.75"),
        ((192, 60, 195), "free=0.50,occupied=0.50"),
    ],
)
def test_thresholds_that_are_proposed(
    tmp_path: Path, levels: tuple[int, int, int], options: str
) -> None:
    with pytest.raises(FloorPlanError, match=rf"such as {tmp_path}/plan\.png:{options}"):
        read(tmp_path, building(*levels))


def test_free_greys_around_a_mark_are_doubted_although_there_are_walls(tmp_path: Path) -> None:
    image = building(205, 0, 127)
    image[20:24, 20:24] = 255
    found = read(tmp_path, image)
    assert "greys between the thresholds" in kinds(found)
    count = int((image == 127).sum())
    assert f"{count} of 4800 pixels have the grey 127," in text(found)


def test_walls_between_the_thresholds_are_doubted_though_they_are_few(tmp_path: Path) -> None:
    found = read(tmp_path, building(255, 127))
    assert kinds(found) == ["greys between the thresholds", "no wall"]
    assert "free=0.25,occupied=0.25" in text(found)
    assert kinds(read(tmp_path, building(255, 127), ":free=0.25,occupied=0.25")) == []


@pytest.mark.parametrize("grey", [255, 240])
def test_an_image_without_any_wall_is_doubted(tmp_path: Path, grey: int) -> None:
    found = read(tmp_path, np.full((60, 80), grey, np.uint8))
    assert kinds(found) == ["no wall"]
    assert f"no pixel is occupied: the only grey is {grey}" in text(found)


@pytest.mark.parametrize(
    ("grey", "line"),
    [
        (0, "no free cell; no pixel is free: the only grey is 0, with free .above 205. and occ"),
        (205, "no free cell; no pixel is free: the only grey is 205"),
        (127, "no free cell; 4800 of 4800 pixels have the grey 127"),
    ],
)
def test_an_image_without_any_free_pixel_says_why(tmp_path: Path, grey: int, line: str) -> None:
    with pytest.raises(FloorPlanError, match=rf"plan\.png: {line}"):
        read(tmp_path, np.full((60, 80), grey, np.uint8))


def test_walls_on_a_clear_background_say_why_nothing_is_free(tmp_path: Path) -> None:
    image = building(255)
    alpha = np.where(image == 0, 255, 0)
    with pytest.raises(FloorPlanError, match=r"no free cell; 4350 of 4800 pixels are transparent"):
        read(tmp_path, np.dstack([image, image, image, alpha]).astype(np.uint8))
    half = np.dstack([image] * 3 + [np.full_like(image, 128)])
    with pytest.raises(FloorPlanError, match="no free cell; all of the 4800 pixels are transp"):
        read(tmp_path, half)


@pytest.mark.parametrize(
    ("keys", "line"),
    [
        ({"free_thresh": 0.25}, "count as free by free_thresh 0.25; 0.196 keeps them unknown"),
        ({"mode": "scale"}, "count as free by mode scale; mode trinary keeps them unknown"),
        ({"mode": "Scale", "free_thresh": 0.25}, "0.196 keeps them unknown in mode trinary"),
        ({"occupied_thresh": 0.1, "free_thresh": 0.1}, "as occupied by occupied_thresh 0.1"),
        ({"negate": 1}, "count as occupied by negate: 1"),
    ],
)
def test_what_map_savers_write_for_unknown_and_is_read_as_something_else(
    tmp_path: Path, keys: dict[str, object], line: str
) -> None:
    found = read(tmp_path, building(205), **keys)
    assert kinds(found)[0].startswith("unknown read as ")
    assert text(found).startswith(
        "1984 of 4800 pixels have the grey 205, which map savers write for unknown, and count as "
    )
    assert line in text(found)
    assert found.where == str(tmp_path / "plan.yaml")


def test_the_cure_for_unknown_read_as_free_is_one(tmp_path: Path) -> None:
    free = read(tmp_path, building(205), free_thresh=0.25)
    assert f"{tmp_path}/plan.yaml:free=0.196" in text(free)
    assert kinds(read(tmp_path, building(205), ":free=0.196", free_thresh=0.25)) == []


def test_a_few_pixels_of_205_among_their_like_are_a_shade(tmp_path: Path) -> None:
    image = building(255)
    image[12:14, 12:32] = np.arange(200, 220)
    assert "unknown read as free" not in kinds(read(tmp_path, image, free_thresh=0.25))


def test_greys_in_mode_raw_are_no_percentages(tmp_path: Path) -> None:
    with pytest.raises(FloorPlanError, match=r"1984 of 4800 pixels are over 100.*mode: trinary"):
        read(tmp_path, building(205), mode="raw")


@pytest.mark.parametrize("outside", [255, 205])
def test_black_and_white_the_wrong_way_round(tmp_path: Path, outside: int) -> None:
    small = 255 - building(outside)
    assert "perhaps inverted" in kinds(read(tmp_path, small))
    large = np.kron(small, np.ones((8, 8), np.uint8))
    found = read(tmp_path, large)
    assert "perhaps inverted" in kinds(found)
    assert "negate" in text(found)
    assert kinds(read(tmp_path, small, ":negate=1")) == []


# Cells, whatever source they are of ----------------------------------------------------------


def test_one_cell_is_nothing_to_explore() -> None:
    alone = plan("#####\n#.#.#\n#####")
    with pytest.raises(FloorPlanError, match=r"floor plan drawn: nothing to explore.*start 1,1"):
        check_explorable(alone)
    closet = plan("#######\n#.#...#\n#######")
    assert check_explorable(closet).sum() == 3
    with pytest.raises(FloorPlanError, match="nothing to explore"):
        check_explorable(closet, Cell(1, 1))


class Plugin:
    """Somebody's source."""

    default_predictor = "none"

    def __init__(self, *pictures: str) -> None:
        self._plans = [plan(picture, f"p{k}") for k, picture in enumerate(pictures)]

    def ids(self) -> Sequence[str]:
        return [one.id for one in self._plans]

    def load(self, floor_plan_id: str) -> FloorPlan:
        return next(one for one in self._plans if one.id == floor_plan_id)


def test_plans_of_plug_ins_are_asked_too() -> None:
    source = Plugin("###\n#.#\n###", "....\n....")
    found = dict(load_each(source, list(source.ids())))
    assert "nothing to explore" in str(found["p0"])
    assert isinstance(found["p1"], FloorPlan)
    assert "no wall" in kinds(found["p1"])


def large(rows: int = 60, cols: int = 80, fill: str = "#") -> npt.NDArray[np.int8]:
    return np.full((rows, cols), draw(fill)[0, 0], np.int8)


def test_nearly_nothing_but_walls() -> None:
    cells = large()
    cells[5, 5:8] = FREE
    assert kinds(FloorPlan("x", cells, 0.2)) == ["almost all wall", "few cells"]


def test_almost_all_unknown() -> None:
    cells = large(fill="?")
    cells[5:12, 5:13] = OCCUPIED
    cells[6:11, 6:12] = FREE
    assert "almost all unknown" in kinds(FloorPlan("x", cells, 0.2))
    assert "4744 of 4800 cells are unknown" in text(FloorPlan("x", cells, 0.2))


def test_walls_that_are_nowhere_near() -> None:
    cells = large(fill="?")
    cells[5:30, 5:30] = FREE
    cells[50, 50] = OCCUPIED
    assert kinds(FloorPlan("x", cells, 0.2))[0] == "no wall"


def test_specks_are_no_walls() -> None:
    cells = large(fill=".")
    cells[30, ::10] = OCCUPIED
    speckled = FloorPlan("x", cells, 0.2)
    assert kinds(speckled)[0] == "no wall"
    assert "of 8 cells that are walls 8 are next to the 4792 free cells" in text(speckled)


def test_a_start_outside_of_the_building() -> None:
    cells = large(fill=".")
    cells[20:40, 20:50] = OCCUPIED
    cells[21:39, 21:49] = FREE
    outside = FloorPlan("x", cells.copy(), 0.2)
    assert kinds(outside) == ["start outside"]
    assert "start 59,0 is probably outside" in text(outside)
    assert "touches the border of the map at 276 of 276 cells" in text(outside)
    assert kinds(outside, Cell(25, 25)) == ["closed off"]
    for edge in (np.s_[0], np.s_[-1], np.s_[:, 0], np.s_[:, -1]):
        cells[edge] = OCCUPIED  # a frame around it all
    framed = FloorPlan("x", cells, 0.2)
    assert kinds(framed) == ["start outside"]
    assert "encloses 504 of " in text(framed)


def test_a_door_at_the_border_is_no_outside() -> None:
    cells = large()
    cells[1:-1, 1:-1] = FREE
    cells[10:14, 0] = FREE
    assert kinds(FloorPlan("x", cells, 0.2)) == []


@pytest.mark.parametrize("resolution", [0.0005, 0.00005, 5.0, 100.0])
def test_cells_of_an_absurd_size(resolution: float) -> None:
    cells = large()
    cells[1:-1, 1:-1] = FREE
    assert kinds(FloorPlan("x", cells, resolution)) == ["cell size"]


# Warnings ------------------------------------------------------------------------------------


def test_a_few_warnings_are_lines_and_many_are_a_summary() -> None:
    wall, out = Doubt("no wall", "it has none"), Doubt("start outside", "choose another")
    assert warning_lines(["a", "b", "c"], [[wall, out], [], [out]]) == [
        "warning: a: it has none; choose another",
        "warning: c: choose another",
    ]
    names = [f"plan{k}" for k in range(100)]
    (line,) = warning_lines(names, [[wall, out] if k % 2 else [] for k in range(99)] + [[out]])
    assert line.startswith(
        "warning: 50 of 100 floor plans may be read wrongly: start outside (50, such as plan1)"
        ", no wall (49, such as plan1)"
    )
    assert warning_lines([], []) == []


# Options -------------------------------------------------------------------------------------


def test_options_behind_the_path(tmp_path: Path) -> None:
    assert split_options("a.png") == ("a.png", GreyOptions())
    assert split_options("a:b.png:free=0.3,negate=1") == (
        "a:b.png",
        GreyOptions(free=0.3, negate=True),
    )
    odd = tmp_path / "x:free=0.3"
    odd.touch()
    assert split_options(str(odd)) == (str(odd), GreyOptions())
    rule = GreyOptions(occupied=0.9, negate=False).applied_to(GreyRule(negate=True))
    assert (rule.thresholds.occupied, rule.thresholds.free, rule.negate) == (0.9, 0.196, False)


@pytest.mark.parametrize(
    "options",
    ["free=x", "free=2", "free=nan", "negate=2", "free=0.1,free=0.2", "free=0.1,mode=1", "fre=1"],
)
def test_options_that_are_none(tmp_path: Path, options: str) -> None:
    read(tmp_path, building(205))
    with pytest.raises(UsageError, match="is not one of free=, occupied="):
        open_source(f"{tmp_path}/plan.png:{options}")


def test_thresholds_that_contradict_each_other(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"free_thresh 0\.7 and occupied_thresh 0\.65"):
        read(tmp_path, building(205), ":free=0.7")
    with pytest.raises(FloorPlanError, match=r"plan\.yaml: free_thresh 0\.7 and occ"):
        read(tmp_path, building(205), ":free=0.7", mode="trinary")


def test_houses_have_no_greys(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text("{}")
    with pytest.raises(UsageError, match="only images and map_server maps"):
        open_source(f"{tmp_path}/a.json:free=0.3")


def test_the_sources_name_and_options_together(tmp_path: Path) -> None:
    read(tmp_path, building(255, 127))
    source = open_source(f"image:{tmp_path}/plan.png:free=0.25,occupied=0.25")
    assert (source.load("plan").cells == OCCUPIED).sum() == 450
