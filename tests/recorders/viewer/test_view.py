from __future__ import annotations

import socket
import subprocess
import time
import urllib.request
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import psutil
import pytest
import rerun as rr
import rerun.blueprint as rrb
from hypothesis import given
from hypothesis import strategies as st
from rerun.chunk import RrdReader

from drawing import plan
from fakes import NoisyPredictor
from mapreplay.config import EpisodeConfig
from mapreplay.episode import Episode, prepare_episode, run_episode
from mapreplay.errors import ExistsError, LogError, UsageError, WriteError
from mapreplay.grid import FREE, OCCUPIED, UNKNOWN, Grid
from mapreplay.recorders.pictures.annotations import Mark
from mapreplay.recorders.pictures.captions import decision_words
from mapreplay.recorders.pictures.layers import cell_classes, error_classes, rays_of
from mapreplay.recorders.pictures.palette import (
    AGENT_COLOUR,
    FRONTIER_COLOUR,
    RIVALS_COLOUR,
    CellClass,
)
from mapreplay.recorders.pictures.replay import Replay
from mapreplay.recorders.viewer import columns as rerun_columns
from mapreplay.recorders.viewer import servers
from mapreplay.recorders.viewer.columns import send_episode
from mapreplay.recorders.viewer.recording import save_rrd
from mapreplay.recorders.viewer.servers import LiveView, WebServer, serve_web
from mapreplay.step import Step
from viewer import (
    LATTICE,
    Screenshot,
    agreement,
    controls,
    samples,
    seen_classes,
    seen_levels,
    viewer_on,
)

HOUSE = """
    #######################
    #.......#......#......#
    #.......#......#......#
    #..............#......#
    #.......#.............#
    ####.####......#......#
    #.......########..#####
    #.......#.............#
    #.......#....##.......#
    #............##...#####
    #.......#.........#?..#
    #######################
"""

Recorded = dict[str, dict[int, Any]]
"""Of each "path:component" the value logged at each step; at -1 what is static."""


def prepare(**config: Any) -> Episode:
    values = {"planner": "nearest", "plan_on": "observed", "coverage": 1.0, "max_steps": 30}
    # Thresholds as loose as these let the predictor fill the fused map with mistakes.
    loose = {"delta_free": 0.4, "delta_occupied": 0.4}
    return prepare_episode(
        EpisodeConfig(**(values | loose | config)), plan(HOUSE), predictor=NoisyPredictor()
    )


@pytest.fixture(scope="module")
def episode() -> Episode:
    return prepare()


@pytest.fixture(scope="module")
def steps(episode: Episode) -> list[Step]:
    return list(run_episode(episode))


@pytest.fixture(scope="module")
def saved(episode: Episode, steps: list[Step], tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("rrd") / "episode.rrd"
    save_rrd(path, [Replay(episode.header, steps)])
    return path


def read(path: Path) -> Recorded:
    recorded: Recorded = {}
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        indices = [-1] * len(batch) if chunk.is_static else batch["step"].to_pylist()
        for name in batch.schema.names:
            if ":" in name and not name.startswith("RecordingInfo"):
                column = recorded.setdefault(f"{chunk.entity_path}:{name}", {})
                column.update(zip(indices, batch[name].to_pylist(), strict=True))
    return recorded


def pictures(recorded: Recorded, name: str, image: str, shape: tuple[int, int]) -> dict[int, Any]:
    """Each step's picture, row 0 on top: the newest that was sent up to it, as a viewer shows."""
    column = recorded[f"/maps/{name}:{image}:buffer"]
    shown = {k: np.array(value, np.uint8).reshape(shape) for k, value in column.items()}
    if -1 in shown:
        return shown
    last = max(recorded["/agent/position:Points2D:positions"])
    return {k: shown[max(i for i in shown if i <= k)] for k in range(last + 1)}


def class_of(cell: int) -> CellClass:
    return {
        UNKNOWN: CellClass.UNKNOWN,
        FREE: CellClass.FREE,
        OCCUPIED: CellClass.OCCUPIED,
    }[cell]


# --- What is sent, read back from the file -------------------------------------------------


def test_every_cell_of_every_step_is_sent_with_row_0_at_the_bottom(
    saved: Path, episode: Episode, steps: list[Step]
) -> None:
    height, width = episode.header.floor_plan.shape
    recorded = read(saved)
    observed = pictures(recorded, "observed", "SegmentationImage", (height, width))
    fused = pictures(recorded, "fused", "SegmentationImage", (height, width))
    predicted = pictures(recorded, "predicted", "DepthImage", (height, width))
    truth = pictures(recorded, "truth", "SegmentationImage", (height, width))
    assert list(truth) == [-1]
    assert list(observed) == list(fused) == list(predicted) == [step.index for step in steps]
    for step in steps:
        assert step.p_wall is not None
        for row in range(height):
            for col in range(width):
                at = (height - 1 - row, col)
                assert observed[step.index][at] == class_of(step.observed[row, col])
                assert fused[step.index][at] == class_of(step.fused[row, col])
                assert predicted[step.index][at] == step.p_wall[row, col]
                assert truth[-1][at] == class_of(episode.header.floor_plan.cells[row, col])


def test_errors_are_sent_of_the_fused_map(saved: Path, episode: Episode, steps: list[Step]) -> None:
    shape = episode.header.floor_plan.shape
    shown = pictures(read(saved), "error", "SegmentationImage", shape)
    truth = episode.header.floor_plan.cells
    found = set()
    for step in steps:
        expected = error_classes(step.fused, truth, episode.header.explorable)
        assert (shown[step.index][::-1] == expected).all()
        found |= set(np.unique(expected).tolist())
    assert found == set(CellClass), "this episode must show every kind of cell"


@given(st.data(), st.integers(1, 9), st.integers(1, 9))
def test_points_lie_on_the_cells_of_pictures(data: st.DataObject, height: int, width: int) -> None:
    cell = (data.draw(st.integers(0, height - 1)), data.draw(st.integers(0, width - 1)))
    grid = np.zeros((height, width), np.uint8)
    grid[cell] = 1
    x, y = rerun_columns.centres(np.array([cell]), height)[0]
    picture = rerun_columns.as_pictures([grid])[0].reshape(height, width)
    assert picture[int(y), int(x)] == 1
    assert (x % 1, y % 1) == (0.5, 0.5)


def test_agent_trail_frontier_path_and_target_are_those_of_the_step(
    saved: Path, episode: Episode, steps: list[Step]
) -> None:
    height = episode.header.floor_plan.shape[0]
    recorded = read(saved)

    def xy(cell: Any) -> list[float]:
        return [cell[1] + 0.5, height - cell[0] - 0.5]

    for before, step in zip([None, *steps], steps, strict=False):
        k = step.index
        assert recorded["/agent/position:Points2D:positions"][k] == [xy(step.agent)]
        move = [[xy(before.agent), xy(step.agent)]] if before else []
        assert recorded["/agent/trail:LineStrips2D:strips"][k] == move
        frontier = [xy(cell) for cell in step.frontier]
        assert recorded["/plan/frontier:Points2D:positions"][k] == frontier
        path = [[xy(cell) for cell in step.decision.path]] if step.decision else []
        assert recorded["/plan/path:LineStrips2D:strips"][k] == path
        target = [xy(step.decision.target)] if step.decision else []
        assert recorded["/plan/target:Points2D:positions"][k] == target
        rays = rays_of(step, episode.header)
        ends = [strip[1] for strip in recorded["/agent/rays:LineStrips2D:strips"][k]]
        assert ends == [xy(end) for end in rays.ends]
        hits = [xy(end) for end in rays.ends[rays.hit]]
        assert recorded["/agent/hits:Points2D:positions"][k] == hits
        rivals = [xy(rival.cell) for rival in step.decision.rivals] if step.decision else []
        assert recorded["/plan/rivals:Points2D:positions"][k] == rivals
    assert steps[-1].decision is None, "the last step clears path and target"


def test_curves_events_and_header_are_sent(saved: Path, steps: list[Step]) -> None:
    recorded = read(saved)
    names = (
        "f1",
        "precision",
        "recall",
        "coverage_observed",
        "coverage_fused",
        "correct_coverage_fused",
    )
    for name in names:
        curve = recorded[f"/scores/{name}:Scalars:scalars"]
        expected = {step.index: [getattr(step.metrics, name)] for step in steps}
        assert curve == expected
    texts = recorded["/events:TextLog:text"]
    assert texts[steps[-1].index] == ["outcome: out of steps after 30 steps"]
    states = recorded["/state:StateChange:state"]
    assert states == {0: ["exploring"], 30: ["out of steps"]}
    (said,) = recorded["/decision:TextDocument:text"][3]
    assert said.startswith(f"**Step 3: exploring**\n\n{decision_words(steps[3])}\n")
    chosen = steps[3].decision
    assert chosen is not None
    assert f"| **({chosen.target.row}, {chosen.target.col})** |" in said
    (document,) = recorded["/header:TextDocument:text"][-1]
    assert "| predictor | noisy |" in document


def test_blocks_join_without_a_seam(
    episode: Episode, steps: list[Step], saved: Path, tmp_path: Path, monkeypatch: Any
) -> None:
    monkeypatch.setattr(rerun_columns, "BLOCK_STEPS", 7)
    save_rrd(tmp_path / "seven.rrd", [Replay(episode.header, iter(steps))])
    assert read(tmp_path / "seven.rrd") == read(saved)


def test_a_live_view_shows_what_a_finished_one_shows(
    episode: Episode, steps: list[Step], saved: Path, tmp_path: Path
) -> None:
    path = tmp_path / "live.rrd"

    def to_file(recording: rr.RecordingStream, blueprint: rrb.Blueprint) -> None:
        recording.save(path, blueprint)

    with LiveView(episode.header, to_file) as live:
        for step in steps:
            live.add(step)
    assert read(path) == read(saved)


def test_a_step_without_a_prediction_takes_back_the_last_one(
    episode: Episode, steps: list[Step], tmp_path: Path
) -> None:
    silent = replace(steps[1], p_wall=None)
    save_rrd(tmp_path / "x.rrd", [Replay(episode.header, [steps[0], silent])])
    column = read(tmp_path / "x.rrd")["/maps/predicted:DepthImage:buffer"]
    assert len(column[0]) == 1
    assert column[1] == []


def test_two_episodes_share_a_recording_under_two_roots(
    episode: Episode, steps: list[Step], tmp_path: Path
) -> None:
    path = tmp_path / "two.rrd"
    recording = rr.RecordingStream("two")
    recording.save(path)
    send_episode(recording, Replay(episode.header, steps), "/A", "A first")
    send_episode(recording, Replay(episode.header, steps[:5]), "/B", "B second")
    recording.flush()
    recording.disconnect()
    recorded = read(path)
    assert max(recorded["/A/agent/position:Points2D:positions"]) == len(steps) - 1
    assert max(recorded["/B/agent/position:Points2D:positions"]) == 4


def test_marks_are_sent_on_their_cells_while_they_are_shown(
    tmp_path: Path, episode: Episode, steps: list[Step]
) -> None:
    """Row 0 of a picture is on top: a mark in the lowest row has the largest y."""
    last, height = steps[-1].index, episode.header.floor_plan.shape[0]
    marks = [
        Mark("blocking cell", 2, 4, np.array([[0, 3], [1, 3]], np.int32), "walls"),
        Mark("doorway", 3, last, np.array([[height - 1, 5]], np.int32), "a door"),
        Mark("blocking cell", last + 1, last + 1, np.array([[1, 1]], np.int32), "too late"),
    ]
    save_rrd(tmp_path / "x.rrd", [Replay(episode.header, steps, marks)])
    recorded = read(tmp_path / "x.rrd")
    bottom = height - 0.5
    assert recorded["/marks/0:Boxes2D:centers"] == {
        2: [[3.5, bottom], [3.5, bottom - 1]],
        5: [],
    }
    assert recorded["/marks/0:Boxes2D:half_sizes"] == {2: [[0.5, 0.5]] * 2, 5: []}
    assert recorded["/marks/0:Boxes2D:labels"] == {-1: ["blocking cell: walls"]}
    assert recorded["/marks/1:Boxes2D:centers"] == {3: [[5.5, 0.5]]}
    assert not any(name.startswith("/marks/2") for name in recorded)
    blocking_cell, opening = (recorded[f"/marks/{i}:Boxes2D:colors"][-1] for i in (0, 1))
    assert blocking_cell != opening


def view_names(path: Path) -> set[str]:
    reader = RrdReader(path)
    (blueprint,) = reader.blueprints()
    names = set()
    for chunk in reader.stream(store=blueprint):
        batch = chunk.to_record_batch()
        if "ViewBlueprint:display_name" in batch.schema.names:
            names.update(
                name for row in batch["ViewBlueprint:display_name"].to_pylist() for name in row
            )
    return names


def test_the_file_holds_its_layout(saved: Path) -> None:
    assert view_names(saved) == {
        "Observed", "Predicted P(wall)", "Fused", "Error of fused", "Truth",
        "Scores", "Events", "Episode", "Decision", "State", "Legend",
    }  # fmt: skip


def test_without_a_predictor_nothing_is_left_empty(tmp_path: Path) -> None:
    config = EpisodeConfig(planner="nearest", predictor="none", max_steps=3)
    episode = prepare_episode(config, plan(HOUSE))
    save_rrd(tmp_path / "x.rrd", [Replay(episode.header, run_episode(episode))])
    recorded = read(tmp_path / "x.rrd")
    assert "Predicted P(wall)" not in view_names(tmp_path / "x.rrd")
    assert "/maps/predicted:DepthImage:buffer" not in recorded
    fused = recorded["/maps/fused:SegmentationImage:buffer"]
    assert fused == recorded["/maps/observed:SegmentationImage:buffer"]


# --- Where it is shown ---------------------------------------------------------------------


def test_a_file_is_only_overwritten_by_force(
    episode: Episode, steps: list[Step], tmp_path: Path
) -> None:
    path = tmp_path / "x.rrd"
    path.write_text("precious")
    with pytest.raises(ExistsError, match="exists; choose another name"):
        save_rrd(path, [Replay(episode.header, steps)])
    assert path.read_text() == "precious"
    save_rrd(path, [Replay(episode.header, steps)], force=True)
    assert len(read(path)["/events:TextLog:text"]) > 0


def test_a_file_is_written_whole_or_not_at_all(
    episode: Episode, steps: list[Step], tmp_path: Path
) -> None:
    def damaged() -> Iterator[Step]:
        yield from steps[:3]
        raise LogError("x.mcap: damaged")

    with pytest.raises(LogError, match="damaged"):
        save_rrd(tmp_path / "x.rrd", [Replay(episode.header, damaged())])
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_cannot_be_written_is_a_clear_error(
    episode: Episode, steps: list[Step], tmp_path: Path
) -> None:
    with pytest.raises(WriteError, match=r"x\.rrd: cannot be written \(no folder .+\)"):
        save_rrd(tmp_path / "nowhere" / "x.rrd", [Replay(episode.header, steps)])
    (tmp_path / "folder").mkdir()
    with pytest.raises(ExistsError, match="folder: is a folder; give the name of a file"):
        save_rrd(tmp_path / "folder", [Replay(episode.header, steps)], force=True)


@pytest.mark.parametrize(
    ("platform", "environment", "ok"),
    [
        ("linux", {}, False),
        ("linux", {"DISPLAY": ""}, False),
        ("linux", {"DISPLAY": ":0"}, True),
        ("linux", {"WAYLAND_DISPLAY": "wayland-0"}, True),
        ("darwin", {}, True),
        ("win32", {}, True),
    ],
)
def test_a_window_needs_a_display(platform: str, environment: dict[str, str], ok: bool) -> None:
    if ok:
        servers.require_display(platform, environment)
    else:
        with pytest.raises(UsageError, match=r"--web .*--save"):
            servers.require_display(platform, environment)


def test_without_a_display_nothing_is_started(
    episode: Episode, steps: list[Step], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(servers, "_viewer", lambda *_: pytest.fail("a viewer was started"))
    with pytest.raises(UsageError, match="no display"):
        servers.open_viewer([Replay(episode.header, steps)])
    with pytest.raises(UsageError, match="no display"):
        LiveView(episode.header)


@pytest.mark.filterwarnings("ignore:RRD file has no footer")  # the client is stopped
def test_the_web_viewer_is_served_to_this_machine_only(
    episode: Episode, steps: list[Step], tmp_path: Path
) -> None:
    with serve_web([Replay(episode.header, steps)]) as server:
        (process,) = psutil.Process(server._program.pid).children()
        page = urllib.request.urlopen(server.address, timeout=5)
        with page:
            assert b"Rerun" in page.read()
        listening = [c.laddr.ip for c in process.net_connections() if c.status == "LISTEN"]
        assert set(listening) == {"127.0.0.1"}
        received = receive(server._grpc_address, tmp_path / "got.rrd")
        with pytest.raises(UsageError, match="cannot be used"):
            WebServer(grpc_port=int(server._grpc_address.split(":")[-1].split("/")[0]))
    assert not process.is_running()
    assert len(received["/agent/position:Points2D:positions"]) == len(steps)


@pytest.mark.filterwarnings("ignore:RRD file has no footer")  # the client is stopped
def test_a_viewer_that_is_open_is_used_again(
    episode: Episode, steps: list[Step], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DISPLAY", ":0")
    with WebServer() as server:  # listens as a viewer does
        monkeypatch.setattr(servers, "_viewer", lambda *_: pytest.fail("a second one"))
        port = int(server._grpc_address.split(":")[-1].split("/")[0])
        servers.open_viewer([Replay(episode.header, steps)], port)
        received = receive(server._grpc_address, tmp_path / "got.rrd")
    assert len(received["/agent/position:Points2D:positions"]) == len(steps)


def test_nothing_is_sent_to_what_is_not_a_viewer(
    episode: Episode, steps: list[Step], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DISPLAY", ":0")
    with socket.create_server(("127.0.0.1", 0)) as deaf:
        port = deaf.getsockname()[1]
        with pytest.raises(UsageError, match=f"port {port} is used"):
            servers.open_viewer([Replay(episode.header, steps)], port)


def receive(address: str, path: Path) -> Recorded:
    """What a client of the server gets: Rerun's own, which goes on listening until stopped."""
    client = [
        servers.viewer_program(),
        "--bind=127.0.0.1",
        "--port=auto",
        address,
        "--save",
        path,
    ]
    with subprocess.Popen(client, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        sizes = [0]
        while len(sizes) < 100 and (sizes[-1] == 0 or sizes[-1] != sizes[-5:][0]):
            time.sleep(0.2)
            sizes.append(path.stat().st_size if path.exists() else 0)
        process.terminate()
    return read(path)


# --- What is seen, in the real viewer ------------------------------------------------------


@pytest.fixture(scope="module")
def screenshot(saved: Path) -> Iterator[Screenshot]:
    with viewer_on(saved) as shoot:
        yield shoot


def test_every_cell_is_seen_where_it_lies(
    screenshot: Screenshot, episode: Episode, steps: list[Step]
) -> None:
    plan = episode.header.floor_plan

    def classes(cells: Grid) -> npt.NDArray[np.int64]:
        return np.vectorize(class_of, otypes=[np.int64])(cells)

    expected: dict[str, Callable[[Step], npt.NDArray[Any]]] = {
        "Observed": lambda step: classes(step.observed),
        "Fused": lambda step: classes(step.fused),
        "Error of fused": lambda step: error_classes(
            step.fused, plan.cells, episode.header.explorable
        ),
    }
    for k in (5, 13, 19):
        for view, map_of in expected.items():
            seen = seen_classes(screenshot(k, view), plan.shape)
            right = map_of(steps[k])
            assert np.argwhere(seen != right).tolist() == [], (k, view, steps[k].agent)
            for name, wrong in controls(right).items():
                assert agreement(seen, wrong) < 0.95, (k, view, name)
            other = map_of(steps[k + 10])
            assert agreement(seen, other) < 0.95, (k, view, "ten steps later")
            next_one = map_of(steps[k + 1])
            assert agreement(seen, next_one) < 1.0, (k, view, "next step")


def test_the_prediction_is_seen_where_it_lies(
    screenshot: Screenshot, episode: Episode, steps: list[Step]
) -> None:
    for k in (0, 13):
        seen = seen_levels(screenshot(k, "Predicted P(wall)"), episode.header.floor_plan.shape)
        right = steps[k].p_wall
        assert right is not None
        assert agreement(seen, right, tolerance=6) == 1.0
        for name, wrong in controls(right).items():
            assert agreement(seen, wrong, tolerance=6) < 0.9, name


def test_agent_and_frontier_are_seen_on_their_cells(
    screenshot: Screenshot, episode: Episode, steps: list[Step]
) -> None:
    shape = episode.header.floor_plan.shape
    for k in (0, 13):
        step = steps[k]
        centre = samples(screenshot(k, "Fused"), shape)[::-1, :, LATTICE**2 // 2]

        def is_at(cell: Any, colour: tuple[int, int, int], centre: Any = centre) -> bool:
            return bool(np.abs(centre[tuple(cell)] - colour).max() <= 40)

        assert step.decision is not None
        assert is_at(step.agent, AGENT_COLOUR)
        covered = {tuple(cell) for cell in step.decision.path.tolist()}
        rivals = {rival.cell for rival in step.decision.rivals} - covered
        assert rivals
        assert all(is_at(cell, RIVALS_COLOUR) for cell in rivals)
        covered |= rivals
        free = [cell for cell in step.frontier.tolist() if tuple(cell) not in covered]
        assert free
        assert all(is_at(cell, FRONTIER_COLOUR) for cell in free)
        assert not any(
            is_at((r, c + 1), FRONTIER_COLOUR) for r, c in free if [r, c + 1] not in free
        )


@pytest.mark.slow
def test_of_two_episodes_every_cell_is_seen_in_its_own_row(
    episode: Episode, steps: list[Step], tmp_path: Path
) -> None:
    other = prepare(planner="random", seed=5)
    walks = {"A": steps, "B": list(run_episode(other))}
    headers = {"A": episode.header, "B": other.header}
    rrd = tmp_path / "two.rrd"
    save_rrd(rrd, [Replay(headers[name], walk) for name, walk in walks.items()])
    shape = episode.header.floor_plan.shape
    truth = episode.header.floor_plan.cells
    with viewer_on(rrd) as shoot:
        for k in (4, 15, 29):
            for name, walk in walks.items():
                step, stranger = walk[k], walks["B" if name == "A" else "A"][k]
                right = {
                    "Observed": (cell_classes(step.observed), cell_classes(stranger.observed)),
                    "Fused": (cell_classes(step.fused), cell_classes(stranger.fused)),
                    "Error of fused": (
                        error_classes(step.fused, truth, episode.header.explorable),
                        error_classes(stranger.fused, truth, episode.header.explorable),
                    ),
                }
                for view, (expected, wrong) in right.items():
                    seen = seen_classes(shoot(k, f"{name}  {view}"), shape)
                    assert np.argwhere(seen != expected).tolist() == [], (k, name, view)
                    assert agreement(seen, wrong) < 1.0, (k, name, view, "the other episode's")
                assert step.p_wall is not None
                levels = seen_levels(shoot(k, f"{name}  Predicted P(wall)"), shape)
                off = np.argwhere(np.abs(levels - step.p_wall) > 6).tolist()
                track = [list(earlier.agent) for earlier in walk[: k + 1]]
                assert all(cell in track for cell in off), "only dot and trail may cover a cell"
                assert len(off) <= 3
                assert stranger.p_wall is not None
                assert agreement(levels, stranger.p_wall, tolerance=6) < 0.9
