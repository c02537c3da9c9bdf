"""Writers and readers of the participant, on topics that they share, and their quality of service in DDS.

Topics are made once and stay until the participant goes. Nobody sees a topic without ends; but each one that is made
costs memory that cyclonedds does not give back, and Cyclone 11.0.1 crashes now and then when a type is declared after
others of this process were forgotten: the tree in which it keeps what types consist of has entries that were freed
(`gv->typedeps`; eclipse-cyclonedds/cyclonedds, issue 2426). No harm was seen of types that other processes
forget. So a participant that closes while others of this process stay in the domain leaves them its types.
"""

from __future__ import annotations

import ctypes
from typing import Any

from cyclonedds.core import DDSException
from cyclonedds.domain import DomainParticipant
from cyclonedds.internal import dds_c_t
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos, _CQos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from fame.clock import SECOND
from fame.errors import MessageError
from fame.middleware.dds import wire
from fame.middleware.interface import QoS

_RELIABLE: Any = Policy.Reliability.Reliable
_FOREVER = duration(infinite=True)
_PATIENCE = SECOND // 10
"""How long a write waits for subscriptions that do not keep up (ns)."""
_KEPT = "kept"
"""Topics with this prefix exist for their types alone."""
_of_process: dict[int, list[Entities]] = {}
"""Domain -> the entities of each participant of this process."""


class Entities:
    """Makes the writers and readers of a participant, until `close`."""

    def __init__(self, participant: DomainParticipant, domain: int) -> None:
        self.participant = participant
        self._topics: dict[tuple[str, str, bool], Topic[Any]] = {}
        self._others = _of_process.setdefault(domain, [])
        self._others.append(self)

    @property
    def types(self) -> set[str]:
        """The types that Cyclone knows at least as long as the participant exists."""
        return {type for _, type, _ in self._topics}

    def close(self) -> None:
        """Hand the types over to another participant of the process, if there is one, before this one is deleted."""
        self._others.remove(self)
        if self._others:
            for _, type, header in self._topics:
                self._others[0].topic(f"{_KEPT}/{type}/{header}", type, header)

    def writer(self, topic: str, type: str, qos: QoS, user_data: str, *, header: bool = False) -> DataWriter[Any]:
        """A writer on a DDS topic (``rt/odom``) of a ROS type. Raises MessageError if Cyclone refuses it.

        `header` is for the topics of services, see `wire.declared`.
        """
        try:
            shared = self.topic(topic, type, header)
            return DataWriter(self.participant, shared, to_dds(qos, user_data, True))
        except DDSException as error:
            raise _refused(topic, type, error) from None

    def reader(self, topic: str, type: str, qos: QoS, user_data: str, *, header: bool = False) -> DataReader[Any]:
        """A reader on a DDS topic. Raises as `writer`."""
        try:
            shared = self.topic(topic, type, header)
            return DataReader(self.participant, shared, to_dds(qos, user_data, False))
        except DDSException as error:
            raise _refused(topic, type, error) from None

    def topic(self, name: str, type: str, header: bool) -> Topic[Any]:
        """The topic of that name and type."""
        key = name, type, header
        if key not in self._topics:
            self._topics[key] = Topic(self.participant, name, wire.declared(type, header))
        return self._topics[key]


def matched(end: DataWriter[Any] | DataReader[Any]) -> list[int]:
    """The instance handles of all endpoints that one is connected to now.

    cyclonedds asks how many there are, and then for that many: if one comes in between, it reads beyond its array.
    """
    find = end.get_matched_subscriptions if isinstance(end, DataWriter) else end.get_matched_publications
    while True:
        try:
            return find()
        except IndexError:
            continue


def samples_lost(reader: DataReader[Any]) -> int:
    """How many messages of its publishers a reader has missed since this was asked last, as far as Cyclone knows.

    cyclonedds tells that to listeners only, which Cyclone calls in threads of its own.
    """
    status: Any = dds_c_t.sample_lost_status()
    reader._dll_handle.dds_get_sample_lost_status(reader._ref, ctypes.byref(status))
    return int(status.total_count_change)


def _refused(topic: str, type: str, error: DDSException) -> MessageError:
    return MessageError(f"Cyclone DDS refuses an endpoint on {topic}: {error}", type=type)


# ---- quality of service ----------------------------------------------------------------------------------------------


def to_dds(qos: QoS, user_data: str, writes: bool) -> Qos:
    """The policies of a writer or reader. `user_data` is what ROS reads of it: ``typehash=RIHS01_...;``."""
    policies = [
        Policy.Reliability.Reliable(_PATIENCE) if qos.reliability == "reliable" else Policy.Reliability.BestEffort,
        _history(qos),
        Policy.Deadline(_time(qos.deadline)),
        _liveliness(qos),
        Policy.DataRepresentation(use_cdrv0_representation=True),
        Policy.Userdata(user_data.encode()),
    ]
    if qos.durability == "transient_local":
        policies.append(Policy.Durability.TransientLocal)
    if writes:
        policies += [Policy.Lifespan(_time(qos.lifespan)), Policy.WriterDataLifecycle(autodispose=False)]
        if qos.durability == "transient_local":  # else whoever comes late gets one message
            policies.append(Policy.DurabilityService(0, _history(qos), -1, -1, -1))
    return Qos(*policies)


def from_dds(pointer: int) -> tuple[QoS, dict[str, str]]:
    """The policies by which an endpoint matches others, and the entries of its user data.

    `pointer` is Cyclone's. cyclonedds' own conversion is four times as slow, and never frees the user data.
    """
    get: Any = _CQos
    policies = ctypes.c_void_p(pointer)
    liveliness, deadline = get._get_p_liveliness(policies), get._get_p_deadline(policies)
    qos = QoS(
        reliability="reliable" if isinstance(get._get_p_reliability(policies), _RELIABLE) else "best_effort",
        durability="volatile" if get._get_p_durability(policies) == Policy.Durability.Volatile else "transient_local",
        deadline=_seconds(deadline.deadline) if deadline else None,
        liveliness="manual_by_topic" if isinstance(liveliness, Policy.Liveliness.ManualByTopic) else "automatic",
        lease_duration=_seconds(liveliness.lease_duration) if liveliness else None,
    )
    data, size = ctypes.c_void_p(), ctypes.c_size_t()
    if not get._get_userdata(policies, ctypes.byref(data), ctypes.byref(size)) or not data:
        return qos, {}
    entries = user_data(ctypes.string_at(data, size.value))
    get.free(data)
    return qos, entries


def user_data(data: bytes) -> dict[str, str]:
    """The entries of the user data of a participant or endpoint: ``key=value;`` each."""
    return dict(entry.split("=", 1) for entry in data.decode("utf-8", "replace").split(";") if "=" in entry)


def _history(qos: QoS) -> Any:
    return Policy.History.KeepAll if qos.history == "keep_all" else Policy.History.KeepLast(qos.depth)


def _liveliness(qos: QoS) -> Any:
    manual = qos.liveliness == "manual_by_topic"
    kind = Policy.Liveliness.ManualByTopic if manual else Policy.Liveliness.Automatic
    return kind(_time(qos.lease_duration))


def _time(seconds: float | None) -> int:
    return _FOREVER if seconds is None else round(seconds * SECOND)


def _seconds(time: int) -> float | None:
    return None if time >= _FOREVER else time / SECOND
