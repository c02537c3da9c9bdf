"""The participant of a DDS domain: its entities, its discovery, and how it waits for data.

Threads. A thread of the participant updates the tables of discovery, and announces its nodes. The scheduler waits for
data if it is a `DataScheduler` without another participant; else that thread does, which only enters callbacks in the
scheduler. Cyclone's own threads never run Python.

Endpoints that do not match, because of quality of service or type, are found by comparing endpoints as they are
discovered. The warning follows a moment later, when their nodes are known by name.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Set
from functools import partial
from typing import Any

from cyclonedds.core import DDSException
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader

from fame.clock import Scheduler
from fame.errors import ConfigError
from fame.middleware.data_scheduler import DataScheduler
from fame.middleware.dds import wire
from fame.middleware.dds.cyclone import delete
from fame.middleware.dds.discovery import DiscoveredEndpoint, Discovery, NodeEntry
from fame.middleware.dds.domain import confined, open_domain
from fame.middleware.dds.waitset import DataWaiter
from fame.middleware.dds.wire import Entities
from fame.middleware.errors import FOREIGN, mismatch_warning
from fame.middleware.interface import UNKNOWN_NODE, EndpointWarning, QoS
from fame.middleware.qos import compatible, mismatch
from fame.middleware.wire_base import NAMING_DELAY


class Participant:
    """A participant. Raises ConfigError if the domain cannot be joined.

    entities    makes its writers and readers
    discovery   endpoints and nodes of the domain
    warn        called with each warning
    on_servers_changed  called in the scheduler with the names of services whose servers have come or left
    """

    data: DataWaiter

    def __init__(
        self,
        scheduler: Scheduler,
        domain: int,
        network: str | None,
        warn: Callable[[EndpointWarning], object],
        on_servers_changed: Callable[[Set[str]], object],
    ) -> None:
        self.scheduler: Scheduler = scheduler
        self._warn, self._on_servers_changed, self._closed = warn, on_servers_changed, False
        self._lingering: deque[DataWriter[Any]] = deque()
        self._domain = open_domain(domain, network)
        self.confined: bool = confined(domain)
        try:
            self._participant = DomainParticipant(domain, Qos(Policy.Userdata(b"enclave=/;")))
        except DDSException as error:
            raise ConfigError(f"cannot join DDS domain {domain} on {network or 'loopback'}: {error}") from None
        self.entities: Entities = Entities(self._participant, domain)
        self._thread = self.data = DataWaiter(self._participant, self._announce)
        if isinstance(scheduler, DataScheduler) and scheduler.waiter is None:
            self.data = scheduler.waiter = DataWaiter(self._participant)
        self.discovery: Discovery = Discovery(self.entities, self._thread, self.refresh)
        self.announce(())
        self._thread.start()

    def close(self) -> None:
        """Leave the domain; others see it at once."""
        self._closed = True
        self._thread.close()
        self._delete_lingering()
        if isinstance(self.scheduler, DataScheduler) and self.scheduler.waiter is self.data:
            self.scheduler.waiter = None
            self.data.close()
        self.discovery.close()
        self.entities.close()
        delete(self._participant)
        del self._domain

    # ---- for nodes and endpoints -------------------------------------------------------------------------------------

    def announce(self, nodes: Iterable[NodeEntry]) -> None:
        self.discovery.set_nodes(nodes)
        self._thread.wake()

    def announce_again(self) -> None:
        """Announce the nodes that discovery has of this participant."""
        self._thread.wake()

    def delete(self, entity: DataWriter[Any] | DataReader[Any]) -> None:
        """Delete the writer or reader of a closed endpoint."""
        self.data.remove(entity)
        delete(entity)

    def delete_soon(self, writer: DataWriter[Any]) -> None:
        """Delete a writer in the participant's thread, since it waits for acknowledgements."""
        self._lingering.append(writer)
        self._thread.wake()

    def owner(self, gid: bytes) -> str:
        """Return the full name of the node of an endpoint."""
        self.refresh()
        return self.discovery.owners().get(gid, UNKNOWN_NODE)

    def services(self, name: str) -> list[tuple[str, str]]:
        """Type and node of each service of that name in the domain."""
        self.refresh()
        owners = self.discovery.owners()
        found = self.servers(name)
        return [(server.type.removesuffix("_Request"), owners.get(server.gid, UNKNOWN_NODE)) for server in found]

    def servers(self, name: str) -> list[DiscoveredEndpoint]:
        """Return the endpoint of each service of that name that takes its requests, as of the last `refresh`."""
        topic = wire.dds_topic(name, wire.REQUEST, "Request")
        return [endpoint for endpoint in self.discovery.on_topic(topic) if not endpoint.writes]

    def subscriptions(self, topic: str, type: str, offered: QoS) -> int:
        """Return how many subscriptions match a publisher of that topic, type and quality of service."""
        return sum(
            not other.writes and other.type == type and compatible(offered, other.qos) is None
            for other in self.discovery.on_topic(wire.dds_topic(topic))
        )

    # ---- discovery ---------------------------------------------------------------------------------------------------

    def refresh(self) -> None:
        """Update the tables of discovery, and report what follows from the changes."""
        came, went = self.discovery.refresh()
        for endpoint in came:
            for writer, reader in self._pairs(endpoint):
                if (reason := mismatch(writer, reader)) is not None:
                    self.scheduler.after(NAMING_DELAY, partial(self._report, writer, reader, reason))
            if service := self._served_to_another_dds(endpoint):
                self.scheduler.after(NAMING_DELAY, partial(self._report_foreign, service, endpoint))
        changed = {name for each in (*came, *went) if not each.writes and (name := wire.service_of(each.topic))}
        if changed:
            self.scheduler.soon(partial(self._on_servers_changed, changed))

    def _announce(self) -> None:
        try:
            if not self._closed:
                self.discovery.announce()
        except DDSException as error:
            if error.code != DDSException.DDS_RETCODE_TIMEOUT:
                raise
            self._thread.wake()  # somebody does not keep up: try again
        self._delete_lingering()

    def _delete_lingering(self) -> None:
        while self._lingering:
            delete(self._lingering.popleft())

    def _pairs(self, endpoint: DiscoveredEndpoint) -> Iterator[tuple[DiscoveredEndpoint, DiscoveredEndpoint]]:
        """Writer and reader of each pair that an endpoint makes with another, if one of them is of this participant."""
        if not endpoint.topic.startswith(f"{wire.TOPIC}/"):
            return
        for other in self.discovery.on_topic(endpoint.topic):
            if endpoint.writes != other.writes and self.discovery.participant in (
                endpoint.participant,
                other.participant,
            ):
                yield (endpoint, other) if endpoint.writes else (other, endpoint)

    def _served_to_another_dds(self, endpoint: DiscoveredEndpoint) -> str:
        """The service of this participant that this endpoint, of another DDS, is a client of; of an action only one."""
        service = wire.service_of(endpoint.topic) if endpoint.writes and endpoint.is_foreign else ""
        own = service and any(server.participant == self.discovery.participant for server in self.servers(service))
        return service if own and ("/_action/" not in service or service.endswith("/send_goal")) else ""

    def _report_foreign(self, service: str, client: DiscoveredEndpoint) -> None:
        """Warn that a client of another DDS calls a service here, and gets no response."""
        name = service.removesuffix("/_action/send_goal")
        node = self.discovery.owners().get(client.gid, UNKNOWN_NODE)
        self._warn(EndpointWarning(name, f"cannot be called by {node}, {FOREIGN}", "mismatch"))

    def _report(self, writer: DiscoveredEndpoint, reader: DiscoveredEndpoint, reason: str) -> None:
        """Warn that two endpoints do not match, unless they are of one node, or one of them is gone."""
        present = {endpoint.gid for endpoint in self.discovery.on_topic(writer.topic)}
        own = any({writer.gid, reader.gid} <= node.gids for node in self.discovery.all_nodes())
        if not own and {writer.gid, reader.gid} <= present:
            owners, topic = self.discovery.owners(), writer.topic.removeprefix(wire.TOPIC)
            subscriber, publisher = (owners.get(end.gid, UNKNOWN_NODE) for end in (reader, writer))
            self._warn(mismatch_warning(topic, subscriber, publisher, reason))
