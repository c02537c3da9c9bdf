"""Whom a robot obeys: its mission, or a person who has taken it over.

As twist_mux of ROS 2 with a lock does: while `taken_over` (std_msgs/msg/Bool) is true, the robot ignores `cmd_vel` and
obeys `cmd_vel_manual`, slowly; at each change of hands it stops. A lock that is not renewed ends: its engine is gone.
"""

from __future__ import annotations

from typing import Protocol

from fame.clock import SECOND, Scheduler
from fame.middleware import messages
from fame.middleware.interface import AnyMessage, Node

TWIST = "geometry_msgs/msg/Twist"
DEAD_MAN = 0.3
"""For how long a person's command is valid, s."""
_LOCK = 5 * SECOND


class Driven(Protocol):
    """What obeys: a drive, a flight."""

    def command(self, twist: AnyMessage, now: int, *, by_hand: bool = False) -> None:
        """Obey a command given `now` (ns); one `by_hand` has a speed limit of its own and is valid for `DEAD_MAN`."""


class TwistMux:
    """Gives what comes on the topics of `node` to what is `driven`."""

    def __init__(self, node: Node, scheduler: Scheduler, driven: Driven) -> None:
        self._scheduler, self._driven = scheduler, driven
        self._locked_until = 0
        node.subscription("cmd_vel", TWIST, self._on_command)
        node.subscription("cmd_vel_manual", TWIST, self._on_manual)
        node.subscription("taken_over", "std_msgs/msg/Bool", self._on_lock)

    @property
    def _locked(self) -> bool:
        return self._scheduler.now < self._locked_until

    def _on_command(self, twist: AnyMessage) -> None:
        if not self._locked:
            self._driven.command(twist, self._scheduler.now)

    def _on_manual(self, twist: AnyMessage) -> None:
        if self._locked:
            self._driven.command(twist, self._scheduler.now, by_hand=True)

    def _on_lock(self, lock: AnyMessage) -> None:
        now, before = self._scheduler.now, self._locked
        self._locked_until = now + _LOCK if lock.data else 0
        if self._locked != before:
            self._driven.command(messages.create(TWIST), now)
