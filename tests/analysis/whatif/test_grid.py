"""Other thresholds on logged predictions: the same as fusing, scoring and planning again."""

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from drawing import plan
from fakes import FixedPredictor, NoisyPredictor
from mapreplay import mapping, scores
from mapreplay.analysis.reporting.figures import render
from mapreplay.analysis.whatif.figure import HeatMap
from mapreplay.analysis.whatif.grid import sufficient_thresholds, what_if, what_if_frame
from mapreplay.config import EpisodeConfig
from mapreplay.episode import prepare_episode, run_episode
from mapreplay.errors import LogError, UsageError
from mapreplay.grid import Grid
from mapreplay.mapping import Thresholds
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.recorders.log.writer import EpisodeWriter
from mapreplay.recorders.pictures.palette import PAGE_DARK
from mapreplay.stages import look_around
from recordings import record, three_rooms, two_rooms

SAMPLES = Path(__file__).parents[3] / "samples" / "episodes"
SEALED = SAMPLES / "procedural-60014__cost-utility__fused-fused__s1.mcap"
DELTAS = (0.05, 0.2, 0.4, 0.7, 1.0)


class Late(FixedPredictor):
    """Predicts nothing before 31 cells are known."""

    def predict(self, observed: Grid) -> npt.NDArray[np.float32] | None:  # type: ignore[override]
        return self.p_wall if (observed >= 0).sum() > 30 else None


@pytest.fixture(scope="module", params=["uint8", "uint16", "float32", "late"])
def log(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> EpisodeLog:
    """An episode with random predictions, most of them walls, so that every threshold matters."""
    header = two_rooms().header
    late = request.param == "late"
    dtype = "uint8" if late else request.param
    values = header.config.model_dump() | {"prediction_dtype": dtype, "max_steps": 8}
    p_wall = np.random.default_rng(1).random(header.floor_plan.shape) ** 0.3
    episode = prepare_episode(
        EpisodeConfig.of(values),
        header.floor_plan,
        predictor=(Late if late else FixedPredictor)(p_wall.astype(np.float32)),
    )
    path = tmp_path_factory.mktemp("noisy") / "log.mcap"
    with EpisodeWriter(path, episode.header) as writer:
        for step in run_episode(episode):
            writer.add(step)
    return EpisodeLog(path)


def test_every_pair_is_what_fusing_scoring_and_planning_again_gives(log: EpisodeLog) -> None:
    result = what_if(log, DELTAS, DELTAS)
    config = EpisodeConfig(coverage=log.header.config.coverage)  # plans on fused, builds fused
    truth, region = log.header.floor_plan.cells, log.header.explorable
    sealed_somewhere = 0
    for i, delta_free in enumerate(DELTAS):
        for j, delta_occupied in enumerate(DELTAS):
            reached = False
            for k, step in enumerate(log):
                thresholds = Thresholds(delta_free, delta_occupied)
                fused = mapping.fuse(step.observed, step.p_wall, thresholds)
                counts = scores.tally(fused, truth, region)
                assert result.f1[k, i, j] == pytest.approx(scores.score(counts).f1)
                covered = scores.coverage(counts)
                assert result.coverage[k, i, j] == covered.known
                assert result.correct[k, i, j] == covered.correct
                reached = reached or covered.known >= config.coverage
                view = look_around(config, step.agent, step.observed, fused)
                sealed = not reached and len(view.frontier) == 0
                assert result.sealed[k, i, j] == sealed, (delta_free, delta_occupied, k)
                sealed_somewhere += sealed
    assert sealed_somewhere > 0


def test_the_thresholds_of_the_episode_give_what_was_logged() -> None:
    log = EpisodeLog(SEALED)
    config = log.header.config
    result = what_if(log, [config.delta_free], [config.delta_occupied])
    assert result.f1[:, 0, 0].tolist() == [step.metrics.f1 for step in log]
    assert result.coverage[:, 0, 0].tolist() == [step.metrics.coverage_fused for step in log]
    course = result.course(0, 0)
    assert (course.sealed, course.freed, course.sealed_steps) == (10, None, 1)
    assert len(log) - 1 == 10  # where the episode ended, sealed in


def test_release_finds_the_least_change_that_leaves_a_way_on() -> None:
    log = EpisodeLog(SEALED)
    deltas = [k / 100 for k in range(1, 101)]
    found = sufficient_thresholds(log, 10, deltas)
    assert found.delta_occupied == 0.76
    config = log.header.config
    result = what_if(log, [config.delta_free], [0.75, 0.76])
    assert result.sealed[10, 0].tolist() == [True, False]
    assert found.delta_free == 0.9
    result = what_if(log, [0.89, 0.9], [config.delta_occupied])
    assert result.sealed[10, :, 0].tolist() == [True, False]
    assert sufficient_thresholds(log, 10, [0.5]).delta_occupied is None


def test_a_stricter_threshold_never_seals_in_who_had_a_way_on(log: EpisodeLog) -> None:
    result = what_if(log, DELTAS, DELTAS)
    reached = np.maximum.accumulate(result.coverage >= result.target, axis=0)
    for k in range(len(log)):
        # Where one of the two has ended, nothing can be said.
        both = ~reached[k]
        wider = result.sealed[k][:-1] | ~both[:-1] | ~both[1:]
        assert (wider | ~result.sealed[k][1:]).all()


def test_the_table_has_a_row_a_pair(log: EpisodeLog) -> None:
    result = what_if(log, DELTAS, (0.3, 0.9))
    frame = what_if_frame(result, step=2)
    assert len(frame) == 10
    row = frame.row(3, named=True)
    assert (row["delta_free"], row["delta_occupied"]) == (0.2, 0.9)
    assert row["f1"] == result.f1[2, 1, 1]
    assert row["mean_coverage"] == pytest.approx(result.coverage[:, 1, 1].mean())


def test_the_heat_map_is_a_picture_and_the_same_one_each_time(log: EpisodeLog) -> None:
    picture = HeatMap(what_if(log, DELTAS, (0.5,)), 3, (0.7, 0.5))
    png = render(picture, (6, 3), form="png")
    assert png.startswith(b"\x89PNG")
    assert png == render(picture, (6, 3), form="png")
    assert png != render(picture, (6, 3), PAGE_DARK, form="png")
    assert render(picture, (6, 3)) == render(picture, (6, 3))


def test_what_makes_no_sense_is_refused(log: EpisodeLog, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="delta-free: thresholds must be above 0 and at most 1"):
        what_if(log, [0.0], [0.5])
    with pytest.raises(UsageError, match="delta-occupied: a threshold is repeated"):
        what_if(log, [0.5], [0.5, 0.5])
    without = EpisodeLog(record(tmp_path, three_rooms(max_steps=2)).path)
    with pytest.raises(LogError, match="no step has a prediction"):
        what_if(without, [0.5], [0.5])


def test_walls_that_nobody_knows_have_no_score(tmp_path: Path) -> None:
    episode = prepare_episode(
        EpisodeConfig(max_steps=2), plan("?????\n?...?\n?????", "open"), predictor=NoisyPredictor()
    )
    with EpisodeWriter(tmp_path / "log.mcap", episode.header) as writer:
        for step in run_episode(episode):
            writer.add(step)
    frame = what_if_frame(what_if(EpisodeLog(tmp_path / "log.mcap"), [0.01], [1.0]))
    assert frame["coverage"][0] == 1.0
