"""A process that is to take the place of what runs, from the envelope that brought it until it runs or is dropped.

::

    loading ──the ends of others are there──> ready ──start──> leaving ──scripts of the old one are out──> it runs
       │                                        │
       └──abort, a newer one, nobody came       └──abort, or nobody was told to start ──> dropped

Who has said ``ready`` has given its word: it neither drops the process nor takes a newer one before the sender has
decided, since others may have been told to start already. If the sender falls silent, they are asked (`abandoned`).
A bare model comes from nobody who could say more: it is never ready, and starts when it is loaded.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum
from functools import partial
from typing import TYPE_CHECKING, Protocol

from fame.clock import SECOND, Entry, Kind, Scheduler
from fame.deployment.abandoned import Inquiry
from fame.deployment.envelope import SILENCE, Envelope
from fame.deployment.loading import missing
from fame.middleware.interface import Middleware, Node

if TYPE_CHECKING:
    from fame.node import RobotNode

MATCHING = 5.0
"""How long a robot waits for the other ends of its topics (s)."""
_POLL = 0.02
_LEAVING = 2.5  # s that scripts may take to leave, should their own clock stand


class Stage(Enum):
    """See the module."""

    LOADING = "loading"
    READY = "ready"
    LEAVING = "leaving"


class Robot(Protocol):
    """Who is told how it goes."""

    def ready(self, candidate: Candidate) -> None: ...

    def start(self, candidate: Candidate) -> None: ...

    def drop(self, answer: str, reason: str) -> None: ...


class Candidate:
    """See the module. `process` is loaded; `node` is who asks the other robots."""

    def __init__(
        self,
        envelope: Envelope,
        process: RobotNode,
        robot: Robot,
        *,
        node: Node,
        scheduler: Scheduler,
        middleware: Middleware,
    ) -> None:
        self.envelope, self.process, self.stage = envelope, process, Stage.LOADING
        self._robot, self._node, self._scheduler, self._middleware = robot, node, scheduler, middleware
        self._next: Entry | None = None
        self._inquiry: Inquiry | None = None

    @property
    def deployment(self) -> str:
        """What it came with."""
        return self.envelope.deployment

    def begin(self) -> None:
        """Wait for the ends that others promised; without a promise it is ready at once."""
        self._look(self._scheduler.now + round(MATCHING * SECOND))

    def _look(self, until: int) -> None:
        absent = missing(self.envelope.promises, self.process.namespace, self._middleware)
        if (absent or self._middleware.connecting(self.process.node)) and self._scheduler.now < until:
            self._after(_POLL, partial(self._look, until))
        elif absent:
            self._robot.drop("refused", f"nobody came to {', '.join(absent)} within {MATCHING:g} s")
        elif self.envelope.phase == "run":
            self._robot.start(self)
        else:
            self.stage = Stage.READY
            self.hold()
            self._robot.ready(self)

    def hold(self) -> None:
        """Its sender spoke a moment ago: if it is ready, it waits on."""
        if self.stage is Stage.READY:
            self._rest()
            self._after(SILENCE, self._inquire)

    def _inquire(self) -> None:
        """The sender fell silent: do what the others did."""
        others = [robot for robot in self.envelope.team if robot != self.process.namespace]
        self._inquiry = Inquiry(self.deployment, others, self._node, self._scheduler, self._decided)

    def _decided(self, started: bool) -> None:
        if started:
            self._robot.start(self)
        else:
            text = f"the sender said nothing for {SILENCE:g} s, and nobody was told to start"
            self._robot.drop("aborted", text)

    def replace(self, old: RobotNode | None, begin: Callable[[], object]) -> None:
        """Cancel the old process; `begin` is called when its scripts are out."""
        self._rest()
        self.stage = Stage.LEAVING
        if old is not None:
            old.stop()
        self._await_leaving(old, begin, self._scheduler.now + round(_LEAVING * SECOND))

    def _await_leaving(self, old: RobotNode | None, begin: Callable[[], object], until: int) -> None:
        if old is not None and old.leaving and self._scheduler.now < until:
            self._after(_POLL, partial(self._await_leaving, old, begin, until))
        else:
            begin()

    def close(self) -> None:
        """Forget it."""
        self._rest()
        self.process.close()

    def _after(self, delay: float, action: Callable[[], object]) -> None:
        self._next = self._scheduler.after(round(delay * SECOND), action, Kind.TIMER)

    def _rest(self) -> None:
        if self._next is not None:
            self._next.cancel()
        if self._inquiry is not None:
            self._inquiry.close()
        self._next = self._inquiry = None
