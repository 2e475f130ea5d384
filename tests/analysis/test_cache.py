"""What is kept is believed only if it is whole, and nothing depends on its being there."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from mapreplay import source_digest
from mapreplay.analysis.cache import Cache, key_of, user_cache
from mapreplay.source_digest import code_digest

KEY, OTHER = "ab" + "0" * 62, "cd" + "1" * 62


@pytest.fixture
def kept(tmp_path: Path) -> Path:
    """The file of an entry of ten bytes."""
    Cache(tmp_path).put(KEY, b"0123456789")
    (path,) = (path for path in tmp_path.rglob("*") if path.is_file())
    return path


def test_what_was_kept_is_found_until_it_is_kept_anew(tmp_path: Path) -> None:
    store = Cache(tmp_path)
    for content in (b"", b"one", bytes(100_000)):
        store.put(KEY, content)
        assert store.get(KEY) == content
        assert store.get(OTHER) is None


def test_any_bit_and_any_cut_is_noticed(tmp_path: Path, kept: Path) -> None:
    whole = kept.read_bytes()
    for place in range(len(whole)):
        kept.write_bytes(whole[:place])
        assert Cache(tmp_path).get(KEY) is None
        for bit in range(8):
            kept.write_bytes(
                whole[:place] + bytes([whole[place] ^ (1 << bit)]) + whole[place + 1 :]
            )
            assert Cache(tmp_path).get(KEY) is None
    kept.write_bytes(whole)
    assert Cache(tmp_path).get(KEY) == b"0123456789"


def test_a_file_under_the_name_of_another_key_is_not_taken(tmp_path: Path, kept: Path) -> None:
    place = tmp_path / OTHER[:2] / OTHER
    place.parent.mkdir()
    place.write_bytes(kept.read_bytes())
    assert Cache(tmp_path).get(OTHER) is None


@pytest.mark.parametrize("what", ["folder", "pipe", "loop", "no permission", "large"])
def test_what_is_no_file_of_ours_is_not_waited_for(tmp_path: Path, kept: Path, what: str) -> None:
    if what == "large":
        kept.write_bytes(bytes(101))
        assert Cache(tmp_path, limit=100).get(KEY) is None
        return
    kept.unlink()
    if what == "folder":
        kept.mkdir()
    elif what == "pipe":
        os.mkfifo(kept)
    elif what == "loop":
        kept.symlink_to(kept)
    assert Cache(tmp_path).get(KEY) is None
    if what == "folder":
        with pytest.raises(OSError, match="directory"):
            Cache(tmp_path).put(KEY, b"1")
    else:
        Cache(tmp_path).put(KEY, b"1")
        assert Cache(tmp_path).get(KEY) == b"1"
    assert [path.suffix for path in kept.parent.iterdir()] == [""]  # no draft is left


def test_a_link_in_the_cache_is_not_written_through(tmp_path: Path, kept: Path) -> None:
    mine = tmp_path / "mine"
    mine.write_text("dear")
    kept.unlink()
    kept.symlink_to(mine)
    Cache(tmp_path).put(KEY, b"1")
    assert mine.read_text() == "dear"


def test_the_least_recently_used_goes_first(tmp_path: Path) -> None:
    keys = [letter * 64 for letter in "abc"]
    for age, key in enumerate(keys):
        Cache(tmp_path).put(key, bytes(68))  # 100 bytes with its seal
        os.utime(tmp_path / key[:2] / key, (age, age))
    assert Cache(tmp_path).get(keys[0]) is not None  # used just now
    Cache(tmp_path, limit=250).trim()
    assert [Cache(tmp_path).get(key) is not None for key in keys] == [True, False, True]
    Cache(tmp_path, limit=0).trim()
    assert not any(path.is_file() for path in tmp_path.rglob("*"))


@pytest.mark.parametrize("home", ["", "somewhere"])
def test_without_a_home_nothing_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, home: str
) -> None:
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", home)
    monkeypatch.setattr(os.path, "expanduser", lambda path: path.replace("~", home or "~"))
    monkeypatch.chdir(tmp_path)
    nowhere = user_cache("metrics")
    assert nowhere.get(KEY) is None
    nowhere.put(KEY, b"1")
    nowhere.trim()
    assert nowhere.problem() == "there is no home, and so no cache; nothing is kept"
    assert list(tmp_path.iterdir()) == []


def test_the_folder_is_the_users(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert user_cache("metrics").folder == tmp_path / "mapreplay" / "metrics"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert user_cache("metrics").folder == tmp_path / ".cache" / "mapreplay" / "metrics"


def test_a_folder_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    assert Cache(tmp_path / "new").problem() is None
    (tmp_path / "file").write_text("")
    problem = Cache(tmp_path / "file" / "metrics").problem()
    assert problem is not None
    assert problem.endswith("nothing is kept")


def test_a_key_depends_on_each_part_and_on_where_it_ends(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_bytes(b"abc")
    keys = [
        key_of("a", "bc"),
        key_of("ab", "c"),
        key_of("abc"),
        key_of("abc", ""),
        key_of("x", file),
    ]
    assert len(set(keys)) == len(keys)
    assert key_of("abc") == key_of(file)
    file.write_bytes(b"abd")
    assert key_of("x", file) != keys[-1]


def package(folder: Path) -> Path:
    """A small package with a part that lies elsewhere, as in the source tree."""
    (folder / "elsewhere" / "deep").mkdir(parents=True)
    (folder / "elsewhere" / "deep" / "b.py").write_text("B = 1")
    (folder / "package" / "__pycache__").mkdir(parents=True)
    (folder / "package" / "a.py").write_text("A = 1")
    (folder / "package" / "notes.txt").write_text("nothing")
    (folder / "package" / "part").symlink_to("../elsewhere")
    return folder / "package"


def test_every_file_of_code_counts(tmp_path: Path) -> None:
    def digest() -> bytes | None:
        code_digest.cache_clear()
        return code_digest(folder)

    folder = package(tmp_path)
    try:
        before = digest()
        (folder / "notes.txt").write_text("something")
        (folder / "__pycache__" / "a.py").write_text("")
        assert digest() == before
        seen = {before}
        (tmp_path / "elsewhere" / "deep" / "b.py").write_text("B = 2")
        seen.add(digest())
        (folder / "a.py").rename(folder / "c.py")
        seen.add(digest())
        (folder / "d.py").write_text("")
        seen.add(digest())
        assert len(seen) == 4
        assert None not in seen
    finally:
        code_digest.cache_clear()
    assert code_digest(tmp_path / "package" / "__pycache__" / "none") is None


def test_the_code_of_planners_recorders_and_analyses_counts() -> None:
    """By the tree itself: a folder that is no longer below the package would be missed."""
    found = {
        Path(folder, name).relative_to(source_digest._ROOT).as_posix()
        for folder, _, names in os.walk(source_digest._ROOT, followlinks=True)
        for name in names
    }
    assert {"planners/nearest.py", "recorders/log/codec.py", "analysis/limits/tour.py"} <= found


def test_another_version_of_a_library_is_another_digest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = package(tmp_path)
    before = code_digest(folder)
    code_digest.cache_clear()
    monkeypatch.setattr(source_digest, "version", lambda library: "99")
    assert code_digest(folder) != before
    code_digest.cache_clear()
