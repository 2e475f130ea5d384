"""What was found out about a floor plan is kept: it depends on nothing but its key."""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Final

from mapreplay.analysis.user_cache import cache_folder, code_digest

_CODE: Final = {
    "mapreplay": ("floorplan.py", "kernels.py", "mapping.py", "sensor.py"),
    "mapreplay.analysis.limits": (
        "bound.py",
        "bound_kernels.py",
        "kernels.py",
        "predicted.py",
        "task.py",
        "tour.py",
    ),
}
"""What the numbers depend on beside the key."""


def remembered(key: tuple[object, ...], compute: Callable[[], int]) -> int:
    """The number of that key, from ``mapreplay/limits`` in the user's cache folder if it is there.

    The key is anything that its repr tells apart. A cache that cannot be written does not matter.
    """
    digest = hashlib.sha256(_code_digest() + repr(key).encode()).hexdigest()
    path = cache_folder("limits") / digest[:2] / f"{digest}.json"
    with suppress(OSError, ValueError, KeyError, TypeError):
        return int(json.loads(path.read_text(encoding="utf-8"))["moves"])
    moves = compute()
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, part = tempfile.mkstemp(dir=path.parent, suffix=".part")
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            json.dump({"moves": moves}, file)
        Path(part).replace(path)
    return moves


@cache
def _code_digest() -> bytes:
    return code_digest(_CODE)
