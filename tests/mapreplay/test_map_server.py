"""map_server maps: thresholds at their exact edges, and files that are not what they say."""

import contextlib
import itertools
import struct
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from PIL import Image

from drawing import show
from mapreplay.errors import FloorPlanError, UsageError
from mapreplay.floorplan import explorable
from mapreplay.floorplans.greys import GreyRule
from mapreplay.floorplans.map_server import (
    MapServerSource,
    find_maps,
    open_source,
    read_map_file,
)
from mapreplay.floorplans.pixels import Pixels, read_pixels
from mapreplay.floorplans.reading import to_cells
from mapreplay.grid import FREE, OCCUPIED, UNKNOWN

KEYS = {
    "image": "map.png",
    "resolution": "0.05",
    "origin": "[-1.5, 2, 0.0]",
    "negate": "0",
    "occupied_thresh": "0.65",
    "free_thresh": "0.196",
}


def write_yaml(path: Path, **changes: str | None) -> Path:
    """A map_server YAML file with some keys changed, added or (None) left out."""
    keys = {key: value for key, value in (KEYS | changes).items() if value is not None}
    path.parent.mkdir(exist_ok=True, parents=True)
    path.write_text("".join(f"{key}: {value}\n" for key, value in keys.items()))
    return path


def write_image(path: Path, pixels: Sequence[object]) -> Path:
    """Pixels as seen: the first row is on top. Three or four channels are BGR(A)."""
    assert cv2.imwrite(str(path), np.array(pixels, np.uint8))
    return path


def cells(folder: Path, pixels: Sequence[object], **changes: str | None) -> str:
    write_image(folder / "map.png", pixels)
    return show(MapServerSource(write_yaml(folder / "plan.yaml", **changes)).load("plan").cells)


# What a pixel means --------------------------------------------------------------------------


def test_dark_is_occupied_light_is_free_and_205_is_unknown(tmp_path: Path) -> None:
    assert cells(tmp_path, [[0, 205, 254, 255]]) == "#?.."


def test_a_pixel_exactly_at_a_threshold_is_beyond_it_and_free_wins(tmp_path: Path) -> None:
    # p = (255 - v) / 255: 204 is .2 exactly, 203 is darker and 205 is lighter. As in Nav2 of 2026.
    row = [[203, 204, 205]]
    assert cells(tmp_path, row, occupied_thresh="0.2", free_thresh="0.2") == "#.."
    assert cells(tmp_path, row, occupied_thresh="0.3", free_thresh="0.2") == "?.."
    # 51 / 255 is .2, too; what is 1 - .8 in single precision is a little less.
    light = {"negate": "1", "occupied_thresh": "0.2", "free_thresh": "0.1"}
    assert cells(tmp_path, [[0, 50, 51, 255]], **light) == ".?##"


def test_negate_makes_white_occupied(tmp_path: Path) -> None:
    thresholds = {"occupied_thresh": "0.2", "free_thresh": "0.2", "negate": "1"}
    assert cells(tmp_path, [[50, 51, 52]], **thresholds) == "..#"
    assert cells(tmp_path, [[0, 255]], negate="true") == ".#"


def test_a_colour_is_as_dark_as_it_looks(tmp_path: Path) -> None:
    # Rec. 709: green is bright (182), red is dark (54), blue is darker (18).
    green, red, blue = [0, 255, 0], [0, 0, 255], [255, 0, 0]
    thresholds = {"occupied_thresh": "0.8", "free_thresh": "0.3"}
    assert cells(tmp_path, [[green, red, blue, [255] * 3]], **thresholds) == ".?#."


@pytest.mark.parametrize("mode", ["trinary", "scale"])
def test_what_is_not_opaque_is_unknown(tmp_path: Path, mode: str) -> None:
    row = [[0, 0, 0, 255], [0, 0, 0, 254], [255, 255, 255, 255], [255, 255, 255, 0]]
    assert cells(tmp_path, [row], mode=mode) == "#?.?"


@given(st.lists(st.integers(0, 255), min_size=3, max_size=3), st.sampled_from(["trinary", "scale"]))
@settings(
    max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None
)
def test_an_opaque_alpha_channel_changes_nothing(
    tmp_path: Path, greys: list[int], mode: str
) -> None:
    thresholds = {"occupied_thresh": "0.9", "free_thresh": "0.1", "mode": mode}
    row = [0, 255, *greys]
    plain = cells(tmp_path, [row], **thresholds)
    with_alpha = [[[grey] * 3 + [255] for grey in row]]
    assert cells(tmp_path, with_alpha, **thresholds) == plain
    write_image(tmp_path / "image.png", with_alpha)
    write_image(tmp_path / "plain.png", [row])
    images = [show(to_cells(read_pixels(tmp_path / name), GreyRule()))
              for name in ("image.png", "plain.png")]  # fmt: skip
    assert images[0] == images[1]


@pytest.mark.parametrize("mode", ["Trinary", "TRINARY", "Scale", "RAW"])
def test_a_mode_may_be_in_capitals(tmp_path: Path, mode: str) -> None:
    row = [[0, 100, 101, 255]]
    assert cells(tmp_path, row, mode=mode) == cells(tmp_path, row, mode=mode.lower())


def test_scale_rounds_to_percent_and_only_its_ends_are_known(tmp_path: Path) -> None:
    # p = 1 - v / 255, scaled to (p - .2) / .2: 0.4 % of 204 - 1 round to 0, 99.6 % to 100.
    thresholds = {"occupied_thresh": "0.3", "free_thresh": "0.1", "mode": "scale"}
    percent = [(1 - v / 255 - 0.1) / 0.2 * 100 for v in range(256)]
    expected = "".join("#" if p >= 99.5 else "." if p < 0.5 else "?" for p in percent)
    assert cells(tmp_path, [list(range(256))], **thresholds) == expected
    # 205 is a hundredth of a percent: free, unlike in mode trinary.
    assert cells(tmp_path, [[0, 205, 255]], mode="scale") == "#.."


def test_raw_pixels_are_percentages(tmp_path: Path) -> None:
    row = [[0, 19, 20, 65, 66, 100, 101, 255]]
    assert cells(tmp_path, row, mode="raw") == "..?###??"
    assert cells(tmp_path, row, mode="raw", negate="1") == "..?###??"  # Nav2 ignores it too


def test_the_top_row_of_the_image_is_the_last_row_of_the_grid(tmp_path: Path) -> None:
    write_image(tmp_path / "map.png", [[0, 255, 255], [255, 205, 205]])
    plan = MapServerSource(write_yaml(tmp_path / "plan.yaml")).load("plan")
    assert plan.cells.tolist() == [[FREE, UNKNOWN, UNKNOWN], [OCCUPIED, FREE, FREE]]
    assert plan.origin == (-1.5, 2.0)
    assert plan.resolution == 0.05
    assert plan.id == "plan"


# Images --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "content",
    [
        b"P5 3 2 255\n\x00\x01\x02\x03\x04\xff",
        b"P5\n# by map_saver # twice\n#\n3 2\n# and here\n255\n\x00\x01\x02\x03\x04\xff",
        b"P2\n3 2\n255\n0 1 2\n3 4 255\n",
        b"P2\n3 2\n255\n0 1 2 3 4 255 7 8",
    ],
)
def test_binary_and_ascii_pgm(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "map.pgm"
    path.write_bytes(content)
    pixels = read_pixels(path)
    assert pixels.grey.tolist() == [[3, 4, 255], [0, 1, 2]]
    assert pixels.alpha is None


@given(st.binary(min_size=6, max_size=6), st.sampled_from([".png", ".pgm"]))
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_grey_images_are_read_as_they_were_written(
    tmp_path: Path, values: bytes, ending: str
) -> None:
    grey = np.frombuffer(values, np.uint8).reshape(2, 3)
    path = write_image(tmp_path / f"map{ending}", grey.tolist())
    assert (read_pixels(path).grey[::-1] == grey).all()


def png_chunk(name: bytes, content: bytes) -> bytes:
    body = name + content
    return struct.pack(">I", len(content)) + body + struct.pack(">I", zlib.crc32(body))


def png(width: int, height: int, data: bytes, depth: int = 8) -> bytes:
    header = struct.pack(">IIBBBBB", width, height, depth, 0, 0, 0, 0)
    chunks = [(b"IHDR", header), (b"IDAT", zlib.compress(data)), (b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(itertools.starmap(png_chunk, chunks))


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"", "not a PNG or PGM image"),
        (b"GIF89a", "not a PNG or PGM image"),
        (b"P6\n1 1\n255\n\0\0\0", "not a PNG or PGM image"),
        (b"\x89PNG\r\n\x1a\n", "no header"),
        (b"\x89PNG\r\n\x1a\n" + bytes(30), "no header"),
        (png(100_000, 100_000, b""), "100000 x 100000 pixels; 1 to 4096"),
        (png(0, 5, b""), "0 x 5 pixels"),
        (png(2, 2, b"\0\xff\xff\0\xff\xff")[:-1], "damaged or truncated"),
        (png(2, 2, b"\0\xff\xff\0\xff\xff")[:-30], "damaged or truncated"),
        (png(2, 2, b"\0\xff\xff\0\xff\xff").replace(b"IDAT", b"IDAU"), "damaged or truncated"),
        (b"P5\n100000 100000\n255\n", "100000 x 100000 pixels"),
        (b"P5\n2 0\n255\n", "2 x 0 pixels"),
        (b"P5\n2 -2\n255\n", "no header"),
        (b"P5\n99999999999999999999 2\n255\n", "no header"),
        (b"P5" + b" " * 100_000, "no header"),
        (b"P5" + b" #" * 100_000, "no header"),
        (b"P5 # no end", "no header"),
        (b"P5\n2 2\n0\n\0\0\0\0", "its white is 0, not 1 to 65535"),
        (b"P5\n2 2\n65536\n\0\0\0\0\0\0\0\0", "its white is 65536, not 1 to 65535"),
        (b"P5\n2 2\n100\n\0\0\0\x65", "a pixel is 101, its white is 100"),
        (b"P5\n2 2\n65535\n\0\0\0\0\0\0\0", "truncated, 3 of 2 x 2 pixels"),
        (b"P2\n2 2\n100\n1 2 3 101", "b'101' is not a grey value 0..100"),
        (b"P5\n2 2\n255\n\xff\xff\xff", "truncated, 3 of 2 x 2 pixels"),
        (b"P2\n2 2\n255\n1 2 3", "truncated, 3 of 2 x 2 pixels"),
        (b"P2\n2 2\n255\n1 2 3 256", "b'256' is not a grey value"),
        (b"P2\n2 2\n255\n1 2 3 -1", "b'-1' is not a grey value"),
        (b"P2\n2 2\n255\n1 2 3 x", "b'x' is not a grey value"),
    ],
)
def test_what_is_not_a_whole_image_is_refused(tmp_path: Path, content: bytes, reason: str) -> None:
    path = tmp_path / "map.png"
    path.write_bytes(content)
    with pytest.raises(FloorPlanError, match=f"map.png: .*{reason}") as caught:
        read_pixels(path)
    assert "\n" not in str(caught.value)


def test_an_undamaged_png_of_this_tests_own_making_is_read(tmp_path: Path) -> None:
    path = tmp_path / "map.png"
    path.write_bytes(png(2, 2, b"\0\x01\x02\0\x03\x04"))
    assert read_pixels(path).grey.tolist() == [[3, 4], [1, 2]]


@given(st.integers(0, 10_000), st.integers(1, 255))
@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_png_with_one_byte_changed_is_read_whole_or_refused(
    tmp_path: Path, place: int, change: int
) -> None:
    content = bytearray(png(3, 2, b"\0\x01\x02\x03\0\x04\x05\x06"))
    content[place % len(content)] ^= change
    path = tmp_path / "map.png"
    path.write_bytes(content)
    with contextlib.suppress(FloorPlanError):
        assert read_pixels(path).grey.shape == (2, 3)


def test_an_image_file_that_cannot_be_read(tmp_path: Path) -> None:
    path = write_yaml(tmp_path / "plan.yaml")
    with pytest.raises(FloorPlanError, match=r"plan\.yaml: its image map\.png is not there"):
        MapServerSource(path).load("plan")
    (tmp_path / "map.png").mkdir()
    with pytest.raises(FloorPlanError, match=r"plan\.yaml: its image .*map\.png: is a folder"):
        MapServerSource(path).load("plan")


@pytest.mark.parametrize(
    ("meant", "there"),
    [
        ("/home/robot/maps/office.pgm", "office.pgm"),
        ("C:\\\\maps\\\\office.pgm", "office.pgm"),
        ("../maps/office.pgm", "office.pgm"),
        ("office.pgm", "Office.PGM"),
        ("/home/robot/OFFICE.pgm", "office.pgm"),
    ],
)
def test_an_image_of_that_name_next_to_the_yaml_is_taken_and_told(
    tmp_path: Path, meant: str, there: str
) -> None:
    write_image(tmp_path / there, [[255, 0, 255]])
    plan = MapServerSource(write_yaml(tmp_path / "f1.yaml", image=f'"{meant}"')).load("f1")
    assert show(plan.cells) == ".#."
    assert [doubt.kind for doubt in plan.doubts] == ["another image"]
    assert f"is not there; {there} next to it was taken" in plan.doubts[0].text
    assert plan.where == str(tmp_path / "f1.yaml")


@pytest.mark.parametrize(
    ("there", "hint"),
    [
        ("office.png", "is it office.png?"),
        ("OFFICE.jpg", "is it OFFICE.jpg?"),
        ("images/office.pgm", "is it images/office.pgm?"),
        ("../office.pgm", "is it ../office.pgm?"),
        ("._office.pgm", "copy it next to the YAML file"),
        ("unlike.pgm", "copy it next to the YAML file"),
    ],
)
def test_an_image_that_is_missing_names_the_yaml_and_what_is_like_it(
    tmp_path: Path, there: str, hint: str
) -> None:
    paths = [write_yaml(tmp_path / "maps" / f"{name}.yaml", image="/x/office.pgm") for name in "ab"]
    (tmp_path / "maps" / there).parent.mkdir(exist_ok=True)
    (tmp_path / "maps" / there).touch()
    for path in paths:
        with pytest.raises(FloorPlanError) as caught:
            MapServerSource(path).load(path.stem)
        assert str(caught.value) == f"{path}: its image /x/office.pgm is not there; {hint}"


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"version https://git-lfs.github.com/spec/v1\n", "run git lfs pull"),
        (b"\xff\xd8\xff\xe0", "a JPEG image; convert it to PNG"),
        (b"P5\n2 2\n255\n\0", "truncated"),
        (b"P5\n2 2\n255\n\0\0\0\0", "no free cell"),
    ],
)
def test_each_line_about_an_image_names_the_yaml(
    tmp_path: Path, content: bytes, reason: str
) -> None:
    (tmp_path / "map.png").write_bytes(content)
    for name in ("office", "office-2"):
        path = write_yaml(tmp_path / f"{name}.yaml")
        with pytest.raises(FloorPlanError, match=f"{path}: .*{reason}"):
            MapServerSource(path).load(name)


# Depths and kinds of images ------------------------------------------------------------------


def stored(path: Path, image: Image.Image, **options: Any) -> Pixels:
    image.save(path, "PNG", **options)
    return read_pixels(path)


ROW = np.array([[0, 127, 205, 255]], np.uint8)


def with_palette(row: npt.NDArray[np.uint8]) -> Image.Image:
    """Numbers of colours, which are the greys of `row`."""
    image = Image.fromarray(np.arange(row.size, dtype=np.uint8)[None], "P")
    image.putpalette(np.repeat(row.ravel(), 3).tobytes())
    return image


def test_images_of_every_depth_and_kind_have_the_same_greys(tmp_path: Path) -> None:
    path = tmp_path / "map.png"
    grey, palette = Image.fromarray(ROW), with_palette(ROW)
    sixteen = Image.fromarray(ROW.astype(np.uint16) * 257)
    for image, options in (
        (grey, {}),
        (grey.convert("RGB"), {}),
        (palette, {}),
        (palette, {"bits": 2}),
        (sixteen, {}),
    ):
        pixels = stored(path, image, **options)
        assert pixels.grey.tolist() == ROW.tolist()
        assert pixels.alpha is None
    assert stored(path, grey.convert("1", dither=Image.Dither.NONE)).grey.tolist() == [
        [0, 0, 255, 255]
    ]


def test_transparency_of_every_kind(tmp_path: Path) -> None:
    path = tmp_path / "map.png"
    grey, palette = Image.fromarray(ROW), with_palette(ROW)
    with_alpha = grey.convert("LA")
    with_alpha.putalpha(Image.fromarray(np.array([[255, 0, 255, 255]], np.uint8)))
    for image, options in (
        (grey, {"transparency": 127}),
        (grey.convert("RGB"), {"transparency": (127, 127, 127)}),
        (palette, {"transparency": 1}),
        (with_alpha, {}),
        (with_alpha.convert("RGBA"), {}),
    ):
        pixels = stored(path, image, **options)
        assert pixels.alpha is not None
        assert (pixels.alpha == 255).tolist() == [[True, False, True, True]]
        assert to_cells(pixels, GreyRule()).tolist() == [[OCCUPIED, UNKNOWN, UNKNOWN, FREE]]
    assert (stored(path, palette, transparency=bytes([255, 254])).alpha == 254).sum() == 1


def test_an_interlaced_png(tmp_path: Path) -> None:
    # Adam7 of 2 x 2 pixels: the first one, then the one to its right, then the row below.
    header = struct.pack(">IIBBBBB", 2, 2, 8, 0, 0, 0, 1)
    data = b"\0\x01" + b"\0\x02" + b"\0\x03\x04"
    chunks = [(b"IHDR", header), (b"IDAT", zlib.compress(data)), (b"IEND", b"")]
    path = tmp_path / "map.png"
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(itertools.starmap(png_chunk, chunks)))
    assert read_pixels(path).grey.tolist() == [[3, 4], [1, 2]]


@pytest.mark.parametrize(
    ("content", "greys"),
    [
        (b"P5\n4 1\n100\n\0\x32\x50\x64", [0, 128, 204, 255]),
        (b"P2\n4 1\n100\n0 50 80 100\n", [0, 128, 204, 255]),
        (b"P2\n2 1\n1\n0 1\n", [0, 255]),
        (b"P5\n3 1\n65535\n\0\0\x80\0\xff\xff", [0, 128, 255]),
        (b"P2\n3 1\n4095\n0 2048 4095\n", [0, 128, 255]),
        (b"P5\n2 1\n1000\n\0\0\x03\xe8", [0, 255]),
    ],
)
def test_a_pgm_is_scaled_to_its_white(tmp_path: Path, content: bytes, greys: list[int]) -> None:
    path = tmp_path / "map.pgm"
    path.write_bytes(content)
    assert read_pixels(path).grey.tolist() == [greys]


@pytest.mark.parametrize("ending", ["png", "pgm"])
def test_eight_bits_in_a_file_of_sixteen_say_so(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"map.{ending}"
    assert cv2.imwrite(str(path), np.array([[0, 205, 255]], np.uint16))
    with pytest.raises(FloorPlanError, match="white is 65535, and no pixel is over 255"):
        read_pixels(path)


# YAML ----------------------------------------------------------------------------------------


def test_the_image_lies_beside_the_yaml_or_where_it_says(tmp_path: Path) -> None:
    elsewhere = tmp_path / "images"
    elsewhere.mkdir()
    image = write_image(elsewhere / "x.png", [[255, 0]])
    for spelling in ("../images/x.png", str(image), "'../images/x.png'"):
        path = write_yaml(tmp_path / "yaml" / "plan.yaml", image=spelling)
        assert show(MapServerSource(path).load("plan").cells) == ".#"


@pytest.mark.parametrize("key", KEYS)
def test_a_missing_key_is_named(tmp_path: Path, key: str) -> None:
    path = write_yaml(tmp_path / "plan.yaml", **{key: None})
    with pytest.raises(FloorPlanError, match=rf"plan\.yaml: .*key '{key}' is missing"):
        read_map_file(path)


@pytest.mark.parametrize(
    ("key", "value", "reason"),
    [
        ("image", "", "image is None"),
        ("image", "''", "image is ''"),
        ("image", "[a.png]", "expected the path"),
        ("image", "7", "image is 7"),
        ("resolution", "0", "resolution is 0"),
        ("resolution", "-0.05", "positive number of metres"),
        ("resolution", ".nan", "resolution is nan"),
        ("resolution", ".inf", "resolution is inf"),
        ("resolution", "1" + "0" * 400, "expected a finite number"),
        ("resolution", "0x" + "f" * 5000, "resolution is a huge number"),
        ("resolution", "true", "resolution is True"),
        ("resolution", "five", "resolution is 'five'"),
        ("origin", "0", "three finite numbers"),
        ("origin", "[0, 0]", "three finite numbers"),
        ("origin", "[0, 0, 0, 0]", "three finite numbers"),
        ("origin", "[0, x, 0]", "three finite numbers"),
        ("origin", "[0, .nan, 0]", "three finite numbers"),
        ("origin", "{x: 0}", "three finite numbers"),
        ("origin", "[0, 0, 1.57]", "a yaw of 1.57 rad; rotated maps are not supported"),
        ("negate", "2", "negate is 2; expected 0 or 1"),
        ("negate", "no", "negate is 'no'"),
        ("negate", "0.0", "negate is 0.0"),
        ("occupied_thresh", "1.01", "0 <= free_thresh <= occupied_thresh <= 1"),
        ("occupied_thresh", "0.1", "0 <= free_thresh <= occupied_thresh <= 1"),
        ("free_thresh", "-0.1", "0 <= free_thresh"),
        ("free_thresh", ".nan", "free_thresh is nan"),
        ("free_thresh", "x", "free_thresh is 'x'"),
        ("mode", "ternary", "mode is 'ternary'; expected one of trinary, scale, raw"),
        ("mode", "[raw]", "mode is"),
        ("mode", "", "mode is None"),
    ],
)
def test_a_value_that_makes_no_sense_is_named(
    tmp_path: Path, key: str, value: str, reason: str
) -> None:
    path = write_yaml(tmp_path / "plan.yaml", **{key: value})
    with pytest.raises(FloorPlanError, match=rf"plan\.yaml: .*{reason}"):
        read_map_file(path)


BOMB = "a: &a [x, x]\n" + "".join(
    f"{b}: &{b} [*{a}, *{a}, *{a}, *{a}]\n" for a, b in itertools.pairwise("abcdefghijklmnopqrst")
)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"- a\n- b", "expected keys and values"),
        (b"image", "expected keys and values"),
        (b"\x00\x01\x02", "not a YAML file"),
        (b"\xff\xfe\xfa", "not a YAML file"),
        (b"image: [", "not a YAML file"),
        (b"[" * 5_000, "not a YAML file"),
        (b"image: a\nimage: b\n", "not a YAML file"),
        (b"a: 2001-99-99", "not a YAML file"),
        (b"a: !!int x", "not a YAML file"),
        (b"a: !!python/object/apply:os.system [ls]", "not a YAML file"),
        (b"a: 1\n---\nb: 2\n", "not a YAML file"),
        (b"#" * 70_000, "larger than 64 KiB"),
        (BOMB.encode(), "anchors or aliases"),
        (b"image: &x a.png\n", "anchors or aliases"),
        (b"image: *x\n", "anchors or aliases"),
        (b"<<: {image: a.png}\n", "merges mappings"),
        (b"a: {b: {<<: {c: d}}}\n", "merges mappings"),
        (b"a: " + b"[" * 30 + b"]" * 30, "nested more than 20 deep"),
        (b"a: " + b"{a: " * 60 + b"1" + b"}" * 60, "nested more than 20 deep"),
        (b"- " * 3000 + b"1", "nested more than 20 deep"),
        (b"? " * 3000 + b"1", "nested more than 20 deep"),
        (b"a: [" + b"1," * 10_000 + b"]", "more than 5000 values"),
        (b"image: a.png\nimage: b.png\n", 'duplicate key "image"'),
        (b"", "an empty file"),
        (b"\0" * 100, "zero bytes"),
        ("image: a".encode("utf-16"), "UTF-16 text"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:00\n", "Git LFS pointer"),
        (b"<!DOCTYPE html>\n<html>", "a web page"),
        (b"\x89PNG\r\n\x1a\n", "a PNG image"),
    ],
)
def test_what_is_not_a_map_file_is_refused(tmp_path: Path, content: bytes, reason: str) -> None:
    path = tmp_path / "plan.yaml"
    path.write_bytes(content)
    with pytest.raises(FloorPlanError, match=rf"plan\.yaml: .*{reason}") as caught:
        read_map_file(path)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400


def test_a_value_that_prints_long_is_cut(tmp_path: Path) -> None:
    path = write_yaml(tmp_path / "plan.yaml", image=str(["x" * 500] * 20))
    with pytest.raises(FloorPlanError, match=r"image is .*expected the path") as caught:
        read_map_file(path)
    assert len(str(caught.value)) < 300


@given(st.text(max_size=60) | st.text("[]{}:,&*!%@`'\"|>?-# \nab01.", max_size=60))
@example("? {}\n: 1")
@example("!!timestamp x")
@example("<<: 1")
@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_no_text_raises_anything_else(tmp_path: Path, text: str) -> None:
    path = tmp_path / "plan.yaml"
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    with pytest.raises(FloorPlanError, match=r"plan\.yaml: "):
        read_map_file(path)


# Folders and ids -----------------------------------------------------------------------------


def test_a_folder_is_searched_for_yaml_files_that_name_an_image(tmp_path: Path) -> None:
    for name in ("b/map.yaml", "a.yml", "c/d/office 1.yaml", "broken.yaml"):
        write_yaml(tmp_path / name)
        write_image((tmp_path / name).parent / "map.png", [[255]])
    (tmp_path / "broken.yaml").write_text("image: map.png\norigin: [\n")
    (tmp_path / "nav2_params.yaml").write_text("amcl:\n  image: x\n")
    (tmp_path / "values.yaml").write_text("image: {repository: x}\n")
    (tmp_path / "no.yaml").write_text("[")
    (tmp_path / "map.txt").write_text("image: x\n")
    (tmp_path / "folder.yaml").mkdir()
    source = MapServerSource(tmp_path)
    assert list(source.ids()) == ["a", "b", "broken", "office-1"]
    assert source.load("office-1").id == "office-1"
    with pytest.raises(FloorPlanError, match=r"broken\.yaml: not a YAML file"):
        source.load("broken")
    with pytest.raises(FloorPlanError, match="holds no map c"):
        source.load("c")


@pytest.mark.parametrize(
    ("content", "listed"),
    [
        ("{a: {image: x}, image: y.png}", True),
        ("a: [image, image: b]\n? [k, {l: m}]\n: image\nimage: y.png\n", True),
        ("image: 7\n", True),  # which loading refuses by name
        ("image: a.png\nb: &b 1\n", True),
        ("a: &a 1\nimage: b.png\n", True),
        ("a: image\nb: {image: c}\n", False),
        ("? image\n: [a.png]\n", False),
        ("- image: a.png\n", False),
        ("image\n", False),
        ("services: {web: &web {image: x}}\n", False),
    ],
)
def test_what_in_a_folder_is_a_map(tmp_path: Path, content: str, listed: bool) -> None:
    (tmp_path / "a.yaml").write_text(content)
    assert bool(find_maps(tmp_path)) == listed


def test_a_map_called_map_has_the_name_of_its_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_yaml(tmp_path / "office" / "map.yaml")
    assert list(MapServerSource(path).ids()) == ["office"]
    monkeypatch.chdir(path.parent)
    assert list(MapServerSource(Path("map.yaml")).ids()) == ["office"]


def test_ids_are_unique(tmp_path: Path) -> None:
    for name in ("1/office.yaml", "2/office.yaml", "office/map.yaml", "office-2.yaml"):
        write_yaml(tmp_path / name)
    assert list(MapServerSource(tmp_path).ids()) == ["office", "office-2", "office-3", "office-2-2"]


def test_a_folder_without_a_map_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FloorPlanError, match="holds no YAML file with an 'image'"):
        MapServerSource(tmp_path).ids()


def test_a_resolution_cannot_be_chosen(tmp_path: Path) -> None:
    path = str(write_yaml(tmp_path / "plan.yaml"))
    assert open_source(path, None).default_predictor == "d2"
    with pytest.raises(UsageError, match=r"set by its YAML file, not 0\.1"):
        open_source(path, 0.1)


# Real maps -----------------------------------------------------------------------------------


def test_real_maps_with_and_without_unknown_cells(mrpb: Path) -> None:
    source = open_source(str(mrpb), None)
    assert list(source.ids()) == [
        "maze", "narrow_graph", "office02", "office02_partially_unknown", "room02",
        "shopping_mall", "track",
    ]  # fmt: skip
    plans = {name: source.load(name) for name in source.ids()}
    assert {plan.shape for plan in plans.values()} == {(380, 380)}
    assert {plan.origin for plan in plans.values()} == {(-19.0, -19.0)}
    whole, partial = plans["office02"].cells, plans["office02_partially_unknown"].cells
    hidden = (partial == UNKNOWN) & (whole != UNKNOWN)
    assert hidden.sum() > 5_000
    known = (partial != UNKNOWN) & (whole != UNKNOWN)
    assert (partial[known] == whole[known]).all()
    for plan in plans.values():
        reachable = explorable(plan.cells, plan.default_start)
        assert not reachable[plan.cells == UNKNOWN].any()
        assert 0 < plan.wall_share < 0.5
