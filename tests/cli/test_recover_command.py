"""`mapreplay recover`: exit codes, what it prints, and what it leaves."""

import json
from pathlib import Path

from commands import Run
from mapreplay.recorders.log.reader import EpisodeLog
from recordings import record, three_rooms


def test_the_command_recovers_a_folder_and_says_what_is_missing(cli: Run, tmp_path: Path) -> None:
    recorded = record(tmp_path, three_rooms()).path.rename(tmp_path / "good.mcap")
    whole = recorded.read_bytes()
    (tmp_path / "whole.mcap.part").write_bytes(whole[:-10])
    assert cli("recover", tmp_path).code == 0
    (tmp_path / "cut.mcap.part").write_bytes(whole[: len(whole) // 3])
    (tmp_path / "lost.mcap.part").write_bytes(whole[:100])
    result = cli("recover", tmp_path / "*cut*", tmp_path / "lost.mcap.part", "--remove",
                 "--format", "json")  # fmt: skip
    assert result.code == 3
    (row,) = json.loads(result.out)["rows"]
    steps = len(EpisodeLog(tmp_path / "cut.mcap"))
    assert row["missing"] == f"all after step {steps - 1}"
    assert result.err.startswith("failed: ")
    assert "lost.mcap.part: " in result.err
    left = {path.name for path in tmp_path.iterdir()}
    assert left == {"good.mcap", "whole.mcap", "whole.mcap.part", "cut.mcap", "lost.mcap.part"}
    listed = json.loads(cli("ls", tmp_path / "*.mcap", "--format", "json").out)["rows"]
    outcomes = {Path(row["file"]).name: row["outcome"] for row in listed}
    assert outcomes == {"good.mcap": "out_of_steps", "whole.mcap": "out_of_steps",
                        "cut.mcap": "unfinished"}  # fmt: skip
    info = cli("info", tmp_path / "cut.mcap")
    assert info.code == 3
    assert f"recovered; {steps} steps" in info.err
    assert "bit for bit" in cli("metrics", tmp_path / "cut.mcap").err
    assert cli("recover", tmp_path / "lost.mcap.part").code == 1
