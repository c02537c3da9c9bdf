"""The backend: nodes in one session of Zenoh, and the graph of all nodes and endpoints of the domain.

Nodes are made and used in the thread of the scheduler (or before it runs). Zenoh calls back in threads of its own:
these put messages into the queue of their subscription, and enter all else in the scheduler. Tokens wait in Zenoh until
somebody asks what is there, or for `_LOOK` at most: of a hundred engines that start at once, each gets thousands.

Zenoh connects whatever has the same key expression. That endpoints whose quality of service does not match are not
connected, as over DDS, is up to the subscription: it knows the publisher of each message from the graph.

One of a `crowd` does not learn of all endpoints, which would cost a hundred of them the square of their number, but of
all nodes, of what is in the namespaces of its own nodes, and of the topics and services that it asks for or has an
endpoint on. Only who asks for the whole `graph` learns of the rest.
"""

from __future__ import annotations

import atexit
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from fnmatch import fnmatchcase
from functools import partial
from itertools import count, islice
from typing import Any, ClassVar

import zenoh

from fame.clock import SECOND, WallScheduler
from fame.errors import ConfigError
from fame.middleware.data_scheduler import DataScheduler
from fame.middleware.errors import mismatch_warning
from fame.middleware.interface import UNKNOWN_NODE, EndpointWarning, TopicInfo
from fame.middleware.qos import mismatch
from fame.middleware.wire_base import EndpointClasses, WireMiddleware, WireNode, domain_id
from fame.middleware.zenoh import tokens
from fame.middleware.zenoh.endpoints import ZenohClient, ZenohPublisher, ZenohService, ZenohSubscription
from fame.middleware.zenoh.session import open_session, take_over
from fame.middleware.zenoh.tokens import Entity, EntityKind

_LOOK = SECOND // 10
"""Interval at which a process looks who has come and left (ns)."""
_AT_ONCE = 1000
"""How many tokens are taken before anything else is done."""
_MAX_ENTITIES = 100_000
"""How many nodes and endpoints the graph holds: a flood of tokens must not fill the memory."""
_TAKE_OVER = SECOND
"""Interval at which a process checks whether the process that all connect to has ended (ns)."""
_FLUSH_PATIENCE = 4.0
"""How long another process may take to confirm what it has (s)."""
_ANSWER_PATIENCE = 2.0
"""How long the router may take to say who is there (s)."""
_ANY = "*"
"""Any kind of token."""


class Graph:
    """The nodes and endpoints of a domain, by token. Any thread may use it.

    `update` brings it up to date before it says who is there.
    """

    def __init__(self, update: Callable[[], object]) -> None:
        self._update = update
        self._lock = threading.RLock()
        self._entities: dict[str, Entity] = {}
        self._names: dict[tuple[str, EntityKind], dict[str, Entity]] = {}
        self._publishers: dict[bytes, Entity] = {}
        self._topics: list[TopicInfo] | None = None
        self._nodes: list[str] | None = None

    def add(self, entity: Entity) -> bool:
        """Add a node or an endpoint. Returns whether it was new, and there was room for it."""
        with self._lock:
            if entity.token in self._entities or len(self._entities) >= _MAX_ENTITIES:
                return False
            self._entities[entity.token] = entity
            self._topics = self._nodes = None
            self._names.setdefault((entity.name, entity.kind), {})[entity.token] = entity
            if entity.kind == tokens.PUBLISHER:
                self._publishers[entity.gid] = entity
            return True

    @property
    def full(self) -> bool:
        return len(self._entities) >= _MAX_ENTITIES

    def remove(self, token: str) -> Entity | None:
        with self._lock:
            entity = self._entities.pop(token, None)
            if entity is not None:
                self._topics = self._nodes = None
                named = self._names[entity.name, entity.kind]
                del named[token]
                if not named:
                    del self._names[entity.name, entity.kind]
                self._publishers.pop(entity.gid, None)
            return entity

    def all(self) -> list[Entity]:
        """Return all nodes and endpoints, in the order in which they came."""
        self._update()
        with self._lock:
            return list(self._entities.values())

    def topics(self) -> list[TopicInfo]:
        """Return all topics, in the order of names; the same list until something changes."""
        self._update()
        with self._lock:
            if self._topics is None:
                ends: dict[str, list[Entity]] = {}
                for entity in self._entities.values():
                    if entity.kind in (tokens.PUBLISHER, tokens.SUBSCRIPTION):
                        ends.setdefault(entity.name, []).append(entity)
                self._topics = [_info(name, ends[name]) for name in sorted(ends)]
            return self._topics

    def nodes(self) -> list[str]:
        """Return the names of all nodes, in order; the same list until something changes."""
        self._update()
        with self._lock:
            if self._nodes is None:
                self._nodes = sorted(each.node for each in self._entities.values() if each.kind == tokens.NODE)
            return self._nodes

    def named(self, name: str, kind: EntityKind) -> list[Entity]:
        """Return the endpoints of a topic or service (full name) of one kind."""
        self._update()
        with self._lock:
            return list(self._names.get((name, kind), {}).values())

    def publisher(self, gid: bytes) -> Entity | None:
        if gid not in self._publishers:
            self._update()
        return self._publishers.get(gid)


class Wakeups:
    """The waiter of a `DataScheduler`: subscriptions with samples, which the scheduler takes in its own thread.

    To release a lock is far faster than to notify a condition. (`SimpleQueue.get` of CPython 3.11 is as fast, but can
    forget its timeout on a busy machine, and wait forever.)
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._lock.acquire()
        self._ready: deque[Callable[[], object]] = deque()

    def wait(self, timeout: int) -> None:
        if not self._ready:
            if timeout:
                self._lock.acquire(timeout=timeout / SECOND)
            else:
                self._lock.acquire(blocking=False)
        for _ in range(len(self._ready)):
            self._ready.popleft()()

    def add(self, action: Callable[[], object]) -> None:
        """Call `action` in the thread that waits; from any thread."""
        self._ready.append(action)
        self.wake()

    def wake(self) -> None:
        if self._lock.locked():
            with suppress(RuntimeError):  # another thread was faster
                self._lock.release()


class ZenohMiddleware(WireMiddleware):
    """Nodes on Zenoh. `warnings` are for the user; `on_warning` is called with each of them in the scheduler.

    `domain` None is ROS_DOMAIN_ID. `network` None keeps everything on loopback, without a router; else it names routers
    or a configuration file (`fame.middleware.zenoh.session`, where `crowd` is explained, too). Raises ConfigError.
    """

    use_sim_time: bool = False
    lockstep: bool = True
    nodes: list[ZenohNode]

    def __init__(
        self,
        scheduler: WallScheduler,
        *,
        domain: int | None = None,
        network: str | None = None,
        crowd: int = 0,
        on_warning: Callable[[EndpointWarning], object] | None = None,
    ) -> None:
        super().__init__(scheduler, network, on_warning)
        self.domain: int = domain_id(domain)
        self.confined: bool = network is None
        self.entities: Graph = Graph(self._take_tokens)
        self.receivers: dict[str, list[ZenohSubscription]] = {}  # by key, those of this session
        self._crowd = crowd
        self.session: Any = open_session(self.domain, network, crowd=crowd)
        self.id: str = str(self.session.zid())
        self._ids = count()
        self._barrier: Any = None
        self._meeting: Any = None  # a second session, where processes meet
        self._tokens: dict[tuple[str, str], Any] = {}  # subscribers, by what they `follow`
        self._asked: set[tuple[str, str]] = set()
        self._doubted: set[str] = set()  # services about which the router is being asked
        self._taking = threading.RLock()
        self._takes = False
        self.follow(tokens.NODE if crowd else _ANY)
        self._look()
        if network is None:
            scheduler.after(_TAKE_OVER, self._take_over)
        self.wakeups: Wakeups | None = None
        if isinstance(scheduler, DataScheduler) and scheduler.waiter is None:
            scheduler.waiter = self.wakeups = Wakeups()
        atexit.register(self.close)  # Zenoh's threads must not outlive the interpreter

    def node(self, name: str, namespace: str = "", part: str = "") -> ZenohNode:
        return ZenohNode(self, name, namespace.strip("/"), part)

    def graph(self) -> list[TopicInfo]:
        self.ask((_ANY, ""))
        return list(self.entities.topics())

    def known_topics(self, names: Iterable[str] = (), *, publishers: bool = False) -> Sequence[TopicInfo]:
        """See `fame.middleware.interface.known_topics`."""
        kind = tokens.PUBLISHER if publishers else _ANY
        self.ask(*((kind, name) for name in names))
        return self.entities.topics()

    def follow(self, kind: str = _ANY, name: str = "") -> None:
        """Learn from now on of what `tokens.pattern` describes.

        What leaves in the very milliseconds in which it is declared may stay known: a session of Zenoh 1.x keeps such
        tokens until it closes, although the router does not have them any more (4 to 12 of 150 trials at once). See
        `doubt`.
        """
        if not self._follows_all() and not any(
            fnmatchcase(kind, kinds) and fnmatchcase(name, names) for kinds, names in self._tokens
        ):
            waiting: Any = zenoh.handlers.FifoChannel(_MAX_ENTITIES)
            key = tokens.pattern(self.domain, kind, name)
            self._tokens[kind, name] = self.session.liveliness().declare_subscriber(key, waiting, history=True)

    def ask(self, *ends: tuple[str, str]) -> None:
        """Do so for kinds and names and, the first time, wait until what is there is known."""
        unknown = set(ends) - self._asked
        if not unknown or self._follows_all() or self.closed:
            return
        self._asked.update(unknown)
        for end in unknown:
            self.follow(*end)
        with self._taking:
            self._takes = True  # who leaves after the answer is removed after it
        try:
            keys = [tokens.pattern(self.domain, *end) for end in unknown]
            queries = [self.session.liveliness().get(key, timeout=_ANSWER_PATIENCE) for key in keys]
            for sample in (reply.ok for query in queries for reply in query):
                if sample is not None:
                    self._on_token(sample)
        finally:
            self._takes = False

    def doubt(self, service: str) -> None:
        """Forget those servers of a name that are gone, when a request has had no response (see `follow`).

        Queries of a session that keeps their tokens may say that they are there: a new one asks, in a thread (10 ms).
        """
        if service not in self._doubted:
            self._doubted.add(service)
            known = [end.token for end in self.entities.named(service, tokens.SERVICE) if end.session != self.id]
            threading.Thread(target=self._verify, args=(service, known), name="fame doubt", daemon=True).start()

    def _verify(self, service: str, known: list[str]) -> None:
        key = tokens.pattern(self.domain, tokens.SERVICE, service)
        try:
            with suppress(ConfigError, zenoh.ZError), open_session(self.domain, self.network, crowd=1) as session:
                replies = [reply.ok for reply in session.liveliness().get(key, timeout=_ANSWER_PATIENCE)]
                if None not in replies:  # else not all has been said in time
                    there = {str(sample.key_expr) for sample in replies if sample is not None}
                    self.scheduler.soon(partial(self._forget, [token for token in known if token not in there]))
        finally:
            self._doubted.discard(service)

    def _forget(self, gone: Iterable[str]) -> None:
        for token in gone:
            if (entity := self.entities.remove(token)) is not None:
                self._note_server(entity)

    def _follows_all(self) -> bool:
        return (_ANY, "") in self._tokens

    def namespaces(self) -> list[str]:
        return sorted({entity.namespace for entity in self.entities.all() if entity.namespace})

    def node_names(self) -> list[str]:
        return list(self.entities.nodes())

    def offers(self, service: str) -> list[tuple[str, str]]:
        self.ask((tokens.SERVICE, service))
        return [(entity.type, entity.node) for entity in self.entities.named(service, tokens.SERVICE)]

    def matching_subscriptions(self, publisher: ZenohPublisher) -> int:
        return len(publisher.connected())

    def next_id(self) -> int:
        """Return a number for a node or an endpoint of this session."""
        return next(self._ids)

    def declare(self, entity: Entity) -> Any:
        """Announce a node or an endpoint, until the token that is returned is withdrawn."""
        self.entities.add(entity)
        self._note_server(entity)
        return self.session.liveliness().declare_token(entity.token)

    def withdraw(self, entity: Entity, token: Any) -> None:
        """Undo `declare`."""
        self.entities.remove(entity.token)
        self._note_server(entity)
        token.undeclare()

    def _note_server(self, entity: Entity) -> None:
        """Tell the clients of a service, if a service is what has come or left."""
        if entity.kind == tokens.SERVICE:
            self.scheduler.soon(partial(self.on_servers_changed, (entity.name,)))

    def hold(self, holds: Callable[[WireNode], bool]) -> None:
        """Hold nodes, and confirm to the sessions that flush what has come from them."""
        super().hold(holds)
        if self._barrier is None:
            key = self._barrier_key(self.id)
            answer: Any = zenoh.handlers.Callback(lambda query: query.reply(key, b""), indirect=False)
            self._barrier = self.session.declare_queryable(key, answer, complete=True)

    def flush(self) -> None:
        """Wait until all confirming sessions have received what this one sent, at most `_FLUSH_PATIENCE` s.

        Messages of a link arrive in order.
        """
        for reply in self.session.get(
            self._barrier_key("*"),
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=_FLUSH_PATIENCE,
        ):
            if reply.err is not None:
                text = f"a process did not confirm within {_FLUSH_PATIENCE:g} s what it has received"
                self.warn(EndpointWarning("", text, "backend"))

    def release(self) -> None:
        atexit.unregister(self.close)
        if isinstance(self.scheduler, DataScheduler) and self.scheduler.waiter is self.wakeups:
            self.scheduler.waiter = None
        for session in filter(None, (self._meeting, self.session)):
            try:
                session.close()
            except zenoh.ZError as error:  # its threads end with the process
                self.warn(EndpointWarning("", f"Zenoh: {error}", "backend"))

    def _take_over(self) -> None:
        """Listen where processes of the domain meet, if the one that did has ended."""
        if not self.closed:
            self._meeting = self._meeting or take_over(self.domain, self._crowd)
            self.scheduler.after(_TAKE_OVER, self._take_over)

    def report_mismatches(self, entity: Entity) -> None:
        """Warn of the endpoints of other nodes that an endpoint is not connected to, if one of the two is ours."""
        other_kind = tokens.SUBSCRIPTION if entity.kind == tokens.PUBLISHER else tokens.PUBLISHER
        for other in self.entities.named(entity.name, other_kind):
            writer, reader = (entity, other) if entity.kind == tokens.PUBLISHER else (other, entity)
            if self.id in (entity.session, other.session) and entity.owner != other.owner:
                reason = mismatch(writer, reader)
                if reason is not None:
                    self.warn(mismatch_warning(entity.name, reader.node, writer.node, reason))

    def _barrier_key(self, session: str) -> str:
        return f"fame_lockstep/{self.domain}/{session}"

    def _look(self) -> None:
        if not self.closed:
            self._take_tokens()
            self.scheduler.after(_LOOK, self._look)

    def _take_tokens(self) -> None:
        """Take the tokens that have come since the last time, in any thread; of a flood, some."""
        with self._taking:
            if self._takes or self.closed:
                return  # to take one asks for others
            self._takes = True
            try:
                for subscriber in list(self._tokens.values()):
                    for sample in islice(iter(subscriber.try_recv, None), _AT_ONCE):
                        self._on_token(sample)
            finally:
                self._takes = False

    def _on_token(self, sample: zenoh.Sample) -> None:
        """Note who has come or left. The tokens of this session are in the graph already."""
        token = str(sample.key_expr)
        if sample.kind == zenoh.SampleKind.DELETE:
            self._forget([token])
            return
        entity = tokens.read_token(token)
        if entity is None or entity.session == self.id:
            return
        if not self.entities.add(entity):
            if self.entities.full:
                text = f"there are more than {_MAX_ENTITIES} nodes and endpoints: the others are not known"
                self.warn(EndpointWarning("", text, "backend"))
            return
        if entity.kind in (tokens.PUBLISHER, tokens.SUBSCRIPTION):
            self.report_mismatches(entity)
        self._note_server(entity)


class ZenohNode(WireNode):
    middleware: ZenohMiddleware
    publishers: list[ZenohPublisher]
    subscriptions: list[ZenohSubscription]
    services: list[ZenohService | ZenohClient]
    entity: Entity
    endpoint_classes: ClassVar[EndpointClasses] = EndpointClasses(
        ZenohPublisher, ZenohSubscription, ZenohService, ZenohClient
    )

    def __init__(self, middleware: ZenohMiddleware, name: str, namespace: str, part: str) -> None:
        super().__init__(middleware, name, namespace, part)
        if namespace:
            middleware.follow(name=f"/{namespace}/*")
        others = self.others()
        if others:
            self.entity, self._token = others[0].entity, others[0]._token
        else:
            token = tokens.node_token(middleware.domain, middleware.id, middleware.next_id(), namespace, name)
            self.entity = tokens.entity(token)
            self._token = middleware.declare(self.entity)

    def close(self) -> None:
        """Close all endpoints. Does nothing the second time."""
        if self in self.middleware.nodes:
            last = not self.others()
            super().close()
            if last:
                self.middleware.withdraw(self.entity, self._token)

    def owns(self, entity: Entity) -> bool:
        """Return whether an endpoint is one of this part of the node."""
        if entity.session != self.entity.session:
            return False
        tokens_of_it = {end.token for end in self.publishers} | {end.token for end in self.subscriptions}
        return entity.token in tokens_of_it


def _info(name: str, entities: list[Entity]) -> TopicInfo:
    def nodes(kind: EntityKind) -> Iterator[str]:
        return (entity.node or UNKNOWN_NODE for entity in entities if entity.kind == kind)

    types = tuple(sorted({entity.type for entity in entities}))
    offered = tuple(entity.qos for entity in entities if entity.kind == tokens.PUBLISHER)
    return TopicInfo(name, types, tuple(nodes(tokens.PUBLISHER)), tuple(nodes(tokens.SUBSCRIPTION)), offered)
