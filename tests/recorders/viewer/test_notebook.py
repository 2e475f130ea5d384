from __future__ import annotations

from pathlib import Path

import pytest
from rerun import notebook

import mapreplay
from mapreplay.errors import LogError, MapreplayError

SAMPLES = Path(__file__).parents[3] / "samples" / "episodes"


def test_show_makes_a_widget_or_says_what_to_install() -> None:
    log = sorted(SAMPLES.glob("procedural-60014*"))[0]
    if notebook.HAS_NOTEBOOK:
        assert isinstance(mapreplay.show(log), notebook.Viewer)
    else:
        with pytest.raises(MapreplayError, match=r"pip install 'mapreplay\[notebook\]'"):
            mapreplay.show(log)


def test_show_wants_a_log(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(notebook, "HAS_NOTEBOOK", True)
    with pytest.raises(LogError, match=r"nothing\.mcap"):
        mapreplay.show(tmp_path / "nothing.mcap")
