"""Writing a log: names, overwriting, interruptions, and the same bytes for the same steps."""

import errno
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader

from mapreplay.episode import run_episode
from mapreplay.errors import ExistsError, LogError, WriteError
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.recorders.log.writer import EpisodeWriter
from mapreplay.step import differences
from recordings import Recorded, record, three_rooms


def test_the_same_steps_give_the_same_bytes(blurred: Recorded, tmp_path: Path) -> None:
    again = tmp_path / "other-name.mcap"
    with EpisodeWriter(again, blurred.header, profile=True) as writer:
        for step in blurred.steps:
            writer.add(step)
    assert again.read_bytes() == blurred.path.read_bytes()


def test_the_same_seed_gives_the_same_bytes(tmp_path: Path) -> None:
    """Without the profile: wall-clock times are the one thing that is not reproducible."""
    logs = []
    for name in ("a.mcap", "b.mcap"):
        episode = three_rooms(predictor="blur")
        with EpisodeWriter(tmp_path / name, episode.header) as writer:
            for step in run_episode(episode):
                writer.add(step)
        logs.append((tmp_path / name).read_bytes())
    assert logs[0] == logs[1]


def test_the_profile_is_kept_only_if_asked_for(blurred: Recorded, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with EpisodeWriter(path, blurred.header) as writer:
        for step in blurred.steps:
            writer.add(step)
    assert [differences(a, b) for a, b in zip(EpisodeLog(path), blurred.steps, strict=True)] == [
        ["profile"]
    ] * len(blurred.steps)


def test_until_its_last_step_a_log_is_a_part(blurred: Recorded, tmp_path: Path) -> None:
    path = tmp_path / "new" / "folder" / "a.mcap"
    with EpisodeWriter(path, blurred.header) as writer:
        for step in blurred.steps:
            assert writer.part.exists()
            assert not path.exists()
            writer.add(step)
    assert [p.name for p in path.parent.iterdir()] == ["a.mcap"]


def test_without_its_last_step_a_log_stays_a_part(blurred: Recorded, tmp_path: Path) -> None:
    with EpisodeWriter(tmp_path / "a.mcap", blurred.header) as writer:
        for step in blurred.steps[:25]:
            writer.add(step)
    assert [p.name for p in tmp_path.iterdir()] == ["a.mcap.part"]
    assert len(EpisodeLog(writer.part)) == 25


def test_after_an_exception_all_written_steps_are_there(blurred: Recorded, tmp_path: Path) -> None:
    def interrupted() -> EpisodeWriter:
        with EpisodeWriter(tmp_path / "a.mcap", blurred.header) as writer:
            for step in blurred.steps[:33]:
                writer.add(step)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert len(EpisodeLog(tmp_path / "a.mcap.part")) == 33


def test_a_kill_costs_at_most_20_steps(tmp_path: Path) -> None:
    """A process that is killed while it records: every chunk it closed can be read."""
    script = """
import os, signal, sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from recordings import three_rooms
from mapreplay.episode import run_episode
from mapreplay.recorders.log.writer import EpisodeWriter

episode = three_rooms()
writer = EpisodeWriter(Path(sys.argv[2]), episode.header)
for step in run_episode(episode):
    writer.add(step)
    if step.index == 50:
        os.kill(os.getpid(), signal.SIGKILL)
"""
    tests = str(Path(__file__).parents[2] / "helpers")
    path = tmp_path / "a.mcap"
    done = subprocess.run([sys.executable, "-c", script, tests, path], check=False, timeout=120)
    assert done.returncode == -signal.SIGKILL
    log = EpisodeLog(tmp_path / "a.mcap.part")
    assert not log.finished
    assert len(log) == 40
    expected = list(run_episode(three_rooms()))[:40]
    assert {name for a, b in zip(log, expected, strict=True) for name in differences(a, b)} == {
        "profile"
    }


def test_nothing_is_overwritten_without_force(blurred: Recorded, tmp_path: Path) -> None:
    path, part = tmp_path / "a.mcap", tmp_path / "a.mcap.part"
    path.write_bytes(b"mine")
    with pytest.raises(ExistsError, match=r"a\.mcap: exists; .* --force"):
        EpisodeWriter(path, blurred.header)
    path.unlink()
    part.write_bytes(b"mine")
    with pytest.raises(ExistsError, match=r"a\.mcap\.part: exists; .* --force"):
        EpisodeWriter(path, blurred.header)
    assert part.read_bytes() == b"mine"


def test_a_file_that_appeared_meanwhile_is_not_overwritten(
    blurred: Recorded, tmp_path: Path
) -> None:
    path = tmp_path / "a.mcap"
    writer = EpisodeWriter(path, blurred.header)
    for step in blurred.steps:
        writer.add(step)
    path.write_bytes(b"mine")
    with pytest.raises(ExistsError, match=r"a\.mcap: exists"):
        writer.close()
    assert path.read_bytes() == b"mine"
    assert EpisodeLog(writer.part).finished


def test_with_force_both_names_are_overwritten(tmp_path: Path) -> None:
    path, part = tmp_path / "a.mcap", tmp_path / "a.mcap.part"
    path.write_bytes(b"old")
    part.write_bytes(b"old")
    episode = three_rooms(max_steps=3)
    with EpisodeWriter(path, episode.header, force=True) as writer:
        for step in run_episode(episode):
            writer.add(step)
    assert EpisodeLog(path).finished
    assert not part.exists()


def test_another_suffix_is_refused(blurred: Recorded, tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"ends in \.mcap"):
        EpisodeWriter(tmp_path / "a.bag", blurred.header)


def test_steps_come_in_order(blurred: Recorded, tmp_path: Path) -> None:
    with EpisodeWriter(tmp_path / "a.mcap", blurred.header) as writer:
        writer.add(blurred.steps[0])
        with pytest.raises(ValueError, match="step 2 does not follow 1 steps"):
            writer.add(blurred.steps[2])


def test_nothing_follows_the_last_step(blurred: Recorded, tmp_path: Path) -> None:
    last = blurred.steps[-1]
    with EpisodeWriter(tmp_path / "a.mcap", blurred.header) as writer:
        for step in blurred.steps:
            writer.add(step)
        with pytest.raises(ValueError, match="does not follow"):
            writer.add(replace(last, index=last.index + 1))


def test_closing_twice_is_harmless(tmp_path: Path) -> None:
    episode = three_rooms(max_steps=2)
    with EpisodeWriter(tmp_path / "a.mcap", episode.header) as writer:
        for step in run_episode(episode):
            writer.add(step)
        writer.close()
    assert EpisodeLog(writer.path).finished


def test_a_folder_that_is_a_file_is_a_clear_error(blurred: Recorded, tmp_path: Path) -> None:
    (tmp_path / "runs").write_bytes(b"")
    with pytest.raises(ExistsError, match=r"runs: is a file, or in one") as caught:
        EpisodeWriter(tmp_path / "runs" / "a.mcap", blurred.header)
    assert "\n" not in str(caught.value)


class FullDisk:
    """A file on a disk that has no space left after so many bytes."""

    def __init__(self, file: Any, room: int) -> None:
        self._file, self._room = file, room

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)

    def write(self, data: bytes) -> int:
        self._room -= len(data)
        if self._room < 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        return int(self._file.write(data))


def test_a_full_disk_is_a_clear_error(
    blurred: Recorded, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with EpisodeWriter(tmp_path / "short.mcap", blurred.header) as writer:
        for step in blurred.steps[:20]:
            writer.add(step)
    room = writer.part.stat().st_size + 100
    opened = Path.open
    monkeypatch.setattr(Path, "open", lambda self, mode: FullDisk(opened(self, mode), room))
    writer = EpisodeWriter(tmp_path / "a.mcap", blurred.header)
    for step in blurred.steps[:39]:
        writer.add(step)
    with pytest.raises(WriteError, match=r"a\.mcap\.part: cannot be written \(No space left"):
        writer.add(blurred.steps[39])
    monkeypatch.undo()
    assert len(EpisodeLog(tmp_path / "a.mcap.part")) == 20


def test_chunks_stay_small_on_large_maps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A chunk ends with the step that fills it, even before 20 steps."""
    monkeypatch.setattr("mapreplay.recorders.log.writer.CHUNK_BYTES", 3000)
    recorded = record(tmp_path, three_rooms(max_steps=30))
    log = EpisodeLog(recorded.path)
    assert [differences(a, b) for a, b in zip(log, recorded.steps, strict=True)] == [[]] * 31
    assert differences(log[17], recorded.steps[17]) == []
    with recorded.path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert len(summary.chunk_indexes) > 10
