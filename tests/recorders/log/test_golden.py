"""Logs of every format version stay readable, to the last bit; see tests/helpers/golden.py."""

import json
from pathlib import Path

import pytest

from golden import FOLDER, described
from mapreplay.recorders.log.header import FORMAT_VERSION
from mapreplay.recorders.log.reader import EpisodeLog

LOGS = sorted(FOLDER.glob("v*.mcap"))


def assert_kept(now: object, then: object, where: str = "log") -> None:
    """What the log said then it says now; a later version may say more."""
    if isinstance(now, dict) and isinstance(then, dict):
        for key, value in then.items():
            assert_kept(now[key], value, f"{where}.{key}")
    elif isinstance(now, list) and isinstance(then, list):
        assert len(now) == len(then), where
        for k, (a, b) in enumerate(zip(now, then, strict=True)):
            assert_kept(a, b, f"{where}[{k}]")
    else:
        assert now == then or (now != now and then != then), where


def test_there_is_one_of_every_version() -> None:
    assert [log.stem for log in LOGS] == [f"v{n}" for n in range(1, FORMAT_VERSION + 1)]


@pytest.mark.parametrize("path", LOGS, ids=lambda path: path.stem)
def test_it_says_what_it_said(path: Path) -> None:
    assert path.stat().st_size < 30_000
    then = json.loads(path.with_suffix(".json").read_text())
    assert_kept(json.loads(described(EpisodeLog(path))), then)
