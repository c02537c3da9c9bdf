"""An action server in a process of its own is stopped, or killed and started again: the token goes on."""

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from action_server import DRIVE, skip_without_drive
from bpmn_text import process, properties
from domains import DOMAIN
from middleware_contract import WallWorld, needs, world

from fame.bpmn.reader import read_text
from fame.clock import SECOND
from fame.robot import RobotNode, make_mission

pytestmark = pytest.mark.processes
HERE = Path(__file__).parent
LEASE_OF_ROS = 10
"""Time after which the middleware of ROS takes a silent process for gone (s)."""


class Driver:
    """The action server in its process; `said` are the lines that it has printed."""

    def __init__(self, middleware: str) -> None:
        words = [sys.executable, "-W", "error", str(HERE / "driver_child.py"), middleware, str(DOMAIN)]
        if middleware == "ros":  # with rclpy's own action server
            words = [sys.executable, str(HERE / "rclpy_driver.py")]
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
        self.said: list[str] = []
        self.process = subprocess.Popen(
            words, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self._reading = threading.Thread(target=self._read)
        self._reading.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.said.append(line.strip())

    def step(self) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write("x")
        self.process.stdin.flush()

    def send(self, number: signal.Signals) -> None:
        self.process.send_signal(number)

    def close(self) -> None:
        with suppress(ProcessLookupError):
            self.process.kill()
        self.process.wait()
        self._reading.join()
        for pipe in (self.process.stdin, self.process.stdout):
            assert pipe is not None
            with suppress(BrokenPipeError):
                pipe.close()


class Place:
    """An engine in this process, and drivers in processes of their own."""

    def __init__(self, middleware: str) -> None:
        self.middleware = middleware
        made = world(f"{middleware} apart")
        assert isinstance(made, WallWorld)
        self.here = made
        self.here.node("_watcher")
        self.drivers: list[Driver] = []
        self.robots: list[RobotNode] = []

    def driver(self) -> Driver:
        """A driver that is a server."""
        return self.begin(self.loaded())

    def loaded(self) -> Driver:
        """A process that has loaded all that a driver needs: that takes long on a busy machine."""
        self.drivers.append(Driver(self.middleware))
        self.until(lambda: self.drivers[-1].said == ["loaded"])
        return self.drivers[-1]

    def begin(self, driver: Driver) -> Driver:
        """Let a loaded driver be a server."""
        driver.said.clear()
        driver.step()
        self.until(lambda: driver.said == ["ready"])
        return driver

    def run(self, distance: int, more: str = "", **said: str) -> Any:
        """Start the service task ``t`` that drives so far; returns its instance."""
        task = properties(action="drive", type=DRIVE, payload=f"{{distance: {distance}}}", **said)
        outer = '<startEvent id="s"/><sequenceFlow id="f" sourceRef="s" targetRef="t"/>'
        definitions = read_text(process(f'{outer}<serviceTask id="t">{task}</serviceTask>{more}'), file="m.bpmn")
        mission = make_mission(definitions, definitions.processes[0])
        robot = RobotNode("REX", mission, scheduler=self.here.scheduler, middleware=self.here.middlewares[0])
        self.robots.append(robot)
        robot.load()
        robot.start({})
        return robot.instances[-1]

    def until(self, condition: Any) -> None:
        self.here.until(condition)

    def end(self, instance: Any, driver: Driver) -> Any:
        """Let the driver drive until the instance is over."""
        while instance.status == "running":
            driver.step()
            self.here.scheduler.run(self.here.scheduler.now + SECOND // 10)
        return instance

    def is_gone(self) -> bool:
        """Whether the engine finds no server."""
        return any("it has had no server" in token.text for token in self.robots[-1].waiting_tokens())

    def until_gone(self) -> None:
        """Until the engine finds no server any more."""
        self.until(self.is_gone)

    def close(self) -> None:
        for driver in self.drivers:
            driver.close()
        for robot in self.robots:
            robot.close()
        self.here.close()


@pytest.fixture
def lease() -> str:
    """Time after which a process that fell silent is gone (s)."""
    return "2"


@pytest.fixture(
    params=[
        pytest.param("dds", marks=[needs("cyclonedds"), pytest.mark.dds]),
        pytest.param("zenoh", marks=[needs("zenoh"), pytest.mark.zenoh]),
        pytest.param("ros", marks=[needs("rclpy"), pytest.mark.ros]),
    ]
)
def place(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch, lease: str) -> Iterator[Place]:
    skip_without_drive(request.param)
    monkeypatch.setenv("FAME_LEASE", lease)
    made = Place(request.param)
    yield made
    made.close()


def test_a_goal_goes_on_when_its_server_was_stopped_for_longer_than_the_lease(place: Place) -> None:
    driver = place.driver()
    instance = place.run(3)
    place.until(lambda: "goal" in driver.said)
    driver.step()
    for _ in range(3):
        driver.send(signal.SIGSTOP)
        place.until_gone()
        driver.send(signal.SIGCONT)
        place.until(lambda: not place.is_gone())
    assert place.end(instance, driver).status == "completed"
    assert driver.said == ["ready", "goal"]


def test_a_goal_goes_on_when_its_server_was_stopped_for_less(place: Place) -> None:
    driver = place.driver()
    instance = place.run(3)
    place.until(lambda: "goal" in driver.said)
    driver.send(signal.SIGSTOP)
    place.here.scheduler.run(place.here.scheduler.now + SECOND)
    driver.send(signal.SIGCONT)
    assert place.end(instance, driver).status == "completed"
    assert driver.said == ["ready", "goal"]


@pytest.mark.parametrize("lease", ["2", "10"], ids=["after its lease", "within its lease"])
@pytest.mark.parametrize("retry", ["safe", "never"])
def test_a_goal_whose_server_was_killed_and_started_again_is_sent_again_or_lost(
    place: Place, lease: str, retry: str
) -> None:
    driver, again = place.driver(), place.loaded()
    instance = place.run(3, retry=retry)
    place.until(lambda: "goal" in driver.said)
    driver.send(signal.SIGKILL)
    if lease == "2":
        place.until_gone()
    else:
        place.here.scheduler.run(place.here.scheduler.now + 2 * SECOND)
    end = place.end(instance, place.begin(again))
    if retry == "safe":
        assert (end.status, again.said) == ("completed", ["ready", "goal"])
    else:
        assert (end.status, end.error.code, again.said) == ("failed", "lost", ["ready"])


@pytest.mark.parametrize("missed", [True, False], ids=["after its lease", "within its lease"])
def test_a_goal_that_was_cancelled_while_its_server_was_stopped_is_cancelled_when_that_is_back(
    place: Place, missed: bool
) -> None:
    wait = LEASE_OF_ROS + 4 if missed and place.middleware == "ros" else 4 if missed else 1
    driver = place.driver()
    instance = place.run(
        9,
        f'<boundaryEvent id="late" attachedToRef="t"><timerEventDefinition><timeDuration>PT{wait}S</timeDuration>'
        "</timerEventDefinition></boundaryEvent>",
    )
    place.until(lambda: "goal" in driver.said)
    driver.send(signal.SIGSTOP)
    if missed:
        place.until_gone()
    place.until(lambda: instance.status == "completed")
    driver.send(signal.SIGCONT)
    place.until(lambda: "cancelled" in driver.said)
