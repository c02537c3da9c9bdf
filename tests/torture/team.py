"""A team that runs a plan: machines, engines, senders and a network, on one scheduler."""

from __future__ import annotations

import errno
import hashlib
import math
import random
import re
import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cache, partial
from pathlib import Path
from typing import Any

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from fame.bpmn import reader
from fame.bpmn.model import Definitions
from fame.clock import SECOND, Entry, Kind
from fame.deploy import Deployment, EngineNode, engines
from fame.deploy.assignment import assign_robots
from fame.deploy.authentication import Diagram
from fame.deploy.envelope import PROCESS_QOS, STRING, Envelope, Report, signed
from fame.deploy.options import DeploymentOptions, EngineOptions
from fame.deploy.requests import TaskClient, TaskRequest
from fame.deploy.robot_state import Reply
from fame.deploy.signing import Identity, _name_of, sign
from fame.deploy.splitter_node import DIAGRAM, SplitterNode
from fame.engine.repair import _tokens as tokens_of, token_at
from fame.errors import ConfigError, DeploymentError, FameError, MissionError
from fame.fleet.engine_log import EngineLog
from fame.middleware import messages
from fame.middleware.actions import ActionServer, ServerGoal
from fame.middleware.interface import DeferredResponse
from fame.monitor.pipeline.configuration import Configuration, load
from fame.monitor.pipeline.node import ProcessingNode
from fame.robot import Event, RobotNode
from fame.robot.journal import StateDirectory
from fame.scripting.cancelled_goals import BOUND

from .disks import PowerLoss
from .drawn import ASK, GOALS, Mission, accepts, durations_of, end_goal, help_needed, is_started, text_of, walk
from .fabric import LEASE, Fabric, Wire
from .missions import DRIVE, WORK, mission, text
from .plan import DESK, DISK_FAULTS, PROGRAMS, SPLITTERS, Plan, Step
from .processes import WRITING, EndlessRunError, Machine, Process, Timeline
from .states import Witness, stored

_AT_ANY_TIME = ("refused", "suspended", "noted")
"""What a robot answers to a person's request although it has promised to start something else."""
AT_ONCE = 2_000
"""How many events the missions of a team have at one instant at most."""
SEND_GOAL = "/go/_action/send_goal"
STRANGER = 66
"""The version that somebody deploys who has no key of the team."""
QUIET = 60.0
"""How long the team has after the last fault (s), if it does not come to rest before."""
REST = 6.0
"""How long nothing is under way before a team is at rest (s): longer than what is silent is waited for, and than
signals wait for those who acknowledge them."""


_CLOCKS = {"clock", "drift", "battery"}
_HELPERS = {"drives": "server", "watched": "monitor"}
"""The program beside the robots that a mission needs for what it has."""


@cache
def _monitor() -> Configuration:
    return load(Path(__file__).parent / "monitor.yaml")


@dataclass
class Said:
    """An answer of an engine to a deployment, as it gave it; `effects` of its robot's mission had left before."""

    time: float
    robot: str
    process: str
    answer: str
    deployment: str
    reason: str
    effects: int = 0


@dataclass
class Robot:
    """A robot: its machine, and the engine that runs on it now, if one does."""

    name: str
    machine: Machine
    process: Process | None = None
    wire: Wire | None = None
    engine: EngineNode | None = None
    durable: bool = False
    promised: dict[str, float] = field(default_factory=dict)  # what its process has promised to start, since when (s)
    spoilt: bool = False  # whether its state was lost, or rot
    fresh: bool = False  # whether a person has put its old state aside
    began: float = 0.0  # when its process began (s)
    continued: float = 0.0  # when it was last continued after a stop (s)
    resumes: bool = False  # whether it has not been seen since it began to resume
    excuses: list[tuple[float, str]] = field(default_factory=list)  # why what it does may be done again, since when (s)
    witness: Witness = field(default_factory=lambda: Witness(lambda text: None))


@dataclass
class Program:
    """A process beside the robots: a splitter, or the server of goals. `begin` is its program."""

    name: str
    machine: Machine
    begin: Callable[[Process, Wire], Any]
    process: Process | None = None
    wire: Wire | None = None
    node: Any = None  # what it has begun


@dataclass
class Sender:
    """`fame deploy` of a version: it looks for its robots, deploys, and ends."""

    version: int
    process: Process
    wire: Wire
    migrates: bool = False
    deployment: Deployment | None = None
    key: Any = None
    graph: object = None  # in which it has not found its robots
    ended: str = ""

    @property
    def alive(self) -> bool:
        return self.process.alive and not self.ended


@dataclass
class Team:
    """The run of a plan, recorded in the folder `log` if that is given.

    `lines` tell what happened; `said` has all answers; `problems` what must not be.
    """

    plan: Plan
    log: Path | None = None
    scheduler: Timeline = field(default_factory=Timeline)
    said: list[Said] = field(default_factory=list)
    lines: list[str] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    struck: Counter[str] = field(default_factory=Counter)
    released: set[tuple[str, str]] = field(default_factory=set)  # (robot, deployment) that a person aborted

    def __post_init__(self) -> None:
        self.fabric = Fabric(self.scheduler, self.plan.seed)
        effects = *(f"/tell_{name}" for name in self.plan.robots), SEND_GOAL, "/ask"
        self.fabric.on_published = {WORK: partial(self._on_effect, 0.0), "/tick": partial(self._check_written, "n")}
        if self.plan.mission is not None:
            self.fabric.on_published |= dict.fromkeys(effects, partial(self._on_effect, 1.0))
        self.machines = {name: Machine(name, self.scheduler, self.plan.seed) for name in (*self.plan.robots, DESK)}
        self.robots = {name: Robot(name, self.machines[name]) for name in self.plan.robots}
        for robot in self.robots.values():
            robot.witness.wrong = partial(self._is_wrong, robot)
            robot.witness.clocks_are_right = not _CLOCKS & {step.kind for step in self.plan.steps}
            robot.witness.durations = durations_of(self.plan.mission) if self.plan.mission is not None else {}
        self.more = ""  # what the missions have: see `missions.text`
        self.programs = {
            name: Program(name, Machine(name, self.scheduler, self.plan.seed), self._begin_splitter)
            for name in SPLITTERS
        }
        self.programs["server"] = Program(
            "server", Machine("server", self.scheduler, self.plan.seed), self._begin_server
        )
        self.programs["monitor"] = Program(
            "monitor", Machine("monitor", self.scheduler, self.plan.seed), self._begin_monitor
        )
        self.told: dict[str, str] = {}  # by request: what its person was told
        self.held = set[str]()  # robots that have held a deployment
        self.entered = set[str]()  # elements of missions to which a token has come
        self.goals: list[tuple[str, int]] = []  # (process of the server, count), as they were accepted
        self.expired = Counter[str]()  # signals that were not acknowledged, by receiver
        self.unserved = 0  # how often the server was not there
        self._left: dict[bytes, float] = {}  # when goals left their robots (s)
        self._begun: dict[tuple[str, bytes], float] = {}  # by process of the server and goal: the same; -1: cancelled
        self._sent: dict[tuple[str, str, int], bytes] = {}  # by process of the server, robot and number: the last goal
        self._lost: dict[bytes, float] = {}  # goals that no task waits for, since when (s)
        self.stubborn = False  # whether the server refuses to cancel goals, which then go on for long
        self.refused: dict[bytes, tuple[float, str]] = {}  # goals that it does not cancel: since when (s), whose
        self.senders: list[Sender] = []
        self.key: Ed25519PrivateKey | None = None  # of the team, if it has one
        self._numbers = Counter[str]()
        if self.plan.mission is not None:
            self._start(self.programs["server"])
        self._read: dict[int, Definitions] = {}  # versions of a drawn mission
        self._armed: list[Step] = []  # what waits for an answer
        self._recordings: list[EngineLog] = []
        self._away = 1.0  # how long a machine without power is away (s)
        self._ahead: list[Entry] = []  # what comes from outside: steps, and what ends them
        self.healed = math.inf  # when all faults have ended (s)
        self._event_at, self._at_once = 0.0, 0  # when an event of a mission was last, and how many there were then
        self._rested = 0.0  # for how long nothing has been under way (s)
        self._told = 0  # how many lines there were then

    def tells(self, robot: str) -> str:
        """The topic of the effects of a robot's mission, which are counted."""
        return "/tick" if self.plan.mission is None else f"/tell_{robot}"

    # ---- the run -----------------------------------------------------------------------------------------------------

    def run(self) -> None:
        """Carry out the plan, heal, and wait. While the team is at rest, what is next comes at once."""
        for step in self.plan.steps:
            action = partial(self._armed.append, step) if step.on else partial(self._do, step)
            self._later(step.time, action)
        self._later(self.plan.heal, self._heal)
        while self.healed == math.inf:
            self.pass_time(1)
            if self._rested >= REST and self.healed == math.inf:
                self._skip()
        self.come_to_rest(QUIET)

    def pass_time(self, seconds: float) -> None:
        """Let simulated time pass."""
        self.scheduler.run(self.scheduler.now + round(seconds * SECOND))
        self._check_refused()
        if self.plan.mission is not None:
            self._check_followed()
        for robot in self.robots.values():
            robot.witness.look(self.scheduler.now / SECOND, robot.process, robot.engine)
            if robot.resumes and robot.engine is not None and not robot.engine.resuming:
                robot.resumes = False
                self._on_moment(f"{robot.name} resumed")
            if robot.witness.held:
                robot.excuses.append((self.scheduler.now / SECOND, "cancel"))
        self._rested = self._rested + seconds if len(self.lines) == self._told and not self._is_busy() else 0.0
        self._told = len(self.lines)

    def come_to_rest(self, longest: float) -> None:
        """Let at most `longest` s pass, until nothing has been under way for `REST` s."""
        for _ in range(round(longest)):
            self.pass_time(1)
            if self._rested >= REST:
                return

    def _skip(self) -> None:
        """What is to come from outside comes sooner, all by the time that is left until the first of it."""
        waiting, self._ahead = [entry for entry in self._ahead if entry.action is not None], []
        early = min(entry.time for entry in waiting) - self.scheduler.now
        for entry in waiting:
            assert entry.action is not None
            self._at(entry.time - early, entry.action)
            entry.cancel()

    def _is_idle(self) -> bool:
        """Whether no robot has a mission."""
        return all(robot.engine is None or robot.engine.running is None for robot in self.robots.values())

    def _is_busy(self) -> bool:
        """Whether a deployment is under way, a process has not begun, or one that is away has not been forgotten.

        A robot that holds asks the others again and again: that alone is rest.
        """
        if any(sender.alive for sender in self.senders) or self.fabric.is_forgetting:
            return True
        nodes = [program.node for program in self.programs.values()]
        if any(isinstance(node, SplitterNode) and node.state == "deploying" for node in nodes):
            return True
        return any(self._is_under_way(robot.engine) for robot in self.robots.values() if robot.process is not None)

    def _is_under_way(self, engine: EngineNode | None) -> bool:
        """Whether an engine begins, loads, waits for a start, or has promised what is not known to be under way."""
        if engine is None or engine.resuming:
            return True
        state = engine._protocol.state
        if state.candidate is not None and state.candidate.asks:
            return False
        return bool(state.candidate or state.waiting or state.loading or state.promises)

    def _is_wrong(self, robot: Robot, text: str) -> None:
        self.problems.append(f"{robot.name} {text}")

    def note(self, text: str) -> None:
        """A line of the log."""
        self.lines.append(f"{self.scheduler.now / SECOND:10.6f}  {text}")

    def _do(self, step: Step) -> None:
        """Do a step; one that has no effect, since nothing is there to be struck, does not count."""
        phase = self._phase(step)
        if self._does(step):
            self.note(f"{step.kind} {step.target} {step.value}")
            self.struck[phase] += 1

    def _does(self, step: Step) -> bool:
        """Whether a step has an effect, which follows."""
        if step.kind in (*DISK_FAULTS, "removed") and not self.robots[step.target].durable:
            return False
        match step.kind:
            case "start":
                self.start(self.robots[step.target])
            case "deploy" | "migrate":
                self.deploy(step.value, migrates=step.kind == "migrate")
            case "diagram":
                self.publish_diagram(step.value)
            case "drives" | "breaks" | "acknowledges" | "watched" | "works":
                self.more = f"{self.more}{step.kind} "
                if step.kind in _HELPERS:
                    self._start(self.programs[_HELPERS[step.kind]])
            case "splitter":
                self._start(self.programs[step.target])
            case "slow disk":
                self.machines[step.target].slow_down(step.value)
            case "mute":
                self.fabric.silence(step.target)
                self._later(step.value, partial(self.fabric.silence, step.target, -1))
            case "stubborn":
                self.stubborn = True
            case "repair":
                return self.repair(self.robots[step.target], step.value)
            case "act":
                return self.act(self.robots[step.target], *step.value)
            case "suspend":
                return self.suspend(self.robots[step.target], step.value)
            case kind if kind.endswith(PROGRAMS):
                return self._strike_program(self._program(step), step.kind[:4], step.value)
            case "keys":
                self.key = self._private("team")
            case "stranger":
                self.deploy(STRANGER, key=self._private("stranger") if step.value > 2 else None)
                self.abort(self.robots[step.target], key=self._private("stranger"))
            case "directory":
                self.robots[step.target].durable = True
            case "kill" | "power" | "flip" | "erase":
                return self._strike(self.robots[step.target], step.kind, step.value)
            case "battery":
                away, back = step.value
                if not self._strike(self.robots[step.target], "kill", away):
                    return False
                self.machines[step.target].ahead -= back
            case "fuse":
                self.machines[step.target].disk.fuse, self._away = step.value
            case "full":
                self.machines[step.target].disk.room = step.value[0]
                self._later(step.value[1], partial(setattr, self.machines[step.target].disk, "room", None))
            case "read-only":
                self.machines[step.target].disk.trouble = errno.EROFS
                self._later(step.value, partial(setattr, self.machines[step.target].disk, "trouble", 0))
            case "removed":
                robot, disk = self.robots[step.target], self.machines[step.target].disk
                if disk.trouble or robot.engine is None or robot.engine.resuming or robot.engine._no_memory:
                    return False  # all that it had would be lost with it
                disk.remove_all()
                self._later(step.value, partial(setattr, disk, "trouble", 0))
            case "memory":
                robot = self.robots[step.target]
                if robot.engine is None or robot.process is None:
                    return False
                robot.process.soon(robot.engine._on_no_memory)
                robot.excuses.append((self.scheduler.now / SECOND, "crash"))
                if robot.machine.disk.removed:  # all that it had is lost with it
                    robot.spoilt = True
                    robot.promised.clear()
                    self.released |= {(one.robot, one.deployment) for one in self.said if one.robot == robot.name}
            case "stop":
                process = self.robots[step.target].process
                if process is None or process.stopped:
                    return False
                self._stop(process, step.value)
            case "cut":
                one, other = step.target.split()
                self.fabric.cut(one, other)
                self._later(step.value, partial(self.fabric.cut, one, other, heal=True))
            case "loss" | "twice":
                setattr(self.fabric, step.kind, step.value[0])
                self._later(step.value[1], partial(setattr, self.fabric, step.kind, 0.0))
            case "delay":
                self.fabric.delay = step.value[0]
                self._later(step.value[1], partial(setattr, self.fabric, "delay", 0.002))
            case "match":
                return self._drop_matches(self.robots[step.target])
            case "clock":
                self.machines[step.target].ahead += step.value
            case "drift":
                self.machines[step.target].change_drift(step.value)
            case "kill sender" | "stop sender":
                sender = next((one for one in reversed(self.senders) if one.alive), None)
                if sender is None:
                    return False
                if step.kind == "kill sender":
                    self.fabric.leave(sender.wire)
                else:
                    self._stop(sender.process, step.value)
            case _:
                raise ValueError(step.kind)
        return True

    def _phase(self, step: Step) -> str:
        """A kind of fault or act, and in which phase of a deployment it strikes its robot (or the newest sender)."""
        if step.target in self.robots:
            kind = step.kind if step.kind != "act" else step.value[0]
            return f"{kind} / {self._stage(self.robots[step.target].engine)}"
        if step.kind.endswith(PROGRAMS):
            return f"{step.kind} / {'absent' if self._program(step).process is None else 'running'}"
        running = [one.deployment for one in self.senders if one.alive and one.deployment is not None]
        return f"{step.kind} / {running[-1]._protocol.state.phase if running else 'nothing under way'}"

    def _stage(self, engine: EngineNode | None) -> str:
        """How far an engine is."""
        if engine is None:
            return "absent"
        if engine.resuming:
            return "resuming"
        candidate = engine._protocol.state.candidate
        return engine.state if candidate is None else "holding" if candidate.holds else candidate.stage

    def _program(self, step: Step) -> Program:
        """What a step strikes beside the robots."""
        return self.programs[step.target or step.kind.partition(" ")[2]]

    def _later(self, seconds: float, action: Callable[[], object]) -> None:
        self._at(self.scheduler.now + round(seconds * SECOND), action)

    def _at(self, time: int, action: Callable[[], object]) -> None:
        """Do what comes from outside at a time (ns)."""
        self._ahead.append(self.scheduler.at(time, action, Kind.MESSAGE))

    def _heal(self, *, again: bool = False) -> None:
        """No fault from now on: every link is whole, every process runs. `again`: also if nothing has begun."""
        self.note("heal")
        asked = [step for step in self.plan.steps if step.kind in ("deploy", "diagram")]
        begins = bool(self.plan.mission and asked and not again and self._is_idle())
        self.healed = math.inf if begins else self.scheduler.now / SECOND
        self._armed.clear()
        for machine in (*self.machines.values(), *(program.machine for program in self.programs.values())):
            if self.key is not None:  # what is signed is refused where clocks differ
                machine.ahead = machine.drift = 0.0
            machine.disk.fuse = machine.disk.room = None
            machine.disk.trouble = 0
        self.fabric.loss, self.fabric.twice, self.fabric.delay = 0.0, 0.0, 0.002
        self.fabric.mute.clear()
        self.fabric.check()
        for pair, count in list(self.fabric.cuts.items()):
            for _ in range(count):
                self.fabric.cut(*pair, heal=True)
        everyone = (*self.robots.values(), *self.senders, *self.programs.values())
        for process in [one.process for one in everyone if one.process is not None]:
            self._continue(process)
        for program in self.programs.values():
            if program.process is None and program.node is not None:
                self._start(program)
        for robot in self.robots.values():
            if robot.process is None:
                self.start(robot)
        if self.plan.mission is not None and begins:
            self._begin_again(asked[-1], self.plan.mission)

    def _begin_again(self, deployment: Step, mission: Mission) -> None:
        """A person deploys again what has begun nowhere, since it shows nothing; robots crash while it runs."""
        chance = random.Random(f"again {self.plan.seed}")
        self._later(15, partial(self._heal, again=True))  # until then faults go on
        self._do(deployment)
        for robot, steps in mission["robots"].items():
            met = sorted({step[0] for step in walk(steps)} & {"work", "timer", "go", "tell", "hear", "person"})
            for kind in chance.sample(met, min(1, len(met))):
                fault, away = chance.choice(("kill", "power")), chance.uniform(0.2, 2)
                self._armed.append(Step(chance.random(), fault, robot, away, f"{robot} at {kind}"))

    # ---- processes ---------------------------------------------------------------------------------------------------

    def _process(self, name: str, machine: Machine) -> tuple[Process, Wire]:
        self._numbers[name] += 1
        process = Process(f"{name}#{self._numbers[name]}", machine, self.scheduler, self._on_error)
        return process, self.fabric.join(process)

    def _start(self, program: Program) -> None:
        if program.process is None:
            program.process, program.wire = process, wire = self._process(program.name, program.machine)
            process.soon(partial(self._run_program, program, process, wire))

    def _run_program(self, program: Program, process: Process, wire: Wire) -> None:
        self._server_is_back()
        program.node = program.begin(process, wire)

    def _server_is_back(self) -> None:
        for robot in self.robots.values():
            robot.excuses.append((self.scheduler.now / SECOND, "server"))

    def _strike_program(self, program: Program, how: str, seconds: float) -> bool:
        """A splitter or server is killed, and started again later, or stopped for a while."""
        if program.process is None or program.wire is None or program.process.stopped:
            return False
        if how == "stop":
            self._stop(program.process, seconds)
            self._later(seconds, self._server_is_back if seconds >= LEASE else lambda: None)
        else:
            self.fabric.leave(program.wire)
            program.process = program.wire = None
            self.refused.clear()  # with the server
            self._later(seconds, partial(self._start, program))
        self.unserved += program.name == "server"
        return True

    def _begin_splitter(self, process: Process, wire: Wire) -> SplitterNode:
        return SplitterNode(
            scheduler=process,
            middleware=wire,
            trusted=() if self.key is None else [self.key.public_key()],
            log=lambda text: self.note(f"{process.name}: {text}"),
            options=DeploymentOptions(key=self.key, wall_time=process.machine.wall_time),
        )

    def _begin_server(self, process: Process, wire: Wire) -> ActionServer:
        """The server of the action `/go`: a goal takes 0.3, 6 or 20 s, one that it refuses to cancel 12 s more.

        The service `/ask` takes 0.2 s or 2 s.
        """

        def go(goal: ServerGoal) -> None:
            place = goal.message.pose.pose.position
            self.goals.append((process.name, round(place.x)))
            if (process.name, goal.id) in self._begun:
                self.problems.append(f"{process.name} executes goal {place.x:g} twice")
            if self.plan.mission is not None:
                self._check_goal(goal, process.name)
            self._begun[process.name, goal.id] = self._left.get(goal.id, 0.0)
            seconds = {GOALS["slow"]: 6.0, GOALS["long"]: 20.0}.get(round(place.y), 0.3)
            process.after(round(seconds * SECOND), lambda: goal.id in self.refused or end_goal(goal))

        def ask(request: Any) -> DeferredResponse:
            response = DeferredResponse()
            answer = partial(response.respond, {"success": request.data})
            process.after((2 if request.data else 20) * SECOND // 10, answer)
            return response

        def end(goal: ServerGoal) -> None:
            self.refused.pop(goal.id, None)
            end_goal(goal)

        def cancel(goal: ServerGoal) -> bool:
            if self.stubborn and goal.id not in self.refused:
                robot = goal.message.pose.header.frame_id or "A"
                self.refused[goal.id] = self.scheduler.now / SECOND, robot
                process.after(12 * SECOND, partial(end, goal))
            elif not self.stubborn:
                self._begun[process.name, goal.id] = -1.0
                goal.end("canceled", {})
            return not self.stubborn

        base = wire.node("base")
        base.service("/ask", ASK, ask)
        return ActionServer(base, "/go", DRIVE, go, cancel, accept=accepts)

    def _begin_monitor(self, process: Process, wire: Wire) -> ProcessingNode:
        """``fame monitor process``: an alarm for every second count."""
        return ProcessingNode(wire, process, _monitor(), report=lambda text: self.note(f"{process.name}: {text}"))

    def _on_error(self, process: Process, error: Exception | PowerLoss) -> None:
        """An error has left the main loop of a process: it ends, as one without a handler would."""
        self.note(f"{process.name} ends: {type(error).__name__}: {error}")
        for robot in self.robots.values():
            if robot.process is process:
                if isinstance(error, PowerLoss):
                    self.struck["fuse / blown"] += 1
                    self._strike(robot, "power", self._away)
                    return
                self._end(robot)
        if (
            isinstance(error, DeploymentError | ConfigError)
            and "#" in process.name
            and self._is_refused(process, error)
        ):
            return
        if not (isinstance(error, FameError) and "there is an engine" in str(error)):
            self.problems.append(f"{process.name} ended with {type(error).__name__}: {error}")
        else:  # whoever started it, starts it again
            self._later(3.0, partial(self._restart, process.name.split("#")[0]))

    def start(self, robot: Robot) -> None:
        """Start a robot's engine."""
        if robot.process is not None:
            return
        robot.process, robot.wire = self._process(robot.name, robot.machine)
        robot.began = self.scheduler.now / SECOND
        robot.excuses.append((robot.began, "crash"))
        self.note(f"{robot.process.name} begins")
        robot.process.soon(partial(self._begin_engine, robot, robot.process, robot.wire))

    def _begin_engine(self, robot: Robot, process: Process, wire: Wire) -> None:
        state = None
        if robot.durable:
            state = StateDirectory("/state", robot.machine.disk)
            if robot.fresh:
                state.set_aside()
                robot.fresh = False
        robot.engine = EngineNode(
            robot.name,
            scheduler=process,
            middleware=wire,
            options=EngineOptions(
                wall_time=robot.machine.wall_time,
                epoch=datetime.fromtimestamp(robot.machine.wall_time(), UTC),
                state=state,
                seed=self.plan.seed,
                trusted=() if self.key is None else [self.key.public_key()],
                identity=None if self.key is None else self._identity(robot.name, self.key),
                hold_errors="breaks" in self.more or self.plan.mission is not None,
                on_report=self._on_report,
                observer=None if self.plan.mission is None else partial(self._on_event, robot),
                log=self._recording(robot, process),
            ),
        )
        self._listen(robot, robot.engine, process)
        if robot.engine.resuming:
            robot.resumes = True
            self._on_moment(f"{robot.name} resuming")

    def _on_report(self, event: Event) -> None:
        """Count the acknowledged signals that have expired, and note who holds."""
        if str(event.detail).startswith("holds deployment"):
            self.held.add(event.robot)
        if found := re.search(r"(\w) has not acknowledged (?:number|(\d+) of)", str(event.detail)):
            self.expired[found[1]] += int(found[2] or 1)
            self.note(f"{event.robot}: {event.detail}")

    def _on_event(self, robot: Robot, event: Event) -> None:
        now = self.scheduler.now / SECOND
        self._at_once = self._at_once + 1 if now == self._event_at else 0
        self._event_at = now
        if self._at_once > AT_ONCE:
            raise EndlessRunError(f"{robot.name} does not come to rest: {AT_ONCE} events at {now:g} s")
        if robot.engine is not None:
            robot.witness.on_event(now, robot.engine, event)
        if event.what == "enter" and event.element:
            self.entered.add(event.element)
            if self._armed:
                self._on_moment(f"{robot.name} at {event.element.rsplit('_', 2)[0].partition('_')[2]}")
        if (
            event.what == "cancel"
            or "_handler_" in event.element
            or re.search("; retry: [as]|retried|moved|restarted|taken over|suspended|holds|incident", str(event.detail))
        ):
            robot.excuses.append((now, "cancel"))
        if "server does not know" in str(event.detail):
            self._check_lost(robot, event.element)

    def _check_written(self, variable: str, topic: str, process: str) -> None:
        """What leaves is on the disk: should the power go now, its robot would know of it."""
        robot, count = self.robots[process.partition("#")[0]], self.fabric.published[topic][-1][2].data
        if not robot.durable or robot.spoilt or robot.machine.disk.removed or robot.witness.changed:
            return  # a token may come to what tells without the script before it
        tables = stored(robot.machine.disk.certain())
        found = [(key.rpartition(" ")[2], value) for key, value in tables.get("values", {}).items()]
        found += [pair for ended in tables.get("ended", {}).values() for pair in ended["values"].items()]
        known = [value for name, value in found if name == variable]
        known += [
            value[variable] + count // 1000 * 1000 for name, value in found if name == "done" and variable in value
        ]
        if not any(one >= count for one in known):
            self.problems.append(f"{robot.name} says {count} on {topic}, and has only {known} on its disk")

    def _on_effect(self, longest: float, topic: str, process: str) -> None:
        """Nothing is done while its mission is held, but what is on its way to the disk, for at most `longest` s."""
        robot = self.robots[process.partition("#")[0]]
        node = robot.engine.running if robot.engine is not None else None
        if topic == SEND_GOAL:
            goal = self.fabric.published[topic][-1][2].goal_id
            self._left.setdefault(bytes(goal.uuid), self.scheduler.now / SECOND)
        self._on_moment(f"{robot.name} {'goal' if topic == SEND_GOAL else 'effect'}")
        longest += 2 * (robot.machine.slowest - WRITING)  # behind what is written now
        late = robot.engine is not None and robot.witness.held_for(self.scheduler.now / SECOND, robot.engine) >= longest
        if late and node is not None and "disk" not in node.holds:  # what a full disk has held leaves when it can
            self.problems.append(f"{robot.name} works while its mission is suspended")
        if topic.startswith("/tell_"):
            self._check_written("told", topic, process)

    def _check_goal(self, goal: ServerGoal, server: str) -> None:
        """A goal is executed once; another one for the same, after a crash too, only if the first is cancelled.

        What was sent first may arrive last. Two tokens may make one goal each at one instant, after a move by a person.
        """
        robot, number = self.robots[goal.message.pose.header.frame_id], round(goal.message.pose.pose.position.x)
        last = self._sent.get((server, robot.name, number), b"")
        since, left = self._begun.get((server, last), -1.0), self._left[goal.id]
        first, second = sorted((since, left))
        excused = any(first <= time <= second and why in ("cancel", "server") for time, why in robot.excuses)
        started = self.plan.mission is not None and is_started(self.plan.mission, robot.name)
        excused |= robot.witness.changed and self._left.get(last) == left
        if since >= 0 and robot.durable and not (robot.spoilt or excused or started):
            self.problems.append(f"{robot.name} has sent its goal {number} again, which its server has")
        self._sent[server, robot.name, number] = goal.id

    def _check_lost(self, robot: Robot, element: str) -> None:
        """A goal that its server had when a robot was started, the server knows when it is asked.

        Of several tokens at the element, it may be another one's.
        """
        program, node = self.programs["server"], robot.engine.running if robot.engine is not None else None
        if program.process is None or node is None or node.host.recorder is None:
            return
        server = program.process.name
        goals = [
            goal for wait, (goal, *_) in node.host.recorder._goals.items() if wait.alive and wait.node.id == element
        ]
        begun = [self._begun.get((server, bytes.fromhex(goal)), math.inf) for goal in goals]
        if begun and all(0 <= one < robot.began for one in begun):
            self.problems.append(f"{robot.name} says that its server does not know a goal of {element}: it does")

    def _check_followed(self) -> None:
        """A goal that is executed is one that a task waits for, or was cancelled and is not lost sight of."""
        program, lost = self.programs["server"], dict[bytes, float]()
        apart = +self.fabric.cuts or +self.fabric.mute
        healthy = program.process is not None and not program.process.stopped and not apart
        now = self.scheduler.now / SECOND
        for goal in program.node.goals.values() if healthy and isinstance(program.node, ActionServer) else ():
            robot = self.robots[goal.message.pose.header.frame_id or "A"]
            node = robot.engine.running if robot.engine is not None else None
            recorder = node.host.recorder if node is not None else None
            if robot.spoilt or robot.process is None or robot.process.stopped or recorder is None:
                continue
            known, cancelled = _goals_of(node), goal.id.hex() in node.runner.cancelled.table()
            if goal.id.hex() not in known and not (cancelled and goal.id in self.refused) and not robot.engine.resuming:
                lost[goal.id] = self._lost.get(goal.id, now)
                if now - lost[goal.id] > 3 + self.fabric.delay + 2 * robot.machine.slowest:
                    what = "was cancelled, and goes on" if cancelled else "goes on that no task waits for"
                    self.problems.append(f"a goal of {robot.name} {what}")
        self._lost = lost

    def _check_refused(self) -> None:
        """What robots have cancelled in vain for longer than `BOUND` is in their reports, unless they were away.

        A task that was resumed may have taken it up again.
        """
        now = self.scheduler.now / SECOND
        for id, (time, name) in self.refused.items():
            robot = self.robots[name]
            engine, since = robot.engine, max(robot.began, robot.continued) + 1
            away = engine is None or engine.running is None or robot.process is None or robot.process.stopped
            if (
                since < time < now - BOUND - 1
                and engine is not None
                and not away
                and not engine._progress()["warnings"]
                and id.hex() not in _goals_of(engine.running)
            ):
                self.problems.append(f"{name} does not say that a goal still runs which its server does not cancel")

    def _recording(self, robot: Robot, process: Process) -> EngineLog | None:
        """The recording of an engine."""
        if self.log is None:
            return None
        wall_time = robot.machine.wall_time
        log = EngineLog(self.log, robot.name, process, self.note, files=sys.maxsize, wall_time=wall_time)
        self._recordings.append(log)
        return log

    def close(self) -> None:
        """Finish the recordings."""
        for log in self._recordings:
            log.close()

    def _listen(self, robot: Robot, engine: EngineNode, process: Process) -> None:
        """Note every answer that an engine gives."""
        publish, asked = engine.status.publish, set[str]()
        robot.promised = promised = dict[str, float]()
        robot.witness.watch(self.scheduler.now / SECOND, engine)

        def published(answer: str = "", deployment: str = "", reason: str = "", *rest: Any, **more: Any) -> None:
            if answer and not more.get("repeated"):
                effects = len(self.fabric.published.get(self.tells(robot.name), ()))
                said = Said(self.scheduler.now / SECOND, robot.name, process.name, answer, deployment, reason, effects)
                text = f"{process.name}: {answer} {deployment} {reason}".rstrip()
                if answer not in ("asking", "unknown") or text not in asked:  # they are said each second
                    self.note(text)
                    asked.add(text)
                late = said.time > min(promised.values(), default=math.inf) + 2 * robot.machine.slowest
                late = late and deployment.startswith("person") and answer not in _AT_ANY_TIME  # else just written
                if late and not any((one.robot, one.deployment) == (robot.name, deployment) for one in self.said):
                    self.problems.append(f"{robot.name} has {answer} for {deployment}, to start {min(promised)}")
                if answer == "ready":
                    promised.setdefault(deployment, said.time)
                elif answer != "asking":
                    promised.pop(deployment, None)
                self.said.append(said)
                robot.excuses += [(said.time, "cancel")] * (answer in ("ready", "started", "refused", "aborted"))
            publish(answer, deployment, reason, *rest, **more)
            self._on_moment(f"{robot.name} {answer}")
            if answer == "ready" and engine.running is not None:
                self._on_moment(f"{robot.name} promises")

        engine.status.publish = published  # type: ignore[method-assign]

    def _on_moment(self, moment: str) -> None:
        """Do what waits for this."""
        waiting = [step for step in self._armed if step.on == moment]
        for step in waiting[:1] if moment.endswith(" resumed") else waiting:  # of crashes one after the other
            self._armed.remove(step)
            soon = 0.3 * (step.time % 1) ** 2 if moment.endswith((" goal", " effect")) else 0.0
            soon = 2 * (step.time % 1) ** 2 if " at " in moment else soon
            self._later(soon, partial(self._do, step))

    def _strike(self, robot: Robot, kind: str, away: float) -> bool:
        """SIGKILL, perhaps with more that happens to the disk, and a restart after a while."""
        disk = robot.machine.disk
        if robot.wire is None or (kind != "kill" and not robot.durable):
            return False
        if kind == "kill" and robot.engine is not None and robot.durable:
            robot.witness.killed(robot.engine)
        elif kind != "kill":
            robot.witness.forget()
        self._end(robot)
        if kind == "power":
            disk.lose_power()
        elif kind == "flip":
            robot.spoilt |= disk.flip()
        elif kind == "erase":
            disk.erase()
            robot.spoilt = True
        self._later(away, partial(self._restart, robot.name))
        return True

    def _is_refused(self, process: Process, error: Exception) -> bool:
        """The engine does not take its state: a person puts that aside. Only a disk that rots may be the cause."""
        robot = self.robots.get(process.name.split("#")[0])
        if robot is None or not robot.durable:
            return False
        disk = robot.machine.disk
        if not robot.spoilt and not disk.trouble and disk.room is None:
            self.problems.append(f"{process.name} refuses the state that a crash left: {error}")
        if not disk.trouble and disk.room is None:
            robot.fresh = robot.spoilt = True
        self._later(3.0, partial(self._restart, robot.name))
        return True

    def _end(self, robot: Robot) -> None:
        assert robot.wire is not None
        robot.spoilt |= robot.machine.disk.removed  # all that it had is lost with it
        node = robot.engine.running if robot.engine is not None else None
        if node is not None and node.engine.held is not None:
            robot.excuses.append((self.scheduler.now / SECOND, "cancel"))
        self.fabric.leave(robot.wire)
        robot.machine.disk.release()
        robot.process = robot.wire = robot.engine = None

    def _restart(self, name: str) -> None:
        if name in self.robots:
            self.start(self.robots[name])

    def _stop(self, process: Process, seconds: float) -> None:
        process.stop()
        self.fabric.check()
        self._later(seconds, partial(self._continue, process))

    def _continue(self, process: Process) -> None:
        if process.stopped and process.alive:
            process.go_on()
            self.fabric.check()
            for robot in self.robots.values():
                if robot.process is process:
                    robot.continued = self.scheduler.now / SECOND

    def _drop_matches(self, robot: Robot) -> bool:
        """The endpoints of a robot lose their matches, and find them again."""
        if robot.wire is None:
            return False
        for wire in robot.wire.others():
            for end in robot.wire.ends():
                wire.lose(end)
                self._later(0.5, partial(wire.discover, end))
        return True

    # ---- what people do ----------------------------------------------------------------------------------------------

    def text(self, version: int) -> str:
        """The BPMN of a version."""
        return text(version, self.more) if self.plan.mission is None else text_of(self.plan.mission, version)

    def definitions(self, version: int) -> Definitions:
        """The same, read."""
        if self.plan.mission is None:
            return mission(version, self.more)
        if version not in self._read:
            self._read[version] = reader.read_text(self.text(version), file=f"version_{version}.bpmn")
        return self._read[version]

    def _private(self, name: str) -> Ed25519PrivateKey:
        return Ed25519PrivateKey.from_private_bytes(hashlib.sha256(f"{self.plan.seed} {name}".encode()).digest())

    def _identity(self, robot: str, team: Ed25519PrivateKey) -> Identity:
        """What ``fame keys robot`` makes."""
        private = self._private(robot)
        return Identity(private, sign(_name_of(robot, Identity(private).key), team))

    def deploy(self, version: int, *, key: Ed25519PrivateKey | None = None, migrates: bool = False) -> Sender:
        """``fame deploy``: find the robots for at most 10 s, deploy, end. `key`: that of a stranger."""
        process, wire = self._process(f"sender {version}", self.machines[DESK])
        sender = Sender(version, process, wire, migrates, key=self.key if version != STRANGER else key)
        self.senders.append(sender)
        self._find(sender, process.now + 10 * SECOND)
        return sender

    def _find(self, sender: Sender, until: int) -> None:
        process, wire = sender.process, sender.wire
        if process.now < until and wire.graph() is sender.graph:
            process.after(SECOND // 20, partial(self._find, sender, until))
            return
        sender.graph = wire.graph()
        try:
            assign_robots(self.definitions(sender.version), engines(wire), found=True, only=())
        except (ConfigError, DeploymentError) as error:
            if process.now >= until:
                self._leave(sender, f"no robots: {error}")
            else:
                process.after(SECOND // 20, partial(self._find, sender, until))
        else:
            process.after(SECOND // 2, partial(self._begin, sender))

    def _begin(self, sender: Sender) -> None:
        wall_time = sender.process.machine.wall_time
        try:
            sender.deployment = Deployment(
                self.definitions(sender.version),
                id=sender.process.name,
                sequence=round(wall_time() * 1e6),
                scheduler=sender.process,
                middleware=sender.wire,
                ended=lambda _: self._later(0.0, partial(self._ended, sender)),
                options=DeploymentOptions(
                    migrate=sender.migrates, wall_time=wall_time, key=sender.key, plan=self._migration_plan(sender)
                ),
            )
        except FameError as error:
            self._leave(sender, f"not sent: {error}")
            return
        sender.deployment.begin()

    def _migration_plan(self, sender: Sender) -> dict[str, Any]:
        """What a person plans for some of the tokens that there are: they begin again, end, or go elsewhere."""
        chance, elements = random.Random(f"{self.plan.seed} plan {sender.process.name}"), dict[str, Any]()
        if self.plan.mission is None or not sender.migrates or chance.random() < 0.2:
            return {}
        for robot in self.robots.values():
            node = robot.engine.running if robot.engine is not None else None
            if node is None:
                continue
            nodes, there = node.engine.program.by_key.values(), list(_places(node))
            hosts = sorted({one.id for one in nodes if one.id and one.boundary is not None})  # where a token may come
            some = chance.sample(there, min(len(there), chance.randint(0, 2)))
            for element in some + chance.sample(hosts, min(len(hosts), chance.randint(1, 2))):
                others = [{"to": other} for other in _beside(node, element)]
                elements[element] = chance.choice(("restart", "abandon", *others[:1], *others[-1:]))
        return {"elements": elements, "variables": {}}

    def _ended(self, sender: Sender) -> None:
        if sender.deployment is not None and sender.alive:
            outcome = "; ".join(map(str, sender.deployment.robots.values()))
            if self.plan.mission is not None and sender.deployment.failed and self._is_idle() and len(self.senders) < 6:
                self._later(2.0, partial(self.deploy, sender.version))  # a person tries again
            self._leave(sender, f"{'failed' if sender.deployment.failed else 'started'}: {outcome}")

    def _leave(self, sender: Sender, text: str) -> None:
        """The process of a sender ends."""
        self.note(f"{sender.process.name}: {text}")
        sender.ended = text
        if sender.deployment is not None:
            sender.deployment.close()
        self._end_process(sender.wire)

    def _end_process(self, wire: Wire) -> None:
        """A process closes its endpoints, and ends."""
        wire.close()
        self._later(0.5, partial(self.fabric.leave, wire))

    def publish_diagram(self, version: int) -> None:
        """A person gives the splitters a diagram, and leaves."""
        process, wire = self._process("person", self.machines[DESK])
        publisher = wire.node("person").publisher(DIAGRAM, STRING, PROCESS_QOS)
        diagram = self.text(version)
        if self.key is not None:
            now = process.machine.wall_time()
            diagram = Diagram.of(diagram, purpose="deploy", now=now, key=self.key).to_json()
        self._later(2.0, lambda: publisher.publish(messages.create(STRING, diagram)))
        self._later(20.0, partial(self._end_process, wire))

    def repair(self, robot: Robot, how: str) -> bool:
        """A person mends what has failed: ``fame set`` and ``fame retry``, or ``fame move``, each for at most 5 s."""
        if robot.engine is None or robot.engine.state != "incident":
            return False
        if how == "retry":
            self.ask(robot, {"act": "set", "values": {"mended": 1}}, {"act": "retry", "element": "pcwork"})
        else:
            self.ask(robot, {"act": "move", "element": "pcwork", "to": "pckeep"})
        return True

    def suspend(self, robot: Robot, seconds: float) -> bool:
        """``fame suspend``, and after a while ``fame continue``."""
        if robot.engine is None or robot.engine.running is None:
            return False
        self.ask(robot, {"act": "suspend"})
        self._later(seconds, partial(self.ask, robot, {"act": "continue"}))
        return True

    def act(self, robot: Robot, act: str, number: int, seconds: float) -> bool:
        """A person asks for something; `number` chooses where."""
        node = robot.engine.running if robot.engine is not None else None
        if node is None:
            return False
        tokens = list(_places(node))
        helped = [(element, values) for element, kind, values in help_needed(node) if kind == act]
        places = [element for element, _ in helped] if act in ("complete", "retry") else tokens
        place = places[number % len(places)] if places else "nowhere"
        others = sorted(id for id in node.engine.program.elements if id)
        if number % 4:  # mostly one that is possible, also where the next version has none
            others = _beside(node, place) or others
            new = robot.engine.candidate.process.engine.program.elements if robot.engine.candidate else ()
            others = [one for one in others if number % 3 and one not in new] or others
        more: dict[str, Any] = {
            "move": {"to": others[number % len(others)]},
            "retry": {"values": {"helped": 1}},
            "set": {"element": "", "values": {"helped": number % 2}},
            "take_over": {"element": "", "lease": f"lease {number}"},
            "note": {"to": "seen"},
        }.get(act, {"element": ""} if act in ("suspend", "continue") else {})
        if act == "steer":  # and gives it back
            lease = {"lease": f"lease {number}", "who": "person"}
            taking = [
                {"act": "take_over", "id": f"{number} {self.scheduler.now} {again}", **lease} for again in range(4)
            ]
            self.ask(robot, *taking, {"act": "continue", **lease})
            return True
        self.ask(robot, {"act": act, "element": place, **more})
        if act in ("suspend", "take_over"):
            self._later(3 + seconds, partial(self.ask, robot, {"act": "continue"}))
        return True

    def ask(self, robot: Robot, *requests: dict[str, Any]) -> None:
        """A person makes requests, each when the one before is answered, for 11 s."""
        process, wire = self._process("person", self.machines[DESK])
        asked = [TaskRequest(**{"id": f"{process.name} {one['act']}", "element": "", **one}) for one in requests]
        asking: list[TaskClient] = []
        self._request(robot.name, process, wire, asked, asking)

        def leave() -> None:
            asking[-1].close()
            self._end_process(wire)

        self._later(11.0, leave)

    def _request(
        self, robot: str, process: Process, wire: Wire, requests: list[TaskRequest], asking: list[TaskClient]
    ) -> None:
        """Make one request, and the next when it is answered; `asking` gets the client of each."""
        if not requests:
            return

        def answered(report: Report) -> None:
            self.note(f"{process.name}: {robot} {report.answer} {report.reason}".rstrip())
            unsure = re.search("signed|no memory is left", report.reason)  # by a clock that is wrong
            self.told[requests[0].id] = "" if unsure else report.answer
            client.close()
            if report.answer != "refused":
                self._request(robot, process, wire, requests[1:], asking)

        client = TaskClient(
            robot,
            requests[0],
            node=wire.node("person"),
            scheduler=process,
            answered=answered,
            key=self.key,
            wall_time=process.machine.wall_time,
        )
        asking.append(client)

    def abort(self, robot: Robot, *, key: Ed25519PrivateKey | None = None) -> None:
        """``fame abort``: a person ends the deployment that a robot holds. `key`: that of a stranger."""
        candidate = robot.engine._protocol.state.candidate if robot.engine is not None else None
        if robot.engine is None or candidate is None:
            return
        deployment = candidate.envelope.deployment
        if key is None:
            key = self.key
            self.released.add((robot.name, deployment))
        process, wire = self._process("person", self.machines[DESK])
        publisher = wire.node("person").publisher(f"/{robot.name}/bpmn_process", STRING, PROCESS_QOS)
        envelope = Envelope(deployment=deployment, sequence=0, robot=robot.name, phase="abort")
        envelope = signed(envelope, key, born=robot.engine.born, now=process.machine.wall_time())
        self._later(2.0, lambda: publisher.publish(messages.create(STRING, envelope.to_json())))
        self._later(4.0, partial(self._end_process, wire))


def _goals_of(node: RobotNode | None) -> set[str]:
    """The goals that tasks of a mission with a state directory wait for."""
    recorder = node.host.recorder if node is not None else None
    return {sent[0] for wait, sent in recorder._goals.items() if wait.alive} if recorder is not None else set()


def _places(node: RobotNode) -> dict[str, None]:
    """The elements that have tokens, also those around others."""
    inside = [token for one in node.engine.instances.values() for token in tokens_of(one)]
    return dict.fromkeys(token.node.id for token in inside if token.node is not None and token.node.id)


def _beside(node: RobotNode, element: str) -> list[str]:
    """The elements of the scope that has a token at an element."""
    try:
        body = token_at(node.engine, element)[1].body
    except MissionError:
        return []
    return sorted(body.entries) if body is not None else []


__all__ = ["Reply", "Report", "Robot", "Said", "Sender", "Team"]
