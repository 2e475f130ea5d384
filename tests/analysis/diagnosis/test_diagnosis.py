"""Whole episodes in a house of two rooms whose door the prediction closes."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path, PurePosixPath

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beliefs import belief
from drawing import draw
from mapreplay.analysis.diagnosis.annotations import marks_of
from mapreplay.analysis.diagnosis.blame import trace_blame
from mapreplay.analysis.diagnosis.corpus import corpus_record, costs, groups, kind_counts
from mapreplay.analysis.diagnosis.detect import Ending, NearMissKind, runs
from mapreplay.analysis.diagnosis.diagnosis import Diagnosis, diagnose
from mapreplay.analysis.diagnosis.harms import HarmDetector, HarmKind
from mapreplay.analysis.diagnosis.page import diagnosis_page
from mapreplay.analysis.diagnosis.paragraph import paragraph, what_if
from mapreplay.analysis.diagnosis.passage import passage_size
from mapreplay.analysis.diagnosis.reach import Scratch, reached
from mapreplay.analysis.diagnosis.record import diagnosis_path, record_of, save_next_to
from mapreplay.analysis.diagnosis.reliability import Reliability
from mapreplay.analysis.diagnosis.remedy import threshold_of_free, threshold_of_walls
from mapreplay.analysis.diagnosis.sealing_table import sealing_table
from mapreplay.analysis.diagnosis.tables import all_tables
from mapreplay.episode import run_episode
from mapreplay.errors import ExistsError
from mapreplay.external import ExternalEpisode, unknown_floor_plan
from mapreplay.grid import OCCUPIED, UNKNOWN, Cell
from mapreplay.mapping import PredictionDtype, Thresholds, fuse, quantize
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.recorders.log.writer import EpisodeWriter
from mapreplay.step import Outcome
from sealing import DOOR, LEFT_ROOM, TWO_ROOMS, always, episode, recorded, until


@pytest.fixture(scope="module")
def sealed(tmp_path_factory: pytest.TempPathFactory) -> EpisodeLog:
    """The door is a wall from the first step on; there is no fail-safe."""
    return recorded(tmp_path_factory.mktemp("sealed") / "a.mcap", episode(always(LEFT_ROOM)))


@pytest.fixture(scope="module")
def diagnosis(sealed: EpisodeLog) -> Diagnosis:
    return diagnose(sealed)


def test_the_door_is_the_blocking_cell_and_the_opening(diagnosis: Diagnosis) -> None:
    assert diagnosis.outcome is Outcome.SEALED_IN
    (sealing,) = diagnosis.sealings
    assert sealing.blocking is not None
    assert sealing.opening is not None
    assert sealing.blocking.cells.tolist() == [list(DOOR)]
    assert sealing.opening.cells.tolist() == [list(DOOR)]
    assert sealing.kind == "closed_door"
    assert (sealing.first_step, sealing.ending, sealing.moves) == (0, Ending.FINAL, 0)
    assert sealing.inside == 25  # the left room
    assert sealing.hidden == 7 * 7  # the right room and its other walls


def test_what_is_told_of_the_blocking_cell(diagnosis: Diagnosis) -> None:
    (blame,) = diagnosis.sealings[0].blame
    assert blame.cell == Cell(*DOOR)
    assert blame.p_wall == pytest.approx(0.99, abs=0.002)
    assert (blame.since, blame.first, blame.flickers, blame.seen_at) == (0, 0, 0, None)
    assert blame.distance == pytest.approx(math.hypot(4 - 3, 6 - 2))  # of cell (4, 2), seen first
    assert (blame.seen_free, blame.seen_occupied) == (0, 0)


def test_what_would_have_helped(diagnosis: Diagnosis) -> None:
    remedy = diagnosis.sealings[0].remedy
    assert remedy.viewpoint is not None
    assert (remedy.viewpoint.cell, remedy.viewpoint.moves) == (Cell(4, 5), 4)
    assert (remedy.viewpoint.sees, remedy.viewpoint.suffices) == (1, True)
    assert remedy.fail_safe_moves is not None
    assert remedy.delta_occupied_above == pytest.approx(2 * 252 / 255 - 1)


def test_the_fail_safe_costs_what_was_foretold(diagnosis: Diagnosis, tmp_path: Path) -> None:
    log = recorded(tmp_path / "a.mcap", episode(always(LEFT_ROOM), fail_safe=True))
    (sealing,) = diagnose(log).sealings
    assert log.outcome is Outcome.MAPPED
    assert sealing.ending is Ending.SEEN
    assert sealing.moves == diagnosis.sealings[0].remedy.fail_safe_moves
    assert sealing.blame[0].seen_at == sealing.first_step + sealing.moves


def test_a_prediction_that_changes_lets_out_as_well(tmp_path: Path) -> None:
    open_door = until(LEFT_ROOM, 15, TWO_ROOMS.replace("......#\n", "??????#\n"))
    log = recorded(tmp_path / "a.mcap", episode(open_door, fail_safe=True))
    first = diagnose(log).sealings[0]
    assert (first.first_step, first.ending) == (0, Ending.PREDICTION)
    assert first.last_step == first.moves - 1


def test_mapped_while_sealed_in(tmp_path: Path) -> None:
    no_door = TWO_ROOMS.replace("#............#", "#.....#......#")
    made = episode(until(LEFT_ROOM, 15, no_door), fail_safe=True)
    log = recorded(tmp_path / "a.mcap", made)
    (sealing,) = diagnose(log).sealings
    assert log.outcome is Outcome.MAPPED
    assert sealing.ending is Ending.MAPPED


def test_an_unfinished_log_is_diagnosed_as_far_as_it_goes(
    sealed: EpisodeLog, tmp_path: Path
) -> None:
    made = episode(always(LEFT_ROOM), fail_safe=True)
    log = recorded(tmp_path / "a.mcap", made)
    writer = EpisodeWriter(tmp_path / "b.mcap", log.header)
    writer.add(log[0])
    writer.add(log[1])
    writer.close()
    found = diagnose(EpisodeLog(writer.part))
    assert found.sealings[0].ending is Ending.UNFINISHED
    assert any("unfinished" in note for note in found.notes)


def test_never_sealed_in_is_one_line(tmp_path: Path) -> None:
    log = recorded(tmp_path / "a.mcap", episode(always(TWO_ROOMS.replace(".", "?"))))
    found = diagnose(log)
    assert found.sealings == ()
    assert "was never sealed in: the episode ended mapped" in paragraph(found)


def test_observed_maps_cannot_seal(tmp_path: Path) -> None:
    made = episode(always(LEFT_ROOM), plan_on="observed", build="observed")
    found = diagnose(recorded(tmp_path / "a.mcap", made))
    assert found.sealings == ()
    assert any("cannot be sealed in" in note for note in found.notes)


def test_the_paragraph_says_it(diagnosis: Diagnosis) -> None:
    text = paragraph(diagnosis)
    for part in (
        "was sealed in at step 0",
        "for good",
        "by 1 false wall at (3, 6)",
        "The opening there is 1 cell wide",
        "was predicted since step 0",
        "it was never observed",
        "4 moves to (4, 5) would have shown 1 false wall, and freed it",
    ):
        assert part in text
    assert what_if(diagnosis, PurePosixPath("a.mcap")) == [
        "mapreplay", "branch", PurePosixPath("a.mcap"), "--at", "0", "--with", "truth",
    ]  # fmt: skip


def test_a_detour_to_a_frontier_that_did_not_exist(tmp_path: Path) -> None:
    """A door is predicted above the true one, in the wall: the agent goes there until it sees it.

    The true door is predicted shut, so that there is nowhere else to go.
    """
    wrong_door = """
        #######???????
        #.....#???????
        #......???????
        #.....#???????
        #.....#???????
        #.....#???????
        #######???????
    """
    made = episode(always(wrong_door), start=(3, 1))
    log = recorded(tmp_path / "a.mcap", made)
    (harm,) = diagnose(log).harms
    assert (harm.kind, harm.target) == (HarmKind.PHANTOM_FRONTIER, Cell(4, 6))
    seen = next(step.index for step in log if step.observed[4, 6] == OCCUPIED)
    assert (harm.first_step, harm.last_step, harm.moves) == (0, seen - 1, seen)
    assert seen == 4  # moves from (3, 1) to (4, 5), beside it


A, B, ELSEWHERE = Cell(3, 2), Cell(3, 9), Cell(1, 12)


def oscillations(
    targets: list[Cell], gone: dict[int, Cell] | None = None, seen: dict[int, Cell] | None = None
) -> list[tuple[int, int, Cell]]:
    """What is found in steps with these targets; `gone` are those that are no frontier cells any
    more from a step on, and `seen` cells that are observed from a step on.
    """
    made = episode(always(LEFT_ROOM), plan_on="observed", build="observed")
    first = next(iter(run_episode(made)))
    assert first.decision is not None
    detector = HarmDetector(made.header)
    for index, target in enumerate(targets):
        left = {A, B, ELSEWHERE} - {c for k, c in (gone or {}).items() if k <= index}
        observed = first.observed.copy()
        for k, cell in (seen or {}).items():
            if k <= index:
                observed[cell] = 0
        chosen = replace(first.decision.chosen, cell=target)
        step = replace(
            first,
            index=index,
            observed=observed,
            frontier=np.array(sorted(left), np.int32),
            decision=replace(first.decision, chosen=chosen),
        )
        detector.take(step)
    found = [harm for harm in detector.harms() if harm.kind is HarmKind.OSCILLATION]
    return [(harm.first_step, harm.last_step, harm.target) for harm in found]


def test_to_and_fro_between_two_targets_for_nothing() -> None:
    assert oscillations([A, A, B, B, A]) == [(2, 4, A)]
    assert oscillations([A, B, A, B, A]) == [(1, 4, A)]  # once, not three times
    assert oscillations([A, B, ELSEWHERE, A]) == [(1, 3, A)]


def test_who_does_not_come_back_or_has_a_reason_does_not_oscillate() -> None:
    assert oscillations([A, A, A]) == []
    assert oscillations([A, B, B, B]) == []
    assert oscillations([A, Cell(A.row + 1, A.col), A]) == []  # one place
    assert oscillations([A, B, B, A], gone={3: B}) == []  # B was reached
    assert oscillations([A, B, B, A], gone={1: A}) == []  # A was no frontier cell when it was left
    assert oscillations([A, *[B] * 25, A]) == []  # long ago
    near_a, near_b, far = Cell(4, 3), Cell(5, 12), Cell(1, 2)
    assert oscillations([A, B, B, A], seen={2: near_a}) == []  # A may be worth more than it was
    assert oscillations([A, B, B, A], seen={2: near_b}) == []  # and B less
    assert oscillations([B, ELSEWHERE, B], seen={2: far}) == [(1, 2, B)]


def test_free_space_through_a_wall(tmp_path: Path) -> None:
    wall = """
        #######
        #..#..#
        #..#..#
        #..#..#
        #.....#
        #######
    """
    no_wall = """
        #######
        #....?#
        #....?#
        #....?#
        #####?#
        #######
    """
    found = diagnose(recorded(tmp_path / "a.mcap", episode(always(no_wall), wall)))
    passage_harm = [h for h in found.harms if h.kind is HarmKind.PHANTOM_PASSAGE]
    assert passage_harm
    assert passage_harm[0].first_step == 0


def test_coverage_that_is_wrong_at_the_end(tmp_path: Path) -> None:
    log = recorded(
        tmp_path / "a.mcap", episode(always(TWO_ROOMS.replace("#.....#..", "#........")))
    )
    found = diagnose(log)
    assert log.outcome is Outcome.MAPPED
    assert found.coverage is not None
    assert found.coverage.is_short
    assert found.coverage.false_free == 4


NEAR = """
    #########
    #...#...#
    #...#...#
    #.......#
    #.......#
    #...#...#
    #########
"""


def test_near_miss_one_cell_is_left(tmp_path: Path) -> None:
    """Of a door of two cells one is predicted shut."""
    half = """
        #####????
        #...#????
        #...#????
        #...#????
        #....????
        #...#????
        #####????
    """
    found = diagnose(recorded(tmp_path / "a.mcap", episode(always(half), NEAR)))
    near = [miss for miss in found.near_misses if miss.kind is NearMissKind.ONE_CELL]
    assert near
    assert near[0].first_step == 0
    assert not near[0].led_to_sealing


LEFT_ROOM_OPEN = """
    #######???????
    #.....#???????
    #.....#???????
    #......???????
    #.....#???????
    #.....#???????
    #######???????
"""


def test_near_miss_the_way_out_closes_behind_the_agent(tmp_path: Path) -> None:
    """The prediction shuts the door when the agent has just seen it open."""
    log = recorded(tmp_path / "a.mcap", episode(until(LEFT_ROOM_OPEN, 24, LEFT_ROOM)))
    found = diagnose(log)
    assert any(miss.kind is NearMissKind.CLOSING for miss in found.near_misses)


def test_a_map_that_is_nearly_done_is_no_near_miss(tmp_path: Path) -> None:
    """The last prediction leaves no frontier because it leaves nothing to be seen."""
    log = recorded(tmp_path / "a.mcap", episode(until(LEFT_ROOM_OPEN, 30, TWO_ROOMS), coverage=1.0))
    assert log.outcome is Outcome.MAPPED
    assert diagnose(log).near_misses == ()


def test_a_log_without_a_true_map(tmp_path: Path) -> None:
    """An external log: that the way out vanished is seen, and no more."""
    observed = np.full((7, 14), UNKNOWN, np.int8)
    observed[1:6, 1:6] = 0
    external = ExternalEpisode(unknown_floor_plan("lab", (7, 14), 0.1), (3, 3), planner="theirs")
    path = tmp_path / "lab.mcap"
    p_wall = np.where(draw(LEFT_ROOM) == 100, 0.99, 0.5)
    with EpisodeWriter(path, external.header) as writer:
        writer.add(external.step((3, 3), observed, p_wall=p_wall, outcome="sealed_in"))
    found = diagnose(EpisodeLog(path))
    (sealing,) = found.sealings
    assert sealing.blocking is None
    assert sealing.remedy.delta_occupied_above is not None
    assert any("no true map" in note for note in found.notes)
    assert "sealed in at step 0" in paragraph(found)


def test_a_log_without_predictions(tmp_path: Path) -> None:
    observed = np.zeros((5, 5), np.int8)
    external = ExternalEpisode(unknown_floor_plan("lab", (5, 5), 0.1), (3, 3), planner="theirs")
    with EpisodeWriter(tmp_path / "a.mcap", external.header) as writer:
        writer.add(external.step((3, 3), observed, outcome="mapped"))
    found = diagnose(EpisodeLog(tmp_path / "a.mcap"))
    assert any("no prediction" in note for note in found.notes)


def test_flicker_is_counted() -> None:
    truth = draw("....")
    unseen = np.full_like(truth, UNKNOWN)
    wall = unseen.copy()
    wall[0, 2] = 100
    p_wall = quantize(np.full(truth.shape, 0.9), PredictionDtype.UINT8)
    seen = truth.copy()
    maps = [(unseen, p_wall, m) for m in (unseen, wall, unseen, wall, wall)]
    maps += [(seen, p_wall, seen)]
    ((blame,),) = trace_blame(maps, [(4, np.array([[0, 2]], np.int32))])
    assert (blame.first, blame.since, blame.flickers, blame.seen_at) == (1, 3, 1, 5)
    assert blame.distance is None
    assert len(blame.history) == 6


ROOM = """
    ##W##
    #.AfW
    ##WWW
"""


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_the_thresholds_are_exact(seed: int) -> None:
    """Just above, the agent is out; at the threshold itself it is not."""
    drawn_belief = belief("#####\n#...#\n#####", ROOM)
    rng = np.random.default_rng(seed)
    levels = rng.integers(225, 256, drawn_belief.truth.shape)
    levels[drawn_belief.fused == 0] = rng.integers(0, 20)
    p_wall = levels.astype(np.uint8)
    base = Thresholds(0.7, 0.7)
    agent, observed = drawn_belief.agent, drawn_belief.observed
    scratch = Scratch(observed.shape)

    def is_out(free: float, occupied: float) -> bool:
        return scratch.has_way_out(fuse(observed, p_wall, Thresholds(free, occupied)), agent)

    fused = fuse(observed, p_wall, base)
    if scratch.has_way_out(fused, agent):
        return
    inside = reached(fused, agent)
    walls = threshold_of_walls(observed, fused, p_wall, inside)
    if walls is None:
        assert not is_out(0.7, 1.0)
    else:
        assert is_out(0.7, min(1.0, walls + 1e-6))
        assert not is_out(0.7, walls - 1e-6)
    free = threshold_of_free(observed, fused, p_wall, inside)
    if free is None:
        assert not is_out(1.0, 0.7)
    else:
        assert is_out(min(1.0, free + 1e-6), 0.7)
        assert not is_out(free - 1e-6, 0.7)


def test_width_and_length_of_a_passage() -> None:
    house = draw(
        """
        ###########
        #....#....#
        #.........#
        #....#....#
        ####.######
        ####.######
        ####.######
        ####.######
        #.........#
        ###########
        """
    )
    assert passage_size(house, Cell(7, 5)) == (1, 1)  # the door
    assert passage_size(house, Cell(4, 4)) == (1, 4)  # the corridor


def test_the_json_has_all_of_it(diagnosis: Diagnosis, tmp_path: Path) -> None:
    record = record_of(diagnosis)
    assert json.loads(json.dumps(record))["schema"] == "mapreplay.diagnosis/1"
    assert record["sealings"][0]["culprits"]["cells"] == [list(DOOR)]
    log = tmp_path / "x.mcap"
    path = save_next_to(log, record)
    assert path == diagnosis_path(log) == tmp_path / "x.diagnosis.json"
    assert json.loads(path.read_text()) == record
    save_next_to(log, record)  # again: the same
    path.write_text("mine")
    with pytest.raises(ExistsError, match="is no diagnosis"):
        save_next_to(log, record)


def test_marks_point_at_the_blocking_cell_while_it_is_sealed_in(diagnosis: Diagnosis) -> None:
    marks = marks_of(diagnosis)
    blocking_cell = next(mark for mark in marks if mark.name == "blocking cell")
    assert blocking_cell.cells.tolist() == [list(DOOR)]
    assert (blocking_cell.first_step, blocking_cell.last_step) == (0, 0)


def test_the_page_shows_map_history_and_rules(sealed: EpisodeLog, diagnosis: Diagnosis) -> None:
    page = diagnosis_page([(sealed.path, diagnosis)])
    assert page.count("data:image/png") == 3
    assert page.count("data:image/svg+xml") == 2
    assert "closed door" in page


def test_counts_over_a_corpus(diagnosis: Diagnosis) -> None:
    whole = groups([diagnosis, diagnosis])[0]
    assert (whole.episodes, whole.sealed.count, whole.final, whole.sealings) == (2, 2, 2, 2)
    assert [row.kind for row in kind_counts([diagnosis])] == ["closed_door"]
    frame = sealing_table(["a"], [diagnosis])
    assert frame["kind"].to_list() == ["closed_door"]
    empty = [title for title, table in all_tables([diagnosis]) if not len(table)]
    assert empty == ["Cost of being freed: means per episode, with 95 % intervals"]


def test_the_keys_of_json_stay_while_names_in_the_code_change(diagnosis: Diagnosis) -> None:
    record = corpus_record([diagnosis])
    assert {"culprits", "doorway", "view"} <= record["kinds"][0].keys()
    assert "claims" in record["calibration"][0]
    assert {"culprits", "doorway", "place", "blame"} <= record_of(diagnosis)["sealings"][0].keys()


def test_what_it_cost_to_be_freed(diagnosis: Diagnosis, tmp_path: Path) -> None:
    """Only episodes that were always freed are counted."""
    freed = diagnose(recorded(tmp_path / "a.mcap", episode(always(LEFT_ROOM), fail_safe=True)))
    (cost,) = costs([diagnosis, freed, freed])
    (sealing,) = freed.sealings
    assert (cost.by, cost.episodes, cost.times) == ("all", 2, 2)
    assert cost.moves.mean == sealing.moves
    assert cost.metres.mean == sealing.metres
    assert cost.share.mean == sealing.moves / (freed.steps - 1)
    assert costs([diagnosis]) == []


def test_the_order_of_the_logs_is_in_no_interval(tmp_path: Path) -> None:
    freed = diagnose(recorded(tmp_path / "a.mcap", episode(always(LEFT_ROOM), fail_safe=True)))
    many = [
        replace(
            freed,
            steps=freed.steps + k * k,
            header=replace(freed.header, floor_plan=replace(freed.header.floor_plan, id=f"p{k}")),
        )
        for k in range(9)
    ]
    shuffled = [many[k] for k in (3, 8, 1, 0, 7, 2, 6, 5, 4)]
    assert corpus_record(shuffled) == corpus_record(many)


def test_reliability_is_the_share_that_was_counted() -> None:
    counts = np.zeros((2, 50), np.int64)
    counts[:, 45] = 1, 3
    assert Reliability(counts).right(0.91) == (0.75, 4)
    assert math.isnan(Reliability(counts).right(0.5)[0])


def test_runs_of_integers() -> None:
    assert list(runs([1, 2, 5, 7, 8, 9])) == [(1, 2), (5, 5), (7, 9)]
    assert list(runs([])) == []
