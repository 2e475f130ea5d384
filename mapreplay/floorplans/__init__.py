"""Floor-plan sources: from a specification to floor plans, loaded one by one."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Protocol, cast

from mapreplay import plugins
from mapreplay.errors import FloorPlanError, UsageError
from mapreplay.files.identify import identify, identify_file
from mapreplay.floorplan import ID_PATTERN, FloorPlan
from mapreplay.floorplans.files import (
    exists,
    files_in,
    folders_in,
    is_link,
    missing,
    read_limited,
)
from mapreplay.floorplans.greys import split_options
from mapreplay.floorplans.plausibility import check_explorable

MAX_IDS: Final = 1_000_000
_MAX_ID_LIST_BYTES: Final = 160 << 20
_MAX_IDENTIFIED: Final = 100


class FloorPlanSource(Protocol):
    """A collection of floor plans with IDs."""

    @property
    def default_predictor(self) -> str:
        """The predictor that suits these floor plans."""
        ...

    def ids(self) -> Sequence[str]:
        """All IDs, in a fixed order. Raises FloorPlanError if the source cannot be read."""
        ...

    def load(self, floor_plan_id: str) -> FloorPlan:
        """Load one floor plan. Raises FloorPlanError if it does not exist, or is refused."""
        ...


ENDINGS: Final[Mapping[str, str]] = {
    ".tar.gz": "houseexpo",
    ".tgz": "houseexpo",
    ".tar": "houseexpo",
    ".json": "houseexpo",
    ".yaml": "map_server",
    ".yml": "map_server",
    ".png": "image",
    ".pgm": "image",
}
"""The source that reads a file, by the ending of its name."""


def _holds_maps(folder: Path) -> bool:
    from mapreplay.floorplans.map_server import find_maps

    return bool(find_maps(folder))


def _holds_houses(folder: Path) -> bool:
    from mapreplay.floorplans.houseexpo import find_houses

    return bool(find_houses(folder))


def _holds_images(folder: Path) -> bool:
    from mapreplay.floorplans.image import find_images

    return bool(find_images(folder))


WITH_OPTIONS: Final = ("map_server", "image")
"""The sources whose specifications may end in options, see `greys.split_options`."""


FOLDERS: Final[Mapping[str, Callable[[Path], bool]]] = {
    "map_server": _holds_maps,  # first, because maps have images next to them
    "houseexpo": _holds_houses,
    "image": _holds_images,
}
"""The source that reads a folder: the first one whose check is true."""


def _source_of(folder: Path) -> str | None:
    """The source that reads `folder`.

    Raises:
        UsageError: it holds floor plans of more than one kind.
    """
    found = [source for source, holds in FOLDERS.items() if holds(folder)]
    if "map_server" in found and "houseexpo" in found:
        raise UsageError(
            f"{folder}: holds HouseExpo houses and map_server maps; name one of the files, or "
            f"houseexpo:{folder} or map_server:{folder}"
        )
    return found[0] if found else None


def open_source(spec: str, resolution: float | None = None) -> FloorPlanSource:
    """Open the source that `spec` refers to.

    Args:
        spec: ``name:rest`` or ``name`` of a registered source, like ``procedural:7``; else the
            path of a file or folder; ``./name`` for a file with the name of a source. Images
            and maps take options, like ``plan.png:free=0.3,occupied=0.6,negate=1``.
        resolution: Metres per cell, or None for the default of the source.

    Raises:
        FloorPlanError: there is no such file or folder.
        UsageError: `spec` is neither a source nor readable by one of ours, or the resolution is
            invalid.
        PluginError: a source of another package is broken.
    """
    name, _, rest = spec.partition(":")
    if name in plugins.available(plugins.PluginKind.FLOORPLANS):
        return _open(name, rest, resolution)
    name, options = split_options(spec)
    path = Path(name)
    by_ending = next((ENDINGS[end] for end in ENDINGS if name.lower().endswith(end)), None)
    if not spec or not exists(path):
        if by_ending or len(path.parts) > 1 or is_link(path):
            raise FloorPlanError(missing(path))
        raise UsageError(f"{spec!r}: no such file or folder, and no source; {_understood()}")
    found = by_ending
    if path.is_dir():
        found = _source_of(path)
        if found is None:
            raise UsageError(
                f"{spec}: not a folder of floor plans, {_contents(path)}; {_understood()}"
            )
    if found is None:
        what = identify_file(path)
        line = f"{spec}: not a floor plan" + (f": {what}" if what else "")
        raise UsageError(f"{line}; {_understood()}")
    if found not in WITH_OPTIONS and options:
        raise UsageError(f"{spec}: only images and map_server maps have grey thresholds")
    return _open(found, spec, resolution)


def _contents(folder: Path) -> str:
    """What a folder contains instead, and where near it there are floor plans."""
    near = next((inner for inner in folders_in(folder) if _source_of(inner)), None)
    if near is not None:
        return f"but {near} is one"
    files = files_in(folder)
    if not files:
        return "it holds no file"
    endings = Counter(path.suffix.lower() or "other" for path in files)
    for path in files[:_MAX_IDENTIFIED]:
        what = identify_file(path)
        if what is not None:
            return f"{path} is {what}"
    kinds = " and ".join(f"{count} {ending}" for ending, count in endings.most_common(3))
    return f"it holds {kinds} file{'s' if sum(endings.values()) > 1 else ''}"


def _open(name: str, rest: str, resolution: float | None) -> FloorPlanSource:
    factory = plugins.load(plugins.PluginKind.FLOORPLANS, name)
    return cast("FloorPlanSource", factory(rest, resolution))


def _understood() -> str:
    names = ", ".join(plugins.available(plugins.PluginKind.FLOORPLANS))
    return (
        f"supported are the sources {names} (as in procedural:60000-60099), "
        f"files ending in {', '.join(ENDINGS)}, and folders of these"
    )


def read_ids(path: Path) -> list[str]:
    """Read a list of IDs, one per line; blank lines and comments after ``#`` are skipped.

    Raises:
        FloorPlanError: the file cannot be read, is not such a list, or is empty.
    """
    content = read_limited(path, _MAX_ID_LIST_BYTES)
    what = identify(content)
    if content and what is not None:
        raise FloorPlanError(f"{path}: not a list of ids: {what}")
    try:
        lines = content.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError:
        raise FloorPlanError(f"{path}: not a list of IDs (not a text file)") from None
    if len(lines) > MAX_IDS:
        raise FloorPlanError(f"{path}: {len(lines)} lines; at most {MAX_IDS} are allowed")
    ids = []
    for number, line in enumerate(lines, start=1):
        entry = line.partition("#")[0].strip()
        if entry and not ID_PATTERN.fullmatch(entry):
            raise FloorPlanError(
                f"{path}, line {number}: {entry[:40]!r} is not an id (letters, digits, . _ + -)"
            )
        if entry:
            ids.append(entry)
    if not ids:
        raise FloorPlanError(f"{path}: contains no ID; expected one per line")
    return ids


@dataclass(frozen=True)
class Selection:
    """Some of a source's floor plans."""

    ids: tuple[str, ...]
    """In the requested order, without repetitions."""
    missing: tuple[str, ...]
    """Requested IDs that the source does not have."""


def select(
    source: FloorPlanSource, wanted: Sequence[str] | None = None, limit: int | None = None
) -> Selection:
    """The first `limit` of the `wanted` floor plans, or of all; None is no limit.

    Raises:
        FloorPlanError: the source cannot be read.
        UsageError: `limit` is negative.
    """
    if limit is not None and limit < 0:
        raise UsageError(f"limit {limit} of floor plans is negative")
    available = source.ids()
    if wanted is None:
        return Selection(tuple(available[:limit]), ())
    known = frozenset(available)
    asked = dict.fromkeys(wanted)
    return Selection(
        ids=tuple(entry for entry in asked if entry in known)[:limit],
        missing=tuple(entry for entry in asked if entry not in known),
    )


def by_sha256(ids: Iterable[str]) -> list[str]:
    """Sorted by the SHA-256 of the ID; the first ones are held out."""
    return sorted(ids, key=lambda floor_plan_id: hashlib.sha256(floor_plan_id.encode()).hexdigest())


def load_each(
    source: FloorPlanSource, ids: Sequence[str]
) -> Iterator[tuple[str, FloorPlan | FloorPlanError]]:
    """The floor plans of `ids` in their order, each with its ID, or the error for it.

    Floor plans with nothing to explore are refused, whatever their source; for doubts about the
    others see `mapreplay.floorplans.plausibility.examine`.

    All are loaded before the first is yielded, in the order of the source, because seeking in an
    archive means reading it again from its start.
    """
    wanted = frozenset(ids)
    loaded: dict[str, FloorPlan | FloorPlanError] = {}
    for floor_plan_id in source.ids():
        if floor_plan_id in wanted:
            try:
                plan = source.load(floor_plan_id)
                check_explorable(plan)
                loaded[floor_plan_id] = plan
            except FloorPlanError as error:
                loaded[floor_plan_id] = error
    yield from ((floor_plan_id, loaded[floor_plan_id]) for floor_plan_id in ids)
