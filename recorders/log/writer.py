"""Writing an episode to MCAP, so that nothing is lost and the same steps give the same bytes."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Final, Self

from mapreplay.errors import ExistsError, LogError, MapreplayError
from mapreplay.files.whole import cannot_write, check_new, make_folder
from mapreplay.recorders.log import step_table
from mapreplay.recorders.log.codec import Encoded, encode_step, encode_truth
from mapreplay.recorders.log.geometry import check_geometry
from mapreplay.recorders.log.header import (
    EPISODE_RECORD,
    NO_STEPS,
    OUTCOME_RECORD,
    episode_pairs,
    outcome_pairs,
)
from mapreplay.recorders.log.limits import MAX_STEP_BYTES, MAX_STEPS
from mapreplay.recorders.log.lock import is_at, is_locked, lock, move
from mapreplay.recorders.log.mcap.writer import ContainerWriter
from mapreplay.recorders.log.schemas import MESSAGE_ENCODING, SCHEMA_ENCODING, schema_text
from mapreplay.recorders.log.topics import Topic
from mapreplay.step import FIRST_STAMP_NS, EpisodeHeader, Step

STEPS_A_CHUNK: Final = 20
"""What a kill may cost at most."""
CHUNK_BYTES: Final = 4 << 20
"""A chunk is closed at the end of the step that fills it, so that a step is never cut."""


class EpisodeWriter:
    """Writes one episode: ``with EpisodeWriter(path, header) as writer: writer.add(step)``.

    The file is ``<path>.part`` until the step with the outcome was written and the writer is
    closed; then it becomes `path` in one move. After an error it stays ``.part``, with all
    steps that were written, and can be read. Every `STEPS_A_CHUNK` steps it is pushed to the
    disk: a kill or a power cut costs the steps after that. It is locked while it is written.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        header: EpisodeHeader,
        *,
        profile: bool = False,
        force: bool = False,
    ) -> None:
        """Create the file, and its folder.

        Args:
            path: Ends in ``.mcap``.
            header: What the log says once.
            profile: Keep the wall-clock times of the steps; such logs differ every time.
            force: Overwrite `path` and ``<path>.part``.

        Raises:
            ExistsError: there is such a file already, or, also with `force`, it is not a regular
                file.
            LogError: another process writes it, or cells of this resolution and origin cannot be
                told from their metres.
            WriteError: it cannot be written.
        """
        path = Path(path)
        if path.suffix != ".mcap":
            raise LogError(f"{path}: the name of a log ends in .mcap")
        self.path: Final = path
        self.part: Final = path.with_name(path.name + ".part")
        self._header = header
        self._profile = profile
        self._force = force
        self._tally = _Tally(header)
        self._channels: dict[Topic, int] = {}
        self._pending_bytes = 0
        check_geometry(header.floor_plan)
        make_folder(path.parent)
        check_new(path, force=force)
        self._file = _create(self.part, force=force)
        with self._writing():
            self._mcap = ContainerWriter(self._file, profile="ros2", library="mapreplay")
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
            with suppress(MapreplayError):  # the exception under way says more
                self._keep_part()

    def add(self, step: Step) -> None:
        """Append a step.

        Raises:
            LogError: a log with this step could not be read back (see `limits`).
            WriteError: the file cannot be written.
            ValueError: `step` does not follow the last one.
        """
        self._count(step)
        messages = [
            message
            for message in encode_step(step, self._header)
            if self._profile or message.topic is not Topic.PROFILE
        ]
        size = sum(len(message.data) for message in messages)
        if size > MAX_STEP_BYTES:
            raise LogError(
                f"{self.part}: step {step.index} has {size} bytes; at most {MAX_STEP_BYTES} can "
                "be read back"
            )
        with self._writing():
            for message in messages:
                self._add(message, step.stamp_ns, step.index)
            full = self._pending_bytes >= CHUNK_BYTES
            if full or len(self._tally.rows) % STEPS_A_CHUNK == 0:
                self._flush()

    def _count(self, step: Step) -> None:
        if step.index >= MAX_STEPS:
            raise LogError(f"{self.part}: a log has at most {MAX_STEPS} steps")
        self._tally.add(step)

    def skip_to(self, index: int) -> None:
        """Say that the steps up to `index` are lost, which is the next that will be written.

        Only for what is recovered: the log will be finished by `close_recovered`.

        Raises:
            ValueError: step `index` was written, or is before one that was.
        """
        self._tally.skip_to(index)

    def close(self) -> None:
        """Finish the log if its last step was written, otherwise keep it as ``.part``.

        Raises:
            ExistsError: meanwhile there is another of that name.
            WriteError: the file cannot be written.
        """
        if self._file.closed:
            return
        if self._tally.ended and not self._tally.missing:
            self._finish()
        else:
            self._keep_part()

    def close_recovered(self) -> None:
        """Finish a log of which the end is lost, or steps in its middle.

        If the end is, its outcome stays unknown.

        Raises:
            ExistsError, WriteError: as for `close`.
            ValueError: no step was written.
        """
        if not self._tally.rows:
            raise ValueError("a log without steps cannot be finished")
        self._finish()

    def _finish(self) -> None:
        summary = self._tally.summary
        with self._writing():
            self._flush()
            parquet = step_table.to_parquet(step_table.table_of(self._tally.rows))
            self._mcap.add_attachment(step_table.ATTACHMENT, step_table.MEDIA_TYPE, parquet)
            self._mcap.add_metadata(OUTCOME_RECORD, outcome_pairs(summary, self._tally.missing))
            self._mcap.finish()
            self._sync()
            check_new(self.path, force=self._force)
            move(self._file, self.part, self.path)
            _sync_folder(self.path.parent)

    def _keep_part(self) -> None:
        if self._file.closed:
            return
        with self._writing():
            self._flush()
            self._file.close()

    def _flush(self) -> None:
        self._mcap.flush()
        self._sync()
        self._pending_bytes = 0

    def _sync(self) -> None:
        self._file.flush()
        os.fsync(self._file.fileno())

    def _add(self, message: Encoded, stamp_ns: int, sequence: int) -> None:
        channel = self._channels.get(message.topic) or self._declare(message.topic)
        self._mcap.add_message(channel, sequence, stamp_ns, message.data)
        self._pending_bytes += len(message.data)

    def _declare(self, topic: Topic) -> int:
        name = topic.type_name
        self._channels[topic] = self._mcap.add_channel(
            topic, MESSAGE_ENCODING, name, SCHEMA_ENCODING, schema_text(name)
        )
        return self._channels[topic]

    @contextmanager
    def _writing(self) -> Iterator[None]:
        """Errors of the operating system as ours; the file is closed after one."""
        try:
            yield
        except OSError as error:
            with suppress(OSError):  # what is still buffered cannot be written either
                self._file.close()
            raise cannot_write(self.part, error) from None
        except MapreplayError:
            self._file.close()
            raise


class _Tally:
    """What the end of a log says about all of its steps."""

    def __init__(self, header: EpisodeHeader) -> None:
        self.rows: list[step_table.TableRow] = []
        self.summary = NO_STEPS
        self.missing: list[range] = []
        """Steps that were lost before those that came."""
        self._config = header.config
        self._next = 0

    @property
    def ended(self) -> bool:
        """Whether the last step of the episode was counted."""
        return self.summary.outcome is not None

    def skip_to(self, index: int) -> None:
        """Leave out the steps before `index`.

        Raises:
            ValueError: there are none to leave out.
        """
        if self.ended or index < self._next:
            raise ValueError(f"step {index} does not follow {self._next} steps")
        if index > self._next:
            self.missing.append(range(self._next, index))
        self._next = index

    def add(self, step: Step) -> None:
        """Count a step.

        Raises:
            ValueError: it is not the next one.
        """
        if self.ended or step.index != self._next:
            raise ValueError(f"step {step.index} does not follow {self._next} steps")
        self._next += 1
        self.rows.append(step_table.row_of(step))
        self.summary = self.summary.after(step, self._config)


def _create(part: Path, *, force: bool) -> BinaryIO:
    """The new file, empty and locked."""
    check_new(part, force=True)  # whatever it is, it is a file
    try:
        # What is there is truncated only under the lock.
        file = part.open("ab" if force else "xb")
    except FileExistsError:
        if is_locked(part):
            raise _is_being_written(part) from None
        raise ExistsError(
            f"{part}: exists; an interrupted recording left it: save it with `mapreplay "
            "recover`, move it away, or overwrite it with --force"
        ) from None
    except OSError as error:
        raise cannot_write(part, error) from None
    try:
        if not lock(file) or not is_at(file, part):
            raise _is_being_written(part)
        file.truncate(0)
        file.seek(0)
    except OSError as error:
        file.close()
        raise cannot_write(part, error) from None
    except LogError:
        file.close()
        raise
    return file


def _is_being_written(part: Path) -> LogError:
    return LogError(f"{part}: another process is writing it; choose another name, or wait")


def _sync_folder(folder: Path) -> None:
    """Make the new name of a file survive a power cut."""
    with suppress(OSError):  # Windows cannot open a folder
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
