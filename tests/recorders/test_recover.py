"""Logs that were cut or damaged become finished files, and what is missing is told."""

from pathlib import Path

import pytest

from mapreplay.errors import ExistsError, LogError
from mapreplay.recorders.log import recover as recovering
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.recorders.log.recover import recover
from mapreplay.recorders.log.writer import EpisodeWriter
from mapreplay.step import differences
from recordings import Recorded


@pytest.fixture
def part(tmp_path: Path) -> Path:
    return tmp_path / "a.mcap.part"


def assert_steps(log: EpisodeLog, recorded: Recorded, count: int) -> None:
    assert len(log) == log.table().height == count
    for read, written in zip(log, recorded.steps[:count], strict=True):
        assert differences(read, written) == []


def test_a_log_that_lost_only_its_index_becomes_the_undisturbed_file(
    blurred: Recorded, part: Path
) -> None:
    whole = blurred.path.read_bytes()
    for size in (len(whole), len(whole) - 1, len(whole) - 5000):
        part.write_bytes(whole[:size])
        saved = recover(part, force=True)
        assert saved is not None
        assert (saved.path, saved.whole, saved.steps) == (part.with_suffix(""), True, 61)
        assert saved.path.read_bytes() == whole
    assert part.exists()
    assert {path.name for path in part.parent.iterdir()} == {"a.mcap", "a.mcap.part"}


def test_what_was_cut_off_stays_unknown(unfinished: Recorded) -> None:
    saved = recover(unfinished.path)
    assert saved is not None
    assert (saved.steps, saved.last, saved.outcome, saved.whole) == (40, 39, None, False)
    assert (saved.missing, saved.damages, saved.tail) == ((), (), None)
    log = EpisodeLog(saved.path)
    assert not log.finished
    assert log.outcome is None
    assert log.summary is not None
    assert log.summary.steps == 39
    assert set(differences(log[39], unfinished.steps[39])) <= {"profile"}
    assert recover(saved.path) is None  # it is as good as it gets


def test_a_damaged_chunk_is_named_and_what_is_before_it_is_saved(
    blurred: Recorded, tmp_path: Path
) -> None:
    path, whole = tmp_path / "a.mcap", bytearray(blurred.path.read_bytes())
    with EpisodeWriter(tmp_path / "b.mcap", blurred.header, profile=True) as writer:
        for step in blurred.steps[:20]:
            writer.write(step)
    whole[writer.part.stat().st_size + 2000] ^= 1  # somewhere in the chunk of steps 20 to 39
    path.write_bytes(whole)
    with pytest.raises(LogError, match="checksum"):
        EpisodeLog(path)
    saved = recover(path)
    assert saved is not None
    assert saved.path == tmp_path / "a.recovered.mcap"
    assert saved.damage is not None
    assert saved.damage.startswith(f"{path}: damaged (")
    assert_steps(EpisodeLog(saved.path), blurred, 20)
    assert path.read_bytes() == bytes(whole)


def test_where_not_even_a_step_is_left_nothing_is_written(blurred: Recorded, part: Path) -> None:
    for size in (0, 100, 6000):
        part.write_bytes(blurred.path.read_bytes()[:size])
        with pytest.raises(LogError, match=r"a\.mcap\.part: "):
            recover(part)
        assert list(part.parent.iterdir()) == [part]


def test_nothing_is_overwritten_without_force(blurred: Recorded, part: Path) -> None:
    part.write_bytes(blurred.path.read_bytes())
    part.with_suffix("").write_bytes(b"mine")
    with pytest.raises(ExistsError, match=r"a\.mcap: exists; .* --force"):
        recover(part)
    assert part.with_suffix("").read_bytes() == b"mine"
    assert recover(part, force=True) is not None


def test_a_log_that_is_being_written_is_left_alone(blurred: Recorded, tmp_path: Path) -> None:
    with EpisodeWriter(tmp_path / "a.mcap", blurred.header) as writer:
        writer.write(blurred.steps[0])
        with pytest.raises(LogError, match="another process is writing it"):
            recover(writer.part)


def test_a_disk_that_fills_up_is_not_mistaken_for_damage(
    unfinished: Recorded, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(self: EpisodeWriter, step: object) -> None:
        raise LogError(f"{self.part}: cannot be written (No space left on device)")

    monkeypatch.setattr(recovering.EpisodeWriter, "write", full)
    before = sorted(unfinished.path.parent.iterdir())
    with pytest.raises(LogError, match="No space left"):
        recover(unfinished.path)
    assert sorted(unfinished.path.parent.iterdir()) == before
