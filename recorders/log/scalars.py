"""A log of the scalars of an episode alone: header, true map, outcome and table, but no steps.

It has about a hundredth of the size, and is all that `ls`, `compare` and the reports of an
experiment read.
"""

from __future__ import annotations

from mapreplay.recorders.log.writer import EpisodeWriter
from mapreplay.step import Step


class ScalarsWriter(EpisodeWriter):
    """Writes a log like `EpisodeWriter`, in the same format and as durably, without its steps."""

    def add(self, step: Step) -> None:
        """Take the scalars of a step.

        Raises:
            LogError: a log with this step could not be read back (see `limits`).
            ValueError: `step` does not follow the last one.
        """
        self._count(step)
