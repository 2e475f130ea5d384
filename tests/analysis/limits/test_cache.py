"""What was found is found again by its key, and a cache that is broken does not matter."""

from pathlib import Path

import pytest

from mapreplay.analysis.cache import key_of, user_cache
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


@pytest.mark.parametrize("content", [b"", b"{", b"7.5", b"-7", b"\xb2", b"9" * 5000, b" 7"])
def test_what_is_no_number_of_moves_is_computed_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, content: bytes
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    key = ("tour", "abc", 0.98)
    user_cache("limits").put(key_of("limits", repr(key)), content)
    assert remembered(key, lambda: 8) == 8
    assert remembered(key, never) == 8


@pytest.mark.parametrize("place", range(33))
def test_a_flipped_bit_is_computed_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: int
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert remembered(("tour", "abc"), lambda: 7) == 7
    (kept,) = (path for path in tmp_path.rglob("*") if path.is_file())
    data = bytearray(kept.read_bytes())
    data[place] ^= 1
    kept.write_bytes(data)
    assert remembered(("tour", "abc"), lambda: 8) == 8


def test_a_cache_that_cannot_be_written_does_not_matter(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "file"
    file.write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(file))
    assert remembered(("tour", "abc", 0.98), lambda: 7) == 7
