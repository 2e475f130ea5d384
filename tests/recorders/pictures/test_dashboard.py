"""The layout as a picture. To renew the golden ones after a change that is meant:
``MAPREPLAY_RENEW=1 pytest tests/recorders/pictures/test_dashboard.py``, and look at them.
"""

from __future__ import annotations

import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from mapreplay.errors import UsageError
from mapreplay.external import ExternalEpisode, unknown_floor_plan
from mapreplay.pictures import Picture, png_of
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.recorders.log.writer import EpisodeWriter
from mapreplay.recorders.pictures.animation import few_colours
from mapreplay.recorders.pictures.annotations import Mark
from mapreplay.recorders.pictures.dashboard import Film, Filmed
from mapreplay.recorders.pictures.palette import CELL_COLOURS, DARK, LIGHT, YELLOW, Theme
from recordings import record, two_rooms

GOLDEN = Path(__file__).parent / "golden_pictures"
SAMPLES = Path(__file__).parents[3] / "samples" / "episodes"
SIZE = (960, 540)


@pytest.fixture(scope="module")
def rooms(tmp_path_factory: pytest.TempPathFactory) -> Filmed:
    """Nine steps in a map of 12 x 12 cells, with a mark from step 2 to 5."""
    log = EpisodeLog(record(tmp_path_factory.mktemp("rooms"), two_rooms()).path)
    mark = Mark(
        "blocking cell", 2, 5, np.array([[6, 2], [6, 3]], np.int32), "this wall is not there"
    )
    return Filmed.of(log, [mark])


@pytest.fixture(scope="module")
def houses() -> list[Filmed]:
    """Two recorded episodes on the same floor plan."""
    return [Filmed.of(EpisodeLog(path)) for path in sorted(SAMPLES.glob("procedural-60002*"))]


def check(picture: Picture, name: str) -> None:
    """Compare with the golden picture; fonts and codecs may differ by a shade."""
    path = GOLDEN / f"{name}.png"
    if os.environ.get("MAPREPLAY_RENEW"):
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(png_of(picture))
    golden = cv2.imread(str(path))
    assert golden is not None
    assert picture.shape == golden.shape
    off = np.abs(picture[..., ::-1].astype(int) - golden).max(axis=2) > 40
    assert off.mean() < 0.002, f"{off.sum()} pixels are not as in {path.name}"


@pytest.mark.parametrize(("step", "theme"), [(0, LIGHT), (3, DARK), (8, LIGHT)])
def test_one_episode_looks_as_it_did(rooms: Filmed, step: int, theme: Theme) -> None:
    check(Film([rooms], SIZE, theme).frame(step), f"rooms-{step}-{theme.name}")


def test_two_episodes_look_as_they_did(houses: list[Filmed]) -> None:
    check(Film(houses, SIZE, LIGHT).frame(60), "houses-60-light")


def test_a_golden_picture_notices_another_step(
    rooms: Filmed, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("MAPREPLAY_RENEW", raising=False)
    with pytest.raises(AssertionError, match="pixels are not as in"):
        check(Film([rooms], SIZE, LIGHT).frame(1), "rooms-0-light")


def test_a_film_has_the_frames_of_its_steps(rooms: Filmed) -> None:
    film = Film([rooms], (640, 360))
    frames = list(film.frames(every=3))
    assert len(frames) == 4, "steps 0, 3, 6 and the last, 8"
    for index, frame in zip((0, 3, 6, 8), frames, strict=True):
        assert (frame == film.frame(index)).all()


def test_an_episode_that_is_over_stays_at_its_last_step(houses: list[Filmed]) -> None:
    film = Film(houses, (640, 360))
    assert film.last == 520
    maps = [film.frame(step)[40:140, :480] for step in (103, 104, 300)]
    assert (maps[1] == maps[2]).all()
    assert (maps[0] != maps[1]).any()


def test_marks_are_drawn_and_named(rooms: Filmed) -> None:
    film = Film([rooms], SIZE)

    def yellow(step: int) -> int:
        maps = film.frame(step)[30:280]  # the legend below has it at every step
        return int((np.abs(maps.astype(int) - YELLOW).max(axis=2) < 4).sum())

    assert yellow(3) > yellow(1) + 500
    assert yellow(3) > yellow(6) + 500


def test_an_episode_without_truth_prediction_and_targets_is_drawn(tmp_path: Path) -> None:
    plan = unknown_floor_plan("lab", (30, 80), resolution=0.05)
    episode = ExternalEpisode(plan, (5, 5), planner="mine")
    observed = np.full((30, 80), -1, np.int8)
    observed[3:9, 3:30] = 0
    with EpisodeWriter(tmp_path / "lab.mcap", episode.header) as writer:
        for k in range(3):
            writer.add(episode.step((5, 5 + k), observed))
    film = Film([Filmed.of(EpisodeLog(tmp_path / "lab.mcap.part"))], (640, 360))
    assert film.last == 2
    assert film.frame(2).std() > 20


def test_sizes_and_numbers_of_episodes_are_checked(rooms: Filmed) -> None:
    with pytest.raises(UsageError, match="100x100: a picture has 640x360 to 7680x4320 pixels"):
        Film([rooms], (100, 100))
    with pytest.raises(UsageError, match="3 episodes; a picture shows one or two"):
        Film([rooms] * 3)


def test_few_colours_keep_those_that_have_a_meaning(rooms: Filmed) -> None:
    frame = Film([rooms], SIZE, LIGHT).frame(3)
    few = np.asarray(few_colours(frame).convert("RGB"))
    for colour in (*CELL_COLOURS.values(), YELLOW, LIGHT.paper):
        exact = (frame == colour).all(axis=2)
        assert (few[exact] == colour).all()
    assert np.abs(few.astype(int) - frame).mean() < 3
