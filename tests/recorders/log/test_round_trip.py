"""Through a file and back, bit for bit: any map size, any kind of prediction, any values."""

import math
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from mapreplay.config import EpisodeConfig
from mapreplay.floorplan import FloorPlan
from mapreplay.grid import Cell, Grid, Origin, Quantized
from mapreplay.mapping import PredictionDtype
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.recorders.log.step_table import row_of, table_of
from mapreplay.recorders.log.writer import EpisodeWriter
from mapreplay.step import (
    MAX_RIVALS,
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

Shape = tuple[int, int]
sides = st.integers(8, 64) | st.integers(65, 512)
dtypes = st.none() | st.sampled_from(PredictionDtype)


class Anything:
    """Steps of arbitrary content; the same `seed` makes the same."""

    def __init__(self, seed: int, shape: Shape, dtype: PredictionDtype | None) -> None:
        self.rng = np.random.default_rng(seed)
        self.shape, self.dtype = shape, dtype
        truth = self.grid()
        truth[0, 0] = 0
        self.header = EpisodeHeader(
            config=EpisodeConfig(prediction_dtype=dtype or PredictionDtype.UINT8),
            floor_plan=FloorPlan("any", truth, 0.05, Origin(-12.3, 4.5)),
            start=Cell(0, 0),
            max_steps=1000,
            predictor=PredictorIdentity("any", "0" * 64),
            versions=(("numpy", "2"),),
        )

    def grid(self) -> Grid:
        return self.rng.choice(np.array([-1, 0, 100], np.int8), self.shape)

    def p_wall(self) -> Quantized | None:
        if self.dtype is None:
            return None
        if self.dtype is PredictionDtype.FLOAT32:
            return self.rng.random(self.shape, np.float32)
        top = np.iinfo(self.dtype.value).max
        return self.rng.integers(0, top, self.shape, self.dtype.value, endpoint=True)

    def cells(self, count: int) -> Cells:
        return self.rng.integers(0, self.shape, (count, 2)).astype(np.int32)

    def cell(self) -> Cell:
        return Cell(*self.cells(1)[0].tolist())

    def reals(self, count: int) -> list[float]:
        """Any bits: tiny, huge, infinite and undefined numbers too."""
        bits = self.rng.integers(0, 2**64 - 1, count, np.uint64, endpoint=True)
        special = np.array([0.0, -0.0, 5e-324, np.inf, -np.inf, np.nan, 1 / 3])
        chosen = self.rng.choice(special, count)
        kept: list[float] = np.where(
            self.rng.random(count) < 0.5, bits.view(float), chosen
        ).tolist()
        return kept

    def scores(self) -> StepMetrics:
        """Metres, and shares with some that are undefined."""
        count = len(StepMetrics.names())
        special = np.array([0.0, -0.0, 5e-324, np.nan, 1 / 3, 1.0])
        shares = np.where(
            self.rng.random(count) < 0.5, self.rng.random(count), self.rng.choice(special, count)
        )
        scores = StepMetrics(float(self.rng.random()) / 10, *shares[1:].tolist())
        if self.dtype is not None:
            return scores
        of_prediction = ("_thresholded", "_raw", "brier", "log_loss", "unobserved")
        names = [n for n in StepMetrics.names() if any(part in n for part in of_prediction)]
        return replace(scores, **dict.fromkeys(names, math.nan))

    def candidate(self) -> Candidate:
        utility, reward = self.reals(2)
        moves = self.rng.integers(0, self.shape[0] * self.shape[1], 2).tolist()
        return Candidate(self.cell(), utility, reward, *moves)

    def decision(self) -> Decision:
        rivals = self.rng.integers(0, MAX_RIVALS, endpoint=True)
        draw = int(self.rng.integers(0, 2**64 - 1, dtype=np.uint64, endpoint=True))
        return Decision(
            chosen=self.candidate(),
            path=self.cells(int(self.rng.integers(2, 40))),
            mode=list(Mode)[self.rng.integers(len(Mode))],
            rivals=tuple(self.candidate() for _ in range(rivals)),
            random_draw=draw if self.rng.random() < 0.5 else None,
        )

    def step(self, index: int, outcome: Outcome | None) -> Step:
        sensor = self.header.sensor
        # A ray may cross one cell with two k: then the first is what it hits.
        hits = self.rng.integers(0, sensor.reach, sensor.rays, np.int16, endpoint=True)
        for i, k in enumerate(hits):
            if k:
                same = (sensor.offsets[i] == sensor.offsets[i, k - 1]).all(axis=1)
                hits[i] = 1 + np.argmax(same)
        kinds = self.rng.choice(len(EventKind), self.rng.integers(0, 3))
        return Step(
            index=index,
            agent=self.cell(),
            hits=hits,
            observed=self.grid(),
            p_wall=self.p_wall(),
            fused=self.grid(),
            frontier=self.cells(int(self.rng.integers(0, min(200, self.shape[0] * self.shape[1])))),
            decision=None if outcome else self.decision(),
            metrics=self.scores(),
            events=tuple(Event(list(EventKind)[kind], f"Ereignis Nº {kind} ✓") for kind in kinds),
            outcome=outcome,
            profile=StepProfile(*self.rng.integers(0, 2**63, 5, np.int64).tolist()),
        )


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32), st.tuples(sides, sides), dtypes, st.integers(1, 4))
@example(0, (8, 8), None, 45)  # three chunks
@example(1, (8, 512), PredictionDtype.UINT16, 2)
@example(2, (512, 8), PredictionDtype.UINT8, 2)
@example(3, (512, 512), None, 2)
@example(4, (512, 512), PredictionDtype.UINT8, 2)
@example(5, (512, 512), PredictionDtype.UINT16, 2)
@example(6, (512, 512), PredictionDtype.FLOAT32, 3)
def test_every_step_comes_back_bit_for_bit(
    seed: int, shape: Shape, dtype: PredictionDtype | None, count: int
) -> None:
    make = Anything(seed, shape, dtype)
    steps = [make.step(k, None) for k in range(count - 1)]
    steps.append(make.step(count - 1, Outcome.MAPPED))
    with TemporaryDirectory() as folder:
        path = Path(folder) / "any.mcap"
        with EpisodeWriter(path, make.header, profile=True) as writer:
            for step in steps:
                writer.add(step)
        log = EpisodeLog(path)
        assert [differences(a, b) for a, b in zip(log, steps, strict=True)] == [[]] * count
        for k in {0, count // 2, count - 1}:
            assert differences(log[k], steps[k]) == []
        assert log.table().equals(table_of([row_of(step) for step in steps]))
        plan, was = log.header.floor_plan, make.header.floor_plan
        assert (plan.sha256, plan.cells.tobytes()) == (was.sha256, was.cells.tobytes())
        assert log.header.config == make.header.config
        assert (len(log), log.outcome) == (count, Outcome.MAPPED)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**32), st.tuples(sides, sides), dtypes)
def test_what_was_read_is_written_as_the_same_bytes(
    seed: int, shape: Shape, dtype: PredictionDtype | None
) -> None:
    """Nothing that the file holds is lost in a Step."""
    make = Anything(seed, shape, dtype)
    with TemporaryDirectory() as folder:
        first, second = Path(folder) / "first.mcap", Path(folder) / "second.mcap"
        with EpisodeWriter(first, make.header, profile=True) as writer:
            writer.add(make.step(0, None))
            writer.add(make.step(1, Outcome.OUT_OF_STEPS))
        log = EpisodeLog(first)
        with EpisodeWriter(second, log.header, profile=True) as writer:
            for step in log:
                writer.add(step)
        assert first.read_bytes() == second.read_bytes()


@pytest.mark.parametrize("dtype", [None, *PredictionDtype])
def test_an_unfinished_log_gives_the_same_steps(
    tmp_path: Path, dtype: PredictionDtype | None
) -> None:
    make = Anything(7, (33, 100), dtype)
    steps = [make.step(k, None) for k in range(25)]
    with EpisodeWriter(tmp_path / "any.mcap", make.header, profile=True) as writer:
        for step in steps:
            writer.add(step)
    log = EpisodeLog(writer.part)
    assert [differences(a, b) for a, b in zip(log, steps, strict=True)] == [[]] * 25
