"""Kernels are compiled, whatever has become of the folder where compiled ones are kept."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import pytest
from numba.core import caching

Compile = Callable[[], Any]


@pytest.fixture
def kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where compiled kernels are kept."""
    folder = tmp_path / "kept"
    folder.mkdir()
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(folder))
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(folder))
    return folder


@pytest.fixture
def double(tmp_path: Path) -> Compile:
    """Makes a kernel anew, as another process would."""
    source = tmp_path / "doubling.py"
    source.write_text(
        "from mapreplay.compiled import njit\n\n\n@njit\ndef double(x):\n    return 2 * x\n"
    )

    def make() -> Any:
        spec = importlib.util.spec_from_file_location("doubling", source)
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module.double

    return make


def hits(kernel: Any) -> int:
    return sum(kernel.stats.cache_hits.values())


def test_a_kernel_is_compiled_once(kept: Path, double: Compile) -> None:
    assert double()(21) == 42
    again = double()
    assert again(21) == 42
    assert hits(again) == 1


def cut(data: bytes) -> bytes:
    return data[: len(data) // 2]


def flip(data: bytes) -> bytes:
    """One bit in the middle: of an .nbc, in its machine code."""
    half = len(data) // 2
    return data[:half] + bytes([data[half] ^ 4]) + data[half + 1 :]


def empty(data: bytes) -> bytes:
    return b""


@pytest.mark.parametrize("harm", [cut, flip, empty])
@pytest.mark.parametrize("ending", [".nbi", ".nbc"])
def test_what_is_damaged_is_compiled_anew(
    kept: Path, double: Compile, ending: str, harm: Callable[[bytes], bytes]
) -> None:
    assert double()(21) == 42
    (file,) = kept.rglob(f"*{ending}")
    file.write_bytes(harm(file.read_bytes()))
    mended = double()
    assert mended(21) == 42
    assert hits(mended) == 0
    again = double()
    assert again(21) == 42
    assert hits(again) == 1, "what was compiled anew is not kept"


def test_without_a_folder_it_is_compiled_in_memory(
    kept: Path, double: Compile, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr(caching._CacheLocator, "ensure_cache_path", refuse)
    assert double()(21) == 42
    assert not list(kept.rglob("*.nb?"))


def test_a_full_disk_costs_the_copy_only(
    kept: Path, double: Compile, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(caching.IndexDataCacheFile, "_save_index", full)
    assert double()(21) == 42


@pytest.mark.parametrize("home", ["", "not/absolute"])
def test_no_home_is_no_folder_elsewhere(
    tmp_path: Path, double: Compile, monkeypatch: pytest.MonkeyPatch, home: str
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", home)
    monkeypatch.setattr(caching.InTreeCacheLocator, "from_function", lambda *_: None)
    assert double()(21) == 42
    assert [path.name for path in tmp_path.iterdir()] == ["doubling.py"]


def test_nor_where_nobody_knows_of_one(
    tmp_path: Path, double: Compile, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unknown() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(Path, "home", unknown)
    monkeypatch.setattr(caching.InTreeCacheLocator, "from_function", lambda *_: None)
    assert double()(21) == 42
