"""HouseExpo floor plans: the paper's second dataset, D2.

One JSON file per house, with one polygon whose inside is free; interior walls are notches of
about 0.1 m. The polygon is rasterized at 80 px/m or finer, and a cell is free only if all
of it is free, because coarser rasterizing erases most interior walls.
"""

from __future__ import annotations

import json
import math
import re
import tarfile
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from mapreplay.errors import FloorPlanError, UsageError
from mapreplay.files.identify import identify, identify_file
from mapreplay.floorplan import FloorPlan
from mapreplay.floorplans.files import brief, existing_path, files_in, is_junk, read_limited
from mapreplay.grid import FREE, OCCUPIED, Grid, Origin

ENDING: Final = ".json"
PIXELS_PER_METRE: Final = 80
MAX_METRES: Final = 200.0
MIN_RESOLUTION: Final = 0.01
MAX_RESOLUTION: Final = 5.0
MAX_VERTICES: Final = 1_000_000
MAX_JSON_BYTES: Final = 16 << 20
MAX_MEMBERS: Final = 1_000_000
READ_AHEAD_BYTES: Final = 64 << 20
MARGIN: Final = 1
"""Occupied cells around the house's bounding box."""

_HOUSE_ID: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,127}")
_SUBPIXEL_BITS: Final = 6


@dataclass(frozen=True, eq=False)
class House:
    """The fields of a HouseExpo JSON file that are used."""

    id: str
    vertices: npt.NDArray[np.float64]
    """float64[n, 2]: x, y in metres, n >= 3."""


def parse_house(text: bytes, name: str) -> House:
    """Read one house; `name` is used in error messages.

    Raises:
        FloorPlanError: not JSON, keys missing, or coordinates that are not a house.
    """
    try:
        data = json.loads(text)
    except (ValueError, RecursionError) as error:
        reason = identify(text) or error
        raise FloorPlanError(f"{name}: not a JSON file ({reason})") from None
    if not isinstance(data, dict):
        raise FloorPlanError(f"{name}: expected a JSON object with 'id' and 'verts'")
    missing = [key for key in ("id", "verts") if key not in data]
    if missing:
        raise FloorPlanError(f"{name}: key {missing[0]!r} is missing")
    house_id = data["id"]
    if not isinstance(house_id, str) or not _HOUSE_ID.fullmatch(house_id):
        raise FloorPlanError(f"{name}: id {brief(house_id)} is not letters, digits and . _ -")
    verts = data["verts"]
    if not isinstance(verts, list) or not 3 <= len(verts) <= MAX_VERTICES:
        raise FloorPlanError(f"{name}: 'verts' must be a list of 3 to {MAX_VERTICES} points")
    for vert in verts:
        if not (isinstance(vert, list) and len(vert) == 2 and all(map(_is_metre, vert))):
            raise FloorPlanError(
                f"{name}: vertex {brief(vert)} is not two finite numbers of metres"
            )
    vertices = np.array(verts, np.float64)
    extent = float(np.ptp(vertices, axis=0).max())
    if extent > MAX_METRES:
        raise FloorPlanError(
            f"{name}: {extent:,.0f} m across; at most {MAX_METRES:g} m are "
            "allowed ('verts' are in metres)"
        )
    return House(house_id, vertices)


def _is_metre(value: object) -> bool:
    return (
        isinstance(value, (int, float))
        and not isinstance(value, bool)
        and abs(value) < 1e6  # False for NaN
    )


def rasterize(house: House, resolution: float) -> FloorPlan:
    """Cells of `resolution` metres; free only where the whole cell lies inside the polygon.

    The outside of the polygon is occupied. The inside of a polygon that crosses itself is
    defined by the even-odd rule.

    Raises:
        FloorPlanError: the house has no free cell, or too many cells.
    """
    per_cell = max(1, math.ceil(PIXELS_PER_METRE * resolution))
    low = house.vertices.min(axis=0)
    sides = np.ceil(np.ptp(house.vertices, axis=0) / resolution - 1e-9).astype(int)
    width, height = (int(n) + 2 * MARGIN for n in np.maximum(sides, 1))
    if max(width, height) * per_cell > PIXELS_PER_METRE * MAX_METRES + 64 * per_cell:
        raise FloorPlanError(
            f"house {house.id}: {height} x {width} cells of {resolution} m are too many"
        )
    origin = low - MARGIN * resolution
    fine = np.zeros((height * per_cell, width * per_cell), np.uint8)
    # OpenCV's pixel centres are at whole numbers, ours at halves.
    pixels = (house.vertices - origin) * (per_cell / resolution) - 0.5
    points = np.rint(pixels * (1 << _SUBPIXEL_BITS)).astype(np.int32)
    cv2.fillPoly(fine, [points], 1, lineType=cv2.LINE_8, shift=_SUBPIXEL_BITS)
    inside = fine.reshape(height, per_cell, width, per_cell).min(axis=(1, 3)).astype(bool)
    cells: Grid = np.where(inside, np.int8(FREE), np.int8(OCCUPIED))
    try:
        return FloorPlan(house.id, cells, resolution, Origin(float(origin[0]), float(origin[1])))
    except FloorPlanError as error:
        sides = " x ".join(f"{side:.3g}" for side in np.ptp(house.vertices, axis=0))
        raise FloorPlanError(
            f"house {house.id}: {str(error).partition(': ')[2]}; it has {sides} m, and a cell "
            f"{resolution:g} m"
        ) from None


class HouseExpoSource:
    """HouseExpo houses in a ``.tar.gz``, a folder of JSON files, or one JSON file."""

    default_predictor = "d2"

    def __init__(self, path: Path, resolution: float = 0.2) -> None:
        """`resolution` is in metres per cell.

        Raises:
            UsageError: `resolution` is out of range.
        """
        if not MIN_RESOLUTION <= resolution <= MAX_RESOLUTION:
            raise UsageError(
                f"houseexpo: resolution {resolution} must be {MIN_RESOLUTION:g} to "
                f"{MAX_RESOLUTION:g} metres per cell"
            )
        self._path = path
        self._resolution = resolution
        self._ids: list[str] | None = None
        self._files: dict[str, Path] | None = None
        self._texts: dict[str, bytes] = {}

    def ids(self) -> Sequence[str]:
        """The names of the JSON files, without ending, in the order of the archive (sorted in
        a folder).

        Raises:
            FloorPlanError: the file or folder cannot be read.
        """
        if self._ids is None:
            self._ids = [house_id for house_id, _ in self._members(with_text=False)]
            if not self._ids:
                what = None if self._path.is_dir() else _no_archive(self._path)
                raise FloorPlanError(
                    f"{self._path}: holds no JSON file" + (f" ({what})" if what else "")
                )
        return self._ids

    def load(self, floor_plan_id: str) -> FloorPlan:
        """Read and rasterize one house.

        An archive can only be read from its start, so one pass also keeps the texts of the
        houses that follow in `ids()`, up to 64 MB.

        Raises:
            FloorPlanError: there is no such house, or it is refused.
        """
        text = self._texts.pop(floor_plan_id, None)
        if text is None:
            text = self._read_from(floor_plan_id)
        name = f"{self._path}: house {floor_plan_id}"
        # The file's name counts: an id list means that, whatever a copied file says inside.
        house = replace(parse_house(text, name), id=floor_plan_id)
        try:
            return replace(rasterize(house, self._resolution), file=name)
        except FloorPlanError as error:
            raise FloorPlanError(f"{self._path}: {error}") from None

    def _read_from(self, floor_plan_id: str) -> bytes:
        if not _HOUSE_ID.fullmatch(floor_plan_id):
            raise FloorPlanError(f"{self._path}: holds no house {floor_plan_id[:40]!r}")
        if self._path.is_dir():
            path = self._in_folder().get(floor_plan_id)
            if path is None:
                raise FloorPlanError(f"{self._path}: holds no house {floor_plan_id}")
            return read_limited(path, MAX_JSON_BYTES)
        found: bytes | None = None
        size = 0
        self._texts = {}
        for house_id, text in self._members(with_text=True):
            if house_id == floor_plan_id:
                found = text
            elif found is not None:
                self._texts[house_id] = text
                size += len(text)
                if size > READ_AHEAD_BYTES:
                    break
        if found is None:
            raise FloorPlanError(f"{self._path}: holds no house {floor_plan_id}")
        return found

    def _in_folder(self) -> dict[str, Path]:
        """The houses of a folder by ID; the first of two that differ in the case of the ending."""
        if self._files is None:
            self._files = {path.stem: path for path in reversed(find_houses(self._path))}
        return self._files

    def _members(self, *, with_text: bool) -> Iterator[tuple[str, bytes]]:
        if self._path.is_dir():
            for house_id, path in sorted(self._in_folder().items()):
                yield house_id, read_limited(path, MAX_JSON_BYTES) if with_text else b""
        elif self._path.suffix.lower() == ENDING:
            yield self._path.stem, read_limited(self._path, MAX_JSON_BYTES) if with_text else b""
        else:
            yield from _archive_members(self._path, with_text=with_text)


class _CheckedHeader(tarfile.TarInfo):
    """A tar header that is checked while it is read.

    `tarfile` loads long names and extended headers of an archive into memory, whatever their
    declared size.
    """

    @classmethod
    def frombuf(cls, buf: bytes | bytearray, encoding: str, errors: str) -> _CheckedHeader:
        """As in `tarfile.TarInfo`.

        Raises:
            FloorPlanError: the file that follows is too large.
            ReadError: the archive ends here, without the blocks that end one.
        """
        if len(buf) < tarfile.BLOCKSIZE:  # which `tarfile` would take for the end
            raise tarfile.ReadError("it is cut off; copy it again")
        header = super().frombuf(buf, encoding, errors)
        if header.size > MAX_JSON_BYTES:
            raise FloorPlanError(f"{header.name[:80]!r} is larger than {MAX_JSON_BYTES >> 20} MiB")
        return header


def _archive_members(path: Path, *, with_text: bool) -> Iterator[tuple[str, bytes]]:
    """The JSON files of a tar archive, streamed: nothing is ever written to disk.

    If two have the same name, the first counts.
    """
    seen: set[str] = set()
    try:
        with tarfile.open(path, "r|*", tarinfo=_CheckedHeader) as archive:
            for count, member in enumerate(archive):
                inner = PurePosixPath(member.name)
                if inner.is_absolute() or ".." in inner.parts:
                    raise FloorPlanError(f"it holds the name {member.name[:80]!r}")
                if count >= MAX_MEMBERS:
                    raise FloorPlanError(f"it holds over {MAX_MEMBERS} files")
                if not member.isfile() or inner.suffix.lower() != ENDING or inner.stem in seen:
                    continue
                if is_junk(inner):
                    continue
                seen.add(inner.stem)
                stream = archive.extractfile(member) if with_text else None
                yield inner.stem, stream.read() if stream else b""
    except FloorPlanError as error:
        raise FloorPlanError(f"{path}: refused, {error}") from None
    except (tarfile.TarError, EOFError, zlib.error, OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        reason = _no_archive(path) or reason
        raise FloorPlanError(f"{path}: not a readable tar archive ({reason})") from None


def _no_archive(path: Path) -> str | None:
    """What `path` is, if it does not start like a readable archive."""
    what = identify_file(path)
    readable = what is None or "-compressed" in what or "tar archive" in what
    return None if readable else what


def find_houses(folder: Path) -> list[Path]:
    """The JSON files in `folder`, not below, sorted; without hidden ones.

    Raises:
        FloorPlanError: the folder cannot be read.
    """
    return files_in(folder, (ENDING,))


def open_source(rest: str, resolution: float | None) -> HouseExpoSource:
    """The source ``houseexpo``; see `mapreplay.plugins.PluginKind.FLOORPLANS`.

    Raises:
        UsageError: no path, or a resolution that is out of range.
        FloorPlanError: there is no such file or folder.
    """
    path = existing_path("houseexpo", rest)
    return HouseExpoSource(path, 0.2 if resolution is None else resolution)
