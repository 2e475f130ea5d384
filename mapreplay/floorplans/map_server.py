"""ROS ``map_server`` maps: a YAML file that names an image, and how to read it.

The modes are those of Nav2's ``nav2_map_server`` (``map_io.cpp``), reduced to the three
values that our cells have: what lies between the two thresholds is unknown in every mode.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from ruamel.yaml import YAML

from mapreplay.errors import FloorPlanError, UsageError
from mapreplay.floorplan import FloorPlan
from mapreplay.floorplans.files import brief, existing_path, read_limited, unique_ids
from mapreplay.floorplans.pixels import OPAQUE, Pixels, read_pixels
from mapreplay.grid import FREE, OCCUPIED, UNKNOWN, Grid, Origin

ENDINGS: Final = (".yaml", ".yml")
MAX_YAML_BYTES: Final = 64 << 10
REQUIRED: Final = ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh")

_IMAGE_KEY: Final = re.compile(rb"^image\s*:", re.MULTILINE)


@dataclass(frozen=True)
class GreyThresholds:
    """Occupied above `occupied`, free below `free`, unknown between and at them; 0 to 1."""

    occupied: float = 0.65
    free: float = 0.196


@dataclass(frozen=True)
class MapFile:
    """What a map_server YAML file says."""

    image: Path
    resolution: float
    """Metres a cell."""
    origin: Origin
    negate: bool
    """White is occupied."""
    thresholds: GreyThresholds
    mode: str
    """A key of `MODES`."""


def _trinary(pixels: Pixels, negate: bool, thresholds: GreyThresholds) -> Grid:  # noqa: FBT001
    """An alpha channel counts as one more colour, as in Nav2 and in ROS 1 before it."""
    channels = pixels.colour
    if pixels.alpha is not None:
        grey_or_colour = np.broadcast_to(channels, (*channels.shape[:2], 3))
        channels = np.concatenate([grey_or_colour, pixels.alpha[..., None]], axis=2)
    return _threshold(_darkness(channels, negate=negate), thresholds)


def _scale(pixels: Pixels, negate: bool, thresholds: GreyThresholds) -> Grid:  # noqa: FBT001
    """What is not opaque is unknown."""
    cells = _threshold(_darkness(pixels.colour, negate=negate), thresholds)
    if pixels.alpha is not None:
        cells[pixels.alpha != OPAQUE] = UNKNOWN
    return cells


def _raw(pixels: Pixels, negate: bool, thresholds: GreyThresholds) -> Grid:  # noqa: ARG001, FBT001
    """Pixels are percentages; above 100 they are unknown. Nothing is negated."""
    percent = np.floor(_brightness(pixels.colour) * 255 + 0.5)
    cells = _threshold(percent / 100, thresholds)
    cells[percent > 100] = UNKNOWN
    return cells


MODES: Final[Mapping[str, Callable[[Pixels, bool, GreyThresholds], Grid]]] = {
    "trinary": _trinary,
    "scale": _scale,
    "raw": _raw,
}
"""What turns pixels into cells, by the YAML's ``mode``."""


def _brightness(channels: npt.NDArray[np.uint8]) -> npt.NDArray[np.float64]:
    """float64[H, W], 0 to 1: the mean of the channels."""
    sums: npt.NDArray[np.int64] = channels.sum(axis=2, dtype=np.int64)
    mean: npt.NDArray[np.float64] = sums / (255 * channels.shape[2])
    return mean


def _darkness(channels: npt.NDArray[np.uint8], *, negate: bool) -> npt.NDArray[np.float64]:
    """P(occupied), float64[H, W]. Inverted as integers, so that thresholds are met exactly."""
    return _brightness(channels if negate else OPAQUE - channels)


def _threshold(p_occupied: npt.NDArray[np.float64], thresholds: GreyThresholds) -> Grid:
    cells = np.full(p_occupied.shape, UNKNOWN, np.int8)
    cells[p_occupied < thresholds.free] = FREE
    cells[p_occupied > thresholds.occupied] = OCCUPIED
    return cells


def to_cells(
    pixels: Pixels,
    mode: str = "trinary",
    thresholds: GreyThresholds = GreyThresholds(),
    *,
    negate: bool = False,
) -> Grid:
    """int8[H, W] of -1, 0 and 100 from an image, by one of `MODES`."""
    return MODES[mode](pixels, negate, thresholds)


def read_map_file(path: Path) -> MapFile:
    """Read and check a map_server YAML file.

    Raises:
        FloorPlanError: it cannot be read, or a key is missing or makes no sense.
    """
    data = _parse_yaml(read_limited(path, MAX_YAML_BYTES), path)
    if not isinstance(data, dict):
        raise FloorPlanError(f"{path}: not a map_server YAML file; expected keys and values")
    missing = [key for key in REQUIRED if key not in data]
    if missing:
        raise FloorPlanError(
            f"{path}: not a complete map_server YAML file, key {missing[0]!r} is missing"
        )
    image = data["image"]
    if not isinstance(image, str) or not image:
        raise _bad(path, "image", image, "the path of a PNG or PGM file")
    resolution = _number(path, data, "resolution")
    if resolution <= 0:
        raise _bad(path, "resolution", resolution, "a positive number of metres a cell")
    mode = data.get("mode", "trinary")
    if not isinstance(mode, str) or mode not in MODES:
        raise _bad(path, "mode", mode, f"one of {', '.join(MODES)}")
    negate = data["negate"]
    if not isinstance(negate, (bool, int)) or negate not in (0, 1):
        raise _bad(path, "negate", negate, "0 or 1")
    thresholds = GreyThresholds(
        occupied=_number(path, data, "occupied_thresh"), free=_number(path, data, "free_thresh")
    )
    if not 0 <= thresholds.free <= thresholds.occupied <= 1:
        raise FloorPlanError(
            f"{path}: free_thresh {thresholds.free:g} and occupied_thresh "
            f"{thresholds.occupied:g}: expected 0 <= free_thresh <= occupied_thresh <= 1"
        )
    return MapFile(
        image=path.parent / image,
        resolution=resolution,
        origin=_origin(path, data["origin"]),
        negate=bool(negate),
        thresholds=thresholds,
        mode=mode,
    )


def _parse_yaml(content: bytes, path: Path) -> Any:
    try:
        return YAML(typ="safe", pure=True).load(content.decode())
    except Exception as error:  # odd tags make the parser fail with more than its own errors
        reason = str(getattr(error, "problem", None) or error).splitlines() or ["no reason given"]
        raise FloorPlanError(f"{path}: not a YAML file ({reason[0][:100]})") from error


def _bad(path: Path, key: str, value: object, expected: str) -> FloorPlanError:
    return FloorPlanError(f"{path}: {key} is {brief(value)}; expected {expected}")


def _is_number(value: object) -> bool:
    return (
        isinstance(value, (int, float))
        and not isinstance(value, bool)
        and abs(value) < 1e9  # False for NaN
    )


def _number(path: Path, data: Mapping[str, Any], key: str) -> float:
    if not _is_number(data[key]):
        raise _bad(path, key, data[key], "a finite number")
    return float(data[key])


def _origin(path: Path, value: Any) -> Origin:
    if not (isinstance(value, list) and len(value) == 3 and all(map(_is_number, value))):
        raise _bad(path, "origin", value, "three finite numbers: x, y, yaw")
    x, y, yaw = map(float, value)
    if yaw != 0:
        raise FloorPlanError(
            f"{path}: origin has a yaw of {yaw:g} rad; turned maps are not supported, rotate "
            "the image and set it to 0"
        )
    return Origin(x, y)


class MapServerSource:
    """The maps of one YAML file, or of all in a folder and its subfolders."""

    default_predictor = "d2"

    def __init__(self, path: Path) -> None:
        self._path = path
        self._files: dict[str, Path] | None = None

    def ids(self) -> Sequence[str]:
        """The YAML files' names without ending, or their folders' if that is ``map``.

        Sorted by path; characters that are illegal in an id become ``-``, and of two equal
        ids the second gets ``-2``.

        Raises:
            FloorPlanError: the folder holds no map.
        """
        return list(self._by_id())

    def load(self, floor_plan_id: str) -> FloorPlan:
        """Read one map.

        Raises:
            FloorPlanError: there is no such map, or it is refused.
        """
        path = self._by_id().get(floor_plan_id)
        if path is None:
            raise FloorPlanError(f"{self._path}: holds no map {floor_plan_id}")
        file = read_map_file(path)
        cells = to_cells(read_pixels(file.image), file.mode, file.thresholds, negate=file.negate)
        return FloorPlan(floor_plan_id, cells, file.resolution, file.origin)

    def _by_id(self) -> dict[str, Path]:
        if self._files is None:
            paths = find_maps(self._path) if self._path.is_dir() else [self._path]
            if not paths:
                raise FloorPlanError(f"{self._path}: holds no YAML file with an 'image'")
            self._files = dict(zip(unique_ids(map(_name, paths)), paths, strict=True))
        return self._files


def _name(path: Path) -> str:
    return path.absolute().parent.name if path.stem == "map" else path.stem


def find_maps(folder: Path) -> list[Path]:
    """The YAML files in `folder` and below that have a key ``image``, sorted.

    A file with that key that is not YAML is listed too, so that loading it says what is
    wrong; one that is not about a map is passed over.
    """
    paths = (path for path in folder.rglob("*") if path.suffix.lower() in ENDINGS)
    return [path for path in sorted(paths) if _names_an_image(path)]


def _names_an_image(path: Path) -> bool:
    try:
        content = read_limited(path, MAX_YAML_BYTES)
    except FloorPlanError:
        return False
    if b"image" not in content:  # spares the slow parser
        return False
    try:
        data = _parse_yaml(content, path)
    except FloorPlanError:
        return _IMAGE_KEY.search(content) is not None
    return isinstance(data, dict) and isinstance(data.get("image"), str)


def open_source(rest: str, resolution: float | None) -> MapServerSource:
    """The source ``map_server``; see `mapreplay.plugins.Group.FLOORPLANS`.

    Raises:
        UsageError: no path, or a resolution was asked for.
        FloorPlanError: there is no such file or folder.
    """
    if resolution is not None:
        raise UsageError(
            f"a map_server map has the resolution that its YAML file says, not {resolution}"
        )
    return MapServerSource(existing_path("map_server", rest))
