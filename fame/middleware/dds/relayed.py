"""The middleware of an engine whose participant is in the process that forked it (`fame.middleware.dds.relay`).

Messages go over a `RelayLink`, one way each. What needs an answer, such as the graph, is asked and waited for: that
process takes questions of all its engines in turn.

If the link ends, that process was killed, or this one was stopped for longer than the lease. Then this one has a relay
of its own, where its nodes and endpoints are made again: to bring the robot to its safe state, or to go on. Until those
of others are found, whoever sends or asks waits.

Threads. One reads the link: it puts messages into the queues of subscriptions. The relay of its own has one. All else
happens in the scheduler's.
"""

from __future__ import annotations

import os
import pickle
import socket
import threading
from collections import deque
from collections.abc import Callable, Hashable, Iterator, Sequence, Set
from contextlib import suppress
from functools import partial
from itertools import count
from queue import SimpleQueue
from typing import Any, ClassVar

from fame.clock import WallScheduler
from fame.errors import FameError, MessageError
from fame.middleware import codec, typesystem
from fame.middleware.data_scheduler import DataScheduler
from fame.middleware.dds.link import ASK, DATA, EVENT, RelayLink
from fame.middleware.dds.relay import KEY, Relay
from fame.middleware.interface import AnyMessage, EndpointWarning, QoS, TopicInfo
from fame.middleware.wire_base import EndpointClasses, WireMiddleware, WireNode
from fame.middleware.wire_endpoints import (
    Callback,
    WireClient,
    WireEndpoint,
    WirePublisher,
    WireService,
    WireSubscription,
)

_ENDED = "the process that started this engine has ended"


class RelayedMiddleware(WireMiddleware):
    """Nodes on the participant at the other end of a link. `warnings` and `on_warning` are as of `DdsMiddleware`.

    If the other process started this one and has ended, the scheduler stops. If this one cannot join the domain then,
    what is asked raises FameError.
    """

    use_sim_time: bool = False

    def __init__(
        self,
        scheduler: WallScheduler,
        end: socket.socket,
        on_warning: Callable[[EndpointWarning], object] | None = None,
    ) -> None:
        super().__init__(scheduler, None, on_warning)
        self.link: RelayLink = RelayLink(end)
        self.entities: dict[int, Any] = {}
        self._made: dict[int, tuple[Any, ...]] = {}  # what was asked for each of them
        self._numbers, self._questions = count(1), dict[int, tuple[tuple[Any, ...], SimpleQueue[tuple[bool, Any]]]]()
        self._ended, self._known = "", {*typesystem.BUILTIN}
        self._graph = -1, list[TopicInfo]()
        self._own: tuple[Relay, threading.Thread] | None = None
        self._parent, self.domain = os.getppid(), -1
        threading.Thread(target=self._read, name="fame relay", daemon=True).start()
        self.confined: bool = self.ask("confined")
        self.network, self.domain = self.ask("network"), self.ask("domain")

    def ask(self, name: str, *arguments: Any, of: int = 0) -> Any:
        """Return an attribute of what this process has at the other end, or of an endpoint; of a method, its result."""
        number, answer = next(self._numbers), SimpleQueue[tuple[bool, Any]]()
        question, _ = self._questions[number] = (of, name, *arguments), answer
        self.link.send_object(ASK, number, question)
        fine, value = (False, FameError(self._ended)) if self._ended else answer.get()
        if not fine:
            raise value
        return value

    def add(self, entity: Any, name: str, *arguments: Any) -> int:
        """Make a node or an endpoint at the other end. Returns its number."""
        number = next(self._numbers)
        self.entities[number], self._made[number] = entity, (name, number, *arguments)
        self.ask(*self._made[number])
        return number

    def remove(self, number: int) -> None:
        """Close a node or an endpoint at the other end."""
        self.entities.pop(number, None)
        self._made.pop(number, None)
        self.link.send_object(ASK, 0, (0, "remove", number))

    def define(self, *types: str) -> None:
        """Let the other process know of message types that it does not know yet."""
        for type in types:
            if type not in self._known:
                if not self.ask("knows", type):
                    self.ask("define", list(_definitions(type)))
                self._known.add(type)

    def node(self, name: str, namespace: str = "", part: str = "") -> RelayedNode:
        return RelayedNode(self, name, namespace.strip("/"), part)

    def graph(self) -> list[TopicInfo]:
        number, graph = self.ask("graph_after", self._graph[0])
        if number != self._graph[0]:
            self._graph = number, pickle.loads(graph)
        return self._graph[1]

    def namespaces(self) -> list[str]:
        return list(self.ask("namespaces"))

    def node_names(self) -> list[str]:
        return list(self.ask("node_names"))

    def offers(self, service: str) -> list[tuple[str, str]]:
        return list(self.ask("offers", service))

    def losses(self) -> list[str]:
        for number, lost, uncounted in self.ask("take_losses"):
            if (endpoint := self.entities.get(number)) is not None:
                endpoint.count_lost(lost)
                endpoint.uncounted |= uncounted
        return super().losses()

    def connecting(self, node: Any) -> list[str]:
        return list(self.ask("connecting_of", node.number))

    def matching_subscriptions(self, publisher: RelayedPublisher) -> int:
        return 0  # `connecting` asks the other process

    def release(self) -> None:
        with suppress(FameError):
            self.ask("confined")  # all that was said before has been done
        self.link.close()
        if self._own is not None:
            relay, thread = self._own
            relay.scheduler.stop()
            thread.join()
            relay.close()

    def _read(self) -> None:
        why = _ENDED
        try:
            self._take_all()
            while not self.closed and self.domain >= 0:
                self._move()
                self._take_all()
        except FameError as error:
            why = f"{_ENDED}, and {error}"
        finally:
            self._ended = why
            self.link.close()
            for _, answer in list(self._questions.values()):
                answer.put((False, FameError(why)))
            if not self.closed:
                self.scheduler.stop()

    def _take_all(self) -> None:
        """Take what comes until the link ends."""
        for kind, number, data in self.link.messages():
            if kind == DATA:
                if (endpoint := self.entities.get(number)) is not None:
                    endpoint.take(data)
            elif kind == EVENT:
                name, argument = pickle.loads(data)
                self.scheduler.soon(partial(getattr(self, name), argument))
            else:
                _, answer = self._questions.pop(number, (None, None))
                if answer is not None:  # else it was asked twice, over two links
                    answer.put(pickle.loads(data))

    def _move(self) -> None:
        """Go on with a relay in this process. Raises ConfigError if the domain cannot be joined."""
        relay = Relay(DataScheduler(), domain=self.domain, network=self.network)
        if os.getppid() != self._parent:  # else it took this process, which was stopped, for gone
            self.scheduler.stop()
        here, there = socket.socketpair()
        engine = relay.serve(there)
        for number, (name, *arguments) in list(self._made.items()):
            try:
                getattr(engine, name)(*arguments)
            except MessageError as error:  # such as a service that another node offers by now
                self.warn(EndpointWarning("", str(error), "backend"))
            else:
                for data in tuple(getattr(self.entities.get(number), "kept", ())):
                    engine.pass_on(number, data)
        engine.settle()
        thread = threading.Thread(target=relay.scheduler.run, name="fame participant", daemon=True)
        thread.start()
        self._own = relay, thread
        self.scheduler.soon(self._on_moved)
        self.link.connect(here)
        for number, (question, _) in list(self._questions.items()):
            self.link.send_object(ASK, number, question)

    def _on_moved(self) -> None:
        """Drop the requests without response: none comes to the clients that were made again. The losses that the
        other process has counted since it was asked are gone."""
        for entity in list(self.entities.values()):
            if isinstance(entity, RelayedClient):
                entity.take_servers(frozenset())
            elif isinstance(entity, RelayedSubscription):
                entity.uncounted = True


def _definitions(type: str) -> Iterator[tuple[Any, ...]]:
    """A message type, and those that it contains, as `RelayedEngine.define` takes them."""
    content = typesystem.definition(type)
    yield content.name, content.fields, dict(content.constants), dict(content.defaults)
    for field in content.fields:
        if field.is_message:
            yield from _definitions(field.base)


class _RelayedEndpoint(WireEndpoint):
    """An endpoint that is at the other end of the link."""

    node: RelayedNode

    def make(self, types: tuple[str, ...], kind: str, name: str, *options: Any) -> None:
        """Make the endpoint there."""
        middleware = self.node.middleware
        middleware.define(*types)
        self._number: int = middleware.add(self, "make", self.node.number, kind, name, *options)
        self.pass_on = partial(middleware.link.send, DATA, self._number)

    def ask(self, name: str, *arguments: Any) -> Any:
        return self.node.middleware.ask(name, *arguments, of=self._number)

    def matched(self) -> bool:
        return bool(self.ask("matched"))

    def release(self) -> None:
        self.node.middleware.remove(self._number)


class RelayedPublisher(_RelayedEndpoint, WirePublisher):
    uncounted: bool = False

    def __init__(self, node: RelayedNode, topic: str, type: str, qos: QoS) -> None:
        super().__init__(node, topic, type, qos)
        lasts = qos.durability == "transient_local" and qos.lifespan is None
        self.kept: deque[bytes] = deque(maxlen=(None if qos.history == "keep_all" else qos.depth) if lasts else 0)
        self.make((self.type,), "publisher", topic, self.type, qos)

    def publish(self, message: AnyMessage) -> None:
        self.kept.append(data := self.pack(message))
        self.pass_on(data)

    def subscriber_count(self) -> int:
        return int(self.ask("subscriber_count"))


class RelayedSubscription(_RelayedEndpoint, WireSubscription):
    def __init__(self, node: RelayedNode, topic: str, type: str, callback: Callback, qos: QoS) -> None:
        super().__init__(node, topic, type, callback, qos)
        self.make((self.type,), "subscription", topic, self.type, qos)

    def take(self, data: bytes) -> None:
        """Take a message, in the thread that reads."""
        self.enqueue(data)
        self.schedule()


class RelayedService(_RelayedEndpoint, WireService):
    def __init__(self, node: RelayedNode, name: str, type: str, handler: Callable[[AnyMessage], Any]) -> None:
        super().__init__(node, name, type, handler)
        self.make((self.request_type, self.response_type), "service", name, type)

    def take(self, data: bytes) -> None:
        """Take a request, in the thread that reads."""
        self.node.middleware.scheduler.soon(partial(self._on_request, data[: KEY.size], data[KEY.size :]))

    def _on_request(self, key: bytes, data: bytes) -> None:
        request = None if self.closed else self.unpack(data, self.request_type)
        if request is not None:
            self.handle(request, lambda response: self.pass_on(key + codec.serialize(response)))


class RelayedClient(_RelayedEndpoint, WireClient):
    def __init__(self, node: RelayedNode, name: str, type: str) -> None:
        super().__init__(node, name, type)
        self._keys = count(1)
        self.make((self.request_type, self.response_type), "client", name, type)

    @property
    def available(self) -> bool:
        return not self.closed and bool(self.ask("available"))

    def servers(self) -> Set[Hashable]:
        return frozenset(self.ask("servers"))

    def unavailable(self, offers: Sequence[tuple[str, str]]) -> MessageError:
        error: MessageError = super().unavailable(offers) if self.closed else self.ask("unavailable", offers)
        return error

    def send(self, request: AnyMessage) -> int:
        key = next(self._keys)
        self.pass_on(KEY.pack(key) + codec.serialize(request))
        return key

    def take(self, data: bytes) -> None:
        """Take a response, in the thread that reads."""
        self.node.middleware.scheduler.soon(partial(self._on_response, data))

    def _on_response(self, data: bytes) -> None:
        response = None if self.closed else self.unpack(data[KEY.size :], self.response_type)
        if response is not None:
            self.pending.respond(KEY.unpack_from(data)[0], response)


class RelayedNode(WireNode):
    middleware: RelayedMiddleware
    endpoint_classes: ClassVar[EndpointClasses] = EndpointClasses(
        RelayedPublisher, RelayedSubscription, RelayedService, RelayedClient
    )

    def __init__(self, middleware: RelayedMiddleware, name: str, namespace: str, part: str) -> None:
        self.number: int = middleware.add(self, "make_node", name, namespace, part)
        super().__init__(middleware, name, namespace, part)

    def close(self) -> None:
        if self in self.middleware.nodes:
            super().close()
            self.middleware.remove(self.number)
