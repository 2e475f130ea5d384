"""Training: simulated observations, batches, and a loop that learns, stops and goes on."""

import errno
import hashlib
import json
import os
from collections.abc import Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
import torch

from drawing import draw, plan
from mapreplay.errors import ExistsError, FloorPlanError, MapreplayError, WeightsError, WriteError
from mapreplay.floorplan import FloorPlan, explorable
from mapreplay.floorplans.procedural import Style, generate
from mapreplay.grid import FREE, UNKNOWN, Cell
from mapreplay.predictors.architectures import ARCHITECTURES
from mapreplay.predictors.network import OUTSIDE
from mapreplay.predictors.weights import encode_tensors
from mapreplay.sensor import Sensor
from mapreplay.training.batches import BatchPosition, batches_from
from mapreplay.training.dataset import (
    ORIENTATIONS,
    Epoch,
    Layout,
    LossRegion,
    TrainingPlan,
    load_plans,
    make_batch,
    padded_shape,
    prepare_plan,
    turned,
)
from mapreplay.training.loop import Trainer, TrainingConfig, TrainingError, finish
from mapreplay.training.observations import (
    RUNS_PER_PLAN,
    observation_draws,
    simulate_observations,
)

AS_IN_THE_PAPER = Layout(UNKNOWN, LossRegion.ALL)
NEARBY = Layout(OUTSIDE, LossRegion.NEARBY, fewest_left_over=2)


@pytest.fixture(scope="module")
def plans() -> list[TrainingPlan]:
    small = Style(height=24, width=24, min_room=5, door=3, shift=2)
    return [prepare_plan(i, generate(i, small)) for i in range(12)]


def test_simulated_observations_are_true_connected_and_not_everything(
    plans: list[TrainingPlan],
) -> None:
    shares = []
    for item in plans:
        for run in range(RUNS_PER_PLAN):
            seen = simulate_observations(
                item.truth, item.explorable, Sensor(), observation_draws(0, item.number, run)
            )
            known = seen != UNKNOWN
            assert (seen[known] == item.truth[known]).all()
            # Free cells seen hang together: they were seen by one walk.
            free = seen == FREE
            start = Cell(*np.argwhere(free)[0].tolist())
            region = explorable(np.where(free, 0, 100).astype(np.int8), start)
            assert (region & free).sum() == free.sum()
            shares.append(known[item.explorable].mean())
    assert min(shares) < 0.4
    assert max(shares) > 0.8


def test_the_same_run_is_the_same_observation_and_another_run_is_not() -> None:
    item = prepare_plan(0, generate(0))

    def observed(run: int) -> bytes:
        draws = observation_draws(0, 0, run)
        return simulate_observations(item.truth, item.explorable, Sensor(), draws).tobytes()

    assert observed(1) == observed(1)
    assert len({observed(run) for run in range(RUNS_PER_PLAN)}) == RUNS_PER_PLAN


def test_an_epoch_has_every_run_of_every_plan_once_and_batches_of_one_size() -> None:
    mixed = [prepare_plan(i, FloorPlan("box", np.pad(np.zeros((6 + i, 9), np.int8), 1,
             constant_values=100), 0.2)) for i in range(10)]  # fmt: skip
    epoch = Epoch(mixed, cells_per_batch=400, seed=1, number=0, layout=AS_IN_THE_PAPER)
    groups = epoch.batches()
    assert sorted(pair for group in groups for pair in group) == [
        (p, r) for p in range(10) for r in range(RUNS_PER_PLAN)
    ]
    assert groups == Epoch(mixed, 400, 1, 0, AS_IN_THE_PAPER).batches()
    assert groups != Epoch(mixed, 400, 1, 1, AS_IN_THE_PAPER).batches()
    for group in groups:
        batch = epoch.batch(group)
        assert batch.observed.shape == batch.truth.shape == batch.explorable.shape
        assert batch.observed.shape[1] % 8 == batch.observed.shape[2] % 8 == 0
        assert not batch.explorable[batch.truth == UNKNOWN].any()


def test_large_plans_are_cut_around_their_start() -> None:
    cells = np.full((400, 300), 100, np.int8)
    cells[1:-1, 1:-1] = 0
    item = prepare_plan(0, FloorPlan("hall", cells, 0.2))
    assert item.truth.shape == (160, 160)
    assert item.explorable.any()
    assert padded_shape(item) == (160, 160)


def test_one_bad_plan_does_not_end_the_loading() -> None:
    good = plan("""
        ########
        #......#
        #......#
        #......#
        #......#
        #......#
        #......#
        ########
    """)

    class Houses:
        default_predictor = ""

        def ids(self) -> Sequence[str]:
            return ["last", "first", "bad", "tiny"]

        def load(self, floor_plan_id: str) -> FloorPlan:
            if floor_plan_id == "bad":
                raise FloorPlanError("house bad: not a house")
            return FloorPlan("tiny", draw("."), 1.0) if floor_plan_id == "tiny" else good

    results = list(load_plans({"first": 0, "bad": 1, "tiny": 2, "last": 3}, Houses()))
    assert [isinstance(r, TrainingPlan) for r in results] == [True, False, False, True]
    assert results[3].number == 3  # type: ignore[union-attr]


def train(
    plans: list[TrainingPlan],
    checkpoint: Path,
    stop_after: int | None = None,
    resume: bool = False,
    architecture: str = "autoencoder",
) -> Trainer:
    config = TrainingConfig(samples=480, batch=8, validate_every=120, architecture=architecture)
    trainer = Trainer(plans[:10], plans[10:], config, "cpu", checkpoint)
    if resume:
        trainer.resume()
    for report in trainer.run():
        if isinstance(report, int) and stop_after and report > stop_after:
            break
    return trainer


@pytest.mark.parametrize("architecture", ARCHITECTURES)
def test_training_learns(plans: list[TrainingPlan], tmp_path: Path, architecture: str) -> None:
    trainer = train(plans, tmp_path / "a.checkpoint", architecture=architecture)
    losses = [point.validation_loss for point in trainer.curve]
    assert len(losses) == 4
    assert losses[-1] < losses[0]
    assert trainer.samples >= 480


@pytest.mark.parametrize("architecture", ARCHITECTURES)
def test_training_goes_on_where_it_was_killed_and_ends_the_same(
    plans: list[TrainingPlan], tmp_path: Path, architecture: str
) -> None:
    whole = train(plans, tmp_path / "whole.checkpoint", architecture=architecture)
    cut = tmp_path / "cut.checkpoint"
    train(plans, cut, stop_after=240, architecture=architecture)
    resumed = train(plans, cut, resume=True, architecture=architecture)
    assert [p.samples for p in resumed.curve] == [p.samples for p in whole.curve]
    for name, value in whole.model.state_dict().items():
        assert (resumed.model.state_dict()[name] == value).all(), name


@pytest.mark.filterwarnings("ignore:.*use of fork")  # with threads, from Python 3.12 on
def test_any_number_of_processes_makes_the_same_batches(plans: list[TrainingPlan]) -> None:
    def epoch(number: int) -> Epoch:
        return Epoch(plans[:3], 24 * 24 * 4, 0, number, NEARBY, augment=True)

    def first_six(jobs: int) -> list[tuple[BatchPosition, bytes]]:
        batches = islice(batches_from(epoch, BatchPosition(0, 1), jobs), 6)
        return [(place, batch.observed.tobytes() + batch.weights.tobytes())
                for place, batch in batches]  # fmt: skip

    alone = first_six(jobs=1)
    assert [place for place, _ in alone] == [(0, 1), (0, 2), (0, 3), (1, 0), (1, 1), (1, 2)]
    assert first_six(jobs=2) == alone


def test_maps_are_turned_and_mirrored_all_alike() -> None:
    cells = draw("""
        #..
        ##.
    """)
    ways = [turned(cells, orientation).tolist() for orientation in range(ORIENTATIONS)]
    assert all(way not in ways[:i] for i, way in enumerate(ways))
    assert (turned(cells, 4) == draw("""
        ..
        #.
        ##
    """)).all()  # fmt: skip
    item = prepare_plan(0, plan("""
        #########
        #.......#
        #.......#
        #.......#
        #########
    """))  # fmt: skip
    for orientation in range(ORIENTATIONS):
        batch = make_batch([item], [0], 0, NEARBY, orientation)
        assert batch.observed.shape == ((1, 16, 8) if orientation & 4 else (1, 8, 16))
        known = batch.observed[0] >= 0
        assert (batch.observed[0][known] == batch.truth[0][known]).all()
        assert batch.explorable.any()
        assert (batch.observed[0, -1, -1] == OUTSIDE).all()  # what is added is at the high ends
        assert batch.observed[0, 0, 0] != OUTSIDE


def test_a_checkpoint_of_another_training_is_refused_with_what_differs(
    plans: list[TrainingPlan], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.checkpoint"
    config = train(plans, path).config

    def refused(trainer: Trainer) -> str:
        with pytest.raises(WeightsError, match=r"a.checkpoint: was made with ") as error:
            trainer.resume()
        assert "\n" not in str(error.value)
        return str(error.value).partition("was made with ")[2]

    def with_options(**changes: object) -> Trainer:
        return Trainer(plans[:10], plans[10:], replace(config, **changes), "cpu", path)  # type: ignore[arg-type]

    assert refused(with_options(samples=999)).startswith("--samples 480 (now 999); resume")
    assert refused(with_options(loss_region=LossRegion.NEARBY, weight_decay=0.5)).startswith(
        "--loss-region all (now nearby); --weight-decay 0.0 (now 0.5); resume"
    )
    assert refused(with_options(init_sha256="c0ffee" + 58 * "0")).startswith(
        "other --init weights: sha256 none (now c0ffee000000); resume"
    )
    # As many plans, with the same ids: but one cell of one of them is another.
    cells = plans[4].truth.copy()
    cells[12, 12] = FREE if cells[12, 12] else 100
    changed = [*plans[:4], replace(plans[4], truth=cells), *plans[5:]]
    said = refused(Trainer(changed[:10], plans[10:], config, "cpu", path))
    assert said.startswith("other training plans: 10 from procedural-0 to procedural-9, sha256 ")
    assert "validation" not in said
    said = refused(Trainer(plans[:10], plans[11:], config, "cpu", path))
    assert said.startswith("other validation plans: 2 from procedural-10 to procedural-11, ")
    reordered = Trainer([plans[1], plans[0], *plans[2:10]], plans[10:], config, "cpu", path)
    assert refused(reordered).startswith("other training plans")
    monkeypatch.setattr("mapreplay.training.origin.source_digest", lambda *_: 64 * "1")
    assert "(now 111111111111)" in refused(with_options())


def test_a_damaged_checkpoint_is_one_line(plans: list[TrainingPlan], tmp_path: Path) -> None:
    path = tmp_path / "a.checkpoint"
    trainer = train(plans, path)
    whole = path.read_bytes()

    def refused(content: bytes, reason: str) -> None:
        path.write_bytes(content)
        fresh = Trainer(plans[:10], plans[10:], trainer.config, "cpu", path)
        with pytest.raises(WeightsError, match=f"a.checkpoint: {reason}"):
            fresh.resume()
        assert fresh.samples == 0

    refused(whole[:1000], "not a safetensors file")
    refused(whole[:-1] + bytes([whole[-1] ^ 1]), r"a damaged checkpoint \(its checksum")
    note = b'\\"state\\": {\\"samples\\"'
    assert note in whole
    refused(whole.replace(note, note.replace(b"samples", b"simples")), "a damaged checkpoint")
    refused(encode_tensors({"a": torch.zeros(1)}, {}), "not a training checkpoint")
    old = {"mapreplay.training": json.dumps({"config": {}, "plans": 10, "state": {}})}
    refused(encode_tensors({"a": torch.zeros(1)}, old), "of an earlier version")


@pytest.mark.parametrize("samples", [8, 480])  # the first batch still has a finite loss
def test_a_loss_that_is_not_finite_ends_the_training_and_nothing_of_it_is_written(
    plans: list[TrainingPlan], tmp_path: Path, samples: int
) -> None:
    checkpoint = tmp_path / "a.checkpoint"
    train(plans, checkpoint)
    before = checkpoint.read_bytes()
    config = TrainingConfig(samples=samples, batch=8, learning_rate=float("inf"))
    trainer = Trainer(plans[:10], plans[10:], config, "cpu", checkpoint)
    with pytest.raises(TrainingError, match=r"the loss is nan after .* samples; is the learning"):
        list(trainer.run())
    assert trainer.samples <= 100  # two batches: at once
    assert checkpoint.read_bytes() == before
    with pytest.raises(WeightsError, match="is not finite"):
        trainer.save()
    with pytest.raises(WeightsError, match="is not finite"):
        encode_tensors({"a": torch.tensor([1.0, float("inf")])}, {})
    assert checkpoint.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["a.checkpoint"]


def test_a_full_disk_at_a_checkpoint_leaves_the_one_before(
    plans: list[TrainingPlan], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    checkpoint = tmp_path / "a.checkpoint"
    train(plans, checkpoint, stop_after=240)
    before = checkpoint.read_bytes()

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(WriteError, match=r"a.checkpoint: cannot be written \(No space left"):
        train(plans, checkpoint, resume=True)
    monkeypatch.undo()
    assert checkpoint.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["a.checkpoint"]
    assert train(plans, checkpoint, resume=True).samples >= 480


@pytest.mark.parametrize("call", range(1, 4))
def test_weights_and_card_are_both_new_or_both_old(
    plans: list[TrainingPlan], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: int
) -> None:
    """The disk is full at the first, second or third file that is synchronized."""
    trainer = train(plans, tmp_path / "a.checkpoint")
    said = {"trained_on": "a", "validated_on": "b", "command": "c"}
    weights, card = tmp_path / "mine.safetensors", tmp_path / "mine.json"
    weights.write_text("old weights")
    card.write_text("old card")
    with pytest.raises(ExistsError, match=r"mine.json: exists"):
        finish(trainer, weights, **said)
    calls, sync = [], os.fsync

    def full(file: int) -> None:
        calls.append(file)
        if len(calls) == call:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        sync(file)

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(WriteError, match="No space left"):
        finish(trainer, weights, **said, force=True)
    monkeypatch.undo()
    assert (weights.read_text(), card.read_text()) == ("old weights", "old card")
    assert len(list(tmp_path.iterdir())) == 3
    made = finish(trainer, weights, **said, force=True)
    assert hashlib.sha256(weights.read_bytes()).hexdigest() == made.sha256
    assert json.loads(card.read_text())["sha256"] == made.sha256
    assert {p.name for p in tmp_path.iterdir()} == {"mine.safetensors", "mine.json"}


def test_batches_are_what_make_batch_says(plans: list[TrainingPlan]) -> None:
    batch = make_batch(plans[:3], [0, 1, 2], seed=5, layout=NEARBY)
    assert batch.observed.shape == (3, 24, 24)
    known = batch.observed != UNKNOWN
    assert (batch.observed[known] == batch.truth[known]).all()


def test_only_explorable_cells_count_where_that_is_asked_for(
    plans: list[TrainingPlan], tmp_path: Path
) -> None:
    def losses(region: LossRegion, held: list[TrainingPlan]) -> float:
        config = TrainingConfig(samples=8, batch=8, loss_region=region)
        trainer = Trainer(plans[:8], held, config, "cpu", tmp_path / "a.checkpoint")
        return [p for p in trainer.run() if not isinstance(p, int)][-1].validation_loss

    with_closed_room = """
        ########
        #....#{}#
        #....#{}#
        #....###
        #......#
        #......#
        #......#
        ########
    """
    held, turned = (
        [prepare_plan(0, plan(with_closed_room.format(closed, closed)))] for closed in ".#"
    )
    assert losses(LossRegion.EXPLORABLE, held) == losses(LossRegion.EXPLORABLE, turned)
    assert losses(LossRegion.ALL, held) != losses(LossRegion.ALL, turned)


def test_training_starts_from_given_weights(plans: list[TrainingPlan], tmp_path: Path) -> None:
    first = train(plans, tmp_path / "first.checkpoint")
    weights = tmp_path / "first.safetensors"
    card = finish(first, weights, trained_on="a", validated_on="b", command="c")
    config = TrainingConfig(samples=8, batch=8, init_sha256=card.sha256)
    second = Trainer(plans[:10], plans[10:], config, "cpu", tmp_path / "second.checkpoint")
    second.start_from(weights)
    for name, value in first.model.state_dict().items():
        assert (second.model.state_dict()[name] == value).all(), name


def test_weights_of_another_architecture_are_no_start(
    plans: list[TrainingPlan], tmp_path: Path
) -> None:
    first = train(plans, tmp_path / "first.checkpoint")
    weights = tmp_path / "first.safetensors"
    finish(first, weights, trained_on="a", validated_on="b", command="c")
    config = TrainingConfig(samples=8, batch=8, architecture="unet")
    second = Trainer(plans[:10], plans[10:], config, "cpu", tmp_path / "second.checkpoint")
    with pytest.raises(WeightsError, match="weights of the network autoencoder, not unet"):
        second.start_from(weights)


def test_nearby_unseen_cells_count_more() -> None:
    hall = plan("""
        ########
        #......#
        #......#
        ########
    """)
    seen = draw("""
        ??######
        ????...#
        ????...#
        ??######
    """)
    item = prepare_plan(0, hall, logged=[seen])
    batch = make_batch([item], [0], seed=0, layout=NEARBY)
    weights = batch.weights[0, :4, :8]
    assert weights[1].tolist() == pytest.approx([2 / 3, 4 / 5, 4 / 5, 4 / 5, 0, 0, 0, 0])
    assert weights[0].tolist() == pytest.approx([2 / 3, 4 / 5, 0, 0, 0, 0, 0, 0])
    assert (batch.weights[0, 4:] == 0).all()  # outside of the grid


def test_a_network_that_normalizes_is_never_given_one_small_map(
    plans: list[TrainingPlan], tmp_path: Path
) -> None:
    odd = plans[:3]  # 15 maps: seven batches of two, and one is left over
    epoch = Epoch(odd, 2 * 24 * 24, 0, 0, NEARBY)
    assert [len(group) for group in epoch.batches()] == [2] * 7
    config = TrainingConfig(samples=20, batch=1, architecture="unet")
    small = [prepare_plan(i, FloorPlan("hall", np.zeros((9 + 9 * i, 9), np.int8), 1.0))
             for i in range(2)]  # fmt: skip
    trainer = Trainer(small, plans[10:], config, "cpu", tmp_path / "a.checkpoint")
    assert [report for report in trainer.run() if not isinstance(report, int)]


def test_too_few_maps_are_told(plans: list[TrainingPlan], tmp_path: Path) -> None:
    alone = [TrainingPlan(0, plans[0].truth, plans[0].explorable, (plans[0].truth,))]
    config = TrainingConfig(samples=20, architecture="unet")
    trainer = Trainer(alone, plans[10:], config, "cpu", tmp_path / "a.checkpoint")
    with pytest.raises(MapreplayError, match="too few maps to train on"):
        next(trainer.run())


def test_an_epoch_has_all_logged_maps_and_as_many_simulated_ones(
    plans: list[TrainingPlan],
) -> None:
    truth = plans[0].truth
    logs = [
        TrainingPlan(i, truth, plans[0].explorable, (np.full_like(truth, UNKNOWN),) * (3 + i))
        for i in range(2)
    ]
    drawn = []
    for number in range(2):
        epoch = Epoch([*plans, *logs], 4096, 0, number, NEARBY)
        pairs = [pair for group in epoch.batches() for pair in group]
        logged = sorted((i, run) for i, run in pairs if i >= len(plans))
        assert logged == [(12, 0), (12, 1), (12, 2), (13, 0), (13, 1), (13, 2), (13, 3)]
        drawn.append({pair for pair in pairs if pair[0] < len(plans)})
        assert len(drawn[-1]) == 7
    assert drawn[0] != drawn[1]


def test_a_logged_map_is_cut_like_its_floor_plan() -> None:
    cells = np.full((400, 300), 100, np.int8)
    cells[1:-1, 1:-1] = 0
    hall = FloorPlan("hall", cells, 0.2)
    item = prepare_plan(0, hall, Cell(390, 20), [cells])
    assert (item.logged[0] == item.truth).all()
    assert item.truth.shape == (160, 160)
    assert item.runs == 1


def test_the_temperature_says_how_much_too_sure_a_network_is(
    plans: list[TrainingPlan], tmp_path: Path
) -> None:
    trainer = train(plans, tmp_path / "a.checkpoint")
    before = trainer.temperature()
    trainer.divide_logits(1 / 2)
    assert trainer.temperature() == pytest.approx(2 * before, rel=1e-3)
    trainer.divide_logits(2 * before)
    assert trainer.temperature() == pytest.approx(1, rel=1e-3)


def test_a_map_of_which_everything_was_seen_does_no_harm(
    plans: list[TrainingPlan], tmp_path: Path
) -> None:
    seen = [TrainingPlan(i, p.truth, p.explorable, (p.truth,)) for i, p in enumerate(plans[:2])]
    config = TrainingConfig(samples=4, batch=1, loss_region=LossRegion.NEARBY)
    trainer = Trainer(seen, plans[10:], config, "cpu", tmp_path / "a.checkpoint")
    points = [point for point in trainer.run() if not isinstance(point, int)]
    assert np.isfinite(points[-1].validation_loss)
    assert all(value.isfinite().all() for value in trainer.model.state_dict().values())
