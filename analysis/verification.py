"""Whether a log is true: everything in it is made again, and compared bit for bit.

From the log alone, `verify` takes the start, the moves and the predictions as logged and
makes all the rest again with the functions that the simulator uses: scans, maps, frontiers,
decisions, metrics, events and the outcome. `verify_rerun` takes only the metadata and the
floor plan, and `verify_step` one logged observed map.

A value that was changed after the fact is therefore named alone, and a stage that went wrong
is the first of the differences at its step, with what follows from it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Final

from mapreplay import mapping, plugins
from mapreplay.analysis.branching import lineage, predictor_of, run_again
from mapreplay.analysis.diff.steps import Difference, step_differences
from mapreplay.episode import budget, versions
from mapreplay.errors import LogError, PluginError, UsageError
from mapreplay.grid import FREE, Cell, Grid, Quantized, check_grid
from mapreplay.planners import Planner, planner_of
from mapreplay.recorders.log import step_table
from mapreplay.recorders.log.header import EPISODE_RECORD, NO_STEPS, OUTCOME_RECORD
from mapreplay.recorders.log.reader import EpisodeLog, Stamps
from mapreplay.recorders.log.state import span_words
from mapreplay.recorders.log.topics import Topic
from mapreplay.sensor import Hits, accumulate, sense
from mapreplay.stages import (
    Knowledge,
    Past,
    Surroundings,
    Travelled,
    chosen_at,
    decide,
    make_step,
    measure,
    predict,
)
from mapreplay.step import OURS, Decision, EpisodeHeader, PredictorIdentity, Step

SHOWN: Final = 10
"""Differences that are kept by default."""


@dataclass(frozen=True)
class Verification:
    """What came of verifying a log."""

    steps: int
    """Steps that were compared."""
    differences: tuple[Difference, ...]
    """The first of them, in order."""
    count: int
    """Of all differences."""
    notes: tuple[str, ...]
    """What could not be checked, and what may explain the differences."""

    @property
    def agrees(self) -> bool:
        """Whether nothing differs."""
        return self.count == 0


def verify(log: EpisodeLog, shown: int = SHOWN) -> Verification:
    """Check a log against itself; it is read once, and two steps are in memory.

    Args:
        log: Finished or not; an unfinished one is checked as far as it goes.
        shown: Differences to keep; all are counted.

    Raises:
        LogError: the log cannot be read.
        MapreplayError: the planner returned something impossible.
    """
    header = log.header
    if header.simulator != OURS:
        return _verify_external(log, shown)
    truth = header.floor_plan.cells
    findings = _Findings(log, shown)
    findings.add(_check_header(header))
    if log.state.missing:
        findings.notes.append(
            f"{span_words(log.state.missing)} missing: scans, moves, frontiers and decisions "
            "after that not checked"
        )
    planners = _Planners(findings)
    ending = _Ending(log)
    past = Past.at_start(header)
    expected: Step | None = None
    move: Cell | None = None
    unbroken = True
    for logged, stamps in log.steps_with_stamps():
        header = log.header.at(logged.index)
        unbroken = unbroken and logged.index == findings.steps
        if not unbroken:  # what the step took over from those before is not known
            findings.add(_check_alone(log, logged, stamps, None))
            findings.add(ending.compare(logged))
            findings.steps += 1
            continue
        if expected is not None:
            agent = move or logged.agent
            if not _is_free(truth, agent):
                wanted = _neighbour_of(past.agent)
                findings.add([Difference(logged.index, Topic.POSE, "agent", None, agent, wanted)])
                findings.notes.append(f"step {logged.index} and later: not checked")
                return findings.result()
            past = past.after(expected, agent, log.header.at(expected.index))
        hits = sense(truth, past.agent, header.sensor)
        observed = accumulate(past.observed, past.agent, hits, header.sensor)
        findings.steps += 1
        findings.add(_check_stamps(logged, stamps))
        wrong = findings.add(_check_prediction(header, logged))
        asked = None if wrong else planners.get(header)
        expected = _make_again(header, asked, past, hits, observed, logged)
        findings.add(step_differences(logged, expected))
        findings.add(ending.compare(logged))
        move = None
        if logged.decision is not None:
            # The agent goes where the log says, so that one wrong decision does not make
            # everything after it look wrong.
            taken = replace(logged.decision, mode=expected.mode)
            expected = replace(expected, decision=taken)
            move = _legal_move(truth, past.agent, logged.decision)
            if move is None:
                target = logged.decision.next_cell
                wanted = _neighbour_of(past.agent)
                findings.add([Difference(past.index, Topic.PLAN, "move", None, target, wanted)])
    findings.add(ending.close())
    return findings.result()


def _verify_external(log: EpisodeLog, shown: int) -> Verification:
    """What can be checked of an external simulator's steps: fusion, metrics, stamps and the end."""
    header = log.header
    findings = _Findings(log, shown)
    findings.notes.append(
        f"recorded by {header.simulator}: scans, moves, frontiers and decisions not checked"
    )
    ending = _Ending(log)
    travelled, agent, unbroken = Travelled(), header.start, True
    for logged, stamps in log.steps_with_stamps():
        if logged.index == 0 and logged.agent != header.start:
            findings.add([Difference(0, Topic.POSE, "agent", None, logged.agent, header.start)])
        travelled = travelled.to(agent, logged.agent)
        agent = logged.agent
        unbroken = unbroken and logged.index == findings.steps
        findings.steps += 1
        path_length = travelled.metres(header.floor_plan.resolution) if unbroken else None
        findings.add(_check_alone(log, logged, stamps, path_length))
        findings.add(ending.compare(logged))
    findings.add(ending.close())
    return findings.result()


def _check_alone(
    log: EpisodeLog, logged: Step, stamps: Stamps, path_length: float | None
) -> Iterator[Difference]:
    """What can be checked of a step without those before it: stamps, fusion and metrics.

    Without a `path_length` that of the step is taken over.
    """
    header = log.header.at(logged.index)
    yield from _check_stamps(logged, stamps)
    yield from _check_prediction(header, logged)
    metres = logged.metrics.path_length if path_length is None else path_length
    fused = mapping.fuse(logged.observed, logged.p_wall, header.thresholds)
    metrics = measure(header, logged.observed, logged.p_wall, logged.fused, metres)
    yield from step_differences(logged, replace(logged, fused=fused, metrics=metrics))


def verify_rerun(
    log: EpisodeLog, device: str = "cpu", shown: int = SHOWN, weights: Sequence[Path] = ()
) -> Verification:
    """Run the episode again from its metadata and true map, and compare every step.

    `weights` are files, which may have the weights of its predictors.

    If the predictor is not the one that was used, that alone is named.

    Raises:
        LogError: the log cannot be read.
        UsageError: it was recorded by an external simulator.
        PluginError, WeightsError: the planner or the predictor cannot be loaded.
        MapreplayError: one of them returned something impossible.
    """
    header = log.header
    _refuse_external(log)
    findings = _Findings(log, shown)
    predictors = []
    for part in lineage(header):
        predictors.append(predictor_of(part, device, weights))
        if findings.add(_check_predictor(part.predictor, predictors[-1].identity)):
            return findings.result()
    findings.add(_check_header(header))
    again, ending = run_again(header, predictors), _Ending(log)
    if not log.has_steps:
        findings.notes.append("holds scalars only: these were compared")
        for step in again:
            findings.steps += 1
            findings.add(ending.compare(step))
        findings.add(ending.close())
        return findings.result()
    for logged, stamps in log.steps_with_stamps():
        expected = next((step for step in again if step.index == logged.index), None)
        if expected is None:
            steps = f"{findings.steps} steps"
            findings.add([Difference(logged.index, Topic.METRICS, "step", None, "a step", steps)])
            return findings.result()
        findings.steps += 1
        findings.add(_check_stamps(logged, stamps))
        findings.add(step_differences(logged, expected))
        findings.add(ending.compare(logged))
    findings.add(ending.close())
    return findings.result()


def verify_step(
    log: EpisodeLog,
    index: int,
    device: str = "cpu",
    shown: int = SHOWN,
    weights: Sequence[Path] = (),
) -> Verification:
    """Predict, fuse, score and decide again at one step, from its logged pose and observed map.

    Raises:
        IndexError: there is no such step.
        LogError: the log cannot be read, or the observed map is none.
        PluginError, WeightsError: the planner or the predictor cannot be loaded.
        MapreplayError: one of them returned something impossible.
    """
    _refuse_external(log)
    logged = log[index]
    header = log.header.at(logged.index)
    truth = header.floor_plan.cells
    if logged.index > 0:
        log.check_step(logged.index - 1)
    before = log[logged.index - 1].decision if logged.index > 0 else None
    findings = _Findings(log, shown)
    predictor, planner = predictor_of(header, device, weights), planner_of(header)
    if findings.add(_check_predictor(header.predictor, predictor.identity)):
        return findings.result()
    problem = check_grid(logged.observed)
    if problem is not None or not _is_free(truth, logged.agent):
        reason = problem or f"the agent is at {tuple(logged.agent)}, which is no free cell"
        raise LogError(f"{log.path}: step {logged.index} is no state to go on from ({reason})")
    past = replace(
        Past.at_start(header),
        index=logged.index,
        agent=logged.agent,
        previous_target=before.target if before else None,
    )
    hits = sense(truth, logged.agent, header.sensor)
    predicted = replace(logged, p_wall=predict(header, predictor, logged.observed))
    expected = _make_again(header, planner, past, hits, logged.observed, predicted)
    # What these say depends on all steps before.
    known = replace(expected.metrics, path_length=logged.metrics.path_length)
    findings.steps = 1
    findings.add(step_differences(logged, replace(expected, metrics=known, events=logged.events)))
    return findings.result()


def _refuse_external(log: EpisodeLog) -> None:
    if log.header.simulator != OURS:
        raise UsageError(
            f"{log.path}: recorded by {log.header.simulator}, which cannot be run again here"
        )


class _Findings:
    """The first differences, and the count of all."""

    def __init__(self, log: EpisodeLog, shown: int) -> None:
        self.steps = 0
        self.notes: list[str] = list(log.repacked)
        self._header = log.header
        self._shown = shown
        self._kept: list[Difference] = []
        self._count = 0

    def add(self, found: Iterable[Difference]) -> bool:
        """Keep what is still to be shown; whether there was anything."""
        before = self._count
        for difference in found:
            self._count += 1
            if len(self._kept) < self._shown:
                self._kept.append(difference)
        return self._count > before

    def result(self) -> Verification:
        here = dict(versions())
        others = [
            f"{name} {version} (here {here.get(name)})"
            for name, version in self._header.versions
            if here.get(name) != version
        ]
        if self._count and others:
            self.notes.append(f"recorded with {', '.join(others)}")
        return Verification(self.steps, tuple(self._kept), self._count, tuple(self.notes))


class _Ending:
    """What a log with an index says of all its steps, and whether its steps say the same."""

    def __init__(self, log: EpisodeLog) -> None:
        self._config = log.header.config
        self._logged = log.summary
        self._expected = NO_STEPS
        self._rows: Iterator[step_table.TableRow] = iter(())
        self._columns: list[str] = []
        self._has_table = False
        frame = log.attached_table()
        if frame is not None:
            self._has_table = True
            self._rows, self._columns = frame.iter_rows(), frame.columns

    def compare(self, step: Step) -> Iterator[Difference]:
        """Compare the row of the attachment with its step."""
        if self._logged is None:
            return
        self._expected = self._expected.after(step, self._config)
        if not self._has_table:
            return
        expected = step_table.row_of(step)
        row = next(self._rows, None)
        if row is None or len(row) != len(expected):
            size = None if row is None else f"{len(row)} columns"
            wanted = f"{len(expected)} columns"
            yield Difference(step.index, step_table.ATTACHMENT, "row", None, size, wanted)
            return
        for name, ours, theirs in zip(self._columns, row, expected, strict=True):
            if ours != theirs:
                yield Difference(step.index, step_table.ATTACHMENT, name, None, ours, theirs)

    def close(self) -> Iterator[Difference]:
        """After the last step: compare the summary, and look for rows without a step."""
        if self._logged is None or self._expected is NO_STEPS:
            return
        expected = asdict(self._expected)
        for name, value in asdict(self._logged).items():
            if value != expected[name]:
                yield Difference(None, OUTCOME_RECORD, name, None, value, expected[name])
        further = sum(1 for _ in self._rows)
        if further:
            yield Difference(None, step_table.ATTACHMENT, "further rows", None, further, 0)


class _Planners:
    """The planners of a log and of the logs that it branched from; of each that cannot be had
    there is one note.
    """

    def __init__(self, findings: _Findings) -> None:
        self._findings = findings
        self._loaded: dict[object, Planner | None] = {}

    def get(self, header: EpisodeHeader) -> Planner | None:
        key = header.config.planner, header.versions
        if key not in self._loaded:
            self._loaded[key] = self._load(header)
        return self._loaded[key]

    def _load(self, header: EpisodeHeader) -> Planner | None:
        name = header.config.planner
        try:
            return planner_of(header)
        except PluginError as error:
            known = name in plugins.available(plugins.PluginKind.PLANNERS)
            reason = str(error) if known else f"planner {name!r} is not installed"
            self._findings.notes.append(f"{reason}: decisions not checked")
            return None


def _make_again(
    header: EpisodeHeader,
    planner: Planner | None,
    past: Past,
    hits: Hits,
    observed: Grid,
    logged: Step,
) -> Step:
    """The step that follows from a scan, the observed map and the logged prediction.

    Without a planner, the logged decision is taken over, with the mode that is right. What was
    chosen is taken over like the prediction itself.
    """
    p_wall = logged.p_wall
    fused = mapping.fuse(observed, p_wall, header.thresholds)
    path_length = past.travelled.metres(header.floor_plan.resolution)
    metrics = measure(header, observed, p_wall, fused, path_length)

    def decide_again(view: Surroundings) -> Decision | None:
        if planner is not None:
            return decide(header, planner, past, observed, p_wall, view)
        return replace(logged.decision, mode=view.mode) if logged.decision else None

    known = Knowledge(hits, observed, p_wall, fused, metrics, chosen_at(logged))
    return make_step(header, past, known, decide_again)


def _check_header(header: EpisodeHeader) -> Iterator[Difference]:
    """The start and the budget follow from the configuration and the floor plan."""
    for part in lineage(header):
        yield from _check_start(part)


def _check_start(header: EpisodeHeader) -> Iterator[Difference]:
    config, plan = header.config, header.floor_plan
    start, steps = plan.check_start(config.start_cell), budget(config, plan, header.explorable)
    if header.start != start:
        yield Difference(None, EPISODE_RECORD, "start", None, header.start, start)
    elif header.max_steps != steps:
        yield Difference(None, EPISODE_RECORD, "max_steps", None, header.max_steps, steps)


def _check_predictor(logged: PredictorIdentity, here: PredictorIdentity) -> Iterator[Difference]:
    if logged.name != here.name:
        yield Difference(None, EPISODE_RECORD, "predictor", None, logged.name, here.name)
    if logged.sha256 != here.sha256:
        hashes = logged.sha256, here.sha256
        yield Difference(None, EPISODE_RECORD, "predictor_sha256", None, *hashes)


def _check_stamps(step: Step, stamps: Stamps) -> Iterator[Difference]:
    """All messages of a step have its simulated time."""
    for topic, stamp in stamps:
        if stamp != step.stamp_ns:
            yield Difference(step.index, topic, "stamp", None, stamp, step.stamp_ns)


def _check_prediction(header: EpisodeHeader, step: Step) -> Iterator[Difference]:
    """It has the type that the configuration says."""
    p_wall: Quantized | None = step.p_wall
    if p_wall is None:
        return
    dtype = header.config.prediction_dtype
    if p_wall.dtype.name != dtype:
        yield Difference(step.index, Topic.P_WALL, "type", None, p_wall.dtype.name, dtype)


def _is_free(truth: Grid, cell: Cell) -> bool:
    height, width = truth.shape
    inside = 0 <= cell.row < height and 0 <= cell.col < width
    return inside and bool(truth[cell] == FREE)


def _legal_move(truth: Grid, agent: Cell, decision: Decision) -> Cell | None:
    """Where the decision leads, if that is one of the eight neighbours and free."""
    cell = decision.next_cell
    distance = max(abs(cell.row - agent.row), abs(cell.col - agent.col))
    return cell if distance == 1 and _is_free(truth, cell) else None


def _neighbour_of(cell: Cell) -> str:
    return f"a free neighbour of ({cell.row}, {cell.col})"
