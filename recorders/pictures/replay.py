"""Episodes to be shown: what of each, their names, and where two diverge."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final, Self

import numpy as np
import numpy.typing as npt

from mapreplay.errors import UsageError
from mapreplay.recorders.log.state import by_step
from mapreplay.recorders.pictures.annotations import Mark
from mapreplay.recorders.pictures.palette import Curve
from mapreplay.step import EpisodeHeader, Step
from mapreplay.text import shortened

if TYPE_CHECKING:
    from mapreplay.recorders.log.reader import EpisodeLog

LETTERS: Final = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"

Series = npt.NDArray[np.float64]
"""float64[n]: a score at each step, NaN where undefined."""


@dataclass(frozen=True, eq=False)
class Replay:
    """An episode to be shown."""

    header: EpisodeHeader
    steps: Iterable[Step] = ()
    """All steps in order, to be read once; none where only the scores are shown."""
    marks: Sequence[Mark] = ()
    profiled: bool = False
    """Whether the steps have the time of each stage."""
    scores: dict[Curve, Series] = field(default_factory=dict)
    """The curves, if only these are shown."""
    diverges_at: int | None = None
    """The step from which it diverges from the first of those that it is shown with."""

    @property
    def has_maps(self) -> bool:
        """Whether the maps are shown too."""
        return not self.scores

    @classmethod
    def of(cls, log: EpisodeLog, marks: Sequence[Mark] = ()) -> Self:
        """All of a log, read when it is shown.

        Raises:
            LogError: the log is damaged.
        """
        profiled = len(log) > 0 and log[log.indices[0]].profile is not None
        return cls(log.header, log.steps(), marks, profiled)

    @classmethod
    def scores_of(cls, log: EpisodeLog) -> Self:
        """The scores of a log, without its maps.

        Raises:
            LogError: the log is damaged.
        """
        table = log.table()
        return cls(
            log.header,
            scores={
                c: by_step(table["step"].to_numpy(), table[c.value].fill_null(np.nan).to_numpy())
                for c in Curve
            },
        )


def replays_of(
    logs: Sequence[EpisodeLog], marks: Sequence[Sequence[Mark]] = (), chosen: Sequence[int] = ()
) -> list[Replay]:
    """Logs to be shown together.

    Args:
        logs: at least one.
        marks: of each log; none by default.
        chosen: the numbers of those whose maps are shown; by default the first two.

    Raises:
        LogError: a log is damaged.
    """
    maps = list(chosen) or [0, 1]
    replays = []
    for number, log in enumerate(logs):
        if number not in maps:
            replays.append(Replay.scores_of(log))
            continue
        replay = Replay.of(log, marks[number] if marks else ())
        if number != min(maps):
            replay = replace(replay, diverges_at=first_divergence(logs[min(maps)], log))
        replays.append(replay)
    return replays


def names_of(headers: Sequence[EpisodeHeader]) -> list[str]:
    """Names of episodes that are shown together: a letter, and what they differ in.

    ``A nearest observed-observed``, ``B cost-utility fused-fused``; the letter alone where
    they differ in nothing.

    Raises:
        UsageError: there are more episodes than letters.
    """
    if len(headers) > len(LETTERS):
        raise UsageError(
            f"{len(headers)} episodes; at most {len(LETTERS)} are shown together: name some, or "
            "choose with --where"
        )
    parts = [
        (
            header.floor_plan.id,
            header.config.planner,
            f"{header.config.plan_on}-{header.config.build}",
            header.predictor.name,
            "fail-safe" if header.config.fail_safe else "",
            f"s{header.config.seed}",
        )
        for header in headers
    ]
    telling = [len(set(column)) > 1 for column in zip(*parts, strict=True)]
    return [
        " ".join(
            [
                letter,
                *(shortened(p, 60) for p, tells in zip(part, telling, strict=True) if tells and p),
            ]
        )
        for letter, part in zip(LETTERS, parts, strict=False)
    ]


def first_divergence(a: Iterable[Step], b: Iterable[Step]) -> int | None:
    """The step from which two episodes diverge, or None: the last that is the same to the agent.

    They are the same while the agents are on the same cell and have observed the same map, on
    floor plans of the same size: at the step that is returned the agents move apart, or one of
    them ends. 0 also where they never were the same.
    """
    for one, other in side_by_side(a, b):
        if (
            one is None
            or other is None
            or one.agent != other.agent
            or not np.array_equal(one.observed, other.observed)
        ):
            return max(0, (one.index if one else other.index if other else 0) - 1)
    return None


def side_by_side(a: Iterable[Step], b: Iterable[Step]) -> Iterator[tuple[Step | None, Step | None]]:
    """The steps of two episodes by number; None where one has ended.

    A step that is missing in one of them, because its log was recovered, is left out.
    """
    of_a, of_b = iter(a), iter(b)
    one, other = next(of_a, None), next(of_b, None)
    while one is not None or other is not None:
        if one is not None and other is not None and one.index < other.index:
            one = next(of_a, None)
        elif one is not None and other is not None and other.index < one.index:
            other = next(of_b, None)
        else:
            yield one, other
            one, other = next(of_a, None), next(of_b, None)
