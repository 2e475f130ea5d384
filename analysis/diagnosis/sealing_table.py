"""The sealings of many logs as one table, for CSV and Parquet."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import polars as pl

from mapreplay.analysis.diagnosis.diagnosis import Diagnosis


def sealing_table(files: Sequence[str], diagnoses: Sequence[Diagnosis]) -> pl.DataFrame:
    """A row per sealing, with the file that it is in; `_SCHEMA` has the columns and their types."""
    rows = []
    for file, diagnosis in zip(files, diagnoses, strict=True):
        config = diagnosis.header.config
        for s in diagnosis.sealings:
            viewpoint, passage, opening = s.remedy.viewpoint, s.passage, s.opening
            rows.append(
                {
                    "file": file,
                    "floor_plan": diagnosis.header.floor_plan.id,
                    "planner": config.planner,
                    "predictor": diagnosis.header.predictor.name,
                    "delta_occupied": config.delta_occupied,
                    "delta_free": config.delta_free,
                    "fail_safe": config.fail_safe,
                    "kind": s.kind,
                    "step": s.first_step,
                    "last_step": s.last_step,
                    "ending": s.ending.value,
                    "moves": s.moves,
                    "metres": s.metres,
                    "coverage": s.coverage,
                    "correct_coverage": s.correct_coverage,
                    "inside": s.inside,
                    "hidden": s.hidden,
                    "blocking_cells": len(s.blocking.cells) if s.blocking else None,
                    "tied": len(s.blocking.tied) if s.blocking else None,
                    "exits": s.blocking.exits if s.blocking else None,
                    "row": int(s.blocking.cells[0][0]) if s.blocking else None,
                    "col": int(s.blocking.cells[0][1]) if s.blocking else None,
                    "opening": opening.width if opening else None,
                    "opening_parts": opening.parts if opening else None,
                    "gap": passage.gap if passage else None,
                    "gap_length": passage.length if passage else None,
                    "false_wall": passage.false_wall if passage else None,
                    "distance": passage.distance if passage else None,
                    "p_wall": s.blame[0].p_wall if s.blame else None,
                    "since": s.blame[0].since if s.blame else None,
                    "flickers": s.blame[0].flickers if s.blame else None,
                    "delta_occupied_above": s.remedy.delta_occupied_above,
                    "delta_free_above": s.remedy.delta_free_above,
                    "viewpoint_moves": viewpoint.moves if viewpoint else None,
                    "viewpoint_suffices": viewpoint.suffices if viewpoint else None,
                    "fail_safe_moves": s.remedy.fail_safe_moves,
                }
            )
    return pl.DataFrame(rows, schema=_SCHEMA).fill_nan(None)


_TEXT, _INT, _REAL, _BOOL = pl.String, pl.Int64, pl.Float64, pl.Boolean
_SCHEMA: Final = {
    "file": _TEXT, "floor_plan": _TEXT, "planner": _TEXT, "predictor": _TEXT,
    "delta_occupied": _REAL, "delta_free": _REAL, "fail_safe": _BOOL, "kind": _TEXT, "step": _INT,
    "last_step": _INT, "ending": _TEXT, "moves": _INT, "metres": _REAL, "coverage": _REAL,
    "correct_coverage": _REAL, "inside": _INT, "hidden": _INT, "blocking_cells": _INT, "tied": _INT,
    "exits": _INT, "row": _INT, "col": _INT, "opening": _INT, "opening_parts": _INT, "gap": _INT,
    "gap_length": _INT, "false_wall": _INT, "distance": _REAL, "p_wall": _REAL, "since": _INT,
    "flickers": _INT, "delta_occupied_above": _REAL, "delta_free_above": _REAL,
    "viewpoint_moves": _INT, "viewpoint_suffices": _BOOL, "fail_safe_moves": _INT,
}  # fmt: skip
