"""Files that were made to take the memory or the machine are refused within stated limits."""

import io
import struct
import zlib
from collections.abc import Callable, Iterator
from contextlib import suppress
from itertools import takewhile
from pathlib import Path
from typing import NamedTuple

import lz4.frame
import numpy as np
import polars as pl
import pytest
import zstandard
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    McapRecord,
    Message,
    Metadata,
    MetadataIndex,
    Schema,
)
from mcap.writer import MCAP0_MAGIC
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from mapreplay.errors import LogError
from mapreplay.recorders.log import limits, step_table
from mapreplay.recorders.log.header import (
    EPISODE_RECORD,
    OUTCOME_RECORD,
    _crc,
    episode_pairs,
    outcome_pairs,
)
from mapreplay.recorders.log.mcap.reader import read_records
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.recorders.log.topics import Topic
from mapreplay.recorders.log.writer import EpisodeWriter
from mapreplay.step import FIRST_STAMP_NS
from memory import bounded
from recordings import Recorded


class Parts(NamedTuple):
    """The records of a log."""

    start: bytes
    """Up to the true map, which is in a chunk of its own."""
    steps: bytes
    """The chunk of the first steps, as a record."""


def encode(*records: McapRecord) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return builder.end()


def raw(opcode: int, body: bytes, length: int | None = None) -> bytes:
    return struct.pack("<BQ", opcode, len(body) if length is None else length) + body


@pytest.fixture(scope="module")
def parts(small: Recorded) -> Parts:
    with small.path.open("rb") as file:
        records = [raw(record.opcode, record.body) for record in read_records(file)]
    chunks = [k for k, record in enumerate(records) if record[0] == Opcode.CHUNK]
    return Parts(b"".join(records[: chunks[0] + 1]), records[chunks[1]])


def chunk_of(records: bytes, compression: str = "zstd", claim: int | None = None) -> bytes:
    data = zstandard.compress(records) if compression == "zstd" else lz4.frame.compress(records)
    return chunk_with(data, len(records) if claim is None else claim, zlib.crc32(records))


def chunk_with(data: bytes, claim: int, crc: int = 0, compression: str = "zstd") -> bytes:
    return encode(Chunk(compression, data, FIRST_STAMP_NS, FIRST_STAMP_NS, crc, claim))


def message(topic: int, step: int, data: bytes) -> bytes:
    stamp = FIRST_STAMP_NS + step * 100_000_000
    return encode(Message(topic, stamp, data, stamp, step))


def declare(topic: str, type_name: str, number: int, encoding: str = "cdr") -> bytes:
    return encode(
        Schema(number, b"", "ros2msg", type_name), Channel(number, topic, encoding, {}, number)
    )


def finished(data: bytes, index: bytes) -> bytes:
    """A whole file with an index, and all checksums right."""
    data = MCAP0_MAGIC + data
    end = raw(Opcode.DATA_END, struct.pack("<I", zlib.crc32(data)))
    start = len(data) + len(end)
    footer = struct.pack("<BQQQ", Opcode.FOOTER, 20, start, 0)
    crc = struct.pack("<I", zlib.crc32(index + footer))
    return data + end + index + footer + crc + MCAP0_MAGIC


def refused(path: Path, content: bytes, reason: str) -> None:
    """Opening, reading or tabulating `content` ends with one line that says `reason`."""
    path.write_bytes(content)
    with pytest.raises(LogError, match=reason) as caught:
        read_all(path)
    text = str(caught.value)
    assert text.startswith(f"{path}: ")
    assert "\n" not in text
    assert len(text) < 400


def read_all(path: Path) -> EpisodeLog:
    with bounded():
        log = EpisodeLog(path)
        assert sum(1 for _ in log) == len(log)
        log.table()
    return log


@pytest.fixture(scope="module")
def gigabytes() -> bytes:
    """4 GB of zeros as a zstd frame of 400 kB that does not say so."""
    compressor = zstandard.ZstdCompressor(level=1, write_content_size=False).compressobj()
    block = bytes(64 << 20)
    packed = b"".join(compressor.compress(block) for _ in range(64)) + compressor.flush()
    assert len(packed) < 1 << 20
    return packed


@pytest.mark.parametrize("claim", [1 << 60, 2**63 - 1, 2**64 - 1])
def test_a_record_of_2_to_the_60_bytes_is_a_cut(parts: Parts, tmp_path: Path, claim: int) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(MCAP0_MAGIC + parts.start + parts.steps + raw(Opcode.CHUNK, b"abc", claim))
    log = read_all(path)
    assert not log.finished
    assert len(log) == 2
    refused(path, MCAP0_MAGIC + raw(Opcode.METADATA, b"abc", claim), "not a log of mapreplay")


def test_lengths_inside_of_a_record_are_not_believed(parts: Parts, tmp_path: Path) -> None:
    path, huge = tmp_path / "a.mcap", 1 << 60
    name = struct.pack("<I", 2**32 - 1) + b"mapreplay.episode"
    refused(path, MCAP0_MAGIC + raw(Opcode.METADATA, name), "not a log of mapreplay|damaged")
    body = struct.pack("<QQQII4sQ", 0, 0, 100, 0, 4, b"zstd", huge)
    refused(path, MCAP0_MAGIC + parts.start + raw(Opcode.CHUNK, body), "damaged")
    long = chunk_of(raw(Opcode.MESSAGE, b"abc", huge))
    refused(path, MCAP0_MAGIC + parts.start + long, "damaged")


@pytest.mark.parametrize("claim", [100_000, limits.MAX_CHUNK_BYTES // 8])
def test_a_zstd_bomb_unpacks_to_no_more_than_it_claims(
    parts: Parts, gigabytes: bytes, tmp_path: Path, claim: int
) -> None:
    content = MCAP0_MAGIC + parts.start + chunk_with(gigabytes, claim)
    refused(tmp_path / "a.mcap", content, "damaged")


@pytest.mark.parametrize("claim", [limits.MAX_CHUNK_BYTES + 1, 1 << 50])
def test_a_chunk_that_claims_more_than_the_limit_is_refused(
    parts: Parts, tmp_path: Path, claim: int
) -> None:
    content = MCAP0_MAGIC + parts.start + chunk_of(b"", claim=claim)
    refused(tmp_path / "a.mcap", content, f"a chunk of {claim} bytes; at most 536870912")
    frame = zstandard.ZstdCompressor().compressobj(size=claim)
    packed = frame.compress(bytes(1 << 20)) + frame.flush(zstandard.COMPRESSOBJ_FLUSH_BLOCK)
    content = MCAP0_MAGIC + parts.start + chunk_with(packed, 1 << 20)
    refused(tmp_path / "a.mcap", content, f"a chunk of {claim} bytes; at most 536870912")


@pytest.mark.parametrize("claim", [1000, limits.MAX_CHUNK_BYTES // 8])
@pytest.mark.parametrize("stored", [True, False])
def test_an_lz4_bomb_unpacks_to_no_more_than_it_claims(
    parts: Parts, tmp_path: Path, claim: int, stored: bool
) -> None:
    bomb = lz4.frame.compress(bytes(256 << 20), store_size=stored)
    content = MCAP0_MAGIC + parts.start + chunk_with(bomb, claim, compression="lz4")
    refused(tmp_path / "a.mcap", content, "damaged")
    content = MCAP0_MAGIC + parts.start + chunk_with(bomb, 1 << 40, compression="lz4")
    refused(tmp_path / "a.mcap", content, "at most 536870912")


def test_a_chunk_that_is_not_compressed_has_the_size_that_it_claims(
    parts: Parts, tmp_path: Path
) -> None:
    content = MCAP0_MAGIC + parts.start + chunk_with(bytes(2000), 1000, compression="")
    refused(tmp_path / "a.mcap", content, "a chunk of 2000 bytes that should have 1000")


def test_other_compressions_are_refused(parts: Parts, tmp_path: Path) -> None:
    content = MCAP0_MAGIC + parts.start + chunk_with(bytes(1000), 1000, compression="bzip9")
    refused(tmp_path / "a.mcap", content, r"mcap: a chunk is compressed with 'bzip9', .*repack")


def test_millions_of_messages_are_refused(parts: Parts, tmp_path: Path) -> None:
    one = message(1, 0, b"")
    head = declare(Topic.METRICS, Topic.METRICS.type_name, 1)
    count = limits.MAX_MESSAGES_A_CHUNK
    content = MCAP0_MAGIC + parts.start + chunk_of(head + one * (10 * count))
    refused(tmp_path / "a.mcap", content, f"messages in a chunk; at most {count}")


def test_millions_of_channels_and_records_are_refused(parts: Parts, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    channels = b"".join(declare(f"/t{k % 60_000}", "a/msg/B", k % 60_000) for k in range(1, 70_000))
    refused(path, MCAP0_MAGIC + parts.start + chunk_of(channels), "types; at most 1000")
    refused(path, finished(parts.start, channels), "types; at most 1000")
    notes = encode(Metadata("a", {})) * 1_000_000
    refused(path, MCAP0_MAGIC + notes + parts.start, "metadata records; at most 1000")
    places = b"".join(encode(MetadataIndex(0, 0, f"n{k}")) for k in range(5000))
    refused(path, finished(parts.start, places), "metadata records; at most 1000")
    places = b"".join(encode(AttachmentIndex(0, 0, 0, 0, 0, f"n{k}", "")) for k in range(5000))
    refused(path, finished(parts.start, places), "attachments; at most 1000")
    big = encode(MetadataIndex(0, 0, "n" * 1_000_000)) * 70
    refused(path, finished(parts.start, big), f"an index of .* at most {limits.MAX_INDEX_BYTES}")


def test_the_index_may_name_no_place_of_the_file(parts: Parts, tmp_path: Path) -> None:
    for place in (0, 1 << 40, 2**64 - 1):
        index = encode(MetadataIndex(place, 10, EPISODE_RECORD))
        refused(tmp_path / "a.mcap", finished(parts.start, index), "damaged")


@pytest.mark.parametrize("topic", [Topic.TRUTH, Topic.OBSERVED, Topic.METRICS])
def test_a_type_that_is_not_ours_under_our_name_is_refused(
    parts: Parts, tmp_path: Path, topic: Topic
) -> None:
    path = tmp_path / "a.mcap"
    other = declare(topic, "std_msgs/msg/String", 9) + message(9, 0, b"\0\1\0\0\1\0\0\0\0")
    reason = f"{topic} is std_msgs/msg/String as cdr, and not {topic.type_name} as cdr"
    refused(path, MCAP0_MAGIC + parts.start + chunk_of(other), reason)
    other = declare(topic, topic.type_name, 9, "json") + message(9, 0, b"{}")
    refused(path, MCAP0_MAGIC + parts.start + chunk_of(other), f"{topic.type_name} as json")


def test_a_bag_of_another_tool_is_refused(tmp_path: Path) -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)
    text = store.types["std_msgs/msg/String"]
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        topic = bag.add_connection("/map/truth", text.__msgtype__, typestore=store)
        bag.write(topic, 1, store.serialize_cdr(text("hello"), text.__msgtype__))
    (path,) = (tmp_path / "bag").glob("*.mcap")
    refused(path, path.read_bytes(), "a ROS 2 bag with topics /map/truth: not a log of mapreplay")


@pytest.mark.parametrize(
    ("height", "width", "cells"),
    [(2**31, 2**31, 144), (2**32 - 1, 2**32 - 1, 0), (1, 5000, 5000), (0, 0, 0), (0, 2**32 - 1, 0)],
)
def test_absurd_maps_are_refused(
    parts: Parts, small: Recorded, tmp_path: Path, height: int, width: int, cells: int
) -> None:
    head = struct.pack("<4siII4siIfII4x7dI", b"\0\1\0\0", 1, 0, 4, b"map\0", 1, 0, 1.0, width,
                       height, 0, 0, 0, 0, 0, 0, 1, cells)  # fmt: skip
    truth = declare(Topic.TRUTH, Topic.TRUTH.type_name, 1) + message(1, 0, head + bytes(cells))
    start = encode(Metadata(EPISODE_RECORD, episode_pairs(small.header)))
    refused(tmp_path / "a.mcap", MCAP0_MAGIC + start + chunk_of(truth), r"a\.mcap: ")
    step = declare(Topic.OBSERVED, Topic.OBSERVED.type_name, 1) + message(1, 0, head + bytes(cells))
    step += declare(Topic.METRICS, Topic.METRICS.type_name, 2) + message(2, 0, b"")
    refused(tmp_path / "a.mcap", MCAP0_MAGIC + parts.start + chunk_of(step), r"a\.mcap: ")


def replaced(parts: Parts, change: Callable[[str, bytes], bytes]) -> bytes:
    """A log whose first steps have other data: `change` gets the topic and the data."""
    body = Chunk.read(_stream(parts.steps[9:]))
    records = zstandard.decompress(body.data)
    topics: dict[int, str] = {}
    changed = io.BytesIO()
    for opcode, data in _records(records):
        if opcode == Opcode.CHANNEL:
            channel = Channel.read(_stream(data))
            topics[channel.id] = channel.topic
        if opcode == Opcode.MESSAGE:
            (channel_id,) = struct.unpack_from("<H", data)
            changed.write(raw(opcode, data[:22] + change(topics[channel_id], data[22:])))
        else:
            changed.write(raw(opcode, data))
    return MCAP0_MAGIC + parts.start + chunk_of(changed.getvalue())


def _records(records: bytes) -> Iterator[tuple[int, bytes]]:
    position = 0
    while position < len(records):
        opcode, length = struct.unpack_from("<BQ", records, position)
        yield opcode, records[position + 9 : position + 9 + length]
        position += 9 + length


def _stream(body: bytes) -> ReadDataStream:
    return ReadDataStream(io.BytesIO(body))


@pytest.mark.parametrize("topic", sorted(set(Topic) - {Topic.TRUTH, Topic.TF, Topic.PREDICTED}))
def test_counts_of_2_to_the_32_in_a_message_are_not_believed(
    parts: Parts, tmp_path: Path, topic: Topic
) -> None:
    """Every four bytes of every message of a step, as if they were a count."""
    path = tmp_path / "a.mcap"
    sizes: list[int] = []
    replaced(parts, lambda name, data: sizes.append(len(data)) or data if name == topic else data)
    for place in range(4, min(max(sizes, default=0), 160), 4):
        for claim in (2**31 - 1, 2**31, 2**32 - 1):

            def lie(name: str, data: bytes, place: int = place, claim: int = claim) -> bytes:
                if name != topic or len(data) < place + 4:
                    return data
                return data[:place] + struct.pack("<I", claim) + data[place + 4 :]

            path.write_bytes(replaced(parts, lie))
            with suppress(LogError):  # a number may be any number
                read_all(path)


def test_a_million_frontier_cells_on_a_small_map_are_refused(parts: Parts, tmp_path: Path) -> None:
    def crowd(topic: str, data: bytes) -> bytes:
        if topic != Topic.FRONTIER:
            return data
        head = struct.pack("<4siII4sffI4x", b"\0\1\0\0", 1, 0, 4, b"map\0", 1.0, 1.0, 1_000_000)
        return head + np.full((1_000_000, 3), 0.5).tobytes()

    refused(tmp_path / "a.mcap", replaced(parts, crowd), "1000000 cells in a map of 144")


@pytest.mark.parametrize(
    "lie",
    [
        {"start": "[" * 100_000},
        {"versions": '{"a":' * 100_000},
        {"config": '{"planner":' * 50_000},
        {"start": "9" * 100_000},
        {"start": "[1e400, NaN]"},
        {"max_steps": "9" * 10_000},
        {"planner_notes": "x" * (1 << 20)},
    ],
    ids=["nested-start", "nested-versions", "nested-config", "digits", "infinite", "huge", "long"],
)
def test_metadata_that_is_nested_or_huge_is_refused(
    small: Recorded, parts: Parts, tmp_path: Path, lie: dict[str, str]
) -> None:
    pairs = episode_pairs(small.header) | lie
    del pairs["crc32"]
    pairs["crc32"] = _crc(pairs)
    content = MCAP0_MAGIC + encode(Metadata(EPISODE_RECORD, pairs)) + parts.start
    refused(tmp_path / "a.mcap", content, r"damaged|configuration|lies outside|at most")


def with_table(small: Recorded, content: bytes, steps: int | None = None) -> bytes:
    """A finished log whose table is `content`."""
    with small.path.open("rb") as file:
        kept = takewhile(lambda record: record.opcode != Opcode.ATTACHMENT, read_records(file))
        records = list(kept)
    data = b"".join(raw(*record) for record in records)
    summary = EpisodeLog(small.path).summary
    assert summary is not None
    pairs = outcome_pairs(summary)
    if steps is not None:
        pairs["steps"] = str(steps)
    attachment = encode(Attachment(0, 0, step_table.ATTACHMENT, step_table.MEDIA_TYPE, content))
    place = len(MCAP0_MAGIC) + len(data)
    episode = len(MCAP0_MAGIC) + len(raw(*records[0]))
    index = encode(
        MetadataIndex(episode, 0, EPISODE_RECORD),
        MetadataIndex(place + len(attachment), 0, OUTCOME_RECORD),
        AttachmentIndex(place, 0, 0, 0, len(content), step_table.ATTACHMENT, step_table.MEDIA_TYPE),
    )
    return finished(data + attachment + encode(Metadata(OUTCOME_RECORD, pairs)), index)


def parquet(frame: pl.DataFrame) -> bytes:
    file = io.BytesIO()
    frame.write_parquet(file, compression="zstd")
    return file.getvalue()


def test_a_table_that_is_not_ours_is_refused(small: Recorded, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    honest = EpisodeLog(small.path).table()
    path.write_bytes(with_table(small, parquet(honest)))
    assert read_all(path).table().equals(honest)
    refused(path, with_table(small, parquet(honest.head(3))), "does not have 9 rows")
    path.write_bytes(with_table(small, parquet(honest.drop("f1"))))
    assert read_all(path).table().equals(honest)  # from the steps
    for content in (b"", b"PAR1", b"PAR1" + bytes(100) + b"PAR1", b"x" * 1000):
        refused(path, with_table(small, content), "damaged")
    whole = bytearray(parquet(honest))
    for place in range(0, len(whole), 97):
        whole[place] ^= 0xFF
        path.write_bytes(with_table(small, bytes(whole)))
        whole[place] ^= 0xFF
        with suppress(LogError), bounded():  # a number may be any number
            EpisodeLog(path).table()


def test_a_table_of_gigabytes_is_refused(small: Recorded, tmp_path: Path) -> None:
    honest = EpisodeLog(small.path).table()
    bomb = parquet(honest.with_columns(mode=pl.lit("x" * (100 << 20))))
    assert len(bomb) < 1 << 20
    path = tmp_path / "a.mcap"
    refused(path, with_table(small, bomb), "at most [0-9]+ are allowed")
    many = parquet(pl.concat([honest.head(1)] * 100_000, rechunk=True))
    refused(path, with_table(small, many), "does not have 9 rows")
    for steps in (10**9, -5, 10**30):
        refused(path, with_table(small, parquet(honest), steps), "at most 2000000")


def test_more_steps_than_can_be_read_are_not_written(
    small: Recorded, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mapreplay.recorders.log.writer.MAX_STEPS", 3)
    with EpisodeWriter(tmp_path / "a.mcap", small.header) as writer:
        for step in small.steps[:3]:
            writer.add(step)
        with pytest.raises(LogError, match="at most 3 steps"):
            writer.add(small.steps[3])
    monkeypatch.setattr("mapreplay.recorders.log.writer.MAX_STEP_BYTES", 100)
    with (
        EpisodeWriter(tmp_path / "b.mcap", small.header) as writer,
        pytest.raises(LogError, match=r"step 0 has [0-9]+ bytes; at most 100 can be read back"),
    ):
        writer.add(small.steps[0])
