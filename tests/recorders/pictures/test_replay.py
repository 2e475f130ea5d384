from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from mapreplay import ExternalEpisode, unknown_floor_plan
from mapreplay.config import EpisodeConfig
from mapreplay.errors import UsageError
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.recorders.pictures.replay import names_of, replays_of
from mapreplay.recorders.viewer.static import describe
from mapreplay.step import EpisodeHeader
from mapreplay.text import printable
from recordings import two_rooms

SAMPLES = Path(__file__).parents[3] / "samples" / "episodes"


def like(header: EpisodeHeader, **config: object) -> EpisodeHeader:
    return replace(header, config=header.config.model_copy(update=config))


def test_episodes_are_named_by_what_tells_them_apart() -> None:
    header = two_rooms().header
    assert names_of([header, header]) == ["A", "B"]
    assert names_of([header, like(header, seed=7)]) == ["A s3", "B s7"]
    others = [header, like(header, planner="nearest"), like(header, fail_safe=True)]
    assert names_of(others) == ["A random", "B nearest", "C random fail-safe"]


def test_there_are_as_many_names_as_letters() -> None:
    with pytest.raises(UsageError, match="27 episodes; at most 26 are shown together"):
        names_of([two_rooms().header] * 27)


def test_of_several_logs_some_have_maps_and_all_have_scores() -> None:
    logs = [EpisodeLog(path) for path in sorted(SAMPLES.glob("*.mcap"))]
    replays = replays_of(logs)
    assert [replay.has_maps for replay in replays] == [True, True, False]
    assert [replay.diverges_at for replay in replays] == [None, 2, None]
    (f1, *_) = replays[2].scores.values()
    assert len(f1) == len(logs[2])
    chosen = replays_of(logs, chosen=[1, 2])
    assert [replay.has_maps for replay in chosen] == [False, True, True]
    assert chosen[1].diverges_at is None, "it is the first of those with maps"
    assert chosen[2].diverges_at == 0, "another floor plan"


def test_text_of_a_log_is_text_in_the_viewers_documents() -> None:
    planner = "a|b\n# [x](http://y) \x1b[2J"
    header = ExternalEpisode(unknown_floor_plan("lab", (4, 5), 0.1), (1, 1), planner).header
    (row,) = [line for line in describe(header).splitlines() if line.startswith("| planner")]
    assert row == r"| planner | a\|b\\n\# \[x\](http://y) \\x1b\[2J |"
    a, b = names_of([header, replace(header, config=EpisodeConfig(planner="p" * 500))])
    assert a == rf"A {printable(planner)}"
    assert len(b) < 70
