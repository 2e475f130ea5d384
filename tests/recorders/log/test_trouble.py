"""Disks that are full, folders that are read-only, files that vanish: a clear line."""

import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from mapreplay.errors import ExistsError, LogError, WriteError
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.recorders.log.writer import EpisodeWriter
from recordings import Recorded

NOBODY = 65534
TESTS = str(Path(__file__).parents[2] / "helpers")

WRITE = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from recordings import three_rooms
from mapreplay.episode import record
from mapreplay.errors import WriteError
from mapreplay.recorders.log.writer import EpisodeWriter

episode = three_rooms(predictor="blur")
try:
    with EpisodeWriter(Path(sys.argv[2]), episode.header) as writer:
        record(episode, writer)
except WriteError as error:
    print(error)
"""


def limit(size: int) -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))


def write_with_room(path: Path, size: int) -> str:
    """Record in a process whose files may have `size` bytes; what it says."""
    done = subprocess.run(
        [sys.executable, "-c", WRITE, TESTS, str(path)],
        preexec_fn=lambda: limit(size), capture_output=True, text=True, check=True, timeout=120,
    )  # fmt: skip
    assert done.stderr == ""
    return done.stdout


def test_a_full_disk_costs_what_did_not_fit(tmp_path: Path, blurred: Recorded) -> None:
    """The error names the file, and what was written before can be read."""
    path, size = tmp_path / "a.mcap", blurred.path.stat().st_size
    for room, at_least in ((100, None), (size // 2, 20), (size - 5000, 60)):
        said = write_with_room(path, room)
        part = tmp_path / "a.mcap.part"
        assert said == f"{part}: cannot be written (File too large)\n"
        assert not path.exists()
        if at_least is not None:
            log = EpisodeLog(part)
            assert not log.finished
            assert len(log) >= at_least
            assert sum(1 for _ in log) == len(log)
        part.unlink()


def test_a_full_disk_is_noticed_by_the_view(tmp_path: Path, blurred: Recorded) -> None:
    """Rerun itself would wait without end."""
    command = [sys.executable, "-m", "mapreplay", "view", str(blurred.path), "--save"]
    done = subprocess.run(
        [*command, str(tmp_path / "a.rrd")],
        preexec_fn=lambda: limit(50_000), capture_output=True, text=True, check=False, timeout=60,
    )  # fmt: skip
    assert done.returncode == 1
    assert done.stderr == f"mapreplay: {tmp_path}/a.rrd: cannot be written (File too large)\n"
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_written_is_a_clear_error(blurred: Recorded) -> None:
    if not Path("/proc/self").exists():
        pytest.skip("there is no folder here that even root cannot write to")
    for folder in (Path("/proc"), Path("/proc/self/runs")):
        with pytest.raises(WriteError, match=r"cannot be written \(.+\)"):
            EpisodeWriter(folder / "a.mcap", blurred.header)


def test_a_read_only_folder_is_a_clear_error(blurred: Recorded) -> None:
    as_root = os.geteuid() == 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        folder.chmod(0o555)
        if as_root:
            os.seteuid(NOBODY)  # root may write everywhere
        try:
            with pytest.raises(WriteError, match=r"cannot be written \(Permission denied\)"):
                EpisodeWriter(folder / "a.mcap", blurred.header)
        finally:
            if as_root:
                os.seteuid(0)
            folder.chmod(0o755)


@pytest.fixture
def other_writer(tmp_path: Path) -> Iterator[Path]:
    """A log that another process is writing."""
    path = tmp_path / "a.mcap"
    script = WRITE.replace("record(", "print('ready', flush=True); input(); record(")
    process = subprocess.Popen(
        [sys.executable, "-c", script, TESTS, str(path)],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    yield path
    process.communicate("go\n", timeout=60)
    assert EpisodeLog(path).finished


def test_a_second_writer_is_refused_even_with_force(other_writer: Path, blurred: Recorded) -> None:
    for force in (False, True):
        with pytest.raises(LogError, match=r"a\.mcap\.part: another process is writing it"):
            EpisodeWriter(other_writer, blurred.header, force=force)


def test_what_a_dead_writer_left_can_be_overwritten(blurred: Recorded, tmp_path: Path) -> None:
    part = tmp_path / "a.mcap.part"
    part.write_bytes(b"left over" * 100_000)
    with pytest.raises(ExistsError, match=r"an interrupted recording left it: .*mapreplay recover"):
        EpisodeWriter(tmp_path / "a.mcap", blurred.header)
    with EpisodeWriter(tmp_path / "a.mcap", blurred.header, profile=True, force=True) as writer:
        for step in blurred.steps:
            writer.add(step)
    assert (tmp_path / "a.mcap").read_bytes() == blurred.path.read_bytes()


def test_a_log_that_vanishes_is_a_clear_error(blurred: Recorded, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(blurred.path.read_bytes())
    log = EpisodeLog(path)
    path.unlink()
    for read in (list, EpisodeLog.table, lambda log: log[3]):
        with pytest.raises(LogError, match=r"a\.mcap: cannot be read \(No such file"):
            read(log)


def test_a_log_that_is_cut_while_it_is_read_is_a_clear_error(
    blurred: Recorded, tmp_path: Path
) -> None:
    """Never fewer steps without a word: the log said that it was finished."""
    path = tmp_path / "a.mcap"
    path.write_bytes(blurred.path.read_bytes())
    for size in (0, 100, path.stat().st_size // 2):
        path.write_bytes(blurred.path.read_bytes())
        log = EpisodeLog(path)
        steps = log.steps()
        next(steps)
        os.truncate(path, size)
        with pytest.raises(LogError, match=r"a\.mcap: "):
            list(steps)
        with pytest.raises(LogError, match=r"a\.mcap: "):
            list(log)
        with pytest.raises(LogError, match=r"a\.mcap: "):
            log.table()
        with pytest.raises(LogError, match=r"a\.mcap: "):
            log[60]
