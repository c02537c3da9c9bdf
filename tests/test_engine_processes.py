"""An engine in a process of its own, on each middleware: it gets its process, runs it, says so, leaves.

Within rclpy, `fame run` of the example missions too; over DDS that is in `test_processes` and `test_lockstep`.
"""

import fcntl
import importlib.util
import json
import os
import pty
import re
import signal
import subprocess
import sys
import termios
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from bpmn_text import document
from middleware_contract import DOMAIN, needs

from fame.clock import SECOND, WallScheduler
from fame.scenario.process import scheduler_for, serve

ROOT = Path(__file__).parent.parent
ENVIRONMENT = os.environ | {"ROS_DOMAIN_ID": str(DOMAIN), "PYTHONPATH": os.pathsep.join((str(ROOT), *sys.path))}
MODEL = document(
    '<collaboration id="C"><participant id="A" name="REX" processRef="p"/></collaboration>'
    '<process id="p"><startEvent id="s"/><sequenceFlow id="f" sourceRef="s" targetRef="wait"/><userTask id="wait"/>'
    '<sequenceFlow id="g" sourceRef="wait" targetRef="e"/><endEvent id="e"/></process>'
)


@pytest.fixture(
    params=[
        pytest.param("dds", marks=[needs("cyclonedds"), pytest.mark.dds]),
        pytest.param("zenoh", marks=[needs("zenoh"), pytest.mark.zenoh]),
        pytest.param("ros", marks=[needs("rclpy"), pytest.mark.ros]),
    ]
)
def middleware(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def fame(*words: str) -> list[str]:
    return [sys.executable, "-m", "fame", *words]


def told(*words: str) -> str:
    """What a command says that succeeds."""
    done = subprocess.run(fame(*words), env=ENVIRONMENT, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done
    return done.stdout


@pytest.fixture
def engine(middleware: str) -> Iterator[subprocess.Popen[str]]:
    words = fame("engine", "REX", "--insecure", "--middleware", middleware)
    process = subprocess.Popen(words, env=ENVIRONMENT, stderr=subprocess.PIPE, text=True)
    yield process
    process.kill()
    process.communicate()


@pytest.mark.processes
def test_an_engine_gets_its_process_waits_goes_on_and_leaves(
    middleware: str, engine: subprocess.Popen[str], tmp_path: Path
) -> None:
    (tmp_path / "wait.bpmn").write_text(MODEL)
    over = ("--middleware", middleware)
    told("deploy", str(tmp_path / "wait.bpmn"), "--wait", "30", *over)
    robots = json.loads(told("status", "REX", "--json", *over))["robots"]
    assert list(robots) == ["REX"]
    assert '"wait"' in json.dumps(robots)
    told("complete", "REX", "wait", *over)
    engine.send_signal(signal.SIGINT)
    assert engine.wait(timeout=60) == 0


DRIVES = document(
    '<collaboration id="C"><participant id="A" name="REX" processRef="p"/></collaboration>'
    '<process id="p"><startEvent id="s"/><sequenceFlow id="f" sourceRef="s" targetRef="t"/><scriptTask id="t"><script>'
    "while True:\n    robot.publish('cmd_vel', 'geometry_msgs/msg/Twist', linear={'x': 0.5})\n"
    "    print('drives')\n    await sleep(0.05)"
    "</script></scriptTask></process>"
)


ENDING = (signal.SIGHUP, signal.SIGINT, signal.SIGQUIT, signal.SIGTERM)


@needs("cyclonedds")
@pytest.mark.dds
@pytest.mark.processes
@pytest.mark.parametrize("ending", ["the terminal", *ENDING, "nohup"])
def test_an_engine_that_is_ended_brings_its_robot_to_the_safe_state(ending: str | int, tmp_path: Path) -> None:
    """Also if its terminal is gone; an engine that ignores SIGHUP drives on without its terminal."""
    from fame.middleware.dds import DdsMiddleware

    (tmp_path / "drives.bpmn").write_text(DRIVES)
    terminal, end = pty.openpty()

    def in_terminal() -> None:
        fcntl.ioctl(end, termios.TIOCSCTTY, 0)
        for number in ENDING:  # whoever runs the tests may ignore them
            signal.signal(number, signal.SIG_DFL)
        if ending == "nohup":
            signal.signal(signal.SIGHUP, signal.SIG_IGN)

    words = fame("engine", "REX", "--insecure", "--type", "car")
    engine = subprocess.Popen(
        words,
        env=ENVIRONMENT,
        stdin=end,
        stdout=end,
        stderr=end,
        start_new_session=True,
        preexec_fn=in_terminal,  # noqa: PLW1509 (a system call and no lock)
    )
    os.close(end)
    scheduler = scheduler_for("dds")
    middleware = DdsMiddleware(scheduler, domain=DOMAIN)
    speeds: list[float] = []
    middleware.node("base").subscription(
        "/REX/cmd_vel", "geometry_msgs/msg/Twist", lambda message: speeds.append(message.linear.x)
    )

    def run_until(condition: Callable[[], object]) -> None:
        deadline = time.monotonic() + 60
        while not condition():
            assert time.monotonic() < deadline, speeds[-3:]
            scheduler.run(scheduler.now + SECOND // 50)

    try:
        told("deploy", str(tmp_path / "drives.bpmn"), "--wait", "30")
        run_until(lambda: speeds[-3:] == [0.5] * 3)
        if ending in ("the terminal", "nohup"):
            os.close(terminal)
        if ending == "nohup":
            seen = len(speeds)
            run_until(lambda: len(speeds) > seen + 20)
        if ending != "the terminal":
            engine.send_signal(signal.SIGTERM if ending == "nohup" else ending)
        run_until(lambda: engine.poll() is not None)
        scheduler.run(scheduler.now + SECOND // 2)  # what it has said before it ended
        assert (engine.returncode, speeds[-1]) == (0, 0.0)
    finally:
        engine.kill()
        engine.wait()
        middleware.close()
        with suppress(OSError):
            os.close(terminal)


class Fragile:
    """A component that fails whenever it is asked to stop."""

    def __init__(self, scheduler: WallScheduler) -> None:
        self.closed = False
        scheduler.soon(self.stop)

    def stop(self) -> bool:
        raise ZeroDivisionError("the main loop")

    def close(self) -> None:
        self.closed = True


@needs("cyclonedds")
@pytest.mark.dds
def test_an_error_of_the_main_loop_closes_the_component_nevertheless_and_leaves_its_traceback(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", str(DOMAIN))
    made: list[Fragile] = []

    def build(scheduler: WallScheduler, middleware: object) -> Fragile:
        made.append(Fragile(scheduler))
        return made[0]

    former = signal.getsignal(signal.SIGHUP)
    with pytest.raises(ZeroDivisionError):
        serve("dds", None, build)
    assert (made[0].closed, signal.getsignal(signal.SIGHUP)) == (True, former)
    said = capsys.readouterr().err.splitlines()
    assert (said[0], said[-1]) == ("Traceback (most recent call last):", "ZeroDivisionError: the main loop")
    assert any("in stop" in line for line in said)


DIAGRAM = """
import sys
from fame.deploy.splitter_node import DIAGRAM
from fame.middleware.messages import create
from fame.scenario.process import connect, scheduler_for
scheduler = scheduler_for(sys.argv[1])
middleware = connect(sys.argv[1], scheduler)
publisher = middleware.node("modeler").publisher(DIAGRAM, "std_msgs/msg/String")
assert middleware.wait_matched([DIAGRAM], 20) == []
publisher.publish(create("std_msgs/msg/String", open(sys.argv[2]).read()))
scheduler.run(scheduler.now + 500_000_000)
middleware.close()
"""
"""Publishes a file for the splitter."""


@pytest.mark.processes
def test_a_splitter_deploys_the_diagram_that_is_published(
    middleware: str, engine: subprocess.Popen[str], tmp_path: Path
) -> None:
    (tmp_path / "wait.bpmn").write_text(MODEL)
    over = ("--middleware", middleware)
    words = fame("splitter", "--insecure", *over)
    splitter = subprocess.Popen(words, env=ENVIRONMENT, stderr=subprocess.DEVNULL)
    try:
        publish = [sys.executable, "-c", DIAGRAM, middleware, str(tmp_path / "wait.bpmn")]
        subprocess.run(publish, env=ENVIRONMENT, timeout=60, check=True)
        deadline = time.monotonic() + 60
        while '"wait"' not in told("status", "REX", "--json", *over):
            assert time.monotonic() < deadline
        told("complete", "REX", "wait", *over)
    finally:
        splitter.kill()
        splitter.wait()


def refused(*words: str) -> str:
    """What a command says that fails."""
    done = subprocess.run(fame(*words), env=ENVIRONMENT, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 1, done
    return done.stdout + done.stderr


@pytest.mark.processes
def test_an_engine_with_keys_runs_only_what_is_signed(middleware: str, tmp_path: Path) -> None:
    (tmp_path / "wait.bpmn").write_text(MODEL)
    over = ("--middleware", middleware)
    told("keys", "new", str(tmp_path / "team"))
    words = fame("engine", "REX", "--trust", str(tmp_path / "team.pub"), *over)
    engine = subprocess.Popen(words, env=ENVIRONMENT, stderr=subprocess.DEVNULL)
    try:
        assert "not signed" in refused("deploy", str(tmp_path / "wait.bpmn"), "--wait", "30", *over)
        told("deploy", str(tmp_path / "wait.bpmn"), "--wait", "30", "--key", str(tmp_path / "team.key"), *over)
        assert '"wait"' in told("status", "REX", "--json", "--trust", str(tmp_path / "team.pub"), *over)
    finally:
        engine.kill()
        engine.wait()


@pytest.mark.processes
def test_a_process_that_replaces_another_is_recorded_and_nobody_warns(
    middleware: str, engine: subprocess.Popen[str], tmp_path: Path
) -> None:
    (tmp_path / "wait.bpmn").write_text(MODEL)
    file, over = tmp_path / "team.mcap", ("--middleware", middleware)
    recorder = subprocess.Popen(
        fame("log", "record", "-o", str(file), *over), env=ENVIRONMENT, stderr=subprocess.PIPE, text=True
    )
    try:
        assert recorder.stderr is not None
        recorder.stderr.readline()  # it is there
        for _ in range(2):
            told("deploy", str(tmp_path / "wait.bpmn"), "--wait", "30", *over)
        told("complete", "REX", "wait", *over)
        told("status", "REX", *over)
    finally:
        recorder.send_signal(signal.SIGINT)
        recorder.communicate(timeout=60)
    engine.send_signal(signal.SIGINT)
    _, said = engine.communicate(timeout=60)
    assert "already registered" not in said
    told("log", "convert", str(file), "-o", str(tmp_path / "team.csv"))
    events = (tmp_path / "team.csv").read_text()
    assert "REX" in events
    assert "wait" in events


def run(example: str, *words: str) -> tuple[str, str]:
    """What `fame run` of an example says on ROS, on stdout and stderr."""
    command = fame("run", f"examples/{example}.yaml", "--middleware", "ros", *words)
    done = subprocess.run(command, env=ENVIRONMENT, cwd=ROOT, capture_output=True, text=True, timeout=180, check=False)
    return done.stdout, done.stderr


@pytest.mark.ros
@needs("rclpy")
def test_the_ground_vehicles_complete_their_mission_on_ros() -> None:
    out, err = run("ground_vehicles", "--speed", "2")  # slow machines follow: the world does not wait for its robots
    assert re.search(r"REX +1 +\d+ +completed\nDINGO +1 +\d+ +completed\n\ncompleted: ", out), (out, err)


@pytest.mark.ros
@needs("rclpy")
def test_drone_and_tractors_work_on_ros_where_the_type_of_a_service_is_missing() -> None:
    out, err = run("agriculture", "--duration", "60", "--speed", "3")
    assert re.search(r"Drone +1 +\d+ +running\n(Tractor_. .*\n)*Tractor_. +[1-9] ", out), (out, err)
    assert "fame: not over after " in err
    left_out = {"tello_msgs": "Drone offers no service tello_action", "tf2_msgs": "Drone publishes no transforms"}
    for package, said in left_out.items():
        assert (f"{said}: {package}/" in err) == (importlib.util.find_spec(package) is None), err


# ---- several engines by one command ----------------------------------------------------------------------------------

ROBOTS = ("R_1", "R_2", "R_3")


@pytest.fixture
def engines(middleware: str) -> Iterator[subprocess.Popen[str]]:
    words = fame("engine", *ROBOTS, "--insecure", "--middleware", middleware)
    process = subprocess.Popen(words, env=ENVIRONMENT, stderr=subprocess.PIPE, text=True, process_group=0)
    yield process
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.communicate()


def children(process: subprocess.Popen[str]) -> list[int]:
    return [int(pid) for pid in Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()]


def lives(pid: int) -> bool:
    with suppress(OSError):
        return "\nState:\tZ" not in Path(f"/proc/{pid}/status").read_text()
    return False


def status(middleware: str) -> dict[str, str]:
    found = json.loads(told("status", *ROBOTS, "--json", "--middleware", middleware))
    return {robot: report["state"] for robot, report in found["robots"].items()}


@pytest.mark.processes
def test_several_engines_of_one_command_are_robots_like_any_and_leave_together(
    middleware: str, engines: subprocess.Popen[str]
) -> None:
    said = {engines.stderr.readline().split()[0] for _ in ROBOTS}  # type: ignore[union-attr]
    assert said == set(ROBOTS)
    assert status(middleware) == dict.fromkeys(ROBOTS, "waiting")
    assert len(children(engines)) == len(ROBOTS)
    engines.send_signal(signal.SIGINT)
    _, errors = engines.communicate(timeout=60)
    assert (engines.returncode, errors) == (0, "")


@pytest.mark.processes
def test_of_several_engines_one_may_be_killed_and_the_others_end_with_what_started_them(
    middleware: str, engines: subprocess.Popen[str]
) -> None:
    for _ in ROBOTS:
        engines.stderr.readline()  # type: ignore[union-attr]
    first, *others = children(engines)
    os.kill(first, signal.SIGKILL)
    while len(children(engines)) == len(ROBOTS):
        time.sleep(0.1)
    assert all(map(lives, others))
    engines.kill()
    deadline = time.monotonic() + 60
    while any(map(lives, others)) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not any(map(lives, others))


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["A", "A"], "named twice: A"),
        (["A", "B", "--state", "state"], "--state belongs to one robot: start each engine by its own command"),
        (["A", "B", "--trust", "x.pub", "--identity", "a.key"], "--identity belongs to one robot: start each engine"),
        (["A", "1B"], "expected ASCII letters, digits and _, a letter first, got '1B'"),
    ],
)
def test_what_several_engines_cannot_be(words: list[str], complaint: str) -> None:
    done = subprocess.run(fame("engine", *words), env=ENVIRONMENT, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert complaint in done.stderr
