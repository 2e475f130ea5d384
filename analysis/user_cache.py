"""Where results are kept from one run to the next, and which code they are of."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from importlib import resources
from pathlib import Path


def cache_folder(what: str) -> Path:
    """``mapreplay/<what>`` in the user's cache folder."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "mapreplay" / what


def code_digest(code: Mapping[str, tuple[str, ...]]) -> bytes:
    """SHA-256 of the files of these names, by package: what was made by other code is unknown."""
    digest = hashlib.sha256()
    for package, names in code.items():
        for name in names:
            digest.update(resources.files(package).joinpath(name).read_bytes())
    return digest.digest()
