"""`mapreplay compare`: what it prints, the page that it writes, and one line for bad input."""

import json
import shutil
from html.parser import HTMLParser
from pathlib import Path

import pytest

from commands import Run
from episodes import made_up
from mapreplay.analysis.comparison.compare import compare
from mapreplay.analysis.comparison.groups import group_episodes

SAMPLES = Path(__file__).parents[2] / "samples" / "episodes"


class Tags(HTMLParser):
    """The tags and attributes of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))


def test_the_sample_episodes(cli: Run) -> None:
    result = cli("compare", SAMPLES, "--where", "floor_plan=procedural-60002")
    assert result.code == 0, result.err
    assert "cost-utility against nearest: mapping time reduced by 80.0 %" in result.out
    assert "- 1 floor plan: no interval and no test" in result.out
    assert max(map(len, result.out.splitlines())) <= 80


def test_the_page_is_self_contained_and_shows_how_to_go_on(cli: Run, tmp_path: Path) -> None:
    page, plot = tmp_path / "report.html", tmp_path / "figures.svg"
    result = cli("compare", SAMPLES, "--where", "floor_plan=procedural-60002", "--html", page,
                 "--plot", plot, "--format", "json")  # fmt: skip
    assert result.code == 0, result.err
    assert json.loads(result.out)["schema"] == "mapreplay.compare/1"
    assert b"<svg" in plot.read_bytes()
    text = page.read_text()
    tags = Tags(text)
    assert "script" not in {tag for tag, _ in tags.found}
    for _, attributes in tags.found:
        for name in ("src", "srcset"):
            assert (attributes.get(name) or "data:").startswith("data:")
    pictures = [attributes for tag, attributes in tags.found if tag == "img"]
    assert len(pictures) == 4 + 4  # figures, and two maps of each episode
    assert f"mapreplay view {SAMPLES}/procedural-60002__nearest" in text
    again = cli("compare", SAMPLES, "--html", page, "--where", "floor_plan=procedural-60002")
    assert again.code == 2
    assert "exists; choose another name, or overwrite it with --force" in again.err


def test_hostile_names_are_shown_and_not_obeyed() -> None:
    from mapreplay.analysis.comparison.page import comparison_page

    hostile = '"><script>alert(1)</script>'
    result = compare(group_episodes([made_up(0, 9, planner=hostile)], ["planner"]))
    text = comparison_page(result).html()
    assert "<script" not in text
    assert "&lt;script&gt;" in text


@pytest.mark.parametrize(
    ("arguments", "code", "line"),
    [
        (["--by", "colour"], 2, "--by colour: there is maps, thresholds, configuration, planner"),
        (["--baseline", "x"], 2, "--baseline x is not a group: there is"),
        (["--test", "t"], 2, "--test t: should be sign-flip or wilcoxon"),
        (["--budget", "0"], 2, "--budget 0: should be at least 1"),
        (["--plot", "x.jpg"], 2, "should end in .png or .svg"),
        ([], 1, "no floor plan and start is in all groups: there is nothing to pair"),
    ],
)
def test_bad_input_is_one_line(cli: Run, arguments: list[str], code: int, line: str) -> None:
    result = cli("compare", SAMPLES, *arguments)
    assert result.code == code
    assert line in result.err
    assert result.err.strip().splitlines()[-1].startswith("mapreplay: ")


def test_one_episode_gets_an_answer(cli: Run, tmp_path: Path) -> None:
    log = next(SAMPLES.glob("*60014*"))
    result = cli("compare", log)
    assert result.code == 0, result.err
    assert "- one group: there is nothing to compare it with" in result.out
    assert "- cost-utility never reached the target: its time is the budget" in result.out
    shutil.copy(log, tmp_path)
    (tmp_path / "text.mcap").write_text("hello")
    assert cli("compare", tmp_path).code == 3


def test_regret_is_in_every_format(cli: Run, tmp_path: Path) -> None:
    page = tmp_path / "report.html"
    arguments = ("compare", SAMPLES, "--where", "floor_plan=procedural-60002", "--regret")
    shown = cli(*arguments, "--html", page)
    assert shown.code == 0, shown.err
    assert "area regret" in shown.out
    assert max(map(len, shown.out.splitlines())) <= 80
    assert ">regret<" in page.read_text()
    rows = json.loads(cli(*arguments, "--format", "json").out)["rows"]
    regret = {
        row["group"]: row["value"]
        for row in rows
        if row["of"] == "mean" and row["what"] == "regret"
    }
    # Both against the same tour: 520 and 104 steps.
    assert (1 + regret["nearest"]) / (1 + regret["cost-utility"]) == pytest.approx(5)
    assert regret["nearest"] > 0
    assert "mean,nearest,regret" in cli(*arguments, "--format", "csv").out
    assert "regret" not in cli(*arguments[:-1]).out
