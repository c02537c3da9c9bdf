"""Nodes, and their ends of topics."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING

from cyclonedds.core import DDSException

from fame.errors import MessageError
from fame.middleware.dds import wire
from fame.middleware.dds.entities import matched, samples_lost
from fame.middleware.dds.information import NodeEntry
from fame.middleware.dds.services import DdsClient, DdsService
from fame.middleware.interface import Message, QoS
from fame.middleware.qos import counts_losses, one_more
from fame.middleware.wire_base import Kinds, TopicEnd, WireNode

if TYPE_CHECKING:
    from fame.middleware.dds.middleware import DdsMiddleware

_BATCH = 16
"""How many samples are taken from Cyclone at a time."""
_TURNS = 64
"""How many times that is done in a row."""


class DdsPublisher(TopicEnd):
    """One end of a topic."""

    def __init__(self, node: DdsNode, topic: str, type: str, qos: QoS) -> None:
        super().__init__(node, topic, type, qos)
        self._unheard = False
        self._writer = node.middleware.entities.writer(wire.dds_topic(topic), self.type, qos, wire.type_hash(self.type))
        self.gid, self.handle = self._writer.guid.bytes, wire.handle(self._writer.get_instance_handle())
        for subscription in node.subscriptions:
            subscription.ignore(self)

    def publish(self, message: Message) -> None:
        """Send it. Raises MessageError if it is not a message of the topic's type, and if the publisher is closed."""
        data = self.pack(message)
        self._unheard = True
        try:
            self._writer.write(self._writer.data_type(data))
        except DDSException as error:
            if error.code != DDSException.DDS_RETCODE_TIMEOUT:
                raise MessageError(f"cannot be published on {self.topic}: {error}", type=self.type) from None
            self.lost += 1

    def losses(self) -> str:
        text = f"{self.topic}: {self.node.full_name} lost {self.lost} messages: a subscriber does not take them in time"
        return text if self.lost else ""

    def subscribers(self) -> int:
        """How many subscriptions it is connected to, those of its own node too."""
        return len(matched(self._writer))

    def flush(self, patience: int) -> None:
        """Block until all subscribers have what was sent, at most so long (ns)."""
        if self._unheard:
            self._unheard = False
            if not self._writer.wait_for_acks(patience):
                self.node.middleware.warn(f"{self.topic}: a subscriber does not keep up")

    def matched(self) -> bool:
        """Whether there is a subscription of another node."""
        own = {end.handle for end in self.node.subscriptions}
        return not own.issuperset(map(wire.handle, matched(self._writer)))

    def leave(self) -> None:
        self.node.middleware.discard(self._writer)


class DdsSubscription(TopicEnd):
    """The other end.

    What has come waits here, at most `qos.depth` messages, until an entry of the scheduler takes it: there is at most
    one such entry. It calls back for one message, and enters itself again if there are more. Cyclone keeps one message
    more than that until it is asked, so that a loss there is noticed, though not how large it is. What a held node gets
    waits in Cyclone alone.
    """

    def __init__(self, node: DdsNode, topic: str, type: str, callback: Callable[[Message], object], qos: QoS) -> None:
        super().__init__(node, topic, type, qos)
        self._callback = callback
        self._own = {publisher.handle for publisher in node.publishers if publisher.topic == topic}
        self._taken: deque[bytes] = deque(maxlen=None if qos.history == "keep_all" else qos.depth)
        self._senders: dict[int, str] = {}
        self._entered = False
        self._counts = counts_losses(qos)
        self._soon = node.middleware.scheduler.soon
        self._reader = node.middleware.entities.reader(
            wire.dds_topic(topic), self.type, one_more(qos), wire.type_hash(self.type)
        )
        node.middleware.data.add(self._reader, self._arrived)
        self.gid, self.handle = self._reader.guid.bytes, wire.handle(self._reader.get_instance_handle())

    def ignore(self, publisher: DdsPublisher) -> None:
        """A node does not hear itself. What its publisher sent before it closed may still wait: it stays ignored."""
        if publisher.topic == self.topic:
            self._own.add(publisher.handle)

    def drain(self) -> list[tuple[str, bytes]]:
        """All that waits in Cyclone, each with the full name of the node that sent it."""
        found = []
        while samples := self._reader.take(_BATCH):
            for sample in samples:
                info = sample.sample_info
                if info.valid_data and info.publication_handle not in self._own:
                    found.append((self._sender(info.publication_handle), sample.data))
        return found

    def losses(self) -> str:
        if self._counts:
            self.lost += samples_lost(self._reader)
        return super().losses()

    def matched(self) -> bool:
        """Whether there is a publisher of another node."""
        return not self._own.issuperset(map(wire.handle, matched(self._reader)))

    def leave(self) -> None:
        self._taken.clear()
        self.node.middleware.discard(self._reader)

    def _arrived(self) -> None:
        """Something waits in Cyclone: fetch it. Another thread may call this."""
        if self.node.held or self.closed:
            return
        for _ in range(_TURNS):
            samples = self._reader.take(_BATCH)
            for sample in samples:
                info = sample.sample_info
                if info.valid_data and info.publication_handle not in self._own:
                    self.lost += self._counts and len(self._taken) == self._taken.maxlen
                    self._taken.append(sample.data)
            if len(samples) < _BATCH:
                break
        else:
            self._soon(self._arrived)  # others want to be served too
        self._enter()

    def _sender(self, handle: int) -> str:
        if handle not in self._senders:
            end = self._reader.get_matched_publication_data(handle)
            self._senders[handle] = self.node.middleware.owner(end.key.bytes) if end is not None else ""
        return self._senders[handle]

    def _enter(self) -> None:
        if self._taken and not self._entered:
            self._entered = True
            self._soon(self._deliver)

    def _deliver(self) -> None:
        self._entered = False
        if self.closed:
            return
        data = self._taken.popleft()
        self._enter()
        self.hand_over(data)

    def hand_over(self, data: bytes) -> None:
        """Call back for a message, unless it is none."""
        self.unpack(data, self._callback)


class DdsNode(WireNode):
    """A node of the participant. If `held`, `fame.middleware.dds.lockstep` says when it gets its messages."""

    kinds = Kinds(DdsPublisher, DdsSubscription, DdsService, DdsClient)
    publishers: list[DdsPublisher]
    subscriptions: list[DdsSubscription]
    services: list[DdsService | DdsClient]

    def __init__(self, middleware: DdsMiddleware, name: str, namespace: str) -> None:
        self.held = middleware.holds(name)
        super().__init__(middleware, name, namespace)

    def entry(self) -> NodeEntry:
        """How the domain is told of it."""
        readers = (*(end.gid for end in self.subscriptions), *(end.exchange.reader_gid for end in self.services))
        writers = (*(end.gid for end in self.publishers), *(end.exchange.writer_gid for end in self.services))
        return NodeEntry(self.name, self.namespace, readers, writers)
