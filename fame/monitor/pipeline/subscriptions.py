"""What arrives: subscriptions made from a configuration, and the samples that can be used.

Each topic is subscribed once. A message gives one sample to every input of its topic, or to none: if any of them cannot
be read, is not finite, or the stamp is not later than the last, the whole message is left out, and the reason is
reported. So the inputs of one topic always have the same stamps. The stamp is that of the header, else the time of
arrival (s, of the scheduler).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from math import isfinite
from typing import Any

import numpy as np

from fame.clock import SECOND, Scheduler
from fame.errors import MessageError
from fame.middleware.interface import Middleware, Node
from fame.monitor.pipeline.configuration import Port
from fame.monitor.pipeline.fields import Read, Unusable, has_stamp, reader
from fame.monitor.pipeline.processor import Samples
from fame.monitor.silence import Reporter

SILENCE = 2.0
"""A topic without a message for so long (s) is silent."""

LATE = 1.0
"""A message is late if it took so much longer (s) than the quickest."""

DEVIATION = 0.2
"""How far the rate may be from that expected, as a part of it."""

_MOST = 200_000  # samples that wait, at most
_ENOUGH = 50  # samples from which a rate is told


@dataclass(slots=True)
class _Source:
    """One topic."""

    ports: list[Port]
    reads: list[Read]
    stamped: bool
    topic: str = ""
    stamps: list[float] = field(default_factory=list)
    values: list[list[Any]] = field(default_factory=list)
    names: list[tuple[str, ...]] = field(default_factory=list)
    shapes: list[tuple[int, ...] | None] = field(default_factory=list)
    last: float = -np.inf
    arrived: float | None = None
    quickest: float = np.inf
    begin: float = -np.inf
    count: int = 0
    counted: int = 0
    told: list[Any] = field(default_factory=list)


class Intake:
    """The subscriptions. `take` gives what has arrived since the last time."""

    def __init__(
        self,
        node: Node,
        scheduler: Scheduler,
        ports: Sequence[Port],
        say: Reporter,
        arrived: Callable[[Sequence[Port], float, Sequence[Any], Sequence[tuple[str, ...]]], object] | None = None,
    ) -> None:
        """`arrived`, if given, gets every sample at once, and nothing is kept for `take`."""
        self._scheduler, self._say, self._arrived = scheduler, say, arrived
        self._made = scheduler.now / SECOND
        self.sources: list[_Source] = []
        for topic in dict.fromkeys(port.topic for port in ports):
            of_it = [port for port in ports if port.topic == topic]
            source = _Source(of_it, [reader(port.type, port.path) for port in of_it], has_stamp(of_it[0].type))
            source.values, source.names = [[] for _ in of_it], [() for _ in of_it]
            source.shapes, source.told = [None for _ in of_it], [None for _ in of_it]
            heard = partial(self.heard, source)
            source.topic = node.subscription(topic, of_it[0].type, heard, of_it[0].qos).topic
            self.sources.append(source)

    def take(self) -> dict[str, Samples]:
        """Per input, by name, what arrived since the last call; none of an input is an array without rows."""
        taken = {}
        for source in self.sources:
            stamps, source.stamps = np.array(source.stamps), []
            for number, port in enumerate(source.ports):
                shape = source.shapes[number] or ()
                values = np.array(source.values[number], dtype=np.float64).reshape(len(stamps), *shape)
                source.values[number] = []
                taken[port.name] = Samples(values, stamps, source.names[number])
        return taken

    def watch(self, middleware: Middleware) -> None:
        """Report topics that are silent, and why if it can be told, and rates. To be called every second."""
        now = self._scheduler.now / SECOND
        for source in self.sources:
            self._rate(source)
            since = self._made if source.arrived is None else source.arrived
            if now - since > SILENCE and "silent " + source.topic not in self._say.counts:
                reason = "" if source.arrived is not None else _why(middleware, source)
                self._say("silent " + source.topic, f"{source.topic}: nothing for {SILENCE:g} s{reason}")

    def heard(self, source: _Source, message: Any) -> None:
        """A message came."""
        now = self._scheduler.now / SECOND
        topic, source.arrived = source.topic, now
        if self._say.counts:
            self._say.over("silent " + topic, f"{topic} goes on")
        stamp = now
        if source.stamped:
            time = message.header.stamp
            stamp = (time.sec + time.nanosec * 1e-9) or now
        if not stamp > source.last:
            what = "a second sample" if stamp == source.last else f"a sample {source.last - stamp:.3g} s older"
            self._say(f"order {topic}", f"{topic}: left out: {what} of stamp {stamp:.3f} s after {source.last:.3f} s")
            return
        try:
            values = self._read(source, message)
        except Unusable as reason:
            self._say(f"unusable {topic} {reason}", f"{topic}: a message is left out: {reason}")
            return
        source.last = stamp
        source.count += 1
        delay = now - stamp
        if delay < source.quickest:
            source.quickest = delay
        elif delay - source.quickest > LATE:
            text = f"{topic}: late: a message took {delay - source.quickest:.3g} s longer than others"
            self._say(f"late {topic}", text)
        if self._arrived is not None:
            self._arrived(source.ports, stamp, values, source.names)
            return
        source.stamps.append(stamp)
        for kept, value in zip(source.values, values, strict=True):
            kept.append(value)
        if len(source.stamps) > _MOST:
            self._say(f"many {topic}", f"{topic}: {_MOST} samples wait to be processed; the oldest are left out")
            for kept in (source.stamps, *source.values):
                del kept[: _MOST // 2]

    def _read(self, source: _Source, message: Any) -> list[Any]:
        """The value of each input. Raises Unusable."""
        values = []
        for number, read in enumerate(source.reads):
            value, names = read(message)
            if value.__class__ is float:
                shape, finite = (), value - value == 0
            else:
                shape = value.shape
                finite = isfinite(value.ravel().dot(value.ravel())) or np.isfinite(value).all()  # the first is quicker
            if not finite:
                raise Unusable(f"{source.ports[number].name} is not finite")
            if shape != source.shapes[number]:
                self._shape(source, number, shape)
            if names is not source.told[number]:
                port = source.ports[number].name
                source.told[number] = names
                source.names[number] = tuple(f"{port}.{name}" for name in names) or ((port,) if shape == () else ())
            values.append(value)
        return values

    def _shape(self, source: _Source, number: int, shape: tuple[int, ...]) -> None:
        """The first value of an input, or one of another shape than before. Raises Unusable."""
        before, name = source.shapes[number], source.ports[number].name
        if before is not None:
            if source.stamps or self._arrived is not None:
                raise Unusable(f"{name} has {shape} values, before it had {before}")
            self._say(f"shape {name}", f"{name}: {shape} values from now on")
        source.shapes[number] = shape

    def _rate(self, source: _Source) -> None:
        """Report a rate that is not what is expected."""
        topic, expected = source.topic, source.ports[0].rate
        count, span = source.count - source.counted, source.last - source.begin
        if not expected or count < _ENOUGH or not span >= 1 / DEVIATION / expected:
            return
        source.counted, source.begin = source.count, source.last
        if not isfinite(span):
            return  # the first second
        if abs(count / span - expected) > DEVIATION * expected:
            self._say(f"rate {topic}", f"{topic}: {count / span:.3g} Hz arrive; Rate: {expected:g} is expected")
        else:
            self._say.over(f"rate {topic}", f"{topic}: {expected:g} Hz again")


def check_types(middleware: Middleware, inputs: Sequence[tuple[str, str]], outputs: Sequence[tuple[str, str]]) -> None:
    """Full names and types against the topics that are there. Raises MessageError for a topic with another type."""
    there = {info.name: info for info in middleware.graph()}
    for topic, type in (*inputs, *outputs):
        info = there.get(topic)
        if info is not None and info.types and type not in info.types:
            users = ", ".join(dict.fromkeys((*info.publishers, *info.subscribers)))
            text = f"topic {topic} carries {', '.join(info.types)} ({users}); the configuration says {type}"
            raise MessageError(text)


def _why(middleware: Middleware, source: _Source) -> str:
    """What the graph tells of a topic that was never heard."""
    info = next((item for item in middleware.graph() if item.name == source.topic), None)
    others = [type for type in (info.types if info else ()) if type != source.ports[0].type]
    if others:
        return f": it carries {', '.join(others)}, not {source.ports[0].type}"
    if info is None or not info.publishers:
        return ": nobody publishes it"
    return ""
