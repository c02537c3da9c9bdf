"""The sender's end of a deployment: one model, sent to its robots; all start, or none does."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

from fame.bpmn.model import Definitions
from fame.clock import SECOND, Entry, Kind, Scheduler
from fame.deployment.envelope import PROCESS_QOS, STATUS_QOS, STRING, Envelope, Report, model_hash
from fame.errors import DeploymentError
from fame.library import Library
from fame.middleware import messages
from fame.middleware.interface import Middleware
from fame.signing import sign
from fame.splitter import Pool, bind, pools_of, shared_topics, split

PATIENCE = 10.0
"""How long a deployment waits for a robot (s)."""
AGAIN = 1.0
"""After how long a deployment asks again a robot that did not answer (s); asking twice has no effect but the answer."""


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
