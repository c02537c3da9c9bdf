"""Discovery: every endpoint of the domain, and the ROS nodes that they belong to.

DDS itself knows endpoints and participants (its built-in topics), not nodes: each participant of ROS publishes on
`ros_discovery_info` which nodes it has, and which endpoints belong to them (``rmw_dds_common/msg/
ParticipantEntitiesInfo``). The two are joined by gid, the 16 bytes of a GUID, on demand. Endpoints of this participant
are found in the same way as all others.

`refresh` takes the samples that arrived since the last call. Any thread may call it; one lock guards the tables.

The message is packed by hand, not by the codec: every participant sends it whenever a node changes and receives those
of all others, and it is the only message for which an engine without a process would need the codec.
"""

from __future__ import annotations

import struct
import threading
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from cyclonedds import builtin
from cyclonedds.core import InstanceState
from cyclonedds.sub import DataReader

from fame.dataclasses import dataclass
from fame.errors import MessageError
from fame.middleware.codec import LITTLE, ORDERS
from fame.middleware.dds import wire
from fame.middleware.dds.cyclone import delete, read_policies
from fame.middleware.dds.waitset import DataWaiter
from fame.middleware.dds.wire import Entities
from fame.middleware.interface import QoS, resolve
from fame.middleware.typesystem import PARTICIPANT, ros_type

_INFO_TOPIC = "ros_discovery_info"
_ANNOUNCED = QoS(durability="transient_local", depth=1)
_RECEIVED = QoS(durability="transient_local", history="keep_all")
"""Not keep last 1: the topic has no key, so that it would hold one sample of all participants."""

_GID = 16  # bytes
_CYCLONE = bytes((1, 16))
_MANY = 256
"""Samples taken at a time."""


@dataclass(frozen=True, slots=True)
class DiscoveredEndpoint:
    """A writer or reader. `topic` is the name in DDS (``rt/odom``), `type` that in ROS (``nav_msgs/msg/Odometry``)."""

    gid: bytes
    participant: bytes
    topic: str
    type: str
    writes: bool
    qos: QoS
    type_hash: str

    @property
    def is_foreign(self) -> bool:
        """Whether it is of another DDS than Cyclone: its GUID begins with the vendor (RTPS 2.5, 9.3.1.5)."""
        return self.gid[: len(_CYCLONE)] != _CYCLONE


@dataclass(frozen=True, slots=True)
class NodeEntry:
    """A node as its participant announces it. `namespace` has no slashes around it."""

    name: str
    namespace: str
    readers: tuple[bytes, ...]
    writers: tuple[bytes, ...]

    @property
    def full_name(self) -> str:
        return resolve(self.name, self.namespace)

    @property
    def gids(self) -> frozenset[bytes]:
        return frozenset((*self.readers, *self.writers))


class Discovery:
    """The tables. `endpoints`: gid -> endpoint; `nodes`: gid of a participant -> its nodes.

    `changed` is called, in the thread of the waiter, when there is something to `refresh`.
    """

    def __init__(self, entities: Entities, waiter: DataWaiter, changed: Callable[[], object]) -> None:
        participant = entities.participant
        self.participant: bytes = participant.guid.bytes
        self.endpoints: dict[bytes, DiscoveredEndpoint] = {}
        self._on_topics: dict[str, dict[bytes, DiscoveredEndpoint]] = {}
        self.nodes: dict[bytes, tuple[NodeEntry, ...]] = {}
        self.changes: int = 0  # how often something has changed
        self._lock = threading.RLock()
        data = wire.type_hash(PARTICIPANT)
        self._writer = entities.writer(_INFO_TOPIC, PARTICIPANT, _ANNOUNCED, data)
        self._reader = entities.reader(_INFO_TOPIC, PARTICIPANT, _RECEIVED, data)
        self._participants = builtin.BuiltinDataReader(participant, builtin.BuiltinTopicDcpsParticipant)
        self._endpoint_readers = {
            True: builtin.BuiltinDataReader(participant, builtin.BuiltinTopicDcpsPublication),
            False: builtin.BuiltinDataReader(participant, builtin.BuiltinTopicDcpsSubscription),
        }
        for built_in in (self._participants, *self._endpoint_readers.values()):
            read_policies(built_in)
            waiter.add(built_in, changed)
        waiter.add(self._reader, changed)

    def close(self) -> None:
        """Delete all readers and the writer, when no waiter has them any more."""
        for end in (self._writer, self._reader, self._participants, *self._endpoint_readers.values()):
            delete(end)

    def set_nodes(self, nodes: Iterable[NodeEntry]) -> None:
        """Set the nodes of this participant, for `announce`."""
        with self._lock:
            self.nodes[self.participant] = tuple(nodes)
            self.changes += 1

    def announce(self) -> None:
        """Publish which nodes this participant has: the whole list, each time."""
        with self._lock:
            data = pack_nodes(self.participant, self.nodes[self.participant])
            self._writer.write(self._writer.data_type(data))

    def refresh(self) -> tuple[list[DiscoveredEndpoint], list[DiscoveredEndpoint]]:
        """Bring the tables up to date; returns the endpoints that came and those that went."""
        came: list[DiscoveredEndpoint] = []
        went: list[DiscoveredEndpoint] = []
        with self._lock:
            for writes, reader in self._endpoint_readers.items():
                for sample in _samples(reader):
                    self._update(sample, writes, came, went)
            for sample in _samples(self._reader):
                if sample.sample_info.valid_data:
                    self._on_nodes(sample.data)
            for sample in _samples(self._participants):
                if sample.sample_info.instance_state != InstanceState.Alive:
                    self.nodes.pop(sample.key.bytes, None)
                    self.changes += 1
            self.changes += len(came) + len(went)
        return came, went

    def all_endpoints(self) -> list[DiscoveredEndpoint]:
        """Return all endpoints, in the order in which they came."""
        with self._lock:
            return list(self.endpoints.values())

    def on_topic(self, topic: str) -> list[DiscoveredEndpoint]:
        """Return the endpoints of a DDS topic."""
        with self._lock:
            return list(self._on_topics.get(topic, {}).values())

    def all_nodes(self) -> list[NodeEntry]:
        with self._lock:
            return [node for nodes in self.nodes.values() for node in nodes]

    def owners(self) -> dict[bytes, str]:
        """Gid of an endpoint -> full name of its node."""
        return {gid: node.full_name for node in self.all_nodes() for gid in node.gids}

    def _update(
        self, sample: Any, writes: bool, came: list[DiscoveredEndpoint], went: list[DiscoveredEndpoint]
    ) -> None:
        gid = sample.key.bytes
        known = self.endpoints.get(gid)
        if sample.sample_info.instance_state != InstanceState.Alive:
            if known is not None:
                went.append(self.endpoints.pop(gid))
                ends = self._on_topics[known.topic]
                del ends[gid]
                if not ends:
                    del self._on_topics[known.topic]
        elif known is None:
            qos, data = sample.qos
            self.endpoints[gid] = endpoint = DiscoveredEndpoint(
                gid,
                sample.participant_key.bytes,
                sample.topic_name,
                ros_type(sample.type_name),
                writes,
                qos,
                data.get("typehash", ""),
            )
            self._on_topics.setdefault(endpoint.topic, {})[gid] = endpoint
            came.append(endpoint)

    def _on_nodes(self, data: bytes) -> None:
        """Keep what a participant announces. What cannot be read is not from a ROS node, and is ignored."""
        try:
            participant, nodes = unpack_nodes(data)
        except MessageError:
            return
        if participant != self.participant:
            self.nodes[participant] = nodes
            self.changes += 1


def _samples(reader: DataReader[Any]) -> Iterator[Any]:
    while samples := reader.take(_MANY):
        yield from samples


# ---- the announcement of nodes, as CDR -------------------------------------------------------------------------------


def pack_nodes(participant: bytes, nodes: Iterable[NodeEntry]) -> bytes:
    """Return the gid of a participant and its nodes, as CDR."""
    parts = [_pack_node(node) for node in nodes]
    return b"".join((LITTLE, participant, struct.pack("<I", len(parts)), *parts))


def unpack_nodes(data: bytes) -> tuple[bytes, tuple[NodeEntry, ...]]:
    """Return the inverse of `pack_nodes`. Raises MessageError for data that are not from a ROS node."""
    try:
        return _unpack_nodes(data)
    except (KeyError, ValueError, struct.error) as error:
        raise MessageError(f"cannot read {len(data)} bytes of CDR: {error}", type=PARTICIPANT) from None


def _pack_node(node: NodeEntry) -> bytes:
    """A node, padded to a multiple of 4 bytes, so that all begin where numbers may."""
    names = _pack_text(f"/{node.namespace}") + _pack_text(node.name)
    ends = (part for gids in (node.readers, node.writers) for part in (struct.pack("<I", len(gids)), *gids))
    return b"".join((names, *ends))


def _pack_text(text: str) -> bytes:
    data = text.encode() + b"\0"
    return struct.pack("<I", len(data)) + data + bytes(-len(data) % 4)


def _unpack_nodes(data: bytes) -> tuple[bytes, tuple[NodeEntry, ...]]:
    unsigned = struct.Struct(f"{ORDERS[data[:2]]}I")
    at = len(LITTLE)

    def take(length: int) -> bytes:
        nonlocal at
        at += length
        if at > len(data):
            raise ValueError("it ends too early")
        return data[at - length : at]

    def number() -> int:
        take(-at % 4)
        value: int = unsigned.unpack(take(4))[0]
        return value

    def text() -> str:
        return take(number())[:-1].decode()

    def gids() -> tuple[bytes, ...]:
        return tuple([take(_GID) for _ in range(number())])

    participant = take(_GID)
    nodes = []
    for _ in range(number()):
        namespace, name = text().strip("/"), text()
        nodes.append(NodeEntry(name, namespace, gids(), gids()))
    return participant, tuple(nodes)
