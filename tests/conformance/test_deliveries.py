"""No message is delivered twice, and none is lost that the rules keep (docs/signals.md).

Every trigger, with and without queue and correlation, at every place, from outside and from the own robot, and every
order of arrival and arming. `expected` says by the rules, without an engine, what each event takes.
"""

import json
from collections import deque
from dataclasses import dataclass
from itertools import product

import pytest
from engine_models import (
    Run,
    boundary,
    call,
    catch,
    correlation,
    dump,
    element,
    gateway,
    handler,
    load,
    message,
    model,
    path,
    process,
    properties,
    script,
    signal,
    start,
    sub,
    user,
)

from fame.check.explore.canonical import Forms
from fame.engine import snapshot
from fame.engine.encoding import decode, encode
from fame.engine.migration import MigrationPlan, migrate

TYPE = "geometry_msgs/msg/Vector3"
ROOT = correlation("msg.y", "M")


@dataclass(frozen=True)
class Place:
    """Where an event is, and when (by the steps of `ORDERS`).

    kept_from, armed_at  when its queue is opened, and when it begins to wait: s (start), a, b
    takes                how many messages it takes at most
    """

    kept_from: str = "s"
    armed_at: str = "a"
    takes: int = 1


PLACES = {
    "alone": Place(),
    "gateway": Place(),
    "two in sequence": Place(takes=2),
    "boundary": Place("a"),
    "non-interrupting boundary": Place("a", takes=9),
    "handler": Place("a"),
    "non-interrupting handler": Place("a", takes=9),
    "resuming handler": Place("a", takes=9),
    "sequential instances": Place("a", takes=2),
    "parallel instances": Place("a", takes=2),
    "suspended": Place("a", "b"),
    "called process": Place("a", "b"),
    "repeated task": Place(takes=2),
}
ORDERS = ("am", "ma", "mam", "mma", "amm", "mmam", "mmma", "mmmam", "mammm", "mmamm", "xma", "mxam", "axm", "amxm")
"""m: a message; x: one with another key; a: a token comes to the place."""
INNER = ("abm", "amb", "mab", "ammb", "ambm", "ammmb", "ammmbm", "axmb", "amxbm")
"""The same where the token comes later: b."""


def event(kind: str, queue: int, id: str = "c", place: str = "catch", **options: str) -> str:
    """A catching event, or a receive task."""
    said = properties(type=TYPE, queue=queue)
    if kind == "receive" and place == "catch":
        return element("receiveTask", id, said, messageRef="message_M")
    trigger = signal("M") if kind == "signal" else message("M")
    if place == "start":
        return start(id, said, trigger, interrupting=options.get("interrupting") != "")
    if place == "boundary":
        return boundary(id, "act", said, trigger, interrupting=options.get("interrupting") != "")
    return catch(id, said, trigger)


def note(id: str = "n", after: str = "c") -> str:
    return script(id, "found = found + [M.x]") + path(f"{after} {id}")


def content(kind: str, queue: int, place: str) -> tuple[str, str]:
    """What comes after the user task u, its elements; and other processes."""
    several = "<multiInstanceLoopCharacteristics isSequential='{}'><loopCardinality>2</loopCardinality>"
    several += "</multiInstanceLoopCharacteristics>"
    caught = event(kind, queue) + note()
    match place:
        case "alone":
            return caught + path("u c"), ""
        case "gateway":
            return gateway("eventBased", "g") + catch("z", signal("Z")) + caught + path("u g c") + path("g z"), ""
        case "two in sequence":
            return caught + event(kind, queue, "d") + note("k", "d") + path("u c") + path("n d"), ""
        case "boundary" | "non-interrupting boundary":
            soft = {"interrupting": ""} if place.startswith("non") else {}
            return user("act") + event(kind, queue, place="boundary", **soft) + note() + path("u act"), ""
        case "handler" | "non-interrupting handler" | "resuming handler":
            soft = {"interrupting": ""} if place.startswith("non") else {}
            begin = event(kind, queue, place="start", **soft)
            inside = user("act") + handler("h", begin + note(), resume=place.startswith("resuming"))
            return sub("q", inside) + path("u q"), ""
        case "sequential instances" | "parallel instances":
            return sub("q", several.format(str(place.startswith("seq")).lower()), caught) + path("u q"), ""
        case "repeated task":
            each = several.format("true") + properties(type=TYPE, queue=queue)
            return element("receiveTask", "c", each, messageRef="message_M") + path("u c"), ""
        case "suspended":
            pause = handler("h", start("t", signal("S")) + user("v") + path("t v"), resume=True)
            return sub("q", caught + pause) + path("u q"), ""
    return call("q", "Q", ALL) + path("u q"), process(user("v") + caught + path("v c"), id="Q")


ALL = '<extensionElements><camunda:in variables="all"/><camunda:out variables="all"/></extensionElements>'
OWN = "signal('M', {'x': number, 'y': of})"


def expected(kind: str, queue: int, place: str, order: str) -> list[float]:
    """What the events take, by the rules: of a signal each event has a copy, a message is there once."""
    where, is_signal = PLACES[place], kind == "signal"
    events = 2 if place == "two in sequence" else 1
    copies = 2 if is_signal and place == "parallel instances" else 1
    queues = [deque[float](maxlen=queue) for _ in range(events)] if is_signal else [deque[float](maxlen=queue * events)]
    taken: list[float] = []
    waiting, happened, number = 0, "s", 0

    def serve(values: deque[float]) -> None:
        nonlocal waiting
        while values and waiting < events and where.armed_at in happened:
            taken.extend([values.popleft()] * copies)
            waiting += len(taken) >= (where.takes if events == 1 else waiting + 1)
            values = queues[min(waiting, len(queues) - 1)] if events == 2 else values

    for step in order:
        number += step in "mx"
        happened += step
        if step not in "mx":
            serve(queues[0])
        elif step == "m":
            armed = waiting < events and where.armed_at in happened
            for place_of, values in enumerate(queues) if where.kept_from in happened else ():
                if not armed or (is_signal and place_of != waiting):
                    values.append(number)
            if armed:
                serve(deque([number]))
    return taken


def play(kind: str, queue: int, place: str, order: str, *, own: bool, keyed: bool, after: str) -> Run:
    """The run of an order."""
    inside, others = content(kind, queue, place)
    sends = user("p") + script("w", OWN) + path("p w p")
    outer = start() + gateway("parallel", "f") + user("u") + sends + path("s f u") + path("f p") + inside
    whole = model(process(outer), *([others] if others else []), root=ROOT if keyed else "")
    run = Run(whole, {"found": [], "key": 7.0, "number": 0.0, "of": 7.0}, after=after).run()
    number = 0.0
    for step in order:
        if step in "mx":
            number += 1
            values = {"x": number, "y": 7.0 if step == "m" else 8.0}
            if own:
                run.simulation.complete("p", {"number": number, "of": values["y"]})
            else:
                run.signal("M", values)
        elif place == "suspended" and step == "a":
            run.complete("u").signal("S")
        else:
            run.complete("u" if step == "a" else "v")
        if after == "restored":
            check_forms(run)
    return run


def check_forms(run: Run) -> None:
    """The state has a canonical form, from which it comes back; and a migration to the same model keeps it."""
    engine = run.node.engine
    forms = Forms(
        engine.program, lambda value: json.dumps(encode(value, dump)), lambda text: decode(json.loads(text), load)
    )
    form, _ = forms.walk(engine).form()
    again = forms.revived(form, run.node.host, engine.new_variables, moves=1000)
    assert forms.walk(again).form()[0] == form
    data = snapshot(engine, dump=dump)
    moved, _ = migrate(data, engine.program, engine.program, MigrationPlan())
    assert {**moved, "instances": data["instances"]} == data


CASES = [(kind, place) for kind, place in product(("signal", "message", "receive"), PLACES)
         if (kind == "receive" or place != "repeated task")
         and not (kind == "receive" and ("boundary" in place or "handler" in place))]  # fmt: skip


@pytest.mark.long_but("*-0")
@pytest.mark.parametrize("part", range(3))
@pytest.mark.parametrize(("kind", "place"), CASES)
def test_nothing_comes_twice_and_nothing_is_lost_that_a_queue_keeps(kind: str, place: str, part: int) -> None:
    orders = (INNER if PLACES[place].armed_at == "b" else ORDERS)[part::3]
    for queue, own, order in product((0, 2), (False, True), orders):
        for keyed in (False, True) if kind != "signal" else (False,):
            if "x" in order and not keyed:
                continue
            run = play(kind, queue, place, order, own=own, keyed=keyed, after="restored" if own else "straight")
            case = f"{kind} {place} queue={queue} own={own} keyed={keyed} {order}"
            right = expected(kind, queue, place, order)
            if place == "repeated task":
                assert ("c" in run.waiting) == (len(right) < 2 and "a" in order), case
            else:
                found = run.variables["found"]
                assert found == right, case
            if kind != "signal":
                came = order.count("m") + order.count("x")
                assert run.node.engine.untaken["/M"] == came - len(right), case
