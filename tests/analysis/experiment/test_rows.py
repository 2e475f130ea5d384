"""Rows on disk: what was finished stays, whatever happens in the middle of a line."""

import math
from pathlib import Path

import pytest

from experiments import ROW
from mapreplay.analysis.experiment.rows import Row, RowFile
from mapreplay.errors import MapreplayError


def test_rows_come_back_with_what_is_undefined(tmp_path: Path) -> None:
    file = RowFile(tmp_path / "rows.jsonl")
    assert file.read() == []
    odd = ROW(f1=math.nan, mapping_time=None, sealed_step=12, outcome="sealed_in")
    for row in (ROW(), odd):
        file.append(row)
    first, second = file.read()
    assert first == ROW()
    assert math.isnan(second.f1)
    assert (second.mapping_time, second.sealed_step) == (None, 12)


@pytest.mark.parametrize("cut", [1, 2, 30])
def test_a_torn_last_line_is_cut_off(tmp_path: Path, cut: int) -> None:
    path = tmp_path / "rows.jsonl"
    file = RowFile(path)
    file.append(ROW(seed=1))
    file.append(ROW(seed=2))
    path.write_bytes(path.read_bytes()[:-cut])
    assert file.read() == [ROW(seed=1)]
    file.repair()
    file.append(ROW(seed=3))
    assert file.read() == [ROW(seed=1), ROW(seed=3)]


@pytest.mark.parametrize("line", ["{}", "[1]", "nonsense", '{"dataset": 1}'])
def test_a_damaged_line_is_named(tmp_path: Path, line: str) -> None:
    path = tmp_path / "rows.jsonl"
    path.write_text(f"{ROW().to_json()}\n{line}\n")
    with pytest.raises(MapreplayError, match=r"rows.jsonl, line 2: damaged"):
        RowFile(path).read()


def test_a_row_is_one_line_of_strict_json() -> None:
    line = ROW(precision=math.nan).to_json()
    assert "\n" not in line
    assert "NaN" not in line
    assert Row.from_json(line).to_json() == line
