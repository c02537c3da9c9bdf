"""Send late joiners their processes: robots that join late, or restart, get what the others have.

Theory of operation. `LateJoiners` listens to every engine that a pool of its model wants. Those that report ``waiting``
are sent their parts, all that wait at that moment in one deployment, so that they find each other. Robots that have a
process are left alone, whatever it is. If no robot has the model any more and some have another one, nobody is
supplied: the team has gone on. A robot whose deployment failed is tried again after `RETRY` s, with all others that
have failed: alone, each in its turn, they would not find each other. Those that were called off because of it are
tried at once.

Who is supplied when is decided by a pure state machine, ``step(state, event) -> (state, actions)``.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from functools import partial
from typing import Any

from fame.bpmn.model import Definitions
from fame.bpmn.pools import matches, pools_of
from fame.bpmn.split import split
from fame.clock import SECOND, Entry, Kind, Scheduler
from fame.dataclasses import dataclass, replace
from fame.deploy.authentication import GONE, ReportReader
from fame.deploy.envelope import STATUS_QOS, STRING, Report, engines, model_hash
from fame.deploy.machine import ProtocolMachine, boundary
from fame.deploy.sender import Deployment, Sender
from fame.errors import FameError
from fame.middleware.interface import Middleware, Node, Subscription

POLL = 0.5
"""How often the graph is searched for engines (s)."""
_GONE_ON = "no robot has this model any more"
RETRY = 10.0
"""After how long robots whose deployment failed are sent their parts again (s)."""


# ---- decisions -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class JoinersState:
    """The state of the robots.

    waiting    those that report that they wait for a process
    supplied   those that have had the model before
    retry      for each robot that was sent its part and has not started, when it may be sent again (ns)
    deploying  whether a deployment is under way
    ours       those that have the model
    others     those that have another one
    withheld   those that were told not to be supplied
    """

    waiting: frozenset[str] = frozenset()
    supplied: frozenset[str] = frozenset()
    retry: frozenset[tuple[str, int]] = frozenset()
    deploying: bool = False
    ours: frozenset[str] = frozenset()
    others: frozenset[str] = frozenset()
    withheld: frozenset[str] = frozenset()


@dataclass(frozen=True, slots=True)
class Reported:
    """A robot has reported its `Report.state`, and whether it has the model (None: it has none)."""

    robot: str
    state: str
    ours: bool | None = None


@dataclass(frozen=True, slots=True)
class Left:
    """A robot no longer has an engine."""

    robot: str


@dataclass(frozen=True, slots=True)
class Polled:
    """All engines were searched for; it is `now` (ns)."""

    now: int


@dataclass(frozen=True, slots=True)
class RobotStarted:
    """A robot of the current deployment has started its process."""

    robot: str


@dataclass(frozen=True, slots=True)
class CalledOff:
    """A robot of the current deployment has not started, because of another one."""

    robot: str


@dataclass(frozen=True, slots=True)
class DeploymentEnded:
    """The deployment has ended."""


@dataclass(frozen=True, slots=True)
class Supply:
    """Send these robots their parts, in one deployment; those in `again` have had them before."""

    robots: tuple[str, ...]
    again: frozenset[str]


@dataclass(frozen=True, slots=True)
class Withhold:
    """These robots wait, but the team has gone on to another model."""

    robots: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Withdraw:
    """The team has gone on to another model: start none of those that are being supplied."""


LateJoinerAction = Supply | Withhold | Withdraw
LateJoinerEvent = Reported | Left | Polled | RobotStarted | CalledOff | DeploymentEnded


def step(state: JoinersState, event: LateJoinerEvent) -> tuple[JoinersState, tuple[LateJoinerAction, ...]]:
    """Return the next state and the actions."""
    match event:
        case Reported(robot, reported, ours):
            state = _placed(state, robot, ours)
            waiting = state.waiting | {robot} if reported == "waiting" else state.waiting - {robot}
            supplied = state.supplied | {robot} if ours else state.supplied  # its answer `started` may be lost
            state = replace(state, waiting=waiting, supplied=supplied)
            return state, (Withdraw(),) if state.deploying and _has_gone_on(state) else ()
        case Left(robot):
            state = _placed(state, robot, None)
            return replace(state, waiting=state.waiting - {robot}, retry=_without(state, {robot})), ()
        case RobotStarted(robot):
            state = replace(state, waiting=state.waiting - {robot}, retry=_without(state, {robot}))
            return replace(state, supplied=state.supplied | {robot}), ()
        case CalledOff(robot):
            return replace(state, retry=_without(state, {robot})), ()
        case DeploymentEnded():
            return replace(state, deploying=False), ()
        case Polled(now):
            return _supply(state, now)


def _supply(state: JoinersState, now: int) -> tuple[JoinersState, tuple[LateJoinerAction, ...]]:
    failed = {robot: time for robot, time in state.retry if robot in state.waiting}
    late = state.waiting - (failed.keys() if max(failed.values(), default=0) > now else set())
    if state.deploying or not late:
        return state, ()
    if _has_gone_on(state):
        new = tuple(sorted(late - state.withheld))
        return replace(state, withheld=state.withheld | late), (Withhold(new),) if new else ()
    retry = _without(state, late) | {(robot, now + round(RETRY * SECOND)) for robot in late}
    return replace(state, retry=retry, deploying=True), (Supply(tuple(sorted(late)), state.supplied & late),)


def _has_gone_on(state: JoinersState) -> bool:
    """Whether the team runs another model: a late robot must not begin the old one alone."""
    return bool(state.others) and not state.ours


def _placed(state: JoinersState, robot: str, ours: bool | None) -> JoinersState:
    """The state with what a robot has."""
    return replace(
        state,
        ours=state.ours | {robot} if ours else state.ours - {robot},
        others=state.others | {robot} if ours is False else state.others - {robot},
    )


def _without(state: JoinersState, robots: Collection[str]) -> frozenset[tuple[str, int]]:
    return frozenset((robot, time) for robot, time in state.retry if robot not in robots)


# ---- topics and deployments ------------------------------------------------------------------------------------------


class LateJoiners:
    """Keeps the robots of one model supplied until `close`. `supplied` are those that have it already.

    With the key of `sender` only reports that engines signed count. `log` is called with lines to print.
    """

    def __init__(
        self,
        definitions: Definitions,
        sender: Sender,
        *,
        supplied: Collection[str] = (),
        log: Callable[[str], object] = lambda text: None,
    ) -> None:
        self.scheduler: Scheduler = sender.scheduler
        self.middleware: Middleware = sender.middleware
        self._definitions, self._sender, self._log = definitions, sender, log
        self._hashes = {model_hash(part.source) for part in split(definitions, sender.options.library)}
        self._ids, self._met = set[str](), set[str]()  # deployments of the model, robots that have had a process
        self._newer = set[str]()  # robots that know what an envelope says that is for one without a process
        self._pools = pools_of(definitions)
        state = JoinersState(supplied=frozenset(supplied))
        self._protocol: ProtocolMachine[JoinersState, LateJoinerEvent, LateJoinerAction] = ProtocolMachine(
            state, step, self._perform
        )
        self._current: Deployment | None = None
        self.node: Node = self.middleware.node("fame_keeper")
        self._engines: dict[str, Subscription] = {}
        self._next: Entry = self.scheduler.soon(self._poll, Kind.TIMER)

    @property
    def supplied(self) -> frozenset[str]:
        """The robots that have had the model."""
        return self._protocol.state.supplied

    def close(self) -> None:
        """Stop deploying to late joiners, and close all endpoints."""
        self._next.cancel()
        if self._current is not None:
            self._current.close()
        self.node.close()

    def _poll(self) -> None:
        self._next = self.scheduler.after(round(POLL * SECOND), self._poll, Kind.TIMER)
        there = {robot for robot in engines(self.middleware) if any(matches(robot, pool) for pool in self._pools)}
        for robot in sorted(self._engines.keys() - there):
            self._engines.pop(robot).close()
            self._protocol.handle(Left(robot))
        for robot in sorted(there - self._engines.keys()):
            read = partial(self._on_report, ReportReader.of_sender(robot, self._sender.options.key, patience=GONE))
            on_report = boundary(read, partial(self._on_strange_report, robot))
            self._engines[robot] = self.node.subscription(f"/{robot}/bpmn_status", STRING, on_report, STATUS_QOS)
        self._protocol.handle(Polled(self.scheduler.now))

    def _on_report(self, reader: ReportReader, message: Any) -> None:
        report = reader.read(message.data, self.scheduler.now / SECOND)
        if report is not None:
            if not report.deployment:  # answers do not say it
                (self._newer.add if report.protocol > 1 else self._newer.discard)(reader.robot)
            ours = self._is_ours(reader.robot, report) if report.deployed else None
            self._protocol.handle(Reported(reader.robot, report.state, ours))

    def _is_ours(self, robot: str, report: Report) -> bool:
        """Whether what a robot has is from here, or the model that it had before. Parts of models may be the same."""
        if robot not in self._met:
            self._met.add(robot)
            if report.hash in self._hashes:
                self._ids.add(report.deployed)
        return report.deployed in self._ids

    def _on_strange_report(self, robot: str, reason: str) -> None:
        self._log(f"{robot}: its report: {reason}")

    def _perform(self, action: LateJoinerAction) -> None:
        if isinstance(action, Withdraw):
            if self._current is not None:
                self._current.refuse(_GONE_ON)
            return
        if isinstance(action, Withhold):
            self._log(f"{', '.join(action.robots)}: not supplied: {_GONE_ON}")
            return
        try:
            self._current = self._sender.send(
                self._definitions, self._on_end, only=action.robots, again=action.again, joins=self._newer
            )
            self._ids.add(self._current.id)
        except FameError as error:
            self._log(f"{', '.join(action.robots)}: {error}")
            self._protocol.handle(DeploymentEnded())

    def _on_end(self, deployment: Deployment) -> None:
        for robot, progress in deployment.robots.items():
            if progress.state == "started":
                self._protocol.handle(RobotStarted(robot))
            elif progress.called_off:
                self._protocol.handle(CalledOff(robot))
            self._log(str(progress))
        self.scheduler.soon(self._close_current)

    def _close_current(self) -> None:
        if self._current is not None:
            self._current.close()
            self._current = None
        self._protocol.handle(DeploymentEnded())
