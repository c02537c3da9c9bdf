"""Recordings in Foxglove and Lichtblick: what their readers take of a schema, and the layout in docs."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from recorded_runs import record

from fame.log import Recording
from fame.log.channels import CHANNELS
from fame.scenario import Scenario

ROOT = Path(__file__).parent.parent
LAYOUT = json.loads((ROOT / "docs" / "foxglove_layout.json").read_text(encoding="utf-8"))
SINGLE = {"boolean", "string", "number", "integer"}
KEYS = {  # of the configuration of each panel: those of foxglove.layouts (foxglove-sdk 0.30.3), as far as used here
    "3D": {"cameraState", "followMode", "followTf", "fixedFrame", "scene", "topics"},
    "Plot": {
        "paths", "xAxisVal", "isSynced", "showLegend", "legendDisplay", "showPlotValuesInLegend", "showXAxisLabels",
        "showYAxisLabels", "sidebarDimension",
    },
    "StateTransitions": {"paths", "isSynced"},
    "RawMessages": {"topicPath", "expansion"},
}  # fmt: skip


def unread(schema: dict[str, Any], where: str) -> Iterator[str]:
    """What their reader of JSON schemas (parseJsonSchema) refuses."""
    if schema.get("type") == "object":
        if "properties" not in schema:
            yield f"{where}: an object without properties"
        for name, inner in schema.get("properties", {}).items():
            yield from unread(inner, f"{where}.{name}")
    elif schema.get("type") == "array":
        yield from unread(schema["items"], f"{where}[]") if "items" in schema else [f"{where}: an array without items"]
    elif not isinstance(schema.get("type"), str) or schema["type"] not in SINGLE:
        yield f"{where}: {schema.get('type')}"


@pytest.mark.parametrize("topic", CHANNELS)
def test_their_reader_takes_the_schema_of_each_channel(topic: str) -> None:
    name, schema = CHANNELS[topic]
    assert list(unread(dict(schema), name)) == []


def panels(place: str | dict[str, Any]) -> list[str]:
    """The panels of a layout, from left to right."""
    return [place] if isinstance(place, str) else [*panels(place["first"]), *panels(place["second"])]


def test_each_panel_of_the_layout_has_its_place_and_known_settings() -> None:
    assert sorted(panels(LAYOUT["layout"])) == sorted(LAYOUT["configById"])
    for panel, config in LAYOUT["configById"].items():
        assert set(config) <= KEYS[panel.partition("!")[0]], panel


def values(path: str, message: Any) -> list[Any]:
    """What a message path without its topic has in a message: `.name`, `[0]`, `[:]`, `{name==value}`."""
    found = [message]
    for name, index, field, wanted in re.findall(r"\.(\w+)|\[(:|\d+)\]|\{(\w+)==(\S+?)\}", path):
        if name:
            found = [one[name] for one in found]
        elif index:
            found = [inner for one in found for inner in (one if index == ":" else one[int(index) : int(index) + 1])]
        else:
            text = LAYOUT["globalVariables"][wanted[1:]] if wanted.startswith("$") else json.loads(wanted)
            found = [one for one in found if one[field] == text]
    return found


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Recording]:
    scenario = Scenario.load(ROOT / "examples" / "agriculture.yaml", duration=5)
    with Recording(record(scenario, tmp_path_factory.mktemp("foxglove") / "run.mcap")) as found:
        yield found


PATHS = [
    *(path["value"] for config in LAYOUT["configById"].values() for path in config.get("paths", [])),
    *(config["topicPath"] for config in LAYOUT["configById"].values() if "topicPath" in config),
]


@pytest.mark.parametrize("path", PATHS)
def test_the_paths_of_the_layout_have_values_in_a_recording(path: str, recording: Recording) -> None:
    topic, rest = re.match(r"([\w/]+)(.*)", path).groups()  # type: ignore[union-attr]
    rest = rest.replace('"violated"', '"holds"')  # which does not occur
    found = [values(rest, message.json()) for message in recording.messages((topic,))]
    assert any(len(one) == 1 and one[0] not in (None, "") for one in found)
    assert all(len(one) <= 1 for one in found)


def test_the_topics_of_the_world_are_those_of_recordings(recording: Recording) -> None:
    assert set(LAYOUT["configById"]["3D!world"]["topics"]) <= set(recording.topics)
