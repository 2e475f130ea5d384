"""Plain PNG and PGM images: dark is occupied, light is free, mid grey and clear are unknown."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from mapreplay.errors import FloorPlanError, UsageError
from mapreplay.floorplan import FloorPlan
from mapreplay.floorplans.files import existing_path, unique_ids
from mapreplay.floorplans.map_server import to_cells
from mapreplay.floorplans.pixels import read_pixels

ENDINGS: Final = (".png", ".pgm")
DEFAULT_RESOLUTION: Final = 0.05
"""Metres a pixel, the usual one of maps that robots save."""


class ImageSource:
    """One image, or all in a folder; with the thresholds that are map_server's defaults."""

    default_predictor = "d2"

    def __init__(self, path: Path, resolution: float = DEFAULT_RESOLUTION) -> None:
        """`resolution` is in metres a pixel.

        Raises:
            UsageError: `resolution` is not a positive number.
        """
        if not (math.isfinite(resolution) and resolution > 0):
            raise UsageError(f"resolution {resolution} must be a positive number of metres a cell")
        self._path = path
        self._resolution = resolution
        self._files: dict[str, Path] | None = None

    def ids(self) -> Sequence[str]:
        """The images' names without ending, sorted by path; made legal and unique.

        Raises:
            FloorPlanError: the folder holds no image.
        """
        return list(self._by_id())

    def load(self, floor_plan_id: str) -> FloorPlan:
        """Read one image.

        Raises:
            FloorPlanError: there is no such image, or it is refused.
        """
        path = self._by_id().get(floor_plan_id)
        if path is None:
            raise FloorPlanError(f"{self._path}: holds no image {floor_plan_id}")
        cells = to_cells(read_pixels(path), "scale")
        return FloorPlan(floor_plan_id, cells, self._resolution)

    def _by_id(self) -> dict[str, Path]:
        if self._files is None:
            paths = find_images(self._path) if self._path.is_dir() else [self._path]
            if not paths:
                raise FloorPlanError(f"{self._path}: holds no {' or '.join(ENDINGS)} image")
            names = (path.stem for path in paths)
            self._files = dict(zip(unique_ids(names), paths, strict=True))
        return self._files


def find_images(folder: Path) -> list[Path]:
    """The PNG and PGM files in `folder`, not below, sorted."""
    return sorted(path for path in folder.iterdir() if path.suffix.lower() in ENDINGS)


def open_source(rest: str, resolution: float | None) -> ImageSource:
    """The source ``image``; see `mapreplay.plugins.Group.FLOORPLANS`.

    Raises:
        UsageError: no path, or a resolution that is not a positive number.
        FloorPlanError: there is no such file or folder.
    """
    path = existing_path("image", rest)
    return ImageSource(path, DEFAULT_RESOLUTION if resolution is None else resolution)
