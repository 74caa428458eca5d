"""The layout for Foxglove names topics, fields and frames that there are."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from rosbags.interfaces import Nodetype

from rpod_schemas.rmw.cdr import typestore
from rpod_schemas.topics import (
    CAMERA_INFO,
    CHASER,
    DEPTH,
    DIAGNOSTICS,
    POINTS,
    TARGET,
    TARGET_ESTIMATE,
    TOPICS,
)

FILE = Path(__file__).parents[3] / "deploy" / "foxglove" / "rpod-layout.json"
LAYOUT = json.loads(FILE.read_text("utf-8"))
PANELS: dict[str, Any] = LAYOUT["configById"]
SENSORS = {"<camera>": "pmd", "<lidar>": "lidar"}
TYPES = {
    "/" + "/".join(SENSORS.get(part, part) for part in topic.name.split("/")): topic.type for topic in TOPICS
}
"""Types by topic, in the standard scenarios."""
SERIES = [series["value"] for panel in PANELS.values() for series in panel.get("paths", [])]


def arranged(node: Any) -> Iterator[str]:
    """Yield the panels of a split, or the one that it is."""
    if isinstance(node, str):
        yield node
    else:
        yield from (panel for half in (node["first"], node["second"]) for panel in arranged(half))


def type_at(type_name: str, field: str) -> Any:
    """Return the description of a field; an element's where it has an index."""
    name, index = re.fullmatch(r"(\w+)(\[\d+\])?", field).groups()
    kind, content = dict(typestore().fielddefs[type_name][1])[name]
    assert (kind in (Nodetype.ARRAY, Nodetype.SEQUENCE)) == bool(index), field
    return content[0] if index else (kind, content)


def panels(kind: str) -> list[Any]:
    return [config for name, config in PANELS.items() if name.startswith(f"{kind}!")]


def test_every_panel_has_its_place_and_its_configuration():
    assert sorted(arranged(LAYOUT["layout"])) == sorted(PANELS)


@pytest.mark.parametrize("path", SERIES)
def test_every_series_is_a_value_of_a_topic_with_a_header(path):
    topic, _, fields = path.partition(".")
    type_name = TYPES[topic]
    assert typestore().fielddefs[type_name][1][0][0] == "header"
    node: Any = (Nodetype.NAME, type_name)
    for field in (field for field in fields.split(".") if not field.startswith("@")):
        kind, name = node
        assert kind == Nodetype.NAME, path
        node = type_at(name, field)
    assert node[0] == Nodetype.BASE, path


def test_every_series_is_drawn_over_the_stamps():
    """Arrivals say nothing where a run was faster than the clock."""
    series = [series for panel in PANELS.values() for series in panel.get("paths", [])]
    assert len(series) > 10
    assert all(item["enabled"] and item["timestampMethod"] == "headerStamp" for item in series)


def test_images_are_shown_with_their_calibration():
    modes = [panel["imageMode"] for panel in panels("Image")]
    assert len(modes) == 2
    assert {TYPES[mode["imageTopic"]] for mode in modes} == {DEPTH.type}
    assert {TYPES[mode["calibrationTopic"]] for mode in modes} == {CAMERA_INFO.type}


def test_the_scene_shows_points_estimate_and_frames():
    (scene,) = panels("3D")
    shown = {TYPES[topic] for topic, settings in scene["topics"].items() if settings["visible"]}
    assert {POINTS.type, "geometry_msgs/msg/PoseWithCovarianceStamped"} <= shown
    frames = {f"frame:{name}" for name in (CHASER, TARGET, TARGET_ESTIMATE)}
    assert scene["transforms"].keys() == frames
    assert scene["followTf"] == CHASER


def test_health_is_that_of_the_services():
    (health,) = panels("DiagnosticSummary")
    assert TYPES[health["topicToRender"]] == DIAGNOSTICS.type


def test_every_topic_that_is_named_anywhere_is_one_of_the_facility():
    named = set(re.findall(r'"(/[\w/]+)', FILE.read_text("utf-8")))
    assert named <= TYPES.keys()
    assert len(named) >= 8
