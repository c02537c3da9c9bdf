"""Base classes of a middleware between processes and its nodes.

A backend derives its classes from these and implements their abstract methods: making endpoints, and the graph of other
nodes. Everything else is here: names, parts of nodes, parameter services, losses, warnings, closing. The endpoints are
in `fame.middleware.wire_endpoints`.

Parts. An engine appears as one node, with one set of parameter services, though its deployment, its mission and its
clock open and close their endpoints independently. So nodes of one process with the same name and a `part` are
announced as one node. Nodes without a part are separate, also those of the same name.

Threads: `WarningsOnce` may be called from any thread. All else happens in the thread of the scheduler.
"""

from __future__ import annotations

import os
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Container, Iterable, Sequence
from contextlib import suppress
from functools import partial
from typing import Any, ClassVar, NamedTuple

from fame.clock import SECOND, Scheduler
from fame.errors import ConfigError, MessageError
from fame.middleware.errors import check_name
from fame.middleware.interface import SIGNAL, AnyMessage, EndpointWarning, QoS, TopicInfo, resolve
from fame.middleware.parameters import KINDS, NodeParameter, ParameterTable
from fame.middleware.wire_endpoints import (
    Callback,
    OnWarning,
    WireClient,
    WirePublisher,
    WireService,
    WireSubscription,
    endpoints_on,
)

NAMING_DELAY = SECOND // 5
"""Time after an endpoint in which the name of its node may arrive (ns)."""
_LAST_DOMAIN = 232
"""The last one whose ports are below 65536 (DDSI-RTPS 2.5, section 9.6.2)."""
_SHORTEST_LEASE, _LONGEST_LEASE = 0.5, 3600.0
_HIGHEST_LOAD = 5.0
_MAX_WARNINGS = 1000
"""Maximum number of stored warnings: a flood of warnings can differ only in numbers."""
_POLL = 0.002
"""Interval of the checks of `wait_matched` (s)."""

_PARAMETERS_DELAY, _LATEST_PARAMETERS = SECOND // 4, 60 * SECOND
"""How long the domain has no new node before a node offers its parameters, for each node, and when it does so at the
latest (ns): many engines that start at once find each other, and get their processes, first."""
_STEP = SECOND // 100
"""The time between two of their services, for each node of the domain (ns): all may be on one machine."""
_PARAMETERS = "parameters"
"""The part of a node that offers them."""


class WarningsOnce:
    """Called with each warning. Keeps it once, up to a maximum, and passes it to `on_warning` in the scheduler."""

    def __init__(self, scheduler: Scheduler, on_warning: OnWarning | None) -> None:
        self.kept: list[EndpointWarning] = []
        self._scheduler, self._on_warning, self._lock = scheduler, on_warning, threading.Lock()

    def __call__(self, warning: EndpointWarning) -> None:
        with self._lock:
            if warning in self.kept or len(self.kept) > _MAX_WARNINGS:
                return
            if len(self.kept) == _MAX_WARNINGS:
                warning = EndpointWarning("", f"after {_MAX_WARNINGS} warnings no others are kept", "backend")
            self.kept.append(warning)
        if self._on_warning is not None:
            self._scheduler.soon(partial(self._on_warning, warning))


class WireMiddleware(ABC):
    """A backend between processes. See `fame.middleware.interface.Middleware`."""

    scheduler: Scheduler
    network: str | None
    lockstep: bool = False
    """Whether its nodes can be held, for `fame.middleware.simulated_time.Lockstep`."""
    offers_parameters: bool = True
    """Whether its nodes offer parameter services here; else what it is made of does so."""

    def __init__(self, scheduler: Scheduler, network: str | None, on_warning: OnWarning | None) -> None:
        self.scheduler, self.network = scheduler, network
        self.closed: bool = False
        self.nodes: list[Any] = []
        self.holds: Callable[[WireNode], bool] = lambda node: False
        self.warn: WarningsOnce = WarningsOnce(scheduler, on_warning)
        self.warnings: list[EndpointWarning] = self.warn.kept

    @abstractmethod
    def node(self, name: str, namespace: str = "", part: str = "") -> WireNode:
        """Make a node. Several may have the same name, as in ROS; those that are a `part` are announced as one."""

    @abstractmethod
    def graph(self) -> Sequence[TopicInfo]:
        """Return every topic that has an endpoint, in the order of names."""

    @abstractmethod
    def namespaces(self) -> Sequence[str]:
        """Return the namespaces of all nodes, without slashes, in order."""

    @abstractmethod
    def node_names(self) -> list[str]:
        """Full names of all nodes of the domain, in order. A name that two nodes have comes twice."""

    @abstractmethod
    def offers(self, service: str) -> list[tuple[str, str]]:
        """Type and node of each service of that full name."""

    @abstractmethod
    def matching_subscriptions(self, publisher: Any) -> int:
        """Return how many subscriptions are there that match a publisher, connected or not."""

    @abstractmethod
    def release(self) -> None:
        """Release the resources of the backend, when all nodes are closed."""

    def refresh(self) -> None:  # noqa: B027 (not every backend needs it)
        """Update the graph, if the backend does not do so by itself."""

    def on_endpoints_changed(self) -> None:  # noqa: B027 (not every backend needs it)
        """Announce that nodes or their endpoints have changed, if the backend does not do so by itself."""

    def on_servers_changed(self, services: Container[str]) -> None:
        """Tell the clients of these services (full names) that servers have come or left."""
        for node in list(self.nodes):
            for end in list(node.services):
                if isinstance(end, WireClient) and end.name in services:
                    end.on_servers_changed()

    def hold(self, holds: Callable[[WireNode], bool]) -> None:
        """Hold the messages to such nodes, from now on, until they are drained."""
        self.holds = holds
        for node in self.nodes:
            node.hold(holds(node))

    def flush(self) -> None:  # noqa: B027 (only where nodes can be held)
        """Wait until other processes have received the messages of held nodes."""

    def follows_clock(self) -> bool:
        """Return whether one of its nodes subscribes to `/clock`."""
        return any(end.topic == "/clock" for node in self.nodes for end in node.subscriptions)

    def connecting(self, node: Any) -> list[str]:
        """Topics on which a node has a publisher that is not connected yet to every subscription that it matches."""
        self.refresh()
        return [end.topic for end in node.publishers if end.subscriber_count() < self.matching_subscriptions(end)]

    def losses(self) -> list[str]:
        """Return its endpoints that have lost messages, and how many, as text: on each topic of a
        node the worst one."""
        most: dict[tuple[str, str, type], tuple[int, str]] = {}
        for node in list(self.nodes):
            for end in (*node.subscriptions, *node.publishers):
                text, place = end.losses(), (end.topic, node.full_name, type(end))
                most[place] = max(most.get(place, (0, "")), (end.lost, text))
        return [text for _, text in most.values() if text]

    def wait_matched(self, topics: Iterable[str], timeout: float) -> list[str]:
        """Block until each of its endpoints on the topics (full names) is connected to one of another node.

        At most `timeout` s; returns the topics with an endpoint that is not.
        """
        waiting, deadline = list(topics), time.monotonic() + timeout
        while True:
            waiting = [topic for topic in waiting if not all(end.matched() for end in endpoints_on(self.nodes, topic))]
            if not waiting or time.monotonic() >= deadline:
                return waiting
            time.sleep(_POLL)

    def close(self) -> None:
        """Close all nodes; others see it at once. Does nothing the second time."""
        if not self.closed:
            for node in list(self.nodes):
                node.close()
            self.closed = True
            self.release()


class EndpointClasses(NamedTuple):
    """The classes of the endpoints of a backend, each made with its node first (`fame.middleware.wire_endpoints`)."""

    publisher: Callable[..., WirePublisher]
    subscription: Callable[..., WireSubscription]
    service: Callable[..., WireService]
    client: Callable[..., WireClient]


class WireNode:
    """A node and its endpoints. See `fame.middleware.interface.Node`."""

    endpoint_classes: ClassVar[EndpointClasses]
    middleware: WireMiddleware
    name: str
    namespace: str
    part: str

    def __init__(self, middleware: WireMiddleware, name: str, namespace: str, part: str = "") -> None:
        self.middleware, self.name, self.namespace, self.part = middleware, name, namespace, part
        self.full_name: str = resolve(name, namespace)
        self.publishers: list[Any] = []
        self.subscriptions: list[Any] = []
        self.services: list[Any] = []  # and clients
        self.held: bool = middleware.holds(self)
        others = self.others()
        self.parameters: ParameterTable = others[0].parameters if others else self._own_parameters()
        middleware.nodes.append(self)
        middleware.on_endpoints_changed()
        if not others and middleware.offers_parameters and not name.startswith("_"):
            until = middleware.scheduler.now + _LATEST_PARAMETERS
            middleware.scheduler.after(_PARAMETERS_DELAY, partial(self._await_quiet, 0, until))

    def hold(self, held: bool) -> None:
        """Hold its messages until they are drained, or stop holding them."""
        self.held = held
        for subscription in self.subscriptions:
            subscription.held = held

    def others(self) -> list[Any]:
        """Return the other parts of the node, in the order in which they were made."""
        nodes = self.middleware.nodes if self.part else ()
        return [node for node in nodes if node is not self and node.part and node.full_name == self.full_name]

    def is_first_part(self) -> bool:
        """Return whether none of its other parts was made before it."""
        nodes = self.middleware.nodes
        return all(nodes.index(self) < nodes.index(other) for other in self.others())

    def publisher(self, topic: str, type: str, qos: QoS = SIGNAL) -> Any:
        publisher = self.endpoint_classes.publisher(self, self._full(topic), type, qos)
        for subscription in self.subscriptions:
            subscription.ignore(publisher)
        return self._add(self.publishers, publisher)

    def subscription(self, topic: str, type: str, callback: Callback, qos: QoS = SIGNAL) -> Any:
        return self._add(
            self.subscriptions, self.endpoint_classes.subscription(self, self._full(topic), type, callback, qos)
        )

    def service(self, name: str, type: str, handler: Callable[[AnyMessage], Any]) -> Any:
        return self._add(self.services, self.endpoint_classes.service(self, self._full(name), type, handler))

    def client(self, name: str, type: str) -> Any:
        return self._add(self.services, self.endpoint_classes.client(self, self._full(name), type))

    def close(self) -> None:
        """Close all endpoints. Does nothing the second time."""
        for end in (*self.publishers, *self.subscriptions, *self.services):
            end.close()
        if self in self.middleware.nodes:
            self.middleware.nodes.remove(self)
            self.middleware.on_endpoints_changed()
            others = self.others()
            if len(others) == 1 and others[0].part == _PARAMETERS:
                others[0].close()

    def _own_parameters(self) -> ParameterTable:
        middleware = self.middleware
        follows = NodeParameter("bool", middleware.follows_clock, description="whether its time is that of /clock")
        return ParameterTable(use_sim_time=follows)

    def _await_quiet(self, nodes: int, until: int) -> None:
        """Offer the parameters when the domain has had no new node for a while, or at `until` (ns)."""
        if self.middleware.closed:
            return
        scheduler, now = self.middleware.scheduler, len(self.middleware.node_names())
        if now != nodes and scheduler.now < until:
            scheduler.after(_PARAMETERS_DELAY * max(1, now), partial(self._await_quiet, now, until))
        elif self in self.middleware.nodes or self.others():
            # On a part that lives as long as any other.
            home = self.middleware.node(self.name, self.namespace, _PARAMETERS) if self.part else self
            self._offer_parameters(home, KINDS)

    def _offer_parameters(self, home: WireNode, kinds: tuple[str, ...]) -> None:
        """Offer the services one after the other, so that nothing else waits for long."""
        if kinds and home in self.middleware.nodes:
            with suppress(MessageError):  # another node of the same name offers it
                self.parameters.offer(home, kinds[:1])
            pause = _STEP * len(self.middleware.node_names())
            self.middleware.scheduler.after(pause, partial(self._offer_parameters, home, kinds[1:]))

    def _full(self, name: str) -> str:
        full = resolve(name, self.namespace)
        check_name(full)
        return full

    def _add(self, endpoints: list[Any], endpoint: Any) -> Any:
        endpoints.append(endpoint)
        self.middleware.on_endpoints_changed()
        return endpoint


def lease(default: float) -> float:
    """Time after which a process that fell silent is gone (s): FAME_LEASE, else the default. Raises ConfigError."""
    text = os.environ.get("FAME_LEASE", "").strip()
    try:
        seconds = float(text) if text else default
    except ValueError:
        seconds = 0.0
    if not _SHORTEST_LEASE <= seconds <= _LONGEST_LEASE:
        bounds = f"{_SHORTEST_LEASE:g} to {_LONGEST_LEASE:g} s"
        raise ConfigError(f"expected a time from {bounds}, got {text!r}", element="FAME_LEASE")
    return seconds


def load_of_machine() -> float:
    """Return how many processes wanted each processor of this machine in the last minute, from 1 to 5: what waits for
    others waits that many times as long."""
    return min(max(1.0, os.getloadavg()[0] / (os.cpu_count() or 1)), _HIGHEST_LOAD)


def domain_id(given: int | None = None) -> int:
    """Return the number of the domain: `given`, else ROS_DOMAIN_ID, else 0. Raises ConfigError if
    it is not in 0..232."""
    text = os.environ.get("ROS_DOMAIN_ID", "").strip() if given is None else str(given)
    if not text:
        return 0
    if text.isascii() and text.isdigit() and len(text) < 9 and int(text) <= _LAST_DOMAIN:
        return int(text)
    source = "ROS_DOMAIN_ID" if given is None else "domain"
    raise ConfigError(f"expected a domain from 0 to {_LAST_DOMAIN}, got {text!r}", element=source)
