"""What the backends between processes share: base classes for a middleware, its nodes and their endpoints.

A backend derives its classes from these and implements their abstract methods: how an endpoint is made, sends and is
released, whether it is `matched`, and who else is there. Everything else is here: names, one type per topic, packing
and unpacking, the queue of a subscription, losses, requests and their responses, warnings, closing.

Threads: `Warnings` and `WireSubscription.enqueue` may be called from any thread. All else happens in the thread of the
scheduler.
"""

from __future__ import annotations

import os
import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from functools import partial
from typing import Any

from fame.clock import SECOND, Scheduler
from fame.errors import ConfigError, MessageError
from fame.middleware import codec, messages
from fame.middleware.errors import (
    check_name,
    dropped_warning,
    lost_text,
    publish_error,
    service_conflict,
    type_conflict,
    unanswered_warning,
    unavailable_error,
    unreadable_text,
)
from fame.middleware.interface import (
    MAX_MESSAGE_SIZE,
    SIGNAL,
    EndpointWarning,
    Message,
    QoS,
    TopicInfo,
    deliver_response,
    resolve,
)
from fame.middleware.qos import counts_losses

NAMING_DELAY = SECOND // 5
"""How long after an endpoint the name of its node may come (ns)."""
_LAST_DOMAIN = 232
"""The last one whose ports are below 65536 (DDSI-RTPS 2.5, section 9.6.2)."""
_MAX_WARNINGS = 1000
"""How many warnings are kept: those of a flood differ in their numbers."""
_POLL = 0.002
"""How often `wait_matched` checks (s)."""

Callback = Callable[[Message], object]
OnWarning = Callable[[EndpointWarning], object]


class Warnings:
    """Called with each warning. Keeps it once, and passes it to `on_warning` in the scheduler."""

    def __init__(self, scheduler: Scheduler, on_warning: OnWarning | None) -> None:
        self.kept: list[EndpointWarning] = []
        self._scheduler, self._on_warning, self._lock = scheduler, on_warning, threading.Lock()

    def __call__(self, warning: EndpointWarning) -> None:
        with self._lock:
            if warning in self.kept or len(self.kept) >= _MAX_WARNINGS:
                return
            self.kept.append(warning)
        if self._on_warning is not None:
            self._scheduler.soon(partial(self._on_warning, warning))


class WireMiddleware(ABC):
    """A backend between processes. See `fame.middleware.interface.Middleware`."""

    scheduler: Scheduler
    network: str | None
    lockstep: bool = False
    """Whether its nodes can be held, for `fame.middleware.simulated_time.Lockstep`."""

    def __init__(self, scheduler: Scheduler, network: str | None, on_warning: OnWarning | None) -> None:
        self.scheduler, self.network = scheduler, network
        self.closed: bool = False
        self.nodes: list[Any] = []
        self.holds: Callable[[str], bool] = lambda name: False
        self.warn: Warnings = Warnings(scheduler, on_warning)
        self.warnings: list[EndpointWarning] = self.warn.kept

    @abstractmethod
    def node(self, name: str, namespace: str = "") -> WireNode:
        """Make a node. Several may have the same name, as in ROS."""

    @abstractmethod
    def graph(self) -> Sequence[TopicInfo]:
        """Every topic that has an endpoint, in the order of names."""

    @abstractmethod
    def namespaces(self) -> Sequence[str]:
        """The namespaces of all nodes, without slashes, in order."""

    @abstractmethod
    def offers(self, service: str) -> list[tuple[str, str]]:
        """Type and node of each service of that full name."""

    @abstractmethod
    def matching_subscriptions(self, publisher: Any) -> int:
        """How many subscriptions are there that match a publisher, connected or not."""

    @abstractmethod
    def release(self) -> None:
        """Free what the backend is made of, when all nodes are closed."""

    def refresh(self) -> None:  # noqa: B027 (not every backend needs it)
        """Bring up to date who is there, if the backend does not do so by itself."""

    def on_endpoints_changed(self) -> None:  # noqa: B027 (not every backend needs it)
        """Announce that nodes or their endpoints have changed, if the backend does not do so by itself."""

    def hold(self, holds: Callable[[str], bool]) -> None:
        """Hold the messages to nodes of such names, from now on, until they are drained."""
        self.holds = holds
        for node in self.nodes:
            node.hold(holds(node.name))

    def flush(self) -> None:  # noqa: B027 (only where nodes can be held)
        """Wait until others have what held nodes have sent."""

    def connecting(self, node: Any) -> list[str]:
        """Topics on which a node has a publisher that is not connected yet to every subscription that it matches."""
        self.refresh()
        return [end.topic for end in node.publishers if end.subscriber_count() < self.matching_subscriptions(end)]

    def losses(self) -> list[str]:
        """Which of its endpoints have lost messages, and how many, in words: on each topic of a node the worst one."""
        most: dict[tuple[str, str, type], tuple[int, str]] = {}
        for node in list(self.nodes):
            for end in (*node.subscriptions, *node.publishers):
                text, place = end.losses(), (end.topic, node.full_name, type(end))
                most[place] = max(most.get(place, (0, "")), (end.lost, text))
        return [text for _, text in most.values() if text]

    def wait_matched(self, topics: Iterable[str], timeout: float) -> list[str]:
        """Block until each of its endpoints on the topics (full names) is connected to one of another node.

        At most `timeout` s; returns the topics with an endpoint that is not.
        """
        waiting, deadline = list(topics), time.monotonic() + timeout
        while True:
            waiting = [topic for topic in waiting if not all(end.matched() for end in _endpoints(self.nodes, topic))]
            if not waiting or time.monotonic() >= deadline:
                return waiting
            time.sleep(_POLL)

    def close(self) -> None:
        """Close all nodes; others see it at once. Does nothing the second time."""
        if not self.closed:
            for node in list(self.nodes):
                node.close()
            self.closed = True
            self.release()


class WireNode(ABC):
    """A node and its endpoints. See `fame.middleware.interface.Node`."""

    middleware: WireMiddleware
    name: str
    namespace: str

    def __init__(self, middleware: WireMiddleware, name: str, namespace: str) -> None:
        self.middleware, self.name, self.namespace = middleware, name, namespace
        self.full_name: str = resolve(name, namespace)
        self.publishers: list[Any] = []
        self.subscriptions: list[Any] = []
        self.services: list[Any] = []  # and clients
        self.held: bool = middleware.holds(name)
        middleware.nodes.append(self)
        middleware.on_endpoints_changed()

    @abstractmethod
    def make_publisher(self, topic: str, type: str, qos: QoS) -> WirePublisher:
        """Make a publisher on a topic (full name)."""

    @abstractmethod
    def make_subscription(self, topic: str, type: str, callback: Callback, qos: QoS) -> WireSubscription:
        """Make a subscription to a topic (full name)."""

    @abstractmethod
    def make_service(self, name: str, type: str, handler: Callable[[Message], Any]) -> WireService:
        """Make a service of a full name."""

    @abstractmethod
    def make_client(self, name: str, type: str) -> WireClient:
        """Make a client of a service (full name)."""

    def hold(self, held: bool) -> None:
        """Let its messages wait to be drained, or not, from now on."""
        self.held = held
        for subscription in self.subscriptions:
            subscription.held = held

    def publisher(self, topic: str, type: str, qos: QoS = SIGNAL) -> Any:
        return self._add(self.publishers, self.make_publisher(self._full(topic), type, qos))

    def subscription(self, topic: str, type: str, callback: Callback, qos: QoS = SIGNAL) -> Any:
        return self._add(self.subscriptions, self.make_subscription(self._full(topic), type, callback, qos))

    def service(self, name: str, type: str, handler: Callable[[Message], Any]) -> Any:
        return self._add(self.services, self.make_service(self._full(name), type, handler))

    def client(self, name: str, type: str) -> Any:
        return self._add(self.services, self.make_client(self._full(name), type))

    def close(self) -> None:
        """Close all endpoints. Does nothing the second time."""
        for end in (*self.publishers, *self.subscriptions, *self.services):
            end.close()
        if self in self.middleware.nodes:
            self.middleware.nodes.remove(self)
            self.middleware.on_endpoints_changed()

    def _full(self, name: str) -> str:
        full = resolve(name, self.namespace)
        check_name(full)
        return full

    def _add(self, endpoints: list[Any], endpoint: Any) -> Any:
        endpoints.append(endpoint)
        self.middleware.on_endpoints_changed()
        return endpoint


class Endpoint(ABC):
    """An endpoint of a topic or service."""

    def __init__(self, node: WireNode) -> None:
        self.node: WireNode = node
        self.closed: bool = False

    def close(self) -> None:
        """Close the endpoint. Does nothing the second time."""
        if not self.closed:
            self.closed = True
            for endpoints in (self.node.publishers, self.node.subscriptions, self.node.services):
                if self in endpoints:
                    endpoints.remove(self)
            self.release()

    @abstractmethod
    def release(self) -> None:
        """Free what the backend has made for it."""


class TopicEndpoint(Endpoint):
    """An endpoint of a topic. Raises MessageError if this process uses the topic with another type."""

    topic: str
    qos: QoS
    message_class: type[Message]

    def __init__(self, node: WireNode, topic: str, type: str, qos: QoS) -> None:
        super().__init__(node)
        self.topic, self.qos = topic, qos
        self.lost: int = 0  # messages, as far as it knows
        self.message_class = messages.message_type(type)
        self.type: str = self.message_class.__msgtype__
        if users := [end for end in _endpoints(node.middleware.nodes, topic) if end.type != self.type]:
            raise type_conflict(topic, users[0].type, (end.node.full_name for end in users), self.type)

    def count_lost(self, number: int) -> None:
        """Count messages that were lost."""
        self.lost += number

    @abstractmethod
    def matched(self) -> bool:
        """Whether it is connected to an endpoint of another node."""

    @abstractmethod
    def losses(self) -> str:
        """How many messages it has lost, in words; empty if it does not know of any."""


class WirePublisher(TopicEndpoint):
    """A publisher."""

    @abstractmethod
    def publish(self, message: Message) -> None:
        """Send it. Raises MessageError if it is not a message of the topic's type, and if the publisher is closed."""

    @abstractmethod
    def subscriber_count(self) -> int:
        """How many subscriptions it is connected to, those of its own node too."""

    def losses(self) -> str:
        if not self.lost:
            return ""
        return f"{self.topic}: {self.node.full_name} lost {self.lost} messages: a subscriber does not take them in time"

    def pack(self, message: Message) -> bytes:
        """The message as CDR. Raises MessageError as `publish`."""
        if self.closed or message.__class__ is not self.message_class:
            raise publish_error(self.topic, self.type, message, closed=self.closed)
        return codec.serialize(message)


class WireSubscription(TopicEndpoint):
    """A subscription, and the queue of what came in: at most `qos.depth` messages, as CDR.

    The scheduler takes them from the queue, one per entry. There is at most one such entry at a time, so that a
    subscription with a full queue does not keep others waiting. A reliable subscription counts what is pushed out.
    """

    def __init__(self, node: WireNode, topic: str, type: str, callback: Callback, qos: QoS) -> None:
        super().__init__(node, topic, type, qos)
        self.max_size: int = MAX_MESSAGE_SIZE
        self.held: bool = False
        self.on_dropped: OnWarning = self._warn_once
        self.counts_losses: bool = counts_losses(qos)
        self._callback = callback
        self._queue: deque[bytes] = deque(maxlen=None if qos.history == "keep_all" else qos.depth)
        self._scheduled = False
        self._unreadable = 0
        self._soon = node.middleware.scheduler.soon

    def drain(self) -> list[tuple[str, bytes]]:
        """Take all messages that were held, each with the full name of the node that sent it."""
        return []

    def enqueue(self, data: bytes) -> None:
        """Put a message into the queue. `schedule` is to follow."""
        if self.counts_losses and len(self._queue) == self._queue.maxlen:
            self.count_lost(1)
        self._queue.append(data)

    def schedule(self) -> None:
        """Let the scheduler take what is in the queue."""
        if self._queue and not self._scheduled:
            self._scheduled = True
            self._soon(self._take)

    def _take(self) -> None:
        self._scheduled = False
        if self._queue:  # two threads may have scheduled it
            data = self._queue.popleft()
            self.schedule()
            self.deliver(data)

    def deliver(self, data: bytes) -> None:
        """Unpack a message and pass it to the callback, unless it is too large or cannot be read."""
        if self.closed:
            return
        if len(data) > self.max_size:
            self.on_dropped(dropped_warning(self.topic, f"{len(data)} bytes; at most {self.max_size} are taken"))
            return
        try:
            message = codec.deserialize(data, self.type)
        except MessageError as error:
            self.on_dropped(dropped_warning(self.topic, str(error)))
        else:
            self._callback(message)

    def losses(self) -> str:
        counts = ((lost_text, self.lost), (unreadable_text, self._unreadable - 1))
        return "; ".join(text(self.topic, self.node.full_name, count) for text, count in counts if count > 0)

    def close(self) -> None:
        self._queue.clear()
        super().close()

    def _warn_once(self, warning: EndpointWarning) -> None:
        """Warn of the first unreadable message of a flood, and count the others."""
        self._unreadable += 1
        if self._unreadable == 1:
            self.node.middleware.warn(warning)


class ServiceEndpoint(Endpoint):
    """A service or a client. Raises MessageError for an unknown type."""

    name: str
    type: str
    request_type: str
    response_type: str

    def __init__(self, node: WireNode, name: str, type: str) -> None:
        super().__init__(node)
        self.name, self.type = name, type
        self.request_type, self.response_type = messages.service(type)


class WireService(ServiceEndpoint):
    """A service. Raises MessageError if there is a service of that name already."""

    def __init__(self, node: WireNode, name: str, type: str, handler: Callable[[Message], Any]) -> None:
        super().__init__(node, name, type)
        self._handler = handler
        for _, owner in node.middleware.offers(name):
            raise service_conflict(name, owner, type)

    def handle(self, request: Message, send: Callable[[Message], object]) -> None:
        """Call the handler; `send` gets the response, now or later."""
        response_type = self.response_type
        deliver_response(self._handler(request), lambda response: send(messages.create(response_type, response)))


class WireClient(ServiceEndpoint):
    """A client of a service, and the callbacks of its requests under way."""

    def __init__(self, node: WireNode, name: str, type: str) -> None:
        super().__init__(node, name, type)
        self._waiting: dict[Hashable, Callback] = {}

    @property
    @abstractmethod
    def available(self) -> bool:
        """Whether a node offers the service now."""

    @abstractmethod
    def send(self, request: Message) -> Hashable:
        """Send a request. Returns the key of its response, for `on_response`, which comes in the scheduler."""

    def call(self, request: Any, callback: Callback) -> None:
        """Send a request. Raises MessageError if it does not fit, or if no node offers the service with this type."""
        if not self.available:
            offers = self.node.middleware.offers(self.name)
            raise unavailable_error(self.name, self.request_type, (type for type, _ in offers))
        self._waiting[self.send(messages.create(self.request_type, request))] = callback

    def on_response(self, key: Hashable, response: Message) -> None:
        """Pass on a response. One that was given up is dropped."""
        callback = self._waiting.pop(key, None)
        if callback is not None:
            callback(response)

    def give_up(self) -> None:
        """If the service is gone, warn and forget the requests under way."""
        if self._waiting and not self.available:
            self._waiting.clear()
            self.warn_unanswered()

    def warn_unanswered(self) -> None:
        """Warn that a request gets no response."""
        self.node.middleware.warn(unanswered_warning(self.name, self.node.full_name))

    def close(self) -> None:
        self._waiting.clear()
        super().close()


def _endpoints(nodes: Iterable[WireNode], topic: str) -> Iterator[Any]:
    for node in nodes:
        yield from (end for end in (*node.publishers, *node.subscriptions) if end.topic == topic)


def domain_id(given: int | None = None) -> int:
    """The number of the domain: `given`, else ROS_DOMAIN_ID, else 0. Raises ConfigError if it is not in 0..232."""
    text = os.environ.get("ROS_DOMAIN_ID", "").strip() if given is None else str(given)
    if not text:
        return 0
    if text.isascii() and text.isdigit() and int(text[:9]) <= _LAST_DOMAIN:
        return int(text)
    source = "ROS_DOMAIN_ID" if given is None else "domain"
    raise ConfigError(f"expected a domain from 0 to {_LAST_DOMAIN}, got {text!r}", element=source)
