"""docs/log-format.md says what is true: its tables and definitions against the code."""

from pathlib import Path

import pytest

from mapreplay.config import EpisodeConfig
from mapreplay.recorders.log.header import FORMAT_VERSION, episode_pairs, outcome_pairs
from mapreplay.recorders.log.reader import EpisodeLog
from mapreplay.recorders.log.schemas import own_definitions
from mapreplay.recorders.log.topics import Topic
from recordings import Recorded

PAGE = (Path(__file__).parents[3] / "docs" / "log-format.md").read_text(encoding="utf-8")


def test_the_version_is_the_current_one() -> None:
    assert f"Format version {FORMAT_VERSION}." in PAGE


@pytest.mark.parametrize("topic", Topic)
def test_every_topic_is_described(topic: Topic) -> None:
    described = [line for line in PAGE.splitlines() if line.startswith(f"| `{topic}` |")]
    assert len(described) == 1
    assert f"| `{topic.type_name}` |" in described[0]


@pytest.mark.parametrize("name", ["Decision", "Candidate", "StepMetrics", "StepProfile"])
def test_our_own_definitions_are_quoted(name: str) -> None:
    assert own_definitions()[f"mapreplay_msgs/msg/{name}"].rstrip() in PAGE


def test_every_metadata_key_is_described(blurred: Recorded) -> None:
    summary = EpisodeLog(blurred.path).summary
    assert summary is not None
    keys = [*episode_pairs(blurred.header), *outcome_pairs(summary)]
    assert [key for key in (*keys, *EpisodeConfig.model_fields) if f"`{key}`" not in PAGE] == []
