"""What is built is what is in the tree: sdist, wheel, an environment of its own, a run elsewhere.

The environment gets the installed libraries through a path file, so that nothing is downloaded.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tarfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PLAIN = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}


def run(*command: object, folder: Path) -> str:
    done = subprocess.run(
        [str(word) for word in command],
        cwd=folder, env=PLAIN, text=True, capture_output=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


def build(tree: Path, what: str, into: Path) -> Path:
    code = f"import setuptools.build_meta as b; print(b.build_{what}({str(into)!r}))"
    return into / run(sys.executable, "-c", code, folder=tree).splitlines()[-1]


def test_a_script_beside_a_clone_of_that_name_imports_it(tmp_path: Path) -> None:
    # A folder called mapreplay without an __init__.py is a namespace package, and comes after the
    # path of an editable install.
    (tmp_path / "mapreplay").mkdir()
    code = "from mapreplay import EpisodeLog; print(EpisodeLog.__module__)"
    said = run(sys.executable, "-c", code, folder=tmp_path)
    assert said == "mapreplay.recorders.log.reader\n"


@pytest.mark.slow
def test_an_installed_wheel_of_the_sdist_runs_in_another_folder(tmp_path: Path) -> None:
    tree, dist, elsewhere = tmp_path / "tree", tmp_path / "dist", tmp_path / "elsewhere"
    for folder in (dist, elsewhere):
        folder.mkdir()
    run("git", "clone", "--quiet", ROOT, tree, folder=tmp_path)
    with tarfile.open(build(tree, "sdist", dist)) as archive:
        archive.extractall(tmp_path, filter="data")
    (unpacked,) = tmp_path.glob("mapreplay-*")
    wheel = build(unpacked, "wheel", dist)

    run(sys.executable, "-m", "venv", "--without-pip", "env", folder=tmp_path)
    (site,) = (tmp_path / "env").glob("lib/python*/site-packages")
    libraries = [path for path in sys.path if path.endswith("site-packages")]
    (site / "libraries.pth").write_text("\n".join(libraries) + "\n")
    python, mapreplay = tmp_path / "env/bin/python", tmp_path / "env/bin/mapreplay"
    pip = (sys.executable, "-m", "pip", "--python", python, "install", "--quiet", "--no-deps")
    run(*pip, wheel, folder=elsewhere)
    where = run(python, "-c", "import mapreplay; print(mapreplay.__file__)", folder=elsewhere)
    assert str(site) in where
    run(mapreplay, "run", "--floorplans", "procedural:60000", "--out", "logs", folder=elsewhere)
    run(mapreplay, "view", "logs", "--png", "step.png", folder=elsewhere)
    assert (elsewhere / "step.png").stat().st_size > 10_000
    run(mapreplay, "experiment", "tiny", "--out", "tiny", folder=elsewhere)
    assert (elsewhere / "tiny" / "results.md").exists()
