"""Rows of episodes, and conditions on them."""

import dataclasses
import math

import polars as pl
import pytest

from mapreplay.analysis.episodes.summary import EpisodeRow, RowFilter, brief, episode_frame
from mapreplay.errors import UsageError

ROW = EpisodeRow(
    file="a.mcap", floor_plan="p1", planner="nearest", predictor="none", plan_on="observed",
    build="observed", fail_safe=False, seed=1, start_row=5, start_col=1, max_steps=400,
    outcome="mapped", steps=100, mapping_time=100, correct_time=90, path_length=25.0,
    coverage=0.98, correct=0.98, f1=0.99, fail_safe_steps=0,
)  # fmt: skip


def row(**changes: object) -> EpisodeRow:
    return dataclasses.replace(ROW, **changes)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("text", "holds"),
    [
        ("outcome=mapped", True), ("outcome!=mapped", False), ("steps>99", True),
        ("steps>=100", True), ("steps<100", False), ("steps <= 100", True),
        ("fail_safe=false", True), ("fail_safe=true", False), ("f1>.95", True), ("seed=1", True),
        ("planner=random", False),
    ],
)  # fmt: skip
def test_conditions(text: str, holds: bool) -> None:
    assert RowFilter.parse(text).holds(ROW) is holds


def test_what_is_not_there_satisfies_only_unequal() -> None:
    assert not RowFilter.parse("mapping_time<1000").holds(row(mapping_time=None))
    assert RowFilter.parse("mapping_time!=3").holds(row(mapping_time=None))
    assert not RowFilter.parse("f1>0").holds(row(f1=math.nan))


@pytest.mark.parametrize(
    ("text", "message"),
    [("outcome", "expected column=value"), ("colour=red", "no column 'colour'; there are file")],
)
def test_bad_conditions_are_refused(text: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        RowFilter.parse(text)


def test_a_number_is_needed_where_a_number_is_compared() -> None:
    with pytest.raises(UsageError, match="'many' is no number"):
        RowFilter.parse("steps>many").holds(ROW)


def test_the_frame_has_its_columns_even_when_empty() -> None:
    empty, full = episode_frame([]), episode_frame([ROW, row(mapping_time=None)])
    assert empty.schema == full.schema
    assert full["mapping_time"].to_list() == [100, None]
    assert full.schema["fail_safe"] == pl.Boolean
    both = brief(episode_frame([ROW, row(build="fused", floor_plan="f" * 32)]))
    assert both["maps"].to_list() == ["observed", "observed/fused"]
    assert both["floor_plan"].to_list() == ["p1", "f" * 15 + "…"]
