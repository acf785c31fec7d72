"""What RViz and Foxglove are told to show is what the graph publishes."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from neuse_bags import topics

CONFIG = Path(__file__).resolve().parents[3] / "neuse_mapper_node" / "config"
TYPES = {spec.name: spec for spec in vars(topics).values() if isinstance(spec, topics.TopicSpec)}


@pytest.fixture(scope="module")
def layout() -> dict[str, Any]:
    return json.loads((CONFIG / "neuse_foxglove.json").read_text())


def panels_of(node: Any) -> Iterator[str]:
    if isinstance(node, str):
        yield node
    else:
        yield from panels_of(node["first"])
        yield from panels_of(node["second"])


def test_every_panel_of_foxglove_is_placed_and_configured(layout: dict[str, Any]):
    placed = list(panels_of(layout["layout"]))
    assert len(placed) == len(set(placed))
    assert set(placed) == layout["configById"].keys()


def test_foxglove_shows_topics_that_there_are(layout: dict[str, Any]):
    named = set(re.findall(r'"(/[a-z_/]+)', json.dumps(layout)))
    assert named <= TYPES.keys()
    assert {"/neuse/markers", "/neuse/changes", "/color/image", "/depth/image"} <= named


def test_rviz_shows_topics_that_there_are_with_their_types_and_durability():
    displays = yaml.safe_load((CONFIG / "neuse.rviz").read_text())["Visualization Manager"]["Displays"]
    shown = {f"/{d['Topic']['Value']}": d for d in displays if "Topic" in d}
    assert {"/neuse/markers", "/neuse/path", "/color/image"} <= shown.keys()
    for name, display in shown.items():
        assert TYPES[name].type_name.endswith("/" + display["Class"].split("/")[1])
        wanted = display["Topic"]["Durability Policy"] == "Transient Local"
        assert wanted == (TYPES[name].qos.durability.name == "TRANSIENT_LOCAL")
