"""Logs as other tools see them: rosbags' AnyReader, the official mcap reader, rerun."""

import json
import shutil
import subprocess
import sysconfig
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.records import Channel, Message, Schema
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from mapreplay.mapping import dequantize
from mapreplay.recorders.log.topics import Topic
from mapreplay.step import FIRST_STAMP_NS, STEP_NS
from recordings import Recorded

PREDICTED = {Topic.P_WALL, Topic.PREDICTED}


@pytest.fixture(scope="module")
def seen(blurred: Recorded) -> dict[str, list[tuple[int, Any]]]:
    """(stamp, message) by topic, decoded with the definitions in the file alone."""
    found = defaultdict(list)
    empty = get_typestore(Stores.EMPTY)
    with AnyReader([blurred.path], default_typestore=empty) as reader:
        for connection, stamp, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            assert message.__msgtype__ == Topic(connection.topic).type_name
            found[connection.topic].append((stamp, message))
    return dict(found)


Seen = dict[str, list[tuple[int, Any]]]


def test_rosbags_reads_every_topic(seen: Seen, blurred: Recorded) -> None:
    assert set(seen) == set(Topic)
    steps = len(blurred.steps)
    for topic in set(Topic) - {Topic.TRUTH, Topic.EVENTS, Topic.PLAN, Topic.DECISION}:
        stamps = [stamp for stamp, _ in seen[topic]]
        assert stamps == [FIRST_STAMP_NS + k * STEP_NS for k in range(steps)]
    assert len(seen[Topic.TRUTH]) == 1
    assert len(seen[Topic.PLAN]) == len(seen[Topic.DECISION]) == steps - 1


def test_without_a_prediction_its_topics_are_absent(unpredicted: Recorded) -> None:
    with AnyReader([unpredicted.path]) as reader:
        assert set(reader.topics) == set(Topic) - PREDICTED


def test_maps_are_exactly_unknown_free_and_occupied(seen: Seen, blurred: Recorded) -> None:
    for topic, name in [(Topic.OBSERVED, "observed"), (Topic.FUSED, "fused")]:
        for (_, grid), step in zip(seen[topic], blurred.steps, strict=True):
            assert set(grid.data.tolist()) <= {-1, 0, 100}
            cells = grid.data.reshape(grid.info.height, grid.info.width)
            assert np.array_equal(cells, getattr(step, name))
    (_, truth) = seen[Topic.TRUTH][0]
    assert np.array_equal(truth.data, blurred.header.floor_plan.cells.ravel())


def test_the_preview_is_the_prediction_in_tenths(seen: Seen, blurred: Recorded) -> None:
    for (_, grid), step in zip(seen[Topic.PREDICTED], blurred.steps, strict=True):
        assert step.p_wall is not None
        assert set(grid.data.tolist()) <= set(range(0, 101, 10))
        error = grid.data - 100 * dequantize(step.p_wall).ravel()
        assert np.abs(error).max() <= 5


def test_the_frontier_and_the_target_lie_where_cells_do(seen: Seen, blurred: Recorded) -> None:
    resolution = blurred.header.floor_plan.resolution
    for (_, frontier), step in zip(seen[Topic.FRONTIER], blurred.steps, strict=True):
        cells = [(int(p.y / resolution), int(p.x / resolution)) for p in frontier.cells]
        assert cells == list(map(tuple, step.frontier.tolist()))
    for (_, decision), step in zip(seen[Topic.DECISION], blurred.steps, strict=False):
        assert step.decision is not None
        assert (decision.chosen.row, decision.chosen.col) == step.decision.target
        assert decision.is_random == (step.decision.random_draw is not None)
        assert decision.random_draw == (step.decision.random_draw or 0)
        assert decision.chosen.cost == step.decision.chosen.cost


def test_the_events_tell_the_outcome(seen: Seen) -> None:
    lines = [line for _, line in seen[Topic.EVENTS]]
    assert (lines[-1].name, lines[-1].msg) == (
        "mapreplay.outcome",
        "out_of_steps after 60 steps",
    )


def records(recorded: Recorded) -> list[tuple[Schema | None, Channel, Message]]:
    with recorded.path.open("rb") as file:
        return list(make_reader(file, validate_crcs=True).iter_messages())


def test_the_official_reader_finds_what_rosbag2_needs(blurred: Recorded) -> None:
    with blurred.path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == len(records(blurred))
    assert summary.statistics.message_start_time == FIRST_STAMP_NS
    for channel in summary.channels.values():
        assert channel.message_encoding == "cdr"
        assert channel.metadata == {"offered_qos_profiles": ""}
        assert channel.schema_id != 0  # the MCAP specification's "no schema"
        schema = summary.schemas[channel.schema_id]
        assert schema.encoding == "ros2msg"
        assert schema.name == Topic(channel.topic).type_name
    for chunk in summary.chunk_indexes:
        assert chunk.compression == "zstd"
        assert chunk.message_end_time - chunk.message_start_time < 20 * STEP_NS


def test_messages_are_stamped_with_their_step(blurred: Recorded) -> None:
    for _, _, message in records(blurred):
        assert message.log_time == message.publish_time
        assert message.log_time == FIRST_STAMP_NS + message.sequence * STEP_NS


def test_metadata_and_attachment_say_no_date_and_no_place(blurred: Recorded) -> None:
    with blurred.path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
        (attachment,) = reader.iter_attachments()
    assert set(metadata) == {"mapreplay.episode", "mapreplay.outcome"}
    episode = metadata["mapreplay.episode"]
    assert set(episode) == {
        "format_version", "config", "floor_plan_id", "floor_plan_sha256", "resolution", "start",
        "max_steps", "predictor", "predictor_sha256", "seed", "simulator", "versions", "crc32",
    }  # fmt: skip
    assert json.loads(episode["config"])["prediction_dtype"] == "uint8"
    assert episode["seed"] == "3"
    assert metadata["mapreplay.outcome"]["outcome"] == "out_of_steps"
    assert metadata["mapreplay.outcome"]["mapping_time"] == ""
    assert (attachment.name, attachment.media_type) == (
        "steps.parquet",
        "application/vnd.apache.parquet",
    )
    assert attachment.create_time == attachment.log_time == 0
    assert str(blurred.path.parent).encode() not in blurred.path.read_bytes()


def rerun(*arguments: object) -> subprocess.CompletedProcess[str]:
    """The command line tool that the rerun-sdk package installs."""
    program = shutil.which("rerun", path=sysconfig.get_path("scripts"))
    if program is None:
        pytest.skip("rerun's command line tool is not installed")
    command = [program, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)


def test_rerun_finds_nothing_wrong(blurred: Recorded) -> None:
    checked = rerun("mcap", "check", "--full", blurred.path)
    assert checked.returncode == 0, checked.stderr
    verdicts = [line.split() for line in checked.stdout.splitlines() if "/" in line]
    found = {words[3]: words[0] for words in verdicts if len(words) == 5}
    assert found == dict.fromkeys(Topic, "ok"), checked.stdout


def test_rerun_converts_every_topic(blurred: Recorded, tmp_path: Path) -> None:
    target = tmp_path / "log.rrd"
    converted = rerun("mcap", "convert", blurred.path, "-o", target)
    assert converted.returncode == 0, converted.stderr
    printed = rerun("rrd", "print", target)
    assert printed.returncode == 0, printed.stderr
    for topic in Topic:
        assert f"{topic}" in printed.stdout, topic
