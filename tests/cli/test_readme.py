"""The Python of the documents runs as it stands; see test_docs.py for the rest of them."""

import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mapreplay import EpisodeLog

ROOT = Path(__file__).parents[2]


def test_the_python_of_the_readme_runs(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    section = (ROOT / "README.md").read_text(encoding="utf-8").partition("## From Python")[2]
    code = re.search(r"```python\n(.*?)```", section, re.DOTALL)
    assert code is not None
    monkeypatch.chdir(tmp_path)  # it opens a sample, and writes a log
    (tmp_path / "samples").symlink_to(ROOT / "samples")
    exec(compile(code[1], "README.md", "exec"), {})
    printed = capsys.readouterr().out
    assert "Candidate(" in printed
    assert "shape: (105, " in printed
    assert EpisodeLog(tmp_path / "runs/mine.mcap").finished


def test_the_python_of_the_analysis_page_runs(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    page = (ROOT / "docs/analysis.md").read_text(encoding="utf-8")
    code = re.search(r"```python\n(.*?)```", page, re.DOTALL)
    assert code is not None
    monkeypatch.chdir(ROOT)
    exec(compile(code[1], "analysis.md", "exec"), {})
    printed = capsys.readouterr().out
    assert "(105, 2, 2)" in printed
    assert printed.strip().endswith("0.8")


def test_the_python_of_the_plug_ins_page_runs() -> None:
    page = (ROOT / "docs/plug-ins.md").read_text(encoding="utf-8")
    snippets = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    assert len(snippets) == 1
    names: dict[str, Any] = {}
    exec(compile(snippets[0], "plug-ins.md", "exec"), names)
    situation = SimpleNamespace(costs=np.array([3.0, 8.0, 5.0]))  # all that it looks at
    assert names["Farthest"]().choose(situation).index == 1
