"""Recorded episodes for the tests of the log."""

from __future__ import annotations

from pathlib import Path

import pytest

from mapreplay.recorders.log.writer import EpisodeWriter
from recordings import Recorded, record, three_rooms, two_rooms


@pytest.fixture(scope="session")
def blurred(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """A finished log of more than two chunks with a prediction at every step."""
    return record(tmp_path_factory.mktemp("log"), three_rooms(predictor="blur"))


@pytest.fixture(scope="session")
def unpredicted(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """A finished log without a prediction."""
    episode = three_rooms(plan_on="observed", build="observed")
    return record(tmp_path_factory.mktemp("log"), episode)


@pytest.fixture(scope="session")
def small(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """A finished log of a small map: nine steps in chunks of two, some with events."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mapreplay.recorders.log.writer.STEPS_A_CHUNK", 2)
        return record(tmp_path_factory.mktemp("log"), two_rooms())


@pytest.fixture
def unfinished(blurred: Recorded, tmp_path: Path) -> Recorded:
    """The first 50 steps of `blurred`; the writer was killed."""
    writer = EpisodeWriter(tmp_path / "killed.mcap", blurred.header)
    for step in blurred.steps[:50]:
        writer.add(step)
    copy = tmp_path / "copy.mcap.part"
    copy.write_bytes(writer.part.read_bytes())  # what another process sees at this moment
    writer.close()
    return Recorded(copy, blurred.header, blurred.steps[:50])
