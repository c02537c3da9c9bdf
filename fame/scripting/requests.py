"""Awaitable requests of scripts.

`sleep(2)` does nothing by itself. ``await`` yields the request to the runner (`fame.scripting.runner`), which sends
the result or throws the error. There is no event loop, and nothing else can be awaited.
"""

from __future__ import annotations

import math
import weakref
from collections import deque
from collections.abc import Callable, Generator, Mapping
from functools import partial
from typing import Any, Protocol

from fame.clock import SECOND
from fame.dataclasses import dataclass
from fame.engine.host import BpmnError
from fame.errors import MessageError
from fame.middleware.actions import ActionClient
from fame.middleware.interface import AnyMessage, Client, Node, Subscription, resolve
from fame.scripting.transforms import TF, TOPICS, TransformBuffer

SERVICE_TIMEOUT = 5 * SECOND
"""Time that a script waits for an unavailable service or action (ns)."""
MOMENT = SECOND // 2
"""Time before a request is made again whose server has left or been replaced (ns): a request is lost that arrives
before the server has found its client again."""


class ScriptRequest:
    """Base class of everything that a script can await."""

    __slots__ = ()

    def __await__(self) -> Generator[ScriptRequest, Any, Any]:
        return (yield self)


@dataclass(frozen=True, slots=True)
class Sleep(ScriptRequest):
    """``await sleep(2)``: continue after this time on the engine's clock (s)."""

    seconds: float

    def __post_init__(self) -> None:
        check_seconds("sleep", self.seconds)

    def __str__(self) -> str:
        return f"sleep({self.seconds:g})"


@dataclass(frozen=True, slots=True)
class Receive(ScriptRequest):
    """``await receive("odom", timeout=1)``: the next message that arrives on a topic; TimeoutError after `timeout` s.

    `type` is ``pkg/msg/Type``; it may be omitted if a publisher or the model declares it.
    """

    topic: str
    type: str | None = None
    timeout: float | None = None

    def __post_init__(self) -> None:
        check_topic("receive", self.topic)
        check_seconds("receive: timeout", self.timeout)

    def __str__(self) -> str:
        return f"receive({self.topic!r})"


@dataclass(frozen=True, slots=True)
class Until(ScriptRequest):
    """``await until(lambda: battery < 20)``: continue when the condition is true; TimeoutError after `timeout` s.

    The condition is evaluated at once, then after every step of a script or of the engine and after every message of
    this robot: whatever can change a variable. For a condition that depends on time alone, use `sleep`.
    """

    condition: Callable[[], Any]
    timeout: float | None = None

    def __post_init__(self) -> None:
        if not callable(self.condition):
            raise TypeError("until: expected a function that is called repeatedly, as in until(lambda: x > 3)")
        check_seconds("until: timeout", self.timeout)

    def __str__(self) -> str:
        return "until(...)"


@dataclass(frozen=True, slots=True)
class Next(ScriptRequest):
    """The next message of a subscription: what ``async for`` awaits."""

    queue: MessageQueue

    def __str__(self) -> str:
        return str(self.queue)


@dataclass(frozen=True, slots=True)
class Call(ScriptRequest):
    """``await robot.call("spawn", "pkg/srv/Spawn", x=1.0)``: the response of a service."""

    service: str
    type: str
    fields: Mapping[str, Any] | None

    def __str__(self) -> str:
        return f"call({self.service!r})"


STILL_RUNNING = "still_running"
"""The code of the error of a request whose cancelled goal does not end; also the signal that one still runs."""


class GoalError(BpmnError):
    """A goal of an action that did not succeed: code ``rejected``, ``aborted`` or ``canceled``, and its `result`.

    The result is a message; None for a rejected goal.
    """

    result: Any

    def __init__(self, code: str, message: str, result: Any) -> None:
        super().__init__(code, message)
        self.result = result


@dataclass(frozen=True, slots=True)
class Act(ScriptRequest):
    """``await robot.act("navigate_to_pose", "nav2_msgs/action/NavigateToPose", pose=...)``: the result of an action.

    `feedback` is called with the feedback of the action. BpmnError ``rejected``, ``aborted`` or ``canceled`` if it does
    not succeed. Cancelling the script cancels the goal. `wait` is for how long it waits until cancelled goals of the
    action have ended (s), before BpmnError ``still_running``; with 0 it is sent beside them.
    """

    action: str
    type: str
    fields: Mapping[str, Any] | None
    feedback: Callable[[Any], object] | None = None
    wait: float = 0.0

    def __str__(self) -> str:
        return f"act({self.action!r})"


class MessageQueue:
    """``async for message in robot.subscribe("odom")``: the last `depth` messages not yet taken, oldest first."""

    __slots__ = ("__weakref__", "messages", "topic", "waiting")

    def __init__(self, topic: str, depth: int) -> None:
        if not isinstance(depth, int) or depth < 1:
            raise ValueError(f"subscribe: queue={depth!r}: expected a number of messages to keep, at least 1")
        self.topic: str = topic
        self.messages: deque[Any] = deque(maxlen=depth)
        self.waiting: dict[Callable[[], object], None] = {}

    def __str__(self) -> str:
        return f"next message of {self.topic}"

    def put(self, message: Any) -> None:
        """Add a message and wake all scripts that wait for one."""
        self.messages.append(message)
        for wake in tuple(self.waiting):
            wake()

    def __aiter__(self) -> MessageQueue:
        return self

    def __anext__(self) -> Next:
        return Next(self)


def check_seconds(what: str, seconds: Any) -> None:
    """Raises TypeError or ValueError unless it is None or a finite number of seconds, not negative."""
    if seconds is None and what != "sleep":
        return
    try:
        wrong = not math.isfinite(seconds) or seconds < 0
    except TypeError:
        raise TypeError(f"{what}: {seconds!r} is not a number of seconds") from None
    if wrong:
        raise ValueError(f"{what}: {seconds!r} s: expected a finite number, 0 or more")


def check_topic(what: str, topic: Any) -> None:
    """Raises TypeError unless it is the name of a topic."""
    if not isinstance(topic, str) or not topic:
        raise TypeError(f"{what}: {topic!r} is not the name of a topic")


Wake = Callable[[AnyMessage], object]


class TopicTypes(Protocol):
    """The type of a topic by its full name, None if it is unknown."""

    def __call__(self, topic: str, /) -> str | None: ...


class TopicListener:
    """One subscribed topic. `waiting`: callbacks for the next message, in the order of their requests."""

    __slots__ = ("_changed", "_keep", "latest", "queues", "subscription", "topic", "type", "waiting")

    def __init__(self, topic: str, type: str, changed: Callable[[], object], keep: Wake | None = None) -> None:
        self._keep = keep
        self.topic: str = topic
        self.type: str = type
        self._changed = changed
        self.latest: AnyMessage = None
        self.waiting: dict[Wake, None] = {}
        self.queues: list[weakref.ref[MessageQueue]] = []
        self.subscription: Subscription | None = None

    def put(self, message: AnyMessage) -> None:
        """Handle a message that has arrived."""
        self.latest = message
        if self._keep is not None:
            self._keep(message)
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

    `changed` is called after every message.
    """

    def __init__(self, node: Node, types: TopicTypes, changed: Callable[[], object]) -> None:
        self._node, self._types, self._changed = node, types, changed
        self._listeners: dict[str, TopicListener] = {}
        self._transforms = TransformBuffer(node.namespace)
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
        frames = _full(type) == TF and name in TOPICS
        keep = partial(self._transforms.put, static=name == "/tf_static") if frames else None
        listener = TopicListener(name, type, self._changed, keep)
        listener.subscription = self._node.subscription(name, type, listener.put, *([TOPICS[name]] if frames else []))
        self._listeners[name] = listener
        return listener

    def type_of(self, topic: str) -> str | None:
        """Return the type of a topic (full name) that scripts have subscribed to, else None."""
        listener = self._listeners.get(topic)
        return listener.type if listener is not None else None

    def latest(self, topic: str, type: str | None = None) -> AnyMessage | None:
        """Return the latest message since the subscription, None if there was none. Raises what `listen` raises."""
        return self.listen(topic, type).latest

    def transform(self, target: str, source: str, at: Any) -> AnyMessage | None:
        """As `TransformBuffer.lookup`; the first call subscribes."""
        for topic in TOPICS:
            self.listen(topic, TF)
        return self._transforms.lookup(target, source, at)

    def queue(self, topic: str, type: str | None, depth: int) -> MessageQueue:
        """Return a queue of future messages, filled as long as it is referenced. Raises what `listen` raises."""
        listener = self.listen(topic, type)
        queue = MessageQueue(listener.topic, depth)
        listener.queues.append(weakref.ref(queue))
        return queue

    def client(self, service: str, type: str) -> Client:
        """Return the client of a service, named relative to the robot. Raises MessageError if the type is unknown."""
        client = self._clients.get((service, type))
        if client is None:
            client = self._clients[service, type] = self._node.client(service, type)
        return client

    def action(self, name: str, type: str) -> ActionClient:
        """Return the client of an action, named relative to the robot. Raises MessageError if the type is unknown."""
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
