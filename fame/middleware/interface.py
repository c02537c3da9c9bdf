"""What FAME asks of a middleware: nodes that publish on topics and subscribe to them. Three backends give it.

Names follow ROS 2: a topic is absolute (``/weed_found``), relative to the namespace of the node (``odom``), or private
to the robot (``~/odom``: here the same as relative, since a robot is a namespace). A node never receives what it
published itself. Callbacks run as entries of the scheduler (`fame.clock.Kind.MESSAGE`), never inside `publish` or
`call`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol

Message = Any
"""An object with one attribute per field: a dataclass made by `fame.middleware.messages`."""


@dataclass(frozen=True, slots=True)
class QoS:
    """Quality of service: `depth` counts messages, times are in s (None: infinite). The defaults are a signal's."""

    reliability: Literal["reliable", "best_effort"] = "reliable"
    durability: Literal["volatile", "transient_local"] = "volatile"
    history: Literal["keep_last", "keep_all"] = "keep_last"
    depth: int = 100
    deadline: float | None = None
    lifespan: float | None = None
    liveliness: Literal["automatic", "manual_by_topic"] = "automatic"
    lease_duration: float | None = None


SIGNAL = QoS()
"""Reliable, keep last 100 (DESIGN section 7)."""
SENSOR_DATA = QoS(reliability="best_effort", depth=5)
LATCHED = QoS(durability="transient_local", depth=1)

UNKNOWN = "/_NODE_NAME_UNKNOWN_"
"""The node of an end that no node claims (yet); what ROS tools show there too, without the slash."""


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """A topic as the graph shows it: its types, and the full names of the nodes at its ends (one per endpoint)."""

    name: str
    types: tuple[str, ...]
    publishers: tuple[str, ...]
    subscribers: tuple[str, ...]


LARGEST = 100_000_000
"""Bytes of the largest message that is read, whatever its topic."""


class Publisher(Protocol):
    """One end of a topic. `topic` is the full name."""

    topic: str
    type: str

    def publish(self, message: Message) -> None:
        """Send it to all subscribers but those of the own node. The message must not be changed afterwards."""

    def close(self) -> None: ...


class Subscription(Protocol):
    """The other end. `dropped` is told of each message that cannot be read; if nothing else is set, it is a warning.

    On the wire a message of more than `limit` bytes is not read.
    """

    topic: str
    type: str
    limit: int
    dropped: Callable[[str], object]

    def close(self) -> None: ...


class Later:
    """A response that is not known yet: a handler returns it, and `answer`s it once when it is."""

    def __init__(self) -> None:
        self._given: list[Any] = []
        self._tell: Callable[[Any], object] | None = None

    def answer(self, response: Any) -> None:
        """Respond: a message, a mapping, or None for one of defaults."""
        if self._tell is None:
            self._given.append(response)
        else:
            self._tell(response)

    def then(self, tell: Callable[[Any], object]) -> None:
        """For backends: what to do with the response."""
        self._tell = tell
        for response in self._given:
            tell(response)


def respond(answer: Any, tell: Callable[[Any], object]) -> None:
    """For backends: tell what a handler gave, now or `Later`."""
    if isinstance(answer, Later):
        answer.then(tell)
    else:
        tell(answer)


class Service(Protocol):
    """What answers requests. `name` is the full name, `type` is ``pkg/srv/Name``."""

    name: str
    type: str

    def close(self) -> None: ...


class Client(Protocol):
    """What asks a service."""

    name: str
    type: str

    @property
    def available(self) -> bool:
        """Whether somebody offers the service now."""

    def call(self, request: Any, callback: Callable[[Message], object]) -> None:
        """Send a request (a message, a mapping, or None for one of defaults); the response comes to `callback`.

        Raises MessageError if the request does not fit its type, or nobody offers the service.
        """

    def close(self) -> None:
        """Leave: responses that are still to come are dropped."""


class Node(Protocol):
    """A participant. `namespace` has no slashes (``REX``; empty for none), `full_name` is ``/REX/name``."""

    name: str
    namespace: str
    full_name: str

    def publisher(self, topic: str, type: str, qos: QoS = SIGNAL) -> Publisher:
        """Raises MessageError if the type is unknown or the topic is in use with another one."""

    def subscription(
        self, topic: str, type: str, callback: Callable[[Message], object], qos: QoS = SIGNAL
    ) -> Subscription:
        """Calls back for every message. Errors as `publisher`."""

    def service(self, name: str, type: str, handler: Callable[[Message], Any]) -> Service:
        """Answer requests: `handler` gives the response (a message, a mapping, None for one of defaults), or `Later`.

        Names of services are resolved like those of topics. Raises MessageError if the type is unknown, or somebody
        offers a service of that name already.
        """

    def client(self, name: str, type: str) -> Client:
        """Raises MessageError if the type is unknown."""

    def close(self) -> None:
        """Leave: all its ends are closed."""


class Middleware(Protocol):
    """A backend. `confined` tells whether other machines cannot reach it: what carries code relies on that.

    `use_sim_time` is ROS's parameter of that name, as far as the backend has it: time is that of ``/clock``. `warnings`
    collects what a person should know, such as ends that cannot hear each other; what is about a topic begins with it.
    """

    warnings: list[str]

    @property
    def confined(self) -> bool: ...

    @property
    def use_sim_time(self) -> bool: ...

    def warn(self, text: str, /) -> object:
        """Add to `warnings`, unless it is there."""

    def losses(self) -> list[str]:
        """Which own ends have lost messages, and how many each, in words."""

    def node(self, name: str, namespace: str = "") -> Node: ...

    def graph(self) -> Sequence[TopicInfo]:
        """Every topic that has an end, in the order of names."""

    def connecting(self, node: Any) -> Sequence[str]:
        """Topics on which a node publishes to somebody who is there and does not hear it yet."""

    def namespaces(self) -> Sequence[str]:
        """Namespaces in use, without slashes, in order."""

    def close(self) -> None: ...


def resolve(topic: str, namespace: str) -> str:
    """The full name of a topic seen from a namespace.

    >>> resolve("odom", "REX"), resolve("/done", "REX"), resolve("~/led", "REX"), resolve("odom", "")
    ('/REX/odom', '/done', '/REX/led', '/odom')
    """
    if topic.startswith("/"):
        return topic
    name = topic.removeprefix("~/")
    return f"/{namespace}/{name}" if namespace else f"/{name}"
