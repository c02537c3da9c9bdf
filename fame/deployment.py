"""Sending robots their processes, over topics (DESIGN section 6).

An `EngineNode` is a robot's end: it waits on ``/<robot>/bpmn_process``, and says how it stands on
``/<robot>/bpmn_status``. A `Deployment` is the other end: it sends every robot its part, waits for each, and starts
all or none.

Two phases. *Load*: check, compile, make endpoints, wait until the ends that the collaboration promises are there; the
old process runs on. *Start*, when all are ready: the old process is cancelled safely, the new one begins. Otherwise
*abort*, and everybody keeps what it had. A bare model from a plain publisher loads and starts at once.

What goes over ``bpmn_process`` is a .bpmn text, or an `Envelope` as JSON; over ``bpmn_status`` a `Report` as JSON.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from typing import Any

from fame.bpmn.model import Definitions
from fame.clock import SECOND, Entry, Kind, Scheduler
from fame.errors import DeploymentError, FameError
from fame.library import Library
from fame.middleware import messages
from fame.middleware.interface import LATCHED, Middleware, QoS
from fame.node import Event, RobotNode, Service, mission
from fame.signing import sign, verify
from fame.splitter import Pool, bind, pools_of, shared_topics, split

STRING = "std_msgs/msg/String"
PROCESS_QOS = QoS(depth=20)
"""Reliable and volatile, so that any publisher matches."""

MATCHING = 5.0
"""How long a robot waits for the other ends of its topics (s)."""
HEARTBEAT = 1.0
"""How often a robot repeats how it stands (s)."""
PATIENCE = 10.0
"""How long a deployment waits for a robot (s)."""
AGAIN = 1.0
"""After how long a deployment asks again a robot that did not answer (s); asking twice has no effect but the answer."""
STATUS_QOS = QoS(durability="transient_local", depth=100)
"""How a report is listened to: the last one of a robot that spoke before, and every one from then on."""
_POLL = 0.02
_SIZE = 20_000_000
_KEPT = 10  # instances that an engine remembers


@dataclass(frozen=True, slots=True, kw_only=True)
class Envelope:
    """What a robot is told. `promises`: public topics at which others have the opposite end, as ``publisher`` or
    ``subscriber``. `issued` (s since 1970) and `signature` are there where keys are used (`fame.signing`)."""

    deployment: str
    sequence: int
    robot: str
    phase: str
    hash: str = ""
    model: str = ""
    promises: Mapping[str, str] = field(default_factory=dict)
    issued: float = 0.0
    signature: str = ""

    def to_json(self) -> str:
        """As it is sent."""
        return json.dumps({"fame": 1, **asdict(self)}, sort_keys=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """How a robot stands, and what it answers to which deployment.

    state   ``waiting`` (for its first process), ``loading``, ``ready``, ``running``, ``idle`` (no instance), ``failed``
    instances, started, completed, failed      how many run now, have started, completed and failed with this process
    answer  ``ready``, ``started``, ``refused``, ``superseded``, ``aborted``, ``stale``; empty if it is no answer
    """

    robot: str
    state: str
    hash: str = ""
    deployment: str = ""
    answer: str = ""
    reason: str = ""
    instances: int = 0
    started: int = 0
    completed: int = 0
    failed: int = 0
    waits: Sequence[Mapping[str, str]] = ()
    error: str = ""
    time: float = 0.0

    def to_json(self) -> str:
        """As it is sent."""
        return json.dumps(asdict(self), sort_keys=True)

    @classmethod
    def from_json(cls, text: str) -> Report | None:
        """A report, or None if the text is none."""
        try:
            return cls(**json.loads(text))
        except (ValueError, TypeError):
            return None


def model_hash(model: bytes) -> str:
    """What names a model."""
    return hashlib.sha256(model).hexdigest()


def read_envelope(text: str, robot: str) -> Envelope:
    """What came in: a bare model becomes an envelope of its own. Raises DeploymentError."""
    if len(text) > _SIZE:
        raise DeploymentError(f"{len(text)} characters; at most {_SIZE} are taken")
    if text.lstrip().startswith("<"):
        key = model_hash(text.encode())
        return Envelope(deployment=f"plain-{key[:12]}", sequence=-1, robot=robot, phase="run", hash=key, model=text)
    try:
        said = json.loads(text)
        said.pop("fame")
        envelope = Envelope(**said)
    except (ValueError, TypeError, KeyError, AttributeError):
        raise DeploymentError(f"neither a .bpmn text nor an envelope: {text[:60]!r}") from None
    if envelope.robot.casefold() != robot.casefold():
        raise DeploymentError(f"meant for robot {envelope.robot!r}, not for {robot!r}")
    if envelope.phase == "load" and model_hash(envelope.model.encode()) != envelope.hash:
        raise DeploymentError("the model does not have the hash that the envelope says")
    return envelope


class EngineNode:
    """One robot's end: it takes a process, runs it, and takes the next one.

    `observer`, `safe_state` and others: as of `fame.node.RobotNode`. With `trusted` public keys it takes only what one
    of them signed; `wall_time` gives s since 1970. `close` brings the robot to its safe state and leaves.
    """

    def __init__(
        self,
        robot: str,
        *,
        scheduler: Scheduler,
        middleware: Middleware,
        library: Library | None = None,
        services: Mapping[str, Service] | None = None,
        observer: Callable[[Event], object] | None = None,
        on_report: Callable[[Event], object] | None = None,
        safe_state: Sequence[tuple[str, str, Mapping[str, Any]]] = (),
        safe_suspended: Sequence[tuple[str, str, Mapping[str, Any]]] | None = None,
        trusted: Sequence[Any] = (),
        wall_time: Callable[[], float] = time.time,
    ) -> None:
        self._trusted, self._wall_time = trusted, wall_time
        self.robot, self.scheduler, self.middleware = robot, scheduler, middleware
        self._library, self._services = library, services
        self._options: dict[str, Any] = {
            "observer": observer,
            "on_report": on_report,
            "safe_state": safe_state,
            "safe_suspended": safe_suspended,
        }
        self.running: RobotNode | None = None
        self.hash = ""
        self._loaded: tuple[Envelope, RobotNode] | None = None
        self._loading: Entry | None = None
        self._last: Envelope | None = None
        self._done: dict[str, str] = {}
        self._waiting: Envelope | None = None
        self.node = middleware.node("fame_deployment", robot)
        self._status = self.node.publisher("bpmn_status", STRING, LATCHED)
        self.node.subscription("bpmn_process", STRING, self._heard, PROCESS_QOS)
        self._beat()

    # ---- saying how it stands --------------------------------------------------------------------------------------

    @property
    def state(self) -> str:
        """See `Report`."""
        if self._loaded is not None:
            return "loading" if self._loading is not None else "ready"
        if self.running is None:
            return "waiting"
        if any(instance.status == "failed" for instance in self.running.instances[-1:]):
            return "failed"
        return "running" if self.running.engine.instances else "idle"

    def report(self, answer: str = "", deployment: str = "", reason: str = "") -> None:
        """Say how it stands, perhaps as an answer."""
        node = self.running
        last = node.instances[-1].error if node is not None and node.instances else None
        report = Report(
            robot=self.robot,
            state=self.state,
            hash=self.hash,
            deployment=deployment,
            answer=answer,
            reason=reason,
            instances=len(node.engine.instances) if node is not None else 0,
            started=node.started if node is not None else 0,
            completed=node.completed if node is not None else 0,
            failed=node.failed if node is not None else 0,
            waits=[{"element": wait.element, "for": wait.text} for wait in node.waits()] if node is not None else [],
            error=str(last) if last is not None else "",
            time=self.scheduler.now / SECOND,
        )
        self._status.publish(messages.create(STRING, report.to_json()))

    def _beat(self) -> None:
        self.report()
        self._pulse = self.scheduler.after(round(HEARTBEAT * SECOND), self._beat, Kind.TIMER)

    # ---- what it is told -------------------------------------------------------------------------------------------

    def _heard(self, message: Any) -> None:
        said = ""
        try:
            envelope = read_envelope(message.data, self.robot)
            said = envelope.deployment
            if self._trusted:
                verify(asdict(envelope), self._trusted, self._wall_time())
        except DeploymentError as error:
            self.report("refused", said, str(error))
            return
        if envelope.phase in ("start", "abort"):
            self._decide(envelope)
        elif envelope.sequence >= 0 and (envelope.deployment in self._done or self._under_way(envelope)):
            self.report(self._done.get(envelope.deployment, ""), envelope.deployment)
        elif self._last is not None and 0 <= envelope.sequence < self._last.sequence:
            reason = f"sequence {envelope.sequence} is older than {self._last.sequence}"
            self.report("stale", envelope.deployment, reason)
        else:
            if self._waiting is not None:
                self._answer("superseded", self._waiting)
            elif self._loading is None or self._loaded is not None:
                self.scheduler.soon(self._load_newest, Kind.RESUMPTION)
            self._waiting = envelope

    def _under_way(self, envelope: Envelope) -> bool:
        """Whether it is being dealt with already."""
        others = (self._waiting, self._loaded[0] if self._loaded is not None else None)
        return any(other is not None and other.deployment == envelope.deployment for other in others)

    def _answer(self, answer: str, envelope: Envelope, reason: str = "") -> None:
        self._done[envelope.deployment] = answer
        self.report(answer, envelope.deployment, reason)

    def _load_newest(self) -> None:
        envelope, self._waiting = self._waiting, None
        if envelope is None:
            return
        self._drop_loaded("superseded")
        self._last = envelope if envelope.sequence >= 0 else self._last
        try:
            node = self._build(envelope)
        except FameError as error:
            self._answer("refused", envelope, str(error))
            return
        self._loaded = (envelope, node)
        self._await_ends(envelope, self.scheduler.now + round(MATCHING * SECOND))

    def _build(self, envelope: Envelope) -> RobotNode:
        from fame.bpmn.reader import read_text
        from fame.simulation import choose_process

        definitions = read_text(envelope.model, file=f"{self.robot}.bpmn")
        pools = [pool for pool in definitions.participants if pool.process]
        process = choose_process(definitions, pools[0].process if len(pools) == 1 else None)
        node = RobotNode(
            self.robot,
            mission(definitions, process, library=self._library, services=self._services),
            scheduler=self.scheduler,
            middleware=self.middleware,
            keep=_KEPT,
            on_end=lambda instance: self.report(),
            **self._options,
        )
        try:
            node.load()
        except FameError:
            node.close()
            raise
        return node

    def _await_ends(self, envelope: Envelope, until: int) -> None:
        """Ready when every promised end is there; without a promise, at once."""
        self._loading = None
        missing = self._missing(envelope)
        if not missing:
            if envelope.phase == "run":
                self._begin()
            else:
                self._answer("ready", envelope)
        elif self.scheduler.now >= until:
            self._drop_loaded("")
            self._answer("refused", envelope, f"nobody came to {', '.join(missing)} within {MATCHING:g} s")
        else:
            again = partial(self._await_ends, envelope, until)
            self._loading = self.scheduler.after(round(_POLL * SECOND), again, Kind.TIMER)

    def _missing(self, envelope: Envelope) -> list[str]:
        """Promised ends that are not there, as ``topic (publisher)``."""
        if not envelope.promises:
            return []
        graph = {info.name: info for info in self.middleware.graph()}
        missing = []
        for topic, end in envelope.promises.items():
            info = graph.get(topic)
            ends = () if info is None else info.publishers if end == "publisher" else info.subscribers
            if not any(not name.startswith(f"/{self.robot}/") for name in ends):
                missing.append(f"{topic} ({end})")
        return missing

    def _decide(self, envelope: Envelope) -> None:
        """Start or abort what is loaded."""
        loaded = self._loaded
        if loaded is None or loaded[0].deployment != envelope.deployment:
            known = self._done.get(envelope.deployment)
            self.report(known or "refused", envelope.deployment, "" if known else "no such deployment is loaded here")
        elif envelope.phase == "start":
            self._begin()
        else:
            self._drop_loaded("aborted")

    def _drop_loaded(self, answer: str) -> None:
        """Forget what is loaded; what runs goes on."""
        if self._loading is not None:
            self._loading.cancel()
            self._loading = None
        if self._loaded is not None:
            envelope, node = self._loaded
            self._loaded = None
            node.close()
            if answer:
                self._answer(answer, envelope)

    def _begin(self) -> None:
        """Cancel the old process safely, and let the new one begin."""
        assert self._loaded is not None
        (envelope, node), self._loaded = self._loaded, None
        old, self.running, self.hash = self.running, node, envelope.hash
        if old is not None:
            old.stop()
            old.close()
        node.start()
        self._answer("started", envelope)

    def close(self) -> None:
        """Stop safely and leave."""
        self._pulse.cancel()
        self._drop_loaded("")
        if self.running is not None:
            self.running.stop()
            self.running.close()
        self.node.close()


# ---- the other end ---------------------------------------------------------------------------------------------------


@dataclass(slots=True)
class Standing:
    """How far one robot is. `state` is its last answer, or ``silent``."""

    robot: str
    pool: Pool
    envelope: Envelope
    state: str = "silent"
    reason: str = ""
    since: float = 0.0


class Deployment:
    """One model, sent to its robots: all start, or none does.

    `robots` are the namespaces to play it (by default all that have an engine); `only` restricts it to some of them;
    `key` signs what is sent. `ended` is called once, when all have started or it is known that they will not;
    `standings` then tell the rest.
    """

    def __init__(
        self,
        definitions: Definitions,
        *,
        id: str,
        sequence: int,
        scheduler: Scheduler,
        middleware: Middleware,
        ended: Callable[[Deployment], object],
        robots: Sequence[str] | None = None,
        only: Sequence[str] = (),
        library: Library | None = None,
        patience: float = PATIENCE,
        key: Any = None,
        wall_time: Callable[[], float] = time.time,
    ) -> None:
        self._key, self._wall_time = key, wall_time
        self.id, self.sequence, self.scheduler, self.middleware = id, sequence, scheduler, middleware
        self._ended, self._patience = ended, patience
        library = library or Library()
        pools = pools_of(definitions)
        cast = bind(pools, robots if robots is not None else engines(middleware), file=definitions.file)
        unknown = [name for name in only if name not in cast]
        if unknown:
            raise DeploymentError(f"no engine of a robot named {', '.join(unknown)}; there are {', '.join(cast)}")
        parts = {part.name: part.source.decode() for part in split(definitions, library)}
        promised = promises(definitions, cast, library)
        self.standings = {
            robot: Standing(robot, pool, self._envelope(robot, "load", parts[pool.name], promised[robot]))
            for robot, pool in cast.items()
            if not only or robot in only
        }
        self.done = False
        self.failed = False
        self._limit: Entry | None = None
        self._again: Entry | None = None
        self._phase = ""
        self.node = middleware.node("fame_deploy")
        self._out = {
            robot: self.node.publisher(f"/{robot}/bpmn_process", STRING, PROCESS_QOS) for robot in self.standings
        }
        for robot in self.standings:
            self.node.subscription(f"/{robot}/bpmn_status", STRING, partial(self._heard, robot), STATUS_QOS)

    def _envelope(self, robot: str, phase: str, model: str = "", promised: Mapping[str, str] | None = None) -> Envelope:
        return Envelope(
            deployment=self.id,
            sequence=self.sequence,
            robot=robot,
            phase=phase,
            hash=model_hash(model.encode()) if model else "",
            model=model,
            promises=promised or {},
        )

    def begin(self) -> None:
        """Send every robot its part."""
        self._phase = "load"
        self._ask()
        self._limit = self.scheduler.after(round(self._patience * SECOND), self._give_up, Kind.TIMER)

    def _ask(self) -> None:
        """Tell all who have not answered what is wanted of them, until it is over."""
        if self.done:
            return
        for robot, standing in self.standings.items():
            if self._phase == "start" and standing.state != "started":
                self._send(robot, self._envelope(robot, "start"))
            elif standing.state == "silent":
                self._send(robot, standing.envelope)
        self._again = self.scheduler.after(round(AGAIN * SECOND), self._ask, Kind.TIMER)

    def _send(self, robot: str, envelope: Envelope) -> None:
        if self._key is not None:
            envelope = replace(envelope, issued=self._wall_time())
            envelope = replace(envelope, signature=sign(asdict(envelope), self._key))
        self._out[robot].publish(messages.create(STRING, envelope.to_json()))

    def _heard(self, robot: str, message: Any) -> None:
        report = Report.from_json(message.data)
        if report is None or report.deployment != self.id or not report.answer or self.done:
            return
        standing = self.standings[robot]
        standing.state, standing.reason = report.answer, report.reason
        standing.since = self.scheduler.now / SECOND
        states = {each.state for each in self.standings.values()}
        if report.answer in ("refused", "stale", "superseded", "aborted"):
            self._finish(failed=True)
        elif states == {"ready"} and self._phase == "load":
            self._phase = "start"
            if self._again is not None:
                self._again.cancel()
            self._ask()
        elif states == {"started"}:
            self._finish(failed=False)

    def _give_up(self) -> None:
        for standing in self.standings.values():
            if standing.state == "silent":
                standing.reason = f"did not answer within {self._patience:g} s"
        self._finish(failed=True)

    def _finish(self, failed: bool) -> None:
        if self.done:
            return
        self.done, self.failed = True, failed
        for entry in (self._limit, self._again):
            if entry is not None:
                entry.cancel()
        if failed:
            for name in self.standings:
                self._send(name, self._envelope(name, "abort"))
        self._ended(self)

    def close(self) -> None:
        """Leave."""
        self.node.close()


def engines(middleware: Middleware) -> list[str]:
    """The robots (namespaces) that have an engine."""
    suffix = "/bpmn_status"
    return [
        info.name[1 : -len(suffix)] for info in middleware.graph() if info.name.endswith(suffix) and info.publishers
    ]


def promises(definitions: Definitions, cast: Mapping[str, Pool], library: Library) -> dict[str, dict[str, str]]:
    """For each robot, the public topics whose opposite end another robot of the collaboration has."""
    ends: dict[str, tuple[set[str], set[str]]] = {}
    for robot, pool in cast.items():
        for name, use in shared_topics(definitions, [pool], library).items():
            if not name.startswith("~/"):
                throws, catches = ends.setdefault(name, (set(), set()))
                if use.throws:
                    throws.add(robot)
                if use.catches:
                    catches.add(robot)
    found: dict[str, dict[str, str]] = {robot: {} for robot in cast}
    for name, (throws, catches) in ends.items():
        for robot in throws:
            if catches - {robot}:
                found[robot][name] = "subscriber"
        for robot in catches - throws:
            if throws - {robot}:
                found[robot][name] = "publisher"
    return found
