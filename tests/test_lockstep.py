"""Lockstep: the world waits for every engine after each step, messages wait for their step, and runs are the same."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from bpmn_text import document
from domains import PROCESSES
from middleware_contract import WallWorld, dds_world, needs, zenoh_world

from fame.cli import main
from fame.clock import SECOND, Scheduler
from fame.middleware.local import LocalMiddleware
from fame.middleware.messages import create, nanoseconds
from fame.middleware.simulated_time import STEP_DONE, STEP_DONE_TYPE, ClockFollower
from fame.scenario.world_process import LockstepRounds, WorldNode
from sim2d.config import world_config

ROOT = Path(__file__).parents[1]
ENVIRONMENT = os.environ | {"ROS_DOMAIN_ID": str(PROCESSES), "PYTHONPATH": os.pathsep.join((str(ROOT), *sys.path))}
INT = "std_msgs/msg/Int64"
CAR = {"size": [6, 4], "robots": {"REX": {"type": "car", "at": [1, 1]}}}


class AtOnce:
    """Messages that wait for nothing, as within one process."""

    def release(self, enter: Any) -> None:
        pass

    def flush(self) -> None:
        pass


# ---- whose turn it is ------------------------------------------------------------------------------------------------


class Team:
    """A world in lockstep with engines that say what they are told to."""

    def __init__(self, *names: str) -> None:
        self.wall: Any = Scheduler()
        self.middleware = LocalMiddleware(self.wall)
        self.engines = {name: self.middleware.node("fame_time", name) for name in names}
        self.done = {name: node.publisher(STEP_DONE, STEP_DONE_TYPE) for name, node in self.engines.items()}
        self.part = WorldNode(world_config(CAR), 0, self.wall, self.middleware, team=names, steps=AtOnce(), speed=None)

    @property
    def steps(self) -> int:
        return self.part._world.steps

    def say(self, name: str, wait: float = 0.01) -> None:
        time = self.part.time.now
        stamp = {"sec": time // SECOND, "nanosec": time % SECOND}
        self.done[name].publish(create(STEP_DONE_TYPE, {"stamp": stamp, "frame_id": name}))
        self.wait(wait)

    def wait(self, seconds: float) -> None:
        self.wall.run(self.wall.now + round(seconds * SECOND))


def test_a_world_steps_when_every_engine_is_done_with_the_last_step() -> None:
    team = Team("REX", "DINGO")
    team.wait(10)
    assert team.steps == 0
    for round in range(1, 6):  # in the first nothing happens yet, in the second the world begins
        team.say("REX")
        before = team.steps
        team.wait(10)
        assert team.steps == before
        team.say("DINGO")
        assert team.steps == max(0, round - 1)
    team.part.close()


def test_an_engine_that_died_is_waited_for_no_more() -> None:
    team = Team("REX", "DINGO")
    for _ in range(3):
        team.say("REX")
        team.say("DINGO")
    before = team.steps
    team.engines["DINGO"].close()
    team.say("REX", wait=3)
    assert team.steps > before
    team.part.close()


def test_a_team_of_nobody_is_done_at_once() -> None:
    scheduler, over = Scheduler(), list[int]()
    middleware = LocalMiddleware(scheduler)
    rounds = LockstepRounds([], scheduler, middleware, middleware.node("world"), lambda: over.append(1), list)
    rounds.begin(0)
    scheduler.run(0)
    assert over == [1]
    rounds.close()


def test_a_step_is_repeated_for_an_engine_that_has_come_back_and_did_not_get_it() -> None:
    scheduler, said = Scheduler(), list[str]()
    middleware = LocalMiddleware(scheduler)
    world = middleware.node("world")
    rounds = LockstepRounds(
        ["REX"], scheduler, middleware, world, lambda: said.append("over"), lambda: said.append("again")
    )
    done = middleware.node("fame_time", "REX").publisher(STEP_DONE, STEP_DONE_TYPE)
    rounds.begin(0)
    done.publish(create(STEP_DONE_TYPE, {"frame_id": "REX"}))
    scheduler.run(SECOND // 2)
    rounds.begin(SECOND)  # REX ends now, and is back in a moment
    scheduler.run(3 * SECOND)
    done.publish(create(STEP_DONE_TYPE, {"stamp": {"sec": 1}, "frame_id": "REX"}))
    scheduler.run(6 * SECOND)
    assert said == ["over", "again", "again", "again", "over"]
    rounds.close()


def test_a_follower_says_that_it_is_done_when_all_that_was_due_is() -> None:
    wall, said = Scheduler(), list[tuple[str, int]]()
    middleware = LocalMiddleware(wall)
    time, world = ClockFollower(wall), middleware.node("world")
    clock = world.publisher("/clock", "rosgraph_msgs/msg/Clock")
    world.subscription(STEP_DONE, STEP_DONE_TYPE, lambda done: said.append((done.frame_id, nanoseconds(done.stamp))))
    time.subscribe_in_lockstep(middleware.node("fame_time", "REX"), AtOnce())
    time.at(SECOND, lambda: said.append(("timer", time.now)))
    for second in (0, 0, 1, 1):
        clock.publish(create("rosgraph_msgs/msg/Clock", {"clock": second}))
        wall.run()
    assert said == [("REX", 0), ("REX", 0), ("timer", SECOND), ("REX", SECOND), ("REX", SECOND)]


# ---- messages wait for their step ------------------------------------------------------------------------------------


WIRES = [
    pytest.param("dds", marks=[needs("cyclonedds"), pytest.mark.dds]),
    pytest.param("zenoh", marks=[needs("zenoh"), pytest.mark.zenoh]),
]


@pytest.fixture(params=WIRES)
def here(request: pytest.FixtureRequest) -> Iterator[WallWorld]:
    world = dds_world(apart=True) if request.param == "dds" else zenoh_world(apart=True)
    yield world
    world.close()


def test_held_messages_come_when_they_are_released_by_topic_and_sender(here: WallWorld) -> None:
    from fame.middleware.simulated_time import Lockstep

    seen: list[tuple[str, int]] = []
    node = here.node("fame_engine", "REX")
    steps = Lockstep(here.middlewares[0], lambda node: node.name == "fame_engine")
    for topic in ("/b", "/a"):
        node.subscription(topic, INT, lambda message, topic=topic: seen.append((topic, message.data)))
    free = here.middlewares[0].node("fame_time", "REX")
    free.subscription("/b", INT, lambda message: seen.append(("free", message.data)))
    senders = {name: here.node(name) for name in ("zoe", "adam")}
    ends = {(name, topic): senders[name].publisher(topic, INT) for name in senders for topic in ("/b", "/a")}
    here.connect("/a", "/b")
    here.until(lambda: {"/zoe", "/adam"} <= set(here.middlewares[0].node_names()))
    for number in range(3):
        for (name, _), end in ends.items():
            end.publish(create(INT, number + (10 if name == "zoe" else 0)))
    here.until(lambda: len(seen) == 6)
    here.settle()
    assert {topic for topic, _ in seen} == {"free"}
    seen.clear()
    here.middlewares[0].node("fame_engine", "DINGO")  # one that comes later is held, too
    steps.flush()
    steps.release(lambda hand_over: hand_over())
    numbers = [0, 1, 2, 10, 11, 12]
    assert seen == [*(("/a", number) for number in numbers), *(("/b", number) for number in numbers)]
    seen.clear()
    steps.release(lambda hand_over: hand_over())
    assert seen == []


# ---- from the command line -------------------------------------------------------------------------------------------

DRIVE = """
place = 0
for number in range(20):
    robot.publish("cmd_vel", "geometry_msgs/msg/Twist", linear={"x": 0.3}, angular={"z": 0.1 * number - place})
    await sleep(0.07)
    place = (await receive("odom", "nav_msgs/msg/Odometry")).pose.pose.position.x
robot.publish("cmd_vel", "geometry_msgs/msg/Twist")
signal("done")
"""


def two_cars(folder: Path) -> Path:
    """A scenario of two cars that drive for some seconds, and listen to their odometry."""
    pools, flow = "", '<sequenceFlow id="{0}1" sourceRef="{0}s" targetRef="{0}t"/>'
    for name in ("REX", "DINGO"):
        task = f'<startEvent id="{name}s"/><scriptTask id="{name}t"><script>{DRIVE.strip()}</script></scriptTask>'
        pools += f'<process id="{name}p" isExecutable="true">{task}{flow.format(name)}</process>'
    shown = "".join(f'<participant id="{name}" name="{name}" processRef="{name}p"/>' for name in ("REX", "DINGO"))
    (folder / "drive.bpmn").write_text(document(f'<collaboration id="C">{shown}</collaboration>{pools}'))
    robots = {name: {"type": "car", "at": [1, 1 + row], "heading": 0} for row, name in enumerate(("REX", "DINGO"))}
    scenario = {"model": "drive.bpmn", "world": {"size": [6, 4], "robots": robots}}
    (folder / "drive.yaml").write_text(json.dumps(scenario))
    return folder / "drive.yaml"


def places_after_lockstep(scenario: Path, middleware: str) -> Any:
    """Where the robots are when a run in lockstep has completed."""
    words = ["run", str(scenario), "--duration", "20", "--seed", "3", "--middleware", middleware, "--lockstep"]
    done = subprocess.run(
        [sys.executable, "-m", "fame", *words, "--json"],
        env=ENVIRONMENT, capture_output=True, text=True, timeout=90, check=False,
    )  # fmt: skip
    said = json.loads(done.stdout)
    assert (done.returncode, said["status"]) == (0, "completed"), done
    return said["world"]["robots"]


@pytest.mark.processes
@pytest.mark.parametrize("middleware", WIRES)
def test_a_run_in_lockstep_is_the_same_every_time(tmp_path: Path, middleware: str) -> None:
    scenario = two_cars(tmp_path)
    first, second = (places_after_lockstep(scenario, middleware) for _ in range(2))
    assert first == second
    assert first["REX"]["x"] > 1.2


@pytest.mark.processes
@needs("cyclonedds")
def test_a_run_in_lockstep_says_that_what_comes_from_outside_is_not_exact_to_the_step(tmp_path: Path) -> None:
    scenario = two_cars(tmp_path)
    model = tmp_path / "drive.bpmn"
    task = model.read_text().partition("<scriptTask")[2].partition("</scriptTask>")[0]
    model.write_text(model.read_text().replace(f"<scriptTask{task}</scriptTask>", '<userTask id="REXt"/>'))
    words = ["run", str(scenario), "--duration", "20", "--middleware", "dds", "--complete", "REX@1:REXt"]
    done = subprocess.run(
        [sys.executable, "-m", "fame", *words, "--lockstep", "--quiet"],
        env=ENVIRONMENT, capture_output=True, text=True, timeout=90, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done
    assert "complete and signal come in a step that differs between runs" in done.stderr


ROS_NODE = """
import rclpy
from nav_msgs.msg import Odometry
from rclpy.qos import qos_profile_sensor_data
from rosgraph_msgs.msg import Clock
rclpy.init()
node, heard = rclpy.create_node("beside"), {"odom": 0, "clock": 0}
def hear(name, message):
    heard[name] += 1
    print(heard, flush=True)
node.create_subscription(Odometry, "/REX/odom", lambda message: hear("odom", message), qos_profile_sensor_data)
node.create_subscription(Clock, "/clock", lambda message: hear("clock", message), qos_profile_sensor_data)
print("ready", flush=True)
rclpy.spin(node)
"""
"""A node of ROS 2 that listens to the robots and to the clock."""


@pytest.mark.ros
@pytest.mark.processes
@needs("rclpy")
@needs("cyclonedds")
def test_a_run_in_lockstep_is_the_same_beside_a_node_of_ros(tmp_path: Path) -> None:
    scenario = two_cars(tmp_path)
    alone = places_after_lockstep(scenario, "dds")
    beside = subprocess.Popen([sys.executable, "-c", ROS_NODE], env=ENVIRONMENT, stdout=subprocess.PIPE, text=True)
    try:
        assert beside.stdout is not None
        assert beside.stdout.readline() == "ready\n"
        assert places_after_lockstep(scenario, "dds") == alone
    finally:
        beside.kill()
        heard, _ = beside.communicate()
    assert "'odom': 20" in heard
    assert "'clock': 20" in heard


@pytest.mark.parametrize("words", ["run models/ground_vehicles.bpmn --lockstep"])
def test_one_process_needs_no_lockstep(words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words.split()) == 2
    assert "--middleware dds" in capsys.readouterr().err
