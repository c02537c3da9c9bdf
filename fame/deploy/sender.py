"""The sender's end of a deployment: one model, sent to its robots; all start, or none does.

`fame.deploy.sender_protocol` decides; here are the topics, the timers, the signatures and the parts of the model.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from fame.bpmn.library import Library
from fame.bpmn.model import Definitions
from fame.bpmn.pools import Pool
from fame.bpmn.split import split
from fame.clock import SECOND, Entry, Kind, Scheduler
from fame.deploy.assignment import SourceMap, assign_robots, promises, receivers
from fame.deploy.authentication import ReportReader
from fame.deploy.envelope import (
    PROCESS_QOS,
    STATUS_QOS,
    STRING,
    Envelope,
    Report,
    engines,
    is_ahead,
    model_hash,
    signed,
)
from fame.deploy.loading import LoadingTask, Work
from fame.deploy.machine import ProtocolMachine, boundary
from fame.deploy.migration import Foreseen
from fame.deploy.options import DeploymentOptions
from fame.deploy.sender_protocol import (
    Approve,
    Approved,
    Begun,
    CancelTimers,
    Closed,
    End,
    PatienceEnded,
    Prepare,
    Refused,
    RivalFound,
    RobotAnswered,
    RobotProgress,
    SendEnvelope,
    SenderAction,
    SenderEvent,
    SenderState,
    StartTimer,
    StatusReceived,
    TimerFired,
    step,
)
from fame.errors import FameError
from fame.middleware import messages
from fame.middleware.interface import Middleware, Node

_REST = 20.0
"""The part of a long patience that is left when robots stop waiting for the other ends of their topics (s)."""


class _ModelParts:
    """The parts of a model, each for a robot. Raises what `Deployment` does."""

    def __init__(self, definitions: Definitions, middleware: Middleware, options: DeploymentOptions) -> None:
        from fame.check.gate import refuse_errors

        library = options.library or Library()
        named = engines(middleware) if options.robots is None else options.robots
        pools = assign_robots(definitions, named, found=options.robots is None, only=options.only)
        self.pools: Mapping[str, Pool] = {
            robot: pool for robot, pool in pools.items() if not options.only or robot in options.only
        }
        self.robots = list(self.pools)
        refuse_errors(definitions, [pool.process for pool in self.pools.values()], library, sent=True)
        self._texts = {part.name: part.source.decode() for part in split(definitions, library)}
        self._promised = promises(definitions, pools, library)
        self._caught = receivers(definitions, pools, library)
        self.source_maps = {
            robot: SourceMap(robot, definitions, pool.process, library, self._texts[pool.name])
            for robot, pool in self.pools.items()
        }

    def of(self, robot: str) -> Mapping[str, Any]:
        """Return the fields of the envelope of a robot."""
        text = self._texts[self.pools[robot].name]
        promised, caught = self._promised[robot], self._caught[robot]
        return {"model": text, "hash": model_hash(text.encode()), "promises": promised, "receivers": caught}


class _KeptParts:
    """What robots keep themselves: each is sent the hashes alone."""

    def __init__(self, previous: Mapping[str, Mapping[str, Any]]) -> None:
        self.pools: Mapping[str, Pool] = {}
        self.robots, self._previous = list(previous), previous
        self.source_maps: dict[str, SourceMap] = {}

    def of(self, robot: str) -> Mapping[str, Any]:
        """Return the fields of the envelope of a robot."""
        return {name: self._previous[robot][name] for name in ("hash", "recalls")}


class Deployment:
    """One model, sent to its robots: all start, or none does.

    Instead of `definitions` it takes what each robot ran before, by its name, as its report says
    (`fame.deploy.history.History.previous`): robots keep that themselves.

    `decided` is called as soon as robots were told to start: nothing stops them then. `ended` is called once, when all
    have started or it is known that they will not; `robots` then has the result of each, and `envelopes` what each was
    sent.

    Raises ModelError, ConfigError and DeploymentError for what cannot be sent at all.
    """

    def __init__(
        self,
        definitions: Definitions | Mapping[str, Mapping[str, Any]],
        *,
        id: str,
        sequence: int,
        scheduler: Scheduler,
        middleware: Middleware,
        ended: Callable[[Deployment], object],
        decided: Callable[[], object] = lambda: None,
        options: DeploymentOptions | None = None,
    ) -> None:
        self._options = options = options or DeploymentOptions()
        self.id: str = id
        self.foreseen: dict[str, Foreseen] = {}
        self.scheduler: Scheduler = scheduler
        self.middleware: Middleware = middleware
        self._ended = ended
        self._decided: Callable[[], object] | None = decided
        parts: _KeptParts | _ModelParts
        if isinstance(definitions, Mapping):
            parts = _KeptParts(definitions)
        else:
            parts = _ModelParts(definitions, middleware, options)
        sent = parts.robots
        self.pools: Mapping[str, Pool] = parts.pools
        self._patience: float = options.patience_of(len(sent))
        state = SenderState(
            tuple(map(RobotProgress, sent)),
            sequence=sequence,
            signed=options.key is not None,
            migrates=options.migrate,
            preview=options.preview,
        )
        self._protocol: ProtocolMachine[SenderState, SenderEvent, SenderAction] = ProtocolMachine(
            state, step, self._perform
        )
        self.envelopes: dict[str, Envelope] = {robot: self._load(robot, parts.of(robot), sent) for robot in sent}
        self._source_maps = parts.source_maps
        self._limit: Entry | None = None
        self._timer: Entry | None = None
        self._known: dict[str, Report] = {}  # the last report of each, whatever it is about
        self.told: dict[str, Report] = {}
        """The last report of each robot that runs this model, and that answers nobody."""
        self._differs: dict[str, str] = {}  # what to say of the protocol of each
        self._readers = {robot: ReportReader.of_sender(robot, options.key) for robot in sent}
        self.node: Node = middleware.node("_fame_deploy")
        self._out = {robot: self.node.publisher(f"/{robot}/bpmn_process", STRING, PROCESS_QOS) for robot in sent}
        for robot in sent:
            on_report = boundary(partial(self._on_report, robot), partial(self._on_strange_report, robot))
            self.node.subscription(f"/{robot}/bpmn_status", STRING, on_report, STATUS_QOS)

    def _load(self, robot: str, part: Mapping[str, Any], team: Sequence[str]) -> Envelope:
        """The envelope with the part of a robot."""
        return replace(
            self._envelope(robot, "load"),
            **part,
            matching=max(self._patience / 2, self._patience - _REST),
            team=team,
            again=robot in self._options.again,
            joins=robot in self._options.joins,
            migrate=self._options.migrate,
            plan=dict(self._options.plan),
            preview=self._options.preview,
            who=self._options.who,
        )

    @property
    def robots(self) -> dict[str, RobotProgress]:
        """How far each robot is; of one without success, also which protocol it speaks, if that differs."""
        robots = {each.robot: each for each in self._protocol.state.robots}
        for robot, text in self._differs.items():
            robot_progress = robots[robot]
            if text and not robot_progress.called_off and robot_progress.state in ("silent", "refused"):
                robots[robot] = replace(robot_progress, reason="; ".join(filter(None, (robot_progress.reason, text))))
        return robots

    @property
    def started(self) -> list[str]:
        """The robots that have started; perhaps not all, if it `failed`."""
        return [robot for robot, progress in self.robots.items() if progress.state == "started"]

    @property
    def reports(self) -> dict[str, Report]:
        """The last report of each robot, with the places of errors in the files of the model."""
        return {robot: self._in_files(report) for robot, report in self._known.items()}

    def _in_files(self, report: Report) -> Report:
        """A report with the places of errors in the files of the model, if that is here."""
        source_map = self._source_maps.get(report.robot)
        return source_map.report(report) if source_map is not None else report

    @property
    def sequence(self) -> int:
        """The number that orders it among other deployments: above what its robots had seen before."""
        return self._protocol.state.sequence

    @property
    def done(self) -> bool:
        return self._protocol.state.phase == "over"

    @property
    def failed(self) -> bool:
        """Whether it is over and not all have started."""
        return self._protocol.state.failed

    def begin(self) -> None:
        """Send every robot its part, in a moment."""
        patience = self._patience
        self._limit = self._after(patience, lambda: self._protocol.handle(PatienceEnded(patience)))
        self._protocol.handle(Begun(self.scheduler.now))

    def source_map(self, robot: str) -> SourceMap:
        """Where what a robot reports of its file is in the files of the model."""
        return self._source_maps[robot]

    def refuse(self, reason: str) -> None:
        """End it for this reason, unless robots were told to start."""
        self._protocol.handle(Refused(reason))

    def close(self) -> None:
        """Close all endpoints; what was not decided yet is aborted."""
        self._protocol.handle(Closed())
        self.node.close()

    # ---- what robots report ----------------------------------------------------------------------------------------

    def _on_report(self, robot: str, message: Any) -> None:
        report = self._readers[robot].read(message.data)
        if self._readers[robot].rival:
            self._protocol.handle(RivalFound(robot))
        if report is None:
            if self._readers[robot].strange:
                self._protocol.handle(RobotAnswered(robot, "", self._readers[robot].strange, self.scheduler.now))
            return
        self._known[robot] = report
        if not report.deployment:
            self._differs[robot] = report.differs
            if report.deployed == self.id:
                self.told[robot] = report
            if report.answer == "refused" and self.robots[robot].state == "silent":  # to nobody: it may not read ours
                text = f"did not answer; it refused a message: {report.reason}"
                self._protocol.handle(RobotAnswered(robot, "", text, self.scheduler.now))
        ahead = is_ahead(report.sequence, self._options.wall_time())
        self._protocol.handle(StatusReceived(robot, -1 if ahead else report.sequence))
        if report.deployment == self.id and not self.done:
            if report.migration:
                self.foreseen[robot] = Foreseen.from_json(report.migration)
            reason = self._in_files(report).reason
            self._protocol.handle(RobotAnswered(robot, report.answer, reason, self.scheduler.now))

    def _on_strange_report(self, robot: str, reason: str) -> None:
        self._protocol.handle(RobotAnswered(robot, "refused", f"its report: {reason}", self.scheduler.now))

    # ---- what is sent ----------------------------------------------------------------------------------------------

    def _perform(self, action: SenderAction) -> None:
        match action:
            case Prepare():
                known = {robot: report.engine for robot, report in self._known.items()}
                self.envelopes = {
                    robot: replace(
                        envelope, sequence=self.sequence, silence=self._protocol.state.silence, engines=known
                    )
                    for robot, envelope in self.envelopes.items()
                }
            case SendEnvelope(robot, "load"):
                self._send(robot, self.envelopes[robot])
            case SendEnvelope(robot, phase, begun):
                self._send(robot, replace(self._envelope(robot, phase), begun=begun))
                if phase == "start" and self._decided is not None:
                    self.scheduler.soon(self._decided)
                    self._decided = None
            case StartTimer(seconds):
                self._cancel(self._timer)
                self._timer = self._after(seconds, self._on_timer)
            case CancelTimers():
                self._cancel(self._timer)
                self._cancel(self._limit)
            case Approve():
                Work(self.scheduler, self._approval(), self._on_approved)
            case End():
                self._ended(self)

    def _approval(self) -> LoadingTask[str]:
        """Look at what is foreseen, in a thread."""
        refusal: str = yield partial(self._options.approve, self.pools, dict(self.foreseen))
        return refusal

    def _on_approved(self, result: str | FameError) -> None:
        self._protocol.handle(Approved(str(result), self.scheduler.now))

    def _envelope(self, robot: str, phase: str) -> Envelope:
        return Envelope(deployment=self.id, sequence=self.sequence, robot=robot, phase=phase)

    def _send(self, robot: str, envelope: Envelope) -> None:
        if self._options.key is not None:
            if robot not in self._known:
                return  # it would refuse what was not signed for this engine of it
            envelope = signed(envelope, self._options.key, born=self._known[robot].born, now=self._options.wall_time())
        self._out[robot].publish(messages.create(STRING, envelope.to_json()))

    # ---- timers ----------------------------------------------------------------------------------------------------

    def _on_timer(self) -> None:
        self._protocol.handle(TimerFired(self.scheduler.now))

    def _after(self, seconds: float, action: Callable[[], object]) -> Entry:
        return self.scheduler.after(round(seconds * SECOND), action, Kind.TIMER)

    def _cancel(self, entry: Entry | None) -> None:
        if entry is not None:
            entry.cancel()


class Sender:
    """Sends models, each in a `Deployment` whose id begins with `name`, ordered by the time of `options`."""

    scheduler: Scheduler
    middleware: Middleware
    options: DeploymentOptions

    def __init__(self, name: str, scheduler: Scheduler, middleware: Middleware, options: DeploymentOptions) -> None:
        self._name, self._sequence = name, 0
        self.scheduler, self.middleware, self.options = scheduler, middleware, options

    def send(
        self,
        definitions: Definitions | Mapping[str, Mapping[str, Any]],
        ended: Callable[[Deployment], object],
        *,
        decided: Callable[[], object] = lambda: None,
        only: Sequence[str] = (),
        again: Collection[str] = (),
        joins: Collection[str] = (),
    ) -> Deployment:
        """Begin a deployment. Raises what `Deployment` does."""
        self._sequence = max(self._sequence + 1, round(self.options.wall_time() * 1e6))
        deployment = Deployment(
            definitions,
            id=f"{self._name}-{self._sequence}",
            sequence=self._sequence,
            scheduler=self.scheduler,
            middleware=self.middleware,
            ended=ended,
            decided=decided,
            options=replace(self.options, only=only, again=again, joins=joins),
        )
        deployment.begin()
        return deployment
