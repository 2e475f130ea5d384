"""What a file is that is not what it was taken for, and that every reader of plans says so."""

import io
import tarfile
import zipfile
from pathlib import Path

import pytest

from mapreplay.errors import FloorPlanError, PluginError, UsageError, WeightsError
from mapreplay.files.identify import identify, identify_file, unlike
from mapreplay.floorplans import open_source
from mapreplay.predictors import load_predictor
from mapreplay.predictors.weights import load_tensors

POINTER = b"version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 274911\n"


def zipped(member: str) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr(member, b"x" * 600)
    return buffer.getvalue()


def tarred() -> bytes:
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w") as archive:
        archive.addfile(tarfile.TarInfo("a.json"))
    return buffer.getvalue()


@pytest.mark.parametrize(
    ("content", "what"),
    [
        (b"", "an empty file"),
        (bytes(2000), "zero bytes"),
        (POINTER, "Git LFS pointer, not the file itself; run git lfs pull"),
        (b"/annex/objects/MD5E-s3--00.png\n", "git annex get"),
        (b"outs:\n- md5: 00\n", "dvc pull"),
        (b"SQLite format 3\x00", "SQLite"),
        (b"#ROSBAG V2.0\n", "ROS 1 bag"),
        (b"\x89MCAP0\r\n", "MCAP"),
        (b"\x1f\x8b\x08\0", "gunzip"),
        (b"\x28\xb5\x2f\xfd\0", "unzstd"),
        (b"\xfd7zXZ\0\0", "unxz"),
        (b"BZh91AY", "bunzip2"),
        (b"7z\xbc\xaf\x27\x1c", "7z archive"),
        (zipped("plan.png"), "a zip archive; unpack it"),
        (zipped("archive/data.pkl"), "PyTorch checkpoint"),
        (zipped("a.npy"), "NumPy archive"),
        (tarred(), "a tar archive"),
        (b"\xff\xd8\xff\xe0", "a JPEG image; convert it to PNG"),
        (b"BM\x36\0\0\0\0\0\0\0", "a BMP image; convert it to PNG"),
        (b"RIFF\0\0\0\0WEBPVP8 ", "a WebP image; convert it to PNG"),
        (b"II*\0\x08", "a TIFF image"),
        (b"MM\0*\0", "a TIFF image"),
        (b"GIF89a", "a GIF image"),
        (b"P4\n1 1\n\0", "a PBM image; convert it to PNG"),
        (b"P6\n1 1\n255\n\0\0\0", "a PPM image; convert it to PNG"),
        (b"\0\0\0\x1cftypavif", "AVIF"),
        (b"%PDF-1.7", "a PDF document"),
        (b"<svg xmlns=", "an SVG drawing"),
        (b"\xef\xbb\xbf<?xml version='1.0'?><svg>", "an SVG drawing"),
        (b"<?xml version='1.0'?><Error>", "an XML file"),
        (b" \n<!DOCTYPE html><html>", "a web page"),
        ("image: x".encode("utf-16"), "UTF-16 text; save it as UTF-8"),
        (b"\x00\x05\x16\x07\0\2", "._ file"),
        (b"\x80\x02}q", "Python pickle"),
        (b'\x20\0\0\0\0\0\0\0{"a":', "a safetensors file"),
    ],
)
def test_what_a_file_is(tmp_path: Path, content: bytes, what: str) -> None:
    path = tmp_path / "x"
    path.write_bytes(content)
    assert what in (identify(content) or "")
    assert identify_file(path) == identify(content)
    assert unlike(path, "a picture") == f"{path}: not a picture: {identify(content)}"


@pytest.mark.parametrize("content", [b"hello", b"PK", b"P5x", b"BMW", b"{}", b"image: a.png\n"])
def test_what_is_nothing_of_these(content: bytes) -> None:
    assert identify(content) is None


@pytest.mark.parametrize("name", ["plan.png", "plan.pgm", "houses.tar.gz", "houses.tar", "a.json"])
@pytest.mark.parametrize(
    ("content", "what"), [(POINTER, "git lfs pull"), (b"<html>", "web page"), (b"", "empty file")]
)
def test_a_floor_plan_that_cannot_be_read_says_what_it_is(
    tmp_path: Path, name: str, content: bytes, what: str
) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    source = open_source(str(path))
    with pytest.raises(FloorPlanError, match=rf"{path}.*not .*{what}"):
        source.load(source.ids()[0])


def test_a_map_file_that_is_a_pointer(tmp_path: Path) -> None:
    path = tmp_path / "plan.yaml"
    path.write_bytes(POINTER)
    with pytest.raises(FloorPlanError, match=rf"{path}.*git lfs pull"):
        open_source(str(path)).load("plan")
    with pytest.raises(UsageError, match=rf"not a folder of floor plans, {path} is a Git LFS"):
        open_source(str(tmp_path))


@pytest.mark.parametrize(
    ("name", "content", "what"),
    [
        ("run.mcap", b"\x89MCAP0\r\n", "an MCAP file .*mapreplay ls"),
        ("bag.db3", b"SQLite format 3\x00", "a SQLite"),
        ("plan.jpg", b"\xff\xd8\xff", "a JPEG image; convert it to PNG"),
        ("houses.zip", zipped("a.json"), "a zip archive; unpack it"),
        ("a.json.gz", b"\x1f\x8b\x08", "gzip-compressed; unpack it with gunzip"),
    ],
)
def test_what_has_no_ending_of_ours_says_what_it_is(
    tmp_path: Path, name: str, content: bytes, what: str
) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(UsageError, match=f"{name}: not a floor plan: {what}"):
        open_source(str(tmp_path / name))


@pytest.mark.parametrize(
    ("content", "what"),
    [
        (POINTER, "git lfs pull"),
        (b"", "an empty file"),
        (zipped("archive/data.pkl"), "PyTorch checkpoint"),
        (b"<html>404", "a web page"),
        (bytes(100), "zero bytes"),
    ],
)
def test_weights_that_are_something_else(tmp_path: Path, content: bytes, what: str) -> None:
    path = tmp_path / "w.safetensors"
    path.write_bytes(content)
    with pytest.raises(WeightsError, match=rf"{path}: not a safetensors file \(.*{what}"):
        load_tensors(path)


def test_weights_that_are_cut_off_are_not_called_weights(tmp_path: Path) -> None:
    path = tmp_path / "w.safetensors"
    path.write_bytes(b'\x20\0\0\0\0\0\0\0{"a":')
    with pytest.raises(WeightsError, match=r"not a safetensors file \((?!a safetensors)"):
        load_tensors(path)


def test_a_predictor_that_is_another_file_says_what_it_is(tmp_path: Path) -> None:
    (tmp_path / "model.pt").write_bytes(zipped("model/data.pkl"))
    with pytest.raises(
        PluginError, match=r"or a \.safetensors file; .*model\.pt is a PyTorch check"
    ):
        load_predictor(str(tmp_path / "model.pt"))


def test_a_folder_is_no_weights(tmp_path: Path) -> None:
    with pytest.raises(WeightsError, match=r"not a file of weights \(it is a folder\)"):
        load_tensors(tmp_path)
