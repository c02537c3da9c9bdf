"""Writers and readers of the participant: made and deleted. Topics are shared, and go with the last.

What cyclonedds leaves to the garbage collector is deleted at once here: an end that is closed is gone for the others.
All of it happens in the thread of the scheduler.
"""

from __future__ import annotations

from collections import Counter
from typing import Any

from cyclonedds.core import DDSException
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from fame.errors import MessageError
from fame.middleware.dds import policies, wire
from fame.middleware.dds.reading import delete
from fame.middleware.interface import QoS


class Entities:
    """What lives in a participant."""

    def __init__(self, participant: DomainParticipant) -> None:
        self.participant = participant
        self._topics: dict[tuple[str, str], Topic[Any]] = {}
        self._users: Counter[Topic[Any]] = Counter()

    def writer(self, topic: str, type: str, qos: QoS, user_data: str, *, header: bool = False) -> DataWriter[Any]:
        """A writer on a DDS topic (``rt/odom``) of a ROS type. Raises MessageError if Cyclone refuses it."""
        declared = wire.declared(type, header)
        writer: DataWriter[Any] = self._end(DataWriter, topic, declared, policies.to_dds(qos, user_data, True))
        return writer

    def reader(self, topic: str, type: str, qos: QoS, user_data: str, *, header: bool = False) -> DataReader[Any]:
        """A reader likewise."""
        declared = wire.declared(type, header)
        reader: DataReader[Any] = self._end(DataReader, topic, declared, policies.to_dds(qos, user_data, False))
        return reader

    def discard(self, end: DataWriter[Any] | DataReader[Any]) -> None:
        """Delete a writer or reader, and its topic if it was the last on it."""
        topic = end.topic
        delete(end)
        self._users[topic] -= 1
        if not self._users[topic]:
            del self._users[topic]
            self._topics = {key: other for key, other in self._topics.items() if other is not topic}
            delete(topic)

    def _end(self, kind: Any, name: str, declared: Any, qos: Qos) -> Any:
        key = name, declared.__idl_typename__
        try:
            topic = self._topics.get(key) or Topic(self.participant, name, declared)
            end = kind(self.participant, topic, qos)
        except DDSException as error:
            raise MessageError(f"{name}: Cyclone DDS refuses this end: {error}", type=key[1]) from None
        self._topics[key] = topic
        self._users[topic] += 1
        return end
