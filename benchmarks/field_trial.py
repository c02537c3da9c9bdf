"""Five robots for half an hour over a link that loses 5 % of its packets: what was done twice, what was lost unsaid?

    python -m benchmarks.field_trial --minutes 30 --seed 1

Two machines (network namespaces), three robots on one, two on the other with the base, and between them a link that
loses and delays. Each robot drives to numbered poses (fake Nav2 on its machine), throws an acknowledged signal of each
that it has reached, and for each that it catches calls a service of the base, which notes it (`retry` = `never`: what
may have been done is not done again, but said by a second call). Engines with a state on the disk are killed with
``kill -9`` and started again at moments that the seed draws; after a third of the time the mission is migrated, after
two thirds it is rolled back (``fame deploy --previous``). At the end no goal ends any more, and all settles. Wrong is

- a pose that was reached twice, or two goals of a robot at once; a signal that was noted twice;
- a number that was left out: its goal was not reached, or its signal was not noted, and neither the logs of the engines
  nor the base say so. (A robot that the rollback stops may be busy with one signal: that ends with its mission.)

With ``--middleware ros`` engines use rclpy, and the other ends are of rclpy alone; its message packages are built first
(a sourced ROS 2, its Python: ``. /opt/ros/jazzy/setup.sh; .venv-ros/bin/python -m benchmarks.field_trial ...``).

One JSON object; exit code 1 if anything is wrong. Root: it makes the namespaces itself.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from random import Random
from typing import Any, TextIO

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "tests"), str(ROOT)]

from bpmn_text import document, properties  # noqa: E402
from networked_machines import ADDRESSES, INTERFACE, Machines, machines  # noqa: E402

from fame.clock import SECOND  # noqa: E402
from fame.middleware import messages  # noqa: E402
from fame.middleware.actions import ActionServer, ServerGoal  # noqa: E402
from fame.middleware.interface import Node  # noqa: E402
from fame.scenario.process import Router, connect, scheduler_for  # noqa: E402

ROBOTS = {"R1": 0, "R2": 0, "R3": 1, "R4": 1, "R5": 1}
"""The machine of each."""
NAVIGATE, NOTE = "nav2_msgs/action/NavigateToPose", "trial_msgs/srv/Note"
HERE = "127.0.0.1"
"""Where a router of Zenoh is, one on each machine."""
DRIVE, DELAY = 1.0, 0.05
"""How long a goal takes, and a packet on the link (s)."""
DOWN, UP = (0.0, 15.0), (10.0, 40.0)
"""Bounds of how long an engine is down, and of the time to the next kill (s); leases end after 10 s."""
_LOST = re.compile(
    r"has not acknowledged (?:number \d+|(\d+) of the numbers)|: (\d+) acknowledged signals were (?:not taken|dropped)"
)
"""What engines report of signals."""
SETTLING, PATIENCE = 75.0, 120.0
"""For what is still on its way at the end; for a deployment (s)."""


# ---- the mission -----------------------------------------------------------------------------------------------------


def team(version: int) -> str:
    """The collaboration: its versions say who they are in each signal."""
    pools = "".join(f'<participant id="P{robot}" name="{robot}" processRef="{robot}"/>' for robot in ROBOTS)
    signals = "".join(f'<signal id="S{robot}" name="reached_{robot}"/>' for robot in ROBOTS)
    processes = "".join(_process(robot, version) for robot in ROBOTS)
    return document(f'{signals}<collaboration id="C">{pools}</collaboration>{processes}')


def _process(robot: str, version: int) -> str:
    names = list(ROBOTS)
    other = names[names.index(robot) - 1]
    pose = "{pose: {header: {frame_id: map}, pose: {position: {x: ${n}, y: ${run}}}}}"
    goal = properties(action="navigate_to_pose", type=NAVIGATE, payload=pose, retry="never")
    throw = properties(type="std_msgs/msg/String", payload="${text}", delivery="acknowledged")
    note = properties(service="/note", type=NOTE, payload="{robot: ${name}, text: ${seen}}", retry="never")
    lost = properties(service="/note", type=NOTE, payload="{robot: ${name}, text: ${lost}}", retry="safe")
    nodes = f"""<startEvent id="s"/><scriptTask id="zero"><script>
n, name, run = 0, '{robot}', round(robot.now, 3)</script></scriptTask><parallelGateway id="fork"/>
<exclusiveGateway id="more"/><scriptTask id="next"><script>n = n + 1</script></scriptTask>
<serviceTask id="go" name="Go">{goal}</serviceTask><boundaryEvent id="failed" attachedToRef="go"><errorEventDefinition/>
</boundaryEvent><scriptTask id="told"><script>text = '%s %.3f %d v{version}' % (name, run, n)</script></scriptTask>
<intermediateThrowEvent id="throw">{throw}<signalEventDefinition signalRef="S{robot}"/></intermediateThrowEvent>
<exclusiveGateway id="again"/><intermediateCatchEvent id="hear">{properties(queue="100")}
<signalEventDefinition signalRef="S{other}"/></intermediateCatchEvent>
<scriptTask id="seen"><script>
seen, lost = reached_{other}, 'lost ' + reached_{other}</script></scriptTask>
<serviceTask id="note" name="Note">{note}</serviceTask><boundaryEvent id="doubtful" attachedToRef="note">
<errorEventDefinition/></boundaryEvent><serviceTask id="say" name="Say">{lost}</serviceTask>
<boundaryEvent id="unsaid" attachedToRef="say"><errorEventDefinition/></boundaryEvent>"""
    flows = "s zero fork more next go told throw more|fork again hear seen note again|failed more|doubtful say again"
    flows += "|unsaid say"
    arrows = [pair for line in flows.split("|") for pair in zip(line.split(), line.split()[1:], strict=False)]
    drawn = "".join(
        f'<sequenceFlow id="f{number}" sourceRef="{source}" targetRef="{target}"/>'
        for number, (source, target) in enumerate(arrows)
    )
    own = re.sub(r'(id|sourceRef|targetRef|attachedToRef)="', rf'\1="{robot}_', nodes + drawn)
    return f'<process id="{robot}" isExecutable="true">{own}</process>'


# ---- the other ends --------------------------------------------------------------------------------------------------


class Servers:
    """Nav2 of the robots of a machine, and at the base the service that notes. Each effect is a line of a file."""

    def __init__(self, backend: str, place: int, file: TextIO) -> None:
        self.scheduler, self.file, self.holding = scheduler_for(backend), file, False
        self.middleware = connect(backend, self.scheduler, Router(HERE) if backend == "zenoh" else INTERFACE)
        self._ends = [self._nav2(robot) for robot, home in ROBOTS.items() if home == place]
        if place == 0:
            self._service = self.middleware.node("base").service("/note", NOTE, self._note)

    def _nav2(self, robot: str) -> ActionServer:
        goals: dict[bytes, tuple[float, int]] = {}
        node: Node = self.middleware.node("nav2", robot)
        begin, cancel = partial(self._begin, robot, goals), partial(self._end, robot, goals, outcome="canceled")
        return ActionServer(node, "navigate_to_pose", NAVIGATE, begin, cancel)

    def _write(self, *words: Any) -> None:
        print(json.dumps([round(time.time(), 2), *words]), file=self.file, flush=True)

    def _begin(self, robot: str, goals: dict[bytes, tuple[float, int]], goal: ServerGoal) -> None:
        at = goal.message.pose.pose.position
        goals[goal.id] = at.y, round(at.x)
        self._write("begun", robot, *goals[goal.id], len(goals))
        if not self.holding:
            self.scheduler.after(round(DRIVE * SECOND), lambda: self._end(robot, goals, goal))

    def _end(self, robot: str, goals: dict[bytes, Any], goal: ServerGoal, outcome: Any = "succeeded") -> None:
        if (number := goals.pop(goal.id, None)) is not None:
            self._write(outcome, robot, *number)
            goal.end(outcome, {})

    def _note(self, request: Any) -> dict[str, Any]:
        self._write("noted", request.robot, request.text)
        return {}

    def spin(self) -> None:
        """Run for a second."""
        self.scheduler.run(self.scheduler.now + SECOND)


class RosServers:
    """The same of rclpy, without FAME: its action servers and its service."""

    def __init__(self, place: int, file: TextIO) -> None:
        import rclpy
        from nav2_msgs.action import NavigateToPose
        from rclpy.action import ActionServer, CancelResponse
        from rclpy.callback_groups import ReentrantCallbackGroup
        from rclpy.executors import MultiThreadedExecutor
        from trial_msgs.srv import Note

        rclpy.init()
        self.file, self.holding, self._lock, self._result = file, False, threading.Lock(), NavigateToPose.Result
        self._executor = MultiThreadedExecutor(16)
        for robot, home in ROBOTS.items():
            if home == place:
                node, group = rclpy.create_node("nav2", namespace=robot), ReentrantCallbackGroup()
                accept = {"cancel_callback": lambda _: CancelResponse.ACCEPT, "callback_group": group}
                execute = partial(self._execute, robot, Counter())
                node.end = ActionServer(node, NavigateToPose, "navigate_to_pose", execute, **accept)
                self._executor.add_node(node)
        if place == 0:
            base = rclpy.create_node("base")
            base.create_service(Note, "/note", self._note)
            self._executor.add_node(base)

    def _write(self, *words: Any) -> None:
        with self._lock:
            print(json.dumps([round(time.time(), 2), *words]), file=self.file, flush=True)

    def _execute(self, robot: str, active: Counter[str], goal: Any) -> Any:
        """Drive, in a thread of its own."""
        at, end = goal.request.pose.pose.position, time.monotonic() + DRIVE
        active[robot] += 1
        self._write("begun", robot, at.y, round(at.x), active[robot])
        while not goal.is_cancel_requested and (self.holding or time.monotonic() < end):
            time.sleep(0.02)
        outcome = "canceled" if goal.is_cancel_requested else "succeeded"
        active[robot] -= 1
        self._write(outcome, robot, at.y, round(at.x))
        (goal.canceled if goal.is_cancel_requested else goal.succeed)()
        return self._result()

    def _note(self, request: Any, response: Any) -> Any:
        self._write("noted", request.robot, request.text)
        return response

    def spin(self) -> None:
        """Run for a second."""
        self._executor.spin_once(1.0)


def serve(backend: str, place: str, folder: str) -> None:
    """The process of the other ends on a machine; SIGUSR1: goals do not end any more."""
    messages.register_files(Path(folder) / "types")
    with (Path(folder) / f"effects{place}.jsonl").open("a") as file:
        servers = RosServers(int(place), file) if backend == "ros" else Servers(backend, int(place), file)
        signal.signal(signal.SIGUSR1, lambda *_: setattr(servers, "holding", True))
        print("ready", flush=True)
        while os.getppid() != 1:
            servers.spin()


NAV2 = ROOT / "fame/middleware/interfaces/share/nav2_msgs"
PACKAGES = {"nav2_msgs": "action/NavigateToPose.action", "trial_msgs": "srv/Note.srv"}
"""The packages of ROS that the trial needs, and what of each."""


def build(folder: Path) -> None:
    """Build the message packages for rclpy, and source them for the processes that are started from now on."""
    needed = "geometry_msgs", "builtin_interfaces"
    found = "".join(
        f"find_package({name} REQUIRED)\n" for name in ("ament_cmake", "rosidl_default_generators", *needed)
    )
    depends = "".join(f"<depend>{name}</depend>" for name in ("action_msgs", *needed))
    install = folder / "install"
    for package, file in PACKAGES.items():
        source, made = folder / "source" / package, folder / "build" / package
        shutil.copytree((NAV2 if package == "nav2_msgs" else folder / "types" / package), source)
        head = f"cmake_minimum_required(VERSION 3.16)\nproject({package})"
        generate = f"rosidl_generate_interfaces({package} {file} DEPENDENCIES {' '.join(needed)})"
        (source / "CMakeLists.txt").write_text(f"{head}\n{found}{generate}\nament_package()\n")
        (source / "package.xml").write_text(
            f'<package format="3"><name>{package}</name><version>0.1.0</version><description>-</description>'
            '<maintainer email="fame@users.noreply.github.com">-</maintainer><license>Apache-2.0</license>'
            f"<buildtool_depend>ament_cmake</buildtool_depend>{depends}"
            "<member_of_group>rosidl_interface_packages</member_of_group></package>"
        )
        configure = ["-S", source, "-B", made, f"-DCMAKE_INSTALL_PREFIX={install}"]
        for words in (configure, ["--build", made, "--target", "install"]):
            subprocess.run(["cmake", *map(str, words)], check=True, stdout=subprocess.DEVNULL)
    modules = next(install.rglob("trial_msgs/srv/__init__.py")).parents[2]
    for name, path in {"AMENT_PREFIX_PATH": install, "LD_LIBRARY_PATH": install / "lib", "PYTHONPATH": modules}.items():
        os.environ[name] = f"{path}:{os.environ.get(name, '')}"
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "SUBNET"


# ---- the trial -------------------------------------------------------------------------------------------------------


class Trial:
    """Engines and commands of one run."""

    def __init__(self, backend: str, pair: Machines, folder: Path, seed: int) -> None:
        self.backend, self.pair, self.folder, self.random = backend, pair, folder, Random(seed)
        self.did: list[str] = []
        self.began = time.monotonic()
        types = folder / "types" / "trial_msgs" / "srv"
        types.mkdir(parents=True)
        (types / "Note.srv").write_text("string robot\nstring text\n---\n")
        for version in (1, 2):
            (folder / f"team{version}.bpmn").write_text(team(version))
        if backend == "ros":
            build(folder)
        self.engines = {robot: self._engine(robot) for robot in ROBOTS}

    def _fame(self, place: int, *words: str) -> list[str]:
        reach = ["--router", HERE] if self.backend == "zenoh" else ["--network", INTERFACE]
        network = ["--middleware", self.backend, *reach]
        return self.pair.inside(place, sys.executable, "-m", "fame", *words, *network)

    def _engine(self, robot: str) -> subprocess.Popen[bytes]:
        words = ["engine", robot, "--insecure", "--types", str(self.folder / "types"), "--state"]
        with (self.folder / f"{robot}.log").open("ab") as log:
            command = self._fame(ROBOTS[robot], *words, str(self.folder / robot))
            return subprocess.Popen(command, cwd=ROOT, stdout=log, stderr=log)

    def say(self, text: str) -> None:
        """Note what happens, with the second at which it does."""
        self.did.append(f"{time.monotonic() - self.began:7.1f} s  {text}")
        print(self.did[-1], file=sys.stderr, flush=True)

    def deploy(self, *words: str) -> None:
        """Deploy until it succeeds: a robot that is down at that moment is a refusal that is said."""
        end = time.monotonic() + PATIENCE
        command = self._fame(0, "deploy", *words, "--types", str(self.folder / "types"), "--wait", "30")
        while True:
            ran = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
            self.say(f"deploy {' '.join(words)}: exit code {ran.returncode} {(ran.stdout + ran.stderr).strip()[-400:]}")
            if ran.returncode == 0:
                return
            if time.monotonic() > end or ran.returncode == 2:
                raise SystemExit(f"{' '.join(words)}: not within {PATIENCE:g} s:\n{ran.stdout}{ran.stderr}")

    def kill(self) -> None:
        """Kill an engine, and start it again after a while."""
        robot, down = self.random.choice(list(ROBOTS)), self.random.uniform(*DOWN)
        self.engines[robot].kill()
        self.engines[robot].wait()
        self.say(f"kill -9 {robot}, down for {down:.1f} s")
        time.sleep(down)
        self.engines[robot] = self._engine(robot)

    def play(self, seconds: float) -> None:
        """Deploy, and kill until the end; migrate and roll back between."""
        self.deploy(str(self.folder / "team1.bpmn"))
        begun, done = time.monotonic(), list[str]()
        planned = [(1 / 3, [str(self.folder / "team2.bpmn"), "--migrate", "--force"]), (2 / 3, ["--previous"])]
        while (now := time.monotonic() - begun) < seconds:
            if planned and now >= planned[0][0] * seconds:
                self.deploy(*planned.pop(0)[1])
            time.sleep(min(self.random.uniform(*UP), max(0.0, seconds - (time.monotonic() - begun))))
            self.kill()
            done += [robot for robot, engine in self.engines.items() if engine.poll() is not None]
            for robot in done:
                raise SystemExit(f"{robot} has ended: {(self.folder / f'{robot}.log').read_text()[-2000:]}")

    def close(self) -> None:
        for engine in self.engines.values():
            engine.terminate()
        for engine in self.engines.values():
            engine.wait(60)


@contextmanager
def started(command: Sequence[str]) -> Iterator[subprocess.Popen[str]]:
    """A process that says when it is ready; it ends with the block."""
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            process.stdout.readline()
            yield process
        finally:
            process.kill()


def judged(folder: Path) -> dict[str, Any]:
    """What the files of the other ends and the logs of the engines say."""
    lines = sorted(json.loads(line) for path in folder.glob("effects*.jsonl") for line in path.open())
    goals, order = defaultdict[tuple[str, float, int], Counter[str]](Counter), dict[tuple[str, float], int]()
    noted, wrong = Counter[str](), list[str]()
    for _, what, *words in lines:
        if what == "noted":
            noted[words[1]] += 1
            continue
        robot, run, n = words[:3]
        goals[robot, run, n][what] += 1
        order[robot, run] = max(n, order.get((robot, run), 0))
        if what == "begun" and words[3] > 1:
            wrong.append(f"{robot}: goal {n} of {run:.3f} beside another one")
    wrong += [f"{goal}: reached {all['succeeded']} times" for goal, all in goals.items() if all["succeeded"] > 1]
    wrong += [f"{text}: noted {many} times" for text, many in noted.items() if many > 1 and not text.startswith("lost")]
    done = {tuple(text.split()[:3]) for text in noted if not text.startswith("lost")}
    said = {tuple(text.split()[1:4]) for text in noted if text.startswith("lost")}
    logs = {robot: (folder / f"{robot}.log").read_text() for robot in ROBOTS}
    left, missing = list[str](), list[str]()
    for (robot, run), last in order.items():
        for n in range(1, last):
            if not goals[robot, run, n]["succeeded"]:
                left.append(f"{robot} {run:.3f} {n}: {dict(goals[robot, run, n])}")
            elif (robot, f"{run:.3f}", f"{n}") not in done | said:
                missing.append(f"{robot} {run:.3f} {n}")
    told = sum(int("".join(many) or 1) for text in logs.values() for many in _LOST.findall(text))
    replaced = len(order) - len(ROBOTS)
    unknown = sum(text.count("act('navigate_to_pose'): ") for text in logs.values())
    if len(left) > unknown:
        wrong.append(f"{len(left)} goals were left out, {unknown} were reported")
    if len(missing) > told + replaced + unknown:  # a goal whose fate is unknown throws none
        wrong.append(f"{len(missing)} signals are missing, {told} were reported, {replaced} ended with a mission")
    return {
        "goals": len(goals), "reached": sum(all["succeeded"] for all in goals.values()),
        "sent_again": sum(all["begun"] > 1 for all in goals.values()),
        "not_reached": left, "noted": len(done),
        "said_to_be_lost": len(said - done), "said_and_done": len(said & done), "missing": len(missing),
        "first_missing": missing[:20],
        "reported_as_lost": told,
        "runs": len(order), "wrong": wrong,
        "logs": {robot: _repeated(text) for robot, text in logs.items()},
    }  # fmt: skip


def _repeated(text: str) -> list[str]:
    """The lines of a log, without numbers and times, each with how often it came."""
    plain = Counter(re.sub(r"\d+(\.\d+)?", "#", line).strip() for line in text.splitlines())
    return [f"{many} x {line}" for line, many in plain.most_common()]


def main() -> int:
    if sys.argv[1:2] == ["--serve"]:
        serve(*sys.argv[2:5])
        return 0
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--loss", type=float, default=0.05)
    parser.add_argument("--middleware", choices=("dds", "zenoh", "ros"), default="dds")
    parser.add_argument("--keep", type=Path, help="keep effects, logs and states in this new folder")
    given = parser.parse_args()
    with ExitStack() as stack:
        if given.keep is not None:
            given.keep.mkdir(parents=True)
        folder = (given.keep or Path(stack.enter_context(tempfile.TemporaryDirectory()))).resolve()
        pair = stack.enter_context(machines(2, wired=False))
        words = [sys.executable, "-m", "benchmarks.lossy_signals", "--link", *map(str, pair.pids)]
        stack.enter_context(started([*words, str(given.loss), str(DELAY), str(given.seed)]))
        pair.address()
        if given.middleware == "zenoh":
            router = [sys.executable, "-m", "fame", "router", "--network", INTERFACE]
            for place, others in enumerate(([], ["--connect", ADDRESSES[0]])):
                process = subprocess.Popen(pair.inside(place, *router, *others), cwd=ROOT)
                stack.callback(process.wait)
                stack.callback(process.kill)
        trial = Trial(given.middleware, pair, folder, given.seed)
        stack.callback(trial.close)
        serving = [sys.executable, "-m", "benchmarks.field_trial", "--serve", given.middleware]
        ends = [stack.enter_context(started(pair.inside(n, *serving, str(n), str(folder)))) for n in (0, 1)]
        trial.play(60 * given.minutes)
        trial.say("no goal ends any more")
        for end in ends:
            end.send_signal(signal.SIGUSR1)
        time.sleep(SETTLING)
        trial.say("end")
        found = judged(folder) | {"load": os.getloadavg(), "did": trial.did}
    print(json.dumps(vars(given) | found, indent=1, default=str))
    return 1 if found["wrong"] else 0


if __name__ == "__main__":
    sys.exit(main())
