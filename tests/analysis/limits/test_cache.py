"""What was found is found again by its key, and a cache that is broken does not matter."""

from pathlib import Path

import pytest

from mapreplay.analysis.limits.cache import remembered


def never() -> int:
    raise AssertionError("computed twice")


def test_a_number_is_computed_once_for_each_key(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert remembered(("tour", "abc", 0.98), lambda: 7) == 7
    assert remembered(("tour", "abc", 0.98), never) == 7
    assert remembered(("tour", "abc", 0.95), lambda: 6) == 6
    (kept,) = (path for path in tmp_path.rglob("*.json") if "7" in path.read_text())
    kept.write_text("{")
    assert remembered(("tour", "abc", 0.98), lambda: 8) == 8


def test_a_cache_that_cannot_be_written_does_not_matter(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "file"
    file.write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(file))
    assert remembered(("tour", "abc", 0.98), lambda: 7) == 7
