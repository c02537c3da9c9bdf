"""Nodes, and their ends of topics.

rclpy brings a node its own messages back. Each subscription therefore keeps what publishers of its own node have sent
to it, and drops the echo: the next sample with the same bytes. Echoes of one publisher come in its order, so the ones
before a found one were lost; one that does not come within a second was lost too.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.node import Node

from fame.clock import SECOND
from fame.errors import MessageError
from fame.middleware import codec, messages
from fame.middleware.interface import SIGNAL, Message, QoS, resolve
from fame.middleware.primitives import describe
from fame.middleware.qos import compatible
from fame.middleware.ros.services import RosClient, RosService
from fame.middleware.ros.translation import profile, ros_class

if TYPE_CHECKING:
    from fame.middleware.ros.middleware import RosMiddleware

_LOST = SECOND
"""How long an echo may take (ns)."""


class RosNode:
    """A node of rclpy, which is `ros`. See `fame.middleware.interface.Node`."""

    def __init__(self, middleware: RosMiddleware, name: str, namespace: str) -> None:
        self.middleware = middleware
        self.ros = Node(name, namespace=f"/{namespace}", context=middleware.context)
        self.name, self.namespace = self.ros.get_name(), self.ros.get_namespace().strip("/")
        self.full_name = resolve(self.name, self.namespace)
        self.publishers: list[RosPublisher] = []
        self.subscriptions: list[RosSubscription] = []
        self.services: list[RosService | RosClient] = []
        middleware.executor.add_node(self.ros)

    def publisher(self, topic: str, type: str, qos: QoS = SIGNAL) -> RosPublisher:
        publisher = RosPublisher(self, resolve(topic, self.namespace), type, qos)
        self.publishers.append(publisher)
        return publisher

    def subscription(
        self, topic: str, type: str, callback: Callable[[Message], object], qos: QoS = SIGNAL
    ) -> RosSubscription:
        subscription = RosSubscription(self, resolve(topic, self.namespace), type, callback, qos)
        self.subscriptions.append(subscription)
        return subscription

    def service(self, name: str, type: str, handler: Callable[[Message], Any]) -> RosService:
        service = RosService(self, resolve(name, self.namespace), type, handler)
        self.services.append(service)
        return service

    def client(self, name: str, type: str) -> RosClient:
        client = RosClient(self, resolve(name, self.namespace), type)
        self.services.append(client)
        return client

    def close(self) -> None:
        """Leave: all its ends are closed. Does nothing the second time."""
        if self not in self.middleware.nodes:
            return
        for end in (*self.publishers, *self.subscriptions, *self.services):
            end.close()
        self.middleware.nodes.remove(self)
        self.middleware.executor.remove_node(self.ros)
        self.ros.destroy_node()


class RosPublisher:
    """One end of a topic. `kept` is what those get who come late."""

    def __init__(self, node: RosNode, topic: str, type: str, qos: QoS) -> None:
        self.node, self.qos, self._closed = node, qos, False
        self._class = messages.message_type(type)
        self.type: str = self._class.__msgtype__
        node.middleware.check(topic, self.type)
        said = PublisherEventCallbacks(
            incompatible_qos=lambda event: node.middleware.mismatched(self.topic), use_default_callbacks=False
        )
        self._end = node.ros.create_publisher(ros_class(self.type), topic, profile(qos), event_callbacks=said)
        self.topic: str = self._end.topic_name
        depth = (None if qos.history == "keep_all" else qos.depth) if qos.durability == "transient_local" else 0
        self.kept: deque[bytes] = deque(maxlen=depth)

    def publish(self, message: Message) -> None:
        """Send it. Raises MessageError if it is not a message of the topic's type, and if the publisher is closed."""
        if self._closed or message.__class__ is not self._class:
            raise self._refusal(message)
        data = codec.serialize(message)
        for subscription in self.node.subscriptions:
            subscription.expect(self, (data,))
        self.kept.append(data)
        self._end.publish(data)

    def subscribers(self) -> int:
        """How many subscriptions it is connected to, those of its own node too."""
        return int(self._end.get_subscription_count())

    def matched(self) -> bool:
        """Whether there is a subscription of another node."""
        own = sum(other.hears(self) for other in self.node.subscriptions)
        return bool(self._end.get_subscription_count() > own)

    def close(self) -> None:
        if not self._closed:
            self._closed = True
            self.node.publishers.remove(self)
            self.node.ros.destroy_publisher(self._end)

    def _refusal(self, message: object) -> MessageError:
        if self._closed:
            return MessageError(f"the publisher on {self.topic} is closed", type=self.type)
        return MessageError(f"found {describe(message)} to publish on {self.topic}", type=self.type)


class RosSubscription:
    """The other end. What has come waits here until an entry of the scheduler takes it, at most `qos.depth`."""

    def __init__(self, node: RosNode, topic: str, type: str, callback: Callable[[Message], object], qos: QoS) -> None:
        self.node, self.qos, self._callback, self._closed = node, qos, callback, False
        self.type: str = messages.message_type(type).__msgtype__
        node.middleware.check(topic, self.type)
        self._waiting: deque[bytes] = deque(maxlen=None if qos.history == "keep_all" else qos.depth)
        self._echoes: dict[RosPublisher, deque[tuple[int, bytes]]] = {}
        self.topic = node.ros.resolve_topic_name(topic)
        if qos.durability == "transient_local":
            for publisher in node.publishers:
                self.expect(publisher, publisher.kept)
        said = SubscriptionEventCallbacks(
            incompatible_qos=lambda event: node.middleware.mismatched(self.topic), use_default_callbacks=False
        )
        self._end = node.ros.create_subscription(
            ros_class(self.type), topic, self._arrived, profile(qos), event_callbacks=said, raw=True
        )

    def hears(self, publisher: RosPublisher) -> bool:
        """Whether it is connected to a publisher of its own node."""
        return publisher.topic == self.topic and compatible(publisher.qos, self.qos) is None

    def expect(self, publisher: RosPublisher, sent: Iterable[bytes]) -> None:
        """A publisher of the own node sends these: they will come back."""
        if self.hears(publisher):
            now = self.node.middleware.scheduler.now
            self._echoes.setdefault(publisher, deque()).extend((now, data) for data in sent)

    def matched(self) -> bool:
        """Whether there is a publisher of another node."""
        own = sum(map(self.hears, self.node.publishers))
        return bool(self._end.get_publisher_count() > own)

    def close(self) -> None:
        if not self._closed:
            self._closed = True
            self._waiting.clear()
            self.node.subscriptions.remove(self)
            self.node.ros.destroy_subscription(self._end)

    def _arrived(self, data: bytes) -> None:
        """In the executor's thread."""
        self._waiting.append(bytes(data))
        self.node.middleware.scheduler.soon(self._deliver)

    def _deliver(self) -> None:
        if not self._waiting or self._is_echo(data := self._waiting.popleft()):
            return
        try:
            message = codec.deserialize(data, self.type)
        except Exception as error:  # the generated code raises what the bytes make it raise
            self.node.middleware.warn(f"{self.topic}: dropped a message: {error}")
        else:
            self._callback(message)

    def _is_echo(self, data: bytes) -> bool:
        now = self.node.middleware.scheduler.now
        for sent in self._echoes.values():
            while sent and now - sent[0][0] > _LOST:
                sent.popleft()
            for place, (_, echo) in enumerate(sent):
                if echo == data:
                    for _ in range(place + 1):
                        sent.popleft()
                    return True
        return False
