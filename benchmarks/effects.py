"""Count what five robots do before, during and after a migration, a suspension and a take-over: nothing twice.

    python benchmarks/effects.py --middleware dds --runs 3
    python benchmarks/effects.py --middleware ros --runs 3

The second needs a sourced ROS 2 with tests/ros_workspace, as `make test-ros` builds it. Each robot has an engine in a
process of its own, with a state on the disk, and three loops: a script that publishes velocities, goals of an action,
calls of a service. This process serves them, and counts. Something is done twice if

- two velocities of a robot are closer than its script waits between them (by the robot's own clock);
- a goal or a request comes while the one before is neither answered nor cancelled, a second later.

Between the end of `fame suspend` (of a take-over) and `fame continue`, nothing may be done at all. Only this machine's
loopback is needed: best in a network namespace of its own. Exit code 1 if anything was done twice, or an engine died.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "tests"), str(ROOT)]

from action_server import DRIVE  # noqa: E402
from bpmn_text import document, properties  # noqa: E402

from fame.clock import SECOND  # noqa: E402
from fame.middleware.actions import ActionServer, ServerGoal  # noqa: E402
from fame.middleware.interface import DeferredResponse  # noqa: E402
from fame.scenario.process import connect, scheduler_for  # noqa: E402

ROBOTS = [f"R{number}" for number in range(1, 6)]
PERIOD, WORK = 0.2, 0.5
"""Time between two velocities of a script, and that a goal or a request takes (s)."""
GRACE = 1.0
"""Time in which a cancellation may arrive after what follows it, and the last effect after `fame suspend` (s)."""


def team(version: int) -> str:
    """The collaboration: the versions differ in a variable that each script sets."""
    pools = "".join(f'<participant id="P{robot}" name="{robot}" processRef="{robot}"/>' for robot in ROBOTS)
    processes = "".join(_process(robot, version) for robot in ROBOTS)
    return document(f'<collaboration id="C">{pools}</collaboration>{processes}')


def _process(robot: str, version: int) -> str:
    drives = (
        f"version = {version}\nwhile True:\n    robot.publish('cmd_vel', 'geometry_msgs/msg/Twist', "
        f"linear={{'x': 0.5, 'y': robot.now}})\n    await sleep({PERIOD})"
    )
    goal = properties(action="drive", type=DRIVE, payload="{distance: 1}")
    call = properties(service="blade", type="std_srvs/srv/SetBool", payload="{data: true}")
    flows = [("s", "fork"), ("fork", "drive")]
    nodes = [f'<scriptTask id="drive{robot}"><script>{drives}</script></scriptTask>']
    for name, task in (("goal", goal), ("call", call)):
        nodes.append(f'<exclusiveGateway id="{name}again{robot}"/><serviceTask id="{name}{robot}">{task}</serviceTask>')
        flows += [("fork", f"{name}again"), (f"{name}again", name), (name, f"{name}again")]
    arrows = "".join(
        f'<sequenceFlow id="f{number}{robot}" sourceRef="{source}{robot}" targetRef="{target}{robot}"/>'
        for number, (source, target) in enumerate(flows)
    )
    inside = f'<startEvent id="s{robot}"/><parallelGateway id="fork{robot}"/>{"".join(nodes)}{arrows}'
    return f'<process id="{robot}" isExecutable="true">{inside}</process>'


@dataclass
class Effect:
    """A velocity, goal or request of a robot: when it came and ended (s). `stamp`: when the robot sent it."""

    robot: str
    kind: str
    begun: float
    ended: float | None = None
    stamp: float = 0.0


@dataclass
class Counted:
    """What has been done, and by phase (of one robot, or of all) when it began and ended (s)."""

    effects: list[Effect] = field(default_factory=list)
    phases: list[tuple[str, str, float, float]] = field(default_factory=list)

    def twice(self) -> list[str]:
        """What was done twice, as text."""
        found = []
        for robot in ROBOTS:
            own = [one for one in self.effects if one.robot == robot]
            stamps = sorted(one.stamp for one in own if one.kind == "velocity")
            close = [(one, other) for one, other in pairwise(stamps) if other - one < 0.95 * PERIOD]
            found += [f"{robot}: velocities at {one:.3f} and {other:.3f} s" for one, other in close]
            for kind in ("goal", "call"):
                series = [one for one in own if one.kind == kind]
                for one, other in pairwise(series):
                    if one.ended is None or one.ended > other.begun + GRACE:
                        found.append(f"{robot}: {kind} of {other.begun:.2f} s beside that of {one.begun:.2f} s")
        return found

    def while_held(self) -> list[str]:
        """What was done while its robot was suspended or taken over, as text."""
        return [
            f"{one.robot}: {one.kind} at {one.begun:.2f} s, held ({name}) from {begun:.2f} to {ended:.2f} s"
            for name, robot, begun, ended in self.phases if name in ("suspended", "taken over")
            for one in self.effects if one.robot == robot and begun + GRACE < one.begun < ended
        ]  # fmt: skip

    def table(self) -> str:
        rows = []
        for name, robot, begun, ended in self.phases:
            inside = Counter(one.kind for one in self.effects if one.robot == robot and begun <= one.begun < ended)
            counts = "  ".join(f"{inside[kind]:4} {kind}" for kind in ("velocity", "goal", "call"))
            rows.append(f"  {name:12} {robot} {ended - begun:5.1f} s {counts}")
        return "\n".join(rows)


class Servers:
    """The other ends of all robots, in this process."""

    def __init__(self, backend: str) -> None:
        self.counted, self.scheduler = Counted(), scheduler_for(backend)
        self.middleware = connect(backend, self.scheduler)
        self._ends = [self._serve(robot) for robot in ROBOTS]

    @property
    def now(self) -> float:
        return self.scheduler.now / SECOND

    def _serve(self, robot: str) -> Any:
        node = self.middleware.node("servers", robot)
        node.subscription("cmd_vel", "geometry_msgs/msg/Twist", partial(self._on_velocity, robot))
        node.service("blade", "std_srvs/srv/SetBool", partial(self._on_call, robot))
        goals: dict[bytes, Effect] = {}
        return ActionServer(node, "drive", DRIVE, partial(self._on_goal, robot, goals), partial(self._on_cancel, goals))

    def _note(self, robot: str, kind: str, stamp: float = 0.0) -> Effect:
        self.counted.effects.append(made := Effect(robot, kind, self.now, stamp=stamp))
        return made

    def _on_velocity(self, robot: str, message: Any) -> None:
        if message.linear.x:  # that of the safe state is 0
            self._note(robot, "velocity", message.linear.y)

    def _on_goal(self, robot: str, goals: dict[bytes, Effect], goal: ServerGoal) -> None:
        goals[goal.id] = self._note(robot, "goal")
        self.scheduler.after(round(WORK * SECOND), lambda: self._end(goals, goal, "succeeded"))

    def _on_cancel(self, goals: dict[bytes, Effect], goal: ServerGoal) -> None:
        self._end(goals, goal, "canceled")

    def _end(self, goals: dict[bytes, Effect], goal: ServerGoal, outcome: Any) -> None:
        if (effect := goals.pop(goal.id, None)) is not None:
            effect.ended = self.now
            goal.end(outcome, {"driven": 1.0})

    def _on_call(self, robot: str, request: Any) -> DeferredResponse:
        effect, response = self._note(robot, "call"), DeferredResponse()

        def answer() -> None:
            effect.ended = self.now
            response.respond({"success": True, "message": ""})

        self.scheduler.after(round(WORK * SECOND), answer)
        return response

    def run(self, seconds: float) -> None:
        self.scheduler.run(self.scheduler.now + round(seconds * SECOND))

    def until(self, condition: Callable[[], object], what: str, seconds: float = 60) -> None:
        end = self.now + seconds
        while not condition():
            if self.now > end:
                raise SystemExit(f"{what}: not within {seconds:g} s")
            self.run(0.05)


class Show:
    """Servers, engines and commands of one run."""

    def __init__(self, backend: str, folder: Path) -> None:
        self.backend, self.folder, self.servers = backend, folder, Servers(backend)
        (folder / "fame.yaml").write_text(f"types: [{ROOT / 'tests/ros_workspace'}]\n")
        for version in (1, 2):
            (folder / f"team{version}.bpmn").write_text(team(version))
        self.environment = os.environ | {"PYTHONPATH": os.pathsep.join((str(ROOT), os.environ.get("PYTHONPATH", "")))}
        self.engines = {robot: self._engine(robot) for robot in ROBOTS}

    def _fame(self, *words: str) -> list[str]:
        return [sys.executable, "-m", "fame", *words, "--middleware", self.backend]

    def _engine(self, robot: str) -> subprocess.Popen[bytes]:
        words = self._fame("engine", robot, "--type", "car", "--insecure", "--state", str(self.folder / robot))
        with (self.folder / f"{robot}.log").open("ab") as log:
            return subprocess.Popen(words, cwd=self.folder, env=self.environment, stdout=log, stderr=log)

    def command(self, *words: str) -> str:
        """Run a command while the servers serve. Returns what it says; raises SystemExit if it fails."""
        with self._started(*words) as process:
            self.servers.until(lambda: process.poll() is not None, f"fame {' '.join(words)}", 90)
            said = process.stdout.read().decode() if process.stdout else ""
        if process.returncode:
            raise SystemExit(f"fame {' '.join(words)}: exit code {process.returncode}\n{said}")
        return said

    @contextmanager
    def _started(self, *words: str) -> Iterator[subprocess.Popen[bytes]]:
        process = subprocess.Popen(
            self._fame(*words), cwd=self.folder, env=self.environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
        )
        try:
            yield process
        finally:
            process.kill()
            process.wait()

    @contextmanager
    def phase(self, name: str, robots: list[str] = ROBOTS) -> Iterator[None]:
        begun = self.servers.now
        yield
        self.servers.counted.phases += [(name, robot, begun, self.servers.now) for robot in robots]

    def play(self) -> None:
        """Deploy, migrate, suspend, continue, take over, give back."""
        run = self.servers.run
        self.command("deploy", "team1.bpmn", "--wait", "60")
        with self.phase("before"):
            run(5)
        with self.phase("migration"):
            self.command("deploy", "team2.bpmn", "--migrate", "--force", "--wait", "30")
        with self.phase("migrated"):
            run(5)
        for robot in ROBOTS:
            self.command("suspend", robot)
        with self.phase("suspended"):
            run(5)
        for robot in ROBOTS:
            self.command("continue", robot)
        with self.phase("continued"):
            run(4)
        with self._started("take-over", "R2") as taking:
            self.servers.until(lambda: "steers it" in self.command("status", "--why", "R2"), "R2 is taken over")
            with self.phase("taken over", ["R2"]):
                run(5)
            taking.terminate()
            self.servers.until(lambda: taking.poll() is not None, "the end of the take-over")
        self.command("continue", "R2")
        with self.phase("given back"):
            run(4)

    def dead(self) -> list[str]:
        """The engines that have ended by themselves, with the end of their logs."""
        return [
            f"{robot} died with exit code {engine.returncode}:\n{(self.folder / f'{robot}.log').read_text()[-1500:]}"
            for robot, engine in self.engines.items() if engine.poll() is not None
        ]  # fmt: skip

    def close(self) -> None:
        for engine in self.engines.values():
            engine.terminate()
        for engine in self.engines.values():
            engine.wait(30)
        self.servers.middleware.close()


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--middleware", choices=("dds", "zenoh", "ros"), default="dds")
    parser.add_argument("--runs", type=int, default=1)
    arguments, wrong = parser.parse_args(), 0
    for number in range(1, arguments.runs + 1):
        with tempfile.TemporaryDirectory() as folder:
            show = Show(arguments.middleware, Path(folder))
            try:
                show.play()
            finally:
                dead = show.dead()
                show.close()
                print(*dead, sep="\n")
            counted = show.servers.counted
            found = [*counted.twice(), *counted.while_held(), *dead]
            wrong += len(found)
            counts = f"{len(counted.twice())} twice, {len(counted.while_held())} while held, {len(dead)} engines dead"
            print(f"run {number} over {arguments.middleware}: {len(counted.effects)} effects, {counts}")
            print(counted.table(), *found, sep="\n", flush=True)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
