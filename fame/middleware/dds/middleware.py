"""The backend: nodes on one participant of a DDS domain, and their lockstep.

Nodes are made and used in the thread of the scheduler (or before it runs).

Lockstep makes a run over DDS repeatable. A held node gets no message as it comes in: `Lockstep.release` delivers all
that wait, sorted by topic, sender and receiver, those of one sender in its order. `Lockstep.flush` ensures that what
held nodes have sent is there when the next step begins. On loopback it is: when `publish` returns, a message is in the
socket of its receiver, ahead of the message that begins the next step. On a network it takes acknowledgements, which
come late at times (200 ms). Services and actions are not held.
"""

from __future__ import annotations

import atexit
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from fame.clock import SECOND, WallScheduler
from fame.middleware.dds import wire
from fame.middleware.dds.discovery import Endpoint, NodeEntry
from fame.middleware.dds.domain import domain_id
from fame.middleware.dds.endpoints import DdsClient, DdsPublisher, DdsService, DdsSubscription
from fame.middleware.dds.participant import Participant
from fame.middleware.interface import UNKNOWN_NODE, EndpointWarning, Message, QoS, TopicInfo
from fame.middleware.wire_base import WireMiddleware, WireNode

_FLUSH_PATIENCE = 4 * SECOND
"""How long a subscription may take; one whose process died is gone before (ns)."""


class DdsMiddleware(WireMiddleware):
    """Nodes on DDS. `warnings` has what a person should know; `on_warning` is called with each in the scheduler.

    `domain` None is ROS_DOMAIN_ID. `network` None keeps everything on loopback; the name or address of an interface
    opens that one. `confined` says whether other machines really cannot reach us: do not rely on `network` alone before
    sending models without signatures. Raises ConfigError if the domain cannot be joined.
    """

    use_sim_time: bool = False
    nodes: list[DdsNode]

    def __init__(
        self,
        scheduler: WallScheduler,
        *,
        domain: int | None = None,
        network: str | None = None,
        on_warning: Callable[[EndpointWarning], object] | None = None,
    ) -> None:
        super().__init__(scheduler, network, on_warning)
        self.domain: int = domain_id(domain)
        self.holds: Callable[[str], bool] = lambda name: False
        self.participant: Participant = Participant(scheduler, self.domain, network, self.warn, self._on_service_gone)
        self.confined: bool = self.participant.confined
        atexit.register(self.close)  # a process that just ends stays in the graph until its lease is over

    def node(self, name: str, namespace: str = "") -> DdsNode:
        return DdsNode(self, name, namespace.strip("/"))

    def graph(self) -> list[TopicInfo]:
        """Every ROS topic of the domain that has an endpoint, in the order of names. Services are not among them."""
        self.refresh()
        discovery = self.participant.discovery
        owners, topics = discovery.owners(), dict[str, list[Endpoint]]()
        for endpoint in discovery.all_endpoints():
            if endpoint.topic.startswith(f"{wire.TOPIC}/"):
                topics.setdefault(endpoint.topic.removeprefix(wire.TOPIC), []).append(endpoint)
        return [_info(name, topics[name], owners) for name in sorted(topics)]

    def namespaces(self) -> list[str]:
        self.refresh()
        return sorted({node.namespace for node in self.participant.discovery.all_nodes() if node.namespace})

    def node_names(self) -> list[str]:
        """Full names of all nodes of the domain, in order. A name that two nodes have comes twice."""
        self.refresh()
        return sorted(node.full_name for node in self.participant.discovery.all_nodes())

    def offers(self, service: str) -> list[tuple[str, str]]:
        return self.participant.services(service)

    def matching_subscriptions(self, publisher: DdsPublisher) -> int:
        return self.participant.subscriptions(publisher.topic, publisher.type, publisher.qos)

    def refresh(self) -> None:
        self.participant.refresh()

    def on_endpoints_changed(self) -> None:
        self.participant.announce(node.entry() for node in self.nodes)

    def release(self) -> None:
        atexit.unregister(self.close)
        self.participant.close()

    def _on_service_gone(self) -> None:
        for node in self.nodes:
            for end in node.services:
                if isinstance(end, DdsClient):
                    end.on_service_gone()


class DdsNode(WireNode):
    """A node of the participant. While it is held, `Lockstep` delivers its messages."""

    publishers: list[DdsPublisher]
    subscriptions: list[DdsSubscription]
    services: list[DdsService | DdsClient]

    def __init__(self, middleware: DdsMiddleware, name: str, namespace: str) -> None:
        self._participant, self._held = middleware.participant, middleware.holds(name)
        super().__init__(middleware, name, namespace)

    @property
    def held(self) -> bool:
        """Whether its messages wait for `Lockstep.release`."""
        return self._held

    def hold(self, held: bool) -> None:
        """Let its messages wait, or not, from now on."""
        self._held = held
        for subscription in self.subscriptions:
            subscription.held = held

    def make_publisher(self, topic: str, type: str, qos: QoS) -> DdsPublisher:
        publisher = DdsPublisher(self, self._participant, topic, type, qos)
        for subscription in self.subscriptions:
            subscription.ignore(publisher)
        return publisher

    def make_subscription(
        self, topic: str, type: str, callback: Callable[[Message], object], qos: QoS
    ) -> DdsSubscription:
        subscription = DdsSubscription(self, self._participant, topic, type, callback, qos)
        subscription.held = self._held
        subscription.start()
        return subscription

    def make_service(self, name: str, type: str, handler: Callable[[Message], Any]) -> DdsService:
        return DdsService(self, self._participant, name, type, handler)

    def make_client(self, name: str, type: str) -> DdsClient:
        return DdsClient(self, self._participant, name, type)

    def entry(self) -> NodeEntry:
        """The node as it is announced to the domain."""
        readers = (*(end.gid for end in self.subscriptions), *(end.exchange.reader_gid for end in self.services))
        writers = (*(end.gid for end in self.publishers), *(end.exchange.writer_gid for end in self.services))
        return NodeEntry(self.name, self.namespace, readers, writers)


class Lockstep:
    """Holds the nodes of a middleware whose names `holds` accepts: those that exist, and those to come."""

    def __init__(self, middleware: DdsMiddleware, holds: Callable[[str], bool]) -> None:
        self._middleware = middleware
        middleware.holds = holds
        for node in middleware.nodes:
            node.hold(holds(node.name))

    def release(self, enter: Callable[[Callable[[], object]], object]) -> None:
        """Take all messages that wait; `enter` gets an action that delivers each, in order."""
        found = [
            (subscription.topic, sender, node.full_name, number, partial(subscription.deliver, data))
            for node in self._nodes()
            for subscription in list(node.subscriptions)
            for number, (sender, data) in enumerate(subscription.drain())
        ]
        found.sort(key=lambda entry: entry[:4])
        for *_, deliver in found:
            enter(deliver)

    def flush(self) -> None:
        """Wait until others have what was sent."""
        for node in self._nodes() if self._middleware.network is not None else ():
            for publisher in node.publishers:
                publisher.flush(_FLUSH_PATIENCE)

    def _nodes(self) -> Iterator[DdsNode]:
        return (node for node in list(self._middleware.nodes) if node.held)


def _info(name: str, endpoints: list[Endpoint], owners: dict[bytes, str]) -> TopicInfo:
    return TopicInfo(
        name,
        tuple(sorted({endpoint.type for endpoint in endpoints})),
        tuple(owners.get(endpoint.gid, UNKNOWN_NODE) for endpoint in endpoints if endpoint.writes),
        tuple(owners.get(endpoint.gid, UNKNOWN_NODE) for endpoint in endpoints if not endpoint.writes),
    )
