"""A scenario in many processes: the world and one engine per robot, started, deployed to, watched and ended."""

from __future__ import annotations

import json
import math
import os
import signal
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from fame.check.gate import refuse_errors
from fame.clock import SECOND, Kind
from fame.deploy import STATUS_QOS, STRING, Deployment, Report
from fame.deploy.authentication import ReportReader
from fame.deploy.signing import new_run_key
from fame.middleware.interface import LATCHED
from fame.scenario.outcome import event_of, is_over, never_started, reported_result, status_of
from fame.scenario.process import connect, scheduler_for
from fame.scenario.result import Result, RobotResult, Status, TeamStatus
from fame.scenario.subprocesses import Subprocesses, command_lines
from fame.scenario.world_process import EMPTY, RESUME, WORLD_STATE

if TYPE_CHECKING:
    from fame.robot import Event
    from fame.scenario.plan import Plan

_LOOK = SECOND // 5  # ns between two looks at the processes
_APPEARING = 15.0  # s until all engines have to be there


class Team:
    """A scenario in many processes: the world, and one engine per robot. They begin together, and end together.

    The engines run only what a key of this run has signed, whoever else reaches them.

    `watch` is told how things stand, `hear` every line that a process says. A world goes `speed` times as fast as
    reality (1, in `lockstep` as fast as it can), and all engines with it. `types` are folders of message types.
    Raises ModelError for what is known to be wrong before anything is started.
    """

    def __init__(
        self,
        scenario: Plan,
        backend: str,
        *,
        watch: Callable[[TeamStatus], object] = lambda sight: None,
        hear: Callable[[str, str], object] = lambda name, line: None,
        speed: float | None = None,
        lockstep: bool = False,
        types: Sequence[Path] = (),
    ) -> None:
        refuse_errors(scenario.definitions, scenario.processes(), scenario.library)
        self.scenario, self.backend, self._watch = scenario, backend, watch
        self._speed, self._lockstep = speed, lockstep
        self._types = types
        self.scheduler = scheduler_for(backend)
        self.middleware = connect(backend, self.scheduler)
        self.reports: dict[str, Report] = {}
        self.world: Mapping[str, Any] | None = None
        self._children = Subprocesses(
            lambda name, line: self.scheduler.soon(lambda: self._said(name, self._with_own_files(name, line)))
        )
        self._hear = hear
        self._status: Status | None = None  # what it comes to, whatever robots say
        self._problems: list[str] = []
        self._events: list[Event] = []
        self._pids: dict[str, int] = {}
        self._deployment: Deployment | None = None
        self._last_look = False
        self._over = False
        self._until = math.inf  # s, when the duration is over

    def run(self) -> Result:
        """Start all, deploy, wait until nothing runs any more or the duration is over, end all."""
        begun = time.monotonic()
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._interrupt)
        try:
            with TemporaryDirectory(prefix="fame-") as folder:
                self._start(Path(folder) / "run.pub")
                self._listen()
                self._look()
                self.scheduler.after(round(_APPEARING * SECOND), self._expect_all, Kind.TIMER)
                self.scheduler.run()
        finally:
            for number in (signal.SIGINT, signal.SIGTERM):
                signal.signal(number, signal.SIG_IGN)  # a second Ctrl-C would leave some of them behind
            self._problems += self._children.end()
            self.middleware.close()
            signal.signal(signal.SIGINT, signal.default_int_handler)
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
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
        """When the robots were told to start (s of the mission)."""
        return self._until - self.scenario.duration

    def _robots(self) -> tuple[RobotResult, ...]:
        """How it goes for each robot, from what they said last."""
        return tuple(reported_result(robot, self.reports.get(robot)) for robot in self.scenario.cast)

    def _said(self, name: str, line: str) -> None:
        """A process has said a line."""
        event = event_of(name, line)
        if event is not None:
            self._events.append(event)
        self._hear(name, line)

    def _interrupt(self, *_: object) -> None:
        self._status = "interrupted"
        self.scheduler.stop()

    def _fail(self, *problems: str) -> None:
        self._status = "failed"
        self._problems += problems
        self.scheduler.stop()

    def _start(self, trust: Path) -> None:
        self._key = new_run_key(trust)
        words = command_lines(
            self.scenario, self.backend, speed=self._speed, lockstep=self._lockstep, types=self._types, trust=trust
        )
        for name, line in words.items():
            self._children.start(name, line)
            self._pids[name] = self._children.pid(name)

    def _look(self) -> None:
        """Show how things stand; if one process is no more, or the duration is over, all end."""
        ended = self._children.ended()
        if ended:
            self._fail(*ended)
            return
        self._watch(TeamStatus(self._time, self.reports, self._pids))
        if self._time >= self._until and not self._over:
            self.scheduler.stop()
        else:
            self.scheduler.after(_LOOK, self._look, Kind.TIMER)

    @property
    def _time(self) -> float:
        """Of the mission (s): the world's, if there is one."""
        return float(self.world["time"]) if self.world is not None else self.scheduler.now / SECOND

    def _listen(self) -> None:
        node = self.middleware.node("fame_team")
        for robot in self.scenario.cast:
            node.subscription(
                f"/{robot}/bpmn_status", STRING, partial(self._heard, ReportReader(robot, signed=True)), STATUS_QOS
            )
        node.subscription(WORLD_STATE, STRING, self._seen, LATCHED)
        self._world_time = node.client(RESUME, EMPTY)

    def _seen(self, message: Any) -> None:
        with suppress(ValueError, TypeError, KeyError, RecursionError):
            said = json.loads(message.data)
            float(said["time"])
            self.world = said
            if self._last_look:
                self.scheduler.stop()

    def _heard(self, reader: ReportReader, message: Any) -> None:
        report = reader.read(message.data)
        if report is None:
            return
        robot = reader.robot
        self.reports[robot] = report if self._deployment is None else self._deployment.source_map(robot).report(report)
        if self._deployment is None and len(self.reports) == len(self.scenario.cast) and self._world_is_there():
            self._deploy()
        elif self._deployment is not None and self._deployment.done and not self._deployment.failed:
            self._look_whether_over()

    def _with_own_files(self, name: str, line: str) -> str:
        """A line that a process printed, with the places of the model that was deployed."""
        if self._deployment is None or name not in self._deployment.robots:
            return line
        return self._deployment.source_map(name).line(line)

    def _world_is_there(self) -> bool:
        return self.scenario.world is None or self.world is not None

    def _deploy(self) -> None:
        self._deployment = Deployment(
            self.scenario.definitions,
            id=f"run-{os.getpid()}",
            sequence=1,
            scheduler=self.scheduler,
            middleware=self.middleware,
            ended=self._deployed,
            robots=list(self.scenario.cast),
            library=self.scenario.library,
            key=self._key,
        )
        self._deployment.begin()

    def _deployed(self, deployment: Deployment) -> None:
        if deployment.failed:
            self._fail(*map(str, deployment.robots.values()))
            return
        self._until = self._time + self.scenario.duration
        if self._lockstep and self.scenario.world is not None:
            self._world_time.call(None, lambda response: None)

    def _look_whether_over(self) -> None:
        """What one robot said last may be on its way to another: look again when it must have arrived."""
        if not self._over and is_over(self._robots()):
            self._over = True
            self.scheduler.after(SECOND // 2, self._look_again, Kind.TIMER)

    def _look_again(self) -> None:
        self._over = is_over(self._robots())
        if not self._over:
            return
        if self.scenario.world is None:
            self.scheduler.stop()
        else:  # with the next word of the world, which is about what has come to rest
            self._last_look = True
            self.scheduler.after(SECOND, self.scheduler.stop, Kind.TIMER)

    def _expect_all(self) -> None:
        missing = [robot for robot in self.scenario.cast if robot not in self.reports]
        if missing or not self._world_is_there():
            names = ", ".join([*missing, *([] if self._world_is_there() else ["the world"])])
            self._fail(f"{names} did not appear within {_APPEARING:g} s")
