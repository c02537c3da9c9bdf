"""The acknowledged signals of one robot: those that it throws, and those of others that it catches.

`fame.robot.delivery_protocol` decides; here are the topics, the timer, and what is kept in the robot's state. Signals
on ``/weed_found`` reach a robot on ``/<robot>/bpmn_signal/weed_found``, its answers reach the thrower on
``/<thrower>/bpmn_answer/weed_found``, both as JSON in a std_msgs/msg/String. Every signal is published once on
``/weed_found``, too, for nodes that are not FAME's.
"""

from __future__ import annotations

from base64 import b64decode, b64encode
from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import orjson

from fame.clock import SECOND, Entry, Kind
from fame.engine.host import BpmnError
from fame.engine.state import Mailbox
from fame.errors import MessageError
from fame.middleware import codec, messages
from fame.middleware.interface import AnyMessage, QoS
from fame.robot.delivery_protocol import (
    MOST,
    Accept,
    Answer,
    Answered,
    AskReceiver,
    Departed,
    Expired,
    Incoming,
    Late,
    Outgoing,
    OutgoingEvent,
    Receiver,
    Signal,
    SignalReceived,
    Thrown,
    Tick,
    Transmit,
    step_incoming,
    step_outgoing,
)
from fame.robot.endpoints import subscribers_of
from fame.robot.options import Membership
from fame.robot.round_trip import RoundTrip
from fame.text import read_json

if TYPE_CHECKING:
    from fame.robot.node import RobotNode

UNDELIVERED, CONGESTED = "~/undelivered", "~/congested"
"""Signals that a robot raises inside itself: when signals have expired, and when more are thrown than a receiver takes;
the payload is the report."""
_STRING = "std_msgs/msg/String"
_QOS = QoS(depth=2 * MOST)
"""What may be on the way: a window, and once more what is sent again."""
_TICK = SECOND // 4
_SOON = 4
"""A receiver is behind when a signal has waited for this part of its time to live."""
_LONGEST = 100_000_000
"""Characters of the longest message that is read."""


class AcknowledgedSignals:
    """Both ends of the topics (qualified names) of one robot whose signals are acknowledged."""

    life: str

    def __init__(self, node: RobotNode, membership: Membership) -> None:
        self._node, self._membership, self.life = node, membership, membership.life
        uses = {name: use for name, use in node.mission.types.items() if use.ttl}
        self._types = {name: use.type for name, use in uses.items()}
        self.outgoing: dict[str, Outgoing] = {
            name: Outgoing(
                self.life,
                round(use.ttl * SECOND),
                receivers=tuple(
                    Receiver(robot) for robot in membership.receivers.get(name, ()) if robot != node.namespace
                ),
            )
            for name, use in uses.items()
            if use.throws
        }
        self.incoming: dict[str, Incoming] = {name: Incoming(self.life) for name, use in uses.items() if use.catches}
        self._begun, self._catches = False, True
        self._dropped: dict[str, int] = {}  # signals that full queues have dropped, by topic
        self._boxes: dict[str, list[Mailbox]] = {}  # the queues as of the last signal: a failure closes them
        self._timer: Entry | None = None
        self._trips: dict[tuple[str, str], RoundTrip] = {}
        self._present: dict[str, set[str]] = {}  # the robots that caught a topic as of its last tick
        self._congested: set[tuple[str, str]] = set()
        self._failed: set[tuple[str, str]] = set()  # topics and robots whose mission has failed

    # ---- life --------------------------------------------------------------------------------------------------------

    def open(self) -> None:
        """Make the endpoints, also those towards the receivers that are bound."""
        for name, state in self.outgoing.items():
            self._subscribe(_answers(name, self._node.namespace), partial(self._on_answer, name))
            for receiver in state.receivers:
                self._publisher(_signals(name, receiver.robot))
        for name in self.incoming:
            self._subscribe(_signals(name, self._node.namespace), partial(self._on_signal, name))

    def _subscribe(self, topic: str, on_message: Callable[[Mapping[str, Any]], object]) -> None:
        def read(message: AnyMessage) -> None:
            try:
                content = read_json(message.data, _LONGEST)
                if self._begun:
                    on_message(content)
            except (ValueError, TypeError, KeyError, AttributeError, MessageError) as error:
                self._node.host.report("", f"{topic}: a message cannot be read: {error}")

        self._node.node.subscription(topic, _STRING, read, _QOS)

    def connect(self) -> None:
        """Make the publishers to the other ends that are there, so that discovery is over when they are needed."""
        for name in self.incoming:
            for robot in self._others(_answers(name, "")):
                self._publisher(_answers(name, robot))
        for name in self.outgoing:
            for robot in self._others(_signals(name, "")):
                self._publisher(_signals(name, robot))

    def begin(self) -> None:
        """Announce this robot to all that throw what it catches: the process has started, or goes on."""
        self._begun = True
        self._boxes = {name: self._queues(name) for name in self.incoming}
        for name in self.outgoing:
            self._tick(name)
        for name in self.incoming:
            for robot in self._others(_answers(name, "")):
                self._answer(name, Answer(robot, "", 0))

    def leave(self, successor: AcknowledgedSignals | None = None) -> None:
        """Tell the throwers what this process catches no more: another one replaces it, or it never starts.

        What the `successor` catches, too, it announces itself, and gets what the throwers still keep.
        """
        for name, state in self.incoming.items():
            if successor is not None and name in successor.incoming:
                continue
            known = {robot for robot, _ in state.accepted} | set(self._others(_answers(name, "")))
            for robot in sorted(known):
                self._answer(name, Answer(robot, "", 0), left=True)

    def end(self) -> None:
        """Accept nothing more: the process has ended, and would lose it. Report what waits in its queues."""
        self._catches = False
        for name in self.incoming:
            self._report_left(name, self._queues(name), "before the mission was replaced")

    def on_failed(self) -> None:
        """Report what waited in the queues of a mission that is over; `_on_signal` accepts nothing from now on."""
        for name, boxes in self._boxes.items() if self._node.has_failed else ():
            self._report_left(name, boxes, "before the mission failed")

    def _report_left(self, name: str, boxes: list[Mailbox], when: str) -> None:
        self._report_dropped(name)
        if many := sum(len(box.messages) for box in boxes):
            self._report(f"{name}: {many} acknowledged signals were not taken from a queue {when}")

    def _queues(self, name: str) -> list[Mailbox]:
        return [box for box in self._node.engine.listeners.get(name, ()) if isinstance(box, Mailbox)]

    def _count_dropped(self, name: str) -> None:
        """Report when queues that are full begin to drop their oldest signals, and how many they have dropped."""
        self._boxes[name] = boxes = self._queues(name)
        if any(len(box.messages) == box.messages.maxlen for box in boxes):
            if name not in self._dropped:
                self._report(f"{name}: a queue is full and drops its oldest signals, which were acknowledged")
            self._dropped[name] = self._dropped.get(name, 0) + 1
        else:
            self._report_dropped(name)

    def _report_dropped(self, name: str) -> None:
        if many := self._dropped.pop(name, 0):
            self._report(f"{name}: {many} acknowledged signals were dropped from a full queue")

    def report_owed(self) -> None:
        """Report what nobody will send again: another process replaces this one."""
        for name, state in self.outgoing.items():
            for receiver in state.receivers:
                if owed := tuple(state.owed(receiver)):
                    self._report_missed(name, receiver.robot, owed, "before the mission was replaced")

    def close(self) -> None:
        """Stop sending signals again, and handling what comes."""
        self._begun = False
        if self._timer is not None:
            self._timer.cancel()

    def _others(self, topic: str) -> list[str]:
        return subscribers_of(self._node.middleware, topic, self._node.node.full_name)

    def _publisher(self, topic: str) -> Any:
        return self._node.endpoints.publisher(topic, _STRING, _QOS)

    # ---- what it throws ----------------------------------------------------------------------------------------------

    def throw(self, name: str, message: AnyMessage, only: str = "") -> None:
        """Throw a signal, if it is acknowledged: every receiver, or `only` one, gets it."""
        if name in self.outgoing:
            data = b64encode(codec.serialize(message)).decode()
            self._handle(name, Thrown(data, self._node.scheduler.now, only))

    def send(self, name: str, value: Any, robot: Any) -> None:
        """Send a message to a robot that is bound, or is there. Raises BpmnError ``unreachable``, MessageError."""
        known = {one.robot for one in self.outgoing[name].receivers} | set(self._others(_signals(name, "")))
        if robot not in known:
            there = ", ".join(sorted(known)) or "none"
            raise BpmnError("unreachable", f"no other robot {robot!r} takes message {name}; robots that do: {there}")
        message = messages.create(self._types[name], value)
        if all(one.robot != robot for one in self.outgoing[name].receivers):
            self._handle(name, Tick(self._node.scheduler.now, (robot,)))
        self.throw(name, message, robot)

    @property
    def owed(self) -> list[tuple[str, str]]:
        """Robots that are still to get signals of this one, with the qualified names of their topics."""
        return [
            (receiver.robot, name)
            for name, state in self.outgoing.items()
            for receiver in state.receivers
            if any(state.owed(receiver))
        ]

    def _on_answer(self, name: str, content: Mapping[str, Any]) -> None:
        event = Answered(
            _text(content["robot"]), _text(content["life"]), _text(content["sender"]), _number(content["number"]),
            content.get("left") is True,
        )  # fmt: skip
        (self._failed.add if content.get("failed") is True else self._failed.discard)((name, event.robot))
        self._handle(name, event)

    def _handle(self, name: str, event: OutgoingEvent) -> None:
        self.outgoing[name], actions = step_outgoing(self.outgoing[name], event)
        if isinstance(event, Answered):
            self._trip(name, event.robot).answered(event.number, self._node.scheduler.now)
        for action in actions:
            match action:
                case Transmit(robot, life, follows, signal):
                    self._trip(name, robot).sent(signal.number, self._node.scheduler.now)
                    content = {"receiver": life, "follows": follows, "number": signal.number, "data": signal.data}
                    self._leave(_signals(name, robot), self._own(name, content))
                case AskReceiver(robot):
                    self._trip(name, robot).asked(self._node.scheduler.now)
                    self._leave(_signals(name, robot), self._own(name, {}))
                case Expired(robot, signals):
                    self._report_missed(name, robot, signals, f"within {self.outgoing[name].ttl / SECOND:g} s")
                case Departed(robot, signals):
                    self._report_missed(name, robot, signals, "before it left")
                case Late(robot, number):
                    self._report(f"{name}: {robot} has acknowledged number {number} after all, which was reported")
        state, scheduler = self.outgoing[name], self._node.scheduler
        awaits = state.receivers or not scheduler.is_simulated  # a simulated robot alone has nobody to wait for
        if state.is_busy and awaits and (self._timer is None or self._timer.action is None):
            self._timer = scheduler.after(_TICK, self._on_timer, Kind.TIMER)

    def _own(self, name: str, content: Mapping[str, Any]) -> dict[str, Any]:
        sequence = self._membership.sequence
        return {"robot": self._node.namespace, "life": self.outgoing[name].life, "sequence": sequence, **content}

    def _on_timer(self) -> None:
        for name, state in self.outgoing.items():
            if state.is_busy:
                self._tick(name)

    def _tick(self, name: str) -> None:
        now, present = self._node.scheduler.now, self._others(_signals(name, ""))
        for robot in {*present} - self._present.get(name, {*present}):
            self._trip(name, robot).found()
        self._present[name] = {*present}
        waiting = frozenset(
            robot for (topic, robot), trip in self._trips.items() if topic == name and now - trip.moved < trip.patience
        )
        self._handle(name, Tick(now, tuple(present), waiting))
        state = self.outgoing[name]
        behind = {(name, one.robot) for one in state.receivers if self._waits(state, one)[1] > state.ttl / _SOON}
        new = behind - self._congested
        self._congested = {pair for pair in self._congested if pair[0] != name} | behind
        for pair in sorted(new):
            self._report(self._behind(*pair), CONGESTED)

    def _waits(self, state: Outgoing, receiver: Receiver) -> tuple[int, int]:
        """How many signals a receiver has not acknowledged, and for how long the oldest has waited (ns)."""
        owed = list(state.owed(receiver))
        return len(owed), self._node.scheduler.now - (owed[0].expires - state.ttl) if owed else 0

    def _behind(self, name: str, robot: str) -> str:
        state = self.outgoing[name]
        many, waited = self._waits(state, next(one for one in state.receivers if one.robot == robot))
        oldest = f"the oldest for {waited / SECOND:.1f} s{self._reason(name, robot)}"
        return f"{name}: {robot} has not acknowledged {many} signals, {oldest}"

    def _reason(self, name: str, robot: str) -> str:
        return ": its mission has failed" if (name, robot) in self._failed else ""

    def behind(self) -> list[str]:
        """Return which robots do not take signals as fast as they are thrown, as warnings."""
        return [self._behind(*pair) for pair in sorted(self._congested)]

    def _trip(self, name: str, robot: str) -> RoundTrip:
        trip = self._trips.get((name, robot))
        if trip is None:
            trip = self._trips[name, robot] = RoundTrip()
        return trip

    def _report_missed(self, name: str, robot: str, signals: tuple[Signal, ...], when: str) -> None:
        first, last = signals[0].number, signals[-1].number
        numbers = f"number {first}" if first == last else f"{len(signals)} of the numbers {first} to {last}"
        self._report(f"{name}: {robot} has not acknowledged {numbers} {when}{self._reason(name, robot)}", UNDELIVERED)

    def _report(self, text: str, signal: str = "") -> None:
        """Report to people, and by a `signal` to the process itself."""
        self._node.host.report("", text)
        use = self._node.mission.types.get(signal)
        if use is not None and use.catches:
            type = use.declared or _STRING
            message = messages.create(type, text if type == _STRING else None)
            self._node.scheduler.soon(partial(self._node.on_message, signal, message))

    # ---- what it catches ---------------------------------------------------------------------------------------------

    def _on_signal(self, name: str, content: Mapping[str, Any]) -> None:
        event = SignalReceived(
            _text(content["robot"]), _text(content["life"]), _text(content.get("receiver", "")),
            _number(content.get("follows", 0)), _number(content.get("number", 0)), _text(content.get("data", "")),
        )  # fmt: skip
        if not self._catches:
            return
        if event.robot in self._membership.team and _number(content["sequence"]) < self._membership.sequence:
            return  # a process that is being replaced, together with the one of before
        if self._node.has_failed:
            last = self.incoming[name].accepted.get((event.robot, event.life), 0)
            self._answer(name, Answer(event.robot, event.life, last), failed=True)
            return
        message = codec.deserialize(b64decode(event.data), self._types[name]) if event.number else None
        self.incoming[name], actions = step_incoming(self.incoming[name], event)
        for action in actions:
            if isinstance(action, Accept):
                self._count_dropped(name)
                self._node.on_message(name, message)
            else:
                self._answer(name, action)

    def _answer(self, name: str, answer: Answer, *, left: bool = False, failed: bool = False) -> None:
        content = {
            "robot": self._node.namespace, "life": self.incoming[name].life, "sender": answer.life,
            "number": answer.number, "left": left, "failed": failed,
        }  # fmt: skip
        self._leave(_answers(name, answer.robot), content)

    def _leave(self, topic: str, content: Mapping[str, Any]) -> None:
        """Send a message, as soon as what has led to it is on the disk."""
        publisher = self._publisher(topic)
        send = partial(publisher.publish, messages.create(_STRING, orjson.dumps(content).decode()))
        if self._node.host.recorder is None:
            send()
        else:
            self._node.host.recorder.once_written(send)

    # ---- state -------------------------------------------------------------------------------------------------------

    def tables(self, epoch: int) -> dict[str, dict[str, Any]]:
        """Return the state as tables (`fame.robot.state_tables`); `epoch` is the date of second 0
        of the mission (ns)."""
        return {
            "thrown": {
                f"{name} {signal.number}": [signal.expires + epoch, signal.data, signal.only]
                for name, state in self.outgoing.items()
                for signal in state.kept
            },
            "receivers": {
                name: [state.life, state.last, *([one.robot, one.life, one.accepted] for one in state.receivers)]
                for name, state in self.outgoing.items()
            },
            "accepted": {
                name: [state.life, *([*sender, number] for sender, number in state.accepted.items())]
                for name, state in self.incoming.items()
            },
        }

    def restore(self, tables: Mapping[str, Mapping[str, Any]], epoch: int) -> None:
        """Go on with a state as of `tables`, as far as it is about topics of this process."""
        kept: dict[str, list[Signal]] = {}
        for key, (expires, data, only) in tables.get("thrown", {}).items():
            name, _, number = key.rpartition(" ")
            kept.setdefault(name, []).append(Signal(int(number), expires - epoch, data, only))
        for name, (life, last, *known) in tables.get("receivers", {}).items():
            if name in self.outgoing:
                receivers = tuple(Receiver(robot, its, number, number) for robot, its, number in known)
                signals = tuple(sorted(kept.get(name, ()), key=lambda signal: signal.number))
                self.outgoing[name] = Outgoing(life, self.outgoing[name].ttl, last, signals, receivers)
        for name, (life, *accepted) in tables.get("accepted", {}).items():
            if name in self.incoming:
                self.incoming[name] = Incoming(life, {(robot, its): number for robot, its, number in accepted})


def _signals(topic: str, robot: str) -> str:
    """The topic on which a robot gets acknowledged signals.

    >>> _signals("/weed_found", "REX")
    '/REX/bpmn_signal/weed_found'
    """
    return f"/{robot}/bpmn_signal{topic}" if robot else f"/bpmn_signal{topic}"


def _answers(topic: str, robot: str) -> str:
    """The topic on which a robot that throws gets answers; without a robot, how such a topic ends."""
    return f"/{robot}/bpmn_answer{topic}" if robot else f"/bpmn_answer{topic}"


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError(f"expected a text, got {value!r:.60}")
    return value


def _number(value: Any) -> int:
    if not isinstance(value, int) or value < 0:
        raise TypeError(f"expected a number from 0 on, got {value!r:.60}")
    return value
