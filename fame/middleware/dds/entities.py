"""Writers and readers of the participant, on topics that they share.

Topics are made once and stay until the participant goes. Nobody sees a topic without ends; but each one that is made
costs memory that cyclonedds does not give back, and Cyclone 11.0.1 crashes now and then when a type is declared after
others of this process were forgotten: the tree in which it notes what types consist of keeps entries that were freed
(`gv->typedeps`; eclipse-cyclonedds/cyclonedds, issue 2426). No harm was seen of types that other processes
forget. So who leaves while others of this process stay in the domain leaves them its types.
"""

from __future__ import annotations

import ctypes
from typing import Any

from cyclonedds.core import DDSException
from cyclonedds.domain import DomainParticipant
from cyclonedds.internal import dds_c_t
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from fame.errors import MessageError
from fame.middleware.dds import policies, wire
from fame.middleware.interface import QoS

_KEPT = "kept"
"""Topics of such names are there for their types."""
_here: dict[int, list[Entities]] = {}
"""Those of each domain that this process is in."""


class Entities:
    """What makes them, until it has `left`."""

    def __init__(self, participant: DomainParticipant, domain: int) -> None:
        self.participant = participant
        self._topics: dict[tuple[str, str, bool], Topic[Any]] = {}
        self._others = _here.setdefault(domain, [])
        self._others.append(self)

    @property
    def types(self) -> set[str]:
        """Those that Cyclone knows at least as long as the participant is there."""
        return {type for _, type, _ in self._topics}

    def left(self) -> None:
        """The participant is about to go: another one of the process keeps the types known, if there is one."""
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
            return DataWriter(self.participant, shared, policies.to_dds(qos, user_data, True))
        except DDSException as error:
            raise _refused(topic, type, error) from None

    def reader(self, topic: str, type: str, qos: QoS, user_data: str, *, header: bool = False) -> DataReader[Any]:
        """A reader likewise."""
        try:
            shared = self.topic(topic, type, header)
            return DataReader(self.participant, shared, policies.to_dds(qos, user_data, False))
        except DDSException as error:
            raise _refused(topic, type, error) from None

    def topic(self, name: str, type: str, header: bool) -> Topic[Any]:
        """The topic of that name and type."""
        key = name, type, header
        if key not in self._topics:
            self._topics[key] = Topic(self.participant, name, wire.declared(type, header))
        return self._topics[key]


def matched(end: DataWriter[Any] | DataReader[Any]) -> list[int]:
    """The instance handles of all that an end is connected to now.

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
    return MessageError(f"Cyclone DDS refuses an end on {topic}: {error}", type=type)
