"""Reports: made from data alone, as often as one likes, and nothing but the marked parts change."""

import json
from pathlib import Path

import numpy as np
import pytest

from drawing import plan
from experiments import ROW, Row, fill
from fakes import FixedPredictor
from mapreplay.analysis.experiment.curve import measure_curve
from mapreplay.analysis.experiment.example import read_example, record_example
from mapreplay.analysis.experiment.report import read_results, update_page, write_report
from mapreplay.analysis.experiment.sweep import setting_folder
from mapreplay.errors import MapreplayError
from mapreplay.mapping import Thresholds

HOUSE = plan("""
    ############
    #....#.....#
    #..........#
    #....#.....#
    ############
""")
KNOWS = FixedPredictor((HOUSE.cells == 100).astype(np.float32))
DOCS = Path(__file__).parents[3] / "docs"


def episodes(saved: float, predictor: str = "d1") -> list[Row]:
    """Nearest Frontier with and without prediction on three floor plans."""
    rows = []
    for number in range(3):
        name, time = f"p{number}", 100 + 10 * number
        rows.append(ROW(floor_plan=name, mapping_time=time))
        rows.append(
            ROW(floor_plan=name, plan_on="fused", build="fused", fail_safe=True, sha256="ab",
                predictor=predictor, mapping_time=round(time * (1 - saved)))
        )  # fmt: skip
    return rows


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with all kinds of data."""
    folder = tmp_path_factory.mktemp("results")
    fill(folder, episodes(0.5) + episodes(0.4, "infill-4")[1::2])
    for free, occupied, saved in ((0.9, 0.95, 0.6), (0.8, 0.95, 0.7)):
        fill(setting_folder(folder, free, occupied), episodes(saved))
    measure_curve("D1", [HOUSE, HOUSE], KNOWS, Thresholds()).save(folder)
    record_example(HOUSE, KNOWS, folder)
    return folder


def test_everything_is_made_from_the_data(results: Path, tmp_path: Path) -> None:
    page = tmp_path / "results.md"
    page.write_text((DOCS / "results.md").read_text().replace("validation/", "paper/"))
    written = write_report(results, tmp_path)
    assert {path.name for path in written} >= {
        "results.json", "results.md", "table.parquet", "performance.png", "curve.png",
        "calibration.png", "example.png", "paper-curve.png",
    }  # fmt: skip
    text = page.read_text()
    assert "| D1 | nearest | 68 | 50.0 [50.0, 50.0] | - |" in text  # ours beside the paper's
    assert "| nearest | fused/fused, fail-safe | d1 |" in text
    assert "| D1 | nearest | 80 | 95 | **70.0 [70.0, 70.0]** |" in text  # best of the sweep
    assert "| D1 | nearest | infill-4 | 40.0 [40.0, 40.0] |" in text
    assert "weights with SHA-256 `ab`" in text
    found = json.loads((results / "results.json").read_text())
    assert found["schema"] == "mapreplay.experiment/1"
    assert found["curve"][0]["calibration"]["brier"] == 0

    before = {path: path.read_bytes() for path in written}
    assert write_report(results, tmp_path) == written
    assert {path: path.read_bytes() for path in written} == before


def test_every_part_of_the_page_has_its_marks(results: Path) -> None:
    from mapreplay.analysis.experiment.report import blocks

    text = (DOCS / "results.md").read_text()
    for part in blocks(read_results(results)):
        name = ("validation/" if part in ("sweep", "infill") else "paper/") + part
        assert text.count(f"<!-- begin {name} -->") == text.count(f"<!-- end {name} -->") == 1


def test_only_the_marked_parts_of_a_page_change(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(
        "mine\n<!-- begin a -->\nold\n<!-- end a -->\nmine\n<!-- begin b --><!-- end b -->"
    )
    update_page(page, {"a": r"new \1", "c": "nowhere"})
    assert page.read_text() == (
        "mine\n<!-- begin a -->\nnew \\1\n<!-- end a -->\nmine\n<!-- begin b --><!-- end b -->"
    )


def test_an_experiment_leaves_the_parts_and_figures_of_another_alone(tmp_path: Path) -> None:
    fill(tmp_path / "out", episodes(0.5))
    page = tmp_path / "results.md"
    page.write_text((DOCS / "results.md").read_text())
    before = page.read_text()
    written = write_report(tmp_path / "out", tmp_path, "another")
    assert page.read_text() == before
    assert list((tmp_path / "figures").iterdir()) == []
    assert page in written


def test_a_page_that_cannot_be_updated_is_named(tmp_path: Path) -> None:
    with pytest.raises(MapreplayError, match=r"page.md: cannot be read"):
        update_page(tmp_path / "page.md", {})
    (tmp_path / "page.md").write_text("<!-- begin a -->")
    with pytest.raises(MapreplayError, match=r"has no <!-- end a -->"):
        update_page(tmp_path / "page.md", {"a": "text"})


def test_what_was_not_measured_is_left_out(tmp_path: Path) -> None:
    fill(tmp_path, [ROW()])
    names = {path.name for path in write_report(tmp_path)}
    assert names == {"results.json", "results.md", "table.parquet", "performance.png"}


def test_a_folder_without_an_episode_is_refused(tmp_path: Path) -> None:
    with pytest.raises(MapreplayError, match="holds no finished episode"):
        write_report(tmp_path)
    fill(tmp_path / "sweep" / "high", [ROW()])
    with pytest.raises(MapreplayError, match="high: not a pair of thresholds"):
        write_report(tmp_path)


def test_the_example_ends_at_its_target_and_has_its_whole_way(results: Path) -> None:
    example = read_example(results / "example.mcap")
    assert example.exposure_fused >= 0.85
    assert len(example.track) == example.last.index + 1
    assert tuple(example.track[-1]) == example.last.agent
