"""Finding the source that a specification means; id lists; choosing; plain images."""

import io
import tarfile
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest

from drawing import plan, show
from mapreplay.errors import FloorPlanError, UsageError
from mapreplay.floorplan import FloorPlan
from mapreplay.floorplans import (
    ENDINGS,
    Selection,
    load_each,
    open_source,
    read_ids,
    select,
)
from mapreplay.floorplans.describe import PlanSummary, describe
from mapreplay.floorplans.houseexpo import HouseExpoSource
from mapreplay.floorplans.image import ImageSource
from mapreplay.floorplans.image import open_source as open_image
from mapreplay.floorplans.map_server import MapServerSource
from mapreplay.floorplans.procedural import ProceduralSource
from mapreplay.grid import Cell
from mapreplay.plugins import PluginKind, available

HOUSE = '{"id": "house", "verts": [[0, 0], [1, 0], [1, 1], [0, 1]]}'
MAP = """
image: room.png
resolution: 0.5
origin: [0, 0, 0]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
"""


def write_png(path: Path, rows: object = ((255, 255), (0, 255))) -> None:
    assert cv2.imwrite(str(path), np.array(rows, np.uint8))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder of each kind, and some files."""
    for name in ("houses", "maps/office", "images", "nothing"):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "houses" / "house.json").write_text(HOUSE)
    (tmp_path / "maps" / "office" / "map.yaml").write_text(MAP)
    write_png(tmp_path / "maps" / "office" / "room.png")
    write_png(tmp_path / "images" / "room.png")
    (tmp_path / "nothing" / "README.txt").write_text("nothing")
    return tmp_path


# open_source ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("spec", "kind", "ids"),
    [
        ("procedural:7", ProceduralSource, ["procedural-7"]),
        ("houses", HouseExpoSource, ["house"]),
        ("houses/house.json", HouseExpoSource, ["house"]),
        ("houseexpo:houses", HouseExpoSource, ["house"]),
        ("maps", MapServerSource, ["office"]),
        ("maps/office", MapServerSource, ["office"]),  # though an image lies beside the YAML
        ("maps/office/map.yaml", MapServerSource, ["office"]),
        ("map_server:maps", MapServerSource, ["office"]),
        ("maps/office/room.png", ImageSource, ["room"]),
        ("images", ImageSource, ["room"]),
        ("image:images", ImageSource, ["room"]),
    ],
)
def test_a_spec_finds_its_source(
    folder: Path, monkeypatch: pytest.MonkeyPatch, spec: str, kind: type, ids: list[str]
) -> None:
    monkeypatch.chdir(folder)
    source = open_source(spec)
    assert isinstance(source, kind)
    assert list(source.ids()) == ids
    assert source.load(ids[0]).id == ids[0]


@pytest.mark.parametrize("ending", ENDINGS)
def test_every_ending_has_a_source_that_opens_it(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"A{ending.upper()}"
    path.write_bytes(b"")
    source = open_source(str(path))
    assert type(source).__module__ == f"mapreplay.floorplans.{ENDINGS[ending]}"
    with pytest.raises(FloorPlanError, match=str(path)):
        source.load("A")


def test_a_bare_name_is_a_source_and_with_a_dot_it_is_a_file(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    (folder / "procedural").mkdir()
    write_png(folder / "procedural" / "x.png")
    assert len(open_source("procedural").ids()) == 100
    assert list(open_source("./procedural").ids()) == ["x"]


def test_the_resolution_reaches_the_source(folder: Path) -> None:
    assert open_source(str(folder / "houses")).load("house").resolution == 0.2
    assert open_source(str(folder / "houses"), 0.1).load("house").resolution == 0.1
    assert open_source(str(folder / "images")).load("room").resolution == 0.05
    assert open_source(str(folder / "images"), 0.1).load("room").resolution == 0.1
    assert open_source(str(folder / "maps")).load("office").resolution == 0.5


@pytest.mark.parametrize(
    "spec", ["missing.tar.gz", "missing.png", "no/such/folder", "houseexpo:missing", "image:x.png"]
)
def test_a_path_that_does_not_exist(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, spec: str
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(FloorPlanError, match=f"{spec.rpartition(':')[2]}: no such file or folder"):
        open_source(spec)


@pytest.mark.parametrize(("spec", "there"), [("Office.png", "office.PNG"), ("a.yml", "a.yaml")])
def test_a_path_that_is_nearly_one(tmp_path: Path, spec: str, there: str) -> None:
    (tmp_path / there).touch()
    with pytest.raises(FloorPlanError, match=rf"no such file or folder; is it {tmp_path}/{there}"):
        open_source(str(tmp_path / spec))


@pytest.mark.parametrize("spec", ["", "procedrual", "unknown:rest", "a\0b", "x" * 5000])
def test_what_is_neither_a_source_nor_a_path_lists_what_is_understood(spec: str) -> None:
    with pytest.raises(UsageError, match=r"no such file or folder, and no source; supported are"):
        open_source(spec)


@pytest.mark.parametrize(
    ("name", "reason"),
    [("nothing", "not a folder of floor plans, it holds 1 .txt file"),
     ("nothing/README.txt", "not a floor plan")],
)  # fmt: skip
def test_what_is_not_a_floor_plan_lists_what_is_understood(
    folder: Path, name: str, reason: str
) -> None:
    with pytest.raises(UsageError, match=f"{name}: {reason}") as caught:
        open_source(str(folder / name))
    for known in ("procedural", "houseexpo", "map_server", "image", ".tar.gz", ".yaml", ".png"):
        assert known in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["houseexpo", "map_server", "image"])
def test_a_source_of_files_needs_a_path(name: str) -> None:
    with pytest.raises(UsageError, match=f"{name}: which file or folder"):
        open_source(name)


def test_the_built_in_sources_come_through_the_same_door_as_any_other() -> None:
    ours = {
        name
        for name, plugin in available(PluginKind.FLOORPLANS).items()
        if plugin.distribution == "mapreplay"
    }
    assert {*ENDINGS.values(), "procedural"} == ours


# Id lists and choosing -----------------------------------------------------------------------


def test_an_id_list_has_blank_lines_and_comments(tmp_path: Path) -> None:
    path = tmp_path / "ids.txt"
    path.write_bytes(b"\xef\xbb\xbf# the test houses\r\nb\r\n\r\n  a  # the best\r\nb\r\n#c\r\n")
    assert read_ids(path) == ["b", "a", "b"]


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"", "contains no ID"),
        (b"# nothing\n\n", "contains no ID"),
        (b"a\n../b\n", "line 2: '../b' is not an id"),
        (b"a b\n", "line 1: 'a b' is not an id"),
        (b"x" * 129, "line 1: 'x*' is not an id"),
        (b"\xff\x00\x80", "not a text file"),
        ("a\n".encode("utf-16"), "UTF-16 text"),
        (b"\x89PNG\r\n\x1a\n", "not a list of ids: a PNG image"),
        (b"version https://git-lfs.github.com/spec/v1\n", "Git LFS pointer"),
        (b"a\n" * 1_000_001, "1000001 lines; at most 1000000"),
    ],
)
def test_what_is_not_an_id_list_is_refused(tmp_path: Path, content: bytes, reason: str) -> None:
    path = tmp_path / "ids.txt"
    path.write_bytes(content)
    with pytest.raises(FloorPlanError, match=rf"ids\.txt.*{reason}"):
        read_ids(path)


def test_an_id_list_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(FloorPlanError, match=r"ids\.txt: no such file"):
        read_ids(tmp_path / "ids.txt")
    with pytest.raises(FloorPlanError, match="is a folder"):
        read_ids(tmp_path)


@pytest.mark.parametrize(
    ("wanted", "limit", "expected"),
    [
        (None, None, Selection(("procedural-1", "procedural-2", "procedural-3"), ())),
        (None, 2, Selection(("procedural-1", "procedural-2"), ())),
        (None, 0, Selection((), ())),
        (["procedural-3", "procedural-1"], None, Selection(("procedural-3", "procedural-1"), ())),
        (["procedural-3", "procedural-1"], 1, Selection(("procedural-3",), ())),
        (["x", "procedural-3", "y", "x"], 1, Selection(("procedural-3",), ("x", "y"))),
        (["procedural-2", "procedural-2"], None, Selection(("procedural-2",), ())),
        ([], None, Selection((), ())),
    ],
)
def test_select(wanted: Sequence[str] | None, limit: int | None, expected: Selection) -> None:
    assert select(open_source("procedural:1-3"), wanted, limit) == expected


def test_a_negative_limit_is_refused() -> None:
    with pytest.raises(UsageError, match="limit -1"):
        select(open_source("procedural:1-3"), None, -1)


# Plain images --------------------------------------------------------------------------------


def test_floor_plans_come_as_they_were_asked_for_and_are_loaded_as_the_source_has_them() -> None:
    loaded = []

    class Archive:
        default_predictor = "none"

        def ids(self) -> Sequence[str]:
            return ["a", "b", "c", "d"]

        def load(self, floor_plan_id: str) -> FloorPlan:
            loaded.append(floor_plan_id)
            if floor_plan_id == "b":
                raise FloorPlanError("house b: not a house")
            return FloorPlan(floor_plan_id, plan("..").cells, 0.2)

    found = dict(load_each(Archive(), ["d", "b", "a"]))
    assert list(found) == ["d", "b", "a"]
    assert loaded == ["a", "b", "d"]
    assert isinstance(found["b"], FloorPlanError)
    assert found["d"].id == "d"  # type: ignore[union-attr]


def test_a_plain_image(tmp_path: Path) -> None:
    write_png(tmp_path / "my room.png", [[0, 205, 255], [255, 120, 254]])
    source = ImageSource(tmp_path / "my room.png")
    assert list(source.ids()) == ["my-room"]
    loaded = source.load("my-room")
    assert show(loaded.cells) == "#?.\n.?."
    assert loaded.origin == (0.0, 0.0)
    assert source.default_predictor == "d2"


def test_a_transparent_pixel_is_unknown(tmp_path: Path) -> None:
    write_png(tmp_path / "a.png", [[[0, 0, 0, 0], [0, 0, 0, 255], [255] * 4, [255] * 3 + [0]]])
    assert show(ImageSource(tmp_path / "a.png").load("a").cells) == "?#.?"


def test_a_folder_of_images(tmp_path: Path) -> None:
    for name in ("b.png", "a.PGM", "a.png"):
        write_png(tmp_path / name)
    (tmp_path / "below").mkdir()
    write_png(tmp_path / "below" / "c.png")
    (tmp_path / "notes.txt").write_text("not an image")
    empty = tmp_path / "empty"
    empty.mkdir()
    source = ImageSource(tmp_path)
    assert list(source.ids()) == ["a", "a-2", "b"]
    with pytest.raises(FloorPlanError, match="holds no image c"):
        source.load("c")
    with pytest.raises(FloorPlanError, match=r"holds no \.png or \.pgm image"):
        ImageSource(empty).ids()


@pytest.mark.parametrize("resolution", [0.0, -1.0, float("nan"), float("inf")])
def test_an_image_needs_a_resolution_that_makes_sense(tmp_path: Path, resolution: float) -> None:
    write_png(tmp_path / "a.png")
    with pytest.raises(UsageError, match="positive number of metres"):
        open_image(str(tmp_path / "a.png"), resolution)


# Junk, links and folders of other things -------------------------------------------------------

JUNK = b"\x00\x05\x16\x07" + bytes(100)


def test_junk_of_a_mac_is_passed_over_and_takes_no_id(folder: Path) -> None:
    (folder / "images" / "._room.png").write_bytes(JUNK)
    (folder / "images" / ".hidden.png").write_bytes(JUNK)
    (folder / "houses" / "._house.json").write_bytes(JUNK)
    (folder / "houses" / ".DS_Store").write_bytes(JUNK)
    (folder / "maps" / "office" / "._map.yaml").write_bytes(b"image: x.png\n")
    for hidden in ("__MACOSX", ".git"):
        (folder / "maps" / hidden / "office").mkdir(parents=True)
        (folder / "maps" / hidden / "office" / "map.yaml").write_text(MAP)
    for name, expected in (("images", "room"), ("houses", "house"), ("maps", "office")):
        source = open_source(str(folder / name))
        assert list(source.ids()) == [expected]
        assert source.load(expected).id == expected


def test_junk_alone_is_nothing(tmp_path: Path) -> None:
    (tmp_path / "._room.png").write_bytes(JUNK)
    with pytest.raises(UsageError, match="not a folder of floor plans, it holds no file"):
        open_source(str(tmp_path))


def test_junk_that_is_named_says_what_it_is(tmp_path: Path) -> None:
    (tmp_path / "._room.png").write_bytes(JUNK)
    source = open_source(str(tmp_path / "._room.png"))
    with pytest.raises(FloorPlanError, match="a Mac's resource fork"):
        source.load(source.ids()[0])


def test_a_hidden_folder_that_is_named_is_read(tmp_path: Path) -> None:
    (tmp_path / ".plans").mkdir()
    write_png(tmp_path / ".plans" / "a.png")
    assert list(open_source(str(tmp_path / ".plans")).ids()) == ["a"]


@pytest.mark.parametrize("prefix", ["", "./", "houses/"])
def test_junk_in_an_archive(tmp_path: Path, prefix: str) -> None:
    path = tmp_path / "houses.tar.gz"
    members = {"._house.json": JUNK, "__MACOSX/other.json": JUNK, "house.json": HOUSE.encode(),
               "B.JSON": HOUSE.encode(), ".x/c.json": HOUSE.encode()}  # fmt: skip
    with tarfile.open(path, "w:gz") as archive:
        for name, content in members.items():
            info = tarfile.TarInfo(prefix + name)
            info.size = len(content)
            archive.addfile(info, io.BytesIO(content))
    source = open_source(str(path))
    assert list(source.ids()) == ["house", "B"]
    assert source.load("house").id == "house"
    assert source.load("B").id == "B"


def test_endings_in_capitals(tmp_path: Path) -> None:
    (tmp_path / "A.JSON").write_text(HOUSE)
    assert open_source(str(tmp_path / "A.JSON")).load("A").id == "A"
    assert open_source(str(tmp_path)).load("A").id == "A"


def test_a_broken_link_says_where_to(folder: Path) -> None:
    (folder / "gone.png").symlink_to("elsewhere.png")
    (folder / "images" / "gone.png").symlink_to("elsewhere.png")
    with pytest.raises(FloorPlanError, match=r"gone\.png: a broken link, to elsewhere\.png"):
        open_source(str(folder / "gone.png"))
    source = open_source(str(folder / "images"))
    assert list(source.ids()) == ["gone", "room"]
    with pytest.raises(FloorPlanError, match=r"gone\.png: is a broken link, to elsewhere\.png"):
        source.load("gone")


def test_a_folder_of_other_things_says_what_and_where_to_look(tmp_path: Path) -> None:
    inner = tmp_path / "plans"
    inner.mkdir()
    write_png(inner / "a.png")
    with pytest.raises(UsageError, match=f"not a folder of floor plans, but {inner} is one"):
        open_source(str(tmp_path))
    logs = tmp_path / "logs"
    logs.mkdir()
    (logs / "run.mcap").write_bytes(b"\x89MCAP0\r\n")
    with pytest.raises(UsageError, match=r"run\.mcap is an MCAP file \(a log .*mapreplay ls"):
        open_source(str(logs))
    texts = tmp_path / "texts"
    texts.mkdir()
    for name in ("a.txt", "b.txt", "c.csv"):
        (texts / name).write_text("a")
    with pytest.raises(UsageError, match=r"it holds 2 \.txt and 1 \.csv files"):
        open_source(str(texts))


def test_a_folder_that_cannot_be_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(_: Path) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "iterdir", refuse)
    with pytest.raises(FloorPlanError, match=f"{tmp_path}: cannot be read"):
        ImageSource(tmp_path).ids()


# Describing ----------------------------------------------------------------------------------


def test_describe_counts_by_hand() -> None:
    drawn = plan(
        """
        #######
        #...#.#
        #..?###
        ####???
        """,
        "flat",
        0.5,
    )
    assert describe(drawn) == PlanSummary(
        id="flat",
        height=4,
        width=7,
        resolution=0.5,
        width_m=3.5,
        height_m=2.0,
        wall_share=13 / 18,
        free=6,
        explorable=18,
        unknown=4,
        start=Cell(2, 1),
    )
