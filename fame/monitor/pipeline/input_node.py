"""Nodes that subscribe, the samples that arrive, silent topics, and reports that do not repeat themselves.

Each topic is subscribed once. A message gives one sample to every input of its topic, or to none: if any input cannot
be read or is not finite, or the stamp is not later than the last one, the whole message is left out, and the reason is
reported. So the inputs of one topic always have the same stamps. The stamp is that of the header, otherwise the time of
arrival (s, of the scheduler).

Channels keep the names and the order of the first message: another order is undone, and a message with other names is
left out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from math import isfinite
from typing import Any, NamedTuple

import numpy as np

from fame.clock import SECOND, Entry, Kind, Scheduler
from fame.errors import MessageError
from fame.middleware.interface import Middleware, Node, resolve
from fame.middleware.typesystem import STRING
from fame.monitor.pipeline import fields
from fame.monitor.pipeline.blindness import told_by_others
from fame.monitor.pipeline.configuration import Configuration, Port
from fame.monitor.pipeline.elements import ElementFollower
from fame.monitor.pipeline.fields import OtherDevice, Read, UnusableMessage, has_stamp, reader, stamp_of, unusable
from fame.monitor.pipeline.processor import Samples
from fame.robot.robot_state import EVENTS_TOPIC


class ThrottledReport:
    """Reports each kind of event once, and again when it has happened 10, 100, 1000 ... times."""

    def __init__(self, report: Callable[[str], object]) -> None:
        """`report` gets a line of text; `always` is the same function, for what must not be throttled."""
        self.always = report
        self.counts: dict[str, int] = {}

    def __call__(self, key: str, text: str) -> None:
        """Report an event; events with the same `key` are of the same kind."""
        count = self.counts[key] = self.counts.get(key, 0) + 1
        if str(count).rstrip("0") == "1":
            self.always(text if count == 1 else f"{text} ({count} times)")

    def over(self, key: str, text: str) -> None:
        """Report that events of this kind are over, if there were any, and count anew."""
        if self.counts.pop(key, 0):
            self.always(text)


class SilenceWatch:
    """Reports when no message of a topic has come for `silence` (s), and when messages come again.

    `reason` gives the end of the report; it gets whether there ever was a message. A message costs one assignment: the
    timer is moved on only when it is due.
    """

    def __init__(
        self,
        scheduler: Scheduler,
        topic: str,
        silence: float,
        report: Callable[[str], object],
        reason: Callable[[bool], str],
    ) -> None:
        self._scheduler, self._topic, self._silence = scheduler, topic, silence
        self._report, self._reason = report, reason
        self._received = False
        self._last = scheduler.now
        self._timer: Entry | None = self._expect()

    def on_message(self) -> None:
        """Expect the next message in time."""
        self._last, self._received = self._scheduler.now, True
        if self._timer is None:
            self._report(f"{self._topic}: messages arrive again")
            self._timer = self._expect()

    def close(self) -> None:
        """Expect no more messages."""
        if self._timer is not None:
            self._timer.cancel()

    def _expect(self) -> Entry:
        return self._scheduler.at(self._last + round(self._silence * SECOND), self._check, Kind.TIMER)

    def _check(self) -> None:
        if self._scheduler.now < self._last + round(self._silence * SECOND):
            self._timer = self._expect()
            return
        self._timer = None
        self._report(f"{self._topic}: no message for {self._silence:g} s{self._reason(self._received)}")


SILENCE = 2.0
"""A topic without a message for this time (s) is silent."""

JUMP, FORGET = 3, 10.0
"""So many messages of earlier stamps, one after another, are of a clock that jumped back; fewer came late. Then stamps
are not taken for as long again (s), at most."""

LATE = 1.0
"""A message is late if it took this much longer (s) than the quickest one."""

DEVIATION = 0.2
"""Relative deviation of the rate from the expected one that is tolerated."""

_MAX_WAITING = 200_000  # samples that wait to be processed
_MIN_SAMPLES = 50  # samples that a rate is computed from


class LeftOut(NamedTuple):
    """Messages of a topic that were left out.

    inputs  names of the inputs of the topic
    number  of these messages; `others` of them are of other devices, of which `unwanted` have nothing that the
            configuration names; `taken` is that of the messages that were used
    unseen  how long (s) messages came before the first one that was taken, and after the last one
    reason  of the last one
    """

    topic: str
    inputs: tuple[str, ...]
    number: int
    others: int
    taken: int
    unseen: float
    reason: str
    unwanted: int = 0

    @property
    def text(self) -> str:
        """What was left out, in a sentence."""
        total = self.number + self.taken
        return f"{self.number} of {total} messages on {self.topic} are left out, the last one since {self.reason}"

    @property
    def seen(self) -> float:
        """The share of the messages that were taken; those of other devices do not count."""
        return self.taken / max(1, self.taken + self.number - self.others)

    def concerns(self, columns: Sequence[str]) -> bool:
        """Return whether some of the columns of a table are of this topic."""
        return any(column == name or column.startswith(f"{name}.") for name in self.inputs for column in columns)


def listen(node: Node, port: Port, handler: Callable[[Any], object]) -> str:
    """Subscribe to the topic of a port, or offer its service. Returns the full name."""
    if not port.service:
        return node.subscription(port.topic, port.type, handler, port.qos).topic

    def called(request: Any) -> dict[str, Any]:
        handler(request)  # it has the field of the message
        return {"success": True}

    return node.service(port.topic, "std_srvs/srv/SetBool", called).name


class _Stream:
    """The inputs of one topic, and what has arrived of them: `left_out` messages were not taken, of which `others` are
    of other devices, the last one since `reason`; messages came from `arrived[0]` to `arrived[1]` (s), those that were
    taken from `taken[0]` to `taken[1]`."""

    def __init__(self, ports: list[Port]) -> None:
        self.ports = ports
        self.reads: list[Read] = [reader(port.type, port.path) for port in ports]
        self.stamped: bool = has_stamp(ports[0].type)
        self.topic = ""
        self.silence: SilenceWatch
        self.stamps: list[float] = []
        self.values: list[list[Any]] = [[] for _ in ports]
        self.names: list[tuple[str, ...]] = [() for _ in ports]  # of the channels
        self.forget()
        self.last: float = -np.inf
        self.begin: float = -np.inf
        self.quickest: float = np.inf
        self.count = self.counted = self.left_out = self.others = self.unwanted = 0
        self.reason = ""
        self.arrived: tuple[float, float] = (np.inf, -np.inf)
        self.taken: tuple[float, float] = (np.inf, -np.inf)
        self.wrong_rate = ""  # how the rate differs from the expected one
        self.latest: list[Any] = []  # the values of the last message that was taken
        self.older: int = 0  # messages of earlier stamps since then
        self.back: float = 0.0  # how much earlier (s)

    def forget(self) -> None:
        """Forget what the messages were like so far: none of them was taken."""
        self.first_names: list[tuple[str, ...] | None] = [None for _ in self.ports]  # names that the first message gave
        self.message_names: list[Any] = [None for _ in self.ports]  # as the last message gave them
        self.orders: list[list[int] | None] = [None for _ in self.ports]  # of the last message's channels, if another
        self.shapes: list[tuple[int, ...] | None] = [None for _ in self.ports]


class InputNode:
    """A node that subscribes to what a configuration calls Inputs, until `close`.

    report    gets a line for everything unusual
    node      what it has made on the middleware
    follower  knows the active element of the mission, if that is wanted
    handlers  what takes the messages of each topic (full name)
    """

    configuration: Configuration
    scheduler: Scheduler
    report: ThrottledReport
    node: Node
    follower: ElementFollower

    def __init__(
        self, middleware: Middleware, scheduler: Scheduler, configuration: Configuration, name: str = "", *,
        namespace: str = "", report: Callable[[str], object], outputs: Sequence[Port] = (), elements: bool = False,
        on_sample: Callable[[Sequence[Port], float, Sequence[Any], Sequence[tuple[str, ...]]], object] | None = None,
        ordered: bool = True,
    ) -> None:  # fmt: skip
        """Subscribe, with `elements` to ``bpmn_events`` too. `on_sample`, if given, gets every sample at once, and
        nothing is kept for `take`; it may raise UnusableMessage. Without `ordered`, stamps need not grow. Raises
        MessageError if a topic of the inputs or `outputs` has another type."""
        self.configuration, self.scheduler, ports = configuration, scheduler, configuration.inputs
        self._sample_handler, self._ordered = on_sample, ordered
        self._made, self._middleware = scheduler.now / SECOND, middleware
        self.report = ThrottledReport(lambda text: report(f"{configuration.name}: {text}"))
        ends = [[(resolve(port.topic, namespace), port.type) for port in each] for each in (ports, outputs)]
        check_types(middleware, *ends)
        self.node, self.follower = middleware.node(name or configuration.name, namespace), ElementFollower()
        self.streams: list[_Stream] = []
        self.handlers: dict[str, Callable[[Any], object]] = {}
        try:
            for topic in dict.fromkeys(port.topic for port in ports):
                stream = _Stream([port for port in ports if port.topic == topic])
                type = stream.ports[0].type
                handler = partial(self.on_message, stream)
                stream.topic = listen(self.node, stream.ports[0], handler)
                reason = partial(_silence_reason, middleware, stream.topic, type)
                stream.silence = SilenceWatch(scheduler, stream.topic, SILENCE, self.report.always, reason)
                if stream.ports == [configuration.trigger]:
                    stream.silence.close()  # a trigger may have a message per run
                self.streams.append(stream)
                self.handlers[stream.topic] = handler
            if elements:
                watched = self.node.subscription(EVENTS_TOPIC, STRING, self.follower.on_message)
                self.handlers[watched.topic] = self.follower.on_message
        except BaseException:
            InputNode.close(self)
            raise

    def take(self) -> dict[str, Samples]:
        """Return the samples that arrived since the last call, by name of the input; arrays may have no rows."""
        taken = {}
        for stream in self.streams:
            stamps, stream.stamps = np.array(stream.stamps), []
            for number, port in enumerate(stream.ports):
                shape = stream.shapes[number] or ()
                values = np.array(stream.values[number], dtype=np.float64).reshape(len(stamps), *shape)
                stream.values[number] = []
                taken[port.name] = Samples(values, stamps, stream.names[number])
        return taken

    @property
    def left_out(self) -> tuple[LeftOut, ...]:
        """The messages that were left out, of each topic that had some."""
        return tuple(
            LeftOut(
                each.topic, tuple(port.name for port in each.ports), each.left_out, each.others, each.count,
                each.taken[0] - each.arrived[0] + each.arrived[1] - each.taken[1] if each.count else 0.0, each.reason,
                each.unwanted,
            )
            for each in self.streams if each.left_out
        )  # fmt: skip

    def check_rates(self) -> None:
        """Report rates that differ from the expected ones. To be called about once a second."""
        for stream in self.streams:
            self._check_rate(stream)

    def unseen(self) -> dict[str, str]:
        """Return why topics give nothing, or too little, to judge by: kind of reason -> text."""
        now, found = self.scheduler.now / SECOND, {}
        for stream in self.streams:
            topic, arrived, taken = (
                stream.topic,
                *(max(self._made, each[1]) for each in (stream.arrived, stream.taken)),
            )
            if now - arrived >= SILENCE:
                if not told_by_others(self._middleware, self.node.name, topic):
                    found[f"silent {topic}"] = f"{topic}: no message for {SILENCE:g} s"
            elif now - taken >= SILENCE and stream.reason:
                found[f"unusable {topic}"] = f"{topic}: no message can be used: {stream.reason}"
            elif stream.wrong_rate:
                found[f"rate {topic}"] = stream.wrong_rate
        return found

    def close(self) -> None:
        """Close all endpoints."""
        for stream in self.streams:
            stream.silence.close()
        self.node.close()

    def on_message(self, stream: _Stream, message: Any) -> None:
        """Take a message of a topic, or leave it out and say why."""
        now = self.scheduler.now / SECOND
        stream.arrived = min(stream.arrived[0], now), now
        stream.silence.on_message()
        stamp = (stamp_of(message) if stream.stamped else 0.0) or now
        if self._is_out_of_order(stream, message, stamp) or self._is_of_a_past_clock(stream, stamp):
            return
        try:
            values = self._read(stream, message)
            if self._sample_handler is not None:
                self._sample_handler(stream.ports, stamp, values, stream.names)
        except UnusableMessage as reason:
            self._leave_out_unusable(stream, reason)
            return
        stream.last, stream.latest, stream.older, stream.back = stamp, values, 0, 0.0
        stream.taken = min(stream.taken[0], now), now
        stream.count += 1
        self._note_delay(stream, now - stamp)
        if self._sample_handler is None:
            self._keep(stream, stamp, values)

    def _is_out_of_order(self, stream: _Stream, message: Any, stamp: float) -> bool:
        """Return whether a message is not newer than the last one, where order matters; then it is left out."""
        if not self._ordered or stamp > stream.last:
            return False
        same, older, topic = stamp == stream.last, f"{stream.last - stamp:.3g} s older", stream.topic
        what = "a second sample" if same else f"a sample {older}"
        self.report(f"order {topic}", f"{topic}: left out: {what} of stamp {stamp:.3f} s after {stream.last:.3f} s")
        if not same or not self._is_repeated(stream, message):
            stream.left_out += 1
            stream.reason = f"its stamp is {'that' if same else f'{older} than that'} of another one"
        if not same:
            stream.older, stream.back = stream.older + 1, max(stream.back, stream.last - stamp)
        return True

    def _is_of_a_past_clock(self, stream: _Stream, stamp: float) -> bool:
        """Return whether a message comes just after a clock that had jumped back was set right; it is left out.

        Stamps go on where they were, but time has passed: without a gap, windows would span what is missing.
        """
        if stream.older < JUMP or stamp > stream.last + min(stream.back, FORGET):
            return False
        stream.left_out += 1
        stream.reason = f"the clock jumped back by {stream.back:.3g} s"
        text = f"{stream.topic}: left out: {stream.reason}, and no window spans that"
        self.report(f"jump {stream.topic}", text)
        return True

    def _leave_out_unusable(self, stream: _Stream, reason: UnusableMessage) -> None:
        if not stream.count:
            stream.forget()
        stream.left_out += 1
        stream.others += isinstance(reason, OtherDevice)
        stream.unwanted += isinstance(reason, fields.Unwanted)
        stream.reason = str(reason)
        self.report(f"unusable {stream.topic} {reason}", f"{stream.topic}: a message is left out: {reason}")

    def _note_delay(self, stream: _Stream, delay: float) -> None:
        if delay < stream.quickest:
            stream.quickest = delay
        elif delay - stream.quickest > LATE:
            text = f"{stream.topic}: late: a message took {delay - stream.quickest:.3g} s longer than others"
            self.report(f"late {stream.topic}", text)

    def _keep(self, stream: _Stream, stamp: float, values: Sequence[Any]) -> None:
        """Keep a sample until it is processed; of too many, the older half is dropped."""
        stream.stamps.append(stamp)
        for kept, value in zip(stream.values, values, strict=True):
            kept.append(value)
        if len(stream.stamps) > _MAX_WAITING:
            text = f"{stream.topic}: {_MAX_WAITING} samples wait to be processed; the oldest are dropped"
            self.report(f"many {stream.topic}", text)
            for kept in (stream.stamps, *stream.values):
                del kept[: _MAX_WAITING // 2]

    def _is_repeated(self, stream: _Stream, message: Any) -> bool:
        """Return whether a message has the values of the last one that was taken: without it, nothing is lost."""
        try:
            return all(map(np.array_equal, self._read(stream, message), stream.latest))
        except UnusableMessage:
            return False

    def _read(self, stream: _Stream, message: Any) -> list[Any]:
        """Return the value of each input. Raises UnusableMessage."""
        values = []
        for number, read in enumerate(stream.reads):
            value, names = read(message)
            if value.__class__ is float:
                shape, finite = (), value - value == 0
            else:
                shape = value.shape
                finite = isfinite(value.ravel().dot(value.ravel())) or np.isfinite(value).all()  # the first is quicker
            if not finite:
                raise UnusableMessage(f"{stream.ports[number].name} is not finite")
            if shape != stream.shapes[number]:
                self._shape(stream, number, shape, names)
            if names is not stream.message_names[number]:
                self._take_names(stream, number, names, shape)
            order = stream.orders[number]
            values.append(value if order is None else value[order])
        return values

    def _take_names(self, stream: _Stream, number: int, names: tuple[str, ...], shape: tuple[int, ...]) -> None:
        """Take the names of the first value of an input, or the order of other ones. Raises UnusableMessage."""
        before, port = stream.first_names[number], stream.ports[number].name
        if before is None:
            stream.first_names[number] = names
            stream.names[number] = tuple(f"{port}.{name}" for name in names) or ((port,) if shape == () else ())
        elif names != before and (set(names) != set(before) or len(set(names)) < len(names)):
            now, then = (f"the channels {', '.join(each)}" if each else "no names" for each in (names, before))
            raise unusable(f"{port} has {now}, before it had {then}", names, before)
        stream.orders[number] = None if before in (None, names) else [names.index(name) for name in before or ()]
        stream.message_names[number] = names

    def _shape(self, stream: _Stream, number: int, shape: tuple[int, ...], names: tuple[str, ...]) -> None:
        """Take the shape of the first value of an input, or a new one. Raises UnusableMessage."""
        before, name = stream.shapes[number], stream.ports[number].name
        if before is not None:
            if stream.stamps or self._sample_handler is not None:
                text = f"{name} has {shape} values, before it had {before}"
                raise unusable(text, names, stream.first_names[number] or ())
            self.report(f"shape {name}", f"{name}: {shape} values from now on")
            stream.first_names[number] = stream.message_names[number] = None
        stream.shapes[number] = shape

    def _check_rate(self, stream: _Stream) -> None:
        """Report a rate that differs from the expected one."""
        topic, expected = stream.topic, stream.ports[0].rate
        count, span = stream.count - stream.counted, stream.last - stream.begin
        if not expected or count < _MIN_SAMPLES or not span >= 1 / DEVIATION / expected:
            return
        stream.counted, stream.begin = stream.count, stream.last
        if not isfinite(span):
            return  # the first second
        stream.wrong_rate = ""
        if abs(count / span - expected) > DEVIATION * expected:
            stream.wrong_rate = f"{topic}: {count / span:.3g} Hz arrive; Rate: {expected:g} is expected"
            self.report(f"rate {topic}", stream.wrong_rate)
        else:
            self.report.over(f"rate {topic}", f"{topic}: {expected:g} Hz again")


def check_types(middleware: Middleware, inputs: Sequence[tuple[str, str]], outputs: Sequence[tuple[str, str]]) -> None:
    """Compare full names and types with the graph. Raises MessageError for a topic with another type."""
    there = {info.name: info for info in middleware.graph()}
    for topic, type in (*inputs, *outputs):
        info = there.get(topic)
        if info is not None and info.types and type not in info.types:
            users = ", ".join(dict.fromkeys((*info.publishers, *info.subscribers)))
            text = f"topic {topic} carries {', '.join(info.types)} ({users}); expected {type} by the configuration"
            raise MessageError(text)


def _silence_reason(middleware: Middleware, topic: str, type: str, received: bool) -> str:
    """Explain from the graph why a topic has had no message at all."""
    if received:
        return ""
    info = next((item for item in middleware.graph() if item.name == topic), None)
    others = [other for other in (info.types if info else ()) if other != type]
    if others:
        return f": it carries {', '.join(others)}, not {type}"
    return "" if info is not None and info.publishers else ": it has no publisher"
