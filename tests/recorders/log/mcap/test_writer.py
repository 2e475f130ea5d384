"""The container against the official library: its readers, its checksums, its own Writer."""

import io
import itertools
import struct
import zlib

from hypothesis import given
from hypothesis import strategies as st
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import NonSeekingReader, make_reader
from mcap.records import ChunkIndex, MessageIndex
from mcap.stream_reader import StreamReader
from mcap.summary import Summary

from mapreplay.recorders.log.mcap.reader import (
    Channels,
    read_chunk,
    read_record,
    read_records,
    unpack,
)
from mapreplay.recorders.log.mcap.writer import ContainerWriter

Sent = tuple[str, int, bytes]
"""Topic, step, data."""

steps = st.lists(
    st.lists(st.tuples(st.sampled_from(["/a", "/b", "/c"]), st.binary(max_size=50)), max_size=6),
    max_size=6,
)


def written(chunks: list[list[tuple[str, bytes]]]) -> tuple[io.BytesIO, list[Sent]]:
    """A file with these chunks, each of one step, and what is in it."""
    file, sent, channels = io.BytesIO(), [], dict[str, int]()
    writer = ContainerWriter(file, profile="ros2", library="test")
    writer.add_metadata("first", {"key": "value"})
    for step, messages in enumerate(chunks):
        for topic, data in messages:
            if topic not in channels:
                channels[topic] = writer.add_channel(
                    topic, "cdr", f"type of {topic}", "ros2msg", "uint8[] data"
                )
            writer.add_message(channels[topic], step, 100 * step, data)
            sent.append((topic, step, data))
        writer.flush()
    writer.add_attachment("table", "text/plain", b"1,2,3")
    writer.finish()
    file.seek(0)
    return file, sent


def summary_of(file: io.BytesIO) -> Summary:
    summary = make_reader(file, validate_crcs=True).get_summary()
    assert summary is not None
    return summary


@given(steps)
def test_the_official_reader_gets_back_what_was_sent(chunks: list[list[tuple[str, bytes]]]) -> None:
    file, sent = written(chunks)
    for reader in (make_reader(file, validate_crcs=True), NonSeekingReader(file)):
        file.seek(0)
        got = [
            (channel.topic, message.sequence, message.data)
            for _, channel, message in reader.iter_messages()
        ]
        assert sorted(got) == sorted(sent)
    file.seek(0)
    list(StreamReader(file, validate_crcs=True).records)
    file.seek(0)
    reader = make_reader(file, validate_crcs=True)
    assert [m.metadata for m in reader.iter_metadata()] == [{"key": "value"}]
    assert [a.data for a in reader.iter_attachments()] == [b"1,2,3"]


@given(steps)
def test_our_reader_gets_back_what_was_sent(chunks: list[list[tuple[str, bytes]]]) -> None:
    file, sent = written(chunks)
    channels = Channels()
    got = [
        (topic, step, bytes(data))
        for record in read_records(file, wanted={Opcode.CHUNK})
        for topic, step, data, _ in unpack(read_chunk(record.body), channels)
    ]
    assert sorted(got) == sorted(sent)


@given(steps)
def test_statistics_count_what_was_sent(chunks: list[list[tuple[str, bytes]]]) -> None:
    file, sent = written(chunks)
    summary = summary_of(file)
    statistics = summary.statistics
    assert statistics is not None
    assert statistics.message_count == len(sent)
    assert statistics.chunk_count == sum(1 for messages in chunks if messages)
    assert (statistics.metadata_count, statistics.attachment_count) == (1, 1)
    counts = {
        summary.channels[channel].topic: count
        for channel, count in statistics.channel_message_counts.items()
    }
    assert counts == {topic: sum(s[0] == topic for s in sent) for topic in {s[0] for s in sent}}
    stamps = [100 * step for _, step, _ in sent] or [0]
    assert statistics.message_start_time == min(stamps)
    assert statistics.message_end_time == max(stamps)


@given(steps)
def test_message_indexes_point_at_messages(chunks: list[list[tuple[str, bytes]]]) -> None:
    """rosbag2 and Foxglove find the messages of a topic through these."""
    file, sent = written(chunks)
    found = []
    summary = summary_of(file)
    for chunk in summary.chunk_indexes:
        records = read_chunk(read_record(file, chunk.chunk_start_offset, Opcode.CHUNK))
        for channel, offset in chunk.message_index_offsets.items():
            for stamp, at in index_at(file, offset):
                opcode, size, owner, step, log_time = struct.unpack_from("<BQHIQ", records, at)
                assert (opcode, owner, log_time) == (Opcode.MESSAGE, channel, stamp)
                data = records[at + 31 : at + 9 + size]
                found.append((summary.channels[channel].topic, step, data))
        assert lengths_fit(file, chunk)
    assert sorted(found) == sorted(sent)


def index_at(file: io.BytesIO, offset: int) -> list[tuple[int, int]]:
    body = read_record(file, offset, Opcode.MESSAGE_INDEX)
    return MessageIndex.read(ReadDataStream(io.BytesIO(body))).records


def lengths_fit(file: io.BytesIO, chunk: ChunkIndex) -> bool:
    """The chunk and its indexes fill exactly the bytes that the index says."""
    end = chunk.chunk_start_offset + chunk.chunk_length
    size = len(read_record(file, chunk.chunk_start_offset, Opcode.CHUNK)) + 9
    indexes = [len(read_record(file, at, Opcode.MESSAGE_INDEX)) + 9
               for at in chunk.message_index_offsets.values()]  # fmt: skip
    return (
        size == chunk.chunk_length
        and sum(indexes) == chunk.message_index_length
        and min(chunk.message_index_offsets.values()) == end
    )


def test_all_checksums_are_there() -> None:
    file, _ = written([[("/a", b"data")]])
    whole = file.getvalue()
    footer = whole[-8 - 20 :]
    start, _, summary_crc = struct.unpack("<QQI", footer[:20])
    (data_crc,) = struct.unpack("<I", whole[start - 4 : start])
    assert data_crc == zlib.crc32(whole[: start - 13]) != 0
    assert summary_crc == zlib.crc32(whole[start : -8 - 4]) != 0


@given(steps)
def test_messages_of_a_topic_stand_together(chunks: list[list[tuple[str, bytes]]]) -> None:
    file, _ = written(chunks)
    known = Channels()
    for record in read_records(file, wanted={Opcode.CHUNK}):
        topics = [message.topic for message in unpack(read_chunk(record.body), known)]
        assert len(list(itertools.groupby(topics))) == len(set(topics))
