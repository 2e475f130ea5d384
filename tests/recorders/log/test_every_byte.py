"""A small log, cut at every byte and with every bit flipped: a clear error, or nothing changes."""

import random
from collections.abc import Iterable
from pathlib import Path

import pytest

from mapreplay.errors import LogError
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.recorders.log.writer import EpisodeWriter
from mapreplay.step import EpisodeHeader, differences
from recordings import Recorded

CUT_EVERY = 23
FLIPS = 500


@pytest.fixture(scope="module")
def killed(small: Recorded, tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """All steps of `small` but the last; the writer was killed."""
    folder = tmp_path_factory.mktemp("killed")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mapreplay.recorders.log.writer.STEPS_A_CHUNK", 2)
        writer = EpisodeWriter(folder / "a.mcap", small.header, profile=True)
        for step in small.steps[:-1]:
            writer.add(step)
    left = writer.part.read_bytes()
    writer.close()
    copy = folder / "killed.mcap.part"
    copy.write_bytes(left)
    return Recorded(copy, small.header, small.steps[:-1])


def same_header(a: EpisodeHeader, b: EpisodeHeader) -> bool:
    return (
        (a.config, a.start, a.max_steps, a.predictor, a.versions)
        == (b.config, b.start, b.max_steps, b.predictor, b.versions)
        and a.floor_plan.sha256 == b.floor_plan.sha256
        and a.floor_plan.id == b.floor_plan.id
    )


def read(path: Path, original: Recorded) -> EpisodeLog | None:
    """The log if it can be read, after a check that nothing in it was invented."""
    try:
        log = EpisodeLog(path)
        steps = list(log)
        if log.finished:
            log.table()
    except LogError as error:
        text = str(error)
        assert text.startswith(f"{path}: ")
        assert "\n" not in text
        assert len(text) < 400
        return None
    assert same_header(log.header, original.header)
    assert len(log) == len(steps) <= len(original.steps)
    # A chunk that is no longer taken for one leaves a gap, which is told.
    numbers = [step.index for step in steps]
    assert numbers == list(log.indices)
    assert log.state.missing or numbers == list(range(len(numbers)))
    for step in steps:
        assert differences(step, original.steps[step.index]) == []
    return log


def cut(original: Recorded, sizes: Iterable[int], folder: Path) -> None:
    whole, path = original.path.read_bytes(), folder / "cut.mcap"
    path.write_bytes(whole)
    lengths: list[int] = []
    with path.open("r+b") as file:
        for size in sorted(sizes, reverse=True):
            file.truncate(size)
            log = read(path, original)
            if log is None:
                lengths.append(-1)
            else:
                assert not log.finished
                lengths.append(len(log))
    assert lengths == sorted(lengths, reverse=True)  # a shorter file never has more
    assert set(lengths) >= {-1, 0, 2, 4, 6, 8}


def test_a_cut_log_is_refused_or_clearly_unfinished(small: Recorded, tmp_path: Path) -> None:
    cut(small, range(0, small.path.stat().st_size, CUT_EVERY), tmp_path)


@pytest.mark.slow
def test_a_log_cut_at_any_byte_is_refused_or_clearly_unfinished(
    small: Recorded, tmp_path: Path
) -> None:
    cut(small, range(small.path.stat().st_size), tmp_path)


def flip(original: Recorded, flips: Iterable[tuple[int, int]], folder: Path) -> int:
    """Flip one (byte, bit) after the other; how many were refused."""
    whole, path = bytearray(original.path.read_bytes()), folder / "flipped.mcap"
    path.write_bytes(whole)
    finished = EpisodeLog(path).finished
    refused = 0
    with path.open("r+b", buffering=0) as file:
        for place, bit in flips:
            file.seek(place)
            file.write(bytes([whole[place] ^ (1 << bit)]))
            log = read(path, original)
            refused += log is None
            if log is not None and finished:
                assert len(log) == len(original.steps)
            file.seek(place)
            file.write(whole[place : place + 1])
    return refused


def some_flips(size: int, count: int) -> list[tuple[int, int]]:
    draw = random.Random(size)
    return [(draw.randrange(size), draw.randrange(8)) for _ in range(count)]


def test_a_flipped_bit_of_a_finished_log_is_refused(small: Recorded, tmp_path: Path) -> None:
    """Only the footer and what follows it can be flipped unnoticed: that looks like a cut."""
    size = small.path.stat().st_size
    assert flip(small, some_flips(size - 37, FLIPS), tmp_path) == FLIPS
    flip(small, [(place, bit) for place in range(size - 37, size) for bit in range(8)], tmp_path)


def test_a_flipped_bit_of_an_unfinished_log_is_refused_or_changes_nothing_that_is_read(
    killed: Recorded, tmp_path: Path
) -> None:
    refused = flip(killed, some_flips(killed.path.stat().st_size, FLIPS), tmp_path)
    assert refused > FLIPS / 2


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["small", "killed"])
@pytest.mark.parametrize("bit", range(8))
def test_every_bit(request: pytest.FixtureRequest, tmp_path: Path, kind: str, bit: int) -> None:
    original: Recorded = request.getfixturevalue(kind)
    flip(original, ((place, bit) for place in range(original.path.stat().st_size)), tmp_path)
