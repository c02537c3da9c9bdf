"""What the backends between processes share: a middleware and its nodes, which keep their ends, and what ends refuse.

A backend derives its own from these and holds what is its own: how an end is made (`Kinds`), whether it is `matched`,
who else is there, and, in `leave`, what is to be given back. Its callbacks may run in any thread: `Warnings` may be
called from there, and everything else is entered in the scheduler.
"""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import Any, ClassVar, NamedTuple

from fame.clock import SECOND, Scheduler
from fame.errors import MessageError
from fame.middleware import codec, messages
from fame.middleware.errors import (
    check_name,
    loss,
    second_service,
    second_type,
    unanswered,
    unavailable,
    unpublishable,
    unread,
)
from fame.middleware.interface import LARGEST, SIGNAL, Message, QoS, resolve

NAMING = SECOND // 5
"""How long after an end the name of its node may come (ns)."""
_WARNINGS = 1000
"""How many warnings are kept: those of a flood differ in their numbers."""
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
        return self._keep(self.publishers, self.kinds.publisher(self, self._full(topic), type, qos))

    def subscription(self, topic: str, type: str, callback: Callable[[Message], object], qos: QoS = SIGNAL) -> Any:
        return self._keep(self.subscriptions, self.kinds.subscription(self, self._full(topic), type, callback, qos))

    def service(self, name: str, type: str, handler: Callable[[Message], Any]) -> Any:
        return self._keep(self.services, self.kinds.service(self, self._full(name), type, handler))

    def client(self, name: str, type: str) -> Any:
        return self._keep(self.services, self.kinds.client(self, self._full(name), type))

    def close(self) -> None:
        """Leave: all its ends are closed. Does nothing the second time."""
        for end in (*self.publishers, *self.subscriptions, *self.services):
            end.close()
        if self in self.middleware.nodes:
            self.middleware.nodes.remove(self)
            self.middleware.changed()

    def _full(self, name: str) -> str:
        full = resolve(name, self.namespace)
        check_name(full)
        return full

    def _keep(self, ends: list[Any], end: Any) -> Any:
        ends.append(end)
        self.middleware.changed()
        return end


class WireEnd(ABC):
    """An end of a topic or service, closed once; `leave` gives back what the backend has made for it."""

    def __init__(self, node: Any) -> None:
        self.node, self.closed = node, False

    def close(self) -> None:
        if not self.closed:
            self.closed = True
            for ends in (self.node.publishers, self.node.subscriptions, self.node.services):
                if self in ends:
                    ends.remove(self)
            self.leave()

    @abstractmethod
    def leave(self) -> None:
        """Give back what the backend has made."""


class TopicEnd(WireEnd):
    """An end of a topic. Raises MessageError if its node's process uses the topic with another type."""

    def __init__(self, node: Any, topic: str, type: str, qos: QoS) -> None:
        super().__init__(node)
        self.topic, self.qos, self.limit = topic, qos, LARGEST
        self.lost = 0  # messages, as far as this end knows
        self.unread = 0  # messages that were none, or too large
        self.dropped: Callable[[str], object] = self._warn_once
        self.message_class = messages.message_type(type)
        self.type: str = self.message_class.__msgtype__
        if users := [end for end in _ends(node.middleware.nodes, topic) if end.type != self.type]:
            raise second_type(topic, users[0].type, (end.node.full_name for end in users), self.type)

    def pack(self, message: Message) -> bytes:
        """What a publisher sends, as CDR. Raises MessageError if it is no message of the type, or the end is closed."""
        if self.closed or message.__class__ is not self.message_class:
            raise unpublishable(self, message, closed=self.closed)
        return codec.serialize(message)

    def losses(self) -> str:
        """How many messages it has lost or could not read, in words; empty if it does not know of any."""
        name, counts = self.node.full_name, ((loss, self.lost), (unread, self.unread - 1))
        return "; ".join(text(self.topic, name, count) for text, count in counts if count > 0)

    def _warn_once(self, text: str) -> None:
        """A flood of garbage is one warning; what follows is counted."""
        self.unread += 1
        if self.unread == 1:
            self.node.middleware.warn(text)

    def unpack(self, data: bytes, callback: Callable[[Message], object]) -> None:
        """Call back with what a subscription has got, unless it is closed, or the data are no message."""
        if self.closed:
            return
        if len(data) > self.limit:
            self.dropped(f"{self.topic}: dropped a message: {len(data)} bytes; at most {self.limit} are taken")
            return
        try:
            message = codec.deserialize(data, self.type)
        except MessageError as error:
            self.dropped(f"{self.topic}: dropped a message: {error}")
        else:
            callback(message)


class AskedEnd(WireEnd):
    """A service, or a client of one. Raises MessageError for an unknown type."""

    def __init__(self, node: Any, name: str, type: str) -> None:
        super().__init__(node)
        self.name, self.type = name, type
        self.request_type, self.response_type = messages.service(type)


class ServiceEnd(AskedEnd):
    """A service."""

    def check_offer(self) -> None:
        """Raise MessageError if somebody offers a service of that name already."""
        for _, owner in self.node.middleware.offers(self.name):
            raise second_service(self.name, owner, self.type)


class ClientEnd(AskedEnd):
    """A client of a service."""

    @property
    @abstractmethod
    def available(self) -> bool:
        """Whether somebody offers the service now."""

    def request(self, said: Any) -> Message:
        """What it asks. Raises MessageError if it does not fit, or nobody offers the service with this type."""
        if not self.available:
            offers = self.node.middleware.offers(self.name)
            raise unavailable(self.name, self.request_type, (type for type, _ in offers))
        return messages.create(self.request_type, said)

    def give_up(self) -> None:
        """It has asked, and the service has left."""
        self.node.middleware.warn(unanswered(self.name, self.node.full_name))


class Warnings:
    """Called with what a person should know: kept in `said`, each once. `tell` is told of it in the scheduler."""

    def __init__(self, scheduler: Scheduler, tell: Callable[[str], object] | None) -> None:
        self.said: list[str] = []
        self._scheduler, self._tell, self._lock = scheduler, tell, threading.Lock()

    def __call__(self, text: str) -> None:
        with self._lock:
            if text in self.said or len(self.said) >= _WARNINGS:
                return
            self.said.append(text)
        if self._tell is not None:
            self._scheduler.soon(partial(self._tell, text))


class WireMiddleware(ABC):
    """A backend between processes: its nodes, and its `warnings`; `leave` gives back what it is made of."""

    def __init__(self, scheduler: Any, network: str | None, on_warning: Callable[[str], object] | None) -> None:
        self.scheduler, self.network, self.closed = scheduler, network, False
        self.nodes: list[Any] = []
        self.warn = Warnings(scheduler, on_warning)
        self.warnings = self.warn.said

    def connecting(self, node: Any) -> list[str]:
        """Topics on which a node publishes to somebody who is there and does not hear it yet."""
        self.refresh()
        return [end.topic for end in node.publishers if end.subscribers() < self.hearers(end)]

    def losses(self) -> list[str]:
        """Which own ends have lost messages, and how many each, in words: of several at one place the one with most."""
        most: dict[tuple[str, str, type], tuple[int, str]] = {}
        for node in list(self.nodes):
            for end in (*node.subscriptions, *node.publishers):
                text, place = end.losses(), (end.topic, node.full_name, type(end))
                most[place] = max(most.get(place, (0, "")), (end.lost, text))
        return [text for _, text in most.values() if text]

    def wait_matched(self, topics: Iterable[str], timeout: float) -> list[str]:
        """Block until each own end on the topics (full names) is connected to one of another node.

        At most `timeout` s; returns the topics with an end that is not.
        """
        waiting, deadline = list(topics), time.monotonic() + timeout
        while True:
            waiting = [topic for topic in waiting if not all(end.matched() for end in _ends(self.nodes, topic))]
            if not waiting or time.monotonic() >= deadline:
                return waiting
            time.sleep(_LOOK)

    def close(self) -> None:
        """Leave, at once for all others too. Does nothing the second time."""
        if not self.closed:
            for node in list(self.nodes):
                node.close()
            self.closed = True
            self.leave()

    def refresh(self) -> None:  # noqa: B027 (rclpy sees it by itself)
        """See who is there now, if the backend does not do so by itself."""

    def changed(self) -> None:  # noqa: B027 (rclpy tells it by itself)
        """Nodes or their ends are not what they were, if the backend does not see that by itself."""

    @abstractmethod
    def hearers(self, end: Any) -> int:
        """How many subscriptions there are that can hear a publisher."""

    @abstractmethod
    def leave(self) -> None:
        """Give back what the backend is made of."""


def _ends(nodes: Iterable[WireNode], topic: str) -> Iterator[Any]:
    for node in nodes:
        yield from (end for end in (*node.publishers, *node.subscriptions) if end.topic == topic)
