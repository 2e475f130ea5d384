"""Reading a log back: everything that was written, in any order, from whole and partial files."""

import itertools
import pickle
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from mapreplay.config import MapKind
from mapreplay.episode import run_episode
from mapreplay.errors import LogError
from mapreplay.floorplan import explorable
from mapreplay.recorders.log.find import find_logs
from mapreplay.recorders.log.header import EpisodeSummary
from mapreplay.recorders.log.mcap import reader
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.recorders.log.step_table import row_of, table_of
from mapreplay.recorders.log.writer import EpisodeWriter
from mapreplay.step import Mode, Outcome, StepMetrics, differences
from recordings import Recorded, record, three_rooms

WHOLE = ["blurred", "unpredicted"]
ALL = [*WHOLE, "unfinished"]


@pytest.fixture
def recorded(request: pytest.FixtureRequest) -> Recorded:
    value = request.getfixturevalue(request.param)
    assert isinstance(value, Recorded)
    return value


@pytest.mark.parametrize("recorded", ALL, indirect=True)
def test_steps_come_back_bit_for_bit(recorded: Recorded) -> None:
    written = recorded.steps[:40] if "part" in recorded.path.name else recorded.steps
    allowed = [["profile"]] if "part" in recorded.path.name else [[]]
    read = list(EpisodeLog(recorded.path).steps())
    assert [step.index for step in read] == list(range(len(written)))
    assert [differences(a, b) for a, b in zip(read, written, strict=True)] == allowed * len(read)


@pytest.mark.parametrize("recorded", ALL, indirect=True)
def test_any_step_can_be_read_alone(recorded: Recorded) -> None:
    log = EpisodeLog(recorded.path)
    for k in (0, 1, 19, 20, 39, -1, len(log) - 1):
        expected = recorded.steps[k % len(log)]
        assert set(differences(log[k], expected)) <= {"profile"}
    for k in (len(log), -len(log) - 1):
        with pytest.raises(IndexError):
            log[k]


@pytest.mark.parametrize("recorded", ALL, indirect=True)
def test_the_header_comes_back(recorded: Recorded) -> None:
    written, log = recorded.header, EpisodeLog(recorded.path)
    read = log.header
    assert read.floor_plan.sha256 == written.floor_plan.sha256
    assert np.array_equal(read.floor_plan.cells, written.floor_plan.cells)
    for name in ("config", "start", "max_steps", "predictor", "versions"):
        assert getattr(read, name) == getattr(written, name)
    expected = explorable(written.floor_plan.cells, written.start)
    assert np.array_equal(log.header.explorable, expected)


@pytest.mark.parametrize("recorded", WHOLE, indirect=True)
def test_a_finished_log_knows_how_it_ended(recorded: Recorded) -> None:
    log, last = EpisodeLog(recorded.path), recorded.steps[-1]
    assert log.finished
    assert log.outcome is last.outcome
    assert log.summary is not None
    assert log.summary.steps == last.index
    assert log.summary.path_length == last.metrics.path_length
    assert len(log) == len(recorded.steps)


def test_an_unfinished_log_does_not(unfinished: Recorded) -> None:
    log = EpisodeLog(unfinished.path)
    assert not log.finished
    assert log.outcome is None
    assert log.summary is None
    assert len(log) == 40


@pytest.mark.parametrize(
    ("coverage", "correct_coverage", "outcome"),
    [(0.5, 0.3, Outcome.MAPPED), (1.0, 1.0, Outcome.OUT_OF_STEPS)],
)
def test_both_times_are_the_first_steps_that_reached_it(
    tmp_path: Path, coverage: float, correct_coverage: float, outcome: Outcome
) -> None:
    episode = three_rooms(
        predictor="none",
        plan_on="observed",
        build=MapKind.OBSERVED,
        coverage=coverage,
        correct_coverage=correct_coverage,
    )
    recorded = record(tmp_path, episode)
    known = [step.metrics.coverage_observed >= coverage for step in recorded.steps]
    right = [s.metrics.correct_coverage_observed >= correct_coverage for s in recorded.steps]
    last = recorded.steps[-1]
    assert EpisodeLog(recorded.path).summary == EpisodeSummary(
        outcome,
        steps=last.index,
        mapping_time=known.index(True) if any(known) else None,
        correct_time=right.index(True) if any(right) else None,
        path_length=last.metrics.path_length,
    )


@pytest.mark.parametrize("recorded", WHOLE, indirect=True)
def test_the_attachment_is_what_the_steps_say(recorded: Recorded) -> None:
    table = EpisodeLog(recorded.path).table()
    assert table.equals(table_of([row_of(step) for step in recorded.steps]))
    assert table.columns[:7] == [
        "step",
        "row",
        "col",
        "mode",
        "target_row",
        "target_col",
        "utility",
    ]
    assert table.columns[7:] == list(StepMetrics.names())
    row = table.row(5, named=True)
    step = recorded.steps[5]
    assert step.decision is not None
    assert (row["row"], row["col"]) == step.agent
    assert (row["target_row"], row["target_col"]) == step.decision.target
    assert row["mode"] == Mode.NORMAL
    assert row["f1"] == step.metrics.f1
    last = table.row(-1, named=True)
    assert (last["target_row"], last["target_col"], last["utility"]) == (None, None, None)


def test_what_is_undefined_is_null(unpredicted: Recorded) -> None:
    table = EpisodeLog(unpredicted.path).table()
    assert table["brier"].null_count() == len(table)
    assert not any(table[name].is_nan().any() for name in StepMetrics.names())


def test_the_table_of_an_unfinished_log_has_the_same_schema(
    unfinished: Recorded, blurred: Recorded
) -> None:
    part, whole = EpisodeLog(unfinished.path).table(), EpisodeLog(blurred.path).table()
    assert part.schema == whole.schema
    assert part.equals(whole.head(40))
    assert pl.concat([part, whole]).height == len(part) + len(whole)


@pytest.fixture
def chunks_read(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The size of each chunk that was unpacked."""
    sizes, read_chunk = list[int](), reader.read_chunk

    def counting(body: bytes) -> bytes:
        sizes.append(len(body))
        return read_chunk(body)

    monkeypatch.setattr(reader, "read_chunk", counting)
    return sizes


def test_steps_are_read_chunk_by_chunk(blurred: Recorded, chunks_read: list[int]) -> None:
    log = EpisodeLog(blurred.path)
    chunks_read.clear()
    first = list(itertools.islice(log.steps(), 20))
    assert len(first) == 20
    assert len(chunks_read) == 2  # the truth, and the first 20 steps
    chunks_read.clear()
    log[45]
    assert len(chunks_read) == 1


def test_steps_one_by_one_and_slices_read_each_chunk_once(
    blurred: Recorded, chunks_read: list[int]
) -> None:
    log = EpisodeLog(blurred.path)
    chunks = 1 + -(-len(log) // 20)  # the truth, which is logged at step 0, has one of its own
    chunks_read.clear()
    assert [log[k].index for k in range(len(log))] == list(log.indices)
    assert len(chunks_read) == chunks
    log.forget()
    chunks_read.clear()
    assert [step.index for step in log[::-1]] == list(log.indices)[::-1]
    assert len(chunks_read) == chunks


@pytest.mark.parametrize(
    "part", [slice(3, 9), slice(-5, None), slice(None, None, 7), slice(30, 2, -9), slice(9, 9)]
)
def test_a_slice_is_what_a_list_of_steps_would_give(blurred: Recorded, part: slice) -> None:
    expected = blurred.steps[part]
    found = EpisodeLog(blurred.path)[part]
    assert [differences(a, b) for a, b in zip(found, expected, strict=True)] == [[]] * len(expected)


def test_events_are_those_of_the_steps(small: Recorded, chunks_read: list[int]) -> None:
    log = EpisodeLog(small.path)
    expected = [(step.index, event) for step in small.steps for event in step.events]
    assert list(log.events()) == expected != []


def test_logs_steps_and_headers_are_shown_in_short(blurred: Recorded) -> None:
    log = EpisodeLog(blurred.path)
    rows, cols = log.header.floor_plan.shape
    assert f"int8[{rows}, {cols}], start=" in repr(log.header)
    assert repr(log).startswith(f"EpisodeLog('{log.path}': {len(log)} steps, ")
    assert repr(log.header) in repr(log)
    said = repr(log[0])
    assert f"observed=int8[{rows}, {cols}], p_wall=uint8[{rows}, {cols}]" in said
    assert "decision=Decision(normal, target=(" in said
    for text in (said, repr(log), repr(log.header)):
        assert "\n" not in text
        assert len(text) < 600


def test_a_log_can_be_given_to_another_process(blurred: Recorded) -> None:
    log = EpisodeLog(blurred.path)
    log[40], log.table()
    again = pickle.loads(pickle.dumps(log))
    assert differences(again[40], blurred.steps[40]) == []
    assert again.table().equals(log.table())


def test_nobody_can_change_a_log_by_changing_a_step(blurred: Recorded) -> None:
    log = EpisodeLog(blurred.path)
    log[3].observed[:] = 0
    assert differences(log[3], blurred.steps[3]) == []


def test_a_log_that_was_only_begun_has_no_steps(blurred: Recorded, tmp_path: Path) -> None:
    writer = EpisodeWriter(tmp_path / "a.mcap", blurred.header)
    log = EpisodeLog(writer.part)
    assert len(log) == 0
    assert list(log) == []
    assert log.table().height == 0
    writer.close()


def test_every_prediction_dtype_comes_back(tmp_path: Path) -> None:
    for dtype in ("uint8", "uint16", "float32"):
        episode = three_rooms(predictor="blur", prediction_dtype=dtype, max_steps=5)
        path = tmp_path / f"{dtype}.mcap"
        steps = list(run_episode(episode))
        with EpisodeWriter(path, episode.header, profile=True) as writer:
            for step in steps:
                writer.add(step)
        read = list(EpisodeLog(path))
        assert {step.p_wall.dtype.name for step in read if step.p_wall is not None} == {dtype}
        assert [differences(a, b) for a, b in zip(read, steps, strict=True)] == [[]] * len(steps)


def test_a_random_draw_above_the_range_of_int64_comes_back(blurred: Recorded) -> None:
    draws = [step.decision.random_draw for step in EpisodeLog(blurred.path) if step.decision]
    assert max(draw or 0 for draw in draws) > 2**63


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in (
        "b.mcap",
        "a.mcap",
        "deep/er/c.mcap.part",
        "a.diagnosis.json",
        "a.zip",
        "x[1].mcap",
    ):
        file = tmp_path / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(b"")
    return tmp_path


@pytest.mark.parametrize(
    ("asked", "found"),
    [
        (["."], ["a.mcap", "b.mcap", "deep/er/c.mcap.part", "x[1].mcap"]),
        (["b.mcap", "a.mcap"], ["a.mcap", "b.mcap"]),
        (["a.mcap", "*.mcap"], ["a.mcap", "b.mcap", "x[1].mcap"]),
        (["d*"], ["deep/er/c.mcap.part"]),
        (["**/*.part"], ["deep/er/c.mcap.part"]),
        (["x[1].mcap"], ["x[1].mcap"]),
        (["a.mcap", "a.diagnosis.json", "a.zip"], ["a.mcap"]),
        (["a.*"], ["a.mcap"]),
    ],
)
def test_files_folders_and_patterns_find_logs(
    folder: Path, asked: list[str], found: list[str]
) -> None:
    assert find_logs([folder / name for name in asked]) == [folder / name for name in found]


def test_patterns_may_be_relative(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    assert find_logs([Path("deep/**/*.part")]) == [Path("deep/er/c.mcap.part")]


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("none.mcap", r"none\.mcap: no such file or folder"),
        ("none*.mcap", r"none\*\.mcap: matches nothing"),
        ("empty", r"empty: no \.mcap or \.mcap\.part file in it"),
    ],
)
def test_nothing_found_is_an_error(folder: Path, name: str, line: str) -> None:
    (folder / "empty").mkdir()
    with pytest.raises(LogError, match=line):
        find_logs([folder / "a.mcap", folder / name])


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("a.diagnosis.json", r"a\.diagnosis\.json: a diagnosis, not a log; name the \.mcap"),
        ("a.d*", r"a\.diagnosis\.json: a diagnosis, not a log"),
        ("a.zip", r"a\.zip: a zip archive, not a log"),
    ],
)
def test_what_lies_beside_logs_is_no_log(folder: Path, name: str, line: str) -> None:
    with pytest.raises(LogError, match=line):
        find_logs([folder / name])


def test_maps_are_those_of_the_steps(blurred: Recorded) -> None:
    found = list(EpisodeLog(blurred.path).maps("p_wall", "observed"))
    assert len(found) == len(blurred.steps)
    for (p_wall, observed), step in zip(found, blurred.steps, strict=True):
        assert p_wall is not None
        assert step.p_wall is not None
        assert np.array_equal(p_wall, step.p_wall)
        assert np.array_equal(observed, step.observed)


def test_maps_of_a_log_without_a_prediction(unpredicted: Recorded) -> None:
    fused, p_wall = next(EpisodeLog(unpredicted.path).maps("fused", "p_wall"))
    assert np.array_equal(fused, unpredicted.steps[0].fused)
    assert p_wall is None


def test_there_is_no_map_of_another_name(blurred: Recorded) -> None:
    with pytest.raises(ValueError, match="truth"):
        EpisodeLog(blurred.path).maps("truth")
