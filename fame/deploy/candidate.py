"""A process that is to take the place of what runs, from the envelope that brought it until it runs or is dropped.

::

    loading ──the ends of others are there──> ready ──start──> leaving ──scripts of the old one are out──> it runs
       │                                        │
       └──abort, a newer one, nobody came       └──abort, or nobody was told to start ──> dropped

A robot that is ``ready`` neither drops the process nor takes a newer one before it is decided, since others may have
been told to start already. If the sender falls silent they decide together: `termination` says how, and its actions are
carried out here. A bare model comes from nobody who could say more: it is never ready, and starts when it is loaded.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum
from functools import partial
from typing import TYPE_CHECKING, Protocol

from fame.clock import SECOND, Entry, Kind, Scheduler
from fame.deploy.envelope import SILENCE, Envelope
from fame.deploy.inquiry import Inquiry
from fame.deploy.loading import missing
from fame.deploy.termination import Abort, Action, Ask, Event, Ready, Report, Silence, Start, Wait, step
from fame.middleware.interface import Middleware, Node

if TYPE_CHECKING:
    from fame.robot import RobotNode

MATCHING = 5.0
"""How long a robot waits for the other ends of its topics (s)."""
ASKING = 1.0
"""How often the others are asked (s)."""
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

    def hold(self, candidate: Candidate, first: bool) -> None: ...

    def report(self, candidate: Candidate) -> None: ...


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
        self.commit: Ready | None = None  # once it is ready
        self._held = False

    @property
    def deployment(self) -> str:
        """What it came with."""
        return self.envelope.deployment

    @property
    def holds(self) -> bool:
        """Whether its sender fell silent, and the others are asked."""
        return self.commit is not None and self.commit.asking

    @property
    def why(self) -> str:
        """Why it holds."""
        unheard = sorted(self.commit.unheard) if self.commit is not None else ()
        return f"the sender fell silent, and what became of it at {', '.join(unheard)} is not known"

    def begin(self) -> None:
        """Wait for the ends that others promised; without a promise it is ready at once."""
        self._look(self._scheduler.now + round(MATCHING * SECOND))

    def _look(self, until: int) -> None:
        self.process.meet()
        absent = missing(self.envelope.promises, self.process.namespace, self._middleware)
        if (absent or self._middleware.connecting(self.process.node)) and self._scheduler.now < until:
            self._after(_POLL, partial(self._look, until))
        elif absent:
            self._robot.drop("refused", f"nobody came to {', '.join(absent)} within {MATCHING:g} s")
        elif self.envelope.phase == "run":
            self._robot.start(self)
        else:
            others = frozenset(self.envelope.team) - {self.process.namespace}
            self.stage, self.commit = Stage.READY, Ready(others)
            self._do(Wait())
            self._robot.ready(self)

    def happen(self, event: Event) -> None:
        """Something was said, or nothing for too long, while it is ready."""
        if self.stage is Stage.READY and self.commit is not None:
            self.commit, action = step(self.commit, event)
            self._do(action)

    def _do(self, action: Action | None) -> None:
        match action:
            case Wait():
                self._wait(SILENCE)
            case Ask():
                self._ask()
            case Report():
                self._robot.report(self)
            case Start():
                self._robot.start(self)
            case Abort(reason):
                self._robot.drop("aborted", reason)

    def _ask(self) -> None:
        """Others that are there answer at once, so that only who asks again has to hold."""
        again = self._inquiry is not None
        if self._inquiry is None and self.commit is not None:
            self._inquiry = Inquiry(self.envelope, sorted(self.commit.others), self._node, self.happen)
        if self._inquiry is not None:
            self._inquiry.ask()
        self._wait(ASKING)
        self._robot.report(self)
        if again:
            self._robot.hold(self, first=not self._held)
            self._held = True

    def _wait(self, seconds: float) -> None:
        if self._next is not None:
            self._next.cancel()
        self._after(seconds, lambda: self.happen(Silence()))

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
