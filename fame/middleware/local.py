"""Topics within one process: deterministic, and so quick that a topic nobody hears costs next to nothing.

A message travels as the same object, which is why it must not be changed. `publish` hands it to every subscription of
another node that it matches: there it waits for an entry of the scheduler at the present time. So messages arrive in
the order in which they were published and, of one message, in the order of subscription. The history of a subscription
bounds what waits: with keep last, a message too many pushes out the oldest.

Quality of service counts as on the wire: ends that do not match hear nothing of each other, and `warnings` says so; who
joins late and asks for it gets the last messages of transient local publishers that are still there. Deadline and
liveliness are compared, not watched. Everything happens in the thread of the scheduler; others use `scheduler.soon`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from fame.bpmn.ros_names import NAMES, is_ros_name
from fame.clock import SECOND, Scheduler
from fame.middleware import messages
from fame.middleware.errors import loss, second_type, unpublishable
from fame.middleware.interface import LARGEST, SIGNAL, Message, QoS, TopicInfo, resolve
from fame.middleware.local_services import LocalClient, LocalService
from fame.middleware.qos import compatible, counts_losses


class LocalMiddleware:
    """The nodes of one process. `warnings` collects what a person should know; `on_warning` is told of each at once."""

    confined, use_sim_time = True, False

    def __init__(self, scheduler: Scheduler, on_warning: Callable[[str], object] | None = None) -> None:
        self.scheduler = scheduler
        self.warnings: list[str] = []
        self.nodes: list[LocalNode] = []
        self.topics: dict[str, Topic] = {}
        self.services: dict[str, LocalService] = {}
        self._on_warning = on_warning

    def node(self, name: str, namespace: str = "") -> LocalNode:
        """A new node. Several may have the same name, as in ROS."""
        node = LocalNode(self, name, namespace.strip("/"))
        self.nodes.append(node)
        return node

    def graph(self) -> list[TopicInfo]:
        return [self.topics[name].info() for name in sorted(self.topics)]

    def connecting(self, node: LocalNode) -> list[str]:
        return []  # ends are connected as they are made

    def namespaces(self) -> list[str]:
        return sorted({node.namespace for node in self.nodes if node.namespace})

    def losses(self) -> list[str]:
        ends = (end for node in self.nodes for end in node.ends if isinstance(end, LocalSubscription))
        return [loss(end.topic, end.node.full_name, end.lost) for end in ends if end.lost]

    def close(self) -> None:
        for node in list(self.nodes):
            node.close()

    def topic(self, name: str, type: str) -> Topic:
        """The topic of that full name. Raises MessageError if the type is unknown or not that of the topic."""
        type = messages.message_type(type).__msgtype__
        topic = self.topics.get(name)
        if topic is None:
            if not is_ros_name(name):
                self.warn(f"{name}: ROS 2 would refuse this name: {NAMES}")
            topic = self.topics[name] = Topic(name, type)
        if topic.type != type:
            info = topic.info()
            raise second_type(name, topic.type, (*info.publishers, *info.subscribers), type)
        return topic

    def warn(self, text: str) -> None:
        """Record a warning, unless it is recorded already."""
        if text not in self.warnings:
            self.warnings.append(text)
            if self._on_warning is not None:
                self._on_warning(text)


@dataclass(slots=True)
class Topic:
    """The ends of a topic, each in the order in which they came."""

    name: str
    type: str
    publishers: list[LocalPublisher] = field(default_factory=list)
    subscriptions: list[LocalSubscription] = field(default_factory=list)

    def info(self) -> TopicInfo:
        """What the graph shows of it."""
        publishers = tuple(end.node.full_name for end in self.publishers)
        return TopicInfo(self.name, (self.type,), publishers, tuple(end.node.full_name for end in self.subscriptions))


class LocalNode:
    """A participant. See `fame.middleware.interface.Node`."""

    def __init__(self, middleware: LocalMiddleware, name: str, namespace: str) -> None:
        self.middleware, self.name, self.namespace = middleware, name, namespace
        self.full_name = resolve(name, namespace)
        self.ends: list[LocalPublisher | LocalSubscription | LocalService | LocalClient] = []

    def publisher(self, topic: str, type: str, qos: QoS = SIGNAL) -> LocalPublisher:
        shared = self.middleware.topic(resolve(topic, self.namespace), type)
        publisher = LocalPublisher(self, shared, qos)
        for subscription in shared.subscriptions:
            self._match(publisher, subscription)
        shared.publishers.append(publisher)
        self.ends.append(publisher)
        return publisher

    def subscription(
        self, topic: str, type: str, callback: Callable[[Message], object], qos: QoS = SIGNAL
    ) -> LocalSubscription:
        shared = self.middleware.topic(resolve(topic, self.namespace), type)
        subscription = LocalSubscription(self, shared, callback, qos)
        for publisher in shared.publishers:
            if self._match(publisher, subscription) and qos.durability == "transient_local":
                publisher.repeat(subscription)
        shared.subscriptions.append(subscription)
        self.ends.append(subscription)
        return subscription

    def service(self, name: str, type: str, handler: Callable[[Message], Any]) -> LocalService:
        service = LocalService(self, resolve(name, self.namespace), type, handler)
        self.ends.append(service)
        return service

    def client(self, name: str, type: str) -> LocalClient:
        client = LocalClient(self, resolve(name, self.namespace), type)
        self.ends.append(client)
        return client

    def close(self) -> None:
        """Leave: all its ends are closed. Does nothing the second time."""
        for end in list(self.ends):
            end.close()
        if self in self.middleware.nodes:
            self.middleware.nodes.remove(self)

    def leave(self, end: LocalPublisher | LocalSubscription, topic: Topic) -> None:
        """An end has closed. A topic without ends is gone, and with it its type."""
        self.ends.remove(end)
        if not topic.publishers and not topic.subscriptions:
            del self.middleware.topics[topic.name]

    def _match(self, publisher: LocalPublisher, subscription: LocalSubscription) -> bool:
        """Connect two ends of different nodes, unless their quality of service keeps them apart."""
        if publisher.node is subscription.node:
            return False
        mismatch = compatible(publisher.qos, subscription.qos)
        if mismatch is None:
            publisher.matched.append(subscription)
            return True
        ends = f"{subscription.node.full_name} hears nothing from {publisher.node.full_name}"
        self.middleware.warn(f"{publisher.topic}: {ends}: {mismatch}")
        return False


class LocalPublisher:
    """One end of a topic. `matched` are the subscriptions that it reaches, in the order in which they came."""

    def __init__(self, node: LocalNode, shared: Topic, qos: QoS) -> None:
        self.node, self.topic, self.type, self.qos = node, shared.name, shared.type, qos
        self.matched: list[LocalSubscription] = []
        self._shared = shared
        self._class: type[Message] | None = messages.message_type(shared.type)
        self._kept: deque[tuple[int, Message]] | None = None
        if qos.durability == "transient_local":
            self._kept = deque(maxlen=None if qos.history == "keep_all" else qos.depth)

    def publish(self, message: Message) -> None:
        """Send it. Raises MessageError if it is not a message of the topic's type, and if the publisher is closed."""
        if message.__class__ is not self._class:
            raise unpublishable(self, message, closed=self._class is None)
        if self._kept is not None:
            self._kept.append((self.node.middleware.scheduler.now, message))
        for subscription in self.matched:
            subscription.accept(message)

    def repeat(self, subscription: LocalSubscription) -> None:
        """Send what is kept for those who come late, as far as its lifespan is not over."""
        lifespan, now = self.qos.lifespan, self.node.middleware.scheduler.now
        for time, message in self._kept or ():
            if lifespan is None or now - time <= lifespan * SECOND:
                subscription.accept(message)

    def close(self) -> None:
        if self._class is not None:
            self._class = None
            self.matched.clear()
            self._shared.publishers.remove(self)
            self.node.leave(self, self._shared)


class LocalSubscription:
    """The other end."""

    def __init__(self, node: LocalNode, shared: Topic, callback: Callable[[Message], object], qos: QoS) -> None:
        self.node, self.topic, self.type, self.qos = node, shared.name, shared.type, qos
        self._shared, self._callback = shared, callback
        self.limit = LARGEST
        self.dropped: Callable[[str], object] = node.middleware.warn  # never: nothing is written and read here
        self._waiting: deque[Message] = deque()
        self._depth = -1 if qos.history == "keep_all" else qos.depth
        self.lost = 0  # messages, since it was made
        self._pushed_out = 0  # entries of the scheduler, always the first to come up, whose message waits no more
        self._counts = counts_losses(qos)
        self._soon = node.middleware.scheduler.soon
        self._deliver = self._deliver_next  # bound once

    def accept(self, message: Message) -> None:
        """Let a message wait for its entry of the scheduler."""
        waiting = self._waiting
        if len(waiting) == self._depth:
            waiting.popleft()
            self._pushed_out += 1
            self.lost += self._counts
        waiting.append(message)
        self._soon(self._deliver)

    def close(self) -> None:
        if self in self._shared.subscriptions:
            self._waiting.clear()
            self._shared.subscriptions.remove(self)
            for publisher in self._shared.publishers:
                if self in publisher.matched:
                    publisher.matched.remove(self)
            self.node.leave(self, self._shared)

    def _deliver_next(self) -> None:
        if self._pushed_out:
            self._pushed_out -= 1
        elif self._waiting:
            self._callback(self._waiting.popleft())
