"""Publishers and subscriptions, services and clients.

A service is two topics, and two numbers before each message, as rmw_cyclonedds writes it. A request to ``/grip`` goes
to DDS topic ``rq/gripRequest``, its response to ``rr/gripReply``, which all clients of the service receive. Both carry
the instance handle of the client's writer and a number of the client's own, by which it recognises its response.
USER_DATA of both endpoints of a client or service holds one id, which shows that they belong together.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import count
from typing import TYPE_CHECKING, Any, Literal

from cyclonedds.core import DDSException
from cyclonedds.qos import Policy

from fame.clock import SECOND
from fame.errors import MessageError
from fame.middleware import codec, messages
from fame.middleware.dds import wire
from fame.middleware.dds.cyclone import user_data
from fame.middleware.dds.discovery import DiscoveredEndpoint
from fame.middleware.dds.participant import Participant
from fame.middleware.dds.wire import matched
from fame.middleware.errors import FOREIGN
from fame.middleware.interface import AnyMessage, EndpointWarning, QoS
from fame.middleware.qos import one_deeper
from fame.middleware.wire_endpoints import WireClient, WirePublisher, WireService, WireSubscription

if TYPE_CHECKING:
    from fame.middleware.dds.middleware import DdsNode

_BATCH = 16
"""How many samples are taken from Cyclone at a time."""
_MAX_BATCHES = 64
"""How many batches are taken in a row."""
_NEW = 10_000
"""How many messages of a publisher may be sent `to_all`: each time, Cyclone is asked."""
_LONGEST = 10 * SECOND
"""In this time nobody sends as many messages as there are numbers."""


class DdsPublisher(WirePublisher):
    def __init__(self, node: DdsNode, topic: str, type: str, qos: QoS) -> None:
        super().__init__(node, topic, type, qos)
        self._participant = participant = node.participant
        self._unflushed, self._sent, self._matches, self._to_all = False, 0, 0, True
        data = wire.type_hash(self.type) + wire.NUMBERED + wire.ACKNOWLEDGED * qos.acknowledged
        self._writer = participant.entities.writer(wire.dds_topic(topic), self.type, qos, data)
        self._matched_status: Callable[[], Any] = self._writer.get_publication_matched_status
        self.gid: bytes = self._writer.guid.bytes
        self.handle: int = wire.handle(self._writer.get_instance_handle())

    def publish(self, message: AnyMessage) -> None:
        self.send(self.pack(message))

    def send(self, data: bytes) -> None:
        """Send a message that is packed, from any thread. Raises MessageError."""
        self._unflushed = True
        if self._to_all:
            matches = self._matched_status().total_count
            self._matches = self._matches if self._sent else matches
            self._to_all = matches == self._matches and self._sent < _NEW
        try:
            self._writer.write(self._writer.data_type(data), wire.numbered_time(self._sent, self._to_all))
            self._sent += 1
        except DDSException as error:
            if error.code != DDSException.DDS_RETCODE_TIMEOUT:
                raise MessageError(f"cannot be published on {self.topic}: {error}", type=self.type) from None
            self.count_lost(1)

    def flush(self, patience: int) -> None:
        """Block until all subscriptions have received the sent messages, at most `patience` ns."""
        if self._unflushed:
            self._unflushed = False
            if not self._writer.wait_for_acks(patience):
                self.node.middleware.warn(EndpointWarning(self.topic, "a subscriber does not keep up", "slow"))

    def subscriber_count(self) -> int:
        return len(matched(self._writer))

    def matched(self) -> bool:
        own = {end.handle for end in self.node.subscriptions}
        return not own.issuperset(map(wire.handle, matched(self._writer)))

    def release(self) -> None:
        latched = self.qos.durability == "transient_local"  # nobody who comes from now on is to get its messages
        (self._participant.delete if latched else self._participant.delete_soon)(self._writer)
        self.node.middleware.on_endpoints_changed()


class DdsSubscription(WireSubscription):
    """A subscription.

    The messages of publishers of FAME are numbered, so that all that are missing are counted: those before the first
    that is taken as well, if it was matched before the publisher sent any. Of others, Cyclone keeps one message more
    than the depth: so it is noticed that some were dropped, though not how many.
    While it is `held`, messages wait in Cyclone alone, for `drain`.
    """

    def __init__(
        self, node: DdsNode, topic: str, type: str, callback: Callable[[AnyMessage], object], qos: QoS
    ) -> None:
        super().__init__(node, topic, type, callback, qos)
        self._participant = participant = node.participant
        self._own = {publisher.handle for publisher in node.publishers if publisher.topic == topic}
        self._senders: dict[int, str] = {}
        self._acknowledged: dict[int, bool] = {}
        self._last: dict[int, int | None] = {}  # source times of the last messages; None: not numbered
        self._before: dict[int, int] = {}  # missing before the first messages, not counted yet
        self._in_cyclone = 0  # taken since Cyclone had none
        self._unknown = False  # whether one of these may follow others that were not taken
        self._overflowed = False  # whether Cyclone may ever have pushed out any
        self._reader = participant.entities.reader(
            wire.dds_topic(topic), self.type, one_deeper(qos), wire.type_hash(self.type)
        )
        self.gid: bytes = self._reader.guid.bytes
        self.handle: int = wire.handle(self._reader.get_instance_handle())
        participant.data.add(self._reader, self._on_data)

    def ignore(self, publisher: DdsPublisher) -> None:
        """Drop the messages of a publisher of the same node, also those that are still queued when it closes."""
        if publisher.topic == self.topic:
            self._own.add(publisher.handle)

    def drain(self) -> list[tuple[str, bytes]]:
        """Take all messages that wait in Cyclone, each with the full name of the node that sent it."""
        found = []
        while samples := self._reader.take(_BATCH):
            found += [(self._sender(info.publication_handle), data) for data, info in self._accepted(samples)]
        return found

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
            for data, _ in self._accepted(samples):
                self.enqueue(data)
            if len(samples) < _BATCH:
                break
        else:
            self._soon(self._on_data)  # let others have their turn
        self.schedule()

    def _accepted(self, samples: Sequence[Any]) -> Iterator[tuple[bytes, Any]]:
        """The messages of other nodes, each with its sample info of DDS. Counts those that are missing before them."""
        self._in_cyclone += len(samples)  # its own, too: they push out others
        for sample in samples:
            info = sample.sample_info
            if info.valid_data and info.publication_handle not in self._own:
                if self.qos.acknowledged and self._is_acknowledged(info.publication_handle):
                    continue
                if self.counts_losses:
                    self._count(info.publication_handle, info.source_timestamp)
                yield sample.data, info
        self._overflowed |= self._in_cyclone > self.qos.depth and self.qos.history == "keep_last"
        if self._overflowed:
            self.uncounted |= self._unknown
            self.count_lost(sum(self._before.values()))
            self._before.clear()
        if len(samples) < _BATCH:
            self._in_cyclone, self._unknown = 0, False

    def _count(self, sender: int, time: int) -> None:
        """Count the messages of a sender that are missing before one of this source time."""
        last = self._last.get(sender)
        if last is not None:
            number = wire.missing(last, time)
            if (before := self._before.pop(sender, 0)) and wire.sent_before(time)[1]:
                number += before  # else it may have been matched as the first was sent
            self.count_lost(number)
            if number > 0 and time - last > _LONGEST:
                self.uncounted = True
            self._last[sender] = time
        elif sender in self._last:
            self._unknown = True
        else:
            self._begin(sender, time)

    def _begin(self, sender: int, time: int) -> None:
        """Take the first message of a sender."""
        numbered = self._user_data(sender).get("numbered")
        self._last[sender] = time if numbered else None
        before, to_all = wire.sent_before(time)
        if numbered == "2" and to_all and self.qos.durability == "volatile":  # else it begins with the history
            self._before[sender] = before
        elif before or not numbered:
            self._unknown = True

    def _is_acknowledged(self, sender: int) -> bool:
        """Whether what a publisher sends comes in another way."""
        if sender not in self._acknowledged:
            self._acknowledged[sender] = "acknowledged" in self._user_data(sender)
        return self._acknowledged[sender]

    def _user_data(self, sender: int) -> dict[str, str]:
        end = self._reader.get_matched_publication_data(sender)
        data = end.qos[Policy.Userdata] if end is not None else None
        return user_data(data.data) if data is not None else {}

    def _sender(self, handle: int) -> str:
        if handle not in self._senders:
            end = self._reader.get_matched_publication_data(handle)
            self._senders[handle] = self._participant.owner(end.key.bytes) if end is not None else ""
        return self._senders[handle]


# ---- services and clients --------------------------------------------------------------------------------------------

_QOS = QoS(depth=1000)
"""The quality of service of services in ROS, reliable and volatile, but for its depth of 10: all clients of a service
share the history of its responses, and over a link that loses packets one is dropped before it is sent again."""

_NUMBERS = struct.Struct("<Qq")
_START = wire.HEADER + _NUMBERS.size
_RETRY = SECOND // 200
_PATIENCE = SECOND
"""How often a service checks whether it has discovered the reader of a client, and for how long (ns)."""

_ids = count(1)
Numbers = tuple[int, int]


class _Exchange:
    """The two DDS endpoints of a service or client. `on_data` gets each message as CDR, its numbers and its sender."""

    participant: Participant
    writer: Any
    reader: Any
    writer_gid: bytes
    reader_gid: bytes
    closed: bool

    def __init__(
        self,
        participant: Participant,
        name: str,
        type: str,
        role: Literal["service", "client"],
        on_data: Callable[[bytes, Numbers, int], object],
    ) -> None:
        request_type, response_type = messages.service(type)
        request = wire.dds_topic(name, wire.REQUEST, "Request"), request_type
        reply = wire.dds_topic(name, wire.REPLY, "Reply"), response_type
        received, sent = (request, reply) if role == "service" else (reply, request)
        self.participant, self.closed, self._on_data = participant, False, on_data
        identity = participant.discovery.participant[:12] + next(_ids).to_bytes(4)
        data = f"{role}id={'.'.join(f'{byte:x}' for byte in identity)};"
        self.writer = participant.entities.writer(*sent, _QOS, data, header=True)
        self.reader = participant.entities.reader(*received, _QOS, data, header=True)
        participant.data.add(self.reader, partial(participant.scheduler.soon, self.take))
        self.writer_gid, self.reader_gid = self.writer.guid.bytes, self.reader.guid.bytes

    def write(self, data: bytes, numbers: Numbers) -> None:
        self.writer.write(self.writer.data_type(data[: wire.HEADER] + _NUMBERS.pack(*numbers) + data[wire.HEADER :]))

    def take(self) -> None:
        """Enter received messages in the scheduler, each as one entry."""
        for sample in () if self.closed else self.reader.take(_QOS.depth):
            if sample.sample_info.valid_data:
                action = partial(self._read, sample.data, sample.sample_info.publication_handle)
                self.participant.scheduler.soon(action)

    def close(self) -> None:
        self.closed = True
        self.participant.delete_soon(self.writer)
        self.participant.delete(self.reader)

    def _read(self, data: bytes, sender: int) -> None:
        if not self.closed:
            numbers = _NUMBERS.unpack_from(data, wire.HEADER)
            self._on_data(data[: wire.HEADER] + data[_START:], numbers, sender)


class DdsService(WireService):
    """A service. See `fame.middleware.interface.Service`."""

    exchange: _Exchange

    def __init__(self, node: DdsNode, name: str, type: str, handler: Callable[[AnyMessage], Any]) -> None:
        super().__init__(node, name, type, handler)
        self.exchange = _Exchange(node.participant, name, type, "service", self.on_data)
        self._reachable: set[int] = set()

    def release(self) -> None:
        self.exchange.close()
        self.node.middleware.on_endpoints_changed()

    def on_data(self, data: bytes, numbers: Numbers, client: int) -> None:
        """Take a request."""
        request = self.unpack(data, self.request_type)
        if request is not None:
            self.handle(request, lambda response: self.respond(codec.serialize(response), numbers, client))

    def respond(self, response: bytes, numbers: Numbers, client: int) -> None:
        """Respond as soon as the reader of the client is discovered: before that, it would not get the response."""
        self._respond(response, numbers, client, self.node.middleware.scheduler.now + _PATIENCE)

    def _respond(self, response: bytes, numbers: Numbers, client: int, deadline: int) -> None:
        scheduler = self.node.middleware.scheduler
        if self.exchange.closed or client not in map(wire.handle, matched(self.exchange.reader)):
            return  # one of the two has closed
        if client in self._reachable or self._reaches(client):
            self.exchange.write(response, numbers)
        elif scheduler.now < deadline:
            scheduler.after(_RETRY, partial(self._respond, response, numbers, client, deadline))
        else:
            text = "a client does not listen to the response to its request"
            self.node.middleware.warn(EndpointWarning(self.name, text, "slow"))

    def _reaches(self, client: int) -> bool:
        reader, writer = self.exchange.reader, self.exchange.writer
        wanted = _identity(reader.get_matched_publication_data(client))
        found = map(writer.get_matched_subscription_data, matched(writer))
        if wanted not in map(_identity, found):
            return False
        self._reachable.intersection_update(map(wire.handle, matched(reader)))
        self._reachable.add(client)
        return True


class DdsClient(WireClient):
    """A client. See `fame.middleware.interface.Client`."""

    exchange: _Exchange

    def __init__(self, node: DdsNode, name: str, type: str) -> None:
        super().__init__(node, name, type)
        self.exchange = _Exchange(node.participant, name, type, "client", self.on_data)
        self.guid: int = wire.handle(self.exchange.writer.get_instance_handle())
        self._numbers = count(1)

    @property
    def available(self) -> bool:
        """Whether a node on Cyclone offers the service now, and both topics are matched."""
        ends = self.exchange
        return not ends.closed and bool(matched(ends.writer) and matched(ends.reader) and self.servers())

    def servers(self) -> frozenset[bytes]:
        return frozenset(server.gid for server in self._found() if not server.is_foreign)

    def unavailable(self, offers: Sequence[tuple[str, str]]) -> MessageError:
        foreign = next((server for server in self._found() if server.is_foreign), None)
        if foreign is None:
            return super().unavailable(offers)
        server = self.exchange.participant.owner(foreign.gid)
        return MessageError(f"the service {self.name} is offered by {server}, {FOREIGN}", type=self.type)

    def send(self, request: AnyMessage) -> int:
        number = next(self._numbers)
        self.exchange.write(codec.serialize(request), (self.guid, number))
        return number

    def release(self) -> None:
        self.exchange.close()
        self.node.middleware.on_endpoints_changed()

    def _found(self) -> list[DiscoveredEndpoint]:
        """The servers of its name in the domain."""
        participant = self.exchange.participant
        participant.refresh()  # Cyclone connects endpoints before it tells of them
        return participant.servers(self.name)

    def on_data(self, data: bytes, numbers: Numbers, service: int) -> None:
        """Take a response, which may be that to another client."""
        guid, number = numbers
        if guid == self.guid and (response := self.unpack(data, self.response_type)) is not None:
            self.pending.respond(number, response)


def _identity(endpoint: Any) -> str:
    """The identity shared by the endpoints of one client: its id or, without one, the participant."""
    if endpoint is None:
        return ""  # it has left
    policy = endpoint.qos[Policy.Userdata]
    return user_data(policy.data if policy else b"").get("clientid") or str(endpoint.participant_key)
