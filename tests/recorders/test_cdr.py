"""Every layout against rosbags, which builds the same message from its definition."""

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys.stores import ros2_humble as ros

from mapreplay.recorders.log import cdr
from mapreplay.recorders.log.schemas import typestore
from oracle import to_cdr

STAMP = cdr.Stamp(1, 700_000_000)
TIME = ros.builtin_interfaces__msg__Time(1, 700_000_000)
HEADER = ros.std_msgs__msg__Header(TIME, "map")
NO_TURN = ros.geometry_msgs__msg__Quaternion(0.0, 0.0, 0.0, 1.0)

reals = st.floats(width=64, allow_nan=False)
ints = st.integers(-(2**31), 2**31 - 1)
texts = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=20)
point_lists = st.lists(st.tuples(reals, reals, reals), max_size=5)
candidates = st.builds(cdr.Rated, ints, ints, reals, reals, ints, ints, reals)


def pose(x: float, y: float, z: float = 0.0) -> ros.geometry_msgs__msg__Pose:
    return ros.geometry_msgs__msg__Pose(ros.geometry_msgs__msg__Point(x, y, z), NO_TURN)


def as_array(points: list[tuple[float, float, float]]) -> cdr.Points:
    return np.array(points, np.float64).reshape(-1, 3)


@given(reals, reals)
def test_pose_and_transform(x: float, y: float) -> None:
    data = cdr.pack_pose(STAMP, x, y)
    message = ros.geometry_msgs__msg__PoseStamped(HEADER, pose(x, y))
    assert data == to_cdr(message, message.__msgtype__)
    assert cdr.unpack_pose(data) == (x, y)
    move = ros.geometry_msgs__msg__Transform(ros.geometry_msgs__msg__Vector3(x, y, 0.0), NO_TURN)
    stamped = ros.geometry_msgs__msg__TransformStamped(HEADER, "base_link", move)
    transforms = ros.tf2_msgs__msg__TFMessage([stamped])
    assert cdr.pack_transform(STAMP, x, y) == to_cdr(transforms, transforms.__msgtype__)


@given(st.lists(st.floats(width=32, allow_nan=False), max_size=20))
def test_scan(values: list[float]) -> None:
    ranges = np.array(values, np.float32)
    data = cdr.pack_scan(STAMP, cdr.Scan(0.0, 6.0, 0.25, 0.0, 0.5, 0.0, 21.0, ranges))
    message = ros.sensor_msgs__msg__LaserScan(
        ros.std_msgs__msg__Header(TIME, "base_link"),
        0.0, 6.0, 0.25, 0.0, 0.5, 0.0, 21.0, ranges, np.empty(0, np.float32),
    )  # fmt: skip
    assert data == to_cdr(message, message.__msgtype__)
    assert cdr.unpack_ranges(data).tolist() == values


@given(st.integers(1, 9), st.integers(1, 9), reals, reals)
def test_grids(height: int, width: int, x: float, y: float) -> None:
    info = cdr.GridInfo(0.25, width, height, x, y)
    cells = np.arange(height * width, dtype=np.int8).reshape(height, width)
    data = cdr.pack_grid(STAMP, cdr.Stamp(1, 0), info, cells)
    meta = ros.nav_msgs__msg__MapMetaData(
        ros.builtin_interfaces__msg__Time(1, 0), 0.25, width, height, pose(x, y)
    )
    grid = ros.nav_msgs__msg__OccupancyGrid(HEADER, meta, cells.ravel())
    assert data == to_cdr(grid, grid.__msgtype__)
    back, read = cdr.unpack_grid(data)
    assert back == info
    assert np.array_equal(read, cells)


@pytest.mark.parametrize(("code", "dtype"), [(1, "<u1"), (3, "<u2"), (7, "<f4")])
@given(height=st.integers(1, 5), width=st.integers(1, 5))
def test_packed_grids(code: int, dtype: str, height: int, width: int) -> None:
    cells = np.arange(height * width).reshape(height, width).astype(dtype)
    data = cdr.pack_packed_grid(STAMP, cdr.GridInfo(0.25, width, height, 1.0, 2.0), code, cells)
    types, size = typestore().types, cells.itemsize
    grid = types["foxglove_msgs/msg/Grid"](
        timestamp=TIME,
        frame_id="map",
        pose=pose(1.0, 2.0),
        column_count=width,
        cell_size=types["foxglove_msgs/msg/Vector2"](x=0.25, y=0.25),
        row_stride=width * size,
        cell_stride=size,
        fields=[types["foxglove_msgs/msg/PackedElementField"](name="p_wall", offset=0, type=code)],
        data=np.frombuffer(cells.tobytes(), np.uint8),
    )
    assert data == to_cdr(grid, "foxglove_msgs/msg/Grid")
    read = cdr.unpack_packed_grid(data)
    assert (read.field_type, read.width) == (code, width)
    assert read.data.tobytes() == cells.tobytes()


@given(point_lists)
def test_points(points: list[tuple[float, float, float]]) -> None:
    cells = ros.nav_msgs__msg__GridCells(
        HEADER, 0.5, 0.5, [ros.geometry_msgs__msg__Point(*point) for point in points]
    )
    data = cdr.pack_grid_cells(STAMP, 0.5, as_array(points))
    assert data == to_cdr(cells, cells.__msgtype__)
    assert np.array_equal(cdr.unpack_grid_cells(data), as_array(points))
    path = ros.nav_msgs__msg__Path(
        HEADER, [ros.geometry_msgs__msg__PoseStamped(HEADER, pose(*point)) for point in points]
    )
    data = cdr.pack_path(STAMP, as_array(points))
    assert data == to_cdr(path, path.__msgtype__)
    assert np.array_equal(cdr.unpack_path(data), as_array(points))


@given(
    texts, candidates, st.lists(candidates, max_size=4), st.booleans(), st.integers(0, 2**64 - 1)
)
def test_decision(
    mode: str, chosen: cdr.Rated, rivals: list[cdr.Rated], is_random: bool, draw: int
) -> None:
    choice = cdr.Choice(mode, chosen, rivals, is_random, draw)
    types = typestore().types
    candidate = types["mapreplay_msgs/msg/Candidate"]
    message = types["mapreplay_msgs/msg/Decision"](
        header=HEADER,
        mode=mode,
        chosen=candidate(**chosen._asdict()),
        rivals=[candidate(**rival._asdict()) for rival in rivals],
        is_random=is_random,
        random_draw=draw,
    )
    data = cdr.pack_decision(STAMP, choice)
    assert data == to_cdr(message, "mapreplay_msgs/msg/Decision")
    assert cdr.unpack_decision(data) == choice


@given(texts, st.tuples(*[reals] * 25))
def test_metrics(outcome: str, scores: tuple[float, ...]) -> None:
    cls = typestore().types["mapreplay_msgs/msg/StepMetrics"]
    data = cdr.pack_metrics(STAMP, outcome, scores)
    assert data == to_cdr(cls(HEADER, outcome, *scores), "mapreplay_msgs/msg/StepMetrics")
    assert cdr.unpack_metrics(data, 25) == (outcome, scores)


@given(st.tuples(*[st.integers(-(2**63), 2**63 - 1)] * 5))
def test_profile(times: tuple[int, ...]) -> None:
    cls = typestore().types["mapreplay_msgs/msg/StepProfile"]
    data = cdr.pack_profile(STAMP, times)
    assert data == to_cdr(cls(HEADER, *times), "mapreplay_msgs/msg/StepProfile")
    assert cdr.unpack_profile(data) == times


@given(st.builds(cdr.LogLine, st.integers(0, 255), texts, texts))
def test_log_line(line: cdr.LogLine) -> None:
    message = ros.rcl_interfaces__msg__Log(TIME, line.level, line.name, line.text, "", "", 0)
    data = cdr.pack_log(STAMP, line)
    assert data == to_cdr(message, message.__msgtype__)
    assert cdr.unpack_log(data) == line


CHOICE = cdr.Choice("normal", cdr.Rated(1, 2, 3.0, 4.0, 5, 6, 7.0), [], False, 0)
READERS = {
    "pose": (cdr.pack_pose(STAMP, 1.0, 2.0), cdr.unpack_pose),
    "grid": (
        cdr.pack_grid(STAMP, STAMP, cdr.GridInfo(1, 2, 1, 0, 0), np.zeros((1, 2), np.int8)),
        cdr.unpack_grid,
    ),
    "points": (cdr.pack_grid_cells(STAMP, 1.0, np.ones((2, 3))), cdr.unpack_grid_cells),
    "path": (cdr.pack_path(STAMP, np.ones((2, 3))), cdr.unpack_path),
    "decision": (cdr.pack_decision(STAMP, CHOICE), cdr.unpack_decision),
    "log": (cdr.pack_log(STAMP, cdr.LogLine(20, "name", "text"))[:37], cdr.unpack_log),
}


@pytest.mark.parametrize("name", READERS)
def test_a_message_that_is_cut_off_is_refused(name: str) -> None:
    data, unpack = READERS[name]
    unpack(data)
    for size in range(len(data)):
        with pytest.raises((ValueError, struct.error)):
            unpack(data[:size])


def test_a_message_in_another_frame_is_refused() -> None:
    data = cdr.pack_pose(STAMP, 1.0, 2.0).replace(b"map", b"odo")
    with pytest.raises(ValueError, match="not in the frame map"):
        cdr.unpack_pose(data)


def test_arrays_own_their_memory() -> None:
    """A view would keep its whole chunk alive, and could not be written to."""
    info = cdr.GridInfo(1.0, 2, 1, 0.0, 0.0)
    _, cells = cdr.unpack_grid(cdr.pack_grid(STAMP, STAMP, info, np.zeros((1, 2), np.int8)))
    cells[:] = 1
    assert cells.base is None or cells.base.flags.owndata
