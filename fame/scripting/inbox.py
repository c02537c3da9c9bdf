"""Subscriptions and clients of the scripts of one robot: each topic is subscribed once for all scripts.

A topic is subscribed when its process is loaded (literal names, `fame.scripting.analysis`), else at its first use,
which misses earlier messages. The inbox keeps the latest message of each topic, wakes waiting scripts and fills queues.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable
from typing import Any, Protocol

from fame.errors import MessageError
from fame.middleware.actions import ActionClient
from fame.middleware.interface import Client, Message, Node, Subscription, resolve
from fame.scripting.requests import MessageQueue

Subscribe = Callable[[str, str, Callable[[Message], object]], Subscription]
Wake = Callable[[Message], object]


class TopicTypes(Protocol):
    """The type of a topic by its full name, None if it is unknown."""

    def __call__(self, topic: str, /) -> str | None: ...


class TopicListener:
    """One subscribed topic. `waiting`: callbacks for the next message, in the order of their requests."""

    __slots__ = ("_changed", "latest", "queues", "subscription", "topic", "type", "waiting")

    topic: str
    type: str

    def __init__(self, topic: str, type: str, changed: Callable[[], object]) -> None:
        self.topic: str = topic
        self.type: str = type
        self._changed = changed
        self.latest: Message = None
        self.waiting: dict[Wake, None] = {}
        self.queues: list[weakref.ref[MessageQueue]] = []
        self.subscription: Subscription | None = None

    def put(self, message: Message) -> None:
        """Handle a message that has arrived."""
        self.latest = message
        waiting, self.waiting = self.waiting, {}
        for wake in waiting:
            wake(message)
        if self.queues:
            alive = [(reference, reference()) for reference in self.queues]
            self.queues = [reference for reference, queue in alive if queue is not None]
            for _, queue in alive:
                if queue is not None:
                    queue.put(message)
        self._changed()


class Inbox:
    """All topics of one robot's scripts.

    `subscribe` creates a subscription to a full topic name; `changed` is called after every message.
    """

    def __init__(self, node: Node, types: TopicTypes, subscribe: Subscribe, changed: Callable[[], object]) -> None:
        self._node, self._types, self._subscribe, self._changed = node, types, subscribe, changed
        self._listeners: dict[str, TopicListener] = {}
        self._clients: dict[tuple[str, str], Client] = {}
        self._actions: dict[tuple[str, str], ActionClient] = {}

    def listen(self, topic: str, type: str | None = None) -> TopicListener:
        """Subscribe to a topic, named relative to the robot.

        Raises MessageError if the type is unknown, or if the topic has another one.
        """
        name = resolve(topic, self._node.namespace)
        listener = self._listeners.get(name)
        if listener is not None:
            if type is not None and _full(type) != _full(listener.type):
                raise MessageError(f"topic {name} is subscribed as {listener.type}, not as {type}", type=type)
            return listener
        type = type or self._types(name)
        if type is None:
            raise MessageError(f"topic {name}: unknown type; name it in the script, as in "
                               f"receive({topic!r}, \"std_msgs/msg/String\")")  # fmt: skip
        listener = TopicListener(name, type, self._changed)
        listener.subscription = self._subscribe(name, type, listener.put)
        self._listeners[name] = listener
        return listener

    @property
    def types(self) -> dict[str, str]:
        """The type of each topic that scripts have subscribed to, by full name."""
        return {topic: listener.type for topic, listener in self._listeners.items()}

    def latest(self, topic: str, type: str | None = None) -> Message | None:
        """The latest message since the subscription, None if there was none. Raises what `listen` raises."""
        return self.listen(topic, type).latest

    def queue(self, topic: str, type: str | None, depth: int) -> MessageQueue:
        """A queue of future messages, filled as long as it is referenced. Raises what `listen` raises."""
        listener = self.listen(topic, type)
        queue = MessageQueue(listener.topic, depth)
        listener.queues.append(weakref.ref(queue))
        return queue

    def client(self, service: str, type: str) -> Client:
        """The client of a service, named relative to the robot. Raises MessageError if the type is unknown."""
        client = self._clients.get((service, type))
        if client is None:
            client = self._clients[service, type] = self._node.client(service, type)
        return client

    def action(self, name: str, type: str) -> ActionClient:
        """The client of an action, named relative to the robot. Raises MessageError if the type is unknown."""
        client = self._actions.get((name, type))
        if client is None:
            client = self._actions[name, type] = ActionClient(self._node, name, type)
        return client

    def deliver(self, topic: str, message: Any) -> None:
        """Deliver a message that the robot itself has published; the middleware does not return it."""
        listener = self._listeners.get(topic)
        if listener is not None:
            listener.put(message)

    def close(self) -> None:
        """Close all subscriptions and clients."""
        for listener in self._listeners.values():
            if listener.subscription is not None:
                listener.subscription.close()
        for client in self._clients.values():
            client.close()
        for action in self._actions.values():
            action.close()
        self._actions.clear()
        self._listeners.clear()
        self._clients.clear()


def _full(type: str) -> str:
    """The name of a type in its long form."""
    package, _, name = type.rpartition("/")
    return f"{package.removesuffix('/msg')}/msg/{name}"
