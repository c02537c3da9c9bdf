"""The topics that the scripts of one robot listen to, each subscribed once for all of them; and whom they ask.

A topic is subscribed when its process is loaded (literal names, `fame.scripting.topics`), else at its first use, which
cannot hear what was sent before. The inbox keeps the latest message of each topic, wakes who waits, fills queues.
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


class Types(Protocol):
    """What type a topic (full name) is known to have, None if nobody knows."""

    def __call__(self, topic: str, /) -> str | None: ...


class Ear:
    """One subscribed topic. `waiting`: who wants the next message, in the order of asking."""

    __slots__ = ("_changed", "latest", "queues", "subscription", "topic", "type", "waiting")

    def __init__(self, topic: str, type: str, changed: Callable[[], object]) -> None:
        self.topic, self.type, self._changed = topic, type, changed
        self.latest: Message = None
        self.waiting: dict[Wake, None] = {}
        self.queues: list[weakref.ref[MessageQueue]] = []
        self.subscription: Subscription | None = None

    def put(self, message: Message) -> None:
        """A message arrived."""
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
    """All of them. `subscribe` makes a subscription on a full topic name; `changed` is called after every message."""

    def __init__(self, node: Node, types: Types, subscribe: Subscribe, changed: Callable[[], object]) -> None:
        self._node, self._types, self._subscribe, self._changed = node, types, subscribe, changed
        self._ears: dict[str, Ear] = {}
        self._clients: dict[tuple[str, str], Client] = {}
        self._actions: dict[tuple[str, str], ActionClient] = {}

    def listen(self, topic: str, type: str | None = None) -> Ear:
        """Hear a topic, named as seen from the robot.

        Raises MessageError if no type is known, or it is not that one.
        """
        name = resolve(topic, self._node.namespace)
        ear = self._ears.get(name)
        if ear is not None:
            if type is not None and _full(type) != _full(ear.type):
                raise MessageError(f"topic {name} is heard as {ear.type} already, not as {type}", type=type)
            return ear
        type = type or self._types(name)
        if type is None:
            raise MessageError(f"topic {name}: nobody says its type; name it in the script, as in "
                               f"receive({topic!r}, \"std_msgs/msg/String\")")  # fmt: skip
        ear = Ear(name, type, self._changed)
        ear.subscription = self._subscribe(name, type, ear.put)
        self._ears[name] = ear
        return ear

    @property
    def types(self) -> dict[str, str]:
        """The topics that scripts hear by now, by full name, each with its type."""
        return {topic: ear.type for topic, ear in self._ears.items()}

    def latest(self, topic: str, type: str | None = None) -> Message | None:
        """The latest message since the topic was subscribed, None if there was none. Errors as `listen`."""
        return self.listen(topic, type).latest

    def queue(self, topic: str, type: str | None, depth: int) -> MessageQueue:
        """A queue of the messages to come; it lives as long as somebody holds it. Errors as `listen`."""
        ear = self.listen(topic, type)
        queue = MessageQueue(ear.topic, depth)
        ear.queues.append(weakref.ref(queue))
        return queue

    def client(self, service: str, type: str) -> Client:
        """What asks a service, named as seen from the robot. Raises MessageError if the type is unknown."""
        client = self._clients.get((service, type))
        if client is None:
            client = self._clients[service, type] = self._node.client(service, type)
        return client

    def action(self, name: str, type: str) -> ActionClient:
        """What sends goals to an action, likewise."""
        client = self._actions.get((name, type))
        if client is None:
            client = self._actions[name, type] = ActionClient(self._node, name, type)
        return client

    def deliver(self, topic: str, message: Any) -> None:
        """A message of the robot's own on a full topic name, which the middleware does not bring back."""
        ear = self._ears.get(topic)
        if ear is not None:
            ear.put(message)

    def close(self) -> None:
        """Hear nothing any more."""
        for ear in self._ears.values():
            if ear.subscription is not None:
                ear.subscription.close()
        for client in self._clients.values():
            client.close()
        for action in self._actions.values():
            action.close()
        self._actions.clear()
        self._ears.clear()
        self._clients.clear()


def _full(type: str) -> str:
    """The name of a type in its long form."""
    package, _, name = type.rpartition("/")
    return f"{package.removesuffix('/msg')}/msg/{name}"
