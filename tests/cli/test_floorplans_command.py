"""`mapreplay floorplans` and `run` on plans that are odd, junk or missing: lines and exit codes."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from commands import Run
from mapreplay.cli.training_environment import environment
from mapreplay.floorplans import open_source
from mapreplay.training.job import load

QUICK = ("--planner", "nearest", "--predictor", "none", "--plan-on", "observed", "--build",
         "observed", "--max-steps", 3)  # fmt: skip


def write_image(path: Path, *, outside: int = 205, wall: int = 0, free: int = 255) -> Path:
    """One room of 8 x 18 cells in a strip of `outside`."""
    image = np.full((16, 24), outside, np.uint8)
    image[3:13, 2:22] = wall
    image[4:12, 3:21] = free
    path.parent.mkdir(exist_ok=True, parents=True)
    assert cv2.imwrite(str(path), image)
    return path


def write_map(path: Path, image: str, free_thresh: float = 0.196) -> Path:
    path.parent.mkdir(exist_ok=True, parents=True)
    path.write_text(
        f"image: {image}\nresolution: 0.05\norigin: [0, 0, 0]\nnegate: 0\n"
        f"occupied_thresh: 0.65\nfree_thresh: {free_thresh}\n"
    )
    return path


def test_exit_codes_say_how_much_was_read(cli: Run, tmp_path: Path) -> None:
    write_image(tmp_path / "good.png")
    assert cli("floorplans", tmp_path).code == 0
    (tmp_path / "bad.png").write_bytes(b"version https://git-lfs.github.com/spec/v1\n")
    some = cli("floorplans", tmp_path)
    assert some.code == 3
    assert "good" in some.out
    assert some.err.count("refused: ") == 1
    (tmp_path / "good.png").unlink()
    none = cli("floorplans", tmp_path)
    assert (none.code, none.out) == (1, "")
    assert "bad.png: not a PNG or PGM image: a Git LFS pointer" in none.err
    ids = tmp_path / "ids.txt"
    ids.write_text("nothing\n")
    assert cli("floorplans", "procedural:1-2", "--ids", ids).code == 1
    ids.write_text("nothing\nprocedural-2\n")
    assert cli("floorplans", "procedural:1-2", "--ids", ids).code == 3


def test_junk_next_to_a_plan_changes_neither_id_nor_exit_code(cli: Run, tmp_path: Path) -> None:
    write_image(tmp_path / "hall.png")
    clean = cli("floorplans", tmp_path)
    (tmp_path / "._hall.png").write_bytes(b"\0\5\x16\7" + bytes(100))
    assert cli("floorplans", tmp_path) == clean
    assert clean.code == 0


@pytest.mark.parametrize("mark", [True, False])
def test_a_map_of_greys_is_no_perfect_result(cli: Run, tmp_path: Path, mark: bool) -> None:
    path = write_image(tmp_path / "plan.png", outside=127, wall=127, free=195)
    if mark:
        image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        assert image is not None
        image[6:9, 6:9] = 208
        cv2.imwrite(str(path), image)
    listed = cli("floorplans", path)
    assert listed.code == 1
    assert "have the grey 127 or 195, between free (above 205) and occupied (below 90)" in (
        listed.err
    )
    ran = cli("run", "--floorplans", path, *QUICK, "--out", tmp_path / "o")
    assert ran.code == 1
    assert not (tmp_path / "o").exists()
    options = listed.err.rpartition("plan.png:")[2].split()[0]
    cured = cli("run", "--floorplans", f"{path}:{options}", *QUICK, "--out", tmp_path / "o")
    assert (cured.code, "warning" in cured.err) == (0, False)


def test_unknown_that_is_read_as_free_is_told_once_with_its_cure(cli: Run, tmp_path: Path) -> None:
    write_image(tmp_path / "office.png")
    path = write_map(tmp_path / "office.yaml", "office.png", free_thresh=0.25)
    for command in (("floorplans", path), ("run", "--floorplans", path, *QUICK, "--out", tmp_path)):
        result = cli(*command)
        assert result.code == 0
        (line,) = [line for line in result.err.splitlines() if "warning" in line]
        assert line.startswith(f"warning: {path}: 184 of 384 pixels have the grey 205")
        assert "free_thresh 0.25; 0.196 keeps them unknown" in line
        assert "outside of the building" in line
    result = cli("floorplans", f"{path}:free=0.196")
    assert (result.code, result.err) == (0, "")


def test_a_start_that_is_chosen_is_not_doubted(cli: Run, tmp_path: Path) -> None:
    path = write_image(tmp_path / "plan.png", outside=255)
    outside = cli("run", "--floorplans", path, *QUICK, "--out", tmp_path / "a")
    assert "start 15,0 is probably outside" in outside.err
    inside = cli("run", "--floorplans", path, *QUICK, "--out", tmp_path / "b", "--start", "8,10")
    assert "outside" not in inside.err


def test_each_of_many_maps_is_named_or_they_are_summed_up(cli: Run, tmp_path: Path) -> None:
    write_image(tmp_path / "office.pgm")
    for number in range(3):
        write_map(tmp_path / f"f{number}.yaml", "/home/robot/office.pgm")
        write_map(tmp_path / f"g{number}.yaml", "/home/robot/lobby.pgm")
    result = cli("floorplans", tmp_path)
    assert result.code == 3
    lines = sorted(result.err.splitlines())
    assert [line.partition(": its image ")[0] for line in lines] == [
        f"{word}: {tmp_path}/{letter}{number}.yaml"
        for word, letter in (("refused", "g"), ("warning", "f"))
        for number in range(3)
    ]
    for number in range(3, 8):
        write_map(tmp_path / f"f{number}.yaml", "/home/robot/office.pgm")
    result = cli("floorplans", tmp_path, "--format", "json")
    (line,) = [line for line in result.err.splitlines() if line.startswith("warning")]
    assert f"8 of 8 floor plans may be read wrongly: another image (8, such as {tmp_path}" in (line)
    rows = json.loads(result.out)["rows"]
    assert all("office.pgm next to it was taken" in row["doubts"] for row in rows)


def test_training_sums_up_what_is_odd_about_its_plans(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in "abcdefg":
        write_image(tmp_path / f"{name}.png", outside=255)
    load("training", open_source(str(tmp_path)), list("abcdef"), 1, environment())
    assert "6 of 6 floor plans may be read wrongly: start outside (6, such as" in (
        capsys.readouterr().err
    )


def test_weights_that_are_a_pointer_say_so(cli: Run, tmp_path: Path) -> None:
    path = tmp_path / "w.safetensors"
    path.write_bytes(b"version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 1\n")
    result = cli("run", "--floorplans", "procedural:1", "--predictor", path, "--out", tmp_path)
    assert result.code == 1
    assert f"{path}: not a safetensors file (a Git LFS pointer" in result.err
    assert len(result.err.splitlines()) == 1
