"""Boundary events and event sub-processes: every trigger, at every depth, interrupting or not, from inside and outside.

A sub-process ``p`` is guarded by one of them, ``b``, which leads to ``k``. In it ``u`` waits, and ``go`` leads to what
fires from inside. Around it stand as many scopes as the depth says: sub-processes and calls by turns.
"""

from collections.abc import Iterator
from itertools import product

import pytest
from conftest import Play
from engine_models import (
    CANCEL,
    Run,
    boundary,
    call,
    condition,
    element,
    end,
    error,
    escalation,
    handler,
    message,
    model,
    path,
    process,
    script,
    signal,
    start,
    sub,
    throw,
    timer,
    user,
)

from fame.bpmn.model import Definitions

TRIGGERS = {
    "signal": signal("A"),
    "message": message("M"),
    "timer": timer("PT5S"),
    "condition": condition("x > 0"),
    "error": error("E"),
    "escalation": escalation("X"),
    "cancel": CANCEL,
    "multiple": message("M") + signal("A"),
    "parallel multiple": signal("A") + signal("B"),
}
INSIDE = {
    "signal": throw("t", signal("A")),
    "condition": script("t", "x = 1"),
    "error": end("t", error("E")),
    "escalation": throw("t", escalation("X")),
    "cancel": end("t", CANCEL),
    "multiple": throw("t", signal("A")),
    "parallel multiple": throw("t", signal("B"), signal("A")),
}
"""What fires each trigger from inside its scope. Messages are for others, and time passes outside."""
OUTSIDE = {
    "signal": lambda run: run.signal("A"),
    "message": lambda run: run.message("M"),
    "timer": lambda run: run.run(6),
    "condition": lambda run: run.complete("far", {"x": 1}),
    "multiple": lambda run: run.message("M"),
    "parallel multiple": lambda run: run.signal("A").signal("B"),
}
ENDING = ("error", "cancel")
"""Triggers that interrupt, whatever is written: what failed or was cancelled has ended."""
KINDS = {"boundary": TRIGGERS, "event sub-process": [name for name in TRIGGERS if name != "cancel"]}


def cases() -> Iterator[tuple[str, str, bool, int, str]]:
    for place, interrupting, depth in product(KINDS, (True, False), range(4)):
        for trigger, whence in product(KINDS[place], ("inside", "outside")):
            if trigger in (INSIDE if whence == "inside" else OUTSIDE):
                yield place, trigger, interrupting, depth, whence


def guarded(place: str, trigger: str, interrupting: bool) -> str:
    """The sub-process with what guards it."""
    said = {"parallelMultiple": "true"} if trigger.startswith("parallel") else {}
    inner, tag = user("u") + user("go"), "transaction" if trigger == "cancel" else "subProcess"
    inner += INSIDE[trigger] + path("go t") if trigger in INSIDE else ""
    if place == "boundary":
        event = boundary("b", "p", TRIGGERS[trigger], interrupting=interrupting, **said)
        return element(tag, "p", inner) + event + script("k") + path("b k")
    begin = element("startEvent", "b", TRIGGERS[trigger], isInterrupting=str(interrupting).lower(), **said)
    return sub("p", inner, handler("h", begin + script("k") + path("b k")))


def surrounded(content: str, depth: int) -> Definitions:
    """The model: the content with scopes around it, and a task beside them that sets ``x``."""
    called = []
    for level in range(depth):
        if level % 2:
            called.append(process(start(f"s{level}") + content + path(f"s{level} {first(content)}"), id=f"Q{level}"))
            content = call(f"o{level}", f"Q{level}")
        else:
            content = sub(f"o{level}", content)
    return model(process(start() + content + user("far") + path(f"s {first(content)}") + path("s far")), *called)


def first(content: str) -> str:
    """The id of the first element of some content."""
    return content.partition('id="')[2].partition('"')[0]


def expected(place: str, trigger: str, interrupting: bool, depth: int, whence: str) -> tuple[str, str]:
    """The log when it has fired, and what is told when all is over after that."""
    ends = interrupting or trigger in ENDING
    opening = "".join(f"(o{level} " + (f"s{level} " if level % 2 else "") for level in reversed(range(depth)))
    closing = "".join(f" o{level})" for level in range(depth))
    fired = {"error": "t t!E"}.get(trigger, "t") if whence == "inside" else ""
    waiting = "-u" if whence == "inside" else "-u -go"
    if place == "boundary":
        happens = f"b -p {waiting} k" if ends else "b k"
        if trigger == "cancel":
            happens = "-u b -p k"
        over = closing if ends else f" u) p){closing}"
    else:
        happens = f"{waiting} (h b k h)" if ends else "(h b k h)"
        over = f" p){closing}" if ends else f" u) p){closing}"
    return f"s {opening}(p (u {f'go {fired}' if fired else '(go'} {happens}", over


@pytest.mark.parametrize(("place", "trigger", "interrupting", "depth", "whence"), list(cases()))
def test_each_fires_at_each_place(
    play: Play, place: str, trigger: str, interrupting: bool, depth: int, whence: str
) -> None:
    definitions = surrounded(guarded(place, trigger, interrupting), depth)
    run = play(definitions, {"x": 0}).run(1)
    fire(run, trigger, whence)
    happened, over = expected(place, trigger, interrupting, depth, whence)
    ends = interrupting or trigger in ENDING
    assert run.log.replace(" (far", "").replace(" far)", "").removesuffix(" =completed") == happened + (
        over if ends else ""
    )
    assert run.visits["b"] == run.visits["k"] == 1
    assert ("u" in run.waiting) is not ends
    for id in ("go", "u", "far"):
        if id in run.waiting:
            run.complete(id)
    assert run.status == "completed"
    assert not run.left_behind()


def fire(run: Run, trigger: str, whence: str) -> None:
    if whence == "inside":
        run.complete("go")
    else:
        OUTSIDE[trigger](run)
