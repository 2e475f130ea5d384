"""The package as a whole: its face, and the direction in which its parts depend."""

import ast
import inspect
from importlib.metadata import version
from pathlib import Path
from types import ModuleType

import pytest

import mapreplay
from mapreplay import analysis

ROOT = Path(__file__).parents[2]


def test_every_public_name_is_there() -> None:
    assert mapreplay.__all__ == sorted(mapreplay.__all__)
    for name in mapreplay.__all__:
        assert getattr(mapreplay, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        mapreplay.nothing  # noqa: B018


def test_every_public_name_of_the_analysis_is_there() -> None:
    assert analysis.__all__ == sorted(analysis.__all__)
    for name in analysis.__all__:
        assert getattr(analysis, name).__name__ == name
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        analysis.nothing  # noqa: B018


@pytest.mark.parametrize("package", [mapreplay, analysis], ids=lambda package: package.__name__)
def test_every_public_name_is_documented(package: ModuleType) -> None:
    named = [getattr(package, name) for name in package.__all__ if name != "__version__"]
    for thing in named:
        words = inspect.getdoc(thing) or ""
        assert len(words) > 20, f"{thing} has no docstring"
        if inspect.isfunction(thing) and len(inspect.signature(thing).parameters) > 2:
            assert "Args:" in words or "`" in words, f"{thing} does not say what it takes"


def test_the_version_is_that_of_the_distribution() -> None:
    assert mapreplay.__version__ == version("mapreplay")


def imports(path: Path) -> set[str]:
    """Names of the modules that a file imports, anywhere in it."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return found


UPWARDS = {
    "mapreplay": ("mapreplay.recorders", "mapreplay.analysis", "mapreplay.cli", "rerun", "mcap"),
    "recorders": ("mapreplay.analysis", "mapreplay.cli"),
    "analysis": ("mapreplay.cli",),
}


@pytest.mark.parametrize("folder", UPWARDS)
def test_arrows_point_one_way(folder: str) -> None:
    # The command line sits on top of all, and the face of the package only re-exports.
    above = {ROOT / "mapreplay/__init__.py", ROOT / "mapreplay/__main__.py"}
    files = [p for p in (ROOT / folder).rglob("*.py") if "cli" not in p.parts and p not in above]
    assert len(files) > 5
    for path in files:
        wrong = [name for name in imports(path) if name.startswith(UPWARDS[folder])]
        assert not wrong, f"{path} imports {wrong}"


ORDER = {
    "recorders": ["log", "pictures", "viewer", "batch", "export", "resume", "sampled"],
    "analysis": [
        "pool", "cache", "stats", "reporting", "logged_predictor", "episodes", "metrics", "diff",
        "whatif", "diagnosis", "branching", "verification", "bundling", "comparison", "experiment",
        "limits", "benchmarks",
    ],
}  # fmt: skip
"""The packages and modules of a folder: each may import those before it, and none after it."""


@pytest.mark.parametrize("folder", ORDER)
def test_packages_of_a_folder_depend_in_one_order(folder: str) -> None:
    order = ORDER[folder]
    there = {p.stem for p in (ROOT / folder).iterdir() if p.suffix == ".py" or p.is_dir()}
    assert there - {"__init__", "__pycache__"} == set(order)
    for place, package in enumerate(order):
        path = ROOT / folder / package
        files = [*path.rglob("*.py")] if path.is_dir() else [path.with_suffix(".py")]
        later = tuple(f"mapreplay.{folder}.{name}" for name in order[place + 1 :])
        for file in files:
            wrong = [
                n for n in imports(file) if any(n == x or n.startswith(x + ".") for x in later)
            ]
            assert not wrong, f"{file} imports {wrong}"
