"""The topic endpoints of one robot: those that its events and scripts name, and those for messages to one robot.

Endpoints are made when a process is loaded, before the first token moves, so that discovery is over when they are
needed. A topic whose type is known only while the mission runs gets its endpoint on first use.

Messages for one robot: ``order`` for Worker_2 is sent on ``/Worker_2/bpmn_message/order``. Each robot subscribes to
such a topic for every message that its events catch, besides the topic that reaches all. The publisher towards a robot
is made when that robot is discovered (`DirectMessages.connect`), and a message waits until it is connected, at most
some seconds: so no message for a robot that is there is lost to discovery.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any

from fame.bpmn.model import Expression
from fame.bpmn.topics import TopicUse
from fame.clock import SECOND, Entry, Scheduler
from fame.engine.host import BpmnError
from fame.errors import MessageError, ModelError
from fame.middleware import messages, qos
from fame.middleware.interface import SIGNAL, AnyMessage, Middleware, Node, Publisher, QoS, known_topics, resolve
from fame.scripting import Inbox, ScriptTopic

_PATIENCE, _POLL = 5 * SECOND, SECOND // 100
"""Time that a direct message waits for its publisher to be connected, and interval of the checks (ns)."""
_SHOWN = 5
"""Robots that an error message names."""

MakePublisher = Callable[[str, str, QoS], Publisher]
"""Gives the publisher on a topic (full name, type, quality of service)."""
OnMessage = Callable[[str, Any], object]
"""Takes the qualified name of a topic, and a message on it."""
ReportLoss = Callable[[str], object]
"""Takes what people should know."""


class Endpoints:
    """The endpoints of one robot.

    uses    qualified name of a topic -> how the model uses it
    caught  the topics that its own events catch: full name -> qualified name
    direct  its messages to single robots
    """

    def __init__(
        self,
        node: Node,
        uses: Mapping[str, TopicUse],
        middleware: Middleware,
        scheduler: Scheduler,
        report: ReportLoss = lambda text: None,
    ) -> None:
        self._node, self._uses, self._middleware = node, uses, middleware
        self.direct: DirectMessages = DirectMessages(node, middleware, scheduler, self.publisher, report)
        self._publishers: dict[str, Publisher] = {}  # by full name
        self._thrown: dict[str, Publisher] = {}  # those of throwing events, by qualified name
        self.caught: dict[str, str] = {}
        self._own: dict[str, str] = {}  # its topics for messages to it alone: full name -> qualified name
        self._names = {resolve(name, node.namespace): name for name in uses}

    def open(self, on_message: OnMessage) -> None:
        """Make the endpoints of all events. Raises ModelError."""
        for name, use in self._uses.items():
            try:
                self._open(name, use, partial(on_message, name))
            except MessageError as error:
                event = (*use.throws, *use.catches)[0]
                node = event.node
                raise ModelError(
                    str(error), file=event.file, line=node.line, element=node.id, name=node.name
                ) from error

    def open_for_scripts(self, topics: Iterable[tuple[Expression, ScriptTopic]], inbox: Inbox) -> None:
        """Make the endpoints that scripts name, as far as their types are known by now. Raises MessageError."""
        for script, topic in topics:
            # A script in JavaScript reports the error itself when it runs.
            with suppress(*([MessageError] if script.language == "javascript" else [])):
                self._open_for_script(topic.name, topic.direction, topic.type, inbox)

    def prepare(self, name: str, value: Any) -> tuple[Publisher, Any]:
        """Return the publisher of an event's topic, and the message of a payload. Raises MessageError."""
        publisher = self._thrown[name]
        return publisher, messages.create(publisher.type, value)

    def qualified(self, full: str) -> str | None:
        """Return the qualified name of a topic that events throw or catch; None for any other topic."""
        return self._names.get(full)

    def publisher(self, full: str, type: str, profile: QoS = SIGNAL) -> Publisher:
        """Return the publisher on a topic, made on first use. Raises MessageError."""
        if full not in self._publishers:
            self._publishers[full] = self._node.publisher(full, type, profile)
        return self._publishers[full]

    def type(self, full: str) -> str | None:
        """Return the type of a topic: from the model, else from the middleware's graph; None if unknown."""
        for name, use in self._uses.items():
            if use.declared and resolve(name, self._node.namespace) == full:
                return use.declared
        info = next((item for item in known_topics(self._middleware, [full]) if item.name == full), None)
        return info.types[0] if info is not None and info.types else None

    def _open(self, name: str, use: TopicUse, on_message: Callable[[Any], object]) -> None:
        full = resolve(name, self._node.namespace)
        profile = qos.parse(use.qos) if use.qos else SIGNAL
        if use.ttl:
            profile = replace(profile, acknowledged=True)
        if use.throws:
            self._thrown[name] = self.publisher(full, use.type, profile)
        if use.addresses:
            self.direct.add(name, use.type, profile)
        if use.catches:
            self.caught[full] = name
            self._node.subscription(full, use.type, on_message, profile)
        if use.takes_messages:
            own = direct_topic(name, self._node.namespace)
            if (other := self._own.setdefault(own, name)) != name:
                raise MessageError(f"messages {other} and {name} are the same if they are for one robot: rename one")
            self._node.subscription(own, use.type, on_message, profile)

    def _open_for_script(self, topic: str, direction: str, type: str | None, inbox: Inbox) -> None:
        if direction in ("call", "act"):
            with suppress(MessageError):  # the script reports it itself when it runs
                (inbox.client if direction == "call" else inbox.action)(topic, type or "")
            return
        full = resolve(topic, self._node.namespace)
        known = type or self.type(full)
        if known is not None and direction == "publish":
            self.publisher(full, known)
        elif known is not None and direction == "subscribe":
            inbox.listen(full, known)


def direct_topic(topic: str, robot: str) -> str:
    """Return the full name of the topic over which a message (its qualified name) reaches one robot.

    >>> direct_topic("/order", "Worker_2")
    '/Worker_2/bpmn_message/order'
    """
    return f"/{robot}{_suffix(topic)}"


def _suffix(topic: str) -> str:
    return f"/bpmn_message/{topic.lstrip('~/')}"


def subscribers_of(middleware: Middleware, suffix: str, own: str) -> list[str]:
    """Return the robots, in order, on whose topic that ends like this another node than `own` (a
    full name) subscribes."""
    return [
        info.name.removeprefix("/").removesuffix(suffix)
        for info in known_topics(middleware, [f"/*{suffix}"])
        if info.name.endswith(suffix) and any(name != own for name in info.subscribers)
    ]


class DirectMessages:
    """The messages that one robot sends to others by name. `report` gets those that may not arrive."""

    def __init__(
        self,
        node: Node,
        middleware: Middleware,
        scheduler: Scheduler,
        publisher: MakePublisher,
        report: ReportLoss = lambda text: None,
    ) -> None:
        self._node, self._middleware, self._scheduler, self._publisher = node, middleware, scheduler, publisher
        self._report = report
        self._topics: dict[str, tuple[str, QoS]] = {}
        self._waiting: deque[tuple[int, Publisher, AnyMessage]] = deque()
        self._poll: Entry | None = None

    def add(self, topic: str, type: str, profile: QoS) -> None:
        """Announce that messages will be sent on this topic (its qualified name)."""
        self._topics[topic] = type, profile

    def connect(self) -> None:
        """Make the publishers to all discovered robots."""
        for topic, (type, profile) in self._topics.items():
            for robot in self._receivers(topic):
                self._publisher(direct_topic(topic, robot), type, profile)

    def send(self, topic: str, value: Any, robot: Any) -> None:
        """Send a message to a robot. Raises MessageError, and BpmnError ``unreachable`` if no such robot takes it."""
        self.enter(*self.prepare(topic, value, robot))

    def prepare(self, topic: str, value: Any, robot: Any) -> tuple[Publisher, AnyMessage]:
        """Return the publisher to a robot, and the message. Raises what `send` raises."""
        receivers = self._receivers(topic)
        if robot not in receivers:
            known = ", ".join([*receivers[:_SHOWN], *(["..."] if len(receivers) > _SHOWN else [])]) or "none"
            raise BpmnError("unreachable", f"no other robot {robot!r} takes message {topic}; robots that do: {known}")
        type, profile = self._topics[topic]
        publisher = self._publisher(direct_topic(topic, robot), type, profile)
        return publisher, messages.create(type, value)

    def enter(self, publisher: Publisher, message: AnyMessage) -> None:
        """Publish a message as soon as its publisher is connected, after those that are already waiting."""
        self._waiting.append((self._scheduler.now + _PATIENCE, publisher, message))
        self._flush()

    def close(self) -> None:
        """Drop the messages that are still waiting."""
        while self._waiting:
            self._report(f"a message on {self._waiting.popleft()[1].topic} is not sent: its robot is not connected")
        if self._poll is not None:
            self._poll.cancel()

    def _receivers(self, topic: str) -> list[str]:
        """The other robots that subscribe to a message, in order."""
        if not self._topics:
            return []
        return subscribers_of(self._middleware, _suffix(topic), self._node.full_name)

    def _flush(self) -> None:
        """Publish, in order, the messages whose publisher is connected or whose time is up."""
        connecting = self._middleware.connecting(self._node)
        now = self._scheduler.now
        while self._waiting and (self._waiting[0][1].topic not in connecting or self._waiting[0][0] <= now):
            _, publisher, message = self._waiting.popleft()
            connected = publisher.topic not in connecting and publisher.subscriber_count()
            publisher.publish(message)
            if not connected:
                self._report(f"a message on {publisher.topic} may be lost: its robot is not connected")
        if self._waiting and (self._poll is None or self._poll.action is None):
            self._poll = self._scheduler.after(_POLL, self._flush)
