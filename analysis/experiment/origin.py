"""What a folder of results was made of, so that nothing else is mixed with it."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final, Self

from mapreplay.analysis.experiment.config import Dataset, ExperimentConfig
from mapreplay.analysis.experiment.jobs import code_digest
from mapreplay.episode import versions
from mapreplay.errors import UsageError
from mapreplay.files.whole import write_whole
from mapreplay.floorplan import FloorPlan
from mapreplay.predictors import load_predictor

_SHOWN: Final = 12
"""Hex digits of a digest that are shown."""


@dataclass(frozen=True)
class ExperimentOrigin:
    """All that the results on a dataset depend on; the file ``settings-<dataset>.json``."""

    settings: Mapping[str, Any]
    """See `ExperimentConfig.of_dataset`."""
    floor_plans: Mapping[str, str]
    """SHA-256 by id."""
    weights: str
    """SHA-256 of the predictor's."""
    code: str
    versions: Mapping[str, str]

    @classmethod
    def of(cls, config: ExperimentConfig, dataset: Dataset, plans: Sequence[FloorPlan]) -> Self:
        """That of an experiment which is run now."""
        return cls(
            config.of_dataset(dataset),
            {plan.id: plan.sha256 for plan in plans},
            load_predictor(dataset.predictor).identity.sha256,
            code_digest(),
            dict(versions()),
        )

    def differences(self, now: ExperimentOrigin) -> list[str]:
        """What is another thing `now`, each in a few words; floor plans may be added."""
        found = _settings_differ(self.settings, now.settings)
        others = [
            name
            for name, sha256 in now.floor_plans.items()
            if self.floor_plans.get(name, sha256) != sha256
        ]
        if others:
            more = f" and {len(others) - 1} more" if len(others) > 1 else ""
            found.append(f"other cells of floor plan {others[0]}{more}")
        for what, then, here in (
            ("weights", self.weights, now.weights),
            ("code of mapreplay", self.code, now.code),
        ):
            if then != here:
                found.append(f"{what} {then[:_SHOWN] or 'none'}, now {here[:_SHOWN] or 'none'}")
        found += [
            f"{name} {self.versions.get(name)}, now {version}"
            for name, version in now.versions.items()
            if self.versions.get(name) != version
        ]
        return found


def origin_file(folder: Path, dataset: str) -> Path:
    """Where it is written."""
    return folder / f"settings-{dataset}.json"


def keep_origin(folder: Path, dataset: str, now: ExperimentOrigin) -> None:
    """Write down what the results in `folder` are made of.

    Raises:
        UsageError: other results are there.
        WriteError: it cannot be written.
    """
    path = origin_file(folder, dataset)
    then = _read(path)
    if then is not None:
        _refuse(path, then.differences(now))
        now = replace(now, floor_plans={**then.floor_plans, **now.floor_plans})
    if now != then:
        content = json.dumps(asdict(now), indent=1) + "\n"
        write_whole(path, content.encode(), force=True)


def check_settings(folder: Path, config: ExperimentConfig) -> None:
    """Whether the results in `folder` are of `config`, as far as it says.

    Raises:
        UsageError: they are of another.
    """
    for dataset in config.datasets:
        path = origin_file(folder, dataset.name)
        then = _read(path)
        if then is not None:
            _refuse(path, _settings_differ(then.settings, config.of_dataset(dataset)))


def _refuse(path: Path, differences: Sequence[str]) -> None:
    if differences:
        raise UsageError(
            f"{path}: another experiment is there ({'; '.join(differences)}); choose another --out"
        )


def _settings_differ(then: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    return [
        f"{key.replace('_', '-')} {then.get(key)}, now {now.get(key)}"
        for key in sorted({*then, *now})
        if then.get(key) != now.get(key)
    ]


def _read(path: Path) -> ExperimentOrigin | None:
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
        return ExperimentOrigin(**values)
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, ValueError, TypeError):
        raise UsageError(
            f"{path}: does not say what the results there were made of (of an earlier version, or "
            "damaged); choose another --out"
        ) from None
