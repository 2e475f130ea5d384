"""The predictor `auto`: what it counts, what it takes a map for, and what the log says of it."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from drawing import draw, plan
from fakes import ConstantPredictor
from mapreplay.analysis.branching import branch
from mapreplay.analysis.verification import verify, verify_rerun
from mapreplay.config import EpisodeConfig, MapKind
from mapreplay.episode import Episode, prepare_episode, record, run_episode
from mapreplay.errors import WeightsError
from mapreplay.floorplan import FloorPlan, explorable
from mapreplay.floorplans import open_source
from mapreplay.floorplans.procedural import generate
from mapreplay.grid import FREE, OCCUPIED, UNKNOWN, Grid
from mapreplay.predictors import Choosing, choice_of, load_predictor
from mapreplay.predictors.auto import (
    PARAMETERS,
    PREDICTOR_OF,
    UNSURE,
    AutoPredictor,
    PlanKind,
    read_classifier,
    save_classifier,
)
from mapreplay.predictors.auto_features import WORDS, count_words
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.recorders.log.writer import EpisodeWriter
from mapreplay.step import Event, EventKind, PredictorIdentity
from mapreplay.training.other_plans import DRAWN

CLASSIFIER = read_classifier()

maps = hnp.arrays(
    np.int8, st.tuples(st.integers(1, 9), st.integers(1, 9)), elements=st.sampled_from([-1, 0, 100])
)


def words(picture: str) -> dict[str, int]:
    """The words of a drawn map that occur, and how often."""
    counts = count_words(draw(picture))
    return {WORDS[i]: int(counts[i]) for i in np.flatnonzero(counts)}


def seen(truth: Grid) -> Grid:
    """A floor plan as it is known when all of it was seen: the insides of walls stay unknown."""
    region = explorable(truth, FloorPlan("seen", truth, 0.2).default_start)
    return np.where(region, truth, UNKNOWN).astype(np.int8)


def house() -> Grid:
    """Rooms of 12 x 9 cells and larger with walls of 1 and 2 cells in a contour with corners."""
    cells = np.full((44, 52), OCCUPIED, np.int8)
    for top, left, bottom, right in (
        (2, 2, 14, 22),  # a hall
        (2, 24, 11, 36),
        (13, 24, 27, 36),
        (16, 2, 27, 22),
        (29, 10, 41, 36),
        (29, 2, 36, 9),
        (18, 38, 27, 49),
        (6, 22, 10, 24),  # doors of four or five cells
        (14, 8, 16, 12),
        (11, 28, 13, 32),
        (27, 14, 29, 18),
        (31, 9, 35, 10),
        (20, 36, 24, 38),
        (18, 22, 23, 24),
    ):
        cells[top:bottom, left:right] = FREE
    return cells


def test_a_room_is_one_word_a_direction_however_large() -> None:
    assert words("""
        ??????
        ?####?
        #....#
        #....#
        #....#
        ?####?
        ??????
    """) == {
        "free between walls, 3": 1,  # upwards: four equal columns count once
        "free between walls, 4": 1,  # and across, three equal rows
        "wall, both ends unseen, 3": 2,
        "wall, both ends unseen, 4": 2,
        "wall, one end unseen, 1": 4,  # nobody has seen how thick these walls are
    }


def test_the_inside_of_a_wall_is_a_word() -> None:
    across = {
        "free, one end open, 2": 2,
        "wall, one end unseen, 1": 2,
        "unknown between walls, 1": 1,
    }
    upwards = {"free, both ends open, 2": 2, "wall, both ends unseen, 2": 2}
    assert (
        words("""
        ..#?#..
        ..#?#..
    """)
        == across | upwards
    )


@given(maps, st.integers(0, 3), st.integers(0, 3), st.integers(0, 3), st.integers(0, 3))
def test_neither_place_nor_grid_nor_direction_counts(
    cells: Grid, above: int, below: int, left: int, right: int
) -> None:
    counts = count_words(cells)
    bordered = np.pad(cells, ((above, below), (left, right)), constant_values=UNKNOWN)
    for same in (bordered, cells.T, cells[::-1], cells[:, ::-1]):
        assert (count_words(np.ascontiguousarray(same)) == counts).all()


def test_nothing_known_is_nothing_to_go_by() -> None:
    assert CLASSIFIER.kind(np.full((64, 64), UNKNOWN, np.int8)) is PlanKind.NEITHER


def test_it_knows_the_kinds_when_all_is_seen() -> None:
    assert CLASSIFIER.kind(seen(generate(50_003).cells)) is PlanKind.D1
    assert CLASSIFIER.kind(seen(house())) is PlanKind.D2


@pytest.mark.parametrize("sort", DRAWN)
def test_it_is_unsure_of_what_is_neither(sort: str) -> None:
    assert CLASSIFIER.kind(seen(DRAWN[sort](50_001).cells)) is PlanKind.NEITHER


def test_a_house_at_twice_the_scale_is_neither() -> None:
    assert CLASSIFIER.kind(seen(house().repeat(2, axis=0).repeat(2, axis=1))) is PlanKind.NEITHER


def test_an_empty_field_is_neither() -> None:
    assert CLASSIFIER.kind(np.zeros((40, 40), np.int8)) is PlanKind.NEITHER


def test_it_predicts_what_the_chosen_one_predicts() -> None:
    auto, unknown = load_predictor("auto"), np.full((64, 64), UNKNOWN, np.int8)
    assert isinstance(auto, Choosing)
    for observed, kind in (
        (seen(generate(50_003).cells), PlanKind.D1),
        (seen(house()), PlanKind.D2),
    ):
        name = PREDICTOR_OF[kind]
        expected, got = load_predictor(name).predict(observed), auto.predict(observed)
        assert expected is not None
        assert got is not None
        assert (got == expected).all()
        assert auto.choice(observed) == f"{name} predicts"
        assert auto.predict(unknown) is None  # what came before does not matter
        assert auto.choice(unknown) == UNSURE
        again = auto.predict(observed)
        assert again is not None
        assert (again == expected).all()


def test_its_hash_covers_every_part() -> None:
    def digest(parameters: str = "a", d1: str = "b", d2: str = "c", name: str = "d2") -> str:
        parts = {
            PlanKind.D1: ConstantPredictor(0.5, PredictorIdentity("d1", d1)),
            PlanKind.D2: ConstantPredictor(0.5, PredictorIdentity(name, d2)),
        }
        return AutoPredictor(CLASSIFIER, parts, parameters).identity.sha256

    others = [digest("x"), digest(d1="x"), digest(d2="x"), digest(name="x")]
    assert len({digest(), *others}) == 5
    assert digest() == digest()


def test_parameters_are_read_as_they_were_written(tmp_path: Path) -> None:
    save_classifier(CLASSIFIER, tmp_path / "a.json", {"command": "none"})
    again = read_classifier(tmp_path / "a.json")
    assert (again.hidden == CLASSIFIER.hidden).all()
    assert (again.out == CLASSIFIER.out).all()
    assert again.sure == CLASSIFIER.sure


def without_a_word(data: dict[str, Any]) -> None:
    del data["hidden"][WORDS[7]]


def with_a_hole(data: dict[str, Any]) -> None:
    data["out_bias"] = [0.0]


def with_infinity(data: dict[str, Any]) -> None:
    data["out_bias"][0] = float("inf")


def without_bias(data: dict[str, Any]) -> None:
    del data["out_bias"]


def with_words(data: dict[str, Any]) -> None:
    data["out_bias"] = "none"


@pytest.mark.parametrize(
    "damage", [without_a_word, with_a_hole, with_infinity, without_bias, with_words]
)
def test_damaged_parameters_are_refused(damage: Any, tmp_path: Path) -> None:
    data = json.loads(PARAMETERS.read_text())
    damage(data)
    (tmp_path / "bad.json").write_text(json.dumps(data))
    with pytest.raises(WeightsError, match=r"bad\.json"):
        read_classifier(tmp_path / "bad.json")
    with pytest.raises(WeightsError, match="cannot be read"):
        read_classifier(tmp_path / "missing.json")


class ByCells:
    """Says what it chose by how many cells are known; predicts nothing."""

    identity = PredictorIdentity("by-cells", "")

    def predict(self, observed: Grid) -> None:
        """See `mapreplay.predictors.Predictor`."""

    def choice(self, observed: Grid) -> str:
        return "few" if (observed >= 0).sum() < 20 else "many"


CORRIDOR = plan("""
    ##################
    #................#
    ##################
""")


def by_cells(floor_plan: FloorPlan = CORRIDOR) -> Episode:
    config = EpisodeConfig(planner="nearest", predictor="none", reach=4)
    return prepare_episode(config, floor_plan, predictor=ByCells())


def choices(events: dict[int, tuple[Event, ...]]) -> dict[int, str]:
    return {
        index: event.text
        for index, told in events.items()
        for event in told
        if event.kind is EventKind.PREDICTOR
    }


def test_the_log_says_what_was_chosen_and_when_that_changed(tmp_path: Path) -> None:
    steps = list(run_episode(by_cells()))
    few = sum((step.observed >= 0).sum() < 20 for step in steps)
    assert 0 < few < len(steps)
    expected = {0: "few", few: "many"}
    assert choices({step.index: step.events for step in steps}) == expected
    path = tmp_path / "a.mcap"
    with EpisodeWriter(path, by_cells().header) as writer:
        for step in steps:
            writer.add(step)
    log = EpisodeLog(path)
    assert choices({step.index: step.events for step in log.steps()}) == expected
    assert verify(log).differences == ()


def test_a_choice_that_is_told_twice_is_no_change(tmp_path: Path) -> None:
    path = tmp_path / "twice.mcap"
    with EpisodeWriter(path, by_cells().header) as writer:
        for step in run_episode(by_cells()):
            told = (Event(EventKind.PREDICTOR, "few"), *step.events) if step.index == 1 else None
            writer.add(step if told is None else replace(step, events=told))
    found = verify(EpisodeLog(path)).differences
    assert [(d.step, d.what) for d in found] == [(1, "event 0")]


def test_an_episode_with_auto_proves_true_and_branches(tmp_path: Path) -> None:
    config = EpisodeConfig(planner="cost-utility", predictor="auto", fail_safe=True, max_steps=60)
    episode = prepare_episode(config, generate(50_003))
    path = tmp_path / "auto.mcap"
    with EpisodeWriter(path, episode.header) as writer:
        record(episode, writer)
    log = EpisodeLog(path)
    assert verify(log).differences == ()
    assert verify_rerun(log).differences == ()
    told = choices({step.index: step.events for step in log.steps()})
    assert told[0] == UNSURE  # by its first scan no plan is known
    assert f"{PREDICTOR_OF[PlanKind.D1]} predicts" in told.values()
    # A branch goes on with what was chosen before it, and says only what is new.
    unsafe = branch(log, 50, ["fail-safe=off"])
    tail = [step for step in unsafe.steps() if step.index >= 50]
    assert choices({step.index: step.events for step in tail}) == {
        index: text for index, text in told.items() if index >= 50
    }
    last = told[max(index for index in told if index <= 50)]
    right = branch(log, 50, ["truth"])
    assert choice_of(right.episode.predictor, log[50].observed) == last


def test_maps_of_neither_kind_are_hardly_ever_predicted(mrpb: Path) -> None:
    """At most one in twenty of the observed maps, in the first steps, where it is hardest."""
    source, taken, asked = open_source(str(mrpb)), 0, 0
    for name in ("track", "maze", "office02"):
        config = EpisodeConfig(
            planner="nearest", max_steps=80, plan_on=MapKind.OBSERVED, build=MapKind.OBSERVED
        )
        for step in run_episode(prepare_episode(config, source.load(name))):
            asked += 1
            taken += CLASSIFIER.kind(step.observed) is not PlanKind.NEITHER
    assert taken <= asked // 20
