"""Publishers and subscriptions, services and clients.

A transient local publisher keeps its last messages (Zenoh's AdvancedPublisher), which late subscriptions ask for. A
service is a queryable: a request is a query, with an attachment as messages have one.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import partial
from itertools import count
from typing import TYPE_CHECKING, Any

import zenoh
import zenoh.ext

from fame.clock import SECOND
from fame.cpython import keep_thread_state
from fame.errors import MessageError
from fame.middleware import codec
from fame.middleware.errors import dropped_warning
from fame.middleware.interface import AnyMessage, QoS
from fame.middleware.qos import mismatch
from fame.middleware.wire_endpoints import WireClient, WirePublisher, WireService, WireSubscription
from fame.middleware.zenoh import tokens
from fame.middleware.zenoh.tokens import Entity, EntityKind

if TYPE_CHECKING:
    from fame.middleware.zenoh.middleware import ZenohNode

_SERVICE_QOS = QoS(depth=10)
"""The quality of service of services in ROS: reliable, volatile, keep last 10."""
_FOREVER = 10.0 * 365 * 86400
"""Time that a request waits for its response (s); the loss of its service is noticed sooner."""
_MANY = 100_000
"""How many messages of a history that is not bounded are kept."""
_HEARTBEAT = 0.5
"""Interval in which a publisher with a history reports the number of its last message, if that is new (s)."""
_DROPPED = SECOND
"""How long a request that a service has dropped is kept, so that it is not made again at once (ns)."""
_PATIENCE = 1.0
"""How long a thread may take to end (s)."""
_DROP, _BLOCK = zenoh.CongestionControl.DROP, zenoh.CongestionControl.BLOCK


class _Declared:
    """An endpoint in Zenoh, and its token."""

    def __init__(self, node: ZenohNode, kind: EntityKind, name: str, type: str, qos: QoS) -> None:
        service = kind in (tokens.SERVICE, tokens.CLIENT)
        type_hash = codec.service_hash(type) if service else codec.type_hash(type)
        self._node, self._middleware = node, node.middleware
        middleware = node.middleware
        self.session: Any = middleware.session
        self.key: str = tokens.topic_key(middleware.domain, name, type, type_hash)
        token = tokens.endpoint_token(node.entity.token, kind, middleware.next_id(), name, type, type_hash, qos)
        self.entity: Entity = tokens.entity(token)
        middleware.follow(name=name)
        self.end: Any = None
        self._token: Any = None

    def announce(self, end: Any) -> None:
        """Announce it, after it has been declared: peers that see the token may send at once."""
        self.end, self._token = end, self._middleware.declare(self.entity)
        if self.entity.kind in (tokens.PUBLISHER, tokens.SUBSCRIPTION):
            self._middleware.report_mismatches(self.entity)

    def others(self, kind: EntityKind) -> list[Entity]:
        """Return the endpoints of that kind with the same key."""
        same_type = self.entity.type, self.entity.type_hash
        named = self._middleware.entities.named(self.entity.name, kind)
        return [other for other in named if (other.type, other.type_hash) == same_type]

    def matching(self, kind: EntityKind) -> list[Entity]:
        """Return the publishers or subscriptions of other nodes that it is connected to."""
        mine = self.entity
        found = [other for other in self.others(kind) if not self._node.owns(other)]
        if kind == tokens.PUBLISHER:
            return [other for other in found if mismatch(other, mine) is None]
        return [other for other in found if mismatch(mine, other) is None]

    def withdraw(self) -> None:
        self._middleware.withdraw(self.entity, self._token)
        if self.end is not None:
            self.end.undeclare()


class ZenohPublisher(WirePublisher):
    node: ZenohNode

    def __init__(self, node: ZenohNode, topic: str, type: str, qos: QoS) -> None:
        super().__init__(node, topic, type, qos)
        self._declared = declared = _Declared(node, tokens.PUBLISHER, topic, self.type, qos)
        self.token: str = declared.entity.token
        self.gid: bytes = declared.entity.gid
        self._numbers = count(1 + tokens.ACKNOWLEDGED * qos.acknowledged)
        reliable, history = qos.reliability == "reliable", qos.durability == "transient_local"
        options: Any = {
            "congestion_control": _BLOCK if reliable and qos.history == "keep_all" else _DROP,
            "reliability": zenoh.Reliability.RELIABLE if reliable else zenoh.Reliability.BEST_EFFORT,
            "allowed_destination": zenoh.Locality.REMOTE,
        }
        if history:
            misses = zenoh.ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=_HEARTBEAT) if reliable else None
            options |= {
                "cache": zenoh.ext.CacheConfig(_depth(qos)),
                "sample_miss_detection": misses,
                "publisher_detection": True,
            }
            end: Any = zenoh.ext.declare_advanced_publisher(declared.session, declared.key, **options)
        else:
            end = declared.session.declare_publisher(declared.key, **options)
        self._put = end.put
        declared.announce(end)

    def publish(self, message: AnyMessage) -> None:
        data, number = self.pack(message), next(self._numbers)
        try:
            self._put(data, attachment=tokens.attachment(number, self.gid))
        except zenoh.ZError as error:
            raise MessageError(f"cannot be published on {self.topic}: {error}", type=self.type) from None
        for subscription in self.node.middleware.receivers.get(self._declared.key, ()):
            subscription.receive_here(number, self.gid, data)

    def connected(self) -> list[Entity]:
        """Return the subscriptions of other nodes that it matches."""
        return self._declared.matching(tokens.SUBSCRIPTION)

    def subscriber_count(self) -> int:
        return len(self.connected())

    def matched(self) -> bool:
        return bool(self.connected())

    def release(self) -> None:
        self._declared.withdraw()


class ZenohSubscription(WireSubscription):
    """A subscription. Messages that were lost are those whose number is missing, up to the last one that came.

    Publishers of the same session hand their messages over by themselves: Zenoh would call back in the thread that
    publishes, and swallow the KeyboardInterrupt of a Ctrl-C at that moment.
    """

    node: ZenohNode

    def __init__(
        self, node: ZenohNode, topic: str, type: str, callback: Callable[[AnyMessage], object], qos: QoS
    ) -> None:
        super().__init__(node, topic, type, callback, qos)
        self._declared = declared = _Declared(node, tokens.SUBSCRIPTION, topic, self.type, qos)
        self.token: str = declared.entity.token
        self._graph = node.middleware.entities
        self._own = {publisher.gid for publisher in node.publishers if publisher.topic == topic}
        self._last: dict[bytes, int] = {}
        self._here: set[bytes] = set()  # publishers of the same session that have handed something over
        self._accepted: dict[bytes, bool] = {}
        self._arrived: deque[zenoh.Sample] = deque()
        self._noted = False  # whether the scheduler will take what has arrived
        self._wakeups = node.middleware.wakeups
        self._held: deque[tuple[bytes, bytes]] = deque(maxlen=None if qos.history == "keep_all" else qos.depth)
        # A thread of Zenoh does as little as possible: the scheduler's would wait for the interpreter's lock meanwhile.
        self._on_sample = self._take_sample if self._wakeups is None else self._note
        self._listener: threading.Thread | None = None
        if qos.durability == "transient_local":
            end = self._declare_with_history()
        else:
            on_sample: Any = zenoh.handlers.Callback(self._call_back, indirect=False)
            end = declared.session.declare_subscriber(declared.key, on_sample)
        node.middleware.receivers.setdefault(declared.key, []).append(self)
        declared.announce(end)

    def _declare_with_history(self) -> Any:
        """A subscriber that asks publishers for their history, and a thread that takes what comes.

        Zenoh passes samples on under a lock that a publisher of the same topic in this session waits for when it is
        made and closed, and then Python's lock is held: a callback in Zenoh's own thread would wait for that for ever.
        """
        qos = self.qos
        all, last = zenoh.handlers.FifoChannel, zenoh.handlers.RingChannel
        keep: Any = all(_MANY) if qos.history == "keep_all" else last(qos.depth)
        recovery = zenoh.ext.RecoveryConfig(periodic_queries=None, heartbeat=True)
        end: Any = zenoh.ext.declare_advanced_subscriber(
            self._declared.session,
            self._declared.key,
            keep,
            history=zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=_depth(qos)),
            recovery=recovery if qos.reliability == "reliable" else None,
            subscriber_detection=True,
        )
        self._listener = threading.Thread(target=self._listen, args=(end.handler,), name="fame history", daemon=True)
        self._listener.start()
        return end

    def _call_back(self, sample: zenoh.Sample) -> None:
        """In a thread of Zenoh."""
        keep_thread_state()
        self._on_sample(sample)

    def _listen(self, samples: Iterable[zenoh.Sample]) -> None:
        """Take what comes, until the subscriber is withdrawn."""
        for sample in samples:
            self._on_sample(sample)

    def receive_here(self, number: int, gid: bytes, data: bytes) -> None:
        """Take a message of a publisher of the same session."""
        if gid not in self._own:
            self._receive(number, time.time_ns(), gid, data)
            self._here.add(gid)

    def ignore(self, publisher: ZenohPublisher) -> None:
        """Drop the messages of a publisher of the same node, also those that are still queued when it closes."""
        if publisher.topic == self.topic:
            self._own.add(publisher.gid)

    def drain(self) -> list[tuple[str, bytes]]:
        """Take all messages that were held, each with the full name of the node that sent it."""
        self._take_arrived()
        found = [self._held.popleft() for _ in range(len(self._held))]
        return [(self._sender(gid), data) for gid, data in found]

    def matched(self) -> bool:
        return bool(self._declared.matching(tokens.PUBLISHER))

    def release(self) -> None:
        self.node.middleware.receivers[self._declared.key].remove(self)
        self._declared.withdraw()
        if self._listener is not None and self._listener is not threading.current_thread():
            self._listener.join(_PATIENCE)

    def _note(self, sample: zenoh.Sample) -> None:
        """Keep a sample until the scheduler takes it; at most as many as the queue holds."""
        arrived = self._arrived
        if len(arrived) == self._queue.maxlen:
            with suppress(IndexError, MessageError):  # the scheduler has just taken it; it is refused elsewhere
                dropped = arrived.popleft()
                number, _, gid = tokens.read_attachment(dropped.attachment.to_bytes() if dropped.attachment else b"")
                self._begin(gid, number)
        arrived.append(sample)
        if not self._noted and self._wakeups is not None:
            self._noted = True
            self._wakeups.add(self._take_arrived)

    def _take_arrived(self) -> None:
        self._noted = False  # from here on, a new sample is announced again
        arrived = self._arrived
        with suppress(IndexError):  # Zenoh's thread has dropped the last one
            for _ in range(len(arrived)):
                self._take_sample(arrived.popleft())

    def _take_sample(self, sample: zenoh.Sample) -> None:
        """In the thread of the scheduler or, if it waits for something else, in one of Zenoh."""
        try:
            number, sent, gid = tokens.read_attachment(sample.attachment.to_bytes() if sample.attachment else b"")
        except MessageError as error:
            self._soon(partial(self._refuse, str(error)))
            return
        again = gid in self._here and number <= self._last.get(gid, 0)  # of the same session, with the history
        if gid not in self._own and not again:
            self._receive(number, sent, gid, sample.payload.to_bytes())

    def _receive(self, number: int, sent: int, gid: bytes, data: bytes) -> None:
        if not self._accepts(gid, sent) or (self.qos.acknowledged and number > tokens.ACKNOWLEDGED):
            return
        self._begin(gid, number)
        if self.counts_losses:
            self.count_lost(max(0, number - self._last[gid] - 1))
        self._last[gid] = number
        if self.held:
            if self.counts_losses and len(self._held) == self._held.maxlen:
                self.count_lost(1)
            self._held.append((gid, data))
        else:
            self.enqueue(data)
            self.schedule()

    def _begin(self, gid: bytes, number: int) -> None:
        """Begin to count with the first message of a publisher; Zenoh may have dropped others from the history."""
        if gid not in self._last:
            self._last[gid] = number - 1
            self.uncounted |= self._listener is not None and number % tokens.ACKNOWLEDGED > 1

    def _accepts(self, gid: bytes, sent: int) -> bool:
        """Whether the quality of service of a publisher fits, and its message is not too old."""
        publisher = self._graph.publisher(gid)
        if publisher is None:
            return self._accepted.get(gid, True)  # it has left, or is not known yet
        if gid not in self._accepted:
            self._accepted[gid] = mismatch(publisher, self._declared.entity) is None
        lifespan = publisher.qos.lifespan
        return self._accepted[gid] and (lifespan is None or time.time_ns() - sent <= lifespan * SECOND)

    def _refuse(self, text: str) -> None:
        self.on_dropped(dropped_warning(self.topic, text))

    def _sender(self, gid: bytes) -> str:
        publisher = self._graph.publisher(gid)
        return publisher.node if publisher is not None else ""


class ZenohService(WireService):
    """A service. See `fame.middleware.interface.Service`."""

    node: ZenohNode

    def __init__(self, node: ZenohNode, name: str, type: str, handler: Callable[[AnyMessage], Any]) -> None:
        super().__init__(node, name, type, handler)
        self.type: str = self.request_type.removesuffix("_Request")
        self._declared = declared = _Declared(node, tokens.SERVICE, name, self.type, _SERVICE_QOS)
        on_query = zenoh.handlers.Callback(self._on_query, indirect=False)
        declared.announce(declared.session.declare_queryable(declared.key, on_query, complete=True))

    def release(self) -> None:
        self._declared.withdraw()

    def _on_query(self, query: zenoh.Query) -> None:
        """In a thread of Zenoh."""
        self.node.middleware.scheduler.soon(partial(self._answer, query))

    def _answer(self, query: Any) -> None:
        if self.closed:
            return
        try:
            received = tokens.read_attachment(query.attachment.to_bytes() if query.attachment else b"")
            request = codec.deserialize(query.payload.to_bytes() if query.payload else b"", self.request_type)
        except MessageError as error:
            self.node.middleware.warn(dropped_warning(self.name, str(error)))
            query.drop()
            return

        def send(response: AnyMessage) -> None:
            if not self.closed:
                returned = tokens.attachment(received.number, received.gid)
                query.reply(self._declared.key, codec.serialize(response), attachment=returned)
                query.drop()  # it has no other response

        self.handle(request, send)


class ZenohClient(WireClient):
    """A client. See `fame.middleware.interface.Client`."""

    node: ZenohNode

    def __init__(self, node: ZenohNode, name: str, type: str) -> None:
        super().__init__(node, name, type)
        self.type: str = self.request_type.removesuffix("_Request")
        self._declared = _Declared(node, tokens.CLIENT, name, self.type, _SERVICE_QOS)
        self._declared.announce(None)
        self._numbers = count(1)

    @property
    def available(self) -> bool:
        """Whether a node offers the service now."""
        self.node.middleware.ask((tokens.SERVICE, self.name))
        return not self.closed and bool(self._declared.others(tokens.SERVICE))

    def servers(self) -> frozenset[str]:
        return frozenset(server.token for server in self._declared.others(tokens.SERVICE))

    def send(self, request: AnyMessage) -> int:
        number, soon = next(self._numbers), self.node.middleware.scheduler.soon
        self._declared.session.get(
            self._declared.key,
            zenoh.handlers.Callback(
                lambda reply: soon(partial(self._on_reply, number, reply)),
                lambda: soon(partial(self._on_end, number)),
                indirect=False,
            ),
            target=zenoh.QueryTarget.ALL_COMPLETE,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=_FOREVER,
            payload=codec.serialize(request),
            attachment=tokens.attachment(number, self._declared.entity.gid),
        )
        return number

    def release(self) -> None:
        self._declared.withdraw()

    def _on_reply(self, number: int, reply: zenoh.Reply) -> None:
        if self.closed or reply.ok is None:
            return
        if (response := self.unpack(reply.ok.payload.to_bytes(), self.response_type)) is not None:
            self.pending.respond(number, response)

    def _on_end(self, number: int) -> None:
        """Drop a request without response: its service has left, or it is still there and has dropped the request."""
        if number not in self.pending:
            return
        if self.servers():
            self.node.middleware.doubt(self.name)
            self.node.middleware.scheduler.after(_DROPPED, partial(self._drop, number))
        else:
            self._drop(number)

    def _drop(self, number: int) -> None:
        if self.pending.drop(number):
            self.warn_unanswered()


def _depth(qos: QoS) -> int:
    return _MANY if qos.history == "keep_all" else qos.depth
