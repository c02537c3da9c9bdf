"""Services and clients, as rmw_cyclonedds writes them: two topics, and two numbers before each message.

A request to ``/grip`` goes to DDS topic ``rq/gripRequest``, its response to ``rr/gripReply``, which all clients of the
service hear. Both carry the instance handle of the client's writer and a number of the client's own, by which it knows
its response. USER_DATA of both ends of a client or service holds one id, so that others see which belong together.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import partial
from itertools import count
from typing import TYPE_CHECKING, Any, Literal

from cyclonedds.qos import Policy

from fame.clock import SECOND
from fame.errors import MessageError
from fame.middleware import codec, messages
from fame.middleware.dds import policies, wire
from fame.middleware.dds.entities import matched
from fame.middleware.interface import Message, QoS, respond
from fame.middleware.wire_base import ClientEnd, ServiceEnd

if TYPE_CHECKING:
    from fame.middleware.dds.nodes import DdsNode

_QOS = QoS(depth=10)
"""That of services in ROS: reliable, volatile, keep last 10."""

_NUMBERS = struct.Struct("<Qq")
_START = wire.HEADER + _NUMBERS.size
_RETRY = SECOND // 200
_PATIENCE = SECOND
"""How often a response looks whether its client has been discovered, and for how long (ns)."""

_ids = count(1)
Numbers = tuple[int, int]


class _Exchange:
    """The two ends of a service or client. `hear` is called for each message, with its numbers and its sender."""

    def __init__(
        self,
        node: DdsNode,
        name: str,
        type: str,
        role: Literal["service", "client"],
        hear: Callable[[Message, Numbers, int], object],
    ) -> None:
        request_type, response_type = messages.service(type)
        request = wire.dds_topic(name, wire.REQUEST, "Request"), request_type
        reply = wire.dds_topic(name, wire.REPLY, "Reply"), response_type
        heard, said = (request, reply) if role == "service" else (reply, request)
        self.middleware, self.name, self.closed = node.middleware, name, False
        self._hear, self._heard_type = hear, heard[1]
        entities = node.middleware.entities
        identity = node.middleware.discovery.participant[:12] + next(_ids).to_bytes(4)
        data = f"{role}id={'.'.join(f'{byte:x}' for byte in identity)};"
        self.writer = entities.writer(*said, _QOS, data, header=True)
        self.reader = entities.reader(*heard, _QOS, data, header=True)
        node.middleware.data.add(self.reader, partial(node.middleware.scheduler.soon, self.take))
        self.writer_gid, self.reader_gid = self.writer.guid.bytes, self.reader.guid.bytes

    def write(self, message: Message, numbers: Numbers) -> None:
        data = codec.serialize(message)
        self.writer.write(self.writer.data_type(data[: wire.HEADER] + _NUMBERS.pack(*numbers) + data[wire.HEADER :]))

    def take(self) -> None:
        """Enter what has come in the scheduler, each message by itself."""
        for sample in () if self.closed else self.reader.take(_QOS.depth):
            if sample.sample_info.valid_data:
                action = partial(self._read, sample.data, sample.sample_info.publication_handle)
                self.middleware.scheduler.soon(action)

    def close(self) -> None:
        self.closed = True
        self.middleware.discard(self.writer)
        self.middleware.discard(self.reader)

    def _read(self, data: bytes, sender: int) -> None:
        try:
            message = codec.deserialize(data[: wire.HEADER] + data[_START:], self._heard_type)
        except MessageError as error:
            self.middleware.warn(f"{self.name}: dropped a message: {error}")
        else:
            if not self.closed:
                self._hear(message, _NUMBERS.unpack_from(data, wire.HEADER), sender)


class DdsService(ServiceEnd):
    """What answers requests. See `fame.middleware.interface.Service`."""

    def __init__(self, node: DdsNode, name: str, type: str, handler: Callable[[Message], Any]) -> None:
        super().__init__(node, name, type)
        self.check_offer()
        self._handler = handler
        self.exchange = _Exchange(node, name, type, "service", self._answer)
        self._reachable: set[int] = set()

    def leave(self) -> None:
        self.exchange.close()

    def _answer(self, request: Message, numbers: Numbers, client: int) -> None:
        def tell(said: Any) -> None:
            response = messages.create(self.response_type, said)
            self._respond(response, numbers, client, self.node.middleware.scheduler.now + _PATIENCE)

        respond(self._handler(request), tell)

    def _respond(self, response: Message, numbers: Numbers, client: int, deadline: int) -> None:
        """Respond as soon as the reader of the client has been discovered: before that, it would not hear."""
        scheduler = self.node.middleware.scheduler
        if self.exchange.closed or client not in map(wire.handle, matched(self.exchange.reader)):
            return  # one of the two left
        if client in self._reachable or self._reaches(client):
            self.exchange.write(response, numbers)
        elif scheduler.now < deadline:
            scheduler.after(_RETRY, partial(self._respond, response, numbers, client, deadline))
        else:
            self.node.middleware.warn(f"{self.name}: a client does not listen to the response that it asked for")

    def _reaches(self, client: int) -> bool:
        reader, writer = self.exchange.reader, self.exchange.writer
        wanted = _identity(reader.get_matched_publication_data(client))
        found = map(writer.get_matched_subscription_data, matched(writer))
        if wanted not in map(_identity, found):
            return False
        self._reachable.intersection_update(map(wire.handle, matched(reader)))
        self._reachable.add(client)
        return True


class DdsClient(ClientEnd):
    """What asks a service. See `fame.middleware.interface.Client`."""

    def __init__(self, node: DdsNode, name: str, type: str) -> None:
        super().__init__(node, name, type)
        self.exchange = _Exchange(node, name, type, "client", self._hear)
        self._guid = wire.handle(self.exchange.writer.get_instance_handle())
        self._numbers = count(1)
        self._waiting: dict[int, Callable[[Message], object]] = {}

    @property
    def available(self) -> bool:
        """Whether somebody offers the service now, and both topics have been matched."""
        ends = self.exchange
        return not ends.closed and bool(matched(ends.writer) and matched(ends.reader))

    def call(self, request: Any, callback: Callable[[Message], object]) -> None:
        """Send a request. Raises MessageError if it does not fit, or if nobody offers the service with this type."""
        message = self.request(request)
        number = next(self._numbers)
        self._waiting[number] = callback
        self.exchange.write(message, (self._guid, number))

    def leave(self) -> None:
        self._waiting.clear()
        self.exchange.close()

    def check(self) -> None:
        """Some service has left. If it was this one, those who wait for it wait in vain."""
        self.exchange.take()  # what it answered before
        self.node.middleware.scheduler.soon(self._give_up)

    def _give_up(self) -> None:
        if self._waiting and not self.available:
            self._waiting.clear()
            self.give_up()

    def _hear(self, response: Message, numbers: Numbers, service: int) -> None:
        guid, number = numbers
        if guid == self._guid and number in self._waiting:
            self._waiting.pop(number)(response)


def _identity(endpoint: Any) -> str:
    """What tells which ends belong to one client: its id or, where there is none, the participant."""
    if endpoint is None:
        return ""  # it left
    policy = endpoint.qos[Policy.Userdata]
    return policies.user_data(policy.data if policy else b"").get("clientid") or str(endpoint.participant_key)
