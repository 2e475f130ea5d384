"""The messages of a log as CDR: little-endian bytes, packed and read by hand.

Plain CDR is four bytes that say so, then the fields in order; each number is aligned to its
size, counted from after those four bytes, and a string or a sequence begins with its length.
The frame names of our messages never change, so nearly all of a message is one `struct`, in
which ``x`` is the padding. rosbags does the same for any type, at several times the cost; the
tests compare every byte with it. The fields are those of the definitions that a log carries.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

Buffer: TypeAlias = bytes | memoryview

Points: TypeAlias = npt.NDArray[np.float64]
"""float64[n, 3]: x, y, z in metres."""


class Stamp(NamedTuple):
    """builtin_interfaces/Time."""

    sec: int
    nanosec: int


class Scan(NamedTuple):
    """What sensor_msgs/LaserScan says, without intensities."""

    angle_min: float
    angle_max: float
    angle_increment: float
    time_increment: float
    scan_time: float
    range_min: float
    range_max: float
    ranges: npt.NDArray[np.float32]


class GridInfo(NamedTuple):
    """Where a grid lies: the size of a cell and its lower left corner, in metres."""

    resolution: float
    width: int
    height: int
    x: float
    y: float


class PackedGrid(NamedTuple):
    """The cells of a foxglove_msgs/Grid with one field."""

    field_type: int
    width: int
    data: npt.NDArray[np.uint8]


class Rated(NamedTuple):
    """mapreplay_msgs/Candidate."""

    row: int
    col: int
    utility: float
    reward: float
    straight: int
    diagonal: int
    cost: float


class Choice(NamedTuple):
    """What mapreplay_msgs/Decision says."""

    mode: str
    chosen: Rated
    rivals: list[Rated]
    is_random: bool
    random_draw: int


class LogLine(NamedTuple):
    """What rcl_interfaces/Log says, without the place in a source file."""

    level: int
    name: str
    text: str


_CDR: Final = b"\0\1\0\0"
_MAP: Final = (4, b"map\0")
_BASE_LINK: Final = (10, b"base_link\0")
_NO_TURN: Final = (0.0, 0.0, 0.0, 1.0)

_HEADER: Final = struct.Struct("<4siII4s")
_TRANSFORMS: Final = struct.Struct("<4sIiII4sI10s6x7d")
_POSE: Final = struct.Struct("<4siII4s7d")
_SCAN: Final = struct.Struct("<4siII10s2x7fI")
_GRID: Final = struct.Struct("<4siII4siIfII4x7dI")
_PACKED_GRID: Final = struct.Struct("<4siII4s7dI4x2dIIII7sxIB3xI")
_GRID_CELLS: Final = struct.Struct("<4siII4sffI")
_PATH: Final = struct.Struct("<4siII4sI")
_COUNT: Final = struct.Struct("<I")
_CELL: Final = struct.Struct("<ii")
_RATING: Final = struct.Struct("<ddiid")
_FLAG: Final = struct.Struct("<?")
_DRAW: Final = struct.Struct("<Q")
_PROFILE: Final = struct.Struct("<4siII4s5q")
_TIME: Final = struct.Struct("<4siIB")

_FIRST_POINT: Final = 36  # of GridCells: the fixed part and 4 bytes of padding
_FIRST_POSE: Final = 28  # of Path: likewise, if the padding stood before the first header
_POSES: Final = np.dtype([("header", "S16"), ("point", "<f8", 3), ("turn", "<f8", 4)])


def pack_transform(stamp: Stamp, x: float, y: float) -> bytes:
    """tf2_msgs/TFMessage: ``base_link`` in ``map``, not turned."""
    return _TRANSFORMS.pack(_CDR, 1, *stamp, *_MAP, *_BASE_LINK, x, y, 0.0, *_NO_TURN)


def pack_pose(stamp: Stamp, x: float, y: float) -> bytes:
    """geometry_msgs/PoseStamped in ``map``, not turned."""
    return _POSE.pack(_CDR, *stamp, *_MAP, x, y, 0.0, *_NO_TURN)


def unpack_pose(data: Buffer) -> tuple[float, float]:
    """The x and y of `pack_pose`."""
    x, y, *_ = _unpack(_POSE, data)
    return x, y


def pack_scan(stamp: Stamp, scan: Scan) -> bytes:
    """sensor_msgs/LaserScan in ``base_link``."""
    *numbers, ranges = scan
    fixed = _SCAN.pack(_CDR, *stamp, *_BASE_LINK, *numbers, len(ranges))
    return fixed + ranges.astype("<f4").tobytes() + _COUNT.pack(0)


def unpack_ranges(data: Buffer) -> npt.NDArray[np.float32]:
    """The ranges of `pack_scan`."""
    *_, count = _unpack(_SCAN, data, _BASE_LINK)
    return _array(data, "<f4", count, _SCAN.size)


def pack_grid(stamp: Stamp, load_time: Stamp, info: GridInfo, cells: npt.NDArray[np.int8]) -> bytes:
    """nav_msgs/OccupancyGrid in ``map``; `cells` is int8[height, width]."""
    resolution, width, height, x, y = info
    fixed = _GRID.pack(
        _CDR, *stamp, *_MAP, *load_time, resolution, width, height, x, y, 0.0, *_NO_TURN, cells.size
    )
    return fixed + cells.tobytes()


def unpack_grid(data: Buffer) -> tuple[GridInfo, npt.NDArray[np.int8]]:
    """Where the grid of `pack_grid` lies, and its cells, int8[height, width]."""
    _, _, resolution, width, height, x, y, *_, count = _unpack(_GRID, data)
    cells = _array(data, "i1", count, _GRID.size).reshape(height, width)
    return GridInfo(resolution, width, height, x, y), cells


def pack_packed_grid(
    stamp: Stamp, info: GridInfo, field_type: int, cells: npt.NDArray[Any]
) -> bytes:
    """foxglove_msgs/Grid in ``map`` with the field ``p_wall``.

    `cells` is little-endian and [height, width]; `field_type` is PackedElementField's.
    """
    resolution, width, _, x, y = info
    size = cells.itemsize
    fixed = _PACKED_GRID.pack(
        _CDR, *stamp, *_MAP, x, y, 0.0, *_NO_TURN, width, resolution, resolution,
        width * size, size, 1, 7, b"p_wall\0", 0, field_type, cells.nbytes,
    )  # fmt: skip
    return fixed + cells.tobytes()


def unpack_packed_grid(data: Buffer) -> PackedGrid:
    """The cells of `pack_packed_grid`."""
    values = _unpack(_PACKED_GRID, data)
    width, (fields, length, name, _, field_type, size) = values[7], values[12:]
    if (fields, length, name) != (1, 7, b"p_wall\0"):
        raise ValueError("a packed grid without the field p_wall")
    return PackedGrid(field_type, width, _array(data, "u1", size, _PACKED_GRID.size))


def pack_grid_cells(stamp: Stamp, resolution: float, points: Points) -> bytes:
    """nav_msgs/GridCells in ``map``."""
    fixed = _GRID_CELLS.pack(_CDR, *stamp, *_MAP, resolution, resolution, len(points))
    if not len(points):
        return fixed
    return fixed + bytes(4) + points.astype("<f8").tobytes()


def unpack_grid_cells(data: Buffer) -> Points:
    """The points of `pack_grid_cells`."""
    *_, count = _unpack(_GRID_CELLS, data)
    if not count:
        return np.empty((0, 3))
    return _array(data, "<f8", 3 * count, _FIRST_POINT).reshape(-1, 3)


def pack_path(stamp: Stamp, points: Points) -> bytes:
    """nav_msgs/Path in ``map``: poses that are not turned, all of the same stamp."""
    fixed = _PATH.pack(_CDR, *stamp, *_MAP, len(points))
    if not len(points):
        return fixed
    header = _HEADER.pack(_CDR, *stamp, *_MAP)[len(_CDR) :]
    poses = np.empty(len(points), _POSES)
    poses["header"] = header
    poses["point"] = points
    poses["turn"] = _NO_TURN
    # Only the first pose needs padding, and that comes after its header.
    return fixed + header + bytes(4) + poses.tobytes()[len(header) :]


def unpack_path(data: Buffer) -> Points:
    """The points of `pack_path`."""
    *_, count = _unpack(_PATH, data)
    if not count:
        return np.empty((0, 3))
    points: Points = _array(data, _POSES, count, _FIRST_POSE)["point"]
    return points


def pack_decision(stamp: Stamp, choice: Choice) -> bytes:
    """mapreplay_msgs/Decision."""
    message = _Packer(stamp)
    message.text(choice.mode)
    message.rated(choice.chosen)
    message.add(4, _COUNT, len(choice.rivals))
    for rival in choice.rivals:
        message.rated(rival)
    message.add(1, _FLAG, choice.is_random)
    message.add(8, _DRAW, choice.random_draw)
    return bytes(message.data)


def unpack_decision(data: Buffer) -> Choice:
    """The inverse of `pack_decision`."""
    message = _Unpacker(data)
    mode, chosen = message.text(), message.rated()
    (count,) = message.take(4, _COUNT)
    rivals = [message.rated() for _ in range(count)]
    (is_random,) = message.take(1, _FLAG)
    (draw,) = message.take(8, _DRAW)
    return Choice(mode, chosen, rivals, is_random, draw)


def pack_metrics(stamp: Stamp, outcome: str, scores: Sequence[float]) -> bytes:
    """mapreplay_msgs/StepMetrics; `scores` are its float64 fields, in order."""
    message = _Packer(stamp)
    message.text(outcome)
    message.add(8, struct.Struct(f"<{len(scores)}d"), *scores)
    return bytes(message.data)


def unpack_metrics(data: Buffer, count: int) -> tuple[str, tuple[float, ...]]:
    """The outcome and the `count` scores of `pack_metrics`."""
    message = _Unpacker(data)
    return message.text(), message.take(8, struct.Struct(f"<{count}d"))


def pack_profile(stamp: Stamp, nanoseconds: Sequence[int]) -> bytes:
    """mapreplay_msgs/StepProfile."""
    return _PROFILE.pack(_CDR, *stamp, *_MAP, *nanoseconds)


def unpack_profile(data: Buffer) -> tuple[int, ...]:
    """The nanoseconds of `pack_profile`."""
    return _unpack(_PROFILE, data)


def pack_log(stamp: Stamp, line: LogLine) -> bytes:
    """rcl_interfaces/Log."""
    message = _Packer(stamp)
    message.data[:] = _TIME.pack(_CDR, *stamp, line.level)
    for text in (line.name, line.text, "", ""):
        message.text(text)
    message.add(4, _COUNT, 0)
    return bytes(message.data)


def unpack_log(data: Buffer) -> LogLine:
    """The inverse of `pack_log`."""
    level = _TIME.unpack_from(data)[-1]
    message = _Unpacker(data, _TIME.size)
    return LogLine(level, message.text(), message.text())


class _Packer:
    """A message with a header in ``map`` whose other fields may begin anywhere."""

    def __init__(self, stamp: Stamp) -> None:
        self.data = bytearray(_HEADER.pack(_CDR, *stamp, *_MAP))

    def add(self, alignment: int, layout: struct.Struct, *values: float) -> None:
        """Values of one layout, the first of which is aligned."""
        self.data += bytes(-(len(self.data) - len(_CDR)) % alignment) + layout.pack(*values)

    def text(self, text: str) -> None:
        """A string: its length with the final NUL, and its bytes."""
        encoded = text.encode() + b"\0"
        self.add(4, _COUNT, len(encoded))
        self.data += encoded

    def rated(self, rated: Rated) -> None:
        """A candidate; its float64 fields are aligned, its beginning need not be."""
        self.add(4, _CELL, *rated[:2])
        self.add(8, _RATING, *rated[2:])


class _Unpacker:
    """The inverse of `_Packer`."""

    def __init__(self, data: Buffer, position: int = _HEADER.size) -> None:
        if position == _HEADER.size:
            _unpack(_HEADER, data)
        self._data = data
        self.position = position

    def take(self, alignment: int, layout: struct.Struct) -> tuple[Any, ...]:
        """The next values of one layout."""
        self.position += -(self.position - len(_CDR)) % alignment
        values = layout.unpack_from(self._data, self.position)
        self.position += layout.size
        return values

    def text(self) -> str:
        """The next string."""
        (length,) = self.take(4, _COUNT)
        encoded = bytes(self._data[self.position : self.position + length])
        if len(encoded) != length or not encoded.endswith(b"\0"):
            raise ValueError("a string without an end")
        self.position += length
        return encoded[:-1].decode()

    def rated(self) -> Rated:
        """The next candidate."""
        return Rated(*self.take(4, _CELL), *self.take(8, _RATING))


def _unpack(
    layout: struct.Struct, data: Buffer, frame: tuple[int, bytes] = _MAP
) -> tuple[Any, ...]:
    """The values after the header.

    Raises:
        ValueError: this is not a message in `frame`, so that its fields lie elsewhere.
        struct.error: the message is too short.
    """
    values = layout.unpack_from(data)
    if values[0] != _CDR or values[3:5] != frame:
        raise ValueError(f"a message that is not in the frame {frame[1][:-1].decode()}")
    return values[5:]


def _array(data: Buffer, dtype: npt.DTypeLike, count: int, offset: int) -> npt.NDArray[Any]:
    """An array that owns its memory: a view would keep the whole chunk."""
    return np.frombuffer(data, dtype, count, offset).copy()
