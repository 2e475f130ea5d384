"""Logs that were cut or damaged become finished files, and what is missing is told."""

import random
import struct
from collections.abc import Iterable
from contextlib import suppress
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import pytest
from mcap.opcode import Opcode

from damage import damaged
from mapreplay.errors import ExistsError, LogError
from mapreplay.recorders.log import recover as recovering
from mapreplay.recorders.log.mcap.reader import read_records
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.recorders.log.recover import Recovered, recover
from mapreplay.recorders.log.writer import EpisodeWriter
from mapreplay.step import Outcome, Step, differences
from recordings import Recorded
from repack import TOOLS, Tool, read


@pytest.fixture
def part(tmp_path: Path) -> Path:
    return tmp_path / "a.mcap.part"


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


class Chunk(NamedTuple):
    """Where a chunk record stands in a file."""

    start: int
    end: int


def chunks_of(path: Path) -> list[Chunk]:
    """Those of a log: the first has the true map, the others 20 steps each."""
    whole = path.read_bytes()
    with path.open("rb") as file:
        bodies = [record.body for record in read_records(file) if record.opcode == Opcode.CHUNK]
    starts = [whole.index(body) - 9 for body in bodies]
    return [Chunk(s, s + 9 + len(body)) for s, body in zip(starts, bodies, strict=True)]


def saved_of(path: Path, content: bytes) -> tuple[Recovered, EpisodeLog]:
    """What is recovered of a file with that content, which stays as it is."""
    path.write_bytes(content)
    saved = recover(path, force=True)
    assert saved is not None
    assert path.read_bytes() == content
    return saved, EpisodeLog(saved.path)


def assert_saved(log: EpisodeLog, recorded: Recorded, numbers: list[int]) -> None:
    """Exactly these steps, under their numbers, in every way of reading."""
    assert list(log.indices) == numbers == log.table()["step"].to_list()
    assert len(log) == len(numbers) == log.state.steps
    for step, number in zip(log, numbers, strict=True):
        assert step.index == number
        assert differences(step, recorded.steps[number]) == []
        assert differences(log[number], recorded.steps[number]) == []


@pytest.mark.parametrize("ending", ["index", "no index"])
@pytest.mark.parametrize(
    ("bad", "lost", "words"),
    [
        ([2], [*range(20, 40)], "20 to 39"),
        ([2, 3], [*range(20, 60)], "20 to 59"),
        ([3], [*range(40, 60)], "40 to 59"),
    ],
)
def test_what_lies_behind_a_damaged_chunk_is_saved_too(
    blurred: Recorded, tmp_path: Path, ending: str, bad: list[int], lost: list[int], words: str
) -> None:
    whole, chunks = bytearray(blurred.path.read_bytes()), chunks_of(blurred.path)
    for number in bad:
        whole[(chunks[number].start + chunks[number].end) // 2] ^= 1
    content = bytes(whole if ending == "index" else whole[: chunks[-1].end])
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    with pytest.raises(LogError, match=r"a\.mcap: damaged \(.*\); .*: mapreplay recover /"):
        EpisodeLog(path)
    saved, log = saved_of(path, content)
    assert saved.path == tmp_path / "a.recovered.mcap"
    kept = [k for k in range(61) if k not in lost]
    assert (saved.steps, saved.last, saved.outcome) == (len(kept), 60, Outcome.OUT_OF_STEPS)
    assert len(saved.damages) == len(bad)
    assert_saved(log, blurred, kept)
    assert not log.finished
    assert log.outcome is None
    assert str(log.state) == f"steps {words} are missing; {len(kept)} steps can be read"
    assert recover(saved.path) is None  # it is as good as it gets
    with pytest.raises(LogError, match=rf"steps {words} are missing"):
        log[lost[0]]
    with pytest.raises(IndexError):
        log[61]


def test_the_first_and_the_last_steps_may_be_what_is_lost(
    blurred: Recorded, tmp_path: Path
) -> None:
    """The channels, which the first chunk declares, are in the index, too."""
    whole, chunks = blurred.path.read_bytes(), chunks_of(blurred.path)
    for number, kept in ((1, [*range(20, 61)]), (4, [*range(60)])):
        damaged = bytearray(whole)
        damaged[chunks[number].start + 200] ^= 1
        saved, log = saved_of(tmp_path / "a.mcap", bytes(damaged))
        assert_saved(log, blurred, kept)
        assert (saved.last, saved.whole) == (kept[-1], False)
    assert "all after" not in str(log.state)
    assert str(log.state) == "recovered; 60 steps can be read"


@pytest.mark.parametrize("ending", ["index", "no index"])
@pytest.mark.parametrize("length", [0, 1, 50, 1 << 20, 1 << 60], ids=str)
def test_a_wrong_length_of_a_record_costs_nothing(
    blurred: Recorded, tmp_path: Path, ending: str, length: int
) -> None:
    """A chunk says in itself how long it is."""
    whole, chunks = bytearray(blurred.path.read_bytes()), chunks_of(blurred.path)
    struct.pack_into("<Q", whole, chunks[2].start + 1, length)
    content = bytes(whole if ending == "index" else whole[: chunks[-1].end])
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    with pytest.raises(LogError, match="damaged"):
        EpisodeLog(path)
    _, log = saved_of(path, content)
    assert_saved(log, blurred, [*range(61)])
    assert log.path.read_bytes() == blurred.path.read_bytes()


def test_rubbish_between_records_costs_nothing(blurred: Recorded, tmp_path: Path) -> None:
    whole, chunks = blurred.path.read_bytes(), chunks_of(blurred.path)
    rubbish = random.Random(1).randbytes(3000)
    for at in (chunks[1].start, chunks[2].end):
        content = whole[:at] + rubbish + whole[at:]
        _, log = saved_of(tmp_path / "a.mcap", content)
        assert_saved(log, blurred, [*range(61)])
        cut = content[: chunks[3].end + len(rubbish)]
        _, log = saved_of(tmp_path / "a.mcap", cut)
        assert_saved(log, blurred, [*range(60)])


@pytest.mark.parametrize("place", range(9, 40, 3))
def test_a_damaged_beginning_costs_nothing(blurred: Recorded, tmp_path: Path, place: int) -> None:
    """The header of the file says nothing that is needed."""
    whole = bytearray(blurred.path.read_bytes())
    whole[place] ^= 0x41
    _, log = saved_of(tmp_path / "a.mcap", bytes(whole))
    assert_saved(log, blurred, [*range(61)])


def test_a_damaged_prefix_of_the_metadata_costs_nothing(blurred: Recorded, tmp_path: Path) -> None:
    whole = bytearray(blurred.path.read_bytes())
    place = whole.index(b"mapreplay.episode") - 4 - 9
    assert whole[place] == Opcode.METADATA
    for damage in (0, 3):
        damaged = bytearray(whole)
        damaged[place + damage] ^= 0x55
        _, log = saved_of(tmp_path / "a.mcap", bytes(damaged))
        assert_saved(log, blurred, [*range(61)])


def test_what_nothing_can_be_saved_without_is_named(blurred: Recorded, tmp_path: Path) -> None:
    path, whole = tmp_path / "a.mcap", bytearray(blurred.path.read_bytes())
    truth = chunks_of(blurred.path)[0]
    for place, line in (
        (truth.end - 20, r"its true map cannot be read \(.+\); nothing can be saved without it"),
        (whole.index(b'"seed":') + 7, "checksum of mapreplay.episode does not match"),
    ):
        damaged = bytearray(whole)
        damaged[place] ^= 1
        path.write_bytes(damaged)
        with pytest.raises(LogError, match=line) as caught:
            recover(path)
        assert "mapreplay recover" not in str(caught.value)
        assert [file.name for file in tmp_path.iterdir()] == ["a.mcap"]


def test_messages_without_chunks_are_saved_behind_damage(blurred: Recorded, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    unchunked = {"use_chunking": False, "enable_data_crcs": True}
    Tool(options=unchunked).write(read(blurred.path), path)
    whole = bytearray(path.read_bytes())
    place = len(whole) // 2
    whole[place : place + 3000] = bytes(3000)
    saved, log = saved_of(path, bytes(whole))
    (gap,) = saved.missing
    assert 20 < gap.start < 40
    assert len(gap) <= 2
    assert len(log) == 61 - len(gap)
    for step in log:
        assert differences(step, blurred.steps[step.index]) == []


@pytest.mark.parametrize(
    ("behind", "what"),
    [
        (b"x", "1 byte follows the end of the log and was not read"),
        (bytes(5000), "5000 bytes follow the end of the log (nothing but zeros) and were not read"),
        (b"another log", None),
        (b"the half of one", None),
    ],
    ids=["a byte", "zeros", "another log", "half a log"],
)
def test_what_lies_behind_the_end_is_told(
    blurred: Recorded, tmp_path: Path, behind: bytes, what: str | None
) -> None:
    whole = blurred.path.read_bytes()
    if what is None:
        behind = whole if behind == b"another log" else whole[: len(whole) // 2]
        size = len(behind)
        what = f"{size} bytes follow the end of the log (another MCAP file) and were not read"
    path = tmp_path / "a.mcap"
    path.write_bytes(whole + behind)
    log = EpisodeLog(path)
    assert str(log.state) == what
    assert log.outcome is Outcome.OUT_OF_STEPS
    assert log.finished
    assert not log.state.whole
    assert [differences(a, b) for a, b in zip(log, blurred.steps, strict=True)] == [[]] * 61
    saved, clean = saved_of(path, whole + behind)
    assert str(saved.tail) == what
    assert clean.path.read_bytes() == whole


def test_another_file_behind_one_that_is_cut_off_is_not_mixed_in(
    blurred: Recorded, tmp_path: Path
) -> None:
    whole, chunks = blurred.path.read_bytes(), chunks_of(blurred.path)
    for cut in (chunks[2].end, chunks[3].start + 500):
        saved, log = saved_of(tmp_path / "a.mcap", whole[:cut] + whole)
        assert list(log.indices) == [*range(40)]
        assert saved.outcome is None


def assert_honest(original: Recorded, content: bytes, folder: Path, *, has_crcs: bool) -> None:
    """Whatever is read or recovered of the content is a step of the original, under its number;
    without checksums there may be other values in it.
    """

    def assert_same(step: Step) -> None:
        assert not has_crcs or set(differences(step, original.steps[step.index])) <= {"profile"}

    path = folder / "hurt.mcap"
    path.write_bytes(content)
    with suppress(LogError):
        for step in EpisodeLog(path):
            assert_same(step)
    with suppress(LogError):
        saved = recover(path, force=True)
        if saved is not None:
            log = EpisodeLog(saved.path)
            assert len(log) == saved.steps == len([*log])
            for step in log:
                assert_same(step)
            assert {*log.indices}.isdisjoint(chain.from_iterable(saved.missing))


PACKED = ("ours", "lz4", "not compressed", "small chunks", "no chunks", "data checksum", "by topic")
"""How the file is packed that is damaged."""


def hurt(original: Recorded, seeds: Iterable[int], folder: Path) -> None:
    contents = {"ours": original.path.read_bytes()}
    packed = read(original.path)
    for name in PACKED[1:]:
        contents[name] = TOOLS[name].write(packed, folder / "packed.mcap").read_bytes()
    for seed in seeds:
        name = PACKED[seed % len(PACKED)]
        content = damaged(contents[name], random.Random(seed))
        try:
            assert_honest(original, content, folder, has_crcs=name != "no chunks")
        except BaseException as error:
            error.add_note(f"seed {seed}, {name}")
            raise


def test_whatever_happens_to_a_file_what_is_read_is_right(small: Recorded, tmp_path: Path) -> None:
    hurt(small, range(14), tmp_path)


@pytest.mark.slow
def test_whatever_happens_to_many_files_what_is_read_is_right(
    small: Recorded, tmp_path: Path
) -> None:
    hurt(small, range(300), tmp_path)


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
        writer.add(blurred.steps[0])
        with pytest.raises(LogError, match="another process is writing it"):
            recover(writer.part)


def test_a_disk_that_fills_up_is_not_mistaken_for_damage(
    unfinished: Recorded, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(self: EpisodeWriter, step: object) -> None:
        raise LogError(f"{self.part}: cannot be written (No space left on device)")

    monkeypatch.setattr(recovering.EpisodeWriter, "add", full)
    before = sorted(unfinished.path.parent.iterdir())
    with pytest.raises(LogError, match="No space left"):
        recover(unfinished.path)
    assert sorted(unfinished.path.parent.iterdir()) == before
