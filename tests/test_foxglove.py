"""Foxglove and Lichtblick: what their readers take of a recording's schema, the layout in docs, a team served live."""

from __future__ import annotations

import json
import re
import signal
import struct
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from recorded_runs import record

from fame.cli import main
from fame.errors import ConfigError
from fame.log import Recording
from fame.log.channels import CHANNELS, EVENTS, GROUND, KEY, WORLD
from fame.middleware import messages
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


# ---- live ------------------------------------------------------------------------------------------------------------


@contextmanager
def connected(address: str) -> Iterator[Client]:
    client = pytest.importorskip("websockets.sync.client", reason="websockets is not installed")
    with client.connect(address, subprotocols=["foxglove.sdk.v1"]) as socket:
        yield Client(socket)


class Client:
    """A client of their websocket protocol: it subscribes to topics as they are advertised."""

    def __init__(self, socket: Any) -> None:
        self.socket = socket
        self.channels: dict[int, dict[str, Any]] = {}

    def messages(self, *topics: str) -> Iterator[tuple[str, int, bytes]]:
        """Topic, time (ns) and content of each message that comes."""
        while True:
            got = self.socket.recv(timeout=60)
            if isinstance(got, bytes):
                kind, number, time = struct.unpack("<BIQ", got[:13])
                assert kind == 1
                yield self.channels[number]["topic"], time, got[13:]
            elif (said := json.loads(got))["op"] == "advertise":
                new = {channel["id"]: channel for channel in said["channels"] if channel["topic"] in topics}
                self.channels |= new
                self._subscribe(*new)
            elif refused := re.search(r"Unknown channel ID: (\d+)", said.get("message", "")):
                self._subscribe(int(refused[1]))  # the server knows it a moment after it has advertised it

    def _subscribe(self, *numbers: int) -> None:
        wanted = [{"id": number, "channelId": number} for number in numbers]
        self.socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))


@pytest.fixture
def server() -> Iterator[Any]:
    pytest.importorskip("foxglove", reason="foxglove-sdk is not installed")
    from fame.log.foxglove import FoxgloveServer

    with FoxgloveServer() as made:
        yield made


def test_a_client_gets_the_last_message_of_a_topic_but_no_event_again(server: Any) -> None:
    ground = {"deletions": [], "entities": []}
    server.sink.put(GROUND, 1, {"deletions": [], "entities": [{"id": "old"}]})
    server.sink.put(EVENTS, 2, {"robot": "REX", "events": ["past"]})
    server.sink.put(GROUND, 3, ground)
    with connected(server.address) as client:
        came = client.messages(EVENTS, GROUND)
        topic, time, data = next(came)
        assert (topic, time, json.loads(data)) == (GROUND, 3, ground)
        server.sink.put(EVENTS, 4, {"robot": "REX", "events": ["now"]})
        topic, time, data = next(came)
        assert (topic, time, json.loads(data)) == (EVENTS, 4, {"robot": "REX", "events": ["now"]})
        schemas = {each["topic"]: (each["schemaName"], json.loads(each["schema"])) for each in client.channels.values()}
        assert schemas == {topic: CHANNELS[topic] for topic in (EVENTS, GROUND)}


def test_what_a_client_sends_wrongly_is_not_printed(server: Any, caplog: pytest.LogCaptureFixture) -> None:
    with connected(server.address) as client:
        client.socket.send(json.dumps({"op": "y" * 60_000}))
        next(got for got in client.socket if "Invalid message" in got)  # it is told
    assert caplog.messages == []


def test_a_topic_of_a_robot_has_one_channel_of_ros(server: Any) -> None:
    numbers = {server.sink.message_channel("/hello", "std_msgs/msg/String", node) for node in ("/a/x", "/b/x")}
    (number,) = numbers
    server.sink.message(number, 5, messages.create("std_msgs/msg/String", "hi"))
    with connected(server.address) as client:
        assert next(client.messages("/hello")) == ("/hello", 5, b"\0\1\0\0\3\0\0\0hi\0")
        (channel,) = client.channels.values()
        assert (channel["encoding"], channel["schemaEncoding"]) == ("cdr", "ros2msg")
        assert (channel["schemaName"], channel["schema"].split("#")[0].strip()) == (
            "std_msgs/msg/String",
            "string data",
        )


def test_an_address_that_cannot_be_opened_is_said_in_one_line(server: Any) -> None:
    from fame.log.foxglove import FoxgloveServer

    port = int(server.address.rpartition(":")[2])
    assert server.address == f"ws://127.0.0.1:{port}"
    with pytest.raises(ConfigError, match=rf"^Foxglove cannot be served at 127.0.0.1:{port}: .+$"):
        FoxgloveServer(port=port)


@pytest.mark.parametrize("words", [["--port", "9000"], ["--control"]])
def test_what_is_for_the_page_is_refused(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["view", "--foxglove", "8765", *words]) == 2
    assert "is for the page" in capsys.readouterr().err


@pytest.mark.processes
def test_foxglove_shows_a_team_in_many_processes() -> None:
    pytest.importorskip("foxglove", reason="foxglove-sdk is not installed")
    words = [sys.executable, "-m", "fame"]
    run = [*words, "run", "examples/ground_vehicles.yaml", "--middleware", "dds", "--duration", "60", "--quiet"]
    with (
        subprocess.Popen([*words, "view", "--foxglove", "0"], stdout=subprocess.PIPE, text=True, cwd=ROOT) as viewer,
        subprocess.Popen(run, cwd=ROOT) as team,
    ):
        assert viewer.stdout is not None
        wanted, seen = {KEY, EVENTS, WORLD, GROUND, "/REX/odom"}, dict[str, Any]()
        with connected(viewer.stdout.readline().strip()) as client:
            for topic, _, data in client.messages(*wanted):
                seen[topic] = data
                if seen.keys() == wanted:
                    break
        assert {each["id"] for each in json.loads(seen[WORLD])["entities"]} == {"REX", "DINGO"}
        viewer.send_signal(signal.SIGINT)
        assert viewer.wait(60) == 0
        team.terminate()
