"""Writing files whole or not at all: one way, one wording; and opening regular files only.

A file is made under another name in the same folder and takes its own name when it is complete, so
that an error, a full disk or a kill leaves what was there before. A link is never written through,
and nothing but a regular file is ever replaced.
"""

from __future__ import annotations

import errno
import os
import secrets
import stat
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO, Final

from mapreplay.errors import ExistsError, WriteError

_LONGEST_ENDING: Final = 16


def check_new(path: Path, *, force: bool = False) -> None:
    """Refuse a `path` that cannot be written, before any work is done.

    Args:
        path: The file to write.
        force: Whether a regular file of that name may be replaced.

    Raises:
        ExistsError: it exists and `force` is not given, or it is not a regular file but a
            folder, link or device.
        WriteError: its folder does not exist or is not accessible.
    """
    try:
        mode = path.lstat().st_mode
    except FileNotFoundError:
        if not path.parent.is_dir():
            raise WriteError(f"{path}: cannot be written (no folder {path.parent})") from None
        return
    except (OSError, ValueError) as error:
        raise cannot_write(path, error) from None
    if stat.S_ISLNK(mode):
        raise ExistsError(f"{path}: is a link; give its target instead")
    if stat.S_ISDIR(mode):
        raise ExistsError(f"{path}: is a folder; give the name of a file")
    if not stat.S_ISREG(mode):
        raise ExistsError(f"{path}: is not a regular file; choose another name")
    if not force:
        raise ExistsError(f"{path}: exists; choose another name, or overwrite it with --force")


@contextmanager
def whole_path(path: Path, *, force: bool = False) -> Iterator[Path]:
    """Yields the path of a draft, which becomes `path` at the end of the block.

    If the block raises, the draft is removed and `path` is unchanged. The draft is created empty,
    so that a folder that is not writable is detected before any work is done. It has the ending of
    `path`, for encoders that depend on it, and the permissions of the file that it replaces.

    Raises:
        ExistsError: see `check_new`; also if `path` was created meanwhile.
        WriteError: the draft could not be written or renamed; also for OSErrors of the block.
    """
    check_new(path, force=force)
    ending = path.suffix if len(path.suffix) <= _LONGEST_ENDING else ""
    draft = path.with_name(f".{secrets.token_hex(6)}.draft{ending}")
    try:
        draft.open("xb").close()
        yield draft
        with draft.open("rb") as file:
            os.fsync(file.fileno())
        _publish(draft, path, force=force)
    except OSError as error:
        raise cannot_write(path, error) from None
    finally:
        with suppress(OSError):
            draft.unlink(missing_ok=True)


def write_whole(path: Path, content: bytes | Iterable[bytes], *, force: bool = False) -> None:
    """Write `content` (bytes or blocks of bytes) to the file `path`, completely or not at all.

    Raises:
        ExistsError, WriteError: see `whole_path`.
    """
    blocks = [content] if isinstance(content, bytes) else content
    with whole_path(path, force=force) as draft, draft.open("wb") as file:
        for block in blocks:
            file.write(block)


def _publish(draft: Path, path: Path, *, force: bool) -> None:
    if force:
        check_new(path, force=True)  # a link that came meanwhile would be replaced silently
        with suppress(FileNotFoundError):
            draft.chmod(stat.S_IMODE(path.lstat().st_mode))
        draft.replace(path)
        return
    try:
        path.hardlink_to(draft)  # fails where the name is taken, without a race
    except FileExistsError:
        check_new(path)
        raise
    except OSError:  # a file system without hard links
        check_new(path)
        draft.replace(path)


def make_folder(path: Path) -> None:
    """Create the folder `path` and its parents, unless they exist.

    Raises:
        ExistsError: it or one of its parents is a file.
        WriteError: it cannot be created.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        raise ExistsError(f"{path}: is a file, or in one; give the name of a folder") from None
    except (OSError, ValueError) as error:
        raise cannot_write(path, error) from None


def cannot_write(path: Path, error: OSError | ValueError) -> WriteError:
    """The message for a failed write to `path`: its name and the system's reason."""
    return WriteError(f"{path}: cannot be written ({getattr(error, 'strerror', None) or error})")


def open_regular(path: Path) -> BinaryIO:
    """Open a regular file to be read; a named pipe or a device is refused, and not waited for.

    Raises:
        OSError: it is not one, or it cannot be read.
    """
    file = open(path, "rb", opener=_open_at_once)  # noqa: SIM115 (Path has no opener)
    if stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        return file
    file.close()
    raise OSError(errno.EINVAL, "not a regular file", str(path))


def _open_at_once(path: str, flags: int) -> int:
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))
