"""A log as arrays and pictures."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from drawing import draw
from mapreplay.errors import ExistsError, LogError, WriteError
from mapreplay.recorders import export
from mapreplay.recorders.export import export_arrays, export_images, shade, shade_prediction
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.recorders.log.step_table import row_of
from mapreplay.step import StepMetrics
from recordings import Recorded


def test_arrays_are_stacked_over_steps(blurred: Recorded, tmp_path: Path) -> None:
    path = tmp_path / "episode.npz"
    log = EpisodeLog(blurred.path)
    export_arrays(log, path)
    assert [p.name for p in tmp_path.iterdir()] == ["episode.npz"]
    with np.load(path) as arrays:
        for k in (0, 33, len(blurred.steps) - 1):
            step = blurred.steps[k]
            for name in ("observed", "fused", "p_wall", "hits"):
                expected = getattr(step, name)
                assert arrays[name].dtype == expected.dtype
                assert np.array_equal(arrays[name][k], expected)
            assert tuple(arrays["agent"][k]) == step.agent
            target = step.decision.target if step.decision else (-1, -1)
            assert tuple(arrays["target"][k]) == target
        truth = blurred.header.floor_plan.cells
        assert np.array_equal(arrays["truth"], truth)
        assert np.array_equal(arrays["explorable"], log.header.explorable)
        assert arrays["p_wall_step"].tolist() == list(range(len(blurred.steps)))
        for name in StepMetrics.names():
            expected = [getattr(step.metrics, name) for step in blurred.steps]
            assert np.array_equal(arrays[name], expected, equal_nan=True)


def test_the_log_is_read_once(
    blurred: Recorded, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log, passes = EpisodeLog(blurred.path), []
    steps = log.steps
    monkeypatch.setattr(log, "steps", lambda: passes.append(1) or steps())
    monkeypatch.setattr(log, "maps", None)
    monkeypatch.setattr(export, "IN_MEMORY", 100)
    export_arrays(log, tmp_path / "through-the-disk.npz")
    assert len(passes) == 1
    monkeypatch.undo()
    export_arrays(log, tmp_path / "in-memory.npz")
    one, other = (path.read_bytes() for path in tmp_path.iterdir())
    assert one == other


def test_without_a_prediction_there_is_none(unpredicted: Recorded, tmp_path: Path) -> None:
    path = tmp_path / "episode.npz"
    export_arrays(EpisodeLog(unpredicted.path), path)
    with np.load(path) as arrays:
        assert "p_wall" not in arrays
        assert "p_wall_step" not in arrays
        assert arrays["observed"].shape == (61, *unpredicted.header.floor_plan.shape)


def test_an_unfinished_log_can_be_exported(unfinished: Recorded, tmp_path: Path) -> None:
    path = tmp_path / "episode.npz"
    export_arrays(EpisodeLog(unfinished.path), path)
    with np.load(path) as arrays:
        assert len(arrays["observed"]) == len(arrays["f1"]) == 40
        last = row_of(unfinished.steps[39])
        assert arrays["agent"][-1].tolist() == list(last[1:3])


def test_the_same_log_gives_the_same_bytes(blurred: Recorded, tmp_path: Path) -> None:
    for name in ("a.npz", "b.npz"):
        export_arrays(EpisodeLog(blurred.path), tmp_path / name)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_row_0_is_at_the_bottom_and_cells_are_whole(blurred: Recorded, tmp_path: Path) -> None:
    written = export_images(EpisodeLog(blurred.path), tmp_path / "new", [0, 60], scale=3)
    assert sorted(path.name for path in written) == [
        "step-000000-fused.png",
        "step-000000-observed.png",
        "step-000000-predicted.png",
        "step-000060-fused.png",
        "step-000060-observed.png",
        "step-000060-predicted.png",
        "truth.png",
    ]
    truth = blurred.header.floor_plan.cells
    picture = cv2.imread(str(tmp_path / "new" / "truth.png"), cv2.IMREAD_UNCHANGED)
    assert picture.shape == (truth.shape[0] * 3, truth.shape[1] * 3)
    # The notch of the third room is drawn on the second line from below.
    below = picture[::-1][4, 1::3]
    assert np.array_equal(below < 128, truth[1] == 100)
    for dr in range(3):
        for dc in range(3):
            assert np.array_equal(picture[::-1][dr::3, dc::3], shade(truth))
    step = blurred.steps[60]
    assert step.p_wall is not None
    file = tmp_path / "new" / "step-000060-predicted.png"
    picture = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    assert np.array_equal(picture[::-1][::3, ::3], shade_prediction(step.p_wall))


def test_unknown_is_grey_free_is_light_occupied_is_dark() -> None:
    assert shade(draw("?.#")).tolist() == [
        [export.UNKNOWN_GREY, export.FREE_GREY, export.OCCUPIED_GREY]
    ]
    assert shade_prediction(np.array([[0, 255]], np.uint8)).tolist() == [
        [export.FREE_GREY, export.OCCUPIED_GREY]
    ]


def test_nothing_is_overwritten_without_force(blurred: Recorded, tmp_path: Path) -> None:
    log = EpisodeLog(blurred.path)
    for name in ("a.npz", "truth.png"):
        (tmp_path / name).write_bytes(b"mine")
    with pytest.raises(ExistsError, match=r"a\.npz: exists.*--force"):
        export_arrays(log, tmp_path / "a.npz")
    with pytest.raises(ExistsError, match=r"truth\.png: exists.*--force"):
        export_images(log, tmp_path, [0])
    assert {p.read_bytes() for p in tmp_path.iterdir()} == {b"mine"}
    export_arrays(log, tmp_path / "a.npz", force=True)
    export_images(log, tmp_path, [0], force=True)
    assert b"mine" not in {p.read_bytes() for p in tmp_path.iterdir()}


@pytest.mark.parametrize(
    ("steps", "scale", "reason"),
    [([61], 4, "no step 61; it has steps 0 to 60"), ([-1], 4, "no step -1"),
     ([0], 0, "scale 0: must be 1 to"), ([0], 10_000, "scale 10000: must be 1 to")],
)  # fmt: skip
def test_impossible_pictures_are_refused(
    blurred: Recorded, tmp_path: Path, steps: list[int], scale: int, reason: str
) -> None:
    with pytest.raises(LogError, match=reason):
        export_images(EpisodeLog(blurred.path), tmp_path / "a", steps, scale)
    assert not (tmp_path / "a").exists()


def test_a_folder_that_cannot_be_is_a_clear_error(blurred: Recorded, tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    log = EpisodeLog(blurred.path)
    with pytest.raises(WriteError, match=r"cannot be written \(.+\)"):
        export_arrays(log, tmp_path / "file" / "a.npz")
    with pytest.raises(ExistsError, match="file: is a file, or in one; give the name of a folder"):
        export_images(log, tmp_path / "file", [0])
