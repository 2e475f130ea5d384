"""A file is written whole or not at all, never over what is there, and never through a link."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from mapreplay.errors import ExistsError, WriteError
from mapreplay.files.whole import check_new, make_folder, open_regular, whole_path, write_whole


def _names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_new_file_has_all_its_blocks(tmp_path: Path) -> None:
    write_whole(tmp_path / "a.csv", iter([b"x\n", b"1\n"]))
    assert (tmp_path / "a.csv").read_bytes() == b"x\n1\n"
    assert _names(tmp_path) == ["a.csv"]


def test_what_is_there_stays_without_force(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes(b"old")
    with pytest.raises(ExistsError, match=r"a.csv: exists; .*--force"):
        write_whole(path, b"new")
    assert path.read_bytes() == b"old"
    write_whole(path, b"new", force=True)
    assert path.read_bytes() == b"new"


@pytest.mark.parametrize("force", [False, True])
def test_a_failure_in_the_middle_leaves_what_was_there(tmp_path: Path, force: bool) -> None:
    path = tmp_path / "a.csv"
    if force:
        path.write_bytes(b"old")

    def blocks() -> Iterator[bytes]:
        yield b"half"
        raise OSError(28, "No space left on device")

    with pytest.raises(WriteError, match=r"a.csv: cannot be written \(No space left on device\)"):
        write_whole(path, blocks(), force=force)
    assert _names(tmp_path) == (["a.csv"] if force else [])
    assert not force or path.read_bytes() == b"old"


def test_a_link_is_not_written_through(tmp_path: Path) -> None:
    target, link = tmp_path / "target", tmp_path / "link"
    link.symlink_to(target)  # also one whose target is not there
    for _ in range(2):
        with pytest.raises(ExistsError, match="is a link"):
            write_whole(link, b"new", force=True)
        assert not target.exists() or target.read_bytes() == b"old"
        target.write_bytes(b"old")


def test_a_device_or_folder_is_never_replaced(tmp_path: Path) -> None:
    with pytest.raises(ExistsError, match="not a regular file"):
        check_new(Path("/dev/null"), force=True)
    with pytest.raises(ExistsError, match="is a folder"):
        check_new(tmp_path, force=True)
    with pytest.raises(WriteError, match="no folder"):
        check_new(tmp_path / "no" / "a.csv")


def test_a_name_taken_meanwhile_is_respected(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"

    def blocks() -> Iterator[bytes]:
        path.write_bytes(b"theirs")
        yield b"ours"

    with pytest.raises(ExistsError):
        write_whole(path, blocks())
    assert path.read_bytes() == b"theirs"
    assert _names(tmp_path) == ["a.csv"]


def test_what_is_replaced_gives_its_permissions(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes(b"old")
    path.chmod(0o640)
    write_whole(path, b"new", force=True)
    assert path.stat().st_mode & 0o777 == 0o640


def test_an_ending_of_any_length_is_written(tmp_path: Path) -> None:
    path = tmp_path / ("a." + "x" * 250)
    write_whole(path, b"new")
    assert _names(tmp_path) == [path.name]


@pytest.mark.parametrize("name", ["x" * 300, "a\0b", "file/below"])
def test_a_name_that_cannot_be_is_one_error(tmp_path: Path, name: str) -> None:
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(WriteError, match=r"cannot be written \(.+\)"):
        write_whole(tmp_path / name, b"new")
    with pytest.raises((ExistsError, WriteError)):
        make_folder(tmp_path / name)
    assert _names(tmp_path) == ["file"]


def test_a_link_that_came_meanwhile_is_not_written_through(tmp_path: Path) -> None:
    path, target = tmp_path / "a.csv", tmp_path / "target"
    target.write_bytes(b"theirs")

    def blocks() -> Iterator[bytes]:
        path.symlink_to(target)
        yield b"ours"

    with pytest.raises(ExistsError, match="is a link"):
        write_whole(path, blocks(), force=True)
    assert target.read_bytes() == b"theirs"
    assert _names(tmp_path) == ["a.csv", "target"]


def test_a_folder_that_cannot_be_written_to_is_found_before_any_work(tmp_path: Path) -> None:
    if not Path("/proc/self").exists():
        pytest.skip("there is no folder here that even root cannot write to")
    worked = False
    with pytest.raises(WriteError, match="cannot be written"), whole_path(Path("/proc/a.csv")):
        worked = True
    assert not worked


def test_a_named_pipe_is_refused_and_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.mcap")
    with pytest.raises(OSError, match="not a regular file"):
        open_regular(tmp_path / "a.mcap")
