"""A network of processes as DDS makes one: discovery takes time, links fail, and each process has a view of its own.

Each pair of processes has one link. While it is cut, or one end is stopped or dead, nothing passes: reliable messages
wait, at most the `depth` newest of each publisher. After `LEASE` s without contact an end forgets the other one, with
all matches and waiting messages; with new contact it discovers it again, and transient local publishers send their
last messages once more. A process that closes an endpoint says so; one that is killed does not.
"""

from __future__ import annotations

import random
from collections import Counter, deque
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from fame.clock import SECOND, Kind, Scheduler
from fame.middleware import messages
from fame.middleware.errors import publish_error, unavailable_error
from fame.middleware.insistent import InsistentRequests
from fame.middleware.interface import (
    SIGNAL,
    AnyMessage,
    EndpointWarning,
    PendingRequests,
    QoS,
    TopicInfo,
    deliver_response,
    resolve,
)
from fame.middleware.qos import compatible

from .processes import Process

LEASE = 10.0
_MESSAGE = Kind.MESSAGE
_ALL = QoS(history="keep_all")
_REPEATED = "/bpmn_"
"""In the names of topics whose senders repeat what is not answered: deployments, reports, requests of people, and
acknowledged signals with their answers."""


class Fabric:
    """The network. `struck` counts what it did to messages and matches."""

    def __init__(self, scheduler: Scheduler, seed: int) -> None:
        self.scheduler, self.seed = scheduler, seed
        self.wires: list[Wire] = []
        self.links: dict[tuple[str, str], Link] = {}
        self.cuts: Counter[frozenset[str]] = Counter()  # of machines
        self.mute: Counter[str] = Counter()  # machines that hear, and are not heard
        self.delay, self.loss = 0.002, 0.0  # s at most, probability
        self.unheard: set[str] = set()  # processes whose request was lost, though they know its server
        self.twice = 0.0  # probability that a goal, or a message of a protocol which repeats itself, arrives again
        self.struck: Counter[str] = Counter()
        self.published: dict[str, list[tuple[float, str, AnyMessage]]] = {}  # topic -> (s, process, message)
        self.on_published: dict[
            str, Callable[[str, str], object]
        ] = {}  # by topic or service; gets that, and the process

    def join(self, process: Process) -> Wire:
        """The middleware of a new process."""
        wire = Wire(self, process)
        for other in self.wires:
            for pair in ((wire, other), (other, wire)):
                self.links[pair[0].id, pair[1].id] = Link(self, *pair)
        self.wires.append(wire)
        for other in self.wires[:-1]:
            self.links[wire.id, other.id].begin()
            self.links[other.id, wire.id].begin()
        return wire

    def note_published(self, end: End, message: AnyMessage) -> None:
        """A message, or the request of a service, leaves."""
        self.published.setdefault(end.topic, []).append((self.scheduler.now / SECOND, end.wire.id, message))
        if end.topic in self.on_published:
            self.on_published[end.topic](end.topic, end.wire.id)

    def leave(self, wire: Wire) -> None:
        """A process is killed: the others notice after the lease."""
        wire.process.kill()
        self.check()

    def cut(self, one: str, other: str, *, heal: bool = False) -> None:
        """Cut the link between two machines, or mend it."""
        pair = frozenset((one, other))
        self.cuts[pair] = max(0, self.cuts[pair] - 1) if heal else self.cuts[pair] + 1
        self.check()

    def silence(self, machine: str, by: int = 1) -> None:
        """Nothing that a machine sends arrives, until that is taken back (-1)."""
        self.mute[machine] = max(0, self.mute[machine] + by)
        self.check()

    def check(self) -> None:
        """Look at every link: processes, stops or cuts have changed."""
        for link in list(self.links.values()):
            link.check()

    @property
    def is_forgetting(self) -> bool:
        """Whether a living process still knows endpoints of one that is away."""
        silent = [link for link in self.links.values() if link.known and not link.open and link.target.process.alive]
        return any(link.target.knows(link.source) for link in silent)

    def remove(self, wire: Wire) -> None:
        """Forget a dead process that nobody knows any more."""
        if wire in self.wires and not any(
            link.known for (_, end), link in self.links.items() if link.source is wire or end == wire.id
        ):
            self.wires.remove(wire)
            self.links = {pair: link for pair, link in self.links.items() if wire.id not in pair}


class Link:
    """The way from one process to another. `known`: the target knows the source's endpoints."""

    def __init__(self, fabric: Fabric, source: Wire, target: Wire) -> None:
        self.fabric, self.source, self.target = fabric, source, target
        self.random = random.Random(f"{fabric.seed} {source.id} {target.id}")
        self._chance = self.random.random
        self.known = self.open = False
        self._lost_at: int | None = None
        self._waiting: dict[Any, deque[Callable[[], object]]] = {}  # by stream
        self._finding = False

    @property
    def is_up(self) -> bool:
        """Whether messages pass."""
        one, other = self.source.process, self.target.process
        machines = frozenset((one.machine.name, other.machine.name))
        cut = self.fabric.cuts[machines] or self.fabric.mute[one.machine.name]
        return one.alive and other.alive and not (one.stopped or other.stopped or cut)

    def begin(self) -> None:
        """Discover, as soon as the link is up."""
        self.open = self.is_up
        self._lost_at = None if self.open else self.fabric.scheduler.now
        if self.open:
            self._find()

    def check(self) -> None:
        """The link may have gone up or down."""
        up, now = self.is_up, self.fabric.scheduler.now
        if up and not self.open:
            self.open, self._lost_at = True, None
            if self.known:
                self._release()
            else:
                self._find()
        elif not up and self.open:
            self.open, self._lost_at = False, now
            self.fabric.scheduler.after(round(LEASE * SECOND), partial(self._expire, now), Kind.MESSAGE)

    def _find(self) -> None:
        if not self._finding:
            self._finding = True
            delay = round(self.random.uniform(0.01, 0.3) * SECOND)
            self.fabric.scheduler.after(delay, self._found, Kind.MESSAGE)

    def _found(self) -> None:
        self._finding = False
        if self.open and not self.known:
            self.known = True
            for end in list(self.source.ends()):
                self.target.discover(end)
            self._release()  # what was announced before the link went down and up

    def _expire(self, since: int) -> None:
        if self._lost_at == since and not self.open:
            self.forget()

    def forget(self) -> None:
        """The target forgets the source, and the source's messages for it are lost."""
        if self.known:
            self.known = False
            self.fabric.struck["lease"] += 1
        back = self.fabric.links.get((self.target.id, self.source.id))
        requests = [one for one in self._waiting if isinstance(one, tuple) and isinstance(one[0], Client)]
        if requests and back is not None and back.open:
            self.fabric.unheard.add(self.source.id)
        lost = sum(map(len, self._waiting.values()))
        self.fabric.struck["lost with the lease"] += lost
        self._waiting.clear()
        self.target.forget(self.source)
        for wire in (self.source, self.target):
            if not wire.process.alive:
                self.fabric.remove(wire)

    def announce(self, action: Callable[[], object]) -> None:
        """Pass on news about an endpoint, if the target knows the source (it hears of it with the rest otherwise)."""
        if self.known or self._finding:
            self.send(self, _ALL, action)

    def send(self, stream: Any, qos: QoS, action: Callable[[], object]) -> None:
        """Have `action` done at the target, in the order of what was sent on the stream, unless it is lost."""
        if qos.reliability != "reliable":
            self._send_once(action)
            return
        waiting = self._waiting.get(stream)
        if waiting is None:
            waiting = self._waiting[stream] = deque()
        if not self.open and qos.history != "keep_all" and len(waiting) >= qos.depth:
            waiting.popleft()
            self.fabric.struck["pushed out"] += 1
        waiting.append(action)
        if self.open:
            self._schedule(stream)

    def twice(self, action: Callable[[], object]) -> None:
        """A message arrives, and perhaps once more up to 3 s later: what acknowledges it was lost."""
        action()
        if self._chance() < self.fabric.twice:
            delay = round(self.random.uniform(0.0, 3.0) * SECOND)
            self.fabric.scheduler.after(delay, partial(self._again, action), _MESSAGE)

    def _again(self, action: Callable[[], object]) -> None:
        if self.open:
            self.fabric.struck["arrived twice"] += 1
            action()

    def _send_once(self, action: Callable[[], object]) -> None:
        fabric = self.fabric
        if not self.open or (fabric.loss and self.random.random() < fabric.loss):
            fabric.struck["lost best effort"] += 1
            return
        delay = round(self.random.uniform(0.0001, fabric.delay) * SECOND)
        fabric.scheduler.after(delay, lambda: action() if self.open else None, Kind.MESSAGE)

    def _schedule(self, stream: Any) -> None:
        """The next message of a stream arrives in a moment, later if it has to be sent again."""
        fabric = self.fabric
        delay = 0.0001 + (fabric.delay - 0.0001) * self._chance()
        while fabric.loss and self._chance() < fabric.loss:
            fabric.struck["sent again"] += 1
            delay += 0.1
        scheduler = fabric.scheduler
        scheduler.at(scheduler.now + round(delay * SECOND), partial(self._arrive, stream), _MESSAGE)

    def _arrive(self, stream: Any) -> None:
        """The oldest message of a stream; one that does not pass stays until the link is up again."""
        waiting = self._waiting.get(stream)
        if self.open and waiting:
            waiting.popleft()()
            if not waiting:
                self._waiting.pop(stream, None)

    def _release(self) -> None:
        for stream, waiting in list(self._waiting.items()):
            for _ in waiting:
                self._schedule(stream)


class Wire:
    """The middleware of one process: see `fame.middleware.interface.Middleware`."""

    confined, use_sim_time = True, False

    def __init__(self, fabric: Fabric, process: Process) -> None:
        self.fabric, self.process, self.scheduler = fabric, process, process
        self.id = process.name
        self.warnings: list[EndpointWarning] = []
        self.nodes: list[WireNode] = []
        self.known: dict[End, None] = {}  # endpoints of other processes
        self._on: dict[str, dict[End, None]] = {}  # topic -> all endpoints, own ones and known ones
        self._own: dict[str, dict[End, None]] = {}
        self._infos: dict[str, TopicInfo] = {}  # as they were when the graph was asked for
        self._changed: set[str] = set()  # topics since then
        self._graph: Sequence[TopicInfo] = []

    def node(self, name: str, namespace: str = "", part: str = "") -> WireNode:
        node = WireNode(self, name, namespace.strip("/"))
        self.nodes.append(node)
        return node

    def ends(self) -> list[End]:
        """The endpoints of this process."""
        return [end for node in self.nodes for end in node.ends]

    def on(self, topic: str) -> list[End]:
        """The endpoints of a topic or service that this process has or knows."""
        return list(self._on.get(topic, ()))

    def own(self, topic: str) -> list[End]:
        """Those that it has."""
        return list(self._own.get(topic, ()))

    def add(self, end: End) -> None:
        """An endpoint is there from now on."""
        self._on.setdefault(end.topic, {})[end] = None
        if end.wire is self:
            self._own.setdefault(end.topic, {})[end] = None
        self._changed.add(end.topic)

    def remove(self, end: End) -> None:
        """It is not there any more."""
        del self._on[end.topic][end]
        if end.wire is self:
            del self._own[end.topic][end]
        self._changed.add(end.topic)

    def warn(self, warning: EndpointWarning) -> None:
        if warning not in self.warnings:
            self.warnings.append(warning)

    def losses(self) -> list[str]:
        return []

    def connecting(self, node: Any) -> Sequence[str]:
        return []

    def graph(self) -> Sequence[TopicInfo]:
        if self._changed:
            self._infos |= {topic: self._info(topic) for topic in self._changed}
            self._changed.clear()
            self._graph = [info for _, info in sorted(self._infos.items()) if info.publishers or info.subscribers]
        return self._graph

    def _info(self, topic: str) -> TopicInfo:
        ends = self._on[topic]
        publishers = tuple(end.node.full_name for end in ends if end.role == "publisher")
        subscribers = tuple(end.node.full_name for end in ends if end.role == "subscription")
        return TopicInfo(topic, tuple(end.type for end in ends)[:1], publishers, subscribers)

    def namespaces(self) -> list[str]:
        return sorted({end.node.namespace for end in (*self.ends(), *self.known)} - {""})

    def close(self) -> None:
        for node in list(self.nodes):
            node.close()

    def others(self) -> list[Wire]:
        """The wires of other living processes."""
        return [wire for wire in self.fabric.wires if wire is not self and wire.process.alive]

    def tell(self, end: End, *, gone: bool = False) -> None:
        """Tell the other processes of a new endpoint, or one that was closed."""
        for other in self.others():
            action = partial(other.lose if gone else other.discover, end)
            self.fabric.links[self.id, other.id].announce(action)

    def discover(self, end: End) -> None:
        """An endpoint of another process is known from now on."""
        if not end.open or end in self.known or not self.process.alive:
            return
        self.known[end] = None
        self.add(end)
        for own in self.own(end.topic):
            own.meet(end)

    def lose(self, end: End) -> None:
        """An endpoint of another process is gone."""
        if self.known.pop(end, self) is None:
            self.remove(end)
            for own in self.own(end.topic):
                own.part(end)

    def knows(self, source: Wire) -> bool:
        """Whether it knows endpoints of another process."""
        return any(end.wire is source for end in self.known)

    def forget(self, source: Wire) -> None:
        """Nothing was received from another process for too long."""
        for end in [end for end in self.known if end.wire is source]:
            self.lose(end)


class WireNode:
    """A node: see `fame.middleware.interface.Node`."""

    def __init__(self, middleware: Wire, name: str, namespace: str) -> None:
        self.middleware, self.name, self.namespace = middleware, name, namespace
        self.full_name = resolve(name, namespace)
        self.ends: list[End] = []

    def publisher(self, topic: str, type: str, qos: QoS = SIGNAL) -> Publisher:
        return self._add(Publisher(self, topic, type, qos))

    def subscription(
        self, topic: str, type: str, callback: Callable[[AnyMessage], object], qos: QoS = SIGNAL
    ) -> Subscription:
        return self._add(Subscription(self, topic, type, qos, callback))

    def service(self, name: str, type: str, handler: Callable[[AnyMessage], Any]) -> Service:
        return self._add(Service(self, name, type, handler))

    def client(self, name: str, type: str) -> Client:
        return self._add(Client(self, name, type))

    def _add(self, end: Any) -> Any:
        wire = self.middleware
        for other in wire.on(end.topic):
            if other.node is not self:
                end.meet(other)
                if other.wire is wire:
                    other.meet(end)
        self.ends.append(end)
        wire.add(end)
        wire.tell(end)
        return end

    def close(self) -> None:
        for end in list(self.ends):
            end.close()
        if self in self.middleware.nodes:
            self.middleware.nodes.remove(self)


class End:
    """An endpoint."""

    role = ""

    def __init__(self, node: WireNode, topic: str, type: str, qos: QoS) -> None:
        self.node, self.topic, self.type, self.qos = node, resolve(topic, node.namespace), type, qos
        self.open, self.wire = True, node.middleware

    def meet(self, other: End) -> None:
        """Another endpoint is known."""

    def part(self, other: End) -> None:
        """Another endpoint is gone."""

    def link(self, other: End) -> Link | None:
        """The way to another endpoint; None within a process."""
        return self.wire.fabric.links.get((self.wire.id, other.wire.id))

    def close(self) -> None:
        if self.open:
            self.open = False
            self.node.ends.remove(self)
            wire = self.wire
            wire.remove(self)
            for own in wire.own(self.topic):
                own.part(self)
            wire.tell(self, gone=True)


class Publisher(End):
    role = "publisher"

    def __init__(self, node: WireNode, topic: str, type: str, qos: QoS) -> None:
        super().__init__(node, topic, messages.message_type(type).__msgtype__, qos)
        self._class = messages.message_type(type)
        self.matched: dict[Subscription, None] = {}
        self._processes: dict[Wire, list[Subscription]] = {}  # `matched` by process, until it changes
        kept = qos.durability == "transient_local"
        self._kept: deque[AnyMessage] = deque(maxlen=qos.depth if kept else 0)

    def publish(self, message: AnyMessage) -> None:
        if message.__class__ is not self._class or not self.open:
            raise publish_error(self.topic, self.type, message, closed=not self.open)
        self._kept.append(message)
        self.wire.fabric.note_published(self, message)
        if self.matched and not self._processes:
            for subscription in self.matched:
                self._processes.setdefault(subscription.wire, []).append(subscription)
        for there, subscriptions in self._processes.items():
            self._send(there, subscriptions, message)

    def _send(self, there: Wire, subscriptions: Sequence[Subscription], message: AnyMessage) -> None:
        """Send a message to a process: all its subscriptions get it at once."""
        if there is self.wire:
            for subscription in subscriptions:
                subscription.enqueue(message)
        elif link := self.wire.fabric.links.get((self.wire.id, there.id)):
            action = partial(self._arrive, tuple(subscriptions), message)
            repeats = self.wire.fabric.twice and _REPEATED in self.topic
            link.send((self, there), self.qos, partial(link.twice, action) if repeats else action)

    def _arrive(self, subscriptions: Sequence[Subscription], message: AnyMessage) -> None:
        for subscription in subscriptions:
            subscription.arrive(self, message)

    def subscriber_count(self) -> int:
        return len(self.matched)

    def meet(self, other: End) -> None:
        if isinstance(other, Subscription) and other.topic == self.topic and other not in self.matched:
            if (
                other.type != self.type
                or compatible(self.qos, other.qos) is not None
                or (self.qos.acknowledged and other.qos.acknowledged)
            ):
                return
            self.matched[other] = None
            self._processes.clear()
            if other.qos.durability == "transient_local":
                for message in self._kept:
                    self._send(other.wire, [other], message)

    def part(self, other: End) -> None:
        self.matched.pop(other, None)  # type: ignore[call-overload]
        self._processes.clear()


class Subscription(End):
    role = "subscription"

    def __init__(
        self, node: WireNode, topic: str, type: str, qos: QoS, callback: Callable[[AnyMessage], object]
    ) -> None:
        super().__init__(node, topic, messages.message_type(type).__msgtype__, qos)
        self.max_size, self.on_dropped = 1 << 62, node.middleware.warn
        self._callback = callback
        self._queue: deque[AnyMessage] = deque(maxlen=None if qos.history == "keep_all" else qos.depth)
        self._early: dict[End, list[AnyMessage]] = {}

    def arrive(self, publisher: Publisher, message: AnyMessage) -> None:
        """A message from another process: one of a publisher that is not known yet waits for its discovery."""
        if publisher in self.wire.known:
            self.enqueue(message)
        elif self.open and self.qos.reliability == "reliable":
            self._early.setdefault(publisher, []).append(message)

    def meet(self, other: End) -> None:
        for message in self._early.pop(other, ()):
            self.enqueue(message)

    def enqueue(self, message: AnyMessage) -> None:
        """Queue a message; a full queue loses its oldest."""
        if self.open:
            if len(self._queue) == self._queue.maxlen:
                self.wire.fabric.struck["queue overflow"] += 1
            else:
                self.wire.process.soon(self._deliver)
            self._queue.append(message)

    def _deliver(self) -> None:
        if self.open and self._queue:
            self._callback(self._queue.popleft())


class Service(End):
    role = "service"

    def __init__(self, node: WireNode, name: str, type: str, handler: Callable[[AnyMessage], Any]) -> None:
        super().__init__(node, name, type, SIGNAL)
        self.name, self.handler = self.topic, handler
        self.request_type, self.response_type = messages.service(type)


class Client(End):
    role = "client"
    mismatch = ""

    def __init__(self, node: WireNode, name: str, type: str) -> None:
        super().__init__(node, name, type, SIGNAL)
        self.name = self.topic
        self.request_type, self.response_type = messages.service(type)
        self._requests, self._number = PendingRequests(), 0
        self._insistent = InsistentRequests(self, node.middleware.process)

    def insist(self, request: Any, callback: Callable[[AnyMessage], object]) -> None:
        self._insistent.add(request, frozenset(self._servers()), callback)

    def _servers(self) -> list[Service]:
        ends = self.wire.on(self.topic)
        return [end for end in ends if isinstance(end, Service) and end.type == self.type]

    @property
    def available(self) -> bool:
        return bool(self._servers())

    def meet(self, other: End) -> None:
        self.wire.process.soon(self._look)

    part = meet

    def _look(self) -> None:
        if self.open:
            servers = frozenset(self._servers())
            self._requests.servers_changed(servers)
            self._insistent.on_servers_changed(servers)

    def close(self) -> None:
        self._insistent.clear()
        super().close()

    def call(
        self,
        request: Any,
        callback: Callable[[AnyMessage], object],
        lost: Callable[[], object] | None = None,
        *,
        or_new: bool = False,
    ) -> None:
        servers = self._servers()
        if not servers:
            raise unavailable_error(self.name, self.request_type, ())
        message = messages.create(self.request_type, request)
        self._number += 1
        self.wire.fabric.note_published(self, message)
        self._requests.add(self._number, servers, callback, lost, or_new)
        for server in servers:  # as on DDS: the first response counts
            twice = self.wire.fabric.twice * self.topic.endswith("send_goal")
            for _ in range(2 if twice and server.wire.process.machine.busy.random() < twice else 1):
                self._way(self, server, partial(self._handle, server, message, self._number))

    def _handle(self, server: Service, request: AnyMessage, number: int) -> None:
        def respond(response: Any) -> None:
            answer = messages.create(server.response_type, response)
            again = server.wire.process.machine.busy.random() < self.wire.fabric.twice
            for _ in range(1 + again):
                self._way(server, self, lambda: self._requests.respond(number, answer) if self.open else None)
            self.wire.fabric.struck["answered twice"] += again

        if server.open:
            deliver_response(server.handler(request), respond)

    def _way(self, sender: End, receiver: End, action: Callable[[], object]) -> None:
        process = receiver.wire.process
        link = sender.link(receiver)
        if link is None:
            process.soon(action)
        else:
            link.send((sender, receiver), SIGNAL, lambda: process.soon(action))
