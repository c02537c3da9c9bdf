"""An engine as a managed node of ROS 2: when it configures, what starts with its activation, what stops it."""

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from deployment_field import TEAM, Field, patrol
from domains import PROCESSES
from middleware_contract import needs
from test_resumption import Durable, told

from fame.deploy.requests import TaskClient, TaskRequest

ROOT = Path(__file__).parent.parent


class Managed(Field):
    """Robots whose engines have a lifecycle, and a manager."""

    def __init__(self, *robots: str) -> None:
        super().__init__(*robots, lifecycle=True)
        self.manager = self.middleware.node("manager")
        self.events: list[str] = []
        for name in robots:
            topic, type = f"/{name}/fame_engine/transition_event", "lifecycle_msgs/msg/TransitionEvent"
            self.manager.subscription(topic, type, lambda event: self.events.append(event.transition.label))

    def call(self, robot: str, service: str, type: str, request: dict | None = None):
        client = self.manager.client(f"/{robot}/fame_engine/{service}", f"lifecycle_msgs/srv/{type}")
        responses: list = []
        client.call(request, responses.append)
        self.pass_time(0.1)
        client.close()
        return responses[0]

    def change(self, label: str, *robots: str) -> bool:
        """Whether a transition succeeds, at all of the robots."""
        request = {"transition": {"label": label}}
        return all(self.call(robot, "change_state", "ChangeState", request).success for robot in robots)

    def state(self, robot: str) -> str:
        return self.call(robot, "get_state", "GetState").current_state.label

    def ask(self, robot: str, act: str):
        """The robot's report on a request of Ann."""
        heard: list = []
        client = TaskClient(
            robot, TaskRequest(id=f"{act} at {self.scheduler.now}", element="", act=act, who="ann"),
            node=self.person, scheduler=self.scheduler, answered=heard.append,
        )  # fmt: skip
        self.pass_time(1)
        client.close()
        return heard[0]


def test_a_deployment_is_ready_until_all_robots_are_activated() -> None:
    team = Managed("A", "B")
    assert not team.change("configure", "A")  # no process is loaded
    assert team.state("A") == "unconfigured"
    sent = team.deploy(TEAM, patience=60.0)
    assert not sent.done
    assert [engine.state for engine in team.engines.values()] == ["ready", "ready"]
    assert team.change("configure", "A", "B")
    assert team.change("activate", "A")
    team.pass_time(8)
    assert not sent.done
    assert team.engines["A"].running is None
    assert team.change("activate", "B")
    team.pass_time(1)
    assert [(each.robot, each.state) for each in sent.robots.values()] == [("A", "started"), ("B", "started")]
    assert team.events[:4] == ["configure", "transition_failure", "configure", "transition_success"]


def test_otherwise_it_is_aborted_and_its_sender_says_which_robot_was_not_activated() -> None:
    team = Managed("A", "B")
    sent = team.deploy(TEAM, patience=5.0, robots=["A", "B"])
    assert sent.failed
    assert [each.reason for each in sent.robots.values()] == [
        "is unconfigured (--lifecycle), and waits to be activated"
    ] * 2
    assert [engine.state for engine in team.engines.values()] == ["waiting", "waiting"]
    assert not team.change("configure", "A")


def test_deactivation_suspends_and_activation_goes_on() -> None:
    robot = Managed("p")
    robot.send("p", patrol(1))
    robot.pass_time(1)
    assert any("a bare model would start at once" in report.reason for report in robot.said)
    assert robot.engines["p"].running is None
    sent = robot.deploy(patrol(1), robots=["p"], patience=60.0)
    assert robot.change("configure", "p")
    assert robot.change("activate", "p")
    robot.pass_time(1)
    assert sent.robots["p"].state == "started"
    assert robot.change("deactivate", "p")
    assert robot.engines["p"].state == "suspended"
    assert "is inactive" in robot.ask("p", "continue").reason
    assert robot.change("cleanup", "p")  # what is loaded stays
    assert robot.change("configure", "p")
    assert robot.change("activate", "p")
    assert robot.engines["p"].state == "running"
    assert robot.ask("p", "suspend").answer == "suspended"
    assert robot.change("deactivate", "p")
    assert robot.change("activate", "p")
    assert robot.engines["p"].state == "suspended"  # by Ann, who lets it go on
    assert robot.ask("p", "continue").answer == "continued"
    assert robot.change("shutdown", "p")
    assert robot.state("p") == "finalized"
    assert not robot.engines["p"].running.engine.instances


def active(*robots: str) -> Managed:
    """Robots whose mission runs."""
    team = Managed(*robots)
    team.deploy(patrol(1), robots=robots, patience=60.0)
    assert team.change("configure", *robots)
    assert team.change("activate", *robots)
    team.pass_time(1)
    return team


def test_a_person_who_suspends_an_inactive_robot_is_not_overruled_by_its_activation() -> None:
    robot = active("p")
    assert robot.change("deactivate", "p")
    assert robot.ask("p", "suspend").answer == "suspended"
    assert robot.change("activate", "p")
    assert robot.engines["p"].state == "suspended"
    assert robot.ask("p", "continue").answer == "continued"


def test_a_transition_that_fails_in_any_way_leaves_the_state_as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = active("p")
    monkeypatch.setattr(robot.engines["p"].running.suspension, "suspend", lambda who: 1 / 0)
    assert not robot.change("deactivate", "p")
    assert robot.state("p") == "active"


def test_a_manager_sees_what_it_can_do() -> None:
    robot = Managed("A")
    listed = robot.call("A", "get_available_transitions", "GetAvailableTransitions").available_transitions
    shown = [(each.transition.id, each.transition.label, each.goal_state.label) for each in listed]
    assert shown == [(1, "configure", "configuring"), (5, "shutdown", "shuttingdown")]
    assert len(robot.call("A", "get_transition_graph", "GetAvailableTransitions").available_transitions) == 7
    assert len(robot.call("A", "get_available_states", "GetAvailableStates").available_states) == 10
    assert not robot.call("A", "change_state", "ChangeState", {"transition": {"id": 3}}).success


class DurableManaged(Durable):
    """A robot with a lifecycle and a state directory: a deployment is sent as its sender does."""

    def change(self, label: str) -> bool:
        node = self.middleware.node("manager")
        client = node.client("/A/fame_engine/change_state", "lifecycle_msgs/srv/ChangeState")
        responses: list = []
        client.call({"transition": {"label": label}}, responses.append)
        self.pass_time(0.5)
        node.close()
        return responses[0].success


@pytest.fixture
def durable(tmp_path: Path) -> Iterator[DurableManaged]:
    """It runs `patrol(1)`, and is ready for `patrol(2)`."""
    made = DurableManaged(tmp_path / "state", lifecycle=True)
    told(made, "d1", 1, patrol(1), "load")
    made.pass_time(0.5)
    assert made.change("configure")
    assert made.change("activate")
    told(made, "d1", 1, "", "start")
    made.pass_time(0.5)
    told(made, "d2", 2, patrol(2), "load")
    made.pass_time(0.5)
    assert (made.engine.state, made.engine.deployed) == ("ready", "d1")
    yield made
    for engine in made.engines.values():
        engine.close()


def test_a_promise_is_kept_by_an_engine_that_is_inactive_after_a_crash(durable: DurableManaged) -> None:
    durable.crash()
    durable.start()
    durable.pass_time(1)
    assert (durable.engine.state, durable.said[-1].candidate) == ("ready", "d2")
    told(durable, "d2", 2, "", "start")
    durable.pass_time(1)
    assert (durable.engine.deployed, durable.engine.state) == ("d2", "suspended")
    assert durable.change("configure")
    assert durable.change("activate")
    assert (durable.engine.state, durable.variables("A")) == ("running", {"mark": 2})


def test_what_was_called_off_while_an_inactive_engine_was_down_is_forgotten(durable: DurableManaged) -> None:
    durable.crash()
    durable.start()
    durable.pass_time(1)
    told(durable, "d2", 2, "", "abort")
    durable.pass_time(1)
    assert (durable.engine.deployed, durable.engine.state) == ("d1", "suspended")
    durable.crash()
    durable.start()
    durable.pass_time(1)
    assert (durable.engine.deployed, durable.said[-1].candidate) == ("d1", "")
    assert durable.change("configure")
    assert durable.change("activate")
    assert (durable.engine.state, durable.variables("A")) == ("running", {"mark": 1})


@pytest.mark.ros
@pytest.mark.processes
@needs("rclpy")
@needs("cyclonedds")
@pytest.mark.skipif(shutil.which("ros2") is None, reason="ROS 2 is not sourced")
def test_ros2_drives_the_lifecycle_of_an_engine() -> None:
    environment = os.environ | {"ROS_DOMAIN_ID": str(PROCESSES), "PYTHONPATH": os.pathsep.join((str(ROOT), *sys.path))}

    def called(service: str, type: str, request: str) -> str:
        words = ["ros2", "service", "call", f"/A/fame_engine/{service}", f"lifecycle_msgs/srv/{type}", request]
        return subprocess.run(words, env=environment, capture_output=True, text=True, timeout=60, check=True).stdout

    words = [sys.executable, "-m", "fame", "engine", "A", "--lifecycle"]
    with subprocess.Popen(words, env=environment, stderr=subprocess.PIPE, text=True) as engine:
        assert engine.stderr is not None
        try:
            assert "waits for its process" in engine.stderr.readline()
            assert "label='unconfigured'" in called("get_state", "GetState", "{}")
            assert "success=False" in called("change_state", "ChangeState", "{transition: {id: 1}}")
            assert "success=True" in called("change_state", "ChangeState", "{transition: {label: shutdown}}")
            assert "label='finalized'" in called("get_state", "GetState", "{}")
        finally:
            engine.send_signal(signal.SIGTERM)
