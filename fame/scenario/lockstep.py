"""Whose turn it is where all keep step: the world says a time, and waits until every engine is done with it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from fame.clock import SECOND, Scheduler
from fame.middleware.interface import Message, Middleware, Node
from fame.middleware.simulated_time import STEP_DONE, STEP_DONE_TYPE, nanoseconds

_LOOK = SECOND
"""How often it is looked whether an engine that is waited for has left (ns)."""


class Rounds:
    """Who is waited for: the robots of the team, but those whose engine was there and left. `over` ends a round."""

    def __init__(
        self, team: Sequence[str], scheduler: Scheduler, middleware: Middleware, node: Node, over: Callable[[], object]
    ) -> None:
        self.team = dict.fromkeys(team)
        self._scheduler, self._middleware, self._over = scheduler, middleware, over
        self._seen: set[str] = set()
        self._waiting: set[str] = set()
        self._time = 0
        node.subscription(STEP_DONE, STEP_DONE_TYPE, self._heard)
        self._look = scheduler.after(_LOOK, self._drop_the_dead)

    @property
    def open(self) -> bool:
        """Whether somebody is waited for."""
        return bool(self._waiting)

    def begin(self, time: int) -> None:
        """Wait for everybody's word on `time` (ns)."""
        self._time, self._waiting = time, set(self.team)
        if not self._waiting:
            self._scheduler.soon(self._over)

    def close(self) -> None:
        """Wait no more."""
        self._look.cancel()
        self._waiting.clear()

    def _heard(self, message: Message) -> None:
        self._seen.add(message.frame_id)
        if nanoseconds(message.stamp) == self._time:
            self._finish(message.frame_id)

    def _finish(self, robot: str) -> None:
        if robot in self._waiting:
            self._waiting.remove(robot)
            if not self._waiting:
                self._over()

    def _drop_the_dead(self) -> None:
        if self._waiting & self._seen:
            ends = {name for info in self._middleware.graph() if info.name == STEP_DONE for name in info.publishers}
            there = {name.split("/")[1] for name in ends}
            for robot in self._seen - there:
                self.team.pop(robot, None)
                self._seen.discard(robot)
                self._finish(robot)
        self._look = self._scheduler.after(_LOOK, self._drop_the_dead)
