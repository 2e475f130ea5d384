"""A diagnosis as JSON: what lies beside a log as ``x.diagnosis.json``, and goes to programs."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any, Final

from mapreplay.analysis.diagnosis.blame import Blame
from mapreplay.analysis.diagnosis.claims import Claims
from mapreplay.analysis.diagnosis.diagnosis import Diagnosis, Sealing
from mapreplay.errors import ExistsError
from mapreplay.files import cannot_write, check_new, write_whole
from mapreplay.step import Cells

SCHEMA: Final = "mapreplay.diagnosis/1"
SUFFIX: Final = ".diagnosis.json"
_DIGITS: Final = 6


def record_of(diagnosis: Diagnosis, claims: Claims | None = None) -> dict[str, Any]:
    """Everything that was found, as plain values; cells are ``[row, col]``, undefined is null.

    `claims` are those of the corpus that the log was diagnosed in; by default its own.
    """
    config, header = diagnosis.header.config, diagnosis.header
    base = claims or diagnosis.claims
    coverage = diagnosis.coverage
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
        "near_misses": [
            {
                "kind": near.kind,
                "first_step": near.first_step,
                "last_step": near.last_step,
                "agent": list(near.agent),
                "led_to_sealing": near.led_to_sealing,
            }
            for near in diagnosis.near_misses
        ],
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
        "coverage": coverage
        and {
            "claimed": _real(coverage.claimed),
            "correct": _real(coverage.correct),
            "false_walls": coverage.false_walls,
            "false_free": coverage.false_free,
            "is_short": coverage.is_short,
        },
        "notes": list(diagnosis.notes),
    }


def _sealing(sealing: Sealing, claims: Claims) -> dict[str, Any]:
    culprits, doorway, place = sealing.culprits, sealing.doorway, sealing.place
    remedy, view = sealing.remedy, sealing.remedy.view
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
        "culprits": culprits
        and {
            "cells": _cells(culprits.cells),
            "tied": _cells(culprits.tied),
            "unique": culprits.unique,
            "exits": culprits.exits,
            "way": _cells(culprits.way),
        },
        "doorway": doorway
        and {
            "cells": _cells(doorway.cells),
            "width": doorway.width,
            "parts": doorway.parts,
            "unique": doorway.unique,
        },
        "place": place
        and {
            "gap": place.gap,
            "length": place.length,
            "false_wall": place.false_wall,
            "span": place.span,
            "thickness": place.thickness,
            "distance": _real(place.distance),
        },
        "blame": [_blame(blame, claims) for blame in sealing.blame],
        "remedy": {
            "delta_occupied_above": _real(remedy.delta_occupied_above),
            "delta_free_above": _real(remedy.delta_free_above),
            "view": view
            and {
                "cell": list(view.cell),
                "moves": view.moves,
                "metres": _real(view.metres),
                "sees": view.sees,
                "suffices": view.suffices,
            },
            "fail_safe_moves": remedy.fail_safe_moves,
        },
    }


def _blame(blame: Blame, claims: Claims) -> dict[str, Any]:
    right, count = claims.right(blame.p_wall)
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


def _cells(cells: Cells) -> list[list[int]]:
    rows: list[list[int]] = cells.tolist()
    return rows


def _real(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else round(value, _DIGITS)


def to_json(records: dict[str, Any]) -> bytes:
    """As text, one line a list of cells, so that people can read it too."""
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
    """``x.diagnosis.json`` beside ``x.mcap`` or ``x.mcap.part``."""
    return log.with_name(log.name.removesuffix(".part").removesuffix(".mcap") + SUFFIX)


def save_beside(log: Path, record: dict[str, Any]) -> Path:
    """Write the diagnosis of `log` beside it; an older diagnosis is replaced.

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
