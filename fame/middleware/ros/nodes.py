"""Nodes, and their ends of topics.

rclpy brings a node its own messages back: each subscription keeps what publishers of its own node have sent to it, and
drops the echo (`fame.middleware.self_echo_filter`).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.node import Node

from fame.errors import ConfigError
from fame.middleware.interface import Message, QoS
from fame.middleware.qos import compatible, counts_losses, one_more
from fame.middleware.ros.services import RosClient, RosService
from fame.middleware.ros.translation import profile, ros_class
from fame.middleware.self_echo_filter import Echoes
from fame.middleware.wire_base import Kinds, TopicEnd, WireNode

if TYPE_CHECKING:
    from fame.middleware.ros.middleware import RosMiddleware


_AT_ONCE = 100
"""How many messages are taken behind another if the history is not bounded."""


class RosPublisher(TopicEnd):
    """One end of a topic. `kept` is what those get who come late."""

    def __init__(self, node: RosNode, topic: str, type: str, qos: QoS) -> None:
        super().__init__(node, node.ros.resolve_topic_name(topic), type, qos)
        said = PublisherEventCallbacks(
            incompatible_qos=lambda event: node.middleware.mismatched(self.topic), use_default_callbacks=False
        )
        self._end = node.ros.create_publisher(ros_class(self.type), topic, profile(qos), event_callbacks=said)
        depth = (None if qos.history == "keep_all" else qos.depth) if qos.durability == "transient_local" else 0
        self.kept: deque[bytes] = deque(maxlen=depth)

    def publish(self, message: Message) -> None:
        """Send it. Raises MessageError if it is not a message of the topic's type, and if the publisher is closed."""
        data = self.pack(message)
        for subscription in self.node.subscriptions:
            subscription.expect(self, (data,))
        self.kept.append(data)
        self._end.publish(data)

    def subscribers(self) -> int:
        """How many subscriptions it is connected to, those of its own node too."""
        return int(self._end.get_subscription_count())

    def matched(self) -> bool:
        """Whether there is a subscription of another node."""
        return bool(self._end.get_subscription_count() > sum(other.hears(self) for other in self.node.subscriptions))

    def leave(self) -> None:
        self.node.ros.destroy_publisher(self._end)


class RosSubscription(TopicEnd):
    """The other end. What has come waits here until an entry of the scheduler takes it, at most `qos.depth`.

    ROS does not tell what is pushed out of the queue below rclpy. So that one holds one message more, and is emptied
    when the first has come: what is pushed out here then is counted, with what rclpy tells.
    """

    def __init__(self, node: RosNode, topic: str, type: str, callback: Callable[[Message], object], qos: QoS) -> None:
        super().__init__(node, node.ros.resolve_topic_name(topic), type, qos)
        self._callback, self._echoes = callback, Echoes()
        self._waiting: deque[bytes] = deque(maxlen=None if qos.history == "keep_all" else qos.depth)
        if qos.durability == "transient_local":
            for publisher in node.publishers:
                self.expect(publisher, publisher.kept)
        self._counts, self._more = counts_losses(qos), _AT_ONCE if qos.history == "keep_all" else qos.depth
        said = SubscriptionEventCallbacks(
            incompatible_qos=lambda event: node.middleware.mismatched(self.topic),
            message_lost=self._missed,
            use_default_callbacks=False,
        )
        self._end: Any = None
        self._end = node.ros.create_subscription(
            ros_class(self.type), topic, self._arrived, profile(one_more(qos)), event_callbacks=said, raw=True
        )

    def hears(self, publisher: RosPublisher) -> bool:
        """Whether it is connected to a publisher of its own node."""
        return publisher.topic == self.topic and compatible(publisher.qos, self.qos) is None

    def expect(self, publisher: RosPublisher, sent: Iterable[bytes]) -> None:
        """A publisher of the own node sends these: they will come back."""
        if self.hears(publisher):
            self._echoes.expect(publisher, sent, self.node.middleware.scheduler.now)

    def matched(self) -> bool:
        """Whether there is a publisher of another node."""
        return bool(self._end.get_publisher_count() > sum(map(self.hears, self.node.publishers)))

    def leave(self) -> None:
        self._waiting.clear()
        self.node.ros.destroy_subscription(self._end)

    def _arrived(self, data: bytes) -> None:
        """In the executor's thread."""
        self._keep(data)
        if self._end is None:  # it is being made
            return
        with self._end.handle:
            for _ in range(self._more):
                taken = self._end.handle.take_message(self._end.msg_type, self._end.raw)
                if taken is None:
                    break
                self._keep(taken[0])

    def _keep(self, data: bytes) -> None:
        self.lost += self._counts and len(self._waiting) == self._waiting.maxlen
        self._waiting.append(data)
        self.node.middleware.scheduler.soon(self._deliver)

    def _missed(self, event: Any) -> None:
        """In the executor's thread."""
        self.lost += self._counts * event.total_count_change

    def _deliver(self) -> None:
        if self._waiting:
            data = self._waiting.popleft()
            if not self._echoes.take(data, self.node.middleware.scheduler.now):
                self.unpack(data, self._callback)


class RosNode(WireNode):
    """A node of rclpy, which is `ros`."""

    kinds = Kinds(RosPublisher, RosSubscription, RosService, RosClient)
    publishers: list[RosPublisher]
    subscriptions: list[RosSubscription]
    services: list[RosService | RosClient]

    def __init__(self, middleware: RosMiddleware, name: str, namespace: str) -> None:
        try:
            self.ros = Node(name, namespace=f"/{namespace}", context=middleware.context)
        except Exception as error:  # rclpy raises what its C++ gives it
            text = " ".join(str(error).split())
            raise ConfigError(f"ROS 2 refuses a node /{namespace}/{name}: {text}") from None
        super().__init__(middleware, self.ros.get_name(), self.ros.get_namespace().strip("/"))
        middleware.executor.add_node(self.ros)

    def close(self) -> None:
        """Leave: all its ends are closed. Does nothing the second time."""
        if self in self.middleware.nodes:
            super().close()
            self.middleware.executor.remove_node(self.ros)
            self.ros.destroy_node()
