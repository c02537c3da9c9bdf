"""Keeping a team supplied: whoever comes late, or comes back, gets what the others have.

A `Keeper` listens to every engine that a pool of its model wants. Those that say ``waiting`` are sent their parts, all
that wait at that moment in one deployment, so that they find each other. Robots that have a process are left alone,
whatever it is. Where no part can be started yet, it is tried again.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from functools import partial
from typing import Any, Protocol

from fame.bpmn.model import Definitions
from fame.bpmn.pools import matches, pools_of
from fame.clock import SECOND, Entry, Kind, Scheduler
from fame.deploy.envelope import STATUS_QOS, STRING, engines
from fame.deploy.report_reader import GONE, ReportReader
from fame.deploy.sender import Deployment
from fame.errors import FameError
from fame.middleware.interface import Middleware, Subscription

LOOK = 0.5
"""How often it looks who is there (s)."""
AGAIN = 10.0
"""After how long robots that refused are sent their parts again (s)."""


class Send(Protocol):
    """Makes a deployment of the model to some robots, of which `again` had it before; `ended` is told when it is over.

    Raises FameError if that cannot be.
    """

    def __call__(
        self, only: Sequence[str], again: Collection[str], ended: Callable[[Deployment], object]
    ) -> Deployment: ...


class Keeper:
    """Keeps the robots of one model supplied until `close`. `served` are those that have it already.

    With the `key` of a sender only reports that engines signed count.
    """

    def __init__(
        self,
        definitions: Definitions,
        send: Send,
        *,
        scheduler: Scheduler,
        middleware: Middleware,
        key: Any = None,
        served: Collection[str] = (),
        say: Callable[[str], object] = lambda text: None,
    ) -> None:
        self._pools = pools_of(definitions)
        self._send, self._say = send, say
        self.scheduler, self.middleware = scheduler, middleware
        self.served = set(served)
        self._signed, self._trusted = key is not None, [key.public_key()] if key is not None else []
        self._states: dict[str, str] = {}
        self._not_before: dict[str, int] = {}
        self._current: Deployment | None = None
        self.node = middleware.node("fame_keeper")
        self._ends: dict[str, Subscription] = {}
        self._next: Entry = scheduler.soon(self._look, Kind.TIMER)

    def close(self) -> None:
        """Let them be."""
        self._next.cancel()
        if self._current is not None:
            self._current.close()
        self.node.close()

    def _look(self) -> None:
        """Listen to those who came, forget those who left, serve those who wait."""
        self._next = self.scheduler.after(round(LOOK * SECOND), self._look, Kind.TIMER)
        there = {robot for robot in engines(self.middleware) if any(matches(robot, pool) for pool in self._pools)}
        for robot in self._ends.keys() - there:
            self._ends.pop(robot).close()
            self._states.pop(robot, None)
            self._not_before.pop(robot, None)
        for robot in sorted(there - self._ends.keys()):
            reader = ReportReader(robot, signed=self._signed, trusted=self._trusted, patience=GONE)
            heard = partial(self._heard, reader)
            self._ends[robot] = self.node.subscription(f"/{robot}/bpmn_status", STRING, heard, STATUS_QOS)
        if self._current is None:
            self._serve()

    def _heard(self, reader: ReportReader, message: Any) -> None:
        report = reader.read(message.data, self.scheduler.now / SECOND)
        if report is not None:
            self._states[reader.robot] = report.state

    def _serve(self) -> None:
        now = self.scheduler.now
        late = [
            robot
            for robot, state in sorted(self._states.items())
            if state == "waiting" and self._not_before.get(robot, now) <= now
        ]
        if not late:
            return
        self._not_before.update(dict.fromkeys(late, now + round(AGAIN * SECOND)))
        try:
            self._current = self._send(late, self.served & set(late), self._ended)
        except FameError as error:
            self._say(f"{', '.join(late)}: {error}")

    def _ended(self, deployment: Deployment) -> None:
        for robot, progress in deployment.robots.items():
            if progress.state == "started":
                self.served.add(robot)
                self._states[robot] = "running"
                self._not_before.pop(robot, None)
            self._say(str(progress))
        self.scheduler.soon(self._close_current)

    def _close_current(self) -> None:
        if self._current is not None:
            self._current.close()
            self._current = None
