"""A long episode on a large floor plan: what it takes to save it, and to open it."""

from __future__ import annotations

import resource
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

from mapreplay.analysis.benchmarks.log import BlurPredictor
from mapreplay.analysis.benchmarks.view import floor_plan_of, record_long
from viewer import viewer_on

pytestmark = pytest.mark.slow

GIGABYTE = 1 << 30


def test_2000_steps_of_256_x_256_cells_are_saved_and_opened_in_a_gigabyte(tmp_path: Path) -> None:
    log, rrd = tmp_path / "long.mcap", tmp_path / "long.rrd"
    assert record_long(log, floor_plan_of(256), 2000, BlurPredictor()) == 2000

    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    command = [sys.executable, "-m", "mapreplay", "view", log, "--save", rrd]
    subprocess.run(command, check=True, capture_output=True)
    saving = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * 1024
    assert before * 1024 < saving < GIGABYTE

    with viewer_on(rrd) as shoot:
        for step in (0, 1000, 1999):
            assert shoot(step, "Fused").std() > 20
        (viewer,) = psutil.Process().children()
        memory = viewer.memory_info()
    # The viewer's program and software Vulkan are files, whose pages the system can take back.
    opening = memory.rss - getattr(memory, "shared", 0)
    print(f"saving {saving >> 20}, opening {opening >> 20}, with files {memory.rss >> 20} MiB")
    assert opening < GIGABYTE
