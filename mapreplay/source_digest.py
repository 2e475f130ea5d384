"""Digests of the package's code, for results that are valid for the same code only.

A cache takes the digest of all code; training and experiments that of the modules that they import.
"""

from __future__ import annotations

import ast
import hashlib
import os
import sys
from contextlib import suppress
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Final

_PACKAGE: Final = "mapreplay"
_ROOT: Final = Path(__file__).absolute().parent
_LIBRARIES: Final = ("numpy", "numba", "opencv-python-headless", "polars", "scipy", "torch")
"""What numbers are computed and kept with."""


@cache
def code_digest(package: Path = _ROOT) -> bytes | None:
    """SHA-256 of all code in `package` and of the libraries' versions.

    None if there is no code to be read, so that nobody can tell which code made a result.
    """
    digest = hashlib.sha256(sys.version.encode())
    for library in _LIBRARIES:
        with suppress(PackageNotFoundError):
            digest.update(f"{library} {version(library)}\0".encode())
    found = False
    for folder, folders, files in os.walk(package, followlinks=True):
        folders[:] = sorted(set(folders) - {"__pycache__"})
        for name in sorted(files):
            if not name.endswith(".py"):
                continue
            path = Path(folder, name)
            try:
                code = path.read_bytes()
            except OSError:
                return None
            found = True
            digest.update(f"{path.relative_to(package).as_posix()} {len(code)}\0".encode())
            digest.update(code)
    return digest.digest() if found else None


@cache
def source_digest(*modules: str) -> str:
    """SHA-256 (hex) of the source of `modules` and of all of this package that they import.

    Imports inside of functions count, too. An imported package counts with all its modules,
    because plug-ins (planners, predictors) are not imported by name.

    Raises:
        FileNotFoundError: there is no such module.
    """
    digest = hashlib.sha256()
    for module, path in sorted(_closure(modules).items()):
        content = path.read_bytes()
        digest.update(f"{module} {len(content)}\n".encode() + content)
    return digest.hexdigest()


def _closure(modules: tuple[str, ...]) -> dict[str, Path]:
    found: dict[str, Path] = {}
    left = list(modules)
    while left:
        module = left.pop()
        if module in found:
            continue
        path = _path(module)
        if path is None:
            raise FileNotFoundError(f"no module {module}")
        found[module] = path
        if path.name == "__init__.py" and module != _PACKAGE:
            left += [f"{module}.{each.stem}" for each in path.parent.glob("*.py")
                     if each.stem != "__init__"]  # fmt: skip
        left += _imported(path)
    return found


def _imported(path: Path) -> list[str]:
    """The modules of ours that a file imports, inside of functions, too."""
    names = []
    for node in ast.walk(ast.parse(path.read_bytes())):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            below = [f"{node.module}.{alias.name}" for alias in node.names]
            modules = [name for name in below if _path(name)]
            names += modules if len(modules) == len(below) else [*modules, node.module]
    return [n for n in names if n.split(".")[0] == _PACKAGE and n != _PACKAGE and _path(n)]


def _path(module: str) -> Path | None:
    parts = module.split(".")
    if parts[0] != _PACKAGE:
        return None
    place = _ROOT.joinpath(*parts[1:])
    for path in (place.with_suffix(".py"), place / "__init__.py"):
        if path.is_file() and len(parts) > 1:
            return path
    return None
