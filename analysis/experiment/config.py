"""Configuration of an experiment: which planners and predictors meet which floor plans."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from mapreplay.analysis.experiment.controls import CONTROLS
from mapreplay.analysis.experiment.infill import PREFIX as INFILL
from mapreplay.config import (
    WEIGHTS_ENDING,
    EpisodeConfig,
    MapKind,
    Share,
    describe,
    predictor_name,
    read_toml,
)
from mapreplay.errors import ConfigError, FloorPlanError, UsageError
from mapreplay.floorplan import FloorPlan
from mapreplay.floorplans import load_each, open_source, read_ids, select


def shipped_configs() -> dict[str, Path]:
    """The configurations that come with the package, by name, sorted."""
    paths = (Path(__file__).parent / "configs").glob("*.toml")
    return dict(sorted((path.stem, path) for path in paths))


class _Table(BaseModel):
    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        allow_inf_nan=False,
        alias_generator=lambda name: name.replace("_", "-"),
        populate_by_name=True,
    )


class Dataset(_Table):
    """Floor plans, and the predictor that was trained on their like."""

    name: Annotated[str, Field(pattern=r"^[^./\\\x00-\x1f][^/\\\x00-\x1f]{0,63}$")]
    """Files and folders are called after it."""
    floorplans: str
    """See `mapreplay.floorplans.open_source`; the command line can name another place."""
    predictor: str
    wall_share: Share
    """Of the explorable cells of the training plans; what the control ``mean-wall`` repeats."""
    ids: Path | None = None
    """Beside the configuration; a file with one id a line."""
    plans: Annotated[int, Field(ge=1)] = 100
    """The first so many."""
    curve_plans: Annotated[int, Field(ge=0)] = 30
    """Of them, the first so many give the F1 curve and the calibration."""

    def weights_of(self, episode: EpisodeConfig) -> Path | None:
        """The file of weights that predicts in `episode`, if `predictor` is one."""
        given = self.predictor
        used = given.endswith(WEIGHTS_ENDING) and episode.predictor == predictor_name(given)
        return Path(given) if used else None

    def load(self, floorplans: str | None = None) -> list[FloorPlan]:
        """The floor plans, from `floorplans` instead of where the configuration says.

        Raises:
            FloorPlanError: one of them cannot be had: an experiment is on all or none.
        """
        source = open_source(floorplans or self.floorplans)
        selection = select(source, read_ids(self.ids) if self.ids else None, self.plans)
        if selection.missing:
            raise FloorPlanError(
                f"dataset {self.name}: {len(selection.missing)} floor plans are missing, such as "
                f"{selection.missing[0]}"
            )
        plans = []
        for _, plan in load_each(source, selection.ids):
            if isinstance(plan, FloorPlanError):
                raise plan
            plans.append(plan)
        return plans


class Planning(_Table):
    """A planner, and how many runs it has on each floor plan."""

    planner: str
    runs: Annotated[int, Field(ge=1, le=1000)] = 1


class Maps(_Table):
    """One of the four configurations: planned on, built."""

    plan_on: MapKind
    build: MapKind


class Sweep(_Table):
    """Thresholds that are tried, each free one with each occupied one."""

    delta_free: tuple[Share, ...]
    delta_occupied: tuple[Share, ...]


class ExperimentConfig(_Table):
    """All of an experiment: the keys of its TOML file."""

    datasets: Annotated[tuple[Dataset, ...], Field(min_length=1)]
    planners: Annotated[tuple[Planning, ...], Field(min_length=1)]
    maps: Annotated[tuple[Maps, ...], Field(min_length=1)]
    controls: tuple[str, ...] = ()
    """Predictors that know nothing; each meets the first run of each planner but random."""
    infill: tuple[Annotated[int, Field(ge=1)], ...] = ()
    """Radii of the in-fill oracle, which is right about all that is near to what was observed."""
    sweep: Sweep | None = None
    example: str | None = None
    """The dataset whose first floor plan is the example of the paper's mapping figure."""
    delta_free: Share = 0.93
    delta_occupied: Share = 0.95
    coverage: Annotated[float, Field(gt=0, le=1)] = 0.98
    seed: Annotated[int, Field(ge=0)] = 1
    """Of the first run; the next has the next."""

    @classmethod
    def of(cls, values: Mapping[str, Any], where: str) -> Self:
        """Check `values`; `where` says in an error where they came from.

        Raises:
            ConfigError: a key is unknown or a value out of range.
        """
        try:
            config = cls(**values)
        except ValidationError as error:
            raise ConfigError(f"{where}: {describe(error)}") from None
        names = [dataset.name for dataset in config.datasets]
        if len(set(names)) < len(names):
            raise ConfigError(f"{where}: two datasets have one name")
        if config.example is not None and config.example not in names:
            raise ConfigError(f"{where}: example = {config.example!r}: there is no such dataset")
        taken = {*config.controls, "none", *(f"{INFILL}{radius}" for radius in config.infill)}
        for dataset in config.datasets:
            name = predictor_name(dataset.predictor)
            if name in taken and dataset.predictor.endswith(WEIGHTS_ENDING):
                raise ConfigError(
                    f"{where}: predictor = {dataset.predictor!r}: {name} is a control; rename it"
                )
        unknown = [name for name in config.controls if name not in CONTROLS]
        if unknown:
            raise ConfigError(
                f"{where}: controls: no {unknown[0]!r}; there are {', '.join(CONTROLS)}"
            )
        return config

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read a TOML file; relative id lists are beside it.

        Raises:
            ConfigError: it cannot be read, or is not such a configuration.
        """
        config = cls.of(read_toml(path), str(path))
        datasets = tuple(
            d.model_copy(update={"ids": path.parent / d.ids}) if d.ids else d
            for d in config.datasets
        )
        return config.model_copy(update={"datasets": datasets})

    def only(self, names: tuple[str, ...]) -> Self:
        """With the datasets of those names only; none is all.

        Raises:
            UsageError: there is no such dataset.
        """
        known = {dataset.name for dataset in self.datasets}
        for name in names:
            if name not in known:
                raise UsageError(f"no dataset {name!r}; there are {', '.join(sorted(known))}")
        chosen = tuple(d for d in self.datasets if not names or d.name in names)
        example = self.example if self.example in {d.name for d in chosen} else None
        return self.model_copy(update={"datasets": chosen, "example": example})

    def swept(self) -> list[Self]:
        """The same experiment at each pair of thresholds that is swept."""
        if self.sweep is None:
            return []
        return [
            self.model_copy(
                update={
                    "delta_free": free, "delta_occupied": occupied, "sweep": None, "controls": (),
                    "infill": (),
                }
            )
            for free, occupied in product(self.sweep.delta_free, self.sweep.delta_occupied)
        ]  # fmt: skip

    def of_dataset(self, dataset: Dataset) -> dict[str, Any]:
        """Keys and values that its results depend on, but for weights and floor plans.

        Not how many runs there are, nor what is swept: an experiment can grow.
        """
        shared = {"delta_free", "delta_occupied", "coverage", "seed"}
        grows = {"floorplans", "ids", "plans", "curve_plans"}
        values = self.model_dump(mode="json", include=shared)
        values |= dataset.model_dump(mode="json", exclude=grows)
        return values | {"predictor": predictor_name(dataset.predictor)}

    def episode(
        self, planner: str, predictor: str, maps: Maps, seed: int, *, fail_safe: bool
    ) -> EpisodeConfig:
        """The configuration of one episode."""
        return EpisodeConfig(
            planner=planner,
            predictor=predictor,
            plan_on=maps.plan_on,
            build=maps.build,
            fail_safe=fail_safe,
            delta_free=self.delta_free,
            delta_occupied=self.delta_occupied,
            coverage=self.coverage,
            seed=seed,
        )
