"""ROS ``map_server`` maps: a YAML file that names an image, and how to read it."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path, PureWindowsPath
from typing import Any, Final

from ruamel.yaml import YAML
from ruamel.yaml.events import (
    AliasEvent,
    CollectionEndEvent,
    CollectionStartEvent,
    Event,
    MappingStartEvent,
    NodeEvent,
    ScalarEvent,
)

from mapreplay.errors import FloorPlanError, UsageError
from mapreplay.files.identify import identify
from mapreplay.floorplan import Doubt, FloorPlan
from mapreplay.floorplans.files import (
    brief,
    existing_path,
    exists,
    files_in,
    folders_in,
    is_link,
    read_limited,
    unique_ids,
)
from mapreplay.floorplans.greys import (
    MODES,
    NO_OPTIONS,
    GreyOptions,
    GreyRule,
    GreyThresholds,
    split_options,
)
from mapreplay.floorplans.pixels import read_pixels
from mapreplay.floorplans.reading import Where, plan_of
from mapreplay.grid import Origin

ENDINGS: Final = (".yaml", ".yml")
MAX_YAML_BYTES: Final = 64 << 10
_MAX_SHOWN: Final = 200
MAX_DEPTH: Final = 20
MAX_EVENTS: Final = 5000
REQUIRED: Final = ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh")

_IMAGE_KEY: Final = re.compile(rb"^image\s*:", re.MULTILINE)


@dataclass(frozen=True)
class MapFile:
    """The content of a map_server YAML file."""

    image: str
    """As written in the file."""
    resolution: float
    """Metres per cell."""
    origin: Origin
    rule: GreyRule


def read_map_file(path: Path) -> MapFile:
    """Read and check a map_server YAML file.

    Raises:
        FloorPlanError: it cannot be read, or a key is missing or invalid.
    """
    content = read_limited(path, MAX_YAML_BYTES)
    data = _parse_yaml(content, path)
    if not isinstance(data, dict):
        what = identify(content) or "expected keys and values"
        raise FloorPlanError(f"{path}: not a map_server YAML file; {what}")
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
        raise _bad(path, "resolution", resolution, "a positive number of metres per cell")
    mode = data.get("mode", "trinary")
    if not isinstance(mode, str) or mode.lower() not in MODES:
        raise _bad(path, "mode", mode, f"one of {', '.join(MODES)}")
    negate = data["negate"]
    if not isinstance(negate, (bool, int)) or negate not in (0, 1):
        raise _bad(path, "negate", negate, "0 or 1")
    occupied, free = _number(path, data, "occupied_thresh"), _number(path, data, "free_thresh")
    try:
        thresholds = GreyThresholds(occupied, free)
    except ValueError as error:
        raise FloorPlanError(f"{path}: {error}") from None
    return MapFile(
        image=image,
        resolution=resolution,
        origin=_origin(path, data["origin"]),
        rule=GreyRule(mode.lower(), thresholds, bool(negate)),
    )


def _parse_yaml(content: bytes, path: Path) -> Any:
    try:
        text = content.decode("utf-8-sig")
        for _ in _events(text):
            pass  # refuse what makes a small file a large value, before any value is made
        return YAML(typ="safe", pure=True).load(text)
    except Exception as error:  # odd tags make the parser fail with more than its own errors
        reason = str(getattr(error, "problem", None) or error).splitlines() or ["no reason given"]
        what = identify(content) or reason[0][:100]
        raise FloorPlanError(f"{path}: not a YAML file of a map ({what})") from error


def _events(text: str) -> Iterator[Event]:
    """The events of a YAML text; no value is constructed.

    Raises:
        ValueError: its value could be huge: it has aliases, or is nested too deeply or too
            long.
        YAMLError: it is not YAML.
    """
    depth = 0
    for count, event in enumerate(YAML(typ="safe", pure=True).parse(text)):
        if isinstance(event, AliasEvent) or (isinstance(event, NodeEvent) and event.anchor):
            raise ValueError("it has anchors or aliases (& and *); write the values themselves")
        if getattr(event, "value", None) == "<<":
            raise ValueError("it merges mappings (<<); write the keys themselves")
        depth += isinstance(event, CollectionStartEvent) - isinstance(event, CollectionEndEvent)
        if depth > MAX_DEPTH:
            raise ValueError(f"it is nested more than {MAX_DEPTH} deep")
        if count > MAX_EVENTS:
            raise ValueError(f"it has more than {MAX_EVENTS} values and marks")
        yield event


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
            f"{path}: origin has a yaw of {yaw:g} rad; rotated maps are not supported; rotate "
            "the image and set it to 0"
        )
    return Origin(x, y)


class MapServerSource:
    """The maps of one YAML file, or of all in a folder and its subfolders."""

    default_predictor = "d2"

    def __init__(self, path: Path, options: GreyOptions = NO_OPTIONS) -> None:
        """`options` override the YAML files."""
        self._path = path
        self._options = options
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
        image, doubts = find_image(path, file.image)
        try:
            rule = self._options.applied_to(file.rule)
            pixels = read_pixels(image)
        except ValueError as error:
            raise FloorPlanError(f"{path}: {error}") from None
        except FloorPlanError as error:
            raise FloorPlanError(f"{path}: its image {error}") from None
        where = Where(path, str(self._path))
        return plan_of(
            floor_plan_id,
            pixels,
            rule,
            file.resolution,
            where,
            origin=file.origin,
            doubts=doubts,
        )

    def _by_id(self) -> dict[str, Path]:
        if self._files is None:
            paths = find_maps(self._path) if self._path.is_dir() else [self._path]
            if not paths:
                raise FloorPlanError(f"{self._path}: holds no YAML file with an 'image'")
            self._files = dict(zip(unique_ids(map(_name, paths)), paths, strict=True))
        return self._files


def find_image(path: Path, image: str) -> tuple[Path, tuple[Doubt, ...]]:
    """The image file of the YAML file `path`, and doubts about it.

    If it does not exist, a file of the same name next to the YAML file is used, because maps are
    copied between machines, some of which ignore the case of names.

    Raises:
        FloorPlanError: neither of them exists.
    """
    meant = path.parent / image
    if exists(meant) or is_link(meant):
        return meant, ()
    name = PureWindowsPath(image).name  # what is behind the last / or backslash
    beside = _no_yaml(path.parent)
    shown = image if len(image) <= _MAX_SHOWN else brief(image)
    same = [file for file in beside if file.name == name]
    same += [file for file in beside if file.name.lower() == name.lower()]
    if same:
        text = f"its image {shown} is not there; {same[0].name} next to it was taken"
        return same[0], (Doubt("another image", text),)
    stem = PureWindowsPath(name).stem.lower()
    folders = [*folders_in(path.parent), path.absolute().parent.parent]
    near = (file for folder in folders for file in _no_yaml(folder))
    alike = next((file for file in chain(beside, near) if file.stem.lower() == stem), None)
    hint = "copy it next to the YAML file"
    if alike is not None:
        hint = f"is it {os.path.relpath(alike, path.parent)}?"
    raise FloorPlanError(f"{path}: its image {shown} is not there; {hint}")


def _no_yaml(folder: Path) -> list[Path]:
    """The files in `folder` that may be images."""
    return [file for file in files_in(folder) if file.suffix.lower() not in ENDINGS]


def _name(path: Path) -> str:
    return path.absolute().parent.name if path.stem == "map" else path.stem


def find_maps(folder: Path) -> list[Path]:
    """The YAML files in `folder` and below that have a key ``image``, sorted; no hidden ones.

    Invalid YAML files with that key are listed too, so that loading them reports the error;
    other YAML files are skipped.

    Raises:
        FloorPlanError: the folder cannot be read.
    """
    return [path for path in files_in(folder, ENDINGS, below=True) if _names_an_image(path)]


def _names_an_image(path: Path) -> bool:
    try:
        content = read_limited(path, MAX_YAML_BYTES)
    except FloorPlanError:
        return False
    if b"image" not in content:  # spares the slow parser
        return False
    try:
        return _has_image_key(content.decode("utf-8-sig"))
    except Exception:  # noqa: BLE001 (odd tags make the parser fail with more than its own errors)
        return _IMAGE_KEY.search(content) is not None


def _has_image_key(text: str) -> bool:
    """Whether the YAML `text` is a mapping with a key ``image`` that is a scalar.

    Raises:
        ValueError: see `_events`, as far as the text was read: only up to that key.
        YAMLError: it is not YAML.
    """
    depth, is_key, key = 0, True, ""
    for event in _events(text):
        depth -= isinstance(event, CollectionEndEvent)
        if depth == 0 and isinstance(event, NodeEvent) and not isinstance(event, MappingStartEvent):
            return False
        if depth == 1 and isinstance(event, (NodeEvent, CollectionEndEvent)):
            if not is_key and key == "image":
                return isinstance(event, ScalarEvent)
            if not isinstance(event, CollectionStartEvent):
                key = getattr(event, "value", "") if is_key else ""
                is_key = not is_key
        depth += isinstance(event, CollectionStartEvent)
    return False


def open_source(rest: str, resolution: float | None) -> MapServerSource:
    """The source ``map_server``; see `mapreplay.plugins.PluginKind.FLOORPLANS`.

    Raises:
        UsageError: no path, a resolution was given, or invalid options.
        FloorPlanError: there is no such file or folder.
    """
    name, options = split_options(rest)
    if resolution is not None:
        raise UsageError(
            f"the resolution of a map_server map is set by its YAML file, not {resolution}"
        )
    return MapServerSource(existing_path("map_server", name), options)
