"""Writers and readers of the participant, on topics that they share.

Topics stay until the participant goes: nobody sees a topic without ends, and each new one costs memory that cyclonedds
does not give back.
"""

from __future__ import annotations

from typing import Any

from cyclonedds.core import DDSException
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from fame.errors import MessageError
from fame.middleware.dds import policies, wire
from fame.middleware.dds.reading import delete
from fame.middleware.interface import QoS


class Entities:
    """What makes them."""

    def __init__(self, participant: DomainParticipant) -> None:
        self.participant = participant
        self._topics: dict[tuple[str, str, bool], Topic[Any]] = {}

    def writer(self, topic: str, type: str, qos: QoS, user_data: str, *, header: bool = False) -> DataWriter[Any]:
        """A writer on a DDS topic (``rt/odom``) of a ROS type. Raises MessageError if Cyclone refuses it.

        `header` is for the topics of services, see `wire.declared`.
        """
        try:
            shared = self._topic(topic, type, header)
            return DataWriter(self.participant, shared, policies.to_dds(qos, user_data, True))
        except DDSException as error:
            raise _refused(topic, type, error) from None

    def reader(self, topic: str, type: str, qos: QoS, user_data: str, *, header: bool = False) -> DataReader[Any]:
        """A reader likewise."""
        try:
            shared = self._topic(topic, type, header)
            return DataReader(self.participant, shared, policies.to_dds(qos, user_data, False))
        except DDSException as error:
            raise _refused(topic, type, error) from None

    def close(self) -> None:
        """Delete the topics. Writers and readers have gone before."""
        for topic in self._topics.values():
            delete(topic)

    def _topic(self, name: str, type: str, header: bool) -> Topic[Any]:
        key = name, type, header
        if key not in self._topics:
            self._topics[key] = Topic(self.participant, name, wire.declared(type, header))
        return self._topics[key]


def _refused(topic: str, type: str, error: DDSException) -> MessageError:
    return MessageError(f"Cyclone DDS refuses an end on {topic}: {error}", type=type)
