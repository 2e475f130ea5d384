"""HouseExpo: rasterizing that keeps thin walls, and files that lie."""

import contextlib
import gzip
import io
import json
import lzma
import math
import re
import tarfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drawing import show
from mapreplay.errors import FloorPlanError, UsageError
from mapreplay.files.identify import identify
from mapreplay.floorplans import load_each
from mapreplay.floorplans.houseexpo import (
    MAX_JSON_BYTES,
    House,
    HouseExpoSource,
    open_source,
    parse_house,
    rasterize,
)
from mapreplay.grid import FREE

Points = Sequence[tuple[float, float]]

SQUARE: Points = [(0, 0), (1, 0), (1, 1), (0, 1)]


def text(verts: object = SQUARE, name: object = "house") -> bytes:
    return json.dumps({"id": name, "verts": verts, "bbox": {}, "room_num": 1}).encode()


def drawn(points: Points, resolution: float) -> str:
    return show(rasterize(House("house", np.array(points, float)), resolution).cells)


def picture(lines: str) -> str:
    return "\n".join(line.strip() for line in lines.strip().splitlines())


# Rasterizing ---------------------------------------------------------------------------------


def test_a_square_room() -> None:
    assert drawn(SQUARE, 0.25) == picture("""
        ######
        #....#
        #....#
        #....#
        #....#
        ######
        """)


def test_a_thin_wall_between_two_rooms_survives() -> None:
    # A wall of 0.1 m from below, as a notch of the polygon; cells of 0.2 m.
    notch: Points = [
        (0, 0), (0.45, 0), (0.45, 0.8), (0.55, 0.8), (0.55, 0), (1, 0), (1, 1), (0, 1),
    ]  # fmt: skip
    assert drawn(notch, 0.2) == picture("""
        #######
        #.....#
        #..#..#
        #..#..#
        #..#..#
        #..#..#
        #######
        """)


def test_a_cell_that_is_not_wholly_inside_is_occupied() -> None:
    # 1.1 m wide: the last column of cells of 0.5 m is only 0.1 m free.
    assert drawn([(0, 0), (1.1, 0), (1.1, 1), (0, 1)], 0.5) == picture("""
        #####
        #..##
        #..##
        #####
        """)


def test_row_0_is_the_smallest_y_and_the_origin_is_where_the_cells_are() -> None:
    corner: Points = [(10, -3), (12, -3), (12, -2), (11, -2), (11, -1), (10, -1)]
    plan = rasterize(House("house", np.array(corner)), 0.5)
    assert show(plan.cells) == picture("""
        ######
        #..###
        #..###
        #....#
        #....#
        ######
        """)
    assert plan.origin == (9.5, -3.5)
    assert plan.resolution == 0.5


def test_the_inside_of_a_polygon_that_crosses_itself_is_where_crossings_are_odd() -> None:
    # Once around the large square and once around the small one inside: twice around that.
    twice: Points = [
        (0, 0), (4, 0), (4, 4), (0, 4), (0, 0), (1, 1), (3, 1), (3, 3), (1, 3), (1, 1),
    ]  # fmt: skip
    assert drawn(twice, 1.0) == picture("""
        ######
        #....#
        #.##.#
        #.##.#
        #....#
        ######
        """)
    bow_tie: Points = [(0, 0), (4, 4), (4, 0), (0, 4)]
    assert drawn(bow_tie, 0.5) == picture("""
        ##########
        ##########
        #.######.#
        #..####..#
        #...##...#
        #...##...#
        #..####..#
        #.######.#
        ##########
        ##########
        """)


@given(
    st.lists(st.floats(0.2, 1.0), min_size=3, max_size=12),
    st.floats(-50, 50),
    st.sampled_from([0.1, 0.2, 0.25]),
)
@settings(deadline=None, max_examples=25)
def test_every_free_cell_lies_inside_of_the_polygon(
    radii: list[float], shift: float, resolution: float
) -> None:
    angles = 2 * np.pi * np.arange(len(radii)) / len(radii)
    points = shift + 3 * np.array(radii)[:, None] * np.stack([np.cos(angles), np.sin(angles)], 1)
    try:
        plan = rasterize(House("star", points), resolution)
    except FloorPlanError:  # slivers without a whole cell
        return
    slack = 1.5 / 80  # a fine pixel and its corner
    for row, col in np.argwhere(plan.cells == FREE):
        for dx, dy in ((0.5, 0.5), (slack, slack), (1 - slack, 1 - slack)):
            x = plan.origin.x + (col + dx) * resolution
            y = plan.origin.y + (row + dy) * resolution
            assert _inside_or_close(points, x, y, slack)


def _inside_or_close(points: np.ndarray, x: float, y: float, slack: float) -> bool:
    inside = False
    for (x0, y0), (x1, y1) in zip(points, np.roll(points, -1, axis=0), strict=True):
        if (y0 > y) != (y1 > y) and x < x0 + (y - y0) * (x1 - x0) / (y1 - y0):
            inside = not inside
        length = math.hypot(x1 - x0, y1 - y0)
        along = ((x - x0) * (x1 - x0) + (y - y0) * (y1 - y0)) / max(length, 1e-9) ** 2
        along = min(max(along, 0), 1)
        if math.hypot(x - x0 - along * (x1 - x0), y - y0 - along * (y1 - y0)) < slack:
            return True
    return inside


def test_a_polygon_of_12249_vertices() -> None:
    angles = np.linspace(0, 2 * np.pi, 12_249, endpoint=False)
    circle = 5 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    plan = rasterize(parse_house(text(circle.tolist()), "circle"), 0.2)
    area = float((plan.cells == FREE).sum()) * 0.2**2
    assert 0.9 * math.pi * 25 < area < math.pi * 25


def test_a_house_of_100_metres_is_read_and_one_of_300_metres_is_refused() -> None:
    large = parse_house(text([(0, 0), (100, 0), (100, 60), (0, 60)]), "large")
    assert rasterize(large, 0.2).shape == (302, 502)
    with pytest.raises(FloorPlanError, match="huge: 300 m across; at most 200 m"):
        parse_house(text([(0, 0), (300, 0), (300, 60), (0, 60)]), "huge")


def test_a_house_without_a_free_cell_is_refused_with_its_id() -> None:
    line = parse_house(text([(0, 0), (5, 0), (3, 0)], "flat"), "line")
    with pytest.raises(FloorPlanError, match="house flat: no free cell"):
        rasterize(line, 0.2)


@pytest.mark.parametrize("resolution", [0.0, -1.0, 1e-300, 1e6, math.nan, math.inf])
def test_a_resolution_that_makes_no_sense_is_refused(resolution: float, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"must be 0\.01 to 5 metres per cell"):
        open_source(str(tmp_path), resolution)


def test_too_many_cells_are_refused() -> None:
    large = parse_house(text([(0, 0), (100, 0), (100, 60), (0, 60)]), "large")
    with pytest.raises(FloorPlanError, match=r"house house: .*at most 4096"):
        rasterize(large, 0.02)


# JSON that lies ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"", "not a JSON file"),
        (b"\xff\xfe\x00", "not a JSON file"),
        (b'{"id": "a", "verts": [[0, 0], [1, 0]', "not a JSON file"),
        (b"[" * 100_000, "not a JSON file"),
        (b'{"a":' * 100_000, "not a JSON file"),
        (b"[1, 2]", "expected a JSON object"),
        (b"null", "expected a JSON object"),
        (b'{"verts": []}', "key 'id' is missing"),
        (b'{"id": "a"}', "key 'verts' is missing"),
        (text(name=7), "id 7 is not letters"),
        (text(name="../../etc/passwd"), "is not letters"),
        (text(name=""), "is not letters"),
        (text(name="x" * 1000), "is not letters"),
        (text(verts={}), "list of 3 to 1000000 points"),
        (text(verts="square"), "list of 3 to 1000000 points"),
        (text(verts=[]), "list of 3 to 1000000 points"),
        (text(verts=[[0, 0], [1, 1]]), "list of 3 to 1000000 points"),
        (text(verts=[[0, 0], [1, 1], [1]]), r"vertex \[1\] is not two finite"),
        (text(verts=[[0, 0], [1, 1], [1, 2, 3]]), "is not two finite"),
        (text(verts=[[0, 0], [1, 1], None]), "vertex None is not"),
        (text(verts=[[0, 0], [1, 1], ["1", 0]]), "is not two finite"),
        (text(verts=[[0, 0], [1, 1], [True, 0]]), r"vertex \[True, 0\] is not"),
        (text(verts=[[0, 0], [1, 1], [math.nan, 0]]), r"vertex \[nan, 0\] is not"),
        (text(verts=[[0, 0], [1, 1], [0, math.inf]]), r"vertex \[0, inf\] is not"),
        (text(verts=[[0, 0], [1, 1], [0, 1e300]]), "is not two finite"),
        (text(verts=[[0, 0], [1, 1], [0, 10**400]]), "is not two finite"),
        (b'{"id": "a", "verts": [[0, 0], [1, 1], [0, 1' + b"0" * 9999 + b"]]}", "not a JSON file"),
        (b'{"id": "a", "verts": [' + b"[" * 500 + b"]" * 500 + b", 1, 2]}", "is not two finite"),
    ],
)
def test_json_that_is_not_a_house_is_refused(content: bytes, reason: str) -> None:
    with pytest.raises(FloorPlanError, match=f"(?s)^the file: .*{reason}") as caught:
        parse_house(content, "the file")
    assert len(str(caught.value)) < 250
    assert "\n" not in str(caught.value)


JSON_VALUES = st.one_of(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    st.lists(st.lists(st.integers() | st.floats() | st.none(), max_size=3), max_size=5),
)


@given(JSON_VALUES, JSON_VALUES)
def test_no_json_object_raises_anything_else(name: object, verts: object) -> None:
    with contextlib.suppress(FloorPlanError):
        rasterize(parse_house(text(verts, name), "any"), 0.2)
    with contextlib.suppress(FloorPlanError):
        rasterize(parse_house(text(verts, "house"), "any"), 0.2)


# Archives, folders and files -----------------------------------------------------------------

TRIANGLE: Points = [(0, 0), (2, 0), (0, 2)]
HOUSES = {
    "a": text(SQUARE, "a"),
    "b": text(TRIANGLE, "b"),
    "c": text([(0, 0), (3, 0), (3, 1), (0, 1)], "c"),
}


def write_tar(path: Path, members: Mapping[str, bytes], mode: str = "w:gz") -> Path:
    with tarfile.open(path, mode) as archive:  # type: ignore[call-overload]
        for name, content in members.items():
            member = tarfile.TarInfo(name)
            member.size = len(content)
            archive.addfile(member, io.BytesIO(content))
    return path


@pytest.fixture
def archive(tmp_path: Path) -> Path:
    return write_tar(
        tmp_path / "json.tar.gz", {f"json/{name}.json": HOUSES[name] for name in "bca"}
    )


def test_archive_folder_and_file_give_the_same_plans(archive: Path, tmp_path: Path) -> None:
    folder = tmp_path / "houses"
    folder.mkdir()
    for name, content in HOUSES.items():
        (folder / f"{name}.json").write_bytes(content)
    plain = write_tar(tmp_path / "json.tar", {f"{n}.json": c for n, c in HOUSES.items()}, "w")
    sources = [HouseExpoSource(path) for path in (archive, folder, plain)]
    assert [list(source.ids()) for source in sources] == [
        ["b", "c", "a"],  # the order of the archive
        ["a", "b", "c"],  # sorted
        ["a", "b", "c"],
    ]
    for name in HOUSES:
        digests = {source.load(name).sha256 for source in sources}
        single = HouseExpoSource(folder / f"{name}.json")
        assert list(single.ids()) == [name]
        assert digests == {single.load(name).sha256}


@pytest.mark.parametrize("order", ["bca", "acb", "aabbcc", "cbacba"])
def test_houses_are_loaded_in_any_order(archive: Path, order: str) -> None:
    source = HouseExpoSource(archive)
    widths = {"a": 7, "b": 12, "c": 17}
    for name in order:
        plan = source.load(name)
        assert (plan.id, plan.shape[1]) == (name, widths[name])


def test_one_pass_reads_ahead(archive: Path) -> None:
    source = HouseExpoSource(archive)
    source.load("b")
    archive.unlink()
    assert source.load("a").id == "a"
    assert source.load("c").id == "c"
    with pytest.raises(FloorPlanError, match=r"json\.tar\.gz: "):
        source.load("c")  # was given once, and is not kept


def test_the_read_ahead_is_limited(archive: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mapreplay.floorplans.houseexpo.READ_AHEAD_BYTES", 1)
    source = HouseExpoSource(archive)
    assert source.load("a").id == "a"  # the last one, behind more than may be kept
    assert source.load("b").id == "b"
    archive.unlink()
    assert source.load("c").id == "c"
    with pytest.raises(FloorPlanError, match="not a readable tar archive"):
        source.load("a")


def test_nothing_is_unpacked(archive: Path) -> None:
    before = sorted(archive.parent.rglob("*"))
    source = HouseExpoSource(archive)
    for name in source.ids():
        source.load(name)
    assert sorted(archive.parent.rglob("*")) == before


def test_of_two_houses_with_one_name_the_first_counts(tmp_path: Path) -> None:
    path = write_tar(
        tmp_path / "twice.tar",
        {"1/a.json": HOUSES["a"], "b.json": HOUSES["b"], "2/a.json": HOUSES["c"]},
        "w",
    )
    for order in ("ab", "ba"):
        source = HouseExpoSource(path)
        assert list(source.ids()) == ["a", "b"]
        assert {name: source.load(name).shape[1] for name in order} == {"a": 7, "b": 12}


def test_a_plan_is_called_like_its_file(tmp_path: Path) -> None:
    (tmp_path / "copy.json").write_bytes(text(SQUARE, "original"))
    assert HouseExpoSource(tmp_path).load("copy").id == "copy"


def test_a_bad_house_harms_no_other(tmp_path: Path) -> None:
    path = write_tar(
        tmp_path / "json.tar.gz",
        {"a.json": HOUSES["a"], "bad.json": b"{}", "b.json": HOUSES["b"]},
    )
    source = HouseExpoSource(path)
    assert list(source.ids()) == ["a", "bad", "b"]
    with pytest.raises(FloorPlanError, match="house bad: key 'id' is missing"):
        source.load("bad")
    assert source.load("a").id == "a"
    assert source.load("b").id == "b"


@pytest.mark.parametrize("name", ["d", "", "../a", "a.json", "x" * 500])
def test_a_house_that_is_not_there(archive: Path, tmp_path: Path, name: str) -> None:
    folder = tmp_path / "houses"
    folder.mkdir()
    (tmp_path / "a.json").write_bytes(HOUSES["a"])
    (folder / "b.json").write_bytes(HOUSES["b"])
    for path in (archive, folder, tmp_path / "a.json"):
        with pytest.raises(FloorPlanError, match=r"holds no house|no such file"):
            HouseExpoSource(path).load(name)


def test_what_is_not_a_json_file_is_passed_over(tmp_path: Path) -> None:
    path = tmp_path / "mixed.tar"
    with tarfile.open(path, "w") as archive:
        for name, kind in (("d.json", tarfile.DIRTYPE), ("fifo.json", tarfile.FIFOTYPE)):
            member = tarfile.TarInfo(name)
            member.type = kind
            archive.addfile(member)
        for name, kind in (("soft.json", tarfile.SYMTYPE), ("hard.json", tarfile.LNKTYPE)):
            member = tarfile.TarInfo(name)
            member.type, member.linkname = kind, "/etc/passwd"
            archive.addfile(member)
        for name in ("README.txt", "a.json"):
            member = tarfile.TarInfo(name)
            member.size = len(HOUSES["a"])
            archive.addfile(member, io.BytesIO(HOUSES["a"]))
    source = HouseExpoSource(path)
    assert list(source.ids()) == ["a"]
    with pytest.raises(FloorPlanError, match="holds no house soft"):
        source.load("soft")


@pytest.mark.parametrize("name", ["../a.json", "json/../../a.json", "/etc/a.json", "../a.txt"])
def test_an_archive_with_a_name_that_leaves_it_is_refused(tmp_path: Path, name: str) -> None:
    path = write_tar(tmp_path / "evil.tar.gz", {"b.json": HOUSES["b"], name: HOUSES["a"]})
    with pytest.raises(FloorPlanError, match=f"evil.tar.gz: refused, it holds the name '{name}'"):
        HouseExpoSource(path).ids()


def test_an_archive_that_is_cut_off_anywhere_is_refused(tmp_path: Path) -> None:
    path = write_tar(tmp_path / "json.tar", {f"{n}.json": c for n, c in HOUSES.items()}, "w")
    content = path.read_bytes()
    end = 512 * -(-len(content.rstrip(b"\0")) // 512)  # where the blocks that end it begin
    assert list(HouseExpoSource(path).ids()) == list(HOUSES)
    for size in range(100, end + 1, 206):
        path.write_bytes(content[:size])
        with pytest.raises(
            FloorPlanError, match=r"json\.tar: not a readable tar archive \((it|un)"
        ):
            HouseExpoSource(path).ids()
    for size in range(512, end + 1, 512):
        path.write_bytes(content[:size])
        with pytest.raises(FloorPlanError, match=r"cut off; copy it again|unexpected end of data"):
            HouseExpoSource(path).ids()


POINTER = b"version https://git-lfs.github.com/spec/v1\n"


def test_lines_about_houses_name_the_archive(tmp_path: Path) -> None:
    path = write_tar(
        tmp_path / "json.tar.gz",
        {
            "mm.json": text([(0, 0), (9000, 0), (9000, 9000)]),
            "small.json": text([(0, 0), (0.1, 0), (0.1, 0.1), (0, 0.1)]),
            "closet.json": text([(0, 0), (0.3, 0), (0.3, 0.3), (0, 0.3)]),
            "pointer.json": POINTER,
        },
    )
    found = dict(load_each(HouseExpoSource(path), ["mm", "small", "closet", "pointer"]))
    assert [str(error) for error in found.values()] == [
        f"{path}: house mm: 9,000 m across; at most 200 m are allowed ('verts' are in metres)",
        f"{path}: house small: no free cell; it has 0.1 x 0.1 m, and a cell 0.2 m",
        f"{path}: house closet: nothing to explore, no cell can be reached from the start 1,1",
        f"{path}: house pointer: not a JSON file ({identify(POINTER)})",
    ]


@pytest.mark.parametrize(
    "kind", [tarfile.REGTYPE, tarfile.GNUTYPE_LONGNAME, tarfile.XHDTYPE, tarfile.XGLTYPE]
)
def test_a_large_member_is_refused_by_its_header(tmp_path: Path, kind: bytes) -> None:
    member = tarfile.TarInfo("big.json")
    member.type, member.size = kind, 1 << 33
    path = tmp_path / "big.tar"
    path.write_bytes(member.tobuf(tarfile.GNU_FORMAT) + bytes(10_240))
    with pytest.raises(FloorPlanError, match=r"big\.tar: refused, .* larger than 16 MiB"):
        HouseExpoSource(path).ids()


def test_a_large_file_in_a_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "big.json").write_bytes(b" " * (MAX_JSON_BYTES + 1))
    with pytest.raises(FloorPlanError, match=r"big.json: larger than 16 MiB"):
        HouseExpoSource(tmp_path).load("big")


@pytest.mark.parametrize(
    ("name", "damage"),
    [
        ("empty.tar.gz", lambda tar: b""),
        ("text.tar.gz", lambda tar: b"this is not an archive\n" * 100),
        ("text_inside.tar.gz", lambda tar: gzip.compress(b"this is not an archive\n" * 100)),
        ("truncated.tar.gz", lambda tar: gzip.compress(tar)[:150]),
        ("flipped.tar.gz", lambda tar: flip(gzip.compress(tar), 40, 60)),
        ("truncated.tar", lambda tar: tar[:700]),
        ("truncated.tar.xz", lambda tar: lzma.compress(tar)[:150]),
        ("flipped.tar.xz", lambda tar: flip(lzma.compress(tar), 60, 80)),
    ],
)
def test_a_damaged_archive_is_refused(
    archive: Path, name: str, damage: Callable[[bytes], bytes]
) -> None:
    path = archive.parent / name
    path.write_bytes(damage(gzip.decompress(archive.read_bytes())))
    with pytest.raises(FloorPlanError, match=f"{re.escape(name)}: ") as caught:
        HouseExpoSource(path).load("a")
    assert "\n" not in str(caught.value)


def flip(content: bytes, start: int, stop: int) -> bytes:
    return content[:start] + bytes(b ^ 0xFF for b in content[start:stop]) + content[stop:]


def test_an_extended_header_that_lies_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "sparse.tar"
    with tarfile.open(path, "w", format=tarfile.PAX_FORMAT) as archive:
        member = tarfile.TarInfo("a.json")
        member.pax_headers = {"GNU.sparse.map": "not,numbers"}
        archive.addfile(member)
    with pytest.raises(FloorPlanError, match=r"sparse\.tar: not a readable tar archive"):
        HouseExpoSource(path).ids()


@given(data=st.data())
@settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_no_damage_raises_anything_else(archive: Path, data: st.DataObject) -> None:
    content = bytearray(gzip.decompress(archive.read_bytes()))
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, 511))] = data.draw(st.integers(0, 255))
    # A right checksum lets the damage through to what reads the fields.
    checksum = 256 + sum(content[:148]) + sum(content[156:512])
    content[148:156] = b"%06o\0 " % checksum
    path = archive.parent / "damaged.tar"
    path.write_bytes(content)
    source = HouseExpoSource(path)
    with contextlib.suppress(FloorPlanError):
        for name in source.ids():
            source.load(name)


def test_a_source_without_houses_is_refused(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    write_tar(tmp_path / "no_json.tar", {"README.txt": b"nothing"}, "w")
    for name in ("empty", "no_json.tar"):
        with pytest.raises(FloorPlanError, match=f"{name}: holds no JSON file"):
            HouseExpoSource(tmp_path / name).ids()
    with pytest.raises(FloorPlanError, match=r"missing\.tar: .*\(No such file or directory\)"):
        HouseExpoSource(tmp_path / "missing.tar").ids()


def test_the_real_archive_loads_or_refuses_by_id(houseexpo: Path) -> None:
    source = open_source(str(houseexpo / "json.tar.gz"), None)
    ids = source.ids()
    assert len(ids) == 34_480
    refused = {}
    for name in ids[:300]:
        try:
            assert source.load(name).id == name
        except FloorPlanError as error:
            refused[name] = str(error)
    assert len(refused) < 10
    assert all(name in reason for name, reason in refused.items())
