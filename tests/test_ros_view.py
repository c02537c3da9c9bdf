"""`fame view` and `fame log record` of a team on ROS 2: page and recording get what the engines publish through rclpy.

What the page fetches is fetched here without a browser: ``mission.json``, the drawings, and what its WebSocket sends.
"""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import pytest
from bpmn_text import document, properties
from middleware_contract import DOMAIN, WallWorld, needs, world
from view_page import eventually

from fame.errors import ConfigError
from fame.log import Recording
from fame.mining.conversion import convert

pytestmark = [needs("rclpy"), pytest.mark.ros, pytest.mark.processes]

ROOT = Path(__file__).parent.parent
ENVIRONMENT = os.environ | {"ROS_DOMAIN_ID": str(DOMAIN), "PYTHONPATH": os.pathsep.join((str(ROOT), *sys.path))}
ROS = ("--middleware", "ros")
VECTOR = "geometry_msgs/msg/Vector3"


def flows(prefix: str, *ids: str) -> str:
    return "".join(f'<sequenceFlow id="{prefix}{a}" sourceRef="{a}" targetRef="{b}"/>' for a, b in pairwise(ids))


MODEL = document(f"""
  <signal id="Signal_found" name="found"/>
  <collaboration id="Team">
    <participant id="REX_pool" name="REX" processRef="Scout"/>
    <participant id="DINGO_pool" name="DINGO" processRef="Follow"/>
  </collaboration>
  <process id="Scout">
    <startEvent id="S"/>
    <scriptTask id="Explore" scriptFormat="python"><script>x, y = 1.5, -2.0</script></scriptTask>
    <userTask id="Report" name="Report the target"/>
    <intermediateThrowEvent id="Found">{properties(type=VECTOR, payload="{x: ${x}, y: ${y}}")}
      <signalEventDefinition signalRef="Signal_found"/></intermediateThrowEvent>
    <userTask id="Rest"/>
    {flows("to_", "S", "Explore", "Report", "Found", "Rest")}
  </process>
  <process id="Follow">
    <startEvent id="T"/>
    <intermediateCatchEvent id="Heard" name="found">{properties(type=VECTOR)}
      <signalEventDefinition signalRef="Signal_found"/></intermediateCatchEvent>
    <userTask id="Look"/>
    {flows("on_", "T", "Heard", "Look")}
  </process>""")
"""REX reports what it found when its task is completed; DINGO looks at it."""

BEFORE = {("REX", "Report"), ("DINGO", "Heard")}
AFTER = {("REX", "Rest"), ("DINGO", "Look")}
"""Where tokens wait, before and after the report."""


# ---- processes -------------------------------------------------------------------------------------------------------


class Command:
    """A command of FAME under way; what it says is kept in a file."""

    def __init__(self, file: Path, *words: str) -> None:
        self.file = file
        with file.open("w") as stream:
            command = [sys.executable, "-m", "fame", *words, *ROS]
            self.process = subprocess.Popen(command, env=ENVIRONMENT, cwd=ROOT, stdout=stream, stderr=stream)

    @property
    def said(self) -> str:
        return self.file.read_text()

    def match(self, pattern: str) -> str:
        """Wait until it says this, and return the group, or the whole."""

        def look() -> re.Match[str] | None:
            found = re.search(pattern, self.said, re.MULTILINE)
            assert found or self.process.poll() is None, f"has ended: {self.said}"
            return found

        found = eventually(look)
        return str(found[found.lastindex or 0])

    def interrupt(self) -> int:
        """What it returns after Ctrl-C."""
        self.process.send_signal(signal.SIGINT)
        return self.process.wait(timeout=60)


class Commands:
    """The commands of a test."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.started: list[Command] = []

    def start(self, *words: str) -> Command:
        self.started.append(Command(self.folder / f"{len(self.started)}.txt", *words))
        return self.started[-1]

    def run(self, *words: str) -> None:
        """A command to its end, which is to succeed."""
        command = self.start(*words)
        assert command.process.wait(timeout=60) == 0, command.said

    def close(self) -> None:
        """End what still runs, the last first: a command ends the processes that it started."""
        for command in reversed(self.started):
            if command.process.poll() is None:
                try:
                    command.interrupt()
                except subprocess.TimeoutExpired:
                    command.process.kill()
                    command.process.wait()


@pytest.fixture
def commands(tmp_path: Path) -> Iterator[Commands]:
    commands = Commands(tmp_path)
    yield commands
    commands.close()


@pytest.fixture
def team(commands: Commands, tmp_path: Path) -> Commands:
    """Engines of REX and DINGO, which run the model."""
    model = tmp_path / "search.bpmn"
    model.write_text(MODEL)
    commands.start("engine", "REX", "DINGO", "--insecure")
    commands.run("deploy", str(model), "--wait", "30")
    return commands


def wait_for_recorder(topic: str) -> None:
    """Wait until a recorder has subscribed to a topic that an engine publishes: a signal before that is not for it."""
    here = world("ros")
    assert isinstance(here, WallWorld)
    here.node("onlooker")
    (middleware,) = here.middlewares
    try:
        here.until(
            lambda: any(
                info.name == topic and info.publishers and "/fame_recorder" in info.subscribers
                for info in middleware.graph()
            )
        )
    finally:
        here.close()


# ---- the page --------------------------------------------------------------------------------------------------------


class Page:
    """What the page of `fame view` has: what it fetched, and the last state after all that its WebSocket sent."""

    def __init__(self, address: str, socket: Any) -> None:
        self.address, self.socket = address, socket
        self.mission: dict[str, Any] = {}
        self.waits: dict[int, dict[str, Any]] = {}
        self.variables: dict[tuple[int, int], dict[str, Any]] = {}
        self.messages: list[tuple[str, str, Any]] = []
        self.poses: dict[int, Any] = {}

    def fetch(self, path: str) -> Any:
        with urlopen(self.address + path, timeout=30) as answer:
            return json.load(answer)

    def until(self, condition: Callable[[], Any]) -> Any:
        """Take what comes until a condition holds, and return its value."""

        def look() -> Any:
            with suppress(TimeoutError):
                self._news(json.loads(self.socket.recv(timeout=0.1)))
            return condition()

        return eventually(look)

    def _news(self, news: dict[str, Any]) -> None:
        if news["type"] == "reload":
            self.mission = self.fetch("mission.json")
        elif news["type"] == "data":
            self._block(news["block"])

    def _block(self, block: dict[str, Any]) -> None:
        """Apply a block, or what is new in it, as the page does (page/store.js)."""
        if key := block.get("key"):
            self.waits = {robot: {token["key"]: token for token in tokens} for robot, tokens in key["waits"]}
            self.variables = {(robot, scope): dict(values) for robot, scope, values in key["variables"]}
            self.poses = dict(key["poses"])
        for _, robot, tokens, gone in block["waits"]:
            known = self.waits.setdefault(robot, {})
            for name in gone:
                known.pop(name, None)
            known.update((token["key"], token) for token in tokens)
        for time, robot, scope, values, _ in block["variables"]:
            if values is None:
                self.variables.pop((robot, scope), None)
            else:
                known = self.variables.setdefault((robot, scope), {})
                known.update((name, [value, time]) for name, value in values.items())
        self.messages += [tuple(message) for _, *message in block["messages"]]
        self.poses.update((robot, pose) for _, robot, pose in block["poses"])

    # ---- with names instead of numbers -------------------------------------------------------------------------------

    @property
    def robots(self) -> list[str]:
        return [robot["name"] for robot in self.mission.get("robots", ())]

    @property
    def waiting(self) -> set[tuple[str, str]]:
        """Robots and the elements at which their tokens wait."""
        if len(self.robots) <= max(self.waits, default=-1):
            return set()  # the page does not know this robot yet
        elements = self.mission["elements"]
        return {
            (self.robots[robot], elements[token["e"]]["id"])
            for robot, tokens in self.waits.items()
            for token in tokens.values()
            if 0 <= token["e"] < len(elements)
        }

    def values(self, robot: str) -> dict[str, Any]:
        """Variables of a robot."""
        return {
            name: value
            for (number, _), values in self.variables.items()
            if self.robots[number] == robot
            for name, (value, _) in values.items()
        }


@pytest.fixture
def page(commands: Commands) -> Iterator[Page]:
    """The page of a team that may be there already."""
    for package in ("starlette", "uvicorn", "websockets"):
        pytest.importorskip(package, reason=f"the page needs {package}: pip install 'fame-robots[view]'")
    from websockets.sync.client import connect

    viewer = commands.start("view", "--no-open")
    address = viewer.match(r"^(http://127\.0\.0\.1:\d+/\S+/)$")
    with connect(address.replace("http://", "ws://") + "live", open_timeout=30) as socket:
        yield Page(address, socket)
    assert viewer.interrupt() == 0, viewer.said


def test_the_page_shows_a_team_on_ros_and_what_it_does_next(team: Commands, page: Page) -> None:
    page.until(lambda: page.waiting == BEFORE and page.values("REX"))
    assert sorted(page.robots) == ["DINGO", "REX"]
    assert page.values("REX") == {"x": 1.5, "y": -2.0}
    elements = page.mission["elements"]
    assert {element["id"] for element in elements} >= {"Explore", "Report", "Found", "Heard", "Look"}
    assert {elements[robot["pool"]]["id"] for robot in page.mission["robots"]} == {"REX_pool", "DINGO_pool"}

    wait_for_recorder("/found")
    team.run("complete", "REX", "Report")
    page.until(lambda: page.waiting == AFTER and page.messages)
    assert page.messages == [("/found", "REX", {"x": 1.5, "y": -2.0, "z": 0.0})]


def test_the_page_shows_where_the_robots_of_a_simulation_on_ros_are(commands: Commands, page: Page) -> None:
    commands.start("run", "examples/ground_vehicles.yaml", "--duration", "120", "--quiet")
    page.until(lambda: len(page.robots) == 2 and len(page.poses) == 2)
    first = {robot: (pose["x"], pose["y"]) for robot, pose in page.poses.items()}
    page.until(lambda: any((pose["x"], pose["y"]) != first[robot] for robot, pose in page.poses.items()))
    for robot in page.mission["robots"]:
        drawn = page.fetch(f"plane/{robot['plane']}.json")
        assert drawn["svg"].startswith("<svg")
        assert str(robot["pool"]) in drawn["shapes"]


# ---- the recording ---------------------------------------------------------------------------------------------------


def recorded(file: Path) -> set[tuple[str, str]]:
    """Where tokens wait, as far as the file is written."""
    with suppress(ConfigError), Recording(file) as recording:
        robots = recording.state(recording.end).robots
        return {(name, token["element"]) for name, robot in robots.items() for token in robot.tokens.values()}
    return set()


def test_a_team_on_ros_is_recorded_until_ctrl_c(team: Commands, tmp_path: Path) -> None:
    from geometry_msgs.msg import Vector3
    from rclpy.serialization import deserialize_message
    from rosbags.highlevel import AnyReader

    file = tmp_path / "run.mcap"
    recorder = team.start("log", "record", "-o", str(file))
    for robot in ("REX", "DINGO"):
        recorder.match(f"^records {robot}: ")
    wait_for_recorder("/found")
    team.run("complete", "REX", "Report")
    eventually(lambda: recorded(file) == AFTER)
    assert recorder.interrupt() == 0
    assert re.search(r"run\.mcap: \d+\.\d s of DINGO, REX$", recorder.said)

    with Recording(file) as recording:
        assert not recording.warnings
        assert recording.metadata["lost_batches"] == "{}"
        assert recording.robots == ["DINGO", "REX"]
        assert all(b"Report the target" in text or b"Heard" in text for text in recording.models.values())
        steps = {robot: [event.element for event in recording.events(robots=[robot])] for robot in recording.robots}
        assert {"Report", "Found", "Rest"} <= set(steps["REX"])
        assert {"Heard", "Look"} <= set(steps["DINGO"])
        state = recording.state(recording.end).robots["REX"]
        values = {name: value for scope in state.scopes.values() for name, value in scope.values.items()}
        assert values == {"x": 1.5, "y": -2.0}
        assert (recording.topics["/found"].type, recording.topics["/found"].encoding) == (VECTOR, "cdr")
        (message,) = recording.messages(["/found"])
        assert message.node == "/REX/fame_engine"
        found = deserialize_message(message.data, Vector3)
        assert (found.x, found.y, found.z) == (1.5, -2.0, 0.0)
    convert(file, tmp_path / "bag")
    with AnyReader([tmp_path / "bag"]) as bag:
        (found,) = [bag.deserialize(data, one.msgtype) for one, _, data in bag.messages() if one.topic == "/found"]
    assert (found.x, found.y, found.z) == (1.5, -2.0, 0.0)
