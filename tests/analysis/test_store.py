"""The cache knows when a log changed, and the work on many logs loses none."""

import os
import shutil
from pathlib import Path

import polars as pl
import pytest

from mapreplay.analysis.metrics.many import MeasuredLog, Unmeasured, measure_logs
from mapreplay.analysis.metrics.measure import Scope, measure_log
from mapreplay.analysis.metrics.store import Store
from mapreplay.analysis.pool import default_jobs, map_unordered
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
    store = Store(tmp_path / "cache")
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
    store = Store(tmp_path / "cache")
    only([log], store)
    times = log.stat().st_mtime_ns
    log.unlink()
    other = record(tmp_path, three_rooms(max_steps=3, seed=4)).path
    os.utime(other, ns=(times, times))  # the same name and the same time
    assert other == log
    assert not only([log], store).known


def test_one_bit_is_a_change(tmp_path: Path, log: Path) -> None:
    store = Store(tmp_path / "cache")
    key = store.key(log, Scope())
    data = bytearray(log.read_bytes())
    data[len(data) // 2] ^= 1
    log.write_bytes(data)
    assert store.key(log, Scope()) != key


def test_another_scope_is_another_table(tmp_path: Path, log: Path) -> None:
    store = Store(tmp_path / "cache")
    only([log], store)
    assert not only([log], store, scope=Scope(UnknownAs.OCCUPIED)).known
    assert not only([log], store, scope=Scope(everywhere=True)).known


def test_further_metrics_are_never_taken_from_the_cache(tmp_path: Path, log: Path) -> None:
    store = Store(tmp_path / "cache")
    for _ in range(2):
        result = only([log], store, metrics=["frontier-size"])
        assert not result.known
        assert "frontier-size" in result.episode().columns


@pytest.mark.parametrize("damage", [b"", b"PAR1 not a table"])
def test_a_damaged_table_is_made_again(tmp_path: Path, log: Path, damage: bytes) -> None:
    store = Store(tmp_path / "cache")
    first = only([log], store)
    first.stored.steps.write_bytes(damage)
    again = only([log], store)
    assert not again.known
    assert len(again.steps().collect()) == 4


def test_the_least_recently_used_goes_first(tmp_path: Path) -> None:
    store = Store(tmp_path)
    frame = pl.DataFrame({"x": [1]})
    kept = [store.keep(key * 64, frame, frame) for key in "abc"]
    size = kept[0].steps.stat().st_size
    for age, stored in enumerate(kept):
        os.utime(stored.steps, (age, age))
        os.utime(stored.episode, (age, age))
    assert store.find("a" * 64) is not None  # used just now
    store.trim(4 * size)
    assert [stored.steps.exists() for stored in kept] == [True, False, True]
    store.trim(0)
    assert not any(path.is_file() for path in tmp_path.rglob("*"))


def test_a_log_that_cannot_be_read_is_a_result_like_others(tmp_path: Path, log: Path) -> None:
    text = tmp_path / "text.mcap"
    text.write_text("hello")
    results = list(measure_logs([text, log], Store(tmp_path / "cache")))
    assert [type(result) for result in results] == [Unmeasured, MeasuredLog]
    (failed,) = [r for r in results if r.log == text]
    assert isinstance(failed, Unmeasured)
    assert isinstance(failed.error, LogError)
    assert str(failed.error) == f"{text}: not an MCAP file"


def test_an_unknown_metric_is_told_before_anything_is_read(tmp_path: Path) -> None:
    with pytest.raises(PluginError, match="unknown metric 'beauty'"):
        list(measure_logs([tmp_path / "none.mcap"], Store(tmp_path), metrics=["beauty"]))


def test_a_store_that_cannot_be_written_is_named(tmp_path: Path, log: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(MapreplayError, match="file: cannot be written"):
        list(measure_logs([log], Store(tmp_path / "file")))


def test_two_processes_measure_what_one_does(tmp_path: Path, log: Path) -> None:
    logs = [log, *(Path(shutil.copy(log, tmp_path / f"{k}.mcap")) for k in range(3))]
    results = list(measure_logs(logs, Store(tmp_path / "two"), jobs=2))
    assert sorted(r.log for r in results) == sorted(logs)
    one = only([log], Store(tmp_path / "one"))
    for result in results:
        assert isinstance(result, MeasuredLog)
        assert result.steps().collect().drop("file").equals(one.steps().collect().drop("file"))


def test_the_death_of_a_process_is_one_line() -> None:
    with pytest.raises(MapreplayError, match="a worker process died"):
        list(map_unordered(os._exit, [9, 9], jobs=2))


def test_a_few_logs_are_not_worth_a_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mapreplay.analysis.pool.cores", lambda: 4)
    assert [default_jobs(n) for n in (0, 1, 31, 32, 1000)] == [1, 1, 1, 2, 4]
