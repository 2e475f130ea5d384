"""The episode without fail-safe, from the steps of the one with it."""

from __future__ import annotations

from dataclasses import replace

from mapreplay.episode import StepSink
from mapreplay.stages import Knowledge, Past, chosen_at, make_step
from mapreplay.step import EpisodeHeader, Mode, Step


def without_fail_safe(header: EpisodeHeader) -> EpisodeHeader:
    """The header of the same episode without the fail-safe."""
    config = header.config.model_copy(update={"fail_safe": False})
    return replace(header, config=config)


class WithoutFailSafe:
    """Passes on the steps that there would be without the fail-safe.

    They are the same up to the first at which the fused map has no frontier within reach, and
    end there: sealed in.

    Args:
        header: Of the episode without the fail-safe.
        sink: Takes its steps.
    """

    def __init__(self, header: EpisodeHeader, sink: StepSink) -> None:
        self._header, self._sink = header, sink
        self._past: Past | None = Past.at_start(header)

    def add(self, step: Step) -> None:
        """Take the next step of the episode with the fail-safe."""
        if self._past is None:  # it has ended
            return
        if step.mode is Mode.FAIL_SAFE or step.outcome is not None:
            known = Knowledge(
                step.hits, step.observed, step.p_wall, step.fused, step.metrics, chosen_at(step)
            )
            made = make_step(self._header, self._past, known, lambda _: None)
            step = replace(made, profile=step.profile)
        self._sink.add(step)
        move = step.decision.next_cell if step.decision else None
        self._past = None if move is None else self._past.after(step, move, self._header)
