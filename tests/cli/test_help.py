"""Help texts, as they are printed on 80 columns: whoever changes one sees it here.

To renew the golden files after a change that is meant:
``MAPREPLAY_RENEW=1 pytest tests/cli/test_help.py``.
"""

import os
from pathlib import Path

import pytest

from commands import Run

GOLDEN = Path(__file__).parent / "golden"
VERBS = [
    "",
    "run",
    "view",
    "ls",
    "info",
    "metrics",
    "branch",
    "bundle",
    "diagnose",
    "compare",
    "diff",
    "whatif",
    "verify",
    "recover",
    "export",
    "floorplans",
    "train",
    "experiment",
    "bench",
]


@pytest.mark.parametrize("verb", VERBS)
def test_help_is_what_it_was(cli: Run, monkeypatch: pytest.MonkeyPatch, verb: str) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    result = cli(*([verb] if verb else []), "--help")
    assert result.code == 0
    golden = GOLDEN / f"help-{verb or 'mapreplay'}.txt"
    if os.environ.get("MAPREPLAY_RENEW"):
        golden.write_text(result.out)
    assert result.out == golden.read_text()
    assert max(map(len, result.out.splitlines())) <= 80
