"""The interface of a middleware: nodes with publishers, subscriptions, services and clients.

Names follow ROS 2: a topic is absolute (``/weed_found``), relative to the namespace of the node (``odom``), or private
to the robot (``~/odom``: here the same as relative, since a robot is a namespace). A node never receives what it
published itself. Callbacks run as entries of the scheduler (`fame.clock.Kind.MESSAGE`), not inside `publish` or `call`.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Sequence, Set
from typing import Any, Literal, Protocol

from fame.dataclasses import dataclass, field

AnyMessage = Any
"""An object with one attribute per field: a dataclass made by `fame.middleware.messages`."""


@dataclass(frozen=True, slots=True)
class QoS:
    """Quality of service: `depth` counts messages, times are in s (None: infinite). The defaults are a signal's.

    `acknowledged` is FAME's own: what such a publisher sends reaches such a subscription in another way
    (`fame.robot.acknowledged`), so that these two are not connected.
    """

    reliability: Literal["reliable", "best_effort"] = "reliable"
    durability: Literal["volatile", "transient_local"] = "volatile"
    history: Literal["keep_last", "keep_all"] = "keep_last"
    depth: int = 100
    deadline: float | None = None
    lifespan: float | None = None
    liveliness: Literal["automatic", "manual_by_topic"] = "automatic"
    lease_duration: float | None = None
    acknowledged: bool = False


SIGNAL = QoS()
"""Reliable, keep last 100."""
SENSOR_DATA = QoS(reliability="best_effort", depth=5)
LATCHED = QoS(durability="transient_local", depth=1)

ENGINE = "fame_engine"
"""The name of the node of every robot's engine, in the namespace of the robot."""
MISSION = "mission"
"""The part of that node that runs a process."""

UNKNOWN_NODE = "/_NODE_NAME_UNKNOWN_"
"""The node of an endpoint that no node has announced (yet). ROS tools show the same name, without the slash."""


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """A topic as the graph shows it: its types, and the full names of its nodes (one per endpoint).

    `offered` has the QoS of each publisher.
    """

    name: str
    types: tuple[str, ...]
    publishers: tuple[str, ...]
    subscribers: tuple[str, ...]
    offered: tuple[QoS, ...] = field(default=(), compare=False)


MAX_MESSAGE_SIZE = 100_000_000
"""Bytes of the largest message that is read, whatever its topic."""


class Publisher(Protocol):
    """A publisher. `topic` is the full name."""

    topic: str
    type: str

    def publish(self, message: AnyMessage) -> None:
        """Send it to all subscriptions but those of the same node. The message must not be changed afterwards.

        Raises MessageError if it is not a message of the topic's type, and if the publisher is closed.
        """

    def subscriber_count(self) -> int:
        """Return the number of subscriptions that it is connected to now."""

    def close(self) -> None: ...


class Subscription(Protocol):
    """A subscription. `topic` is the full name.

    max_size    on the wire a message of more bytes is dropped
    on_dropped  called with a warning for each message that cannot be read; by default only the first is reported
    """

    topic: str
    type: str
    max_size: int
    on_dropped: Callable[[EndpointWarning], object]

    def close(self) -> None: ...


class DeferredResponse:
    """A response that is not known yet: a handler returns it, and calls `respond` once later."""

    def __init__(self) -> None:
        self._responses: list[Any] = []
        self._sends: list[Callable[[Any], object]] = []

    def respond(self, response: Any) -> None:
        """Respond with a message, a mapping, or None for a message of defaults."""
        self._responses.append(response)
        for send in self._sends:
            send(response)

    def send_with(self, send: Callable[[Any], object]) -> None:
        """For backends: send the response with this function too, since several requests may wait for it."""
        self._sends.append(send)
        for response in self._responses:
            send(response)


def deliver_response(response: Any, send: Callable[[Any], object]) -> None:
    """For backends: send the response that a handler returned, or a deferred one when it comes."""
    if isinstance(response, DeferredResponse):
        response.send_with(send)
    else:
        send(response)


class PendingRequests:
    """For backends: the requests of a client that wait for a response, each with the servers that were there then."""

    def __init__(self) -> None:
        self._waiting: dict[
            Hashable, tuple[Callable[[AnyMessage], object], _OnLost | None, bool, frozenset[Hashable]]
        ] = {}

    def __len__(self) -> int:
        return len(self._waiting)

    def __contains__(self, key: Hashable) -> bool:
        return key in self._waiting

    def add(
        self,
        key: Hashable,
        servers: Iterable[Hashable],
        callback: Callable[[AnyMessage], object],
        lost: _OnLost | None,
        or_new: bool,
    ) -> None:
        """Note a request, as of `Client.call`."""
        self._waiting[key] = callback, lost, or_new, frozenset(servers)

    def respond(self, key: Hashable, response: AnyMessage) -> None:
        """Pass on a response, unless its request was dropped."""
        if key in self._waiting:
            self._waiting.pop(key)[0](response)

    def drop(self, key: Hashable) -> bool:
        """Drop a request that gets no response. Returns whether it waited for one."""
        if key not in self._waiting:
            return False
        _, lost, _, _ = self._waiting.pop(key)
        if lost is not None:
            lost()
        return True

    def servers_changed(self, servers: Set[Hashable]) -> bool:
        """Drop the requests that these servers do not answer. Returns whether a server has left with a request."""
        for key, (callback, lost, or_new, there) in self._waiting.items():
            if not there:  # the backend had not told of its server yet
                self._waiting[key] = callback, lost, or_new, frozenset(servers)
        before = {key: (or_new, there) for key, (_, _, or_new, there) in self._waiting.items()}
        gone = [key for key, (_, there) in before.items() if there.isdisjoint(servers) and there]
        for key in (*gone, *(key for key, (or_new, there) in before.items() if or_new and not servers <= there)):
            self.drop(key)
        return bool(gone)

    def clear(self) -> None:
        """Drop all requests without a word."""
        self._waiting.clear()


_OnLost = Callable[[], object]


class Service(Protocol):
    """A service. `name` is the full name, `type` is ``pkg/srv/Name``."""

    name: str
    type: str

    def close(self) -> None: ...


class Client(Protocol):
    """A client of a service."""

    name: str
    type: str

    @property
    def available(self) -> bool:
        """Whether a node offers the service now."""

    @property
    def mismatch(self) -> str:
        """Why it is not connected to a service of its name; empty if it is connected or no service exists."""

    def call(
        self,
        request: Any,
        callback: Callable[[AnyMessage], object],
        lost: Callable[[], object] | None = None,
        *,
        or_new: bool = False,
    ) -> None:
        """Send a request (a message, a mapping, or None for a message of defaults); `callback` gets the response.

        `lost` is called instead if its server has left: nobody knows whether it handled the request. With `or_new` it
        is called, too, when another server has come, since one that was killed stays in the graph for a while.

        Raises MessageError if the request does not fit its type, or no node offers the service.
        """

    def insist(self, request: Any, callback: Callable[[AnyMessage], object]) -> None:
        """Send a request whenever a server comes, until one responds; `callback` gets the response."""

    def close(self) -> None:
        """Close the client. Responses that come later are dropped."""


class Node(Protocol):
    """A node. `namespace` has no slashes (``REX``; empty for none), `full_name` is ``/REX/name``."""

    name: str
    namespace: str
    full_name: str

    def publisher(self, topic: str, type: str, qos: QoS = SIGNAL) -> Publisher:
        """Make a publisher. Raises MessageError if the type is unknown or the topic is in use with another one."""

    def subscription(
        self, topic: str, type: str, callback: Callable[[AnyMessage], object], qos: QoS = SIGNAL
    ) -> Subscription:
        """Call `callback` with every message. Errors as `publisher`."""

    def service(self, name: str, type: str, handler: Callable[[AnyMessage], Any]) -> Service:
        """Offer a service. `handler` returns the response (a message, a mapping, None for a message of defaults), or a
        `DeferredResponse`.

        Names of services are resolved like those of topics. Raises MessageError if the type is unknown, or if there is
        a service of that name already.
        """

    def client(self, name: str, type: str) -> Client:
        """Make a client of a service. Raises MessageError if the type is unknown."""

    def close(self) -> None:
        """Close all endpoints."""


@dataclass(frozen=True, slots=True)
class EndpointWarning:
    """A warning about an endpoint; `topic` is its full name, or that of its service.

    kind  ``mismatch`` (two endpoints are not connected), ``unanswered`` (a service closed before it answered),
          ``dropped`` (a message that cannot be read), ``slow`` (a subscriber or client does not keep up), ``clock``
          (simulated time jumps), ``backend`` (an error of the backend itself)
    """

    topic: str
    text: str
    kind: Literal["mismatch", "unanswered", "dropped", "slow", "clock", "backend"]

    def __str__(self) -> str:
        return f"{self.topic}: {self.text}" if self.topic else self.text


class Middleware(Protocol):
    """A backend.

    confined      whether other machines cannot reach it: sending models without signatures relies on that
    use_sim_time  ROS's parameter of that name: time is that of ``/clock``
    warnings      for the user, such as endpoints that do not match
    """

    warnings: list[EndpointWarning]

    @property
    def confined(self) -> bool: ...

    @property
    def use_sim_time(self) -> bool: ...

    def warn(self, warning: EndpointWarning, /) -> object:
        """Add to `warnings`, once."""

    def losses(self) -> list[str]:
        """Return its endpoints that have lost messages, and how many each, as text."""

    def node(self, name: str, namespace: str = "", part: str = "") -> Node:
        """Make a node. Several may have the same name, as in ROS; those that are a `part` are one node to others."""

    def graph(self) -> Sequence[TopicInfo]:
        """Return every topic that has an endpoint, in the order of names."""

    def connecting(self, node: Any) -> Sequence[str]:
        """Topics on which a node has a publisher that is not connected yet to every subscription that it matches."""

    def namespaces(self) -> Sequence[str]:
        """Namespaces in use, without slashes, in order."""

    def close(self) -> None:
        """Close all nodes."""


def known_topics(middleware: Middleware, names: Iterable[str] = (), *, publishers: bool = False) -> Sequence[TopicInfo]:
    """Return the topics that a middleware knows: those that its own endpoints are on, and those of `names` (full names,
    with ``*`` for any characters), of which it learns from the first time on; with `publishers`, of these ends alone.

    Of a hundred robots on one machine, none has to know all topics. It is the same list until something changes.
    """
    known = getattr(middleware, "known_topics", None)
    found: Sequence[TopicInfo] = middleware.graph() if known is None else known(names, publishers=publishers)
    return found


def resolve(topic: str, namespace: str) -> str:
    """Return the full name of a topic seen from a namespace.

    >>> resolve("odom", "REX"), resolve("/done", "REX"), resolve("~/led", "REX"), resolve("odom", "")
    ('/REX/odom', '/done', '/REX/led', '/odom')
    """
    if topic.startswith("/"):
        return topic
    name = topic.removeprefix("~/")
    return f"/{namespace}/{name}" if namespace else f"/{name}"
