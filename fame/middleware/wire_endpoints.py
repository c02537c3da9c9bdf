"""Endpoints of the backends between processes: publishers, subscriptions, services and clients.

A backend derives its classes from these and implements their abstract methods: sending, releasing, and whether an
endpoint is `matched`. Everything else is here: one type per topic, packing and unpacking, the queue of a subscription,
losses, requests and their responses.

Threads: `WireSubscription.enqueue` may be called from any thread, all else in that of the scheduler.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence, Set
from typing import TYPE_CHECKING, Any

from fame.errors import MessageError
from fame.middleware import codec, messages
from fame.middleware.data_scheduler import DataScheduler
from fame.middleware.errors import (
    dropped_warning,
    lost_text,
    publish_error,
    service_conflict,
    type_conflict,
    unanswered_warning,
    unavailable_error,
    unheard_warning,
    unreadable_text,
)
from fame.middleware.insistent import InsistentRequests
from fame.middleware.interface import (
    MAX_MESSAGE_SIZE,
    AnyMessage,
    EndpointWarning,
    PendingRequests,
    QoS,
    deliver_response,
)
from fame.middleware.qos import counts_losses

if TYPE_CHECKING:
    from fame.middleware.wire_base import WireNode

Callback = Callable[[AnyMessage], object]
OnWarning = Callable[[EndpointWarning], object]


class WireEndpoint(ABC):
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
        """Release the backend's objects for it."""


class WireTopicEndpoint(WireEndpoint):
    """An endpoint of a topic. Raises MessageError if this process uses the topic with another type."""

    topic: str
    qos: QoS
    message_class: type[AnyMessage]

    def __init__(self, node: WireNode, topic: str, type: str, qos: QoS) -> None:
        super().__init__(node)
        self.topic, self.qos = topic, qos
        self.lost: int = 0  # messages, as far as it knows
        self.message_class = messages.message_type(type)
        self.type: str = self.message_class.__msgtype__
        if users := [end for end in endpoints_on(node.middleware.nodes, topic) if end.type != self.type]:
            raise type_conflict(topic, users[0].type, (end.node.full_name for end in users), self.type)

    def count_lost(self, number: int) -> None:
        """Count messages that were lost."""
        self.lost += number

    @abstractmethod
    def matched(self) -> bool:
        """Return whether it is connected to an endpoint of another node."""

    @abstractmethod
    def losses(self) -> str:
        """Return the number of messages that it has lost, as text; empty if it knows of none."""


class WirePublisher(WireTopicEndpoint):
    @abstractmethod
    def publish(self, message: AnyMessage) -> None:
        """Send it. Raises MessageError if it is not a message of the topic's type, and if the publisher is closed."""

    @abstractmethod
    def subscriber_count(self) -> int:
        """Return how many subscriptions it is connected to, those of its own node too."""

    def losses(self) -> str:
        if not self.lost:
            return ""
        return f"{self.topic}: {self.node.full_name} lost {self.lost} messages: a subscriber does not take them in time"

    def pack(self, message: AnyMessage) -> bytes:
        """Return the message as CDR. Raises MessageError as `publish`."""
        if self.closed or message.__class__ is not self.message_class:
            raise publish_error(self.topic, self.type, message, closed=self.closed)
        return codec.serialize(message)


class WireSubscription(WireTopicEndpoint):
    """A subscription, and the queue of received messages: at most `qos.depth`, as CDR.

    The scheduler takes them from the queue, one per entry. There is at most one such entry at a time, so that a
    subscription with a full queue does not keep others waiting. A reliable subscription counts dropped messages.
    """

    def __init__(self, node: WireNode, topic: str, type: str, callback: Callback, qos: QoS) -> None:
        super().__init__(node, topic, type, qos)
        self.max_size: int = MAX_MESSAGE_SIZE
        self.held: bool = node.held
        self.on_dropped: OnWarning = self._warn_once
        self.counts_losses: bool = counts_losses(qos)
        self.uncounted: bool = False  # whether more may have been lost than the backend can count
        self._callback = callback
        self._queue: deque[bytes] = deque(maxlen=None if qos.history == "keep_all" else qos.depth)
        self._scheduled = False
        self._unreadable = 0
        scheduler = node.middleware.scheduler
        self._soon = scheduler.arrived if isinstance(scheduler, DataScheduler) else scheduler.soon

    def ignore(self, publisher: Any) -> None:
        """Drop the messages of a publisher of the same node, if the backend does not do so by itself."""

    def drain(self) -> list[tuple[str, bytes]]:
        """Take all held messages, each with the full name of the node that sent it."""
        return []

    def enqueue(self, data: bytes) -> None:
        """Put a message into the queue. `schedule` is to follow."""
        if self.counts_losses and len(self._queue) == self._queue.maxlen:
            self.count_lost(1)
        self._queue.append(data)

    def schedule(self) -> None:
        """Let the scheduler take messages from the queue."""
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
            self.on_dropped(dropped_warning(self.topic, f"{len(data)} bytes; at most {self.max_size} are accepted"))
            return
        try:
            message = codec.deserialize(data, self.type)
        except MessageError as error:
            self.on_dropped(dropped_warning(self.topic, str(error)))
        else:
            self._callback(message)

    def losses(self) -> str:
        place, unreadable = (self.topic, self.node.full_name), self._unreadable - 1
        texts = [lost_text(*place, self.lost, self.uncounted)] if self.lost else []
        return "; ".join([*texts, *[unreadable_text(*place, unreadable)] * (unreadable > 0)])

    def close(self) -> None:
        self._queue.clear()
        super().close()

    def _warn_once(self, warning: EndpointWarning) -> None:
        """Warn of the first unreadable message of a flood, and count the others."""
        self._unreadable += 1
        if self._unreadable == 1:
            self.node.middleware.warn(warning)


class ServiceEndpoint(WireEndpoint):
    """A service or a client. Raises MessageError for an unknown type."""

    name: str
    type: str
    request_type: str
    response_type: str

    def __init__(self, node: WireNode, name: str, type: str) -> None:
        super().__init__(node)
        self.name, self.type = name, type
        self.request_type, self.response_type = messages.service(type)

    def unpack(self, data: bytes, type: str) -> AnyMessage | None:
        """Return a request or response; None, with a warning, if it cannot be read."""
        try:
            return codec.deserialize(data, type)
        except MessageError as error:
            self.node.middleware.warn(dropped_warning(self.name, str(error)))
            return None


class WireService(ServiceEndpoint):
    """A service. Raises MessageError if there is a service of that name already."""

    def __init__(self, node: WireNode, name: str, type: str, handler: Callable[[AnyMessage], Any]) -> None:
        super().__init__(node, name, type)
        self._handler = handler
        for _, owner in node.middleware.offers(name):
            raise service_conflict(name, owner, type)

    def handle(self, request: AnyMessage, send: Callable[[AnyMessage], object]) -> None:
        """Call the handler; `send` gets the response, now or later."""
        response_type = self.response_type
        deliver_response(self._handler(request), lambda response: send(messages.create(response_type, response)))


class WireClient(ServiceEndpoint):
    """A client of a service, with its pending requests."""

    def __init__(self, node: WireNode, name: str, type: str) -> None:
        super().__init__(node, name, type)
        self.pending: PendingRequests = PendingRequests()
        self.insistent: InsistentRequests = InsistentRequests(self, node.middleware.scheduler)

    @property
    @abstractmethod
    def available(self) -> bool:
        """Whether a node offers the service now."""

    @property
    def mismatch(self) -> str:
        """Why it is not connected to a service of its name that is there."""
        offers = () if self.available else self.node.middleware.offers(self.name)
        return str(self.unavailable(offers)) if offers else ""

    @abstractmethod
    def servers(self) -> Set[Hashable]:
        """Return the servers of this name that are there now, each by an identity of its own."""

    @abstractmethod
    def send(self, request: AnyMessage) -> Hashable:
        """Send a request. Returns the key of its response in `pending`, which comes in the scheduler."""

    def call(
        self,
        request: Any,
        callback: Callback,
        lost: Callable[[], object] | None = None,
        *,
        or_new: bool = False,
    ) -> None:
        """Send a request. Raises MessageError if it does not fit, or if no node offers the service with this type."""
        if not self.available:
            raise self.unavailable(self.node.middleware.offers(self.name))
        key = self.send(messages.create(self.request_type, request))
        self.pending.add(key, self.servers(), callback, lost, or_new)

    def on_servers_changed(self) -> None:
        """Drop the requests that get no response now that a server has come or left; warn if one has left with some."""
        if self.pending or self.insistent:
            self.take_servers(self.servers())

    def take_servers(self, servers: Set[Hashable]) -> None:
        """Drop the requests to which none of these servers, all that are there now, will respond."""
        if self.pending.servers_changed(servers):
            self.warn_unanswered()
        self.insistent.on_servers_changed(servers)

    def unavailable(self, offers: Sequence[tuple[str, str]]) -> MessageError:
        """Return why it cannot be called, from type and node of each service of its name."""
        return unavailable_error(self.name, self.request_type, (type for type, _ in offers))

    def insist(self, request: Any, callback: Callback) -> None:
        self.insistent.add(request, self.servers(), callback)

    def warn_unanswered(self) -> None:
        """Warn that a request gets no response."""
        self.node.middleware.warn(unanswered_warning(self.name, self.node.full_name))

    def close(self) -> None:
        if self.insistent and not self.available:
            self.node.middleware.warn(unheard_warning(self.name, self.node.full_name))
        self.insistent.clear()
        self.pending.clear()
        super().close()


def endpoints_on(nodes: Iterable[WireNode], topic: str) -> Iterator[Any]:
    """Yield the publishers and subscriptions of some nodes on a topic (full name)."""
    for node in nodes:
        yield from (end for end in (*node.publishers, *node.subscriptions) if end.topic == topic)
