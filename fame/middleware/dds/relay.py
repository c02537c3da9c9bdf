"""One participant for the engines that a process has forked, instead of one in each of them.

Sixty participants on a computer cost each of them the announcements, endpoints and heartbeats of 59 others. Here the
process that has forked the engines has the only one. Each engine has a `RelayLink` to it and a middleware without DDS
(`fame.middleware.dds.relayed`). What an engine makes there is made here, with the same nodes, names and quality of
service, so that others see no difference. Messages are passed on as CDR.

An engine that ends, in whatever way, has left when its link closes. One that hangs or is stopped holds up nobody else:
what it does not take waits here, bounded by quality of service. After the lease, one that is stopped has left, as if it
had a participant of its own: its link is closed. An engine whose link has closed, as when this process is killed, makes
all that again on a participant of its own, with a `Relay` in a thread.

Threads. One for each engine reads its link, and publishes. All else happens in the scheduler's.
"""

from __future__ import annotations

import pickle
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterable, Set
from functools import partial
from itertools import chain, count
from types import MappingProxyType
from typing import Any, ClassVar

from fame.clock import SECOND, Entry, WallScheduler
from fame.errors import FameError, MessageError
from fame.middleware import typesystem
from fame.middleware.dds.discovery import NodeEntry
from fame.middleware.dds.domain import LEASE
from fame.middleware.dds.endpoints import DdsClient, DdsPublisher, DdsService, DdsSubscription, Numbers
from fame.middleware.dds.link import ASK, DATA, EVENT, REPLY, PatientLink
from fame.middleware.dds.middleware import DdsMiddleware, DdsNode
from fame.middleware.dds.participant import Participant
from fame.middleware.definitions import Definition
from fame.middleware.interface import EndpointWarning, QoS
from fame.middleware.wire_base import EndpointClasses, WireMiddleware, domain_id, lease

KEY = struct.Struct("<Q")
"""Before a request and its response: the number by which the engine knows it."""
_ANNOUNCE = SECOND // 20
"""How long changes of nodes are collected for one announcement (ns)."""
_RETRY = SECOND // 100
"""When what an engine did not take is sent again (ns)."""
_OPEN = 1000
"""Requests to a service that wait for its response, at most."""
_QUIET, _LATEST = SECOND // 4, 3 * SECOND
"""Discovery is over when it has found nothing for the first, or after the second: a robot may move (ns)."""


class Relay:
    """The participant of several engines. Raises ConfigError if the domain cannot be joined."""

    def __init__(self, scheduler: WallScheduler, *, domain: int | None = None, network: str | None = None) -> None:
        self.scheduler, self.network, self.domain = scheduler, network, domain_id(domain)
        self.engines: list[RelayedEngine] = []
        self._changed, self._graph = False, (-1, b"")
        self._since = time.monotonic_ns()  # numbers of its graphs are not those of a relay before
        self.participant: Participant = Participant(scheduler, self.domain, network, self._warn, self._servers_changed)

    def serve(self, end: socket.socket) -> RelayedEngine:
        """Relay for the engine at the other end, until that closes."""
        self.engines.append(engine := RelayedEngine(self, end))
        return engine

    def close(self) -> None:
        for engine in list(self.engines):
            engine.close()
        self.participant.close()

    def announce_soon(self) -> None:
        """Let others know of the nodes that have changed."""
        entries = chain.from_iterable(engine.entries for engine in self.engines)
        self.participant.discovery.set_nodes(entries)
        if not self._changed:
            self._changed = True
            self.scheduler.after(_ANNOUNCE, self._announce)

    def graph(self, engine: RelayedEngine) -> tuple[int, bytes]:
        """Return the graph, pickled once for all engines, and a number of it."""
        engine.refresh()
        changes = self._since + self.participant.discovery.changes
        if self._graph[0] != changes:
            self._graph = changes, pickle.dumps(engine.graph(), pickle.HIGHEST_PROTOCOL)
        return self._graph

    def _announce(self) -> None:
        self._changed = False
        self.participant.announce_again()

    def _warn(self, warning: EndpointWarning) -> None:
        """Tell the engines that have an endpoint of this name."""
        for engine in list(self.engines):
            if not warning.topic or warning.topic in engine.names:
                engine.warn(warning)

    def _servers_changed(self, services: Set[str]) -> None:
        for engine in list(self.engines):
            engine.servers_changed(engine.names & services)


class RelayedEngine(DdsMiddleware):
    """What the participant has of one engine: nodes and endpoints, by the numbers that the engine gives them."""

    offers_parameters = False  # the engine does so

    def __init__(self, relay: Relay, end: socket.socket) -> None:
        WireMiddleware.__init__(self, relay.scheduler, relay.network, self._pass_warning)
        self.domain, self.participant, self.confined = relay.domain, relay.participant, relay.participant.confined
        self.entries: tuple[NodeEntry, ...] = ()
        self.names: set[str] = set()
        self.waiting: list[Callable[[], object]] = []
        self.link: PatientLink = PatientLink(end, self._retry)
        self._relay, self._entities = relay, dict[int, Any]()
        self._leaving: Entry | None = None
        threading.Thread(target=self._read, name="fame relay", daemon=True).start()

    def node(self, name: str, namespace: str = "", part: str = "") -> DdsNode:
        return ForwardingNode(self, name, namespace.strip("/"), part)

    def on_endpoints_changed(self) -> None:
        self.entries = tuple(node.entry() for node in self.nodes if node.is_first_part())
        self._relay.announce_soon()

    def servers_changed(self, services: Set[str]) -> None:
        """Tell the engine, after the last responses of servers that have left, that these have changed."""
        if services:
            self._servers_changed(services)
            self.scheduler.soon(partial(self.link.send_object, EVENT, 0, ("on_servers_changed", services)))

    def on_stopped(self, stopped: bool) -> None:
        """Note that its process has been stopped, or goes on."""
        if self._leaving is not None:
            self._leaving.cancel()
        self._leaving = self.scheduler.after(round(lease(LEASE) * SECOND), self.close) if stopped else None

    def settle(self) -> None:
        """Run until discovery is over and the endpoints of others are connected."""
        latest, found, discovery = self.scheduler.now + _LATEST, -1, self.participant.discovery
        while (found != discovery.changes or any(map(self.connecting, self.nodes))) and self.scheduler.now < latest:
            found = discovery.changes
            self.scheduler.run(self.scheduler.now + _QUIET)

    def release(self) -> None:
        self._relay.engines.remove(self)
        self._relay.announce_soon()
        self.link.close()

    # ---- what the engine asks for, some of it again over another link ------------------------------------------------

    def make_node(self, number: int, name: str, namespace: str, part: str) -> None:
        if number not in self._entities:
            self._entities[number] = self.node(name, namespace, part)

    def make(self, number: int, node: int, kind: str, name: str, type: str, *options: QoS) -> None:
        """Make an endpoint of a node. `kind` is the name of the method."""
        if number in self._entities:
            return
        self.names.add(name)
        handler = [partial(self.link.send, DATA, number)] if kind in ("subscription", "service") else []
        self._entities[number] = endpoint = getattr(self._entities[node], kind)(name, type, *handler, *options)
        if kind == "client":
            endpoint.on_response = partial(self.link.send, DATA, number)

    def remove(self, number: int) -> None:
        """Close a node or an endpoint."""
        self._entities.pop(number).close()

    def knows(self, type: str) -> bool:
        """Return whether a message type is known here: an engine may have read it from a file of its own."""
        try:
            typesystem.definition(type)
        except MessageError:
            return False
        return True

    def define(self, types: Iterable[tuple[Any, ...]]) -> None:
        """Add message types: name, fields, constants and defaults of each."""
        contents = (Definition(name, fields, *map(MappingProxyType, rest)) for name, fields, *rest in types)
        typesystem.add(contents)

    def connecting_of(self, node: int) -> list[str]:
        return self.connecting(self._entities[node])

    def graph_after(self, known: int) -> tuple[int, bytes]:
        """Return number and graph as `Relay.graph` does; no graph if its number is `known`."""
        number, graph = self._relay.graph(self)
        return number, b"" if number == known else graph

    def take_losses(self) -> list[tuple[int, int, bool]]:
        """Return the endpoints that have lost messages since the last time: number, how many, whether more."""
        found = []
        for number, endpoint in self._entities.items():
            lost, uncounted = getattr(endpoint, "lost", 0), getattr(endpoint, "uncounted", False)
            if lost or uncounted:
                found.append((number, lost, uncounted))
                endpoint.lost = 0
        return found

    # ---- the link ----------------------------------------------------------------------------------------------------

    def _read(self) -> None:
        for kind, number, data in self.link.messages():
            if kind == ASK:
                self.scheduler.soon(partial(self._answer, number, data))
            else:
                self.pass_on(number, data)
        self.scheduler.soon(self.close)

    def pass_on(self, number: int, data: bytes) -> None:
        """Send what an endpoint of the engine sends. From any thread."""
        if isinstance(endpoint := self._entities.get(number), DdsPublisher):
            try:
                endpoint.send(data)
            except MessageError as error:  # it has just been closed
                self.warn(EndpointWarning(endpoint.topic, str(error), "backend"))
        elif endpoint is not None:
            self.scheduler.soon(partial(endpoint.take, data))

    def _answer(self, number: int, data: bytes) -> None:
        target, name, *arguments = pickle.loads(data)
        try:
            value = getattr(self._entities[target] if target else self, name)
            answer: tuple[bool, Any] = True, value(*arguments) if callable(value) else value
        except FameError as error:
            answer = False, error
        except Exception as error:  # one engine's fault is not to end the others
            answer = False, FameError(f"{name}: {type(error).__name__}: {error}")
        if number:
            self.link.send_object(REPLY, number, answer)

    def _pass_warning(self, warning: EndpointWarning) -> None:
        self.link.send_object(EVENT, 0, ("warn", warning))

    def _retry(self) -> None:
        self.scheduler.after(_RETRY, self._flush)

    def _flush(self) -> None:
        if not self.link.flush():
            self._retry()
            return
        waiting, self.waiting = self.waiting, []
        for action in waiting:
            action()


class ForwardingSubscription(DdsSubscription):
    """Passes on what comes; while the engine does not take it, it waits in its queue."""

    def deliver(self, data: bytes) -> None:
        if not self.closed:
            self._callback(data)

    def _take(self) -> None:
        engine: RelayedEngine = self.node.middleware  # type: ignore[assignment]
        if engine.link.congested:
            engine.waiting.append(self._take)
        else:
            super()._take()


class ForwardingService(DdsService):
    def __init__(self, node: DdsNode, name: str, type: str, handler: Callable[[bytes], Any]) -> None:
        super().__init__(node, name, type, handler)
        self._open: dict[int, tuple[Numbers, int]] = {}
        self._keys = count(time.monotonic_ns())  # none that a relay before has given to a request

    def on_data(self, data: bytes, numbers: Numbers, client: int) -> None:
        if len(self._open) == _OPEN:
            if self.node.middleware.link.congested:  # type: ignore[attr-defined]
                return
            del self._open[next(iter(self._open))]
        key = next(self._keys)
        self._open[key] = numbers, client
        self._handler(KEY.pack(key) + data)

    def take(self, data: bytes) -> None:
        """Send the engine's response."""
        (key,) = KEY.unpack_from(data)
        if key in self._open:
            self.respond(data[KEY.size :], *self._open.pop(key))


class ForwardingClient(DdsClient):
    on_response: Callable[[bytes], object]

    def on_data(self, data: bytes, numbers: Numbers, service: int) -> None:
        guid, number = numbers
        if guid == self.guid:
            self.on_response(KEY.pack(number) + data)

    def take(self, data: bytes) -> None:
        """Send the engine's request."""
        if not self.closed:
            self.exchange.write(data[KEY.size :], (self.guid, *KEY.unpack_from(data)))


class ForwardingNode(DdsNode):
    endpoint_classes: ClassVar[EndpointClasses] = EndpointClasses(
        DdsPublisher, ForwardingSubscription, ForwardingService, ForwardingClient
    )
