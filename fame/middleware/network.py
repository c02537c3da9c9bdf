"""A model of the network between robots, for the local backend: delay, loss, reordering, partitions; seeded.

It applies to messages, requests and responses between nodes of two robots (namespaces), not to those between nodes of
one robot, or of nodes without a namespace, such as the world. Each direction of two endpoints has its own random
generator, so that adding a robot changes nothing for the others.

Quality of service has the same effect as on the wire. Best effort loses a message; reliable sends it again `RETRANSMIT`
s later, until it arrives, in order. A partition of at most the lease (10 s, as in DDS) delays reliable messages until
its end: the newest `depth` of them. A longer one ends the match: messages of volatile publishers are lost meanwhile,
and transient local publishers send their last messages again at its end.
"""

from __future__ import annotations

import random
from bisect import insort
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Literal

from fame.clock import SECOND, Kind, Scheduler
from fame.dataclasses import dataclass
from fame.errors import ConfigError
from fame.middleware.interface import AnyMessage, QoS

if TYPE_CHECKING:
    from fame.middleware.local import LocalPublisher, LocalSubscription

LEASE = 10.0
"""Time that two participants stay matched without receiving anything from each other (s): the default of DDS."""
RETRANSMIT = 0.1
"""Time until a lost message is noticed and sent again (s)."""
_DEPTH = 1_000_000
_Pair = tuple[str, str]


@dataclass(frozen=True, slots=True)
class Delay:
    """A distribution of delays (s).

    ``fixed`` (first), ``uniform`` (from first to second), ``normal`` (mean, deviation; not below 0), ``exponential``
    (mean).
    """

    kind: Literal["fixed", "uniform", "normal", "exponential"] = "fixed"
    first: float = 0.0
    second: float = 0.0

    def sample(self, generator: random.Random) -> float:
        """Return one delay (s)."""
        match self.kind:
            case "uniform":
                return generator.uniform(self.first, self.second)
            case "normal":
                return max(0.0, generator.gauss(self.first, self.second))
            case "exponential":
                return generator.expovariate(1 / self.first) if self.first > 0 else 0.0
        return self.first


@dataclass(frozen=True, slots=True)
class Link:
    """The link between two robots (`between`, both ways; empty: all) on a topic (full name; empty: all).

    delay    of each message
    loss     probability that a message is lost on its way
    reorder  probability that a best effort message is overtaken by the next ones
    """

    delay: Delay = Delay()
    loss: float = 0.0
    reorder: float = 0.0
    between: tuple[str, ...] = ()
    topic: str = ""

    def __post_init__(self) -> None:
        if not 0 <= self.loss < 1:
            raise ConfigError(f"loss: expected a probability below 1, got {self.loss!r}")

    def concerns(self, pair: _Pair, topic: str) -> bool:
        """Return whether it applies to a topic between two robots."""
        return (not self.between or set(self.between) == set(pair)) and self.topic in ("", topic)


@dataclass(frozen=True, slots=True)
class Partition:
    """Two robots cannot reach each other from `start` to `end` (simulated s)."""

    between: tuple[str, str]
    start: float
    end: float


@dataclass(frozen=True, slots=True)
class NetworkConfig:
    """The network of a scenario. The last link that applies to a message counts."""

    links: tuple[Link, ...] = ()
    partitions: tuple[Partition, ...] = ()
    lease: float = LEASE


class Network:
    """The network while a scenario runs. `lost` counts messages by (from, to, topic), `under_way` by (to, topic)."""

    config: NetworkConfig
    scheduler: Scheduler

    def __init__(self, config: NetworkConfig, seed: int, scheduler: Scheduler) -> None:
        self.config, self.scheduler = config, scheduler
        self.lost: Counter[tuple[str, str, str]] = Counter()
        self.under_way: Counter[tuple[str, str]] = Counter()
        self._seed = seed

    def partition(self, pair: _Pair, time: int) -> Partition | None:
        """Return the partition between two robots at a time (ns)."""
        for one in self.config.partitions:
            if set(one.between) == set(pair) and round(one.start * SECOND) <= time < round(one.end * SECOND):
                return one
        return None

    def is_matched(self, pair: _Pair) -> bool:
        """Return whether the endpoints of two robots are matched now: not in a partition after the lease."""
        cut = self.partition(pair, self.scheduler.now)
        return cut is None or self.scheduler.now / SECOND < cut.start + self.config.lease

    def match_changes(self, pair: _Pair) -> list[int]:
        """Return the times to come (ns) at which the endpoints of two robots become unmatched, or matched again."""
        lease, cuts = self.config.lease, self.config.partitions
        long = (cut for cut in cuts if set(cut.between) == set(pair) and cut.end - cut.start > lease)
        times = (round(time * SECOND) for cut in long for time in (cut.start + lease, cut.end))
        return [time for time in times if time > self.scheduler.now]

    def channel(self, sender: str, receiver: str, topic: str, qos: QoS) -> RobotChannel | None:
        """Return the channel from one robot to another for a topic or service; None if the network does not apply."""
        if not sender or not receiver or sender == receiver:
            return None
        rules = [link for link in self.config.links if link.concerns((sender, receiver), topic)]
        generator = random.Random(f"{self._seed} network {sender} {receiver} {topic}")
        return RobotChannel(self, (sender, receiver), topic, rules[-1] if rules else Link(), qos, generator)

    def losses(self) -> list[str]:
        """Lost messages, a line for each topic and direction."""
        return [
            f"the network lost {count} message{'s' if count > 1 else ''} on {topic} from {sender} to {receiver}"
            for (sender, receiver, topic), count in sorted(self.lost.items())
        ]


class RobotChannel:
    """The channel from one robot to another for one topic or service."""

    def __init__(
        self, network: Network, pair: _Pair, topic: str, link: Link, qos: QoS, generator: random.Random
    ) -> None:
        self._network, self._pair, self._topic, self._link = network, pair, topic, link
        self._random, self._scheduler = generator, network.scheduler
        self._reliable = qos.reliability == "reliable"
        self._latched = qos.durability == "transient_local"
        self._held: list[tuple[int, Callable[[], object]]] = []  # with their numbers, which are in order
        self._most = _DEPTH if qos.history == "keep_all" else qos.depth
        self._sent = 0
        self._last = 0  # when the latest message arrives (ns)

    def send(self, deliver: Callable[[], object]) -> None:
        """Send a message: `deliver` is called when it arrives, if it does."""
        self._sent += 1
        self._send(self._sent, deliver)

    def _send(self, number: int, deliver: Callable[[], object]) -> None:
        now = self._scheduler.now
        self._network.under_way[self._pair[1], self._topic] += 1
        if self._cut(now, number, deliver):
            return
        delay = self._link.delay.sample(self._random)
        while self._link.loss and self._random.random() < self._link.loss:
            if not self._reliable:
                self._lose()
                return
            delay += RETRANSMIT
        arrival = now + round(delay * SECOND)
        if not self._reliable and self._link.reorder and self._random.random() < self._link.reorder:
            arrival += round((self._random.uniform(0, 2) * delay + RETRANSMIT) * SECOND)
        else:
            arrival = self._last = max(arrival, self._last)
        self._scheduler.at(arrival, partial(self._arrive, number, deliver), Kind.MESSAGE)

    def _arrive(self, number: int, deliver: Callable[[], object]) -> None:
        """Deliver a message, unless a partition began while it was on its way."""
        if not self._cut(self._scheduler.now, number, deliver):
            self._network.under_way[self._pair[1], self._topic] -= 1
            deliver()

    def _cut(self, now: int, number: int, deliver: Callable[[], object]) -> bool:
        """Whether a partition blocks the channel: then the message is delayed or lost."""
        cut = self._network.partition(self._pair, now)
        if cut is None:
            return False
        long = cut.end - cut.start > self._network.config.lease
        if not self._reliable or (long and not self._latched):
            self._lose()
            return True
        if not self._held:
            self._scheduler.at(round(cut.end * SECOND), self._release, Kind.MESSAGE)
        insort(self._held, (number, deliver))  # one that was under way is older than those that are held
        if len(self._held) > self._most:
            del self._held[0]
            self._lose()
        return True

    def _release(self) -> None:
        """Send the delayed messages at the end of the partition."""
        held, self._held = self._held, []
        self._network.under_way[self._pair[1], self._topic] -= len(held)
        for number, deliver in held:
            self._send(number, deliver)

    def _lose(self) -> None:
        self._network.lost[*self._pair, self._topic] += 1
        self._network.under_way[self._pair[1], self._topic] -= 1


class NetworkedSubscription:
    """Replaces a matched subscription at the other end of the network."""

    subscription: LocalSubscription

    def __init__(self, subscription: LocalSubscription, channel: RobotChannel) -> None:
        self.subscription, self._channel = subscription, channel

    def enqueue(self, message: AnyMessage) -> None:
        """Send a message to it."""
        self._channel.send(partial(self._deliver, message))

    def _deliver(self, message: AnyMessage) -> None:
        if self.subscription.is_open:
            self.subscription.enqueue(message)


def matched_end(
    network: Network | None, publisher: LocalPublisher, subscription: LocalSubscription
) -> LocalSubscription | NetworkedSubscription:
    """Return the end that a publisher sends to for a matched subscription: itself, or one behind the network."""
    if network is None:
        return subscription
    sender, receiver = publisher.node.namespace, subscription.node.namespace
    channel = network.channel(sender, receiver, publisher.topic, publisher.qos)
    return subscription if channel is None else NetworkedSubscription(subscription, channel)


def names(config: NetworkConfig) -> Sequence[str]:
    """Return the robots that a network configuration names, each once."""
    pairs = (*(link.between for link in config.links), *(cut.between for cut in config.partitions))
    return list(dict.fromkeys(name for pair in pairs for name in pair))
