"""The backend: one participant of a DDS domain, and the nodes that live in it.

Threads. Nodes are made and used in the thread of the scheduler (or before it runs). One thread of our own keeps the
tables of discovery, and tells the domain which nodes are here. Data are waited for by the scheduler, if it is a
`DdsScheduler` and this its only middleware, else by our thread too, which only enters callbacks in the scheduler.
Cyclone's own threads never run our code.

Ends that cannot hear each other, because of quality of service or type, are found by comparing endpoints as they are
discovered; it is said in `warnings` a moment later, when their nodes are known by name.
"""

from __future__ import annotations

import atexit
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from cyclonedds.core import DDSException
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader

from fame.clock import WallScheduler
from fame.errors import ConfigError
from fame.middleware.dds import wire
from fame.middleware.dds.discovery import Discovery, Endpoint
from fame.middleware.dds.domain import confined, domain_id, open_domain
from fame.middleware.dds.entities import Entities
from fame.middleware.dds.nodes import DdsNode, DdsPublisher
from fame.middleware.dds.reading import Watch, delete
from fame.middleware.dds.scheduler import DdsScheduler
from fame.middleware.dds.services import DdsClient
from fame.middleware.interface import UNKNOWN, TopicInfo
from fame.middleware.qos import compatible
from fame.middleware.wire_base import NAMING, WireMiddleware


class DdsMiddleware(WireMiddleware):
    """Nodes on DDS. `warnings` collects what a person should know; `on_warning` is told of each in the scheduler.

    `domain` None is ROS_DOMAIN_ID. `network` None keeps everything on loopback; the name or address of an interface
    opens that one. `confined` tells whether other machines really cannot reach us: what carries code must not rely on
    `network` alone. Raises ConfigError if the domain cannot be joined.
    """

    use_sim_time = False

    def __init__(
        self,
        scheduler: WallScheduler,
        *,
        domain: int | None = None,
        network: str | None = None,
        on_warning: Callable[[str], object] | None = None,
    ) -> None:
        super().__init__(scheduler, network, on_warning)
        self.domain = domain_id(domain)
        self.holds: Callable[[str], bool] = lambda name: False
        self._open = open_domain(self.domain, network)
        self.confined = confined(self.domain)
        try:
            self._participant = DomainParticipant(self.domain, Qos(Policy.Userdata(b"enclave=/;")))
        except DDSException as error:
            raise ConfigError(f"cannot join DDS domain {self.domain} on {network or 'loopback'}: {error}") from None
        self.entities = Entities(self._participant, self.domain)
        self._watch = self.data = Watch(self._participant, self._announce)
        if isinstance(scheduler, DdsScheduler) and scheduler.watch is None:
            self.data = scheduler.watch = Watch(self._participant)
        self.discovery = Discovery(self.entities, self._watch, self.refresh)
        self.changed()
        self._watch.start()
        atexit.register(self.close)  # a process that just ends stays in the graph until its lease is over

    def node(self, name: str, namespace: str = "") -> DdsNode:
        """A new node. Several may have the same name, as in ROS."""
        return DdsNode(self, name, namespace.strip("/"))

    def graph(self) -> list[TopicInfo]:
        """Every ROS topic of the domain that has an end, in the order of names. Services are not in it."""
        self.refresh()
        owners = self.discovery.owners()
        topics: dict[str, list[Endpoint]] = {}
        for endpoint in self.discovery.ends():
            if endpoint.topic.startswith(f"{wire.TOPIC}/"):
                topics.setdefault(endpoint.topic.removeprefix(wire.TOPIC), []).append(endpoint)
        return [_info(name, topics[name], owners) for name in sorted(topics)]

    def namespaces(self) -> list[str]:
        """The namespaces of all nodes of the domain."""
        self.refresh()
        return sorted({node.namespace for node in self.discovery.all_nodes() if node.namespace})

    def node_names(self) -> list[str]:
        """Full names of all nodes of the domain, own ones too, in order. A name that two have comes twice."""
        self.refresh()
        return sorted(node.full_name for node in self.discovery.all_nodes())

    def leave(self) -> None:
        atexit.unregister(self.close)
        self._watch.close()
        if isinstance(self.scheduler, DdsScheduler) and self.scheduler.watch is self.data:
            self.scheduler.watch = None
            self.data.close()
        self.discovery.close()
        self.entities.left()
        delete(self._participant)
        del self._open

    # ---- for nodes and their ends ------------------------------------------------------------------------------------

    def changed(self) -> None:
        """Nodes or their ends are not what they were: let the domain know."""
        self.discovery.describe(node.entry() for node in self.nodes)
        self._watch.ring()

    def discard(self, end: DataWriter[Any] | DataReader[Any]) -> None:
        """An end is closed."""
        self.data.remove(end)
        delete(end)
        self.changed()

    def owner(self, gid: bytes) -> str:
        """The full name of the node of an endpoint."""
        self.refresh()
        return self.discovery.owners().get(gid, UNKNOWN)

    def offers(self, service: str) -> list[tuple[str, str]]:
        """Type and node of each service of that name in the domain."""
        self.refresh()
        topic, owners = wire.dds_topic(service, wire.REQUEST, "Request"), self.discovery.owners()
        servers = [endpoint for endpoint in self.discovery.on_topic(topic) if not endpoint.writes]
        return [(server.type.removesuffix("_Request"), owners.get(server.gid, UNKNOWN)) for server in servers]

    def refresh(self) -> None:
        """See who came and who went."""
        came, went = self.discovery.refresh()
        for endpoint in came:
            for writer, reader in self._pairs(endpoint):
                if (mismatch := _mismatch(writer, reader)) is not None:
                    self.scheduler.after(NAMING, partial(self._report, writer, reader, mismatch))
        if any(endpoint.topic.startswith(f"{wire.REQUEST}/") and not endpoint.writes for endpoint in went):
            self.scheduler.soon(self._check_clients)

    def _announce(self) -> None:
        try:
            if not self.closed:
                self.discovery.announce()
        except DDSException as error:
            if error.code != DDSException.DDS_RETCODE_TIMEOUT:
                raise
            self._watch.ring()  # somebody does not keep up: once more

    def _pairs(self, endpoint: Endpoint) -> Iterator[tuple[Endpoint, Endpoint]]:
        """Writer and reader of each pair that an endpoint makes with another, if one of them is here."""
        if not endpoint.topic.startswith(f"{wire.TOPIC}/"):
            return
        for other in self.discovery.on_topic(endpoint.topic):
            if endpoint.writes != other.writes and self.discovery.participant in (
                endpoint.participant,
                other.participant,
            ):
                yield (endpoint, other) if endpoint.writes else (other, endpoint)

    def _report(self, writer: Endpoint, reader: Endpoint, mismatch: str) -> None:
        """Say why two ends do not hear each other, unless they are of one node, or one of them left."""
        present = {endpoint.gid for endpoint in self.discovery.on_topic(writer.topic)}
        own = any({writer.gid, reader.gid} <= node.gids for node in self.discovery.all_nodes())
        if not own and {writer.gid, reader.gid} <= present:
            owners, topic = self.discovery.owners(), writer.topic.removeprefix(wire.TOPIC)
            ends = f"{owners.get(reader.gid, UNKNOWN)} hears nothing from {owners.get(writer.gid, UNKNOWN)}"
            self.warn(f"{topic}: {ends}: {mismatch}")

    def _check_clients(self) -> None:
        for node in self.nodes:
            for end in node.services:
                if isinstance(end, DdsClient):
                    end.check()

    def hearers(self, end: DdsPublisher) -> int:
        """How many subscriptions there are that can hear a publisher."""
        return sum(
            not other.writes and other.type == end.type and compatible(end.qos, other.qos) is None
            for other in self.discovery.on_topic(wire.dds_topic(end.topic))
        )


def _mismatch(writer: Endpoint, reader: Endpoint) -> str | None:
    """Why a reader hears nothing from a writer, or None if it does."""
    if writer.type != reader.type:
        return f"type: offered {writer.type}, requested {reader.type}"
    if writer.type_hash and reader.type_hash and writer.type_hash != reader.type_hash:
        return f"type: they have different definitions of {writer.type}"
    return compatible(writer.qos, reader.qos)


def _info(name: str, endpoints: list[Endpoint], owners: dict[bytes, str]) -> TopicInfo:
    return TopicInfo(
        name,
        tuple(sorted({endpoint.type for endpoint in endpoints})),
        tuple(owners.get(endpoint.gid, UNKNOWN) for endpoint in endpoints if endpoint.writes),
        tuple(owners.get(endpoint.gid, UNKNOWN) for endpoint in endpoints if not endpoint.writes),
    )
