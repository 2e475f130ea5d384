"""The cache knows when a log changed, and the work on many logs loses none."""

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from lethal import lethal
from mapreplay.analysis.cache import Cache
from mapreplay.analysis.metrics.many import MeasuredLog, Unmeasured, measure_logs
from mapreplay.analysis.metrics.measure import Scope, measure_log
from mapreplay.analysis.metrics.store import Store, temporary_store
from mapreplay.analysis.pool import WorkerError, default_jobs, map_unordered
from mapreplay.errors import LogError, MapreplayError, PluginError
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.scores import UnknownAs
from recordings import record, three_rooms


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return record(tmp_path, three_rooms(max_steps=3)).path


def only(logs: list[Path], store: Store, **options: object) -> MeasuredLog:
    (result,) = measure_logs(logs, store, **options)  # type: ignore[arg-type]
    assert isinstance(result, MeasuredLog)
    return result


def test_a_log_is_measured_once_even_if_it_is_moved(tmp_path: Path, log: Path) -> None:
    store = Store(Cache(tmp_path / "cache"))
    first = only([log], store)
    assert not first.known
    moved = log.rename(tmp_path / "moved.mcap")
    os.utime(moved, (0, 0))
    again = only([moved], store)
    assert again.known
    assert again.episode()["file"].to_list() == [str(moved)]
    frame = again.steps().collect()
    assert frame["file"].unique().to_list() == [str(moved)]
    assert frame.drop("file").equals(measure_log(EpisodeLog(moved)).steps)


def test_a_log_that_changed_is_measured_anew(tmp_path: Path, log: Path) -> None:
    store = Store(Cache(tmp_path / "cache"))
    only([log], store)
    times = log.stat().st_mtime_ns
    log.unlink()
    other = record(tmp_path, three_rooms(max_steps=3, seed=4)).path
    os.utime(other, ns=(times, times))  # the same name and the same time
    assert other == log
    assert not only([log], store).known


def test_one_bit_is_a_change(tmp_path: Path, log: Path) -> None:
    store = Store(Cache(tmp_path / "cache"))
    key = store.key(log, Scope())
    data = bytearray(log.read_bytes())
    data[len(data) // 2] ^= 1
    log.write_bytes(data)
    assert store.key(log, Scope()) != key


def test_another_scope_is_another_table(tmp_path: Path, log: Path) -> None:
    store = Store(Cache(tmp_path / "cache"))
    only([log], store)
    assert not only([log], store, scope=Scope(UnknownAs.OCCUPIED)).known
    assert not only([log], store, scope=Scope(everywhere=True)).known


def test_further_metrics_are_never_taken_from_the_cache(tmp_path: Path, log: Path) -> None:
    store = Store(Cache(tmp_path / "cache"))
    for _ in range(2):
        result = only([log], store, metrics=["frontier-size"])
        assert not result.known
        assert "frontier-size" in result.episode().columns


def entries(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file())


def damaged(data: bytes) -> Iterator[bytes]:
    """What may become of a kept table."""
    yield b""
    yield b"PAR1 not a table"
    yield data[:-1]
    yield data + b"\0"
    for place in range(0, len(data), 97):
        yield data[:place] + bytes([data[place] ^ 8]) + data[place + 1 :]


def test_a_table_that_is_not_whole_is_made_again(tmp_path: Path, log: Path) -> None:
    store = Store(Cache(tmp_path / "cache"))
    key = store.key(log, Scope())
    honest = only([log], store).steps().collect()
    (entry,) = entries(tmp_path)[:1]
    whole = entry.read_bytes()
    for content in damaged(whole):
        entry.write_bytes(content)
        assert store.find(key) is None
    again = only([log], store)
    assert not again.known
    assert again.steps().collect().equals(honest)
    assert entry.read_bytes() == whole


def test_the_table_of_another_log_is_not_taken(tmp_path: Path, log: Path) -> None:
    store = Store(Cache(tmp_path / "cache"))
    only([log], store)
    (mine,) = entries(tmp_path / "cache")
    other = record(tmp_path / "other", three_rooms(max_steps=5)).path
    honest = only([other], store).steps().collect()
    (theirs,) = set(entries(tmp_path / "cache")) - {mine}
    theirs.write_bytes(mine.read_bytes())
    again = only([other], store)
    assert not again.known
    assert again.steps().collect().equals(honest)


def test_a_whole_entry_that_is_no_table_is_made_again(tmp_path: Path, log: Path) -> None:
    store = Store(Cache(tmp_path / "cache"))
    for content in (b"", b"x", bytes(8), bytes(100), b"\xff" * 100):
        store.cache.put(store.key(log, Scope()), content)
        assert not only([log], store).known


def test_what_is_gone_when_it_is_read_is_measured_again(tmp_path: Path, log: Path) -> None:
    store = Store(Cache(tmp_path / "cache"))
    result = only([log], store)
    honest = result.steps().collect()
    for path in entries(tmp_path / "cache"):
        path.unlink()
    assert result.steps().collect().equals(honest)


@pytest.mark.parametrize("place", ["file", "nowhere"])
def test_without_a_place_to_keep_it_all_is_measured(
    tmp_path: Path, log: Path, place: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("")
    store = Store(Cache(tmp_path / "file" if place == "file" else None))
    for _ in range(2):
        result = only([log], store)
        assert not result.known
        assert len(result.steps().collect()) == 4
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "file"))
    with temporary_store() as store:
        assert len(only([log], store).steps().collect()) == 4


def test_a_log_that_cannot_be_read_is_a_result_like_others(tmp_path: Path, log: Path) -> None:
    text = tmp_path / "text.mcap"
    text.write_text("hello")
    results = list(measure_logs([text, log], Store(Cache(tmp_path / "cache"))))
    assert [type(result) for result in results] == [Unmeasured, MeasuredLog]
    (failed,) = [r for r in results if r.log == text]
    assert isinstance(failed, Unmeasured)
    assert isinstance(failed.error, LogError)
    assert str(failed.error) == f"{text}: not an MCAP file"


def test_an_unknown_metric_is_told_before_anything_is_read(tmp_path: Path) -> None:
    with pytest.raises(PluginError, match="unknown metric 'beauty'"):
        list(measure_logs([tmp_path / "none.mcap"], Store(Cache(tmp_path)), metrics=["beauty"]))


def test_two_processes_measure_what_one_does(tmp_path: Path, log: Path) -> None:
    logs = [log, *(Path(shutil.copy(log, tmp_path / f"{k}.mcap")) for k in range(3))]
    results = list(measure_logs(logs, Store(Cache(tmp_path / "two")), jobs=2))
    assert sorted(r.log for r in results) == sorted(logs)
    one = only([log], Store(Cache(tmp_path / "one")))
    for result in results:
        assert isinstance(result, MeasuredLog)
        assert result.steps().collect().drop("file").equals(one.steps().collect().drop("file"))


def test_the_death_of_a_process_is_one_line() -> None:
    with pytest.raises(MapreplayError, match="a worker process died"):
        list(map_unordered(os._exit, [9, 9], jobs=2))


def told(number: int, error: WorkerError) -> str:
    return f"{number}: {error}"


def test_the_death_of_a_process_costs_the_item_that_it_died_of() -> None:
    results = list(map_unordered(lethal, range(8), jobs=2, lost=told))
    died = (
        "3: item 4 of 8: a worker process died at it (killed by SIGABRT), perhaps for want of "
        "memory; try again with --jobs 1"
    )
    assert sorted(results) == [
        *"012",
        died,
        *"4567",
    ]


def test_a_few_logs_are_not_worth_a_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mapreplay.analysis.pool.cores", lambda: 4)
    assert [default_jobs(n) for n in (0, 1, 31, 32, 1000)] == [1, 1, 1, 2, 4]
