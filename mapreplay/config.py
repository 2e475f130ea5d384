"""Configuration of an episode: checked, frozen, and written completely into the log.

`mapreplay run --help` imports this module, which therefore imports neither NumPy nor our kernels.
"""

from __future__ import annotations

import re
import sys
import tomllib
from bisect import bisect_left
from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from mapreplay.errors import ConfigError
from mapreplay.files.identify import identify
from mapreplay.files.whole import open_regular

if TYPE_CHECKING:
    from mapreplay.grid import Cell


class MapKind(StrEnum):
    """One of the two maps that an agent keeps."""

    OBSERVED = "observed"
    FUSED = "fused"


class PredictionDtype(StrEnum):
    """How P(occupied) is quantized, used and logged."""

    UINT8 = "uint8"
    UINT16 = "uint16"
    FLOAT32 = "float32"


MAX_SEED = 2**63 - 1
_MAX_CONFIG_BYTES = 1 << 20
_MAX_NAME = 512
_MAX_SHOWN = 80

# Strict: nothing is truncated, rounded or guessed; 5.0 and "yes" are refused.
Whole = Annotated[int, Field(strict=True)]
Number = Annotated[float, Field(strict=True)]
Switch = Annotated[bool, Field(strict=True)]
Share = Annotated[Number, Field(ge=0, le=1)]


WEIGHTS_ENDING: Final = ".safetensors"
_PATH: Final = re.compile(r"[/\\~]|[A-Za-z]:[/\\]")


def predictor_name(word: str) -> str:
    """The logged name of a predictor that is given by its name or by the file of its weights.

    For a file this is its name without folder and ending: a log identifies weights by their hash,
    never by their location. No file is ever opened because of this name.
    """
    if WEIGHTS_ENDING in word or _PATH.match(word):
        word = re.split(r"[/\\]", word)[-1].replace(WEIGHTS_ENDING, "") or "unnamed"
    return word


class EpisodeConfig(BaseModel):
    """Everything that an episode depends on, except its floor plan.

    Create it with `of`, whose `ConfigError` names the key, the value and the allowed range.
    """

    model_config = ConfigDict(
        frozen=True, extra="forbid", validate_default=True, allow_inf_nan=False
    )

    planner: str = Field(
        default="cost-utility",
        description="random, nearest, cost-utility, informative-path, or a plug-in.",
    )
    predictor: str = "none"
    """Name; a path to weights is reduced to the name of the file (see `predictor_name`)."""
    plan_on: MapKind = Field(
        default=MapKind.FUSED,
        description="Planning map: the map on which paths and gains are computed.",
    )
    build: MapKind = Field(
        default=MapKind.FUSED, description="Target map: the map whose coverage ends the episode."
    )
    delta_free: Share = Field(
        default=0.93,
        description="Confidence threshold: a cell is free if P(wall) <= (1 - delta) / 2.",
    )
    delta_occupied: Share = Field(
        default=0.95,
        description="Confidence threshold: a cell is occupied if P(wall) >= (1 + delta) / 2.",
    )
    coverage: Number = Field(
        default=0.98, gt=0, le=1, description="Coverage of the target map that ends the episode."
    )
    correct_coverage: Number = Field(
        default=0.95, gt=0, le=1, description="Correct coverage whose first step is reported."
    )
    fail_safe: Switch = Field(
        default=False,
        description="While sealed in, plan on observations instead of ending the episode.",
    )
    start: tuple[Annotated[Whole, Field(ge=0)], Annotated[Whole, Field(ge=0)]] | None = Field(
        default=None,
        description="Start cell; row 0 is at the bottom, as in ROS (default: the top-left free "
        "cell).",
    )
    max_steps: Annotated[Whole, Field(ge=1, le=10_000_000)] | None = Field(
        default=None, description="Step budget (default: 4 x the number of explorable free cells)."
    )
    seed: Whole = Field(default=1, ge=0, le=MAX_SEED, description="Seed of the random choices.")
    rays: Whole = Field(
        default=16,
        ge=8,
        le=360,
        multiple_of=8,
        description="Rays of the range sensor, a multiple of 8.",
    )
    reach: Whole = Field(default=20, ge=1, le=1000, description="Range of the sensor in cells.")
    prediction_dtype: PredictionDtype = Field(
        default=PredictionDtype.UINT8, description="How predictions are quantized, used and logged."
    )

    @field_validator("*", mode="before")
    @classmethod
    def _plain(cls, value: object) -> object:
        """Convert NumPy scalars to Python numbers."""
        numpy = sys.modules.get("numpy")  # loaded by the caller that passes a scalar of it
        return value.item() if numpy and isinstance(value, numpy.generic) else value

    @field_validator("planner", "predictor")
    @classmethod
    def _name(cls, value: str | None) -> str | None:
        if value is not None and not 1 <= len(value) <= _MAX_NAME:
            raise ValueError(f"be a name of 1 to {_MAX_NAME} characters")
        return value

    @field_validator("predictor")
    @classmethod
    def _named(cls, value: str | None) -> str | None:
        return None if value is None else predictor_name(value)

    @classmethod
    def of(cls, values: Mapping[str, Any], where: str = "config") -> Self:
        """Check `values`; `where` is their origin in error messages.

        Raises:
            ConfigError: a key is unknown or a value out of range.
        """
        try:
            return cls(**values)
        except ValidationError as error:
            raise ConfigError(f"{where}: {describe(error)}") from None

    @property
    def start_cell(self) -> Cell | None:
        """`start` as a cell."""
        from mapreplay.grid import Cell

        return None if self.start is None else Cell(*self.start)


class RunConfig(EpisodeConfig):
    """What `mapreplay run` does: every field is an option and a key of its TOML file."""

    floorplans: str = Field(
        default="procedural:60000",
        description="procedural:FIRST-LAST, HouseExpo archive, folder or file, map_server YAML, "
        "image; grey levels of the last two: PATH:free=0.3,occupied=0.6,negate=1.",
    )
    ids: Path | None = Field(default=None, description="File with one floor-plan ID per line.")
    resolution: Annotated[Number, Field(gt=0, le=10)] | None = Field(
        default=None, description="Metres per cell, for sources that are rasterized."
    )
    predictor: str | None = Field(  # type: ignore[assignment]
        default=None,
        description="none, d1, d2, d2-unet, auto (chooses by the map), a plug-in, or a "
        ".safetensors file (default: the one trained on such floor plans).",
    )
    episodes: Annotated[Whole, Field(ge=1, le=10_000_000)] | None = Field(
        default=None,
        description="Number of episodes (default: one per floor plan). If there are fewer floor "
        "plans, they are repeated with the next seed, which matters only to random choices.",
    )
    jobs: Whole = Field(
        default=1, ge=1, le=1024, description="Number of processes; each takes seconds to start."
    )
    device: str = Field(default="cpu", description="Device for the predictor: cpu, cuda, ...")
    profile: Switch = Field(default=False, description="Record the time of each stage.")
    out: Path | None = Field(
        default=None, description="Folder for the logs (default: runs/<date-time>)."
    )

    @field_validator("predictor")
    @classmethod
    def _named(cls, value: str | None) -> str | None:
        return value  # here it is what the user gave, and may be a file

    @property
    def weights(self) -> Path | None:
        """The file of weights, if the predictor was given as one."""
        given = self.predictor or ""
        return Path(given) if given.endswith(WEIGHTS_ENDING) else None

    def episode(self, default_predictor: str, seed: int) -> EpisodeConfig:
        """The configuration of one episode.

        If no predictor is given, `default_predictor` is used if the planning map or the target
        map is fused, and none otherwise.
        """
        values = {key: getattr(self, key) for key in EpisodeConfig.model_fields}
        if self.predictor is None:
            needed = MapKind.FUSED in (self.plan_on, self.build)
            values["predictor"] = default_predictor if needed else "none"
        return EpisodeConfig.of(values | {"seed": seed})


def describe(error: ValidationError) -> str:
    """The first problem found by pydantic, in our words: key, value, allowed range."""
    first = error.errors()[0]
    key = ".".join(str(part) for part in first["loc"] if not str(part).startswith("tuple["))
    if first["type"] == "extra_forbidden":
        return f"unknown key {key!r}"
    reason = first["msg"].removeprefix("Value error, ").removeprefix("Input should ")
    return f"{key} = {_shown(first['input'])}: should {reason.removeprefix('should ')}"


def _shown(value: object) -> str:
    """The start of a value's representation."""
    try:
        text = repr(value)
    except ValueError:
        return "a number of thousands of digits"
    except RecursionError:
        return "something nested too deeply"
    return text if len(text) <= _MAX_SHOWN else f"{text[:_MAX_SHOWN]}..."


def read_toml(path: Path) -> dict[str, Any]:
    """The keys of a TOML file; ``plan-on`` and ``plan_on`` are the same.

    Raises:
        ConfigError: it cannot be read, or is not TOML.
    """
    try:
        with open_regular(path) as file:  # nothing waits for a pipe, or reads a device for ever
            content = file.read(_MAX_CONFIG_BYTES + 1)
    except (OSError, ValueError) as error:
        raise ConfigError(
            f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})"
        ) from None
    if len(content) > _MAX_CONFIG_BYTES:
        raise ConfigError(f"{path}: larger than 1 MiB, not a configuration")
    try:
        text = content.decode("utf-8-sig")  # editors on Windows begin with a byte-order mark
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        what = identify(content) or "save it as UTF-8"
        raise ConfigError(f"{path}, line {line}: not UTF-8 text ({what})") from None
    values: dict[str, Any] = {}
    for key, value in _parsed(text, path).items():
        name = key.replace("-", "_")
        if name in values:
            raise ConfigError(f"{path}: {key} is given twice, with - and with _")
        values[name] = value
    return values


def _parsed(text: str, path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(text.replace("\r\n", "\n"))
    except tomllib.TOMLDecodeError as error:  # says where
        raise ConfigError(f"{path}: not TOML ({identify(text.encode()) or error})") from None
    except RecursionError as error:
        line = _line_of(type(error), text)
        raise ConfigError(f"{path}, line {line}: nested too deeply") from None
    except ValueError as error:
        line, reason = _line_of(type(error), text), str(error).partition(";")[0]
        raise ConfigError(f"{path}, line {line}: an invalid value ({reason})") from None


def _line_of(kind: type[Exception], text: str) -> int:
    """The line of `text` at which parsing fails with an error of this kind, which has no line."""

    def fails(lines: int) -> bool:
        try:
            tomllib.loads("".join(all_lines[:lines]))
        except Exception as error:  # noqa: BLE001 (also that a part of a file is none)
            return type(error) is kind
        return False

    all_lines = text.splitlines(keepends=True)
    return bisect_left(range(len(all_lines)), True, key=fails)  # noqa: FBT003 (what is looked for)
