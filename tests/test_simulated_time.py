"""Simulated time that one process makes and the others follow: it goes on, stands still, and begins anew."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, cast

import pytest
from bpmn_text import process
from middleware_contract import DOMAIN, dds_world, needs

from fame.bpmn.reader import read_text
from fame.cli import main
from fame.clock import SECOND, Kind, Scheduler, WallScheduler
from fame.log.recording import scene_values
from fame.log.team_recorder import WORLD_SCENE
from fame.middleware.interface import Node
from fame.middleware.local import LocalMiddleware
from fame.middleware.messages import create, nanoseconds
from fame.middleware.simulated_time import CLOCK, CLOCK_QOS, CLOCK_TYPE, ClockFollower, Lockstep, clock_message
from fame.robot import RobotNode, make_mission
from fame.robot.options import RobotOptions
from fame.scenario.world_process import EMPTY, PAUSE, RESUME, WORLD_STATE, WorldNode
from sim2d.config import world_config

TEXT = "std_msgs/msg/String"
CAR = {"size": [6, 4], "robots": {"REX": {"type": "car", "at": [1, 1]}}}


def test_time_on_the_wire_is_to_the_nanosecond() -> None:
    for time in (0, 1, SECOND - 1, SECOND, 1_234_567_890_123):
        assert nanoseconds(clock_message(time).clock) == time


# ---- who follows -----------------------------------------------------------------------------------------------------


class Clock:
    """A wall clock, and a clock on the topic that is set by hand."""

    def __init__(self) -> None:
        self.wall = Scheduler()
        middleware = LocalMiddleware(self.wall)
        self._says = middleware.node("world").publisher(CLOCK, CLOCK_TYPE, CLOCK_QOS)
        self.jumps: list[str] = []
        self.time = ClockFollower(self.wall, lambda warning: self.jumps.append(str(warning)))
        self.time.subscribe(middleware.node("robot"))

    def say(self, seconds: float) -> None:
        self._says.publish(clock_message(round(seconds * SECOND)))
        self.wall.run(self.wall.now + SECOND)


@pytest.fixture
def clock() -> Clock:
    return Clock()


def test_work_beside_a_follower_does_not_hold_it_unless_the_world_waits_for_it_too() -> None:
    wall = WallScheduler()
    middleware = LocalMiddleware(wall)
    done: list[tuple[str, Exception | None]] = []
    for waits in (False, True):
        follower = ClockFollower(wall)
        if waits:
            follower.subscribe_in_lockstep(middleware.node("robot"), cast(Lockstep, None))
        else:
            follower.subscribe(middleware.node("robot"))
        worker = follower.worker("beside")
        worker.call(lambda: threading.current_thread().name, lambda name, error: done.append((name, error)))
        worker.close()
        wall.run(wall.now)
    assert done == [("beside", None), (threading.current_thread().name, None)]


def test_timers_are_due_when_the_clock_says_so_in_their_order(clock: Clock) -> None:
    seen: list[tuple[str, float]] = []

    def note(name: str) -> Callable[[], object]:
        return lambda: seen.append((name, clock.time.now / SECOND))

    clock.time.at(2 * SECOND, note("two"))
    clock.time.at(SECOND, note("one"))
    clock.time.at(SECOND, note("message"), Kind.MESSAGE)
    clock.say(0.9)
    assert (seen, clock.time.now) == ([], 0.9 * SECOND)
    clock.say(5)
    assert seen == [("message", 1.0), ("one", 1.0), ("two", 2.0)]
    assert clock.time.now == 5 * SECOND


def test_what_is_due_is_done_while_time_stands_still(clock: Clock) -> None:
    seen: list[Any] = []
    clock.say(3)
    clock.time.after(1, lambda: seen.append("later"))
    clock.time.soon(lambda: clock.time.soon(lambda: seen.append("now")))
    clock.wall.run(clock.wall.now + 100 * SECOND)
    assert (seen, clock.time.now) == (["now"], 3 * SECOND)


def test_time_goes_on_when_the_world_begins_anew(clock: Clock) -> None:
    seen: list[float] = []
    clock.say(100)
    clock.time.after(10 * SECOND, lambda: seen.append(clock.time.now / SECOND))
    clock.say(0)
    assert clock.time.now == 100 * SECOND
    assert [text.partition(":")[0] for text in clock.jumps] == ["/clock jumped back from 100.0 to 0.0 s"]
    clock.say(9)
    assert seen == []
    clock.say(11)
    assert (seen, clock.time.now) == ([110.0], 111 * SECOND)
    assert len(clock.jumps) == 1


def test_a_clock_that_jumps_far_ahead_is_told_and_lets_no_timer_of_a_loop_fire(clock: Clock) -> None:
    seen: list[float] = []

    def loop() -> None:
        seen.append(clock.time.now / SECOND)
        clock.time.after(SECOND // 5, loop)

    clock.say(5)
    clock.time.after(SECOND // 5, loop)
    clock.say(2**31 - 1)
    assert (seen, clock.time.now) == ([], 5 * SECOND)
    assert [text.partition(":")[0] for text in clock.jumps] == ["/clock jumped ahead from 5.0 to 2147483647.0 s"]
    clock.say(5.1)  # what follows a forged time is a jump back
    clock.say(5.3)
    assert (seen, clock.time.now, len(clock.jumps)) == ([5.2], 5.2 * SECOND, 2)


def test_a_clock_may_say_any_time_first(clock: Clock) -> None:
    clock.say(1_700_000_000)
    assert (clock.jumps, clock.time.now) == ([], 1_700_000_000 * SECOND)


def test_what_waits_before_a_clock_is_heard_does_not_come_all_at_once(clock: Clock) -> None:
    seen: list[int] = []
    clock.time.after(SECOND, lambda: seen.append(1))
    clock.say(1_700_000_000)
    assert (seen, len(clock.jumps)) == ([], 1)
    clock.say(1_700_000_001)
    assert seen == [1]


def test_two_clocks_do_not_drive_time_on_and_are_not_told_each_time(clock: Clock) -> None:
    clock.say(100)
    for _ in range(50):
        for time in (0, 100):
            clock.time.on_clock(time * SECOND)
    assert (clock.time.now, len(clock.jumps)) == (100 * SECOND, 1)


def test_others_get_their_turn_while_much_simulated_time_is_worked_through(clock: Clock) -> None:
    order: list[str] = []

    def loop() -> None:
        order.append("timer")
        clock.time.after(SECOND // 5, loop)

    clock.say(0)
    clock.time.after(SECOND // 5, loop)
    clock.time.on_clock(10 * SECOND)
    clock.wall.soon(lambda: order.append("Ctrl-C"))
    clock.wall.run(clock.wall.now)
    assert (order.index("Ctrl-C") < 20, order.count("timer"), clock.time.now) == (True, 50, 10 * SECOND)


# ---- who makes it ----------------------------------------------------------------------------------------------------


class Place:
    """A world on a wall clock that is simulated itself, and somebody who listens."""

    def __init__(self, **options: Any) -> None:
        self.wall: Any = Scheduler()
        self.middleware = LocalMiddleware(self.wall)
        self.node: Node = self.middleware.node("me")
        self.clock: list[int] = []
        self.states: list[dict[str, Any]] = []
        self.node.subscription(CLOCK, CLOCK_TYPE, lambda said: self.clock.append(nanoseconds(said.clock)), CLOCK_QOS)
        self.node.subscription(WORLD_STATE, TEXT, lambda said: self.states.append(json.loads(said.data)))
        self.part = WorldNode(world_config(CAR), 0, self.wall, self.middleware, **options)

    def wait(self, seconds: float) -> None:
        self.wall.run(self.wall.now + round(seconds * SECOND))

    def ask(self, service: str) -> None:
        answers: list[Any] = []
        self.node.client(service, EMPTY).call(None, answers.append)
        self.wait(0)
        assert len(answers) == 1


@pytest.fixture
def place() -> Iterator[Callable[..., Place]]:
    made: list[Place] = []

    def make(**options: Any) -> Place:
        made.append(Place(**options))
        return made[-1]

    yield make
    for one in made:
        one.part.close()


@pytest.mark.parametrize("speed", [0.5, 1.0, 4.0])
def test_a_world_goes_so_many_times_as_fast_as_reality_step_by_step(place: Callable[..., Place], speed: float) -> None:
    here = place(speed=speed)
    here.wait(2)
    assert here.clock == sorted(set(here.clock))
    assert here.clock[0] == 0
    assert here.clock[-1] == pytest.approx(2 * speed * SECOND, rel=0.02)
    assert here.part.time.now == here.clock[-1]


def test_a_paused_world_stands_still_and_goes_on_where_it_was(place: Callable[..., Place]) -> None:
    here = place()
    here.node.publisher("/REX/cmd_vel", "geometry_msgs/msg/Twist").publish(
        create("geometry_msgs/msg/Twist", {"linear": {"x": 0.2}})
    )
    here.wait(0.5)
    here.ask(PAUSE)
    stopped, pose = here.part.time.now, here.part._world.robots["REX"].pose
    here.wait(60)
    assert (here.part.time.now, here.part._world.robots["REX"].pose) == (stopped, pose)
    assert (here.states[-1]["paused"], here.clock[-1]) == (True, stopped)
    here.ask(PAUSE)
    here.ask(RESUME)
    here.wait(1)
    assert here.part.time.now == pytest.approx(stopped + SECOND, rel=0.02)
    assert here.states[-1]["paused"] is False


def test_a_world_may_begin_paused(place: Callable[..., Place]) -> None:
    here = place(paused=True)
    here.wait(10)
    assert set(here.clock) == {0}
    here.ask(RESUME)
    here.ask(RESUME)
    here.wait(1)
    assert here.clock[-1] == pytest.approx(SECOND, rel=0.02)


@pytest.mark.parametrize("paused", [False, True])
def test_who_comes_to_a_world_in_which_nothing_moves_gets_its_robots(place: Callable[..., Place], paused: bool) -> None:
    here = place(paused=paused)
    scenes: list[list[Any]] = []
    for number in range(2):  # somebody else may listen already
        here.wait(5)
        found = list[Any]()
        here.middleware.node(f"view{number}").subscription(WORLD_SCENE, TEXT, found.append)
        scenes.append(found)
    here.wait(10)
    heard = [len(found) for found in scenes]
    assert {dict(scene_values(json.loads(said.data)))["REX"]["x"] for found in scenes for said in found} == {1}
    here.wait(10)
    assert [len(found) for found in scenes] == heard  # and no more, once they have it


def test_an_engine_on_the_clock_of_a_fast_world_waits_in_its_time(place: Callable[..., Place]) -> None:
    here = place(speed=10.0)
    time = ClockFollower(here.wall)
    time.subscribe(here.middleware.node("time", "REX"))
    text = process(
        '<startEvent id="s"/><scriptTask id="t"><script>await sleep(3)</script></scriptTask>'
        '<intermediateCatchEvent id="c"><timerEventDefinition><timeDuration>PT4S</timeDuration></timerEventDefinition>'
        '</intermediateCatchEvent><sequenceFlow id="f" sourceRef="s" targetRef="t"/>'
        '<sequenceFlow id="g" sourceRef="t" targetRef="c"/>'
    )
    definitions = read_text(text, file="wait.bpmn")
    ended: list[int] = []
    robot = RobotNode(
        "REX",
        make_mission(definitions, definitions.processes[0]),
        scheduler=time,
        middleware=here.middleware,
        options=RobotOptions(on_end=lambda instance: ended.append(time.now)),
    )
    robot.load()
    here.wait(0.01)
    begun = time.now
    robot.start()
    here.wait(1)
    robot.close()
    assert ended == [begun + 7 * SECOND]


# ---- from the command line -------------------------------------------------------------------------------------------


@pytest.mark.processes
@pytest.mark.dds
@needs("cyclonedds")
def test_a_world_in_another_process_is_paused_and_let_go(tmp_path: Path) -> None:
    (tmp_path / "world.yaml").write_text(json.dumps(CAR))
    environment = os.environ | {"ROS_DOMAIN_ID": str(DOMAIN), "PYTHONPATH": str(Path(__file__).parents[1])}
    fame = [sys.executable, "-m", "fame"]
    here, said = dds_world(apart=False), list[int]()
    here.node("me").subscription(CLOCK, CLOCK_TYPE, lambda message: said.append(nanoseconds(message.clock)), CLOCK_QOS)
    world = subprocess.Popen([*fame, "world", str(tmp_path / "world.yaml"), "--pause"], env=environment)
    try:
        here.until(lambda: said)
        assert subprocess.run([*fame, "resume"], env=environment, timeout=60, check=False).returncode == 0
        here.until(lambda: said[-1] > 0)
        assert subprocess.run([*fame, "pause"], env=environment, timeout=60, check=False).returncode == 0
        here.until(lambda: said[-3:] == [said[-1]] * 3)  # time is said again and again, and is the same
    finally:
        world.send_signal(signal.SIGINT)
        world.wait(20)
        here.close()


@pytest.mark.processes
@pytest.mark.dds
@needs("cyclonedds")
def test_an_engine_outlives_a_forged_clock_says_so_and_ends_by_ctrl_c() -> None:
    text = process(
        '<startEvent id="s"/><scriptTask id="t"><script>while True:\n    await sleep(0.2)</script></scriptTask>'
        '<sequenceFlow id="f" sourceRef="s" targetRef="t"/>'
    )
    environment = os.environ | {"ROS_DOMAIN_ID": str(DOMAIN), "PYTHONPATH": str(Path(__file__).parents[1])}
    here, reports = dds_world(apart=False), list[dict[str, Any]]()
    node = here.node("world")
    clock = node.publisher(CLOCK, CLOCK_TYPE, CLOCK_QOS)
    node.subscription("/P/bpmn_status", TEXT, lambda said: reports.append(json.loads(said.data)))
    model = node.publisher("/P/bpmn_process", TEXT)
    command = [sys.executable, "-m", "fame", "engine", "P", "--use-sim-time"]
    engine = subprocess.Popen(command, env=environment, stderr=subprocess.PIPE)
    try:
        here.connect(CLOCK, "/P/bpmn_process", "/P/bpmn_status")
        clock.publish(clock_message(SECOND))
        here.until(lambda: reports and reports[-1]["now"] == 1)
        model.publish(create(TEXT, text))
        here.until(lambda: reports[-1]["instances"] == 1)
        clock.publish(clock_message((2**31 - 1) * SECOND))
        here.until(lambda: any("/clock jumped ahead" in warning for warning in reports[-1]["warnings"]))
        engine.send_signal(signal.SIGINT)
        _, err = engine.communicate(timeout=20)
        assert (engine.returncode, b"/clock jumped ahead from 1.0 to 2147483647.0 s" in err) == (0, True)
    finally:
        engine.kill()
        engine.wait()
        here.close()


def test_without_a_world_there_is_nothing_to_pause(capsys: pytest.CaptureFixture[str], monkeypatch: Any) -> None:
    pytest.importorskip("cyclonedds")
    monkeypatch.setattr("fame.cli.worlds._PATIENCE", 0.1)
    monkeypatch.setenv("ROS_DOMAIN_ID", str(DOMAIN))
    assert main(["pause"]) == 1
    assert "fame world WORLD.yaml" in capsys.readouterr().err


def test_speed_is_for_many_processes(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "examples/ground_vehicles.yaml", "--speed", "3"]) == 2
    error = capsys.readouterr().err
    assert "--view, or --middleware" in error
    assert "--real-time" in error
