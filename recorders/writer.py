"""Writing an episode to MCAP, so that nothing is lost and the same steps give the same bytes."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Final, Literal, Self

from mcap.writer import Writer

from mapreplay.errors import LogError
from mapreplay.recorders import table
from mapreplay.recorders.messages import (
    Encoded,
    Topic,
    check_geometry,
    encode_step,
    encode_truth,
)
from mapreplay.recorders.metadata import (
    EPISODE_RECORD,
    OUTCOME_RECORD,
    EpisodeSummary,
    episode_pairs,
    outcome_pairs,
)
from mapreplay.recorders.schemas import MESSAGE_ENCODING, SCHEMA_ENCODING, schema_text
from mapreplay.step import FIRST_STAMP_NS, EpisodeHeader, Step

STEPS_A_CHUNK: Final = 20
"""What a kill may cost at most."""
CHUNK_BYTES: Final = 4 << 20
"""A chunk is closed at the end of the step that fills it, so that a step is never cut."""


class EpisodeWriter:
    """Writes one episode: ``with EpisodeWriter(path, header) as writer: writer.write(step)``.

    The file is ``<path>.part`` until the step with the outcome was written and the writer is
    closed; then it becomes `path` in one move. After an error it stays ``.part``, with all
    steps that were written, and can be read.
    """

    def __init__(
        self, path: Path, header: EpisodeHeader, *, profile: bool = False, force: bool = False
    ) -> None:
        """Create the file, and its folder.

        Args:
            path: Ends in ``.mcap``.
            header: What the log says once.
            profile: Keep the wall-clock times of the steps; such logs differ every time.
            force: Overwrite `path` and ``<path>.part``.

        Raises:
            LogError: there is such a file already, or it cannot be written; or cells of this
                resolution and origin cannot be told from their metres.
        """
        if path.suffix != ".mcap":
            raise LogError(f"{path}: the name of a log ends in .mcap")
        self.path: Final = path
        self.part: Final = path.with_name(path.name + ".part")
        self._header = header
        self._profile = profile
        self._force = force
        self._tally = _Tally(header)
        self._channels: dict[Topic, int] = {}
        self._schemas: dict[str, int] = {}
        self._pending_bytes = 0
        check_geometry(header.floor_plan)
        self._refuse_overwriting()
        self._file = _create(self.part, "wb" if force else "xb")
        # Chunks are closed by `_flush`, between steps: mcap must not do it earlier.
        self._mcap = Writer(self._file, chunk_size=1 << 62, enable_data_crcs=True)
        with self._writing():
            self._mcap.start(profile="ros2", library="mapreplay")
            self._mcap.add_metadata(EPISODE_RECORD, episode_pairs(header))
            self._add(encode_truth(header.floor_plan), FIRST_STAMP_NS, 0)
            self._flush()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close; after an exception keep what was written as ``.part``."""
        if error is None:
            self.close()
        else:
            with suppress(LogError):  # the exception under way says more
                self._keep_part()

    def write(self, step: Step) -> None:
        """Append a step.

        Raises:
            LogError: the file cannot be written.
            ValueError: `step` does not follow the last one.
        """
        self._tally.add(step)
        kept = step if self._profile else replace(step, profile=None)
        messages = list(encode_step(kept, self._header))
        with self._writing():
            for message in messages:
                self._add(message, step.stamp_ns, step.index)
            full = self._pending_bytes >= CHUNK_BYTES
            if full or len(self._tally.rows) % STEPS_A_CHUNK == 0:
                self._flush()

    def close(self) -> None:
        """Finish the log if its last step was written, otherwise keep it as ``.part``.

        Raises:
            LogError: the file cannot be written, or meanwhile there is another of that name.
        """
        if self._file.closed:
            return
        summary = self._tally.summary
        if summary is None:
            self._keep_part()
            return
        with self._writing():
            self._flush()
            parquet = table.to_parquet(table.table_of(self._tally.rows))
            self._mcap.add_attachment(0, 0, table.ATTACHMENT, table.MEDIA_TYPE, parquet)
            self._mcap.add_metadata(OUTCOME_RECORD, outcome_pairs(summary))
            self._mcap.finish()  # type: ignore[no-untyped-call]
            self._file.flush()
            os.fsync(self._file.fileno())
            self._file.close()
            self._refuse_overwriting()
            self.part.replace(self.path)
            _sync_folder(self.path.parent)

    def _keep_part(self) -> None:
        if self._file.closed:
            return
        with self._writing():
            self._flush()
            self._file.close()

    def _flush(self) -> None:
        self._mcap.flush()  # type: ignore[no-untyped-call]
        self._pending_bytes = 0

    def _add(self, message: Encoded, stamp_ns: int, sequence: int) -> None:
        channel = self._channels.get(message.topic) or self._declare(message.topic)
        self._mcap.add_message(channel, stamp_ns, message.data, stamp_ns, sequence)
        self._pending_bytes += len(message.data)

    def _declare(self, topic: Topic) -> int:
        name = topic.type_name
        if name not in self._schemas:
            self._schemas[name] = self._mcap.register_schema(
                name, SCHEMA_ENCODING, schema_text(name).encode()
            )
        self._channels[topic] = self._mcap.register_channel(
            topic, MESSAGE_ENCODING, self._schemas[name], {"offered_qos_profiles": ""}
        )
        return self._channels[topic]

    def _refuse_overwriting(self) -> None:
        if not self._force and self.path.exists():
            raise LogError(f"{self.path}: exists; choose another name, or overwrite with --force")

    @contextmanager
    def _writing(self) -> Iterator[None]:
        """Errors of the operating system as ours; the file is closed after one."""
        try:
            yield
        except OSError as error:
            with suppress(OSError):  # what is still buffered cannot be written either
                self._file.close()
            raise _cannot_write(self.part, error) from None


class _Tally:
    """What the end of a log says about all of its steps."""

    def __init__(self, header: EpisodeHeader) -> None:
        self.rows: list[table.Row] = []
        self.summary: EpisodeSummary | None = None
        self._config = header.config
        self._mapping_time: int | None = None
        self._correct_time: int | None = None

    def add(self, step: Step) -> None:
        """Count a step.

        Raises:
            ValueError: it is not the next one.
        """
        if self.summary is not None or step.index != len(self.rows):
            raise ValueError(f"step {step.index} does not follow {len(self.rows)} steps")
        self.rows.append(table.row_of(step))
        metrics, config = step.metrics, self._config
        if self._mapping_time is None and metrics.coverage(config.build) >= config.coverage:
            self._mapping_time = step.index
        correct = metrics.correct_coverage(config.build)
        if self._correct_time is None and correct >= config.correct_coverage:
            self._correct_time = step.index
        if step.outcome is not None:
            self.summary = EpisodeSummary(
                step.outcome,
                step.index,
                self._mapping_time,
                self._correct_time,
                metrics.path_length,
            )


def _create(part: Path, mode: Literal["wb", "xb"]) -> BinaryIO:
    try:
        part.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _cannot_write(part, error) from None
    try:
        return part.open(mode)
    except FileExistsError:
        raise LogError(
            f"{part}: exists; it is being written, or was interrupted: move it away, or "
            "overwrite it with --force"
        ) from None
    except OSError as error:
        raise _cannot_write(part, error) from None


def _cannot_write(path: Path, error: OSError) -> LogError:
    return LogError(f"{path}: cannot be written ({error.strerror or error})")


def _sync_folder(folder: Path) -> None:
    """Make the new name of a file survive a power cut."""
    with suppress(OSError):  # Windows cannot open a folder
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
