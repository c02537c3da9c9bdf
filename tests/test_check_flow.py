"""What `fame check` says of flows: start and end events, endless loops, conditions of choices, parallel joins."""

from html import escape

import pytest
from check_drawing import (
    START,
    alone,
    call,
    catch,
    choice,
    ends,
    event,
    flow,
    flows,
    parallel,
    row,
    script,
    throw,
    timer,
    told,
)

FORK = START + parallel("g") + script("x = 1", "a") + script("x = 2", "b") + parallel("j") + ends("e", "f")
LEAVING = choice("c", 'default="c-j"') + flows("s g a j e", "g b c j") + flow("c", "f", "1 > 0")
TERMINATE = '<endEvent id="f"><terminateEventDefinition/></endEvent>'
PAIR = START + script("x = 1", "a") + script("x = 2", "b")
BOUNDARY = timer("boundaryEvent", "timeDuration", "PT1S", 'attachedToRef="b" {}')
LINK = '<intermediate{}Event id="{}"><linkEventDefinition name="l"/></intermediate{}Event>'

WARNINGS = {
    "a flow out of an end event": (
        row(script("x = 1")) + script("y = 1", "after") + flows("e after"),
        "e-after: leaves the end event e, where every token ends: this flow is never taken",
    ),
    "a flow into a start event": (
        row(script("x = 1")) + flows("t s"),
        "t-s: leads into the start event s, but start events have no incoming flows",
    ),
    "an end event without a start event": (
        script("x = 1") + ends("e") + flows("t e"),
        "t: has no start event before it, although there are end events: add a start event",
    ),
    "the same in a sub-process": (
        row(f'<subProcess id="p">{script("x = 1")}{ends("pe")}{flows("t pe")}</subProcess>'),
        "t: has no start event before it, although there are end events: add a start event",
    ),
    "a loop without a way out": (
        PAIR + flows("s a b a"),
        "a: is in a loop with b that no flow leaves and in which nothing waits: it runs forever",
    ),
    "a loop of one": (
        START + script("x = 1") + flows("s t t"),
        "t: is in a loop that no flow leaves and in which nothing waits: it runs forever",
    ),
    "a loop through a link": (
        START + script("x = 1") + LINK.format("Throw", "l1", "Throw") + LINK.format("Catch", "l2", "Catch")
        + flows("s t l1", "l2 t"),
        "t: is in a loop with l1, l2 that no flow leaves and in which nothing waits: it runs forever",
    ),
    "a parallel join behind a branch that may leave": (
        FORK + LEAVING,
        "j: waits for all flows from g, but a token may leave at c: then it waits forever",
    ),
    "the same by a boundary event": (
        FORK + flows("s g a j e", "g b j", "w f") + BOUNDARY.format(""),
        "j: waits for all flows from g, but a token may leave at b: then it waits forever",
    ),
}  # fmt: skip


COMPENSATION = '<boundaryEvent id="b" attachedToRef="t"><compensateEventDefinition/></boundaryEvent>'
UNDO = script("x = 0", "u").replace("<scriptTask", '<scriptTask isForCompensation="true"')
UNDONE = COMPENSATION + UNDO + '<association id="as" sourceRef="b" targetRef="u"/>'
HANDLER = f'<subProcess id="h" triggeredByEvent="true">{event("startEvent", "hs", "done")}</subProcess>'
LINKED = START + LINK.format("Throw", "l1", "Throw") + LINK.format("Catch", "l2", "Catch") + script("x = 1")
WAIT = timer("intermediateCatchEvent", "timeDuration", "PT1S")
EVENT_BASED = START + '<eventBasedGateway id="g"/>' + catch("c") + WAIT
FORBIDDEN = {
    "a flow into a boundary event": (
        START + parallel("g") + script("x = 1", "b") + BOUNDARY.format("") + flows("s g b", "g w"),
        "error: g-w: leads into the boundary event w: expected an activity, a gateway or another event",
    ),
    "a flow into a compensation handler": (
        row(script("x = 1")) + UNDONE + flows("t u"),
        "error: t-u: leads into the compensation handler u: expected an association with its event",
    ),
    "a flow out of a compensation handler": (
        row(script("x = 1")) + UNDONE + flows("u e"),
        "error: u-e: leaves the compensation handler u: put what follows into a sub-process with it",
    ),
    "a flow out of a compensation event": (
        row(script("x = 1")) + UNDONE + flows("b e"),
        "error: b-e: leaves the compensation event b: expected an association with a handler",
    ),
    "a compensation handler that is no activity": (
        row(script("x = 1")) + UNDONE.replace(UNDO, ends("u")),
        "error: b: is associated with u: expected an activity with isForCompensation=true",
    ),
    "a compensation handler that is not marked as one": (
        row(script("x = 1")) + UNDONE.replace(UNDO, script("x = 0", "u")),
        "warning: b: is associated with u: expected an activity with isForCompensation=true",
    ),
    "a flow out of a throwing link event": (
        LINKED + ends("e") + flows("s l1 e", "l2 t"),
        "error: l1-e: leaves the link event l1: expected it to leave the catching one",
    ),
    "a flow into a catching link event": (
        LINKED + parallel("g") + flows("s g l1", "g l2 t"),
        "warning: g-l2: leads into the link event l2: expected a gateway before what follows it",
    ),
    "a flow into an event sub-process": (
        row(script("x = 1")) + HANDLER + flows("t h"),
        "error: t-h: leads into the event sub-process h: expected only its event to start it",
    ),
    "a flow out of an event sub-process": (
        row(script("x = 1")) + HANDLER + flows("h e"),
        "error: h-e: leaves the event sub-process h: put what follows into it",
    ),
    "a condition at a flow out of an event": (
        START + script("x = 1") + flow("s", "t", "x > 0"),
        "warning: s-t: has a condition, but leaves s: expected an exclusive gateway before it",
    ),
    "a flow into what starts a process": (
        START + '<receiveTask id="t" messageRef="M" instantiate="true"/>' + flows("s t"),
        "warning: s-t: leads into t, which starts no process then: expected instantiate=false",
    ),
    "two ways to an event behind an event-based gateway": (
        EVENT_BASED + script("x = 1") + flows("s g c", "g w t w"),
        "warning: g-w: leads to w, which has other incoming flows: expected only this one",
    ),
    "a boundary event behind an event-based gateway": (
        EVENT_BASED + '<receiveTask id="b" messageRef="M"/>' + BOUNDARY.format("").replace('"w"', '"v"')
        + flows("s g c", "g w", "g b"),
        "error: g-b: leads to b, which has boundary events: expected further events of the gateway",
    ),
    "a start event with a trigger in a sub-process": (
        row(f'<subProcess id="p"><startEvent id="ps"/>{event("startEvent", "pt", "done")}</subProcess>'),
        "error: pt: starts nothing, since a sub-process starts at a none start event: expected an event sub-process",
    ),
    "two times of a timer": (
        START + WAIT.replace("<timeDuration", "<timeDate>2026-01-01</timeDate><timeDuration") + flows("s w"),
        "error: w: has two of <timeDate> and <timeDuration>: expected one time",
    ),
    "two scripts": (
        row(script("x = 1").replace("</script>", "</script><script>x = 2</script>")),
        "error: t: has two of <script> and <script>: expected one script",
    ),
    "two loops": (
        row(script("x = 1").replace("<script>", '<standardLoopCharacteristics loopMaximum="2"/>'
        "<multiInstanceLoopCharacteristics><loopCardinality>3</loopCardinality></multiInstanceLoopCharacteristics><script>")),
        "error: t: has two of <standardLoopCharacteristics> and <multiInstanceLoopCharacteristics>: expected one loop",
    ),
    "two conditions": (
        START + choice("g", 'default="g-e"') + script("x = 1") + ends("e") + flows("s g e")
        + flow("g", "t", "x > 0").replace(
            "</sequenceFlow>", "<conditionExpression>1</conditionExpression></sequenceFlow>"),
        "error: g-t: has two of <conditionExpression> and <conditionExpression>: expected one condition",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("content", "expected"), FORBIDDEN.values(), ids=FORBIDDEN.keys())
def test_what_the_standard_forbids_is_told(content: str, expected: str) -> None:
    level, _, text = expected.partition(": ")
    assert text in told(alone(content), level)


def test_an_empty_time_beside_another_does_no_harm() -> None:
    empty = WAIT.replace("<timeDuration", "<timeDate/><timeDuration")
    assert told(alone(START + empty + flows("s w")), "error") == []


@pytest.mark.parametrize(("content", "expected"), WARNINGS.values(), ids=WARNINGS.keys())
def test_it_is_a_warning(content: str, expected: str) -> None:
    assert expected in told(alone(content), "warning")


FINE = {
    "no start event and no end event": PAIR.replace(START, "") + flows("a b"),
    "a process that an event-based gateway starts": (
        '<eventBasedGateway id="r" instantiate="true"/>' + catch("a") + ends("e") + flows("r a e")
    ),
    "an ad-hoc sub-process": row(f'<adHocSubProcess id="p">{script("x = 1", "a")}</adHocSubProcess>'),
    "a loop that waits": START + script("await sleep(1)", "a") + script("x = 2", "b") + flows("s a b a"),
    "a loop with a timer": (
        START + timer("intermediateCatchEvent", "timeDuration", "PT1S") + script("x = 1") + flows("s w t w")
    ),
    "a loop with a call": START + call("c", "GoTo") + script("x_goal = y_goal = 1") + flows("s t c t"),
    "a loop with a user task": START + '<userTask id="u"/>' + flows("s u u"),
    "a loop that an error ends": START + script('raise BpmnError("lost")') + flows("s t t"),
    "a loop with a way out": (
        PAIR + choice("c", 'default="c-e"') + ends("e") + flows("s a b c e") + flow("c", "a", "x > 1")
    ),
    "a loop with a way out by a boundary event": PAIR + flows("s a b a", "w e") + BOUNDARY.format("") + ends("e"),
    "a loop that ends where no condition is true": PAIR + flows("s a b") + flow("b", "a", "x > 1"),
    "a loop that another token ends": (
        PAIR + parallel("g") + TERMINATE + flows("s g a b a", "g f")
    ),
    "a loop that a handler ends": (
        START + throw("a") + flows("s a a") + '<subProcess id="h" triggeredByEvent="true">'
        + event("startEvent", "hs", "done") + ends("he") + flows("hs he") + "</subProcess>"
    ),
    "a loop in a sub-process that may be interrupted": (
        row(f'<subProcess id="p"><startEvent id="ps"/>'
            f'{throw("a")}{flows("ps a a")}</subProcess>')
        + event("boundaryEvent", "b", "done").replace('name="done"', 'attachedToRef="p"') + ends("be") + flows("b be")
    ),
    "a loop that joins": (
        PAIR + parallel("g") + parallel("j") + script("await sleep(1)", "z")
        + flows("s g a j b j", "g z j")
    ),
    "a join behind a choice that comes back": (
        FORK.replace('<endEvent id="f"/>', "") + choice("c", 'default="c-j"') + choice("m")
        + flows("s g a j e", "g m b c j") + flow("c", "m", "x > 1")
    ),
    "a join behind a branch that ends all": (
        FORK.replace('<endEvent id="f"/>', TERMINATE) + LEAVING
    ),
    "a join behind a branch that tells the other": (
        FORK.replace('<endEvent id="f"/>', event("endEvent", "f", "done")) + LEAVING
    ),
    "a join behind a branch that is watched": (
        FORK + flows("s g a j e", "g b j", "w f") + BOUNDARY.format('cancelActivity="false"')
    ),
}  # fmt: skip


@pytest.mark.parametrize("content", FINE.values(), ids=FINE.keys())
def test_it_is_not_blamed(content: str) -> None:
    assert told(alone(content)) == []


NO_WAY_OUT = "g: has no way out if none of its conditions is true: mark one of its flows as the default"


def choosing(*conditions: str) -> str:
    """An exclusive gateway with these conditions."""
    names = [f"o{number}" for number in range(len(conditions))]
    leaving = (flow("g", name, escape(text)) for name, text in zip(names, conditions, strict=True))
    content = START + script("x = y = 1") + choice("g") + ends(*names) + flows("s t g")
    return alone(content + "".join(leaving))


@pytest.mark.parametrize(
    "conditions",
    [
        ("x", "not x"),
        ("${x}", "${!x}"),
        ("${x &&  y}", "${!(x and y)}"),
        ("x > 3", "x <= 3"),
        ("${x > 3}", "${3 >= x}"),
        ("${x gt 3}", "${x le 3}"),
        ("=x > 3", "=not(x > 3)"),
        ("=x = 3", "=x != 3"),
        ("x < 0", "0 <= x < 10", "x >= 10"),
        ("x < -1", "x > -2"),
        ("x < y", "x == y", "x > y"),
        ("x < y", "y <= x"),
        ("x and y", "not x or not y"),
        ("x == 'a'", "x != 'a'"),
        ("x in (1, 2)", "x not in (1, 2)"),
        ("x is None", "x is not None"),
        ("${empty x}", "${not empty x}"),
        ("${x == true}", "${x == false}"),
        ("len(str(x)) > 1", "len(str(x)) <= 1"),
    ],
)
def test_conditions_that_cover_all_cases_leave_a_way_out(conditions: tuple[str, ...]) -> None:
    assert told(choosing(*conditions)) == []


@pytest.mark.parametrize(
    "conditions",
    [
        ("x", "y"),
        ("x > 3", "x < 3"),
        ("x > 3", "y <= 3"),
        ("x < 0", "0 <= x < 10", "x > 10"),
        ("x and y", "not x and not y"),
        ("x == 'a'", "x == 'b'"),
        ("x == 1", "not x"),
        ("${x >= 3}", "${x <= 2.5}"),
        ("__import__('random').random() > 0.5", "__import__('random').random() <= 0.5"),
        ("${x > 3 ? true : y}", "${x <= 3}"),
    ],
)
def test_conditions_that_leave_a_case_out_are_blamed(conditions: tuple[str, ...]) -> None:
    assert told(choosing(*conditions)) == [NO_WAY_OUT]


@pytest.mark.parametrize(
    "conditions",
    [("not " * 900 + "x", "x"), ("x == 1" + "0" * 400, "x == 2"), (" and ".join(f"x == {n}" for n in range(99)), "y")],
    ids=["nested deeply", "a large number", "many cases"],
)
def test_conditions_that_cannot_be_judged_are_blamed(conditions: tuple[str, ...]) -> None:
    assert NO_WAY_OUT in told(choosing(*conditions))
