"""The robot's ends of topics: what its events throw and catch, and what its scripts name.

Ends are made when a process is loaded, before the first token moves, so that discovery is over when they are needed. A
topic whose type only shows while the mission runs gets its end when it is used first.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from functools import partial
from typing import Any

from fame.bpmn.model import Expression
from fame.bpmn.topics import TopicUse
from fame.clock import Scheduler
from fame.errors import MessageError, ModelError
from fame.middleware import messages, qos
from fame.middleware.interface import SIGNAL, Middleware, Node, Publisher, QoS, resolve
from fame.robot.addressed import Addressed, address
from fame.scripting import Inbox, script_topics


class Ends:
    """Those of one robot. `types`: qualified name of a topic -> how the model uses it.

    `caught` has the topics that own events catch: full name -> qualified name.
    """

    def __init__(self, node: Node, types: Mapping[str, TopicUse], middleware: Middleware, scheduler: Scheduler) -> None:
        self._node, self._types, self._middleware = node, types, middleware
        self.addressed = Addressed(node, middleware, scheduler, self.publisher)
        self._publishers: dict[str, Publisher] = {}  # by full name
        self._throws: dict[str, Publisher] = {}  # of events, by qualified name
        self.caught: dict[str, str] = {}
        self._names = {resolve(name, node.namespace): name for name in types}

    def open(self, heard: Callable[[str, Any], object]) -> None:
        """Make those that events name; `heard` gets the qualified name and the message. Raises ModelError."""
        for name, use in self._types.items():
            try:
                self._open(name, use, partial(heard, name))
            except MessageError as error:
                end = (*use.throws, *use.catches)[0]
                raise ModelError(
                    str(error), file=end.file, line=end.node.line, element=end.node.id, name=end.node.name
                ) from error

    def open_named(self, scripts: Iterable[Expression], inbox: Inbox) -> None:
        """Make those that scripts name, as far as their types are known by now."""
        for script in scripts:
            for topic in script_topics(script):
                with suppress(*([MessageError] if script.language == "javascript" else [])):  # it will say so itself
                    self._open_named(topic.name, topic.direction, topic.type, inbox)

    def throw(self, name: str, value: Any) -> tuple[str, Any]:
        """Publish what an event throws; returns the topic's full name and the message. Raises MessageError."""
        publisher = self._throws[name]
        message = messages.create(publisher.type, value)
        publisher.publish(message)
        return publisher.topic, message

    def qualified(self, full: str) -> str | None:
        """The qualified name of a topic that events throw or catch, None if they do neither."""
        return self._names.get(full)

    def publisher(self, full: str, type: str, profile: QoS = SIGNAL) -> Publisher:
        """The publisher on a topic: the one that is there, or a new one. Raises MessageError."""
        if full not in self._publishers:
            self._publishers[full] = self._node.publisher(full, type, profile)
        return self._publishers[full]

    def type(self, full: str) -> str | None:
        """The type of a topic, from the model, else from whoever is at its other end."""
        for name, use in self._types.items():
            if use.declared and resolve(name, self._node.namespace) == full:
                return use.declared
        info = next((item for item in self._middleware.graph() if item.name == full), None)
        return info.types[0] if info is not None and info.types else None

    def _open(self, name: str, use: TopicUse, heard: Callable[[Any], object]) -> None:
        full = resolve(name, self._node.namespace)
        profile = qos.parse(use.qos) if use.qos else SIGNAL
        if use.throws:
            self._throws[name] = self.publisher(full, use.type, profile)
        if use.addresses:
            self.addressed.open(name, use.type, profile)
        if use.catches:
            self.caught[full] = name
            self._node.subscription(full, use.type, heard, profile)
        if use.takes_messages:
            self._node.subscription(address(name, self._node.namespace), use.type, heard, profile)

    def _open_named(self, topic: str, direction: str, type: str | None, inbox: Inbox) -> None:
        if direction in ("call", "act"):
            with suppress(MessageError):  # the script will say so itself
                (inbox.client if direction == "call" else inbox.action)(topic, type or "")
            return
        full = resolve(topic, self._node.namespace)
        known = type or self.type(full)
        if known is not None and direction == "publish":
            self.publisher(full, known)
        elif known is not None and direction == "subscribe":
            inbox.listen(full, known)
