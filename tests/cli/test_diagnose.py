"""`diagnose`, `branch`, `bundle` and `view --diagnose` from the outside, on a sample."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from commands import Run

SAMPLES = Path(__file__).parents[2] / "samples" / "episodes"
SEALED = "procedural-60014__cost-utility__fused-fused__s1.mcap"


@pytest.fixture
def sealed(tmp_path: Path) -> Path:
    return Path(shutil.copy(SAMPLES / SEALED, tmp_path))


def test_a_paragraph_and_a_file_beside_the_log(cli: Run, sealed: Path) -> None:
    before = sealed.read_bytes()
    result = cli("diagnose", sealed)
    assert result.code == 0
    assert "was sealed in at step 10" in " ".join(result.out.split())
    assert f"mapreplay branch {sealed} --at 10 --with truth" in result.out
    beside = sealed.with_name(sealed.name.replace(".mcap", ".diagnosis.json"))
    assert json.loads(beside.read_text())["sealings"][0]["kind"] == "closed_door"
    assert sealed.read_bytes() == before


def test_many_logs_get_tables_of_80_columns(cli: Run) -> None:
    result = cli("diagnose", "--no-save", SAMPLES)
    assert result.code == 0
    tables = result.out.partition("\nSealed in\n")[2]
    assert tables
    assert max(map(len, tables.splitlines())) <= 80


def test_json_csv_and_page(cli: Run, sealed: Path, tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    result = cli("diagnose", "--no-save", sealed, "--format", "json", "--html", page)
    assert json.loads(result.out)["schema"] == "mapreplay.diagnosis/1"
    assert page.read_text().startswith("<!DOCTYPE html>")
    assert cli("diagnose", "--no-save", sealed, "--format", "csv").out.startswith("file,floor_plan")
    again = cli("diagnose", "--no-save", sealed, "--html", page)
    assert again.code == 2
    assert "--force" in again.err


def test_view_marks_it_at_the_right_step(cli: Run, sealed: Path, tmp_path: Path) -> None:
    plain, marked = tmp_path / "a.png", tmp_path / "b.png"
    assert cli("view", sealed, "--png", plain, "--step", 10).code == 0
    assert cli("view", sealed, "--png", marked, "--diagnose").code == 0
    assert plain.read_bytes() != marked.read_bytes()


def test_bundle(cli: Run, sealed: Path) -> None:
    result = cli("bundle", sealed)
    assert result.code == 0
    assert sealed.with_suffix(".zip").exists()
    assert cli("bundle", sealed, "-o", "x.rar").code == 2


def test_a_branch_needs_no_network_where_nothing_is_predicted(cli: Run, sealed: Path) -> None:
    result = cli("branch", sealed, "--at", -1, "--with", "observed", "--with", "max-steps=20")
    assert result.code == 0
    name = sealed.name.replace(".mcap", ".at10-observed+max-steps=20.mcap")
    assert cli("verify", sealed.with_name(name)).code == 0
    said = cli("diff", sealed, sealed.with_name(name))
    assert said.code == 0
    assert "They part at step 10, in the prediction." in said.out
    changes = "branch step none | 10, branch changes none | observed, max-steps=20"
    assert changes in " ".join(said.out.split())
    assert "A: sealed_in after 10 steps. B: out_of_steps after 20 steps." in said.out
    both = cli("ls", sealed.parent, "--format", "csv")
    assert "1 of 2 episodes are branches; without them: --where branch=" in both.err
    assert '"10: observed, max-steps=20"' in both.out
    for condition, left in (("branch=", sealed.name), ("branch!=", name)):
        one = cli("ls", sealed.parent, "--format", "csv", "--where", condition)
        assert (one.out.count(".mcap"), "branches" in one.err) == (1, False)
        assert left in one.out
    assert "--with magic" in cli("branch", sealed, "--at", 3, "--with", "magic").err
