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
