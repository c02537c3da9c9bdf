"""What `fame check` says of who waits for whom: robots that wait for each other, signals too early or too many."""

import pytest
from bpmn_text import properties
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
    row,
    script,
    team,
    throw,
    timer,
    told,
)

from fame import Simulation
from fame.bpmn import read_text
from fame.check import check

PAUSE = timer("intermediateCatchEvent", "timeDuration", "PT5S")
GATE = '<eventBasedGateway id="g"/>'


def two(first: list[str], second: list[str]) -> tuple[str, str]:
    """Two processes, each a row of elements."""
    return row(*first), row(*second, mark="2")


LOST = "signals are not stored, so give the catching event a queue"
WARNINGS = {
    "two robots that wait for each other": (
        two([catch("a"), throw("b", "found")], [catch("c", "found"), throw("d")]),
        "a: waits for /done, but DINGO, which throws it, waits for /found first: they wait for each other",
    ),
    "a robot that waits for itself": (
        two([catch("a"), throw("b")], [script("x = 1")]),
        "a: waits for /done, which only REX itself throws, later: it waits forever",
    ),
    "a robot that begins with what it throws later": (
        (row(script("x = 1")), event("startEvent", "s2", "done") + throw("b") + ends("e2") + flows("s2 b e2")),
        "s2: waits for /done, which only DINGO itself throws, later: it waits forever",
    ),
    "a signal that comes before its catcher": (
        two([throw("a")], [PAUSE, catch("c")]),
        f'a: throws /done as the mission begins, before "done" (c) can wait for it: {LOST}',
    ),
    "the same by a script": (
        two([throw("a")], [script("await sleep(1)"), catch("c")]),
        f'a: throws /done as the mission begins, before "done" (c) can wait for it: {LOST}',
    ),
    "signals in the wrong order": (
        two([throw("a"), throw("b", "found")], [catch("c", "found"), catch("d")]),
        f'a: throws /done as the mission begins, before "done" (d) can wait for it: {LOST}',
    ),
    "a throw and then a catch of the same": (
        two([throw("a"), script("x = 1"), catch("b")], [catch("c")]),
        f'b: waits for /done, which only "done" (a) throws, immediately before: {LOST}',
    ),
    "a queue beyond the depth": (
        two([script("await sleep(1)"), throw("a")], [catch("c", queue="101")]),
        "c: queues up to 101 messages of /done, but its qos.depth is 100: set qos.depth=101, or messages may be lost",
    ),
    "a queue beyond the depth that the throw has": (
        two([script("await sleep(1)"), throw("a", qos_depth="5")], [catch("c", queue="6", qos_depth="10")]),
        "c: queues up to 6 messages of /done, but its qos.depth is 5: set qos.depth=6, or messages may be lost",
    ),
    "a queue of what an event before it catches": (
        two([script("await sleep(1)"), throw("a")], [catch("c"), script("x = 1", "u"), catch("d", queue="2")]),
        'd: its queue keeps the /done that "done" (c) catches, too: one signal passes both',
    ),
}  # fmt: skip


@pytest.mark.parametrize(("contents", "expected"), WARNINGS.values(), ids=WARNINGS.keys())
def test_it_is_a_warning(contents: tuple[str, str], expected: str) -> None:
    assert expected in told(team(*contents), "warning")


FINE = {
    "a question and its answer": two([throw("a"), catch("b", "found")], [catch("c"), throw("d", "found")]),
    "a wait with another way on": (
        START + GATE + catch("a") + PAUSE + throw("b", "found") + ends("e", "f") + flows("s g a e", "g w b f"),
        row(catch("c", "found"), throw("d"), mark="2"),
    ),
    "a choice that may throw first": (
        START + choice("g", 'default="g-a"') + script("x = 1") + catch("a") + throw("b", "found") + ends("e")
        + flows("s t g a b e") + flow("g", "b", "x > 1"),
        row(catch("c", "found"), throw("d"), mark="2"),
    ),
    "a signal for which somebody waits at once": two([throw("a")], [script("x = 1"), catch("c")]),
    "a signal that a queue keeps": two([throw("a")], [PAUSE, catch("c", queue="1")]),
    "a signal that comes later": two([script("await sleep(9)"), throw("a")], [PAUSE, catch("c")]),
    "a signal that is repeated": (
        START + throw("a") + script("await sleep(1)") + flows("s a t a"), row(PAUSE, catch("c"), mark="2"),
    ),
    "a signal that starts another robot": (
        row(throw("a")), event("startEvent", "s2", "done") + ends("e2") + flows("s2 e2"),
    ),
    "a wait that may be over at once": two([throw("a")], [script("await until(lambda: True)"), catch("c")]),
    "a throw and a catch of what others throw too": two([throw("a"), catch("b")], [throw("c"), catch("d")]),
    "a throw and a catch with a queue": two([throw("a"), catch("b", queue="1")], [catch("c")]),
    "a throw and a catch after a pause": two([PAUSE.replace("w", "v", 1), throw("a"), script("await sleep(1)"),
                                              catch("b", queue="1")], [catch("c")]),
    "a queue as long as the depth": two([script("await sleep(1)"), throw("a")], [catch("c", queue="100")]),
    "a wait for two of a signal": two([script("await sleep(1)"), throw("a")], [catch("c", queue="1"), catch("d")]),
    "a queue on another path": (
        row(script("await sleep(1)"), throw("a")),
        '<startEvent id="s2"/>' + script("x = 1", "u") + choice("g", 'default="g-c"') + catch("c")
        + catch("d", queue="2") + ends("e2", "e3") + flows("s2 u g c e2", "d e3") + flow("g", "d", "x > 1"),
    ),
    "a queue of all": two(
        [script("await sleep(1)"), throw("a", qos_history="keep_all")], [catch("c", queue="500")]
    ),
}  # fmt: skip


@pytest.mark.parametrize("contents", FINE.values(), ids=FINE.keys())
def test_it_is_not_blamed(contents: tuple[str, str]) -> None:
    assert told(team(*contents)) == []


def test_robots_of_one_pool_may_answer_each_other() -> None:
    text = team(row(throw("a"), catch("b")), row(catch("c"), mark="2"))
    many = text.replace('processRef="P1"/>', 'processRef="P1"><participantMultiplicity minimum="2"/></participant>')
    assert many != text
    assert told(many) == []


def test_it_is_a_note_where_others_may_throw_it() -> None:
    text = alone(row(throw("a"), catch("b")))
    assert told(text) == []
    assert f'b: waits for /done, which only "done" (a) throws, immediately before: {LOST}' in told(text, "note")
    waiting = alone(row(catch("a"), throw("b")))
    assert told(waiting) == []
    assert "a: waits for /done, which only P itself throws, later: it waits forever" in told(waiting, "note")


def test_a_script_that_computes_what_it_throws_may_throw_anything() -> None:
    def texts(name: str) -> list[str]:
        told_of = told(
            team(*two([catch("a"), script(f"x = 'done'; signal({name})")], [catch("c", "found"), throw("d")]))
        )
        return [text for text in told_of if "each other" in text]

    assert len(texts("'found'")) == 2
    assert len(texts("'found', {}")) == 2
    for computed in ("x", "'' + x", "'%s' % x", "'do' 'ne'"):
        assert texts(computed) == [], computed


def called(*elements: str) -> str:
    """The process ``Q``, after the process that calls it."""
    return f"</process><process id='Q'>{row(*elements, mark='9')}"


def within(*elements: str, more: str = "") -> str:
    """A sub-process ``p``."""
    return f'<subProcess id="p">{row(*elements, mark="p")}{more}</subProcess>'


def boundary(task: str, interrupting: str) -> str:
    at = f'boundaryEvent attachedToRef="{task}" cancelActivity="{interrupting}"'
    return event(at, "b", "done").replace(f"</{at}>", "</boundaryEvent>")


HANDLER = (
    '<subProcess id="h" triggeredByEvent="true">' + event("startEvent", "hs", "done") + ends("he") + flows("hs he")
    + "</subProcess>"
)  # fmt: skip
KEPT, TAKES = catch("d", queue="1"), script("await receive('/done')", "r")
RECEIVES = '<receiveTask id="r" messageRef="M"/>'
MESSAGES = '<intermediateCatchEvent id="{}">{}<messageEventDefinition messageRef="M"/></intermediateCatchEvent>'
PASSED = {
    "a sub-process": ("c", row(within(catch("c")), KEPT)),
    "a called process": ("c", row(call("k", "Q"), KEPT) + called(catch("c"))),
    "a process that a sub-process calls": ("c", row(within(call("k", "Q")), KEPT) + called(catch("c"))),
    "a script that receives it": ("r", row(TAKES, KEPT)),
    "a script that subscribes to it": (
        "r", row(script("async for m in robot.subscribe('/done'): break", "r"), KEPT),
    ),
    "a script of a called process": ("r", row(call("k", "Q"), KEPT) + called(TAKES)),
    "an event-based gateway": ("c", START + GATE + catch("c") + PAUSE + KEPT + ends("e") + flows("s g c d e", "g w d")),
    "a boundary event": ("b", row(script("await sleep(9)"), KEPT) + boundary("t", "true") + flow("b", "d")),
    "a boundary event beside it": (
        "b", row(script("await sleep(9)"), KEPT) + boundary("t", "false") + ends("be") + flow("b", "be"),
    ),
    "an event sub-process": ("hs", row(within(script("await sleep(5)", "u"), more=HANDLER), KEPT)),
    "an event sub-process of a called process": (
        "hs", row(call("k", "Q"), KEPT) + called(script("await sleep(5)", "u")) + HANDLER,
    ),
    "a receive task, which takes messages": ("r", row(RECEIVES, KEPT)),
    "an event that takes messages": ("m", row(MESSAGES.format("m", ""), KEPT)),
    "nothing: messages, each for one": ("", row(RECEIVES, MESSAGES.format("d", properties(queue="1")))),
    "nothing: a gateway that starts the process": (
        "", GATE.replace("/>", ' instantiate="true"/>') + catch("c") + catch("c2", "found") + KEPT + ends("e")
        + flows("g c d e", "g c2 d"),
    ),
    "nothing: a receive task that starts the process": (
        "", RECEIVES.replace("/>", ' instantiate="true"/>') + KEPT + ends("e") + flows("r d e"),
    ),
    "nothing: a boundary event that leads elsewhere": (
        "", row(script("await sleep(9)"), KEPT) + boundary("t", "true") + ends("be") + flow("b", "be"),
    ),
    "nothing: the latest message": ("", row(script("robot.latest('/done')", "r"), KEPT)),
    "nothing: a queue that begins later": ("", row(catch("c"), within(KEPT))),
    "nothing: a called queue that begins later": ("", row(catch("c"), call("k", "Q")) + called(KEPT)),
}  # fmt: skip


@pytest.mark.parametrize(("first", "content"), PASSED.values(), ids=PASSED)
def test_one_signal_passes_a_queue_and_what_catches_it_before(first: str, content: str) -> None:
    """The run agrees: the queue lets its token pass where something is told."""
    model = alone(content).replace("</definitions>", '<message id="M" name="done"/></definitions>')
    texts = [text for text in told(model) if "passes both" in text]
    name = first if first in ("r", "m") else f'"done" ({first})'
    assert texts == (
        [f"d: its queue keeps the /done that {name} catches, too: one signal passes both"] if first else []
    )
    simulation = Simulation(read_text(model, file="bad.bpmn"), process="P")
    simulation.run(until=1)
    simulation.signal("done")
    simulation.run()
    assert bool(simulation.instances[0].visits["d"]) is (bool(first) or "latest" in content)


TOO_LATE = "signals are not stored, and a queue there begins too late: throw it later, or until it is acknowledged"


@pytest.mark.parametrize("queue", [{}, {"queue": "1"}])
@pytest.mark.parametrize(
    ("around", "before", "late"),
    [("sub-process", [PAUSE], True), ("call", [PAUSE], True), ("sub-process", [], False), ("call", [], False),
     ("", [PAUSE], False)],
)  # fmt: skip
def test_a_queue_keeps_what_comes_after_its_scope_has_begun(
    around: str, before: list[str], late: bool, queue: dict[str, str]
) -> None:
    inside = [*([] if before else [PAUSE]), catch("c", **queue)]
    scope = {"": inside, "sub-process": [within(*inside)], "call": [call("k", "Q")]}[around]
    text = team(row(throw("a")), row(*before, *scope, mark="2") + (called(*inside) if around == "call" else ""))
    early = 'a: throws /done as the mission begins, before "done" (c) can wait for it: '
    assert told(text) == ([early + (TOO_LATE if late else LOST)] if late or not queue else [])


def test_a_queue_of_a_boundary_event_keeps_what_comes_while_its_activity_runs() -> None:
    kept = boundary("t", "true").replace('cancelActivity="true">', 'cancelActivity="true">' + properties(queue="1"))
    content = row(PAUSE, script("await sleep(9)"), mark="2") + kept + ends("be") + flow("b", "be")
    early = 'a: throws /done as the mission begins, before "done" (b) can wait for it: '
    assert told(team(row(throw("a")), content)) == [early + TOO_LATE]


@pytest.mark.parametrize("queue", [{}, {"queue": "1"}])
@pytest.mark.parametrize("around", ["sub-process", "call"])
def test_a_throw_is_lost_on_a_catch_in_the_activity_after_it(around: str, queue: dict[str, str]) -> None:
    inside = catch("c", **queue)
    scope = within(inside) if around == "sub-process" else call("k", "Q")
    content = row(throw("a"), scope) + (called(inside) if around == "call" else "")
    expected = f'c: waits for /done, which only "done" (a) throws, immediately before: {TOO_LATE}'
    assert expected in told(team(content, row(script("x = 1", "t2"), mark="2")))
    twice = row(throw("a"), call("k", "Q")) + row(script("x = 1", "t2"), call("l", "Q"), mark="2")
    assert expected not in told(team(twice + called(inside), row(script("x = 1", "t3"), mark="3")))


COMPUTED = [
    "n = 'done'; signal(n)",
    "signal(f'do{1}')",
    "signal(name='do' + 'ne')",
    "for n in ('done', 'found'): signal(n)",
    "robot.publish(f'/do{1}', 'std_msgs/msg/Empty')",
    "say = signal; say('done')",
    "robot.random.choice([signal])('done')",
    "import json; json.dumps(robot)",
    "getattr(robot, 'publish')('/done', 'std_msgs/msg/Empty')",
    "eval('signal(1)')",
]


@pytest.mark.parametrize("text", COMPUTED)
def test_of_a_topic_that_a_script_may_compute_it_is_not_said_that_nothing_throws_it(text: str) -> None:
    assert told(team(*two([script(text)], [catch("c")]))) == []
    assert told(team(*two([throw("a"), catch("b")], [script(text, "u")]))) == []


@pytest.mark.parametrize("text", ["n = 'done'; m = await receive(n)", "robot.latest(f'/do{1}')"])
def test_of_a_topic_that_a_script_may_receive_it_is_not_said_that_nothing_catches_it(text: str) -> None:
    assert told(team(*two([script(text)], [script("await sleep(1)", "u"), throw("c")]))) == []
    assert told(team(*two([script("await sleep(1)"), script(text, "u")], [throw("c")]))) == []


@pytest.mark.parametrize("text", ["signal(f'led_{1}')", "robot.publish(f'do{1}', 'std_msgs/msg/Empty')", "robot.now"])
def test_what_a_script_computes_is_known_as_far_as_its_beginning(text: str) -> None:
    assert told(team(*two([script(text)], [catch("c")]))) == ["c: waits for /done, but nothing in bad.bpmn throws it"]


@pytest.mark.parametrize("elements", [[throw("a"), catch("b")], [catch("a"), throw("b")]])
def test_what_a_scenario_publishes_may_come_in_time(elements: list[str]) -> None:
    model = read_text(team(*two(elements, [script("x = 1")])), file="bad.bpmn")
    assert check(model)
    assert check(model, outside={"/done"}) == []
