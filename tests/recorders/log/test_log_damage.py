"""Damaged, changed or newer logs and other files: one clear line, and never wrong data."""

import random
import shutil
from pathlib import Path

import pytest
from mcap.opcode import Opcode
from mcap.writer import Writer

from mapreplay.errors import LogError
from mapreplay.recorders.log.header import _crc, episode_pairs
from mapreplay.recorders.log.mcap.reader import read_records
from mapreplay.recorders.log.mcap.writer import ContainerWriter
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.recorders.log.writer import EpisodeWriter
from mapreplay.step import differences
from recordings import Recorded


def read_all(path: Path) -> EpisodeLog:
    """Read a log in every way."""
    log = EpisodeLog(path)
    steps = list(log)
    assert len(steps) == len(log)
    assert log.table().height == len(log)
    if steps:
        assert differences(log[-1], steps[-1]) == []
    return log


def assert_clear(error: LogError, path: Path) -> None:
    text = str(error)
    assert text.startswith(f"{path}: ")
    assert "\n" not in text
    assert len(text) < 400


@pytest.mark.parametrize("name", ["cut.mcap", "cut.mcap.part"])
def test_a_cut_file_is_read_up_to_the_cut(blurred: Recorded, tmp_path: Path, name: str) -> None:
    """Wherever it is cut, what is left is read as it was written, or there is a clear error."""
    whole, path = blurred.path.read_bytes(), tmp_path / name
    ends = range(len(whole) - 40, len(whole), 4)
    sizes = {*range(0, len(whole), 3001), *range(0, 40, 4), *ends}
    lengths = []
    for size in sorted(sizes):
        path.write_bytes(whole[:size])
        try:
            log = read_all(path)
        except LogError as error:
            assert_clear(error, path)
            assert lengths == []  # only before the true map is complete
            continue
        assert not log.finished
        lengths.append(len(log))
        assert [differences(a, b) for a, b in zip(log, blurred.steps, strict=False)] == [[]] * len(
            log
        )
    assert lengths == sorted(lengths)
    assert set(lengths) == {0, 20, 40, 60, len(blurred.steps)}


@pytest.mark.parametrize("kind", ["blurred", "unfinished"])
def test_a_flipped_bit_is_never_read_as_something_else(
    request: pytest.FixtureRequest, tmp_path: Path, kind: str
) -> None:
    """Either a clear error, or steps that are those that were written."""
    recorded: Recorded = request.getfixturevalue(kind)
    whole, path = bytearray(recorded.path.read_bytes()), tmp_path / "flipped.mcap"
    header = recorded.header
    draw = random.Random(1)
    caught = 0
    for _ in range(150):
        place, bit = draw.randrange(len(whole)), 1 << draw.randrange(8)
        whole[place] ^= bit
        path.write_bytes(whole)
        whole[place] ^= bit
        try:
            log = read_all(path)
        except LogError as error:
            assert_clear(error, path)
            caught += 1
            continue
        assert not log.finished
        assert (log.header.config, log.header.start) == (header.config, header.start)
        assert log.header.floor_plan.sha256 == header.floor_plan.sha256
        for a, b in zip(log, recorded.steps, strict=False):
            assert set(differences(a, b)) <= {"profile"}
    assert caught > 75


def test_a_finished_log_is_checked_when_it_is_opened(blurred: Recorded, tmp_path: Path) -> None:
    whole = bytearray(blurred.path.read_bytes())
    path = tmp_path / "flipped.mcap"
    tail = 37  # footer and magic: a file without them was cut off
    for place in range(8, len(whole) - tail, 501):
        whole[place] ^= 1
        path.write_bytes(whole)
        whole[place] ^= 1
        with pytest.raises(LogError, match=r"flipped\.mcap: damaged \(.*\); copy it again"):
            EpisodeLog(path)


def test_a_flipped_bit_in_the_metadata_of_an_unfinished_log_is_found(
    unfinished: Recorded,
) -> None:
    """MCAP itself has no checksum for it there."""
    whole = unfinished.path.read_bytes()
    assert whole.count(b'"seed":3') == 1
    unfinished.path.write_bytes(whole.replace(b'"seed":3', b'"seed":2'))
    with pytest.raises(LogError, match=r"checksum of mapreplay\.episode does not match"):
        EpisodeLog(unfinished.path)


@pytest.mark.parametrize(
    "content",
    [b"", b"x", b"\x89MCAP0\r", b"not a log at all" * 100, b"\0" * 5000],
    ids=["empty", "one-byte", "cut-magic", "text", "zeros"],
)
def test_other_files_are_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "other.mcap"
    path.write_bytes(content)
    with pytest.raises(LogError, match=r"other\.mcap: not an MCAP file"):
        EpisodeLog(path)


def test_what_is_not_there_or_a_folder_is_refused(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "none.mcap"):
        with pytest.raises(LogError, match=r"cannot be read \(.+\)") as caught:
            EpisodeLog(path)
        assert_clear(caught.value, path)


@pytest.mark.parametrize("end", ["finished", "killed"])
def test_an_mcap_of_something_else_is_refused(tmp_path: Path, end: str) -> None:
    path = tmp_path / "other.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/chat", "json", 0)
        writer.add_message(channel, 1, b"{}", 1)
        writer.add_metadata("somebody", {"format_version": "1"})
        writer.flush()
        if end == "finished":
            writer.finish()
    with pytest.raises(LogError, match=r"an MCAP file with topics /chat: not a log of mapreplay"):
        EpisodeLog(path)


def test_a_newer_log_says_so(
    blurred: Recorded, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mapreplay.recorders.log.header.FORMAT_VERSION", 2)
    with EpisodeWriter(tmp_path / "a.mcap", blurred.header) as writer:
        writer.add(blurred.steps[0])
    monkeypatch.undo()
    with pytest.raises(LogError, match=r"log format 2 is newer than 1.*upgrade mapreplay"):
        EpisodeLog(writer.part)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"floor_plan_sha256": "0" * 64}, "the true map is not the one"),
        ({"config": '{"rays": 7}'}, "its configuration: rays = 7"),
        ({"config": "[]"}, "configuration"),
        ({"start": "[0, 0]"}, "is not a free cell"),
        ({"start": "no"}, "damaged"),
        ({"resolution": "-1.0"}, "resolution"),
        ({"floor_plan_id": "../../etc"}, "an id is"),
        ({"format_version": "one"}, "damaged"),
        ({"max_steps": "many"}, "damaged"),
    ],
)
def test_a_log_that_lies_is_refused(
    blurred: Recorded,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    changes: dict[str, str],
    reason: str,
) -> None:
    """All checksums are right, but what the file says makes no sense."""
    honest = episode_pairs(blurred.header)
    del honest["crc32"]
    lies = honest | changes
    lies["crc32"] = _crc(lies)
    monkeypatch.setattr("mapreplay.recorders.log.writer.episode_pairs", lambda _: lies)
    with EpisodeWriter(tmp_path / "a.mcap", blurred.header) as writer:
        writer.add(blurred.steps[0])
    with pytest.raises(LogError, match=reason) as caught:
        EpisodeLog(writer.part)
    assert_clear(caught.value, writer.part)


@pytest.mark.parametrize(
    ("chunk", "reason"),
    [
        (0, "/map/observed is None as cdr, and not"),
        (1, "a channel that"),
    ],
    ids=["true map", "steps 0 to 19"],
)
def test_a_missing_chunk_with_declarations_is_found(
    blurred: Recorded, tmp_path: Path, chunk: int, reason: str
) -> None:
    """The chunk of the first steps also declares the channels of the others."""
    path = tmp_path / "a.mcap.part"
    path.write_bytes(without_chunk(blurred, chunk))
    with pytest.raises(LogError, match=reason):
        EpisodeLog(path)


def test_steps_that_are_missing_in_the_middle_are_told(blurred: Recorded, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap.part"
    path.write_bytes(without_chunk(blurred, 2))
    log = EpisodeLog(path)
    assert [step.index for step in log] == [*range(20), *range(40, 61)]
    assert str(log.state) == "unfinished; steps 20 to 39 are missing; 41 steps can be read"
    with pytest.raises(LogError, match="steps 20 to 39 are missing"):
        log[30]


def without_chunk(recorded: Recorded, chunk: int) -> bytes:
    """An unfinished log without one of its chunks, and without all that follows the last."""
    whole = recorded.path.read_bytes()
    with recorded.path.open("rb") as file:
        bodies = [r.body for r in read_records(file) if r.opcode == Opcode.CHUNK]
    start, end = whole.index(bodies[chunk]) - 9, whole.index(bodies[-1]) + len(bodies[-1])
    return whole[:start] + whole[start + 9 + len(bodies[chunk]) : end]


def test_a_log_may_be_moved(blurred: Recorded, tmp_path: Path) -> None:
    moved = tmp_path / "any name, really.mcap"
    shutil.copy(blurred.path, moved)
    assert read_all(moved).finished


def test_a_message_that_is_logged_at_another_time_is_of_the_step_that_it_is_stamped_with(
    tmp_path: Path, blurred: Recorded, monkeypatch: pytest.MonkeyPatch
) -> None:
    add = ContainerWriter.add_message

    def add_late(self: ContainerWriter, channel: int, sequence: int, ns: int, data: bytes) -> None:
        add(self, channel, sequence, ns + (sequence == 2), data)

    monkeypatch.setattr(ContainerWriter, "add_message", add_late)
    path = tmp_path / "late.mcap"
    with EpisodeWriter(path, blurred.header) as writer:
        for step in blurred.steps:
            writer.add(step)
    read = list(EpisodeLog(path))
    assert [set(differences(a, b)) for a, b in zip(read, blurred.steps, strict=True)] == [
        {"profile"}
    ] * 61
