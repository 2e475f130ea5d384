from __future__ import annotations

import sys
from pathlib import Path

import cv2
import pytest
from PIL import Image
from rerun.chunk import RrdReader

from commands import Run


@pytest.fixture(scope="session")
def three(logs: Path) -> list[Path]:
    """Three logs of 31 steps."""
    return sorted(logs.iterdir())


def entities(rrd: Path) -> set[str]:
    return {str(chunk.entity_path) for chunk in RrdReader(rrd).stream()}


def test_it_saves_a_recording(cli: Run, three: list[Path], tmp_path: Path) -> None:
    rrd = tmp_path / "x.rrd"
    result = cli("view", three[0], "--save", rrd)
    assert result.code == 0, result.err
    assert "/maps/observed" in entities(rrd)
    assert cli("view", three[0], "--save", rrd).code == 2, "it is there"


def test_of_three_logs_the_curves_of_all_and_the_maps_of_two(
    cli: Run, three: list[Path], tmp_path: Path
) -> None:
    folder, rrd = three[0].parent, tmp_path / "x.rrd"
    assert cli("view", folder, "--save", rrd).code == 0
    assert {f"/{letter}/scores/f1" for letter in "ABC"} <= entities(rrd)
    assert {"/A/maps/fused", "/B/maps/fused"} <= entities(rrd)
    assert "/C/maps/fused" not in entities(rrd)
    assert cli("view", folder, "--save", rrd, "--force", "--maps", "a,c").code == 0
    assert {"/A/maps/fused", "/C/maps/fused"} <= entities(rrd)
    assert "/B/maps/fused" not in entities(rrd)


def test_it_draws_a_step_without_a_viewer(cli: Run, three: list[Path], tmp_path: Path) -> None:
    png = tmp_path / "x.png"
    assert cli("view", three[0], "--png", png, "--step", 5, "--size", "640x360").code == 0
    fifth = cv2.imread(str(png))
    assert fifth is not None
    assert fifth.shape == (360, 640, 3)
    again = tmp_path / "again.png"
    assert cli("view", three[0], "--png", again, "--step", -26, "--size", "640x360").code == 0
    assert again.read_bytes() == png.read_bytes(), "counted from the end"
    assert cli("view", *three[:2], "--png", tmp_path / "two.png", "--theme", "dark").code == 0


def test_it_draws_films(cli: Run, three: list[Path], tmp_path: Path) -> None:
    gif, mp4 = tmp_path / "x.gif", tmp_path / "x.mp4"
    options = ("--every", 12, "--size", "640x360")
    assert cli("view", three[0], "--gif", gif, *options).code == 0
    with Image.open(gif) as film:
        assert getattr(film, "n_frames") == 4, "steps 0, 12, 24 and the last, 30"  # noqa: B009
    assert cli("view", three[0], "--mp4", mp4, *options).code == 0
    video = cv2.VideoCapture(str(mp4))
    assert video.get(cv2.CAP_PROP_FRAME_WIDTH) == 640
    ok, frame = video.read()
    video.release()
    assert ok
    assert frame.std() > 20, "something is in it"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["x.gif", "x.mp4"]


@pytest.mark.parametrize(
    ("options", "line"),
    [
        ("--save x.rrd --web", "view: choose one of --save, --web"),
        ("--save x.rrd --step 3", "view: --step applies to the window and --png, not to --save"),
        ("--png x.png --step 31", "--step 31: {log} has steps 0 to 30"),
        ("--png x.png --step -32", "--step -32: {log} has steps 0 to 30"),
        ("--png x.png --size big", "--size big: should be WIDTHxHEIGHT, such as 1920x1080"),
        ("--png x.png --size 10x10", "10x10: a picture has 640x360 to 7680x4320 pixels"),
        ("--png x.png --maps B", "--maps B: the logs are A to A"),
    ],
)
def test_wrong_usage_is_one_line(
    cli: Run, three: list[Path], tmp_path: Path, options: str, line: str
) -> None:
    result = cli("view", three[0], *options.replace("x.", f"{tmp_path}/x.").split())
    assert result.code == 2
    assert result.err == f"mapreplay: {line.format(log=three[0])}\n"
    assert list(tmp_path.iterdir()) == []


def test_without_a_display_it_names_what_works(
    cli: Run, three: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    if sys.platform != "linux":
        pytest.skip("displays are looked for in the environment on Linux only")
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)
    result = cli("view", three[0])
    assert result.code == 2
    assert result.err.count("\n") == 1
    for way in ("--web", "--save", "--png"):
        assert way in result.err
