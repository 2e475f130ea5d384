"""Plain PNG and PGM images: dark is occupied, light is free, mid grey and transparent are unknown.

The thresholds can be chosen: ``plan.png:free=0.3,occupied=0.6,negate=1``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from mapreplay.errors import FloorPlanError, UsageError
from mapreplay.floorplan import FloorPlan
from mapreplay.floorplans.files import existing_path, files_in, unique_ids
from mapreplay.floorplans.greys import NO_OPTIONS, GreyOptions, GreyRule, split_options
from mapreplay.floorplans.pixels import read_pixels
from mapreplay.floorplans.reading import Where, plan_of

ENDINGS: Final = (".png", ".pgm")
DEFAULT_RESOLUTION: Final = 0.05
"""Metres per pixel, as usual in maps saved by robots."""


class ImageSource:
    """One image, or all images in a folder; by default with map_server's thresholds."""

    default_predictor = "d2"

    def __init__(
        self,
        path: Path,
        resolution: float = DEFAULT_RESOLUTION,
        options: GreyOptions = NO_OPTIONS,
    ) -> None:
        """`resolution` is in metres per pixel; `options` are thresholds for dark and light.

        Raises:
            UsageError: `resolution` is not a positive number, or the thresholds contradict
                each other.
        """
        if not (math.isfinite(resolution) and resolution > 0):
            raise UsageError(
                f"resolution {resolution} must be a positive number of metres per cell"
            )
        try:
            self._rule = options.applied_to(GreyRule())
        except ValueError as error:
            raise UsageError(f"{path}: {error}") from None
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
        where = Where(path, str(self._path))
        return plan_of(floor_plan_id, read_pixels(path), self._rule, self._resolution, where)

    def _by_id(self) -> dict[str, Path]:
        if self._files is None:
            paths = find_images(self._path) if self._path.is_dir() else [self._path]
            if not paths:
                raise FloorPlanError(f"{self._path}: holds no {' or '.join(ENDINGS)} image")
            names = (path.stem for path in paths)
            self._files = dict(zip(unique_ids(names), paths, strict=True))
        return self._files


def find_images(folder: Path) -> list[Path]:
    """The PNG and PGM files in `folder`, not below, sorted; without hidden ones.

    Raises:
        FloorPlanError: the folder cannot be read.
    """
    return files_in(folder, ENDINGS)


def open_source(rest: str, resolution: float | None) -> ImageSource:
    """The source ``image``; see `mapreplay.plugins.PluginKind.FLOORPLANS`.

    Raises:
        UsageError: no path, a resolution that is not a positive number, or invalid
            options.
        FloorPlanError: there is no such file or folder.
    """
    name, options = split_options(rest)
    path = existing_path("image", name)
    return ImageSource(path, DEFAULT_RESOLUTION if resolution is None else resolution, options)
