"""`mapreplay bench limits`: the table, its formats, and one line for bad input."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from commands import Run


@pytest.fixture
def corridor(tmp_path: Path) -> Path:
    """A floor plan of one corridor, 30 cells long, as an image."""
    pixels = np.zeros((3, 32), np.uint8)
    pixels[1, 1:-1] = 255
    path = tmp_path / "corridor.png"
    Image.fromarray(pixels).save(path)
    return path


def test_a_corridor(cli: Run, corridor: Path, tmp_path: Path) -> None:
    markdown = tmp_path / "limits.md"
    result = cli("bench", "limits", "--floorplans", corridor, "--infill", 4, "--target", 1,
                 "--format", "json", "--markdown", markdown)  # fmt: skip
    assert result.code == 0, result.err
    answer = json.loads(result.out)
    assert answer["schema"] == "mapreplay.bench.limits/1"
    moves = {
        (row["known"], row["limit"]): row["moves"] for row in answer["rows"] if row["of"] == "mean"
    }
    # From column 1. The last corners are seen from column 29: a ray comes to the wall two cells
    # on. The oracle needs to see column 27, 4 before the last, and 20 cells ahead are seen.
    assert moves == {
        ("observed", "nearest"): 28,
        ("observed", "tour"): 28,
        ("observed", "bound"): 28,
        ("infill-4", "tour"): 6,
        ("infill-4", "bound"): 6,
    }
    assert "| infill-4 | proved lower bound | 6 | 78.6 | 1 |" in markdown.read_text()
    table = cli("bench", "limits", "--floorplans", corridor, "--infill", 4, "--target", 1)
    assert max(map(len, table.out.splitlines())) <= 80
    again = cli("bench", "limits", "--floorplans", corridor, "--markdown", markdown)
    assert again.code == 2
    assert "exists; choose another name, or overwrite it with --force" in again.err


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["--target", "0"], "--target 0.0: should be above 0 and at most 1"),
        (["--predictor", "d9"], "d9"),
        (["--infill", "0"], "--infill"),
    ],
)
def test_bad_input_is_one_line(cli: Run, corridor: Path, arguments: list[str], line: str) -> None:
    result = cli("bench", "limits", "--floorplans", corridor, *arguments)
    assert result.code in {1, 2}
    assert line in result.err
    assert result.err.strip().splitlines()[-1].startswith("mapreplay: ")
