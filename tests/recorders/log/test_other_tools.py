"""MCAP files of other tools: all that MCAP allows is read, and what is missing is named."""

import struct
from dataclasses import replace
from pathlib import Path

import polars as pl
import pytest
from mcap.opcode import Opcode
from mcap.writer import Writer
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer
from rosbags.typesys import Stores, get_typestore

from mapreplay.analysis.verification import verify
from mapreplay.errors import LogError
from mapreplay.recorders.log.mcap.reader import read_records
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.recorders.log.recover import recover
from mapreplay.recorders.log.state import Condition
from mapreplay.step import differences
from recordings import Recorded
from repack import (
    TOOLS,
    Contents,
    Tool,
    read,
    without,
    without_records,
)


@pytest.fixture(scope="module")
def contents(blurred: Recorded) -> Contents:
    return read(blurred.path)


@pytest.mark.parametrize("tool", TOOLS)
def test_whatever_a_tool_did_the_steps_are_the_same(
    blurred: Recorded, contents: Contents, tmp_path: Path, tool: str
) -> None:
    path = TOOLS[tool].write(contents, tmp_path / "a.mcap")
    log, ours = EpisodeLog(path), EpisodeLog(blurred.path)
    allowed = {"profile"} if tool == "filtered for viewers" else set()
    for read_back, written in zip(log, blurred.steps, strict=True):
        assert set(differences(read_back, written)) <= allowed
    assert log.state.whole, str(log.state)
    assert (log.outcome, log.summary, len(log)) == (ours.outcome, ours.summary, 61)
    assert log.table().equals(ours.table())
    assert [m[0].tobytes() for m in log.maps("observed") if m[0] is not None] == [
        step.observed.tobytes() for step in blurred.steps
    ]
    for k in (0, 19, 20, 45, -1):
        assert set(differences(log[k], blurred.steps[k])) <= allowed
    assert recover(path) is None  # nothing is wrong with it


def test_verify_says_that_another_tool_packed_it(contents: Contents, tmp_path: Path) -> None:
    packed = Tool(without_records, options={"use_chunking": False})
    result = verify(EpisodeLog(packed.write(contents, tmp_path / "a.mcap")))
    assert result.agrees
    assert result.steps == 61
    by, table, outcome = result.notes[:3]
    assert by == "packed by 'another tool' and not as mapreplay does it: its checksums are not ours"
    assert "steps.parquet" in table
    assert "mapreplay.outcome" in outcome


def test_verify_says_nothing_of_a_log_of_ours(blurred: Recorded) -> None:
    assert EpisodeLog(blurred.path).repacked == ()


@pytest.mark.parametrize(
    "topic",
    ["/map/truth", "/pose", "/scan", "/map/observed", "/map/p_wall", "/map/fused", "/frontier",
     "/plan", "/decision", "/metrics"],
)  # fmt: skip
@pytest.mark.parametrize("options", [{}, {"use_chunking": False}], ids=["chunks", "no chunks"])
def test_a_topic_that_was_left_out_is_named(
    contents: Contents, tmp_path: Path, topic: str, options: dict[str, object]
) -> None:
    """Never a log in which nothing was predicted, decided or scanned."""
    path = Tool(without(topic), options=options).write(contents, tmp_path / "a.mcap")
    with pytest.raises(LogError, match=rf"a\.mcap: messages on {topic} are missing, which an") as e:
        EpisodeLog(path)
    assert "damaged" not in str(e.value)


def test_metadata_that_was_left_out_is_named(contents: Contents, tmp_path: Path) -> None:
    bare = Contents(contents.messages, [], contents.attachments)
    path = Tool().write(bare, tmp_path / "a.mcap")
    with pytest.raises(LogError, match=r"topics of a log, but no metadata 'mapreplay\.episode'"):
        EpisodeLog(path)


def test_a_part_in_time_is_a_log_with_steps_missing(contents: Contents, tmp_path: Path) -> None:
    def cut_out(c: Contents) -> Contents:
        kept = [m for m in c.messages if m.topic == "/map/truth" or 10 <= m.sequence < 30]
        return Contents(kept, c.metadata, c.attachments)

    log = EpisodeLog(Tool(cut_out).write(contents, tmp_path / "a.mcap"))
    assert [step.index for step in log] == list(range(10, 30))
    assert log.state.missing == (range(10), range(30, 61))
    assert not log.finished
    assert log.table()["step"].to_list() == list(range(10, 30))


def test_a_step_without_one_of_its_messages_is_missing(contents: Contents, tmp_path: Path) -> None:
    def lose(c: Contents) -> Contents:
        kept = [m for m in c.messages if (m.topic, m.sequence) != ("/map/fused", 33)]
        return Contents(kept, c.metadata, c.attachments)

    log = EpisodeLog(Tool(lose).write(contents, tmp_path / "a.mcap"))
    assert [step.index for step in log] == [k for k in range(61) if k != 33]
    assert str(log.state) == "step 33 is missing; 60 steps can be read"
    saved = recover(log.path)
    assert saved is not None
    assert saved.missing == (range(33, 34),)


def test_a_log_without_steps_says_so_when_one_is_asked_for(
    contents: Contents, tmp_path: Path
) -> None:
    def only_truth(c: Contents) -> Contents:
        truth = [m for m in c.messages if m.topic == "/map/truth"]
        return Contents(truth, [m for m in c.metadata if m[0] == "mapreplay.episode"], [])

    log = EpisodeLog(Tool(only_truth).write(contents, tmp_path / "a.mcap"))
    with pytest.raises(LogError, match=r"a\.mcap: unfinished; 0 steps can be read"):
        log[-1]


def test_a_message_that_is_damaged_under_right_checksums_is_left_out(
    contents: Contents, tmp_path: Path
) -> None:
    def shorten(c: Contents) -> Contents:
        hurt = [
            replace(m, data=m.data[:-9]) if (m.topic, m.sequence) == ("/scan", 33) else m
            for m in c.messages
        ]
        return Contents(hurt, c.metadata, c.attachments)

    saved = recover(Tool(shorten).write(contents, tmp_path / "a.mcap"))
    assert saved is not None
    assert saved.missing == (range(33, 34),)
    assert len(list(EpisodeLog(saved.path))) == 60


def test_two_episodes_in_one_file_are_not_mixed(
    contents: Contents, unpredicted: Recorded, tmp_path: Path
) -> None:
    def merge(c: Contents) -> Contents:
        messages = c.messages + read(unpredicted.path).messages
        return Contents(sorted(messages, key=lambda m: m.log_time), c.metadata, c.attachments)

    path = Tool(merge).write(contents, tmp_path / "a.mcap")
    with pytest.raises(LogError, match=r"step 0 is in it more than once, and not the same"):
        list(EpisodeLog(path))


def test_an_unfinished_log_that_was_repacked_is_unfinished(
    contents: Contents, tmp_path: Path
) -> None:
    def stop(c: Contents) -> Contents:
        return without_records(Contents([m for m in c.messages if m.sequence < 7], c.metadata, []))

    log = EpisodeLog(Tool(stop).write(contents, tmp_path / "a.mcap"))
    assert (log.state.condition, len(log), log.summary) == (Condition.UNFINISHED, 7, None)


def string_bag(folder: Path, plugin: StoragePlugin) -> Path:
    store = get_typestore(Stores.ROS2_HUMBLE)
    text = store.types["std_msgs/msg/String"]
    with Rosbag2Writer(folder, version=9, storage_plugin=plugin) as bag:
        for topic in ("/odom", "/chatter"):
            connection = bag.add_connection(topic, text.__msgtype__, typestore=store)
            bag.write(connection, 1, store.serialize_cdr(text("hello"), text.__msgtype__))
    (path,) = [file for file in folder.iterdir() if file.suffix != ".yaml"]
    return path


def ros1_bag(path: Path) -> Path:
    store = get_typestore(Stores.ROS1_NOETIC)
    text = store.types["std_msgs/msg/String"]
    with Rosbag1Writer(path) as bag:
        connection = bag.add_connection("/chatter", text.__msgtype__, typestore=store)
        bag.write(connection, 1, store.serialize_ros1(text("hello"), text.__msgtype__))
    return path


def test_bags_of_ros_are_told_by_what_they_are(tmp_path: Path) -> None:
    mcap = string_bag(tmp_path / "a", StoragePlugin.MCAP)
    sqlite = string_bag(tmp_path / "b", StoragePlugin.SQLITE3)
    ros1 = ros1_bag(tmp_path / "c.bag")
    for path, line in (
        (mcap, "a ROS 2 bag with topics /chatter, /odom: not a log of mapreplay"),
        (sqlite, "not an MCAP file: a SQLite database (a ROS 2 bag, .db3?)"),
        (ros1, "not an MCAP file: a ROS 1 bag"),
    ):
        with pytest.raises(LogError) as caught:
            EpisodeLog(path)
        assert str(caught.value) == f"{path}: {line}"


def test_a_bag_that_was_cut_off_is_told_by_its_topics(tmp_path: Path) -> None:
    path = string_bag(tmp_path / "a", StoragePlugin.MCAP)
    path.write_bytes(path.read_bytes()[:-60])
    with pytest.raises(LogError, match="a ROS 2 bag with topics /chatter, /odom: not a log"):
        EpisodeLog(path)


def test_many_topics_are_not_all_named(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        for k in range(30):
            writer.add_message(writer.register_channel(f"/t{k:02}", "json", 0), 1, b"{}", 1)
        writer.finish()
    with pytest.raises(LogError, match=r"an MCAP file with topics /t00, .*, /t07 \.\.\.: not"):
        EpisodeLog(path)


LFS = b"version https://git-lfs.github.com/spec/v1\noid sha256:" + b"0" * 64 + b"\nsize 56953\n"


@pytest.mark.parametrize(
    ("content", "what"),
    [
        (LFS, "a Git LFS pointer, not the file itself; run git lfs pull"),
        (b"\x1f\x8b\x08rest", "gzip-compressed; unpack it with gunzip"),
        (b"<!DOCTYPE html><html>Not found", "a web page"),
        (b"", "an empty file"),
        (bytes(1000), "zero bytes, as after a broken copy"),
    ],
    ids=["lfs", "gzip", "web page", "empty", "zeros"],
)
def test_what_is_no_mcap_is_told_by_what_it_is(tmp_path: Path, content: bytes, what: str) -> None:
    path = tmp_path / "log.mcap"
    path.write_bytes(content)
    with pytest.raises(LogError) as caught:
        EpisodeLog(path)
    assert str(caught.value).startswith(f"{path}: not an MCAP file: {what}")


def test_a_chunk_without_a_checksum_has_none(blurred: Recorded, tmp_path: Path) -> None:
    """0 stands for that; data and index have none either."""
    whole = bytearray(blurred.path.read_bytes())
    with blurred.path.open("rb") as file:
        for record in read_records(file):
            if record.opcode == Opcode.CHUNK:
                place = whole.index(record.body)
                struct.pack_into("<I", whole, place + 24, 0)
            elif record.opcode == Opcode.DATA_END:
                struct.pack_into("<I", whole, whole.index(record.body, len(whole) // 2), 0)
    path = tmp_path / "a.mcap"
    start = whole.rindex(struct.pack("<BQI", Opcode.DATA_END, 4, 0))
    assert start > 0
    path.write_bytes(whole)
    log = EpisodeLog(path)
    assert log.state.whole
    assert [differences(a, b) for a, b in zip(log, blurred.steps, strict=True)] == [[]] * 61


def test_tables_of_logs_of_other_tools_have_the_same_columns(
    contents: Contents, tmp_path: Path
) -> None:
    bare = EpisodeLog(Tool(without_records).write(contents, tmp_path / "a.mcap")).table()
    full = EpisodeLog(Tool().write(contents, tmp_path / "b.mcap")).table()
    assert pl.concat([bare, full]).height == 2 * 61
