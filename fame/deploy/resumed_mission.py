"""What a robot ran when its engine ended, on its way to go on: load it again, wait for its topics, continue."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from fame.clock import SECOND, Kind, Scheduler
from fame.deploy.loading import LoadedCandidate, LoadingTask, Work
from fame.errors import ConfigError, FameError
from fame.middleware.interface import Middleware, Node
from fame.middleware.simulated_time import ClockFollower

if TYPE_CHECKING:
    from fame.deploy.envelope import Envelope
    from fame.deploy.resumption import StateKeeper, StoredMission
    from fame.robot import RobotNode


class ResumedMission:
    """The mission in the directory of `keeper`, until it goes on or something else takes its place.

    time   the scheduler of the mission
    load   what loads the process of an envelope
    begin  called with the process, and the topics that are missing, before it goes on
    ended  called when it goes on
    """

    def __init__(
        self,
        keeper: StateKeeper,
        *,
        node: Node,
        scheduler: Scheduler,
        middleware: Middleware,
        time: Scheduler,
        load: Callable[[Envelope], LoadingTask[RobotNode]],
        begin: Callable[[RobotNode, Sequence[str]], object],
        ended: Callable[[], object],
    ) -> None:
        self._keeper, self._time = keeper, time
        self._load, self._begin, self._ended = load, begin, ended
        self._scheduler = scheduler
        self._node, self._middleware = node, middleware
        self._stored: StoredMission | None = None  # what is to go on
        self._candidate: LoadedCandidate | None = None  # the same, loaded

    @property
    def under_way(self) -> bool:
        """Whether a stored mission is being loaded, or waits for its topics."""
        return self._stored is not None

    def read(self, trusted: Sequence[Any]) -> Envelope | None:
        """Read what was running. Returns its deployment, None if nothing was.

        Raises ConfigError for a state that cannot be used.
        """
        self._stored = self._keeper.read(trusted)
        return self._stored.envelope if self._stored is not None else None

    def resume(self) -> None:
        """Load it, and let it go on. If it cannot be loaded, the scheduler's `run` raises ConfigError."""
        stored = self._stored
        if stored is not None:
            Work(self._scheduler, self._load(stored.envelope), partial(self._on_loaded, stored))

    def _on_loaded(self, stored: StoredMission, result: RobotNode | FameError) -> None:
        if isinstance(result, FameError):
            raise ConfigError(f"the mission cannot be resumed: {result}; --fresh starts over")
        if self._stored is not stored:
            result.close()
            return
        go_on = self._keeper.resume(stored, result)
        self._candidate = LoadedCandidate(
            stored.envelope, result, node=self._node, scheduler=self._scheduler, middleware=self._middleware
        )
        self._candidate.match(partial(self._go_on, go_on))

    def _go_on(self, go_on: Callable[[], object], missing: Sequence[str]) -> None:
        if self._candidate is None:
            return
        if isinstance(self._time, ClockFollower) and not self._time.known:  # timers count from the time of the world
            self._scheduler.after(SECOND // 50, partial(self._go_on, go_on, missing), Kind.TIMER)
            return
        process, self._candidate, self._stored = self._candidate.process, None, None
        self._begin(process, missing)
        go_on()
        self._ended()

    def drop(self) -> None:
        """Drop the mission: something else takes its place, or the engine ends."""
        self._stored = None
        if self._candidate is not None:
            self._candidate.close()
            self._candidate = None
