"""Who is there: every endpoint of the domain, and the ROS nodes that they belong to.

DDS itself knows endpoints and participants (its built-in topics), not nodes: each participant that speaks ROS writes on
`ros_discovery_info` which nodes it has, and which endpoints belong to them. The two are joined by gid, the 16 bytes of
a GUID, whenever somebody asks. Own endpoints are found in the same way as all others.

`refresh` takes what has come in since the last time. Any thread may call; one lock guards the tables.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from cyclonedds import builtin
from cyclonedds.core import InstanceState
from cyclonedds.sub import DataReader

from fame.errors import MessageError
from fame.middleware.builtin_types import PARTICIPANT
from fame.middleware.dds import information, policies, wire
from fame.middleware.dds.entities import Entities
from fame.middleware.dds.information import NodeEntry
from fame.middleware.dds.reading import Watch, delete
from fame.middleware.interface import QoS

_INFO_TOPIC = "ros_discovery_info"
_KEPT = QoS(durability="transient_local", depth=1)
_HEARD = QoS(durability="transient_local", history="keep_all")
"""Not keep last 1: the topic has no key, so that it would hold one sample of all participants."""

_MANY = 256
"""Samples taken at a time."""


@dataclass(frozen=True, slots=True)
class Endpoint:
    """A writer or reader. `topic` is the name in DDS (``rt/odom``), `type` that in ROS (``nav_msgs/msg/Odometry``)."""

    gid: bytes
    participant: bytes
    topic: str
    type: str
    writes: bool
    qos: QoS
    type_hash: str


class Discovery:
    """The tables. `endpoints`: gid -> endpoint; `nodes`: gid of a participant -> its nodes.

    `changed` is called, in the thread of the watch, when there is something to `refresh`.
    """

    def __init__(self, entities: Entities, watch: Watch, changed: Callable[[], object]) -> None:
        participant = entities.participant
        self.participant: bytes = participant.guid.bytes
        self.endpoints: dict[bytes, Endpoint] = {}
        self.nodes: dict[bytes, tuple[NodeEntry, ...]] = {}
        self._lock = threading.RLock()
        data = wire.type_hash(PARTICIPANT)
        self._writer = entities.writer(_INFO_TOPIC, PARTICIPANT, _KEPT, data)
        self._reader = entities.reader(_INFO_TOPIC, PARTICIPANT, _HEARD, data)
        self._participants = builtin.BuiltinDataReader(participant, builtin.BuiltinTopicDcpsParticipant)
        self._ends = {
            True: builtin.BuiltinDataReader(participant, builtin.BuiltinTopicDcpsPublication),
            False: builtin.BuiltinDataReader(participant, builtin.BuiltinTopicDcpsSubscription),
        }
        for built_in in (self._participants, *self._ends.values()):
            built_in._cqos_conv = policies.from_dds
            watch.add(built_in, changed)
        watch.add(self._reader, changed)

    def close(self) -> None:
        """Give all readers and the writer back, when nobody watches them any more."""
        for end in (self._writer, self._reader, self._participants, *self._ends.values()):
            delete(end)

    def describe(self, nodes: Iterable[NodeEntry]) -> None:
        """Note which nodes this participant has."""
        with self._lock:
            self.nodes[self.participant] = tuple(nodes)

    def announce(self) -> None:
        """Tell the domain which nodes this participant has: the whole list, each time."""
        with self._lock:
            data = information.pack(self.participant, self.nodes[self.participant])
            self._writer.write(self._writer.data_type(data))

    def refresh(self) -> tuple[list[Endpoint], list[Endpoint]]:
        """Bring the tables up to date; returns the endpoints that came and those that went."""
        came: list[Endpoint] = []
        went: list[Endpoint] = []
        with self._lock:
            for writes, reader in self._ends.items():
                for sample in _samples(reader):
                    self._note(sample, writes, came, went)
            for sample in _samples(self._reader):
                if sample.sample_info.valid_data:
                    self._hear(sample.data)
            for sample in _samples(self._participants):
                if sample.sample_info.instance_state != InstanceState.Alive:
                    self.nodes.pop(sample.key.bytes, None)
        return came, went

    def ends(self) -> list[Endpoint]:
        """All endpoints, in the order in which they came."""
        with self._lock:
            return list(self.endpoints.values())

    def on_topic(self, topic: str) -> list[Endpoint]:
        """The endpoints of a DDS topic."""
        return [endpoint for endpoint in self.ends() if endpoint.topic == topic]

    def all_nodes(self) -> list[NodeEntry]:
        """The nodes of all participants."""
        with self._lock:
            return [node for nodes in self.nodes.values() for node in nodes]

    def owners(self) -> dict[bytes, str]:
        """Gid of an endpoint -> full name of its node."""
        return {gid: node.full_name for node in self.all_nodes() for gid in node.gids}

    def _note(self, sample: Any, writes: bool, came: list[Endpoint], went: list[Endpoint]) -> None:
        gid = sample.key.bytes
        known = self.endpoints.get(gid)
        if sample.sample_info.instance_state != InstanceState.Alive:
            if known is not None:
                went.append(self.endpoints.pop(gid))
        elif known is None:
            qos, data = sample.qos
            self.endpoints[gid] = endpoint = Endpoint(
                gid,
                sample.participant_key.bytes,
                sample.topic_name,
                wire.ros_type(sample.type_name),
                writes,
                qos,
                data.get("typehash", ""),
            )
            came.append(endpoint)

    def _hear(self, data: bytes) -> None:
        """Note what a participant says of its nodes. What cannot be read is not from a ROS node, and means nothing."""
        try:
            participant, nodes = information.unpack(data)
        except MessageError:
            return
        if participant != self.participant:
            self.nodes[participant] = nodes


def _samples(reader: DataReader[Any]) -> Iterator[Any]:
    while samples := reader.take(_MANY):
        yield from samples
