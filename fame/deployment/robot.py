"""The robot's end of a deployment: it takes a process, runs it, and takes the next one."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from typing import Any

from fame.clock import SECOND, Entry, Kind, Scheduler
from fame.deployment.envelope import PROCESS_QOS, STRING, Envelope, Report, read_envelope
from fame.errors import DeploymentError, FameError
from fame.library import Library
from fame.middleware import messages
from fame.middleware.interface import LATCHED, Middleware
from fame.node import Event, RobotNode, Service, mission
from fame.signing import verify

MATCHING = 5.0
"""How long a robot waits for the other ends of its topics (s)."""
HEARTBEAT = 1.0
"""How often a robot repeats how it stands (s)."""
_POLL = 0.02
_KEPT = 10  # instances that an engine remembers


class EngineNode:
    """One robot's end: it takes a process, runs it, and takes the next one.

    `observer`, `safe_state` and others: as of `fame.node.RobotNode`. With `trusted` public keys it takes only what one
    of them signed; `wall_time` gives s since 1970. `time` is the scheduler of the mission if that is not `scheduler`:
    one of simulated time. `close` brings the robot to its safe state and leaves.
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
        time: Scheduler | None = None,
    ) -> None:
        self._trusted, self._wall_time = trusted, wall_time
        self.robot, self.scheduler, self.middleware = robot, scheduler, middleware
        self._time = time or scheduler
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
            scheduler=self._time,
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
