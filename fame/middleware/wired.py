"""What the backends between processes share: nodes that keep their ends, and warnings that come from any thread.

What an end is, and who is at the other one, is the matter of each backend: it gives the `Kinds` of its ends, and each
end tells whether it is `matched`.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from typing import Any, ClassVar, NamedTuple

from fame.clock import SECOND, Scheduler
from fame.middleware.interface import SIGNAL, Message, QoS, resolve
from fame.middleware.refusals import second_type

NAMING = SECOND // 5
"""How long after an end the name of its node may come (ns)."""
_LOOK = 0.002
"""How often `wait_matched` looks (s)."""


class Kinds(NamedTuple):
    """What makes the ends of a node."""

    publisher: Callable[[Any, str, str, QoS], Any]
    subscription: Callable[[Any, str, str, Callable[[Message], object], QoS], Any]
    service: Callable[[Any, str, str, Callable[[Message], Any]], Any]
    client: Callable[[Any, str, str], Any]


class WireNode:
    """A node and its ends, which take themselves out when they close. See `fame.middleware.interface.Node`.

    Its middleware has `nodes`, and is told by `changed` that they, or ends of them, are not what they were.
    """

    kinds: ClassVar[Kinds]

    def __init__(self, middleware: Any, name: str, namespace: str) -> None:
        self.middleware, self.name, self.namespace = middleware, name, namespace
        self.full_name = resolve(name, namespace)
        self.publishers: list[Any] = []
        self.subscriptions: list[Any] = []
        self.services: list[Any] = []
        middleware.nodes.append(self)
        middleware.changed()

    def publisher(self, topic: str, type: str, qos: QoS = SIGNAL) -> Any:
        return self._keep(self.publishers, self.kinds.publisher(self, resolve(topic, self.namespace), type, qos))

    def subscription(self, topic: str, type: str, callback: Callable[[Message], object], qos: QoS = SIGNAL) -> Any:
        end = self.kinds.subscription(self, resolve(topic, self.namespace), type, callback, qos)
        return self._keep(self.subscriptions, end)

    def service(self, name: str, type: str, handler: Callable[[Message], Any]) -> Any:
        return self._keep(self.services, self.kinds.service(self, resolve(name, self.namespace), type, handler))

    def client(self, name: str, type: str) -> Any:
        return self._keep(self.services, self.kinds.client(self, resolve(name, self.namespace), type))

    def close(self) -> None:
        """Leave: all its ends are closed. Does nothing the second time."""
        for end in (*self.publishers, *self.subscriptions, *self.services):
            end.close()
        if self in self.middleware.nodes:
            self.middleware.nodes.remove(self)
            self.middleware.changed()

    def _keep(self, ends: list[Any], end: Any) -> Any:
        ends.append(end)
        self.middleware.changed()
        return end


class Warnings:
    """Called with what a person should know: kept in `said`, each once. `tell` is told of it in the scheduler."""

    def __init__(self, scheduler: Scheduler, tell: Callable[[str], object] | None) -> None:
        self.said: list[str] = []
        self._scheduler, self._tell, self._lock = scheduler, tell, threading.Lock()

    def __call__(self, text: str) -> None:
        with self._lock:
            if text in self.said:
                return
            self.said.append(text)
        if self._tell is not None:
            self._scheduler.soon(partial(self._tell, text))


def check_type(nodes: Iterable[WireNode], topic: str, type: str) -> None:
    """Raise MessageError if one of the nodes uses the topic with another type."""
    if users := [end for end in _ends(nodes, topic) if end.type != type]:
        raise second_type(topic, users[0].type, (end.node.full_name for end in users), type)


def wait_matched(nodes: Sequence[WireNode], topics: Iterable[str], timeout: float) -> list[str]:
    """Block until each end that the nodes have on the topics (full names) is connected to one of another node.

    At most `timeout` s; returns the topics with an end that is not.
    """
    waiting, deadline = list(topics), time.monotonic() + timeout
    while True:
        waiting = [topic for topic in waiting if not all(end.matched() for end in _ends(nodes, topic))]
        if not waiting or time.monotonic() >= deadline:
            return waiting
        time.sleep(_LOOK)


def _ends(nodes: Iterable[WireNode], topic: str) -> Iterator[Any]:
    for node in nodes:
        yield from (end for end in (*node.publishers, *node.subscriptions) if end.topic == topic)
