"""Publishers and subscriptions."""

from __future__ import annotations

from collections.abc import Callable

from cyclonedds.core import DDSException

from fame.errors import MessageError
from fame.middleware.dds import wire
from fame.middleware.dds.entities import matched, samples_lost
from fame.middleware.dds.participant import Participant
from fame.middleware.interface import Message, QoS
from fame.middleware.qos import one_deeper
from fame.middleware.wire_base import WireNode, WirePublisher, WireSubscription

_BATCH = 16
"""How many samples are taken from Cyclone at a time."""
_MAX_BATCHES = 64
"""How many batches are taken in a row."""


class DdsPublisher(WirePublisher):
    """A publisher."""

    def __init__(self, node: WireNode, participant: Participant, topic: str, type: str, qos: QoS) -> None:
        super().__init__(node, topic, type, qos)
        self._participant, self._unflushed = participant, False
        self._writer = participant.entities.writer(wire.dds_topic(topic), self.type, qos, wire.type_hash(self.type))
        self.gid: bytes = self._writer.guid.bytes
        self.handle: int = wire.handle(self._writer.get_instance_handle())

    def publish(self, message: Message) -> None:
        data = self.pack(message)
        self._unflushed = True
        try:
            self._writer.write(self._writer.data_type(data))
        except DDSException as error:
            if error.code != DDSException.DDS_RETCODE_TIMEOUT:
                raise MessageError(f"cannot be published on {self.topic}: {error}", type=self.type) from None
            self.count_lost(1)

    def flush(self, patience: int) -> None:
        """Block until all subscriptions have what was sent, at most `patience` ns."""
        if self._unflushed:
            self._unflushed = False
            if not self._writer.wait_for_acks(patience):
                self.node.middleware.warn(f"{self.topic}: a subscriber does not keep up")

    def subscriber_count(self) -> int:
        return len(matched(self._writer))

    def matched(self) -> bool:
        own = {end.handle for end in self.node.subscriptions}
        return not own.issuperset(map(wire.handle, matched(self._writer)))

    def release(self) -> None:
        self._participant.delete(self._writer)
        self.node.middleware.on_endpoints_changed()


class DdsSubscription(WireSubscription):
    """A subscription.

    Cyclone keeps one message more than its depth until it is asked, so that a loss there is noticed, though not how
    large it is. While it is `held`, messages wait in Cyclone alone, for `drain`.
    """

    def __init__(
        self,
        node: WireNode,
        participant: Participant,
        topic: str,
        type: str,
        callback: Callable[[Message], object],
        qos: QoS,
    ) -> None:
        super().__init__(node, topic, type, callback, qos)
        self.held: bool = False
        self._participant = participant
        self._own = {publisher.handle for publisher in node.publishers if publisher.topic == topic}
        self._senders: dict[int, str] = {}
        self._reader = participant.entities.reader(
            wire.dds_topic(topic), self.type, one_deeper(qos), wire.type_hash(self.type)
        )
        self.gid: bytes = self._reader.guid.bytes
        self.handle: int = wire.handle(self._reader.get_instance_handle())

    def start(self) -> None:
        """Receive messages from now on."""
        self._participant.data.add(self._reader, self._on_data)

    def ignore(self, publisher: DdsPublisher) -> None:
        """Drop the messages of a publisher of the same node, those too that still wait when it has closed."""
        if publisher.topic == self.topic:
            self._own.add(publisher.handle)

    def drain(self) -> list[tuple[str, bytes]]:
        """Take all messages that wait in Cyclone, each with the full name of the node that sent it."""
        found = []
        while samples := self._reader.take(_BATCH):
            for sample in samples:
                info = sample.sample_info
                if info.valid_data and info.publication_handle not in self._own:
                    found.append((self._sender(info.publication_handle), sample.data))
        return found

    def losses(self) -> str:
        if self.counts_losses:
            self.count_lost(samples_lost(self._reader))
        return super().losses()

    def matched(self) -> bool:
        return not self._own.issuperset(map(wire.handle, matched(self._reader)))

    def release(self) -> None:
        self._participant.delete(self._reader)
        self.node.middleware.on_endpoints_changed()

    def _on_data(self) -> None:
        """Take what waits in Cyclone. Another thread may call this."""
        if self.held or self.closed:
            return
        for _ in range(_MAX_BATCHES):
            samples = self._reader.take(_BATCH)
            for sample in samples:
                info = sample.sample_info
                if info.valid_data and info.publication_handle not in self._own:
                    self.enqueue(sample.data)
            if len(samples) < _BATCH:
                break
        else:
            self._soon(self._on_data)  # let others have their turn
        self.schedule()

    def _sender(self, handle: int) -> str:
        if handle not in self._senders:
            end = self._reader.get_matched_publication_data(handle)
            self._senders[handle] = self._participant.owner(end.key.bytes) if end is not None else ""
        return self._senders[handle]
