"""What a colleague needs to reproduce one failure, in one small file.

A zip of a log, its diagnosis in words, as JSON and as a picture, and what it was made with. The
names in it are fixed and flat, nothing in it is executable, its manifest lists the SHA-256 and
size of everything else, and the same log and versions give the same bytes.
"""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path, PurePath
from tempfile import TemporaryDirectory
from typing import Final

from mapreplay.analysis.diagnosis.annotations import sealing_marks
from mapreplay.analysis.diagnosis.diagnosis import Diagnosis, diagnose
from mapreplay.analysis.diagnosis.paragraph import paragraph, what_if
from mapreplay.analysis.diagnosis.record import record_of, to_json
from mapreplay.config import WEIGHTS_ENDING
from mapreplay.errors import LogError, UsageError
from mapreplay.recorders.log.facts import facts_of
from mapreplay.recorders.log.header import episode_pairs
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.recorders.log.writer import EpisodeWriter
from mapreplay.recorders.pictures.layers import MapView
from mapreplay.recorders.pictures.painter import map_pngs
from mapreplay.text import printable, shell_command

SCHEMA: Final = "mapreplay.bundle/1"
LOG_NAME: Final = "episode.mcap"
_WHEN: Final = (1980, 1, 1, 0, 0, 0)
_ENDING: Final = WEIGHTS_ENDING.encode()
_SIDE: Final = 640
"""Pixels of the picture's longer side."""


@dataclass(frozen=True, eq=False)
class Bundle:
    """A zip, and what is in it."""

    data: bytes
    steps: int
    """Of the log in it."""
    whole: bool
    """Whether that is all of them."""


def bundle(log: EpisodeLog, until: int | None = None) -> Bundle:
    """Pack a log, or its steps up to `until`, with its diagnosis.

    A part of a log starts where the log does, so that it can be read, verified and run on from
    like any other; it is marked as recovered, because its end is not in it.

    Raises:
        UsageError: there is no step `until`.
        LogError: the log cannot be read, or has no step.
    """
    if len(log) == 0:
        raise LogError(f"{log.path}: has no step to be packed")
    last = log.last if until is None else until
    if not 0 <= last <= log.last:
        raise UsageError(f"--until {until}: {log.path} has steps 0 to {log.last}")
    if last < log.indices[0]:
        raise UsageError(f"--until {until}: {log.path} has no step before {log.indices[0]}")
    data = log.path.read_bytes()
    # What earlier versions wrote may say where the predictor's weights were.
    as_it_is = last == log.last and log.state.whole and _ENDING not in data
    with TemporaryDirectory() as folder:
        path = Path(folder) / LOG_NAME
        if as_it_is:
            path.write_bytes(data)
        else:
            _write_part(log, last, path)
        try:
            packed = EpisodeLog(path)
            diagnosis = diagnose(packed)
        except LogError as error:  # of the copy: nobody knows its name
            raise LogError(str(error).replace(str(path), str(log.path))) from None
        files = {
            LOG_NAME: path.read_bytes(),
            "README.txt": _read_me(packed, diagnosis).encode(),
            "config.json": _config(packed),
            "diagnosis.json": to_json(record_of(diagnosis)),
            "diagnosis.png": _picture(packed, diagnosis),
            "diagnosis.txt": (_told(diagnosis) + "\n").encode(),
        }
    return Bundle(_zip(files), len(packed), last == log.last)


def _write_part(log: EpisodeLog, last: int, path: Path) -> None:
    writer = EpisodeWriter(path, log.header, profile=True)
    with writer:
        for step in takewhile(lambda step: step.index <= last, log.steps()):
            writer.skip_to(step.index)
            writer.add(step)
        if last < len(log) - 1 or not log.finished:
            writer.close_recovered()


def _config(log: EpisodeLog) -> bytes:
    """What the episode was made with: the log's own record, with its JSON values opened."""
    pairs = episode_pairs(log.header)
    opened = {
        key: json.loads(value) if key in {"config", "start", "versions", "branch"} else value
        for key, value in pairs.items()
    }
    return (json.dumps(opened, indent=1) + "\n").encode()


def _picture(log: EpisodeLog, diagnosis: Diagnosis) -> bytes:
    """The fused map at the first sealing with its marks, or at the last step."""
    sealing = diagnosis.sealings[0] if diagnosis.sealings else None
    step = log[sealing.first_step if sealing else -1]
    marks = sealing_marks(sealing) if sealing else []
    return map_pngs(log, step, [MapView.FUSED], _SIDE, marks)[0]


def _told(diagnosis: Diagnosis) -> str:
    command = what_if(diagnosis, PurePath(LOG_NAME))
    said = printable(paragraph(diagnosis))
    return f"{said} What if: {shell_command(command)}" if command else said


def _read_me(log: EpisodeLog, diagnosis: Diagnosis) -> str:
    what_if = ""
    if diagnosis.sealings:
        at = diagnosis.sealings[0].first_step
        what_if = f"    mapreplay branch {LOG_NAME} --at {at} --with truth   what if?\n"
    facts = "".join(f"    {printable(f'{f.name}: {f.value}')}\n" for f in facts_of(log.header))
    return (
        f"An episode.\n\n{facts}\n"
        f"    mapreplay diagnose {LOG_NAME}   why was it sealed in?\n"
        f"    mapreplay view {LOG_NAME}       look\n"
        f"    mapreplay verify {LOG_NAME}     check its integrity and reproducibility\n"
        f"{what_if}\n"
        "manifest.json has the SHA-256 of every file.\n"
    )


def _zip(files: dict[str, bytes]) -> bytes:
    """Sorted, without dates, owners or paths; the manifest comes first."""
    manifest = {
        "schema": SCHEMA,
        "files": [
            {"name": name, "bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}
            for name, data in sorted(files.items())
        ],
    }
    entries = {"manifest.json": (json.dumps(manifest, indent=1) + "\n").encode()}
    entries |= dict(sorted(files.items()))
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, data in entries.items():
            info = zipfile.ZipInfo(name, _WHEN)
            info.create_system = 3
            info.external_attr = 0o100644 << 16
            # Logs and pictures are compressed already.
            stored = name.endswith((".mcap", ".png"))
            info.compress_type = zipfile.ZIP_STORED if stored else zipfile.ZIP_DEFLATED
            archive.writestr(info, data, compresslevel=9)
    return buffer.getvalue()
