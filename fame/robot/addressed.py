"""Messages for one robot: ``order`` for Worker_2 goes over ``/Worker_2/bpmn_message/order``.

There a robot listens for each message that its events catch, besides the topic that reaches all. The end towards a
robot is made when that is seen first (`meet`), and what is sent before it is connected waits: a message for a robot
that is there is not lost to discovery.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

from fame.clock import SECOND, Entry, Scheduler
from fame.engine.host import BpmnError
from fame.middleware import messages
from fame.middleware.interface import Message, Middleware, Node, Publisher, QoS

_PATIENCE, _LOOK = 5 * SECOND, SECOND // 100
"""How long a message waits for its end to be connected, and how often that is looked at (ns)."""
_SHOWN = 5

Advertise = Callable[[str, str, QoS], Publisher]
"""Gives the publisher on a topic (full name, type, quality of service)."""


def address(topic: str, robot: str) -> str:
    """The full name of the topic over which a message (its qualified name) reaches one robot.

    >>> address("/order", "Worker_2")
    '/Worker_2/bpmn_message/order'
    """
    return f"/{robot}{_branch(topic)}"


def _branch(topic: str) -> str:
    return f"/bpmn_message/{topic.lstrip('~/')}"


class Addressed:
    """What one robot sends to others by name."""

    def __init__(self, node: Node, middleware: Middleware, scheduler: Scheduler, advertise: Advertise) -> None:
        self._node, self._middleware, self._scheduler, self._advertise = node, middleware, scheduler, advertise
        self._topics: dict[str, tuple[str, QoS]] = {}
        self._waiting: deque[tuple[int, Publisher, Message]] = deque()
        self._entry: Entry | None = None

    def open(self, topic: str, type: str, profile: QoS) -> None:
        """There will be messages on this topic (its qualified name)."""
        self._topics[topic] = type, profile

    def meet(self) -> None:
        """Make the ends towards all robots that are there."""
        for topic, (type, profile) in self._topics.items():
            for robot in self._takers(topic):
                self._advertise(address(topic, robot), type, profile)

    def send(self, topic: str, value: Any, robot: Any) -> None:
        """Send a message to a robot. Raises MessageError, and BpmnError ``unreachable`` if no such robot takes it."""
        takers = self._takers(topic)
        if robot not in takers:
            known = ", ".join([*takers[:_SHOWN], *(["..."] if len(takers) > _SHOWN else [])]) or "none"
            raise BpmnError("unreachable", f"no other robot {robot!r} takes message {topic}; robots that do: {known}")
        type, profile = self._topics[topic]
        publisher = self._advertise(address(topic, robot), type, profile)
        self._waiting.append((self._scheduler.now + _PATIENCE, publisher, messages.create(type, value)))
        self._flush()

    def close(self) -> None:
        """Send nothing more."""
        self._waiting.clear()
        if self._entry is not None:
            self._entry.cancel()

    def _takers(self, topic: str) -> list[str]:
        """The other robots that listen for a message, in order."""
        if not self._topics:
            return []
        branch, own = _branch(topic), self._node.full_name
        return [
            info.name.removeprefix("/").removesuffix(branch)
            for info in self._middleware.graph()
            if info.name.endswith(branch) and any(name != own for name in info.subscribers)
        ]

    def _flush(self) -> None:
        """Publish what has waited for long enough, in order."""
        connecting = self._middleware.connecting(self._node)
        now = self._scheduler.now
        while self._waiting and (self._waiting[0][1].topic not in connecting or self._waiting[0][0] <= now):
            _, publisher, message = self._waiting.popleft()
            publisher.publish(message)
        if self._waiting and (self._entry is None or self._entry.action is None):
            self._entry = self._scheduler.after(_LOOK, self._flush)
