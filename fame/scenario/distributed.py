"""A scenario in many processes: starts the world and one engine per robot, deploys to them, monitors and ends them.

A Ctrl-C in the terminal does not reach the child processes: `DistributedTeam` ends them in order. If the parent process
is killed, its children notice it and end too (`fame.scenario.process.orphaned`).
"""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from fame.check.gate import refuse_errors
from fame.clock import SECOND, Entry, Kind, Scheduler, WallScheduler, date_text
from fame.dataclasses import dataclass
from fame.deploy import STATUS_QOS, STRING, Deployment, Report
from fame.deploy.authentication import GONE, ReportReader
from fame.deploy.options import DeploymentOptions
from fame.deploy.requests import TaskClient, TaskRequest
from fame.deploy.signing import new_run_key, read_private, write_public
from fame.middleware import messages, qos
from fame.middleware.interface import LATCHED, Middleware, Publisher
from fame.middleware.simulated_time import ClockFollower
from fame.middleware.wire_base import load_of_machine
from fame.robot.events import Event
from fame.scenario.plan import Completion, OutsideSignal, published_from_outside
from fame.scenario.process import (
    PARENT,
    ScriptWarning,
    connect,
    decode_line,
    event_text,
    scheduler_for,
    signals_call,
)
from fame.scenario.quiescence import QuiescenceDetector
from fame.scenario.result import (
    Result,
    RobotResult,
    Status,
    TeamStatus,
    alike,
    at_rest,
    is_over,
    never_started,
    reported_result,
    status_of,
)
from fame.scenario.world_process import EMPTY, RESUME, WORLD_STATE
from fame.text import read_json

if TYPE_CHECKING:
    from fame.scenario.plan import Plan
    from fame.scenario.team_logs import TeamLogs


_CHECK = SECOND // 5  # ns between two checks of the processes
RESTARTS = 3
"""Maximum number of restarts of an engine that keeps its mission."""
_SETTLED = SECOND // 2
"""A team whose robots say for as long that nothing runs has ended: a message on its way would have started something
(ns)."""
_SILENT = 5 * SECOND
"""A robot without a report for as long is not known to have ended (ns)."""
_DISCOVERY = 45.0  # s until all engines must have been discovered; a machine with much to do starts them slowly


@dataclass(frozen=True, slots=True, kw_only=True)
class TeamOptions:
    """Options of the processes of a `DistributedTeam`.

    speed     of the world, times wall-clock speed (1 by default; in `lockstep` as fast as possible)
    lockstep  the world waits for the engines
    types     folders of message types, besides those of the scenario
    state     folder in which each engine keeps its mission: one that dies is started again, at most `RESTARTS` times
    key       file of a secret key: the engines run what is signed with it, so that the team can be redeployed
    """

    speed: float | None = None
    lockstep: bool = False
    types: Sequence[Path] = ()
    state: Path | None = None
    key: Path | None = None


class DistributedTeam:
    """A scenario in many processes: the world, and one engine per robot. They start and end together.

    The engines run only models signed with a key of this run.

    `on_status` is called with the status of the team several times a second, `on_line` with each line that a process
    prints. `logs` record the team. Raises ModelError for errors of the model before anything is started.
    """

    scenario: Plan
    backend: str

    def __init__(
        self,
        scenario: Plan,
        backend: str,
        options: TeamOptions | None = None,
        *,
        on_status: Callable[[TeamStatus], object] = lambda status: None,
        on_line: Callable[[str, str], object] = lambda name, line: None,
        logs: TeamLogs | None = None,
    ) -> None:
        refuse_errors(scenario.definitions, scenario.processes(), scenario.library)
        self.scenario, self.backend, self._on_status, self._on_line = scenario, backend, on_status, on_line
        self._options = options = options or TeamOptions()
        self._key = read_private(options.key) if options.key is not None else None
        self._lines: dict[str, list[str]] = {}
        self._restarts: dict[str, int] = {}
        self.scheduler: WallScheduler = scheduler_for(backend)
        self.middleware: Middleware = connect(backend, self.scheduler)
        self._recorder = logs.recorder(self.middleware, self.scheduler) if logs is not None else None
        self.reports: dict[str, Report] = {}
        self._arrivals: dict[str, int] = {}  # when the last report of each robot came
        self._quiescence = QuiescenceDetector(_SETTLED)
        self.world: Mapping[str, Any] | None = None
        self._children = Subprocesses(lambda name, line: self.scheduler.soon(lambda: self._on_output(name, line)))
        self._status: Status | None = None  # overrides the status that follows from the reports
        self._problems: list[str] = []
        self._events: list[Event] = []
        self._told: set[object] = set()
        self._pids: dict[str, int] = {}
        self._deployment: Deployment | None = None
        self._deploying: Entry | None = None
        self._ends_with_next_state = False
        self._over = False
        self._until = math.inf  # s, when the duration is over
        self._overdue: int | None = None  # since when it is, while it is not known whether the mission has ended

    def run(self) -> Result:
        """Start all processes, deploy, wait until no process instance runs or the duration is over, end all."""
        begun = time.monotonic()
        with signals_call(self._interrupt):  # to the end: a second Ctrl-C would leave children behind
            try:
                with TemporaryDirectory(prefix="fame-") as folder:
                    self._start(Path(folder) / "run.pub")
                    self._listen()
                    self._check()
                    self.scheduler.after(round(_DISCOVERY * SECOND), self._expect_all, Kind.TIMER)
                    self.scheduler.run()
            finally:
                status = self._status
                self._problems += self._children.end()
                if self._recorder is not None:
                    self._recorder.close()
                self.middleware.close()
                self._status = status
        return self._result(time.monotonic() - begun)

    def _result(self, wall: float) -> Result:
        robots = self._robots()
        unstarted = () if self._problems else never_started(self.scenario.cast, robots)
        status = self._status or status_of(robots, unstarted)
        return Result(
            status=status,
            seed=self.scenario.seed,
            robots=robots,
            simulated=max(0.0, self._time - self._began),
            wall=wall,
            reports=tuple(self._events),
            ending="not over" if status == "timeout" else "",
            world=self.world,
            epoch=self.scenario.epoch,
            never_started=unstarted,
            problems=tuple(self._problems),
        )

    @property
    def _began(self) -> float:
        """Mission time (s) when the robots were started."""
        return self._until - self.scenario.duration

    def _robots(self) -> tuple[RobotResult, ...]:
        """The result of each robot so far, from its last report."""
        return tuple(reported_result(robot, self.reports.get(robot)) for robot in self.scenario.cast)

    def _on_output(self, name: str, line: str) -> None:
        decoded = decode_line(line)
        if isinstance(decoded, Event):
            self._events.append(decoded)
            if (key := alike(decoded)) in self._told:
                return
            self._told |= {key} if key is not None else set()
            line = event_text(decoded)
        elif decoded is not None:
            line = str(self._in_own_files(name, decoded))
        self._on_line(name, line)

    def _in_own_files(self, robot: str, warning: ScriptWarning) -> ScriptWarning:
        """A warning with its place in the files of the mission, not in the part that the robot was sent."""
        if self._deployment is None or robot not in self._deployment.robots:
            return warning
        file, line = self._deployment.source_map(robot).place(warning.file, warning.line)
        return ScriptWarning(file, line, warning.text)

    def _interrupt(self, *_: object) -> None:
        self._status = "interrupted"
        self.scheduler.stop()

    def _fail(self, *problems: str) -> None:
        self._status = "failed"
        self._problems += problems
        self.scheduler.stop()

    def _start(self, trust: Path) -> None:
        self._key = write_public(self._key, trust) if self._key is not None else new_run_key(trust)
        self._lines = command_lines(self.scenario, self.backend, self._options, trust)
        for name, line in self._lines.items():
            self._children.start(name, [*line, "--fresh"] if "--state" in line else line)
            self._pids[name] = self._children.pid(name)

    def _check(self) -> None:
        """Report the status; end the run if a process has ended or the duration is over."""
        ended = self._children.ended()
        lost = [text for name, text in ended.items() if not self._restart(name, text)]
        if lost:
            self._fail(*lost)
            return
        self._on_status(TeamStatus(self._time, self.reports, self._pids))
        if self._time >= self._until and not self._over and not self._is_to_be_confirmed():
            self._expire()
        else:
            self.scheduler.after(_CHECK, self._check, Kind.TIMER)

    def _is_to_be_confirmed(self) -> bool:
        """Whether nothing runs by the last reports, and newer ones will tell whether that is so."""
        now, robots = self.scheduler.now, self._robots()
        self._overdue = overdue = now if self._overdue is None else self._overdue
        older = any(arrival < overdue for arrival in self._arrivals.values())
        return at_rest(robots) and (older or self._seems_over(robots)) and now - overdue < _SILENT

    def _expire(self) -> None:
        """End the run: its duration is over."""
        now = self.scheduler.now
        silent = {robot: now - arrival for robot, arrival in self._arrivals.items() if now - arrival >= _SILENT}
        unknown = "its engine has been silent for {:.0f} s: it is not known what it does"
        if silent:
            self._fail(*(f"{robot}: {unknown.format(time / SECOND)}" for robot, time in silent.items()))
            return
        if self._seems_over(self._robots()):
            self._status = "timeout"
        self.scheduler.stop()

    def _restart(self, name: str, text: str) -> bool:
        """Start an engine again that keeps its mission. Returns whether it could be."""
        if self._options.state is None:
            return False
        if name == "world":
            self._problems.append("the world has no journal, so the run cannot be resumed")
            return False
        self._restarts[name] = self._restarts.get(name, 0) + 1
        if self._restarts[name] > RESTARTS or self._deployment is None or not self._deployment.done:
            return False
        self._on_line(name, f"{text}; it is started again ({self._restarts[name]} of {RESTARTS})")
        self._children.start(name, self._lines[name])
        self._pids[name] = self._children.pid(name)
        return True

    @property
    def _time(self) -> float:
        """Mission time (s): that of the world, if there is one."""
        return float(self.world["time"]) if self.world is not None else self.scheduler.now / SECOND

    def _listen(self) -> None:
        node = self.middleware.node("_fame_team")
        for robot in self.scenario.cast:
            node.subscription(
                f"/{robot}/bpmn_status", STRING, partial(self._on_report, self._reader(robot)), STATUS_QOS
            )
        node.subscription(WORLD_STATE, STRING, self._on_world_state, LATCHED)
        self._resume_world = node.client(RESUME, EMPTY)
        self._node = node
        self._senders = [
            (node.publisher(sent.topic, sent.type, qos.parse(sent.qos)), sent) for sent in self.scenario.signals
        ]
        self._due = len(self._senders)
        self._clock: Scheduler = self.scheduler
        if self.scenario.world is not None and (self._senders or self.scenario.completions):
            self._clock = follower = ClockFollower(self.scheduler)
            follower.subscribe(node)

    def _reader(self, robot: str) -> ReportReader:
        """Reads reports of an engine; one that is started again has another key."""
        patience = GONE if self._options.state is not None else math.inf
        return ReportReader(robot, signed=True, patience=patience)

    def _on_world_state(self, message: Any) -> None:
        with suppress(ValueError, TypeError, KeyError):
            state = read_json(message.data)
            float(state["time"])
            self.world = state
            if self._ends_with_next_state:
                self.scheduler.stop()

    def _on_report(self, reader: ReportReader, message: Any) -> None:
        report = reader.read(message.data, self.scheduler.now / SECOND)
        if report is None:
            return
        robot = reader.robot
        self._arrivals[robot] = self.scheduler.now
        self.reports[robot] = report if self._deployment is None else self._deployment.source_map(robot).report(report)
        if self._deployment is None and len(self.reports) == len(self.scenario.cast) and self._world_is_there():
            self._deploy_when_recorded()
        elif self._deployment is not None and self._deployment.done and not self._deployment.failed:
            self._check_over()

    def _world_is_there(self) -> bool:
        return self.scenario.world is None or self.world is not None

    def _deploy_when_recorded(self) -> None:
        """Deploy as soon as nothing of it is missed by the recording, by which properties are judged."""
        if self._recorder is None or self._recorder.team.listens(self.scenario.cast):
            self._deploy()
        elif self._deploying is None:
            self._deploying = self.scheduler.after(SECOND // 20, self._deploy_again, Kind.TIMER)

    def _deploy_again(self) -> None:
        self._deploying = None
        if self._deployment is None:
            self._deploy_when_recorded()

    def _deploy(self) -> None:
        self._deployment = Deployment(
            self.scenario.definitions,
            id=f"run-{os.getpid()}",
            sequence=1,
            scheduler=self.scheduler,
            middleware=self.middleware,
            ended=self._deployed,
            options=DeploymentOptions(
                robots=[*self.scenario.cast], library=self.scenario.library, load=load_of_machine, key=self._key
            ),
        )
        self._deployment.begin()

    def _deployed(self, deployment: Deployment) -> None:
        if deployment.failed:
            self._fail(*map(str, deployment.robots.values()))
            return
        self._until = self._time + self.scenario.duration
        for robot, pool in self.scenario.cast.items():
            self._on_line(robot, f"{robot} runs {pool.process.name or pool.process.id} in process {self._pids[robot]}")
        for done in self.scenario.completions:
            self._clock.after(round(done.time * SECOND), partial(self._complete, done))
        for publisher, sent in self._senders:
            self._clock.after(round(sent.time * SECOND), partial(self._publish, publisher, sent))
        if self._options.lockstep and self.scenario.world is not None:
            self._resume_world.call(None, lambda response: None)

    def _complete(self, done: Completion) -> None:
        """Complete a task in the place of a person, and report the robot's answer."""
        client: TaskClient
        request = TaskRequest(
            id=f"scenario-{os.getpid()}-{self.scenario.completions.index(done)}",
            element=done.element,
            values=done.values,
            who="the scenario",
        )

        def answered(report: Report) -> None:
            client.close()
            refused = report.answer == "refused"
            text = f"could not be completed by a person: {report.reason}" if refused else "completed by a person"
            self._report(done.robot, done.element, text)

        client = TaskClient(
            done.robot, request, node=self._node, scheduler=self.scheduler, answered=answered, key=self._key
        )

    def _publish(self, publisher: Publisher, sent: OutsideSignal, tries: int = 50) -> None:
        """Publish a signal in the place of somebody outside, as soon as somebody has subscribed."""
        if publisher.subscriber_count() == 0 and tries:
            self.scheduler.after(SECOND // 50, partial(self._publish, publisher, sent, tries - 1), Kind.TIMER)
            return
        lost = "" if publisher.subscriber_count() else "; it has no subscribers"
        publisher.publish(messages.create(sent.type, sent.payload))
        self._due -= 1
        self._report("", "", published_from_outside(sent) + lost)

    def _report(self, robot: str, element: str, text: str) -> None:
        event = Event(round((self._time - self._began) * SECOND), robot, 0, 0, element, "report", text)
        self._events.append(event)
        self._on_line(robot or "outside", event_text(event))

    def _check_over(self) -> None:
        """End the run if all robots confirm that the mission is over: the last messages may still be in flight."""
        if self._over:
            return
        robots = self._robots()
        done = sum(robot.instances + robot.elements for robot in robots) if self._seems_over(robots) else None
        self._over = self._quiescence.look(self._arrivals, done, self.scheduler.now)
        if not self._over:
            return
        if self.scenario.world is None:
            self.scheduler.stop()
        else:  # with the next state of the world, in which robots have come to rest
            self._ends_with_next_state = True
            self.scheduler.after(SECOND, self.scheduler.stop, Kind.TIMER)

    def _seems_over(self, robots: Sequence[RobotResult]) -> bool:
        return not self._due and is_over(robots)

    def _expect_all(self) -> None:
        missing = [robot for robot in self.scenario.cast if robot not in self.reports]
        if missing or not self._world_is_there():
            names = ", ".join([*missing, *([] if self._world_is_there() else ["the world"])])
            self._fail(f"{names} did not appear within {_DISCOVERY:g} s")


ENDING = 5.0
"""Maximum time for a process to end (s)."""


class Subprocesses:
    """Child processes by name. `on_line` gets the name and each line of stderr, in reader threads."""

    def __init__(self, on_line: Callable[[str, str], object]) -> None:
        self._on_line = on_line
        self._processes: dict[str, subprocess.Popen[str]] = {}
        self._threads: list[threading.Thread] = []
        self.last: dict[str, str] = {}

    def start(self, name: str, arguments: Sequence[str]) -> None:
        """Start ``fame`` with command-line arguments."""
        root = Path(__file__).resolve().parents[2]
        paths = [str(root), *filter(None, [os.environ.get("PYTHONPATH")])]
        process = subprocess.Popen(
            [sys.executable, "-m", "fame", *arguments, "--no-project"],
            env={**os.environ, "PYTHONPATH": os.pathsep.join(paths), PARENT: str(os.getpid())},
            stdin=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
            start_new_session=True,
        )
        self._processes[name] = process
        self.last.pop(name, None)
        thread = threading.Thread(target=self._listen, args=(name, process), daemon=True)
        self._threads.append(thread)
        thread.start()

    def pid(self, name: str) -> int:
        return self._processes[name].pid

    def ended(self) -> dict[str, str]:
        """Return a line with name and cause for each process that has ended, by name."""
        return {
            name: f"{name} {_cause(code)}" + (f": {self.last[name]}" if name in self.last else "")
            for name, process in self._processes.items()
            if (code := process.poll()) is not None
        }

    def end(self) -> list[str]:
        """End all processes and wait for them. Return a line for each that had to be killed."""
        for process in self._processes.values():
            with suppress(ProcessLookupError):
                process.send_signal(signal.SIGINT)
        until, stubborn = time.monotonic() + ENDING, []
        for name, process in self._processes.items():
            try:
                process.wait(max(0.1, until - time.monotonic()))
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
                stubborn.append(f"{name} did not end by itself within {ENDING:g} s")
        for thread in self._threads:
            thread.join()
        return stubborn

    def _listen(self, name: str, process: subprocess.Popen[str]) -> None:
        assert process.stderr is not None
        with process.stderr as lines:
            for line in lines:
                decoded = decode_line(line)
                if not isinstance(decoded, Event):  # what the robot does is no reason why its engine has ended
                    self.last[name] = str(decoded or line).strip()
                self._on_line(name, line.rstrip())


def command_lines(scenario: Plan, backend: str, options: TeamOptions, trust: Path) -> dict[str, list[str]]:
    """Return the arguments of ``fame`` for each process of a scenario: the world, and one engine per robot.

    `trust` is the file of the public key that the engines trust.
    """
    from sim2d.robot import absolute

    lines: dict[str, list[str]] = {}
    types, lockstep = (*options.types, *scenario.types), options.lockstep
    folders = [argument for folder in types for argument in ("--types", str(folder.resolve()))]
    tail = ["--middleware", backend]
    kinds: dict[str, str] = {}
    time: list[str] = []
    if scenario.world is not None:
        pace = ["--speed", str(options.speed)] if options.speed is not None else []
        waits = ["--pause", *(part for robot in scenario.cast for part in ("--lockstep", robot))] if lockstep else []
        lines["world"] = ["world", scenario.file, "--seed", str(scenario.seed), *pace, *waits, *tail]
        folder = Path(scenario.world.source.file).parent
        kinds = {robot.name: absolute(robot.type, folder) for robot in scenario.world.robots}
        time = ["--lockstep" if lockstep else "--use-sim-time"]
    files = ["--files", str(Path(scenario.definitions.file).resolve().parent)]
    for robot in scenario.cast:
        kind = ["--type", kinds[robot]] if robot in kinds else []
        keeps = ["--state", str(options.state / robot)] if options.state is not None else []
        own = ["--trust", str(trust), "--unsigned-tasks", *kind, *files, *keeps, "--epoch", date_text(scenario.epoch)]
        lines[robot] = ["engine", robot, "--seed", str(scenario.seed), *own, *time, *folders, *tail]
    return lines


def _cause(code: int) -> str:
    if code < 0:
        return f"was killed by {signal.Signals(-code).name}"
    return f"ended with exit code {code}"
