"""FAME beside rclpy on Fast DDS, the default of ROS 2: its DDS backend (Cyclone), and rclpy with Fast DDS below FAME.

``make test-fastdds`` installs rclpy and Fast DDS of Jazzy and of Kilted from PyPI for Python 3.12. The tests of all
backends (``-m ros``) run there too. Topics and the graph are understood between any two DDS; services and actions are
not.
"""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import pytest
from bpmn_text import document
from domains import PROCESSES
from middleware_contract import DOMAIN, World, dds_world, ros_world

from fame.clock import SECOND
from fame.deploy import Report
from fame.errors import MessageError
from fame.fleet.markers import MarkerPublisher
from fame.middleware.actions import ActionClient
from fame.middleware.interface import Node
from fame.middleware.messages import create, register_files

MISSING = not all(map(importlib.util.find_spec, ("rmw_fastrtps_cpp", "cyclonedds")))
pytestmark = [
    pytest.mark.fastdds,
    pytest.mark.skipif(MISSING, reason="there is no Fast DDS: make test-fastdds"),
]
TEXT, SET_BOOL, COUNT = "std_msgs/msg/String", "std_srvs/srv/SetBool", "test_msgs/action/Fibonacci"
try:
    IS_KILTED = int(version("ros-rclpy").split(".")[0]) >= 9
except PackageNotFoundError:
    IS_KILTED = False
LARGE = 1_000_000
"""Bytes. More than a packet of UDP: it is sent in fragments."""
PATIENCE = 2 * SECOND
if not MISSING:
    register_files(Path(sys.prefix, "share", "test_msgs"))


@pytest.fixture(params=["dds", "ros"])
def here(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[World]:
    """A backend in this process, beside a node on Fast DDS in another one."""
    monkeypatch.setenv("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp")
    made = dds_world(apart=True) if request.param == "dds" else ros_world(apart=True)
    script = Path(__file__).with_name("fastdds_child.py")
    environment = os.environ | {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    with subprocess.Popen([sys.executable, str(script), str(DOMAIN)], env=environment) as child:
        yield made
        child.kill()
    made.close()


on_dds = pytest.mark.parametrize("here", ["dds"], indirect=True)
on_ros = pytest.mark.parametrize("here", ["ros"], indirect=True)


def talk(here: World, node: Node) -> tuple[Any, list[int]]:
    """A publisher that the stranger hears, and the lengths of its answers, which arrive."""
    answers: list[int] = []
    node.subscription("/answer", TEXT, lambda message: answers.append(len(message.data)))
    publisher = node.publisher("/ask", TEXT)
    here.connect("/answer", "/ask")

    def answered() -> bool:
        publisher.publish(create(TEXT, ""))  # until the stranger has found the subscription, too
        here.settle()
        return bool(answers)

    here.until(answered)
    here.settle()
    answers.clear()
    return publisher, answers


def test_messages_of_every_size_go_both_ways(here: World) -> None:
    publisher, answers = talk(here, here.node("us", "REX"))
    for length in (10, LARGE, 0, LARGE):
        publisher.publish(create(TEXT, "a" * length))
        again = here.scheduler.now + PATIENCE
        while not answers or answers[-1] != length:
            here.settle()
            if length == LARGE and here.scheduler.now > again:  # Cyclone loses the first one that Fast DDS fragments
                publisher.publish(create(TEXT, "a" * length))
                again = here.scheduler.now + PATIENCE
    assert list(dict.fromkeys(answers)) == [10, LARGE, 0]


def expect_that_cyclone_cannot_read(type: str, request: pytest.FixtureRequest) -> None:
    """One with a list of messages, as Kilted's Fast DDS describes it."""
    if IS_KILTED and request.node.callspec.params["here"] == "dds":
        why = f"Cyclone DDS 11.0 cannot read the type of {type} that Kilted's Fast DDS sends"
        request.applymarker(pytest.mark.xfail(reason=why, strict=True))


def test_the_graph_shows_the_nodes_of_both(here: World, request: pytest.FixtureRequest) -> None:
    expect_that_cyclone_cannot_read("ros_discovery_info", request)
    node = here.node("us", "REX")
    talk(here, node)
    middleware = here.middlewares[0]  # type: ignore[attr-defined]
    here.until(lambda: {"/OTHER/stranger", "/REX/us"} <= set(middleware.node_names()))
    topics = {topic.name: topic for topic in middleware.graph()}
    assert (topics["/answer"].publishers, topics["/answer"].subscribers) == (("/OTHER/stranger",), ("/REX/us",))
    assert topics["/ask"].types == (TEXT,)


def test_rclpy_reads_the_markers_of_a_mission(here: World, request: pytest.FixtureRequest) -> None:
    expect_that_cyclone_cannot_read("a MarkerArray", request)
    node, heard = here.node("us", "REX"), list[str]()
    node.subscription("/answer", TEXT, lambda message: heard.append(message.data))
    show = MarkerPublisher(node, "REX/base_link", lambda: None)
    report = Report(robot="REX", state="running", time=0.0)

    def answered() -> bool:
        show(report)  # until the stranger has found the publisher, and is found
        here.settle()
        return bool(heard)

    here.until(answered)
    assert heard[0] == "REX/state REX/base_link REX: running"


@on_dds
def test_services_and_actions_of_fast_dds_are_refused_with_the_reason(here: World) -> None:
    node = here.node("us", "REX")
    service, action = node.client("/OTHER/twice", SET_BOOL), ActionClient(node, "/OTHER/count", COUNT)
    here.until(lambda: service.mismatch and action.mismatch)
    assert (service.available, action.available) == (False, False)
    for call in (lambda: service.call({"data": True}, print), lambda: action.send({"order": 3}, print)):
        with pytest.raises(MessageError, match=r"on another DDS than Cyclone\. .*rmw_cyclonedds_cpp"):
            call()
    assert "the service /OTHER/twice is offered by /" in service.mismatch


@on_dds
def test_a_client_on_fast_dds_is_told_of(here: World) -> None:
    here.node("us", "REX").service("ours", SET_BOOL, lambda request: {"success": True})
    here.until(lambda: here.warnings)
    (text,) = here.warnings  # Fast DDS names its nodes later than their endpoints, sometimes much later
    assert re.match(r"/REX/ours: cannot be called by /\S+, which is on another DDS than Cyclone\. No two", text)


@on_ros
def test_services_of_fast_dds_answer_on_rclpy(here: World) -> None:
    answers: list[Any] = []
    client = here.node("us", "REX").client("/OTHER/twice", SET_BOOL)
    here.until(lambda: client.available)
    client.call({"data": True}, answers.append)
    here.until(lambda: answers)
    assert (answers[0].success, answers[0].message) == (True, "TrueTrue")


@on_ros
def test_actions_of_fast_dds_tell_how_far_they_are_and_end(here: World) -> None:
    told: list[list[int]] = []
    ended: list[tuple[str, list[int]]] = []
    client = ActionClient(here.node("us", "REX"), "/OTHER/count", COUNT)
    here.until(lambda: client.available)
    client.send(
        {"order": 4},
        lambda outcome, result: ended.append((outcome, list(result.sequence))),
        lambda feedback: told.append(list(feedback.sequence)),
    )
    here.until(lambda: ended and told)
    assert ended == [("succeeded", [0, 1, 2, 3])]
    assert all(numbers == list(range(len(numbers))) for numbers in told)


@on_ros
def test_goals_on_fast_dds_can_be_cancelled(here: World) -> None:
    told, node = list[Any](), here.node("us", "REX")
    _, answers = talk(here, node)
    client = ActionClient(node, "/OTHER/count", COUNT)
    here.until(lambda: client.available)
    goal = client.send({"order": 1000}, lambda *ended: told.append(ended), told.append)
    here.until(lambda: told)
    goal.cancel()
    here.until(lambda: answers)
    assert answers == [len("cancelled")]


@pytest.mark.parametrize(("engine", "sender"), [("ros", "dds"), ("dds", "ros")])
def test_a_large_model_is_deployed_between_cyclone_and_fast_dds(engine: str, sender: str, tmp_path: Path) -> None:
    text = f"<documentation>{'x' * LARGE}</documentation>"
    flow = '<startEvent id="s"/><sequenceFlow id="f" sourceRef="s" targetRef="e"/><endEvent id="e"/>'
    pool = '<collaboration id="C"><participant id="A" name="REX" processRef="p"/></collaboration>'
    (tmp_path / "large.bpmn").write_text(document(f'{pool}<process id="p">{text}{flow}</process>'))
    environment = os.environ | {
        "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp",
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_DOMAIN_ID": str(PROCESSES),
    }
    fame = [sys.executable, "-m", "fame"]
    command = [*fame, "engine", "REX", "--insecure", "--middleware", engine]
    with subprocess.Popen(command, env=environment) as process:
        words = ["deploy", str(tmp_path / "large.bpmn"), "--wait", "60", "--middleware", sender]
        done = subprocess.run(
            [*fame, *words], env=environment, capture_output=True, text=True, timeout=120, check=False
        )
        process.kill()
    assert done.returncode == 0, done
    assert re.search(r"REX +started", done.stdout), done
