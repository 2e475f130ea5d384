"""A bundle is safe, small, the same every time, and its log is a log."""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from pathlib import Path

import pytest

from mapreplay.analysis.bundling import LOG_NAME, bundle
from mapreplay.analysis.verification import verify
from mapreplay.errors import UsageError
from mapreplay.recorders.log.reader import EpisodeLog

SEALED = (
    Path(__file__).parents[2]
    / "samples/episodes/procedural-60014__cost-utility__fused-fused__s1.mcap"
)


def opened(data: bytes) -> zipfile.ZipFile:
    return zipfile.ZipFile(io.BytesIO(data))


def test_it_holds_what_its_manifest_says() -> None:
    log = EpisodeLog(SEALED)
    made = bundle(log)
    assert bundle(log).data == made.data
    assert (made.steps, made.whole) == (len(log), True)
    assert len(made.data) < 2_000_000
    with opened(made.data) as archive:
        names = archive.namelist()
        assert names[0] == "manifest.json"
        assert all("/" not in name and "\\" not in name for name in names)
        manifest = json.loads(archive.read("manifest.json"))
        assert [entry["name"] for entry in manifest["files"]] == sorted(names[1:])
        for entry in manifest["files"]:
            data = archive.read(entry["name"])
            assert (len(data), hashlib.sha256(data).hexdigest()) == (
                entry["bytes"],
                entry["sha256"],
            )
        assert archive.read(LOG_NAME) == SEALED.read_bytes()
        assert "sealed in at step 10" in archive.read("diagnosis.txt").decode()
        assert archive.read("diagnosis.png").startswith(b"\x89PNG")


def test_a_part_is_a_log_of_its_own(tmp_path: Path) -> None:
    log = EpisodeLog(SEALED)
    made = bundle(log, until=5)
    assert (made.steps, made.whole) == (6, False)
    with opened(made.data) as archive:
        archive.extract(LOG_NAME, tmp_path)
    part = EpisodeLog(tmp_path / LOG_NAME)
    assert (len(part), part.finished) == (6, False)
    assert verify(part).agrees
    with pytest.raises(UsageError, match="--until 99"):
        bundle(log, until=99)
