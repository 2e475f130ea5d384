"""The Foxglove layout in samples/ shows topics and fields that logs have."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from mapreplay.recorders.log.schemas import typestore
from mapreplay.recorders.log.topics import Topic

LAYOUT = Path(__file__).parents[3] / "samples" / "foxglove" / "mapreplay.json"


@pytest.fixture(scope="module")
def layout() -> dict[str, Any]:
    loaded: dict[str, Any] = json.loads(LAYOUT.read_text())
    return loaded


def paths_in(panel: dict[str, Any]) -> Iterator[str]:
    """The message paths and topics that a panel names, like ``/metrics.f1``."""
    yield from panel.get("topics", {})
    yield from (path["value"] for path in panel.get("paths", ()))
    yield from (panel[key] for key in ("topicPath", "topicToRender") if key in panel)


def leaves(node: Any) -> list[str]:
    return [node] if isinstance(node, str) else leaves(node["first"]) + leaves(node["second"])


def test_every_topic_and_field_is_one_of_ours(layout: dict[str, Any]) -> None:
    shown = set()
    for panel in layout["configById"].values():
        for path in paths_in(panel):
            name, _, field = path.partition(".")
            topic = Topic(name)
            shown.add(topic)
            _, fields = typestore().fielddefs[topic.type_name]
            assert not field or field in dict(fields), path
    # /tf moves the scan, and the profile is rarely there: neither has a panel.
    assert shown == set(Topic) - {Topic.TF, Topic.PROFILE}


def test_every_panel_has_a_place_and_a_configuration(layout: dict[str, Any]) -> None:
    assert sorted(leaves(layout["layout"])) == sorted(layout["configById"])
