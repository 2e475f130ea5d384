"""What all tests share."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings

# A first example may wait for a kernel to be compiled, and any for a busy machine.
settings.register_profile("patient", deadline=None)
settings.load_profile("patient")

SHARED = Path(__file__).parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def houseexpo() -> Path:
    """The folder with HouseExpo's archive and lists, where there is one."""
    folder = SHARED / "houseexpo"
    if not (folder / "json.tar.gz").exists():
        pytest.skip("HouseExpo is not on this machine")
    return folder


@pytest.fixture(scope="session")
def mrpb() -> Path:
    """The folder with the MRPB maps, where there is one."""
    folder = SHARED / "mrpb"
    if not folder.is_dir():
        pytest.skip("the MRPB maps are not on this machine")
    return folder


@pytest.fixture(autouse=True, scope="session")
def cache_of_their_own(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Tests leave the user's cache alone."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(autouse=True, scope="session")
def faults_of_ours_are_seen() -> Iterator[None]:
    """An error that nobody foresaw fails a test with its traceback, and is no exit code."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MAPREPLAY_DEBUG", "1")
        yield
