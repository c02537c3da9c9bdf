"""The backend within one process: deterministic, and fast: a topic without subscribers costs next to nothing.

A message travels as the same object, which is why it must not be changed. One with values that no wire carries (a
float32 with too many digits, an integer for a float) travels as another, with what a wire carries. `publish` hands it
to every subscription of another node that it matches: there it waits for an entry of the scheduler at the present time.
So messages arrive in the order of publication and, of one message, in the order of subscription. The history of a
subscription bounds its queue: with keep last, a new message replaces the oldest one of a full queue.

Quality of service has the same effect as on the wire: endpoints that do not match are not connected, with an entry in
`warnings`; a late transient local subscription gets the last messages of the transient local publishers that still
exist. Deadline and liveliness are compared, not monitored. A request and its response are two entries of the scheduler,
one after the other. Everything happens in the thread of the scheduler; other threads use `scheduler.soon`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Iterator, Sequence
from functools import partial
from itertools import count
from typing import Any

from fame.clock import SECOND, Scheduler
from fame.dataclasses import dataclass, field
from fame.middleware import messages
from fame.middleware.errors import (
    check_name,
    lost_text,
    mismatch_warning,
    publish_error,
    service_conflict,
    type_conflict,
    unanswered_warning,
    unavailable_error,
    unfit_text,
    unheard_warning,
)
from fame.middleware.insistent import InsistentRequests
from fame.middleware.interface import (
    MAX_MESSAGE_SIZE,
    SIGNAL,
    AnyMessage,
    EndpointWarning,
    PendingRequests,
    QoS,
    TopicInfo,
    deliver_response,
    resolve,
)
from fame.middleware.network import Network, NetworkedSubscription, RobotChannel, matched_end
from fame.middleware.qos import compatible, counts_losses


class LocalMiddleware:
    """The nodes of one process. `warnings` are for the user; `on_warning` is called with each of them at once."""

    scheduler: Scheduler
    network: Network | None

    confined: bool
    use_sim_time: bool

    confined, use_sim_time = True, False

    def __init__(
        self,
        scheduler: Scheduler,
        on_warning: Callable[[EndpointWarning], object] | None = None,
        network: Network | None = None,
    ) -> None:
        self.scheduler, self.network = scheduler, network
        self.warnings: list[EndpointWarning] = []
        self.nodes: list[LocalNode] = []
        self.topics: dict[str, LocalTopic] = {}
        self.known_graph: list[TopicInfo] | None = None  # until an endpoint is made or closed
        self.services: dict[str, LocalService] = {}
        self.taps: list[Callable[[LocalPublisher], Callable[[AnyMessage], object] | None]] = []
        self._on_warning = on_warning

    def node(self, name: str, namespace: str = "", part: str = "") -> LocalNode:
        """Make a node. Several may have the same name, as in ROS."""
        node = LocalNode(self, name, namespace.strip("/"))
        self.nodes.append(node)
        return node

    def graph(self) -> Sequence[TopicInfo]:
        if self.known_graph is None:
            self.known_graph = [self.topics[name].info() for name in sorted(self.topics)]
        return self.known_graph

    def connecting(self, node: LocalNode) -> list[str]:
        return []  # endpoints are connected as they are made

    def namespaces(self) -> list[str]:
        return sorted({node.namespace for node in self.nodes if node.namespace})

    def losses(self) -> list[str]:
        ends = (end for node in self.nodes for end in node.endpoints if isinstance(end, LocalSubscription))
        return [lost_text(end.topic, end.node.full_name, end.lost) for end in ends if end.lost]

    def close(self) -> None:
        for node in list(self.nodes):
            node.close()

    def topic(self, name: str, type: str) -> LocalTopic:
        """Return the topic of that full name. Raises MessageError if the type is unknown or not that of the topic."""
        type = messages.message_type(type).__msgtype__
        topic = self.topics.get(name)
        if topic is None:
            check_name(name)
            topic = self.topics[name] = LocalTopic(name, type)
        if topic.type != type:
            info = topic.info()
            raise type_conflict(name, topic.type, (*info.publishers, *info.subscribers), type)
        return topic

    def under_way(self, ignored: Collection[LocalNode]) -> Iterator[LocalSubscription]:
        """Yield subscriptions that a message is on its way to, not of topics that a node of `ignored` publishes."""
        on_network = self.network.under_way if self.network is not None else {}
        for topic in self.topics.values():
            if not any(end.node in ignored for end in topic.publishers):
                ends = topic.subscriptions
                yield from (end for end in ends if end.queued or on_network.get((end.node.namespace, topic.name)))

    def tap(self, tap: Callable[[LocalPublisher], Callable[[AnyMessage], object] | None]) -> None:
        """Observe topics without an endpoint: the function that `tap` returns for a publisher gets its messages.

        `tap` is called with every publisher that exists or is made later.
        """
        self.taps.append(tap)
        for topic in self.topics.values():
            for publisher in topic.publishers:
                publisher.add_tap(tap)

    def on_servers_changed(self, service: str) -> None:
        """Tell the clients that wait for a response that a server of a service (full name) has come or left."""
        for node in self.nodes:
            for end in node.endpoints:
                if isinstance(end, LocalClient) and end.name == service and (end.pending or end.insistent):
                    self.scheduler.soon(end.on_servers_changed)

    def warn(self, warning: EndpointWarning) -> None:
        """Record a warning, unless it is recorded already."""
        if warning not in self.warnings:
            self.warnings.append(warning)
            if self._on_warning is not None:
                self._on_warning(warning)


@dataclass(slots=True)
class LocalTopic:
    """A topic and its endpoints, in the order in which they were made."""

    name: str
    type: str
    publishers: list[LocalPublisher] = field(default_factory=list)
    subscriptions: list[LocalSubscription] = field(default_factory=list)

    def info(self) -> TopicInfo:
        """Return the topic as the graph shows it."""
        publishers = tuple(end.node.full_name for end in self.publishers)
        subscribers = tuple(end.node.full_name for end in self.subscriptions)
        offered = tuple(end.qos for end in self.publishers)
        return TopicInfo(self.name, (self.type,), publishers, subscribers, offered)


class LocalNode:
    """A node. See `fame.middleware.interface.Node`."""

    middleware: LocalMiddleware
    name: str
    namespace: str
    full_name: str

    def __init__(self, middleware: LocalMiddleware, name: str, namespace: str) -> None:
        self.middleware, self.name, self.namespace = middleware, name, namespace
        self.full_name = resolve(name, namespace)
        self.endpoints: list[LocalPublisher | LocalSubscription | LocalService | LocalClient] = []

    def publisher(self, topic: str, type: str, qos: QoS = SIGNAL) -> LocalPublisher:
        shared = self.middleware.topic(resolve(topic, self.namespace), type)
        publisher = LocalPublisher(self, shared, qos)
        for subscription in shared.subscriptions:
            self._match(publisher, subscription)
        shared.publishers.append(publisher)
        self.middleware.known_graph = None
        self.endpoints.append(publisher)
        for tap in self.middleware.taps:
            publisher.add_tap(tap)
        return publisher

    def subscription(
        self, topic: str, type: str, callback: Callable[[AnyMessage], object], qos: QoS = SIGNAL
    ) -> LocalSubscription:
        shared = self.middleware.topic(resolve(topic, self.namespace), type)
        subscription = LocalSubscription(self, shared, callback, qos)
        for publisher in shared.publishers:
            if self._match(publisher, subscription) and qos.durability == "transient_local":
                publisher.send_history(subscription)
        shared.subscriptions.append(subscription)
        self.middleware.known_graph = None
        self.endpoints.append(subscription)
        return subscription

    def service(self, name: str, type: str, handler: Callable[[AnyMessage], Any]) -> LocalService:
        service = LocalService(self, resolve(name, self.namespace), type, handler)
        self.endpoints.append(service)
        return service

    def client(self, name: str, type: str) -> LocalClient:
        client = LocalClient(self, resolve(name, self.namespace), type)
        self.endpoints.append(client)
        return client

    def close(self) -> None:
        """Close all endpoints. Does nothing the second time."""
        for end in list(self.endpoints):
            end.close()
        if self in self.middleware.nodes:
            self.middleware.nodes.remove(self)

    def remove(self, end: LocalPublisher | LocalSubscription, topic: LocalTopic) -> None:
        """Remove a closed endpoint. A topic without endpoints is removed, and with it its type."""
        self.endpoints.remove(end)
        self.middleware.known_graph = None
        if not topic.publishers and not topic.subscriptions:
            del self.middleware.topics[topic.name]

    def _match(self, publisher: LocalPublisher, subscription: LocalSubscription) -> bool:
        """Connect two endpoints of different nodes, if their quality of service matches."""
        if publisher.node is subscription.node or (publisher.qos.acknowledged and subscription.qos.acknowledged):
            return False
        mismatch = compatible(publisher.qos, subscription.qos)
        if mismatch is None:
            publisher.matched.append(matched_end(self.middleware.network, publisher, subscription))
            return True
        nodes = subscription.node.full_name, publisher.node.full_name
        self.middleware.warn(mismatch_warning(publisher.topic, *nodes, mismatch))
        return False


class LocalPublisher:
    """A publisher. `matched` are the subscriptions that it is connected to, in the order in which they were made."""

    node: LocalNode
    qos: QoS
    topic: str
    type: str

    def __init__(self, node: LocalNode, shared: LocalTopic, qos: QoS) -> None:
        self.node, self.topic, self.type, self.qos = node, shared.name, shared.type, qos
        self.matched: list[LocalSubscription | NetworkedSubscription | _Tap] = []
        self._shared = shared
        self._class: type[AnyMessage] | None = messages.message_type(shared.type)
        self._kept: deque[tuple[int, AnyMessage]] | None = None
        if qos.durability == "transient_local":
            self._kept = deque(maxlen=None if qos.history == "keep_all" else qos.depth)

    def publish(self, message: AnyMessage) -> None:
        """Send it. Raises MessageError if it is not a message of the topic's type, and if the publisher is closed; if
        somebody gets it, also for values that do not fit their fields."""
        if message.__class__ is not self._class:
            raise publish_error(self.topic, self.type, message, closed=self._class is None)
        if self.matched or self._kept is not None:
            message = messages.create(self.type, message)
        if self._kept is not None:
            self._kept.append((self.node.middleware.scheduler.now, message))
        for subscription in self.matched:
            subscription.enqueue(message)

    def subscriber_count(self) -> int:
        return sum(not isinstance(end, _Tap) for end in self.matched)

    def add_tap(self, tap: Callable[[LocalPublisher], Callable[[AnyMessage], object] | None]) -> None:
        """Pass every message from now on, at once, to the function that `tap` returns, if any."""
        on_message = tap(self)
        if on_message is not None:
            self.matched.append(_Tap(on_message))

    def remove_tap(self, on_message: Callable[[AnyMessage], object]) -> None:
        """Pass no more messages to a function that a tap returned, which may be the one that is called now."""
        self.matched = [end for end in self.matched if not (isinstance(end, _Tap) and end.enqueue is on_message)]

    def send_history(self, subscription: LocalSubscription) -> None:
        """Send the messages kept for late subscriptions whose lifespan has not ended."""
        lifespan, now = self.qos.lifespan, self.node.middleware.scheduler.now
        for time, message in self._kept or ():
            if lifespan is None or now - time <= lifespan * SECOND:
                subscription.enqueue(message)

    def close(self) -> None:
        if self._class is not None:
            self._class = None
            self.matched.clear()
            self._shared.publishers.remove(self)
            self.node.remove(self, self._shared)


@dataclass(frozen=True, slots=True)
class _Tap:
    """An observer of a publisher: receives messages as they are published."""

    enqueue: Callable[[AnyMessage], object]


def _behind(end: object, subscription: LocalSubscription) -> object:
    """The end itself if it is `subscription` behind the network, else None."""
    return end if isinstance(end, NetworkedSubscription) and end.subscription is subscription else None


class LocalSubscription:
    """A subscription, and the queue of messages that wait for their entry of the scheduler."""

    node: LocalNode
    qos: QoS
    topic: str
    type: str
    lost: int

    def __init__(self, node: LocalNode, shared: LocalTopic, callback: Callable[[AnyMessage], object], qos: QoS) -> None:
        self.node, self.topic, self.type, self.qos = node, shared.name, shared.type, qos
        self._shared, self._callback = shared, callback
        self.max_size: int = MAX_MESSAGE_SIZE
        self.on_dropped: Callable[[EndpointWarning], object] = (
            node.middleware.warn
        )  # never: nothing is written and read here
        self._queue: deque[AnyMessage] = deque()
        self._depth = -1 if qos.history == "keep_all" else qos.depth
        self.lost = 0  # messages, since it was made
        self._pushed_out = 0  # entries of the scheduler, always the next ones, whose message was pushed out
        self._counts = counts_losses(qos)
        self._soon = node.middleware.scheduler.soon
        self._deliver = self._deliver_next  # bound once

    def enqueue(self, message: AnyMessage) -> None:
        """Queue a message, with an entry of the scheduler that delivers it."""
        queue = self._queue
        if len(queue) == self._depth:
            queue.popleft()
            self._pushed_out += 1
            self.lost += self._counts
        queue.append(message)
        self._soon(self._deliver)

    @property
    def queued(self) -> int:
        """Messages that wait for their entry of the scheduler."""
        return len(self._queue)

    @property
    def is_open(self) -> bool:
        """Whether it has not been closed."""
        return self in self._shared.subscriptions

    def close(self) -> None:
        if self in self._shared.subscriptions:
            self._queue.clear()
            self._shared.subscriptions.remove(self)
            for publisher in self._shared.publishers:
                publisher.matched[:] = [end for end in publisher.matched if end not in (self, _behind(end, self))]
            self.node.remove(self, self._shared)

    def _deliver_next(self) -> None:
        if self._pushed_out:
            self._pushed_out -= 1
        elif self._queue:
            self._callback(self._queue.popleft())


class LocalService:
    """A service. `name` is the full name. There is one service of a name at a time."""

    node: LocalNode
    name: str
    type: str
    request_type: str
    response_type: str

    def __init__(self, node: LocalNode, name: str, type: str, handler: Callable[[AnyMessage], Any]) -> None:
        self.node, self.name, self.type, self._handler = node, name, type, handler
        self.request_type, self.response_type = messages.service(type)
        offered = node.middleware.services.setdefault(name, self)
        if offered is not self:
            raise service_conflict(name, offered.node.full_name, type)
        node.middleware.on_servers_changed(name)

    def handle(self, request: AnyMessage, send: Callable[[AnyMessage], object]) -> None:
        """Call the handler; `send` gets the response. Raises MessageError if it does not fit the type."""
        response_type = self.response_type
        deliver_response(self._handler(request), lambda response: send(messages.create(response_type, response)))

    def close(self) -> None:
        if self.node.middleware.services.get(self.name) is self:
            del self.node.middleware.services[self.name]
            self.node.endpoints.remove(self)
            self.node.middleware.on_servers_changed(self.name)


class LocalClient:
    """A client. See `fame.middleware.interface.Client`."""

    node: LocalNode
    name: str
    type: str
    request_type: str

    def __init__(self, node: LocalNode, name: str, type: str) -> None:
        self.node, self.name, self.type = node, name, type
        self.request_type, _ = messages.service(type)
        self._channels: dict[tuple[str, str], RobotChannel | None] = {}
        self.pending: PendingRequests = PendingRequests()
        self.insistent: InsistentRequests = InsistentRequests(self, node.middleware.scheduler)
        self._numbers = count(1)

    @property
    def available(self) -> bool:
        """Whether a node offers the service now, and can be reached."""
        return bool(self._servers())

    @property
    def mismatch(self) -> str:
        """Why it is not connected to a service of its name that is there."""
        return unfit_text(self.name, self.request_type, () if self.available else self._offered())

    def _servers(self) -> frozenset[LocalService]:
        service, network = self.node.middleware.services.get(self.name), self.node.middleware.network
        if service is None or service.request_type != self.request_type:
            return frozenset()
        reached = network is None or network.is_matched((self.node.namespace, service.node.namespace))
        return frozenset((service,)) if reached else frozenset()

    def call(
        self,
        request: Any,
        callback: Callable[[AnyMessage], object],
        lost: Callable[[], object] | None = None,
        *,
        or_new: bool = False,
    ) -> None:
        """Send a request. Raises MessageError if it does not fit, or if no node offers the service with this type."""
        service = self.node.middleware.services.get(self.name)
        if service is None or service.request_type != self.request_type:
            raise unavailable_error(self.name, self.request_type, self._offered())
        message, key = messages.create(self.request_type, request), next(self._numbers)
        self.pending.add(key, (service,), callback, lost, or_new)
        self._way(self.node, service.node, partial(self._send, service, message, key))
        self._follow(service)

    def insist(self, request: Any, callback: Callable[[AnyMessage], object]) -> None:
        self.insistent.add(request, self._servers(), callback)
        service = self.node.middleware.services.get(self.name)
        if service is not None:
            self._follow(service)

    def _follow(self, service: LocalService) -> None:
        """Look again when the network will connect this server or cut it off."""
        middleware, pair = self.node.middleware, (self.node.namespace, service.node.namespace)
        for time in middleware.network.match_changes(pair) if middleware.network is not None else ():
            middleware.scheduler.at(time, self.on_servers_changed)

    def _offered(self) -> Sequence[str]:
        service = self.node.middleware.services.get(self.name)
        return () if service is None else (service.request_type.removesuffix("_Request"),)

    def on_servers_changed(self) -> None:
        """Look which servers are there: one has come or left, or the network connects it or cuts it off."""
        if self.pending and self.pending.servers_changed(self._servers()):
            self.node.middleware.warn(unanswered_warning(self.name, self.node.full_name))
        self.insistent.on_servers_changed(self._servers())

    def close(self) -> None:
        if self.insistent and not self.available:
            self.node.middleware.warn(unheard_warning(self.name, self.node.full_name))
        self.insistent.clear()
        self.pending.clear()
        if self in self.node.endpoints:
            self.node.endpoints.remove(self)

    def _send(self, service: LocalService, request: AnyMessage, key: int) -> None:
        if self.node.middleware.services.get(self.name) is service:
            respond = partial(self.pending.respond, key)
            service.handle(request, lambda response: self._way(service.node, self.node, partial(respond, response)))

    def _way(self, sender: LocalNode, receiver: LocalNode, action: Callable[[], object]) -> None:
        """Send a request or response through the modelled network."""
        network = self.node.middleware.network
        key = sender.namespace, receiver.namespace
        if network is not None and key not in self._channels:
            self._channels[key] = network.channel(*key, self.name, SIGNAL)
        channel = self._channels.get(key)
        if channel is None:
            self.node.middleware.scheduler.soon(action)
        else:
            channel.send(action)
