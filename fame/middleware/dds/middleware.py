"""The backend: nodes on one participant of a DDS domain.

Nodes are made and used in the thread of the scheduler (or before it runs).
"""

from __future__ import annotations

import atexit
from collections.abc import Callable, Set
from functools import partial
from typing import ClassVar

from fame.clock import SECOND, WallScheduler
from fame.middleware.dds import wire
from fame.middleware.dds.discovery import DiscoveredEndpoint, NodeEntry
from fame.middleware.dds.endpoints import DdsClient, DdsPublisher, DdsService, DdsSubscription
from fame.middleware.dds.participant import Participant
from fame.middleware.interface import UNKNOWN_NODE, EndpointWarning, TopicInfo
from fame.middleware.wire_base import EndpointClasses, WireMiddleware, WireNode, domain_id

_FLUSH_PATIENCE = 4 * SECOND
"""Time limit for a subscription to receive all messages; one whose process died is removed earlier (ns)."""


class DdsMiddleware(WireMiddleware):
    """Nodes on DDS. `warnings` are for the user; `on_warning` is called with each of them in the scheduler.

    `domain` None is ROS_DOMAIN_ID. `network` None keeps everything on loopback; the name or address of an interface
    opens that one. `confined` says whether other machines really cannot reach this process: do not rely on `network`
    alone before sending models without signatures. Raises ConfigError if the domain cannot be joined.
    """

    use_sim_time: bool = False
    lockstep: bool = True
    nodes: list[DdsNode]
    _graph: tuple[int, list[TopicInfo]] = (-1, [])
    """How often discovery had changed, and the topics then."""

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
        self.participant: Participant = Participant(scheduler, self.domain, network, self.warn, self._servers_changed)
        self.confined: bool = self.participant.confined
        atexit.register(self.close)  # a process that just ends stays in the graph until its lease is over

    def node(self, name: str, namespace: str = "", part: str = "") -> DdsNode:
        return DdsNode(self, name, namespace.strip("/"), part)

    def graph(self) -> list[TopicInfo]:
        """Return every ROS topic of the domain that has an endpoint, in the order of names, without services.

        It is the same list until something changes.
        """
        self.refresh()
        discovery = self.participant.discovery
        changes = discovery.changes
        if self._graph[0] == changes:
            return self._graph[1]
        owners, topics = discovery.owners(), dict[str, list[DiscoveredEndpoint]]()
        for endpoint in discovery.all_endpoints():
            if endpoint.topic.startswith(f"{wire.TOPIC}/"):
                topics.setdefault(endpoint.topic.removeprefix(wire.TOPIC), []).append(endpoint)
        self._graph = changes, [_info(name, topics[name], owners) for name in sorted(topics)]
        return self._graph[1]

    def namespaces(self) -> list[str]:
        self.refresh()
        return sorted({node.namespace for node in self.participant.discovery.all_nodes() if node.namespace})

    def node_names(self) -> list[str]:
        self.refresh()
        return sorted(node.full_name for node in self.participant.discovery.all_nodes())

    def offers(self, service: str) -> list[tuple[str, str]]:
        return self.participant.services(service)

    def matching_subscriptions(self, publisher: DdsPublisher) -> int:
        return self.participant.subscriptions(publisher.topic, publisher.type, publisher.qos)

    def refresh(self) -> None:
        self.participant.refresh()

    def on_endpoints_changed(self) -> None:
        self.participant.announce(node.entry() for node in self.nodes if node.is_first_part())

    def flush(self) -> None:
        """Wait on a network for acknowledgements, which sometimes come late (200 ms).

        On loopback nothing is needed: when `publish` returns, the message is in the socket of its receiver, ahead of
        the message that begins the next step.
        """
        for node in self.nodes if self.network is not None else ():
            for publisher in node.publishers if node.held else ():
                publisher.flush(_FLUSH_PATIENCE)

    def release(self) -> None:
        atexit.unregister(self.close)
        self.participant.close()

    def _servers_changed(self, services: Set[str]) -> None:
        for node in self.nodes:
            for end in node.services:
                if isinstance(end, DdsClient) and end.name in services:
                    end.exchange.take()  # the last responses of a server that has left
        self.scheduler.soon(partial(self.on_servers_changed, services))


class DdsNode(WireNode):
    publishers: list[DdsPublisher]
    subscriptions: list[DdsSubscription]
    services: list[DdsService | DdsClient]
    endpoint_classes: ClassVar[EndpointClasses] = EndpointClasses(DdsPublisher, DdsSubscription, DdsService, DdsClient)

    def __init__(self, middleware: DdsMiddleware, name: str, namespace: str, part: str) -> None:
        self.participant: Participant = middleware.participant
        super().__init__(middleware, name, namespace, part)

    def entry(self) -> NodeEntry:
        """Return the node as it is announced to the domain, with its other parts."""
        readers, writers = list[bytes](), list[bytes]()
        for part in (self, *self.others()):
            readers += [*(end.gid for end in part.subscriptions), *(end.exchange.reader_gid for end in part.services)]
            writers += [*(end.gid for end in part.publishers), *(end.exchange.writer_gid for end in part.services)]
        return NodeEntry(self.name, self.namespace, tuple(readers), tuple(writers))


def _info(name: str, endpoints: list[DiscoveredEndpoint], owners: dict[bytes, str]) -> TopicInfo:
    return TopicInfo(
        name,
        tuple(sorted({endpoint.type for endpoint in endpoints})),
        tuple(owners.get(endpoint.gid, UNKNOWN_NODE) for endpoint in endpoints if endpoint.writes),
        tuple(owners.get(endpoint.gid, UNKNOWN_NODE) for endpoint in endpoints if not endpoint.writes),
        tuple(endpoint.qos for endpoint in endpoints if endpoint.writes),
    )
