"""Steps to ROS messages and back, bit for bit, and cells where they belong."""

import struct
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drawing import find, plan
from mapreplay.config import EpisodeConfig
from mapreplay.errors import LogError
from mapreplay.floorplan import FloorPlan
from mapreplay.grid import Cell, Grid, Origin, Quantized
from mapreplay.recorders.log.codec import (
    Encoded,
    decode_step,
    decode_truth,
    encode_step,
    encode_truth,
)
from mapreplay.recorders.log.geometry import check_geometry
from mapreplay.recorders.log.reader import STEP_TOPICS
from mapreplay.recorders.log.schemas import own_definitions, schema_text, typestore
from mapreplay.recorders.log.topics import Topic
from mapreplay.sensor import Sensor
from mapreplay.step import (
    Candidate,
    Cells,
    Decision,
    EpisodeHeader,
    Event,
    EventKind,
    Mode,
    Outcome,
    PredictorIdentity,
    Step,
    StepMetrics,
    StepProfile,
    differences,
)
from oracle import from_cdr, messages_of, to_cdr

reals = st.floats(width=64)
shares = st.floats(0, 1) | st.just(float("nan"))
int64s = st.integers(0, 2**63 - 1)


def header_for(floor_plan: FloorPlan, sensor: Sensor) -> EpisodeHeader:
    config = EpisodeConfig(rays=sensor.rays, reach=sensor.reach)
    identity = PredictorIdentity("none", "")
    return EpisodeHeader(config, floor_plan, floor_plan.default_start, 9, identity, ())


def decode(messages: list[Encoded], index: int, header: EpisodeHeader) -> Step:
    by_topic: dict[str, list[bytes]] = {}
    for topic, data in messages:
        by_topic.setdefault(topic, []).append(data)
    return decode_step(by_topic, index, header)


@st.composite
def recorded_steps(draw: st.DrawFn) -> tuple[Step, EpisodeHeader]:
    """Any step that could be written, on a floor plan of 8x8 to 64x64 cells."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    shape = draw(st.tuples(st.integers(8, 64), st.integers(8, 64)))
    sensor = Sensor(8 * draw(st.integers(1, 5)), draw(st.integers(1, 30)))

    def grid() -> Grid:
        return rng.choice(np.array([-1, 0, 100], np.int8), shape)

    def cell() -> Cell:
        return Cell(int(rng.integers(shape[0])), int(rng.integers(shape[1])))

    def cells(count: int) -> Cells:
        return np.array([cell() for _ in range(count)], np.int32).reshape(count, 2)

    def candidate() -> Candidate:
        moves = rng.integers(0, shape[0] * shape[1], 2).tolist()
        return Candidate(cell(), draw(reals), draw(reals), *moves)

    def prediction(dtype: str | None) -> Quantized | None:
        if dtype is None:
            return None
        if dtype == "float32":
            return rng.random(shape, np.float32)
        return rng.integers(0, np.iinfo(dtype).max, shape, dtype, endpoint=True)

    # A ray may cross one cell with two k: then the first is what it hits.
    offsets = sensor.offsets
    hits = rng.integers(0, sensor.reach + 1, sensor.rays).astype(np.int16)
    for i, k in enumerate(hits):
        if k:
            hits[i] = 1 + np.argmax((offsets[i] == offsets[i, k - 1]).all(axis=1))

    truth = grid()
    truth[0, 0] = 0
    origin = Origin(*draw(st.tuples(*[st.floats(-1e4, 1e4)] * 2)))
    header = header_for(FloorPlan("any", truth, draw(st.floats(0.01, 10)), origin), sensor)
    decision = Decision(
        chosen=candidate(),
        path=cells(draw(st.integers(2, 9))),
        mode=draw(st.sampled_from(Mode)),
        rivals=tuple(candidate() for _ in range(draw(st.integers(0, 5)))),
        random_draw=draw(st.none() | st.integers(0, 2**64 - 1)),
    )
    text = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=20)
    events = st.lists(st.builds(Event, st.sampled_from(EventKind), text), max_size=3)
    profiles = st.builds(StepProfile, int64s, int64s, int64s, int64s, int64s)
    step = Step(
        index=draw(st.integers(0, 10_000_000)),
        agent=cell(),
        hits=hits,
        observed=grid(),
        p_wall=prediction(draw(st.sampled_from([None, "uint8", "uint16", "float32"]))),
        fused=grid(),
        frontier=cells(draw(st.integers(0, 30))),
        decision=draw(st.sampled_from([None, decision])),
        metrics=StepMetrics(
            draw(st.floats(0, 0.1)), *[draw(shares) for _ in StepMetrics.names()[1:]]
        ),
        events=tuple(draw(events)),
        outcome=draw(st.none() | st.sampled_from(Outcome)),
        profile=draw(st.none() | profiles),
    )
    return step, header


@given(recorded_steps())
def test_a_step_comes_back_bit_for_bit(recorded: tuple[Step, EpisodeHeader]) -> None:
    step, header = recorded
    check_geometry(header.floor_plan)
    messages = list(encode_step(step, header))
    assert messages[-1].topic is Topic.METRICS
    assert differences(decode(messages, step.index, header), step) == []


@given(recorded_steps())
def test_messages_are_what_rosbags_would_write(recorded: tuple[Step, EpisodeHeader]) -> None:
    """Byte for byte, and so padding included, from the fields of each; and rosbags reads each."""
    packed = list(encode_step(*recorded))
    assert [m for m in packed if m.topic is not Topic.PREDICTED] == messages_of(*recorded)
    for topic, data in packed:
        assert to_cdr(from_cdr(data, topic.type_name), topic.type_name) == data


@given(recorded_steps())
def test_a_floor_plan_comes_back_bit_for_bit(recorded: tuple[Step, EpisodeHeader]) -> None:
    floor_plan = recorded[1].floor_plan
    _, data = encode_truth(floor_plan)
    back = decode_truth(data, floor_plan.id, floor_plan.resolution)
    assert np.array_equal(back.cells, floor_plan.cells)
    assert back.sha256 == floor_plan.sha256


ROOM = """
    #####
    #..A#
    #...#
    #####
"""


@pytest.fixture
def drawn() -> tuple[dict[str, bytes], EpisodeHeader]:
    """The messages of one step in ROOM, whose lower left corner is at (10, 20) m."""
    floor_plan = replace(plan(ROOM, resolution=0.5), origin=Origin(10.0, 20.0))
    header = header_for(floor_plan, Sensor(8, 3))
    agent = Cell(*find(ROOM, "A"))
    path = np.array([agent, (1, 2), (1, 1)], np.int32)
    step = Step(
        index=7,
        agent=agent,
        # E, NE, ..., SE; the wall to the east is the nearest, nothing was hit to the west
        hits=np.array([1, 1, 1, 1, 0, 0, 2, 1], np.int16),
        observed=floor_plan.cells,
        p_wall=np.arange(20, dtype=np.uint16).reshape(4, 5),
        fused=floor_plan.cells,
        frontier=path[1:],
        decision=Decision(
            Candidate(Cell(1, 1), 0.5, 1.0, 1, 1), path, Mode.FAIL_SAFE, (), 2**64 - 1
        ),
        metrics=StepMetrics(0.5, *[0.5] * (len(StepMetrics.names()) - 1)),
        events=(Event(EventKind.SEALED_IN, "no way"),),
        outcome=None,
        profile=StepProfile(1, 2, 3, 4, 5),
    )
    return dict(encode_step(step, header)), header


Drawn = tuple[dict[str, bytes], EpisodeHeader]


def test_row_0_is_the_smallest_y(drawn: Drawn) -> None:
    grid = from_cdr(drawn[0][Topic.OBSERVED], Topic.OBSERVED.type_name)
    # From the lower left corner along x: the bottom wall, then the row above it.
    assert grid.data[:10].tolist() == [100] * 5 + [100, 0, 0, 0, 100]
    assert (grid.info.width, grid.info.height, grid.info.resolution) == (5, 4, 0.5)
    assert (grid.info.origin.position.x, grid.info.origin.position.y) == (10.0, 20.0)


def test_the_agent_is_at_the_centre_of_its_cell(drawn: Drawn) -> None:
    pose = from_cdr(drawn[0][Topic.POSE], Topic.POSE.type_name)
    (transform,) = from_cdr(drawn[0][Topic.TF], Topic.TF.type_name).transforms
    # row 2, column 3
    assert (pose.pose.position.x, pose.pose.position.y) == (10 + 3.5 * 0.5, 20 + 2.5 * 0.5)
    assert transform.transform.translation.x == pose.pose.position.x
    assert transform.transform.translation.y == pose.pose.position.y
    assert transform.transform.rotation.w == pose.pose.orientation.w == 1.0
    assert (pose.header.frame_id, transform.header.frame_id) == ("map", "map")
    assert transform.child_frame_id == "base_link"
    assert (pose.header.stamp.sec, pose.header.stamp.nanosec) == (1, 700_000_000)


def test_ranges_are_metres_and_infinite_where_nothing_was_hit(drawn: Drawn) -> None:
    scan = from_cdr(drawn[0][Topic.SCAN], Topic.SCAN.type_name)
    diagonal = np.float32(0.5 * np.sqrt(2))
    expected = [0.5, diagonal, 0.5, diagonal, np.inf, np.inf, 1.0, diagonal]
    assert scan.ranges.tolist() == expected
    assert scan.header.frame_id == "base_link"
    assert scan.angle_increment == pytest.approx(np.pi / 4)
    assert scan.angle_max == pytest.approx(7 * np.pi / 4)


def test_the_path_and_the_frontier_are_in_metres(drawn: Drawn) -> None:
    path = from_cdr(drawn[0][Topic.PLAN], Topic.PLAN.type_name)
    frontier = from_cdr(drawn[0][Topic.FRONTIER], Topic.FRONTIER.type_name)
    places = [(p.pose.position.x, p.pose.position.y) for p in path.poses]
    assert places == [(11.75, 21.25), (11.25, 20.75), (10.75, 20.75)]
    assert [(p.x, p.y) for p in frontier.cells] == places[1:]


def test_the_prediction_is_packed_as_it_was_used(drawn: Drawn) -> None:
    grid = from_cdr(drawn[0][Topic.P_WALL], Topic.P_WALL.type_name)
    (field,) = grid.fields
    assert (field.name, field.type, field.offset) == ("p_wall", field.UINT16, 0)
    assert (grid.column_count, grid.row_stride, grid.cell_stride) == (5, 10, 2)
    assert grid.data.view("<u2").tolist() == list(range(20))


def test_a_seal_is_a_warning(drawn: Drawn) -> None:
    line = from_cdr(drawn[0][Topic.EVENTS], Topic.EVENTS.type_name)
    assert (line.name, line.level, line.msg) == ("mapreplay.sealed_in", line.WARN, "no way")


def test_a_map_of_another_size_is_refused(drawn: Drawn) -> None:
    messages = {topic: [data] for topic, data in drawn[0].items() if topic != Topic.P_WALL}
    larger = plan(ROOM + "    #####", resolution=0.5)
    other = header_for(replace(larger, origin=Origin(10.0, 20.0)), Sensor(8, 3))
    with pytest.raises(ValueError, match=r"a map of \(4, 5\) cells on a floor plan of \(5, 5\)"):
        decode_step(messages, 7, other)


@pytest.mark.parametrize(
    ("resolution", "origin"),
    [(1e-9, Origin(0.0, 0.0)), (1e9, Origin(0.0, 0.0)), (0.05, Origin(1e16, 0.0))],
    ids=["tiny", "huge", "far"],
)
def test_cells_that_metres_cannot_tell_apart_are_refused(resolution: float, origin: Origin) -> None:
    floor_plan = replace(plan(ROOM, resolution=resolution), origin=origin)
    with pytest.raises(LogError, match="choose another origin or resolution"):
        check_geometry(floor_plan)


def test_the_metrics_message_has_the_fields_of_step_metrics() -> None:
    _, fields = typestore().fielddefs["mapreplay_msgs/msg/StepMetrics"]
    assert [name for name, _ in fields] == ["header", "outcome", *StepMetrics.names()]


@pytest.mark.parametrize("topic", Topic)
def test_schema_texts_are_complete(topic: Topic) -> None:
    """The text alone defines the same type as the one we write."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(schema_text(topic.type_name), topic.type_name))
    digest = typestore().hash_rihs01(topic.type_name)
    assert store.hash_rihs01(topic.type_name) == digest


@pytest.mark.parametrize("topic", sorted(STEP_TOPICS))
def test_a_message_that_is_cut_off_is_refused(drawn: Drawn, topic: Topic) -> None:
    messages, header = drawn
    whole = {name: [data] for name, data in messages.items()}
    decode_step(whole, 7, header)
    data = whole[topic][0]
    # What follows the text of an event, and the ranges of a scan, is not read.
    unread = {Topic.EVENTS: len(data) - data.find(b"no way\0") - 7, Topic.SCAN: 4}.get(topic, 0)
    for size in range(len(data) - unread):
        with pytest.raises((ValueError, struct.error)):
            decode_step(whole | {topic: [data[:size]]}, 7, header)


def test_a_message_in_another_frame_is_refused(drawn: Drawn) -> None:
    messages, header = drawn
    pose = messages[Topic.POSE].replace(b"map", b"odo")
    with pytest.raises(ValueError, match="step 7: a message that is not in the frame map"):
        decode_step(
            {name: [data] for name, data in (messages | {Topic.POSE: pose}).items()}, 7, header
        )


def test_arrays_own_their_memory(drawn: Drawn) -> None:
    """A view would keep its whole chunk alive, and could not be written to."""
    messages, header = drawn
    step = decode_step({name: [data] for name, data in messages.items()}, 7, header)
    assert step.decision is not None
    for array in (step.observed, step.fused, step.p_wall, step.frontier, step.decision.path):
        array[:] = 0
        assert array.base is None or array.base.flags.owndata


def test_own_schemas_keep_their_comments() -> None:
    text = schema_text("mapreplay_msgs/msg/Decision")
    assert text.startswith(own_definitions()["mapreplay_msgs/msg/Decision"])
    assert "# A frontier cell as the planner rated it." in text
