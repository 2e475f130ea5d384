"""A diagnosis as JSON: saved next to a log as ``x.diagnosis.json``, and printed for programs.

The keys are those of the format; some are older than the names in the code.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any, Final

from mapreplay.analysis.diagnosis.blame import Blame
from mapreplay.analysis.diagnosis.diagnosis import Diagnosis, Sealing
from mapreplay.analysis.diagnosis.reliability import Reliability
from mapreplay.errors import ExistsError
from mapreplay.files.whole import cannot_write, check_new, write_whole
from mapreplay.step import Cells

SCHEMA: Final = "mapreplay.diagnosis/1"
SUFFIX: Final = ".diagnosis.json"
_DIGITS: Final = 6


def record_of(diagnosis: Diagnosis, reliability: Reliability | None = None) -> dict[str, Any]:
    """Everything that was found, as plain values; cells are ``[row, col]``, undefined is null.

    `reliability` is that of the corpus that the log was diagnosed in; by default its own.
    """
    config, header = diagnosis.header.config, diagnosis.header
    base = reliability or diagnosis.reliability
    return {
        "schema": SCHEMA,
        "floor_plan": header.floor_plan.id,
        "planner": config.planner,
        "predictor": header.predictor.name,
        "predictor_sha256": header.predictor.sha256,
        "plan_on": config.plan_on,
        "build": config.build,
        "delta_free": config.delta_free,
        "delta_occupied": config.delta_occupied,
        "fail_safe": config.fail_safe,
        "seed": config.seed,
        "steps": diagnosis.steps,
        "outcome": diagnosis.outcome,
        "wall_share": _real(header.floor_plan.wall_share) if header.floor_plan.has_truth else None,
        "sealings": [_sealing(sealing, base) for sealing in diagnosis.sealings],
        "near_misses": [_fields(near) for near in diagnosis.near_misses],
        "harms": [
            {
                "kind": harm.kind,
                "first_step": harm.first_step,
                "last_step": harm.last_step,
                "moves": harm.moves,
                "target": list(harm.target),
            }
            for harm in diagnosis.harms
        ],
        "coverage": _fields(diagnosis.coverage),
        "notes": list(diagnosis.notes),
    }


def _sealing(sealing: Sealing, reliability: Reliability) -> dict[str, Any]:
    blocking, opening, remedy = sealing.blocking, sealing.opening, sealing.remedy
    return {
        "kind": sealing.kind,
        "first_step": sealing.first_step,
        "last_step": sealing.last_step,
        "ending": sealing.ending,
        "moves": sealing.moves,
        "metres": _real(sealing.metres),
        "agent": list(sealing.agent),
        "coverage": _real(sealing.coverage),
        "correct_coverage": _real(sealing.correct_coverage),
        "inside": sealing.inside,
        "hidden": sealing.hidden,
        "culprits": blocking
        and {
            "cells": _cells(blocking.cells),
            "tied": _cells(blocking.tied),
            "unique": blocking.unique,
            "exits": blocking.exits,
            "way": _cells(blocking.way),
        },
        "doorway": opening
        and {
            "cells": _cells(opening.cells),
            "width": opening.width,
            "parts": opening.parts,
            "unique": opening.unique,
        },
        "place": _fields(sealing.passage),
        "blame": [_blame(blame, reliability) for blame in sealing.blame],
        "remedy": {
            "delta_occupied_above": _real(remedy.delta_occupied_above),
            "delta_free_above": _real(remedy.delta_free_above),
            "view": _fields(remedy.viewpoint),
            "fail_safe_moves": remedy.fail_safe_moves,
        },
    }


def _blame(blame: Blame, reliability: Reliability) -> dict[str, Any]:
    right, count = reliability.right(blame.p_wall)
    return {
        "cell": list(blame.cell),
        "p_wall": _real(blame.p_wall),
        "confidence": _real(blame.confidence),
        "claims_right": _real(right),
        "claims": count,
        "first": blame.first,
        "since": blame.since,
        "flickers": blame.flickers,
        "seen_free": blame.seen_free,
        "seen_occupied": blame.seen_occupied,
        "unseen": blame.unseen,
        "distance": _real(blame.distance),
        "seen_at": blame.seen_at,
        "history": [_real(p) for p in blame.history.tolist()],
    }


def _fields(value: Any) -> dict[str, Any] | None:
    """The fields of a dataclass of numbers, words and cells; None of None."""
    return value and {key: _plain(field) for key, field in vars(value).items()}


def _plain(value: Any) -> Any:
    if isinstance(value, float):
        return _real(value)
    return list(value) if isinstance(value, tuple) else value


def _cells(cells: Cells) -> list[list[int]]:
    rows: list[list[int]] = cells.tolist()
    return rows


def _real(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else round(value, _DIGITS)


def to_json(records: dict[str, Any]) -> bytes:
    """As text, with a list of cells per line, so that people can read it too."""
    return (_dump(records, 0) + "\n").encode()


def _dump(value: Any, depth: int) -> str:
    if isinstance(value, dict) and value:
        inner = ",\n".join(
            f"{' ' * (depth + 1)}{json.dumps(key)}: {_dump(item, depth + 1)}"
            for key, item in value.items()
        )
        return f"{{\n{inner}\n{' ' * depth}}}"
    if isinstance(value, list) and any(isinstance(item, dict) for item in value):
        inner = ",\n".join(f"{' ' * (depth + 1)}{_dump(item, depth + 1)}" for item in value)
        return f"[\n{inner}\n{' ' * depth}]"
    return json.dumps(value)


def diagnosis_path(log: Path) -> Path:
    """``x.diagnosis.json`` next to ``x.mcap`` or ``x.mcap.part``."""
    return log.with_name(log.name.removesuffix(".part").removesuffix(".mcap") + SUFFIX)


def save_next_to(log: Path, record: dict[str, Any]) -> Path:
    """Write the diagnosis of `log` next to it; an older diagnosis is replaced.

    Raises:
        ExistsError: what is there is no diagnosis.
        WriteError: it cannot be written.
    """
    path, data = diagnosis_path(log), to_json(record)
    check_new(path, force=True)
    try:
        with path.open("rb") as file:
            there = file.read(len(data) + 1)
    except FileNotFoundError:
        there = None
    except OSError as error:
        raise cannot_write(path, error) from None
    if there == data:
        return path
    if there is not None and not there.startswith(b'{\n "schema": "mapreplay.diagnosis/'):
        raise ExistsError(f"{path}: exists and is no diagnosis; move it away")
    write_whole(path, data, force=True)
    return path
