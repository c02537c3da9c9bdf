"""Acknowledged signals are accepted once and in order, or reported, whatever is lost and whoever is started anew."""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product

import pytest

from fame.robot import delivery_protocol
from fame.robot.delivery_protocol import (
    Accept,
    Answer,
    Answered,
    AskReceiver,
    Departed,
    Expired,
    Incoming,
    Late,
    Outgoing,
    Receiver,
    Signal,
    SignalReceived,
    Thrown,
    Tick,
    Transmit,
    step_incoming,
    step_outgoing,
)

TTL = 10
NEW = Outgoing("a1", TTL, receivers=(Receiver("B"), Receiver("C")))


def after(*events, state: Outgoing = NEW):
    """The state after some events, and what is to be done for the last one."""
    actions = ()
    for event in events:
        state, actions = step_outgoing(state, event)
    return state, list(actions)


def answered(robot: str, number: int, life: str = "b1", **more) -> Answered:
    return Answered(robot, life, "a1", number, **more)


def sent(robot: str, number: int, follows: int, life: str = "b1") -> Transmit:
    return Transmit(robot, life, follows, Signal(number, TTL, f"s{number}"))


FIRST, SECOND = Thrown("s1", 0), Thrown("s2", 0)


@pytest.mark.parametrize(
    ("events", "actions"),
    [
        ((FIRST,), [AskReceiver("B"), AskReceiver("C")]),
        ((FIRST, answered("B", 0)), [sent("B", 1, 0)]),
        ((FIRST, answered("B", 0), SECOND), [sent("B", 2, 1)]),
        ((FIRST, answered("B", 0), answered("B", 1), SECOND), [sent("B", 2, 0)]),
        ((FIRST, SECOND, answered("B", 0)), [sent("B", 1, 0), sent("B", 2, 1)]),
        ((FIRST, answered("B", 0), Tick(1)), [AskReceiver("B"), AskReceiver("C")]),
        ((FIRST, answered("B", 0), answered("B", 1), Tick(1)), [AskReceiver("C")]),
        ((FIRST, answered("B", 0), Tick(1), answered("B", 0)), [sent("B", 1, 0)]),
        ((FIRST, answered("B", 1), answered("B", 0, "b2")), [sent("B", 1, 0, "b2")]),
        ((FIRST, answered("D", 0, "d1")), [sent("D", 1, 0, "d1")]),
        ((FIRST, Answered("B", "b1", "a0", 7)), [sent("B", 1, 0)]),  # what it has of the thrower's life before
        ((FIRST, answered("B", 0, left=True), Tick(1)), [AskReceiver("C")]),
        ((FIRST, SECOND, answered("B", 1), answered("B", 0, left=True)), [Departed("B", (Signal(2, TTL, "s2"),))]),
        ((FIRST, answered("B", 1), answered("B", 0, left=True)), []),
        ((FIRST, Tick(1, ("B", "D"))), [AskReceiver("B"), AskReceiver("C"), AskReceiver("D")]),
        (
            (FIRST, answered("B", 1), Tick(TTL)),
            [Expired("C", (Signal(1, TTL, "s1"),))],
        ),
        ((FIRST, answered("B", 0), Tick(TTL), answered("B", 1)), [Late("B", 1)]),
        ((FIRST, SECOND, answered("B", 0), Tick(TTL), answered("B", 2)), [Late("B", 2)]),  # of s1 nothing is known
        ((FIRST, answered("B", 0), Tick(TTL), answered("B", 1, "b2")), []),
        ((FIRST, answered("B", 0), Tick(1, waiting=frozenset("B"))), [AskReceiver("C")]),
        (
            (Thrown("s1", 0, only="B"), answered("C", 0), answered("B", 0)),
            [Transmit("B", "b1", 0, Signal(1, TTL, "s1", "B"))],
        ),
    ],
)  # fmt: skip
def test_the_thrower_decides(events, actions):
    assert after(*events)[1] == actions


def test_one_receiver_that_is_silent_keeps_no_other_one_waiting():
    many = [Thrown(f"s{number}", 0) for number in range(1, 101)]
    state, actions = after(*many, answered("B", 0))
    assert [action.signal.number for action in actions] == list(range(1, delivery_protocol.WINDOW + 1))
    state, actions = after(answered("B", 10), state=state)
    assert [action.signal.number for action in actions] == list(range(33, 53))  # the window has grown by ten


def test_a_window_shrinks_when_nothing_moves_and_grows_with_what_is_acknowledged():
    many = [Thrown(f"s{number}", 0) for number in range(1, 1001)]
    state, _ = after(*many, answered("B", 0), *[Tick(1)] * 9, answered("B", 0))
    assert state.receivers[0].window == 4
    state, actions = after(answered("B", 4), state=state)
    assert [action.signal.number for action in actions] == list(range(5, 13))
    state, _ = after(*[answered("B", number) for number in range(5, 901)], state=state)
    assert state.receivers[0].window == delivery_protocol.MOST


@pytest.mark.parametrize(
    ("event", "actions"),
    [
        (SignalReceived("A", "a1", "b1", 0, 1, "s1"), (Answer("A", "a1", 3),)),
        (SignalReceived("A", "a1", "b1", 3, 4, "s4"), (Accept("s4"), Answer("A", "a1", 4))),
        (SignalReceived("A", "a1", "b1", 4, 5, "s5"), ()),
        (SignalReceived("A", "a1", "b1", 0, 9, "s9"), (Accept("s9"), Answer("A", "a1", 9))),
        (SignalReceived("A", "a1", "b0", 3, 4, "s4"), (Answer("A", "a1", 3),)),
        (SignalReceived("A", "a2", "b1", 0, 1, "s1"), (Accept("s1"), Answer("A", "a2", 1))),
        (SignalReceived("A", "a1"), (Answer("A", "a1", 3),)),
    ],
)
def test_the_receiver_decides(event, actions):
    assert step_incoming(Incoming("b1", {("A", "a1"): 3}), event)[1] == actions


# ---- both ends, every loss, every restart ----------------------------------------------------------------------------


@dataclass(frozen=True)
class World:
    """Both ends, what is on the way, and what has become of each signal: its text is its sender's life and number.

    `losses`, `restarts`: how often messages may still be lost, and the ends be started anew. `stays`: B may still leave
    if False; None when it has left.
    """

    a: Outgoing
    b: tuple[str, tuple]
    there: tuple = ()
    back: tuple = ()
    now: int = 0
    thrown: int = 0
    sent: tuple[str, ...] = ()
    accepted: tuple[tuple[str, str], ...] = ()
    expired: frozenset[str] = frozenset()
    late: frozenset[str] = frozenset()
    losses: int = 1
    restarts: tuple[int, int] = (0, 0)
    stays: bool | None = True


STEPS = {"incoming": step_incoming}
LENGTH, SIGNALS, LAST = 2, 2, 12


def perform(world: World, actions) -> World:
    for action in actions:
        match action:
            case Transmit("B", life, follows, signal):
                message = SignalReceived("A", world.a.life, life, follows, signal.number, signal.data)
                world = replace(world, there=(*world.there, message))
            case AskReceiver("B"):
                world = replace(world, there=(*world.there, SignalReceived("A", world.a.life)))
            case Expired(_, signals) | Departed(_, signals):
                world = replace(world, expired=world.expired | {signal.data for signal in signals})
            case Late(_, number):
                of_life = [data for data in world.sent if data.startswith(world.a.life)]
                world = replace(world, late=world.late | {of_life[number - 1]})
            case Accept(data):
                world = replace(world, accepted=(*world.accepted, (world.b[0], data)))
            case Answer(_, life, number):
                world = replace(world, back=(*world.back, Answered("B", world.b[0], life, number)))
    return world


def outgoing(world: World, event) -> World:
    state, actions = step_outgoing(world.a, event)
    return perform(replace(world, a=state), actions)


def arrive_there(world: World) -> World:
    state = Incoming(world.b[0], dict(world.b[1]))
    if world.stays is None:
        return replace(world, there=world.there[1:])
    state, actions = STEPS["incoming"](state, world.there[0])
    return perform(replace(world, b=(state.life, tuple(state.accepted.items())), there=world.there[1:]), actions)


def arrive_back(world: World) -> World:
    return outgoing(replace(world, back=world.back[1:]), world.back[0])


def tick(world: World, step: int) -> World:
    now = min(world.now + step, LAST)
    return outgoing(replace(world, now=now), Tick(now, ("B",) if world.stays is not None else ()))


def successors(world: World) -> Iterator[World]:
    if world.thrown < SIGNALS:
        data = f"{world.a.life} {world.thrown + 1}"
        nobody = frozenset[str]() if world.a.receivers else {data}  # all have left, as is known
        sent = replace(world, thrown=world.thrown + 1, sent=(*world.sent, data), expired=world.expired | nobody)
        yield outgoing(sent, Thrown(data, world.now))
    if world.there:
        yield arrive_there(world)
    if world.back:
        yield arrive_back(world)
    if world.losses:
        fewer = replace(world, losses=world.losses - 1)
        for place in range(len(world.there)):
            yield replace(fewer, there=world.there[:place] + world.there[place + 1 :])
        for place in range(len(world.back)):
            yield replace(fewer, back=world.back[:place] + world.back[place + 1 :])
    if world.a.is_busy:
        yield tick(world, 0)
        if world.now < LAST:
            yield tick(world, 6)
    if world.stays is False:
        left = Answered("B", world.b[0], "", 0, left=True)
        yield replace(world, stays=None, back=(*world.back, left))
    a, b = world.restarts
    if a:
        yield replace(world, a=Outgoing("a2", TTL, receivers=(Receiver("B"),)), restarts=(0, b))
    if b:
        yield replace(world, b=("b2", ()), restarts=(a, 0))


def quiet(world: World) -> World:
    """What becomes of a world without further losses, restarts and time."""
    for _ in range(4):
        while world.there or world.back:
            world = arrive_there(world) if world.there else arrive_back(world)
        world = tick(world, 0)
    return world


def broken(world: World) -> str:
    for life, sender in product(("b1", "b2"), ("a1", "a2")):
        taken = [data for its, data in world.accepted if its == life and data.startswith(sender)]
        if taken != sorted(set(taken)):
            return f"{life} has accepted {taken}"
    if wrong := world.late - (world.expired & {data for _, data in world.accepted}):
        return f"{wrong} was not late"
    over = quiet(world)
    kept, known = {signal.data for signal in over.a.kept}, {data for _, data in over.accepted} | over.expired
    if world.stays is None:
        known |= kept if over.a.receivers else set()  # it was not told: they expire
    elif missing := kept - {data for life, data in over.accepted if life == over.b[0]}:
        return f"{missing} never reach {over.b[0]}"
    if missing := {data for data in over.sent if data.startswith(over.a.life)} - known:
        return f"nobody knows of {missing}"
    return ""


def explore(start: World, most: int) -> int:
    seen, queue = {start}, deque([start])
    while queue and len(seen) < most:
        for world in successors(queue.popleft()):
            if world not in seen and len(world.there) <= LENGTH and len(world.back) <= LENGTH:
                assert not broken(world), world
                seen.add(world)
                queue.append(world)
    assert not queue, "not all states were explored"
    return len(seen)


START = World(Outgoing("a1", TTL, receivers=(Receiver("B"),)), ("b1", ()))


@pytest.mark.long_but("both")
@pytest.mark.parametrize(
    "start",
    [
        START,
        replace(START, restarts=(0, 1), losses=0),
        replace(START, restarts=(1, 0), losses=0),
        replace(START, restarts=(1, 1), losses=0, thrown=1),
        replace(START, stays=False),
    ],
    ids=["losses", "receiver", "thrower", "both", "leaves"],
)
def test_every_signal_is_accepted_once_and_in_order_or_reported(start):
    assert explore(start, 400_000) > 1000


@pytest.mark.parametrize(
    ("forgotten", "start"),
    [
        ("number", START),
        ("receiver", replace(START, restarts=(0, 1), losses=0)),
        ("follows", START),
    ],
)
def test_the_search_finds_a_receiver_that_does_not_look_at(forgotten, start, monkeypatch):
    def careless(state, event):
        last = state.accepted.get((event.robot, event.life), 0)
        given = {"number": max(event.number, last + 1), "receiver": state.life, "follows": 0}
        return step_incoming(state, replace(event, **{forgotten: given[forgotten]}) if event.number else event)

    monkeypatch.setitem(STEPS, "incoming", careless)
    with pytest.raises(AssertionError, match=r"has accepted|never reach|nobody knows"):
        explore(start, 400_000)
