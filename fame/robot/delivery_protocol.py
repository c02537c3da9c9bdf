"""Acknowledged signals as pure state machines, one for each end of a topic: ``step(state, event) -> (state, actions)``.

Theory of operation. A robot that throws numbers its signals and keeps each one for its time to live. Each receiver is
sent those that it has not acknowledged, at most its window ahead of its last acknowledgement, in their order; one that
makes no progress is asked what it has, and sent the rest::

    thrower  ── signal 7, which follows 6 ──>  receiver      accepts 7 if 6 was the last one that it has accepted
             <── has accepted all up to 7 ───
             ── what have you? ─────────────>                after a while without progress
             <── all up to 7 ────────────────

Both ends have a *life*: the id of one run of a process. A signal names the life of its sender, which numbers it, and
that of its receiver: a robot that was started anew, and knows nothing, answers a signal for the life before with its
own, and is a new receiver, which gets all that is within its time to live. A robot that was restored from its state
goes on with its life.

Invariants, tried for every reachable state of both ends and the channels between them in
``tests/test_delivery_protocol.py``:

- A life of a receiver accepts a signal at most once, and signals of one life of a sender in their order.
- It accepts each one, or the sender reports that it has expired, or that the receiver left before.
- A receiver that does not answer keeps no other one waiting.

The window is that of a congestion control (RFC 5681): it begins at `WINDOW`, grows by one for each signal that is
acknowledged, and is halved when a receiver makes no progress. Middlewares are reliable, so that most of what is late is
on its way: who asks too early has everything sent twice. For how long a receiver may make no progress is measured
(`fame.robot.round_trip`).

A receiver may answer that the last signal it accepted is one that has been reported as expired: it was late, which is
reported, too. Of those before it nothing is known then, since what has expired is left out for the next one.

Nothing here sends, waits or looks at a clock: times (ns) come with the events, and `fame.robot.acknowledged` carries
the actions out.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import islice, takewhile

from fame.dataclasses import dataclass, field, replace

WINDOW, _LEAST, MOST = 32, 4, 512
"""Signals that are on the way to a receiver at most: at first, after losses, and ever."""
_EXPIRED = 1000
"""Numbers of expired signals that are kept for each receiver, since they may yet be acknowledged."""
_LIVES = 8
"""Lives of a sender that a receiver remembers."""

# ---- the throwing end ------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Signal:
    """A signal that is kept until it `expires` (ns). `data` is its message, `only` the one robot that it is for."""

    number: int
    expires: int
    data: str
    only: str = ""


@dataclass(frozen=True, slots=True)
class Receiver:
    """What the thrower knows of a receiver.

    life      its life as of its last answer; empty before the first
    accepted  it has all signals up to this number, or they have expired
    sent      it was sent those up to this number
    moved     whether it has acknowledged a signal since the last `Tick`
    asked     whether it was asked what it has, and has not answered yet
    window    signals that are on the way to it at most
    expired   the last numbers that were reported as not acknowledged, ascending
    """

    robot: str
    life: str = ""
    accepted: int = 0
    sent: int = 0
    moved: bool = False
    asked: bool = False
    window: int = WINDOW
    expired: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class Outgoing:
    """The throwing end of a topic. `life` is that of this robot; `kept` are consecutive signals."""

    life: str
    ttl: int
    last: int = 0
    kept: tuple[Signal, ...] = ()
    receivers: tuple[Receiver, ...] = ()

    @property
    def is_busy(self) -> bool:
        """Whether a signal is kept: then ticks are to come."""
        return bool(self.kept)

    def owed(self, receiver: Receiver) -> Iterator[Signal]:
        """Yield the kept signals that a receiver has not acknowledged, in order."""
        skipped = max(0, receiver.accepted - self.kept[0].number + 1) if self.kept else 0
        for place in range(skipped, len(self.kept)):
            if self.kept[place].only in ("", receiver.robot):
                yield self.kept[place]


@dataclass(frozen=True, slots=True)
class Thrown:
    """A signal was thrown, for all receivers or for `only` one."""

    data: str
    now: int
    only: str = ""


@dataclass(frozen=True, slots=True)
class Answered:
    """A receiver of this `life` has accepted all signals of the life `sender` up to `number`; or it has `left`."""

    robot: str
    life: str
    sender: str
    number: int
    left: bool = False


@dataclass(frozen=True, slots=True)
class Tick:
    """Some time has passed; robots that are `present` catch the topic, and `waiting` ones may still be given time."""

    now: int
    present: tuple[str, ...] = ()
    waiting: frozenset[str] = frozenset()


@dataclass(frozen=True, slots=True)
class Transmit:
    """Send a signal to a life of a robot, which is to accept it if it has accepted the one numbered `follows`."""

    robot: str
    life: str
    follows: int
    signal: Signal


@dataclass(frozen=True, slots=True)
class AskReceiver:
    """Ask a robot what it has accepted."""

    robot: str


@dataclass(frozen=True, slots=True)
class Expired:
    """Report that a robot has not acknowledged some signals in time."""

    robot: str
    signals: tuple[Signal, ...]


@dataclass(frozen=True, slots=True)
class Departed:
    """Report that a robot has left, and has not acknowledged some signals."""

    robot: str
    signals: tuple[Signal, ...]


@dataclass(frozen=True, slots=True)
class Late:
    """Report that a robot has accepted a signal after all that was reported as expired."""

    robot: str
    number: int


OutgoingEvent = Thrown | Answered | Tick
OutgoingAction = Transmit | AskReceiver | Expired | Departed | Late


def step_outgoing(state: Outgoing, event: OutgoingEvent) -> tuple[Outgoing, tuple[OutgoingAction, ...]]:
    """Return the next state of the throwing end, and what is to be done in this order."""
    match event:
        case Thrown(data, now, only):
            state, expired = _expire(state, now)
            signal = Signal(state.last + 1, now + state.ttl, data, only)
            state, sent = _send_on(replace(state, last=signal.number, kept=(*state.kept, signal)))
            return state, (*expired, *sent)
        case Answered(left=True):
            return _without(state, event)
        case Answered():
            state, late = _answered(state, event)
            state, sent = _send_on(state)
            return state, (*late, *sent)
        case Tick(now, present, waiting):
            state, expired = _expire(state, now)
            known = {receiver.robot for receiver in state.receivers}
            new = tuple(Receiver(robot) for robot in present if robot not in known)
            state, asked = _ask(replace(state, receivers=(*state.receivers, *new)), waiting)
            return state, (*expired, *asked)


def _expire(state: Outgoing, now: int) -> tuple[Outgoing, list[OutgoingAction]]:
    """Forget the signals whose time is over."""
    if not state.kept or state.kept[0].expires > now:
        return state, []
    over = tuple(takewhile(lambda signal: signal.expires <= now, state.kept))
    last, actions, receivers = over[-1].number, list[OutgoingAction](), []
    for receiver in state.receivers:
        missed = tuple(takewhile(lambda signal: signal.number <= last, state.owed(receiver)))
        if missed:
            actions.append(Expired(receiver.robot, missed))
        expired = (*receiver.expired, *(signal.number for signal in missed))[-_EXPIRED:]
        accepted, sent = max(receiver.accepted, last), max(receiver.sent, last)
        receivers.append(replace(receiver, accepted=accepted, sent=sent, expired=expired))
    return replace(state, kept=state.kept[len(over) :], receivers=tuple(receivers)), actions


def _answered(state: Outgoing, event: Answered) -> tuple[Outgoing, tuple[OutgoingAction, ...]]:
    """Note what a receiver has; a robot that is not known yet joins late."""
    number = min(event.number, state.last) if event.sender == state.life else 0
    receiver = next((one for one in state.receivers if one.robot == event.robot), None)
    late = False
    if receiver is None or receiver.life != event.life:
        receiver = Receiver(event.robot, event.life, number, number)
    else:
        accepted = max(receiver.accepted, number)
        sent = accepted if receiver.asked else max(receiver.sent, accepted)  # asked without progress: the rest was lost
        moved = receiver.moved or accepted > receiver.accepted
        window = min(receiver.window + accepted - receiver.accepted, MOST)
        late = number in receiver.expired
        expired = tuple(one for one in receiver.expired if one > number)
        receiver = replace(
            receiver, accepted=accepted, sent=sent, moved=moved, asked=False, window=window, expired=expired
        )
    others = (one if one.robot != event.robot else receiver for one in state.receivers)
    known = any(one.robot == event.robot for one in state.receivers)
    noted = replace(state, receivers=(*others, *(() if known else (receiver,))))
    return noted, (Late(event.robot, number),) if late else ()


def _without(state: Outgoing, event: Answered) -> tuple[Outgoing, tuple[OutgoingAction, ...]]:
    """Forget a receiver that has left, unless it was started anew."""
    left = [one for one in state.receivers if one.robot == event.robot and one.life in ("", event.life)]
    owed = tuple(signal for one in left for signal in state.owed(one))
    rest = replace(state, receivers=tuple(one for one in state.receivers if one not in left))
    return rest, (Departed(event.robot, owed),) if owed else ()


def _send_on(state: Outgoing) -> tuple[Outgoing, tuple[OutgoingAction, ...]]:
    """Send every receiver what it is owed, as far as its window goes."""
    receivers, actions = [], list[OutgoingAction]()
    for receiver in state.receivers:
        sent, follows, owed = receiver.sent, 0, tuple(islice(state.owed(receiver), receiver.window))
        if owed and not receiver.life and not receiver.asked:
            actions.append(AskReceiver(receiver.robot))
            receiver = replace(receiver, asked=True)
        for signal in owed if receiver.life else ():
            if signal.number > receiver.sent:
                actions.append(Transmit(receiver.robot, receiver.life, follows, signal))
                sent = signal.number
            follows = signal.number
        receivers.append(receiver if sent == receiver.sent else replace(receiver, sent=sent))
    return replace(state, receivers=tuple(receivers)), tuple(actions)


def _ask(state: Outgoing, waiting: frozenset[str]) -> tuple[Outgoing, tuple[OutgoingAction, ...]]:
    """Ask the receivers that have made no progress; while signals are kept, also those that have all: are they new?"""
    receivers, actions = [], list[OutgoingAction]()
    for receiver in state.receivers:
        asked, window = receiver.asked, receiver.window
        if receiver.robot not in waiting:
            if asked := bool(state.kept) and not receiver.moved:
                actions.append(AskReceiver(receiver.robot))
                window = max(window // 2, _LEAST) if receiver.sent > receiver.accepted else window
            receiver = replace(receiver, moved=False)
        receivers.append(replace(receiver, asked=asked, window=window))
    return replace(state, receivers=tuple(receivers)), tuple(actions)


# ---- the catching end ------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Incoming:
    """The catching end of a topic. `accepted`: the number of the last signal, by sender and its life."""

    life: str
    accepted: Mapping[tuple[str, str], int] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class SignalReceived:
    """A signal of a life of a sender for a life of this robot; without a number it asks what was accepted."""

    robot: str
    life: str
    receiver: str = ""
    follows: int = 0
    number: int = 0
    data: str = ""


@dataclass(frozen=True, slots=True)
class Accept:
    """Give the signal to the engine."""

    data: str


@dataclass(frozen=True, slots=True)
class Answer:
    """Tell a robot that all signals of its `life` up to this number were accepted, as soon as that is on the disk."""

    robot: str
    life: str
    number: int


def step_incoming(state: Incoming, event: SignalReceived) -> tuple[Incoming, tuple[Accept | Answer, ...]]:
    """Return the next state of the catching end, and what is to be done in this order.

    A signal whose predecessor is missing is dropped: it is sent again.
    """
    sender = event.robot, event.life
    last = state.accepted.get(sender, 0)
    if not event.number or event.receiver != state.life or event.number <= last:
        return state, (Answer(*sender, last),)
    if event.follows > last:  # out of order, or the one before was lost: the sender asks, and sends both again
        return state, ()
    accepted = {**state.accepted, sender: event.number}
    lives = [key for key in accepted if key[0] == event.robot]
    for key in lives[:-_LIVES]:
        del accepted[key]
    return replace(state, accepted=accepted), (Accept(event.data), Answer(*sender, event.number))
