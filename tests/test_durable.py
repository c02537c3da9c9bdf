"""A robot goes on from any record of its journal, and ends as if nothing had happened."""

import json
import sys
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).parent / "conformance"))

from durable_runs import Do, Recorded, Step, Until, cut, left, play, prefixes, state_at
from engine_models import (
    boundary,
    call,
    catch,
    element,
    end,
    flow,
    gateway,
    handler,
    model,
    path,
    process,
    properties,
    script,
    signal,
    start,
    sub,
    throw,
    timer,
    user,
)

from fame.clock import SECOND
from fame.engine.snapshot import snapshot
from fame.robot.journal import Journal, read_segment
from fame.robot.state_tables import restore_engine
from fame.robot.stored_values import StoredValues, dump


def on(name: str, payload: Any = None) -> Step:
    return Do("signal", (name, payload))


def done(id: str, **values: Any) -> Step:
    return Do("complete", (id, values))


TYPED = properties(type="std_msgs/msg/Int32")
LOOP = (
    '<multiInstanceLoopCharacteristics isSequential="{}"><loopCardinality>3</loopCardinality>'
    "</multiInstanceLoopCharacteristics>"
)
ONCE = LOOP.format("true").replace("3", "1")

MODELS: dict[str, tuple[str, list[Step]]] = {
    "tasks of people and scripts": (
        start() + script("a", "x = 1\nitems = [x]") + user("u") + script("b", "items.append(x + y)") + user("v") + end()
        + path("s a u b v e"),
        [Until(1), done("u", y=2), Until(2), done("v")],
    ),
    "variables that scripts delete": (
        start() + script("a", "x = y = loopCounter = 9") + user("u") + script("b", "del x") + user("v")
        + script("c", "del y\nx = 2") + sub("p", ONCE + start("ps") + user("w") + script("d", "del loopCounter")
        + user("m") + script("k", "seen = loopCounter") + end("pe") + path("ps w d m k pe")) + end()
        + path("s a u b v c p e"),
        [Until(1), done("u"), Until(2), done("v"), Until(3), done("w"), Until(4), done("m")],
    ),
    "timers": (
        start() + script("a", "n = 0") + catch("c", timer("PT5S")) + user("u") + end() + path("s a c u e")
        + boundary("b", "u", timer("R3/PT2S", "Cycle"), interrupting=False) + script("k", "n += 1") + path("b k")
        + boundary("late", "u", timer("PT30S")) + path("late e"),
        [Until(4), Until(6), Until(9), Until(40)],
    ),
    "signals and queues": (
        start() + user("u") + catch("c", signal("A"), TYPED) + catch("d", signal("A"), properties(queue="5")) + end()
        + path("s u c d e"),
        [Until(1), on("A", 1), on("A", 2), done("u"), Until(2), on("A", 3), Until(3)],
    ),
    "forks and joins": (
        start() + gateway("parallel", "g") + user("a") + user("b") + gateway("parallel", "j") + end()
        + path("s g a j e") + path("g b j"),
        [Until(1), done("a"), Until(2), done("b"), Until(3)],
    ),
    "sub-processes with handlers": (
        start() + sub("p", start("ps") + user("u") + end("pe") + path("ps u pe")
        + handler("h", start("t", signal("A"), interrupting=False) + script("k", "n += 1") + user("w") + path("t k w")))
        + end() + path("s p e"),
        [Until(1), on("A"), on("A"), Until(2), done("w"), done("u"), Until(3), done("w"), Until(4)],
    ),
    "suspension": (
        start() + script("a", "await sleep(10)\nn = 5") + user("u") + end() + path("s a u e")
        + handler("h", start("t", signal("A")) + user("w") + path("t w"), resume=True),
        [Until(3), on("A"), Until(5), done("w"), Until(30), done("u"), Until(31)],
    ),
    "several instances of an activity": (
        start() + element("userTask", "u", LOOP.format("true")) + element("userTask", "v", LOOP.format("false")) + end()
        + path("s u v e"),
        [Until(1), done("u"), done("u"), Until(2), done("u"), done("v"), done("v"), done("v"), Until(3)],
    ),
    "what waits in scripts": (
        start() + script("a", "await sleep(2)\nx = 1\nawait sleep(2)\nx = 2") + script("b", "signal('B')") + user("u")
        + end() + path("s a b u e"),
        [Until(10), done("u"), Until(11)],
    ),
    "calls": (
        process(start() + call("c", "Q") + end() + path("s c e"))
        + process(start("qs") + user("u") + script("k", "n += 1") + end("qe") + path("qs u k qe"), id="Q"),
        [Until(1), done("u"), Until(2)],
    ),
    "thrown signals": (
        start() + gateway("parallel", "g") + catch("c", signal("A")) + throw("t", signal("A")) + user("u")
        + gateway("parallel", "j") + end() + path("s g c j e") + path("g u t j"),
        [Until(1), done("u"), Until(2)],
    ),
    "loops": (
        start() + gateway("exclusive", "m") + user("u") + script("k", "n += 1")
        + gateway("exclusive", "x", default="x_e") + end() + path("s m u k x e") + flow("x", "m", "${n < 3}"),
        [Until(1), done("u"), done("u"), Until(2), done("u"), Until(3)],
    ),
    "failed instances": (
        start("s", signal("A")) + user("u") + script("k", "raise ValueError('no')") + end() + path("s u k e"),
        [Until(1), on("A"), on("A"), done("u"), Until(2), done("u"), Until(3)],
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", MODELS)
def test_from_every_record_the_run_ends_as_if_nothing_had_happened(name: str, tmp_path: Path) -> None:
    content, steps = MODELS[name]
    definitions = model(*content.replace("</process><process", "</process>\0<process").split("\0"))
    whole = Recorded(definitions, tmp_path / "whole", {"n": 0})
    whole.simulation.run(0)
    steps = [Until(0), *steps]
    after = play(whole, steps)
    expected = whole.outcome()
    whole.close()
    found = read_segment(*(tmp_path / "whole").glob("journal-*"))
    ends = prefixes(found)
    assert len(ends) > 2
    for records, (length, time) in enumerate(ends, 1):
        if records == 1:
            continue  # the process has not begun
        again = Recorded(definitions, cut(tmp_path / "whole", tmp_path / str(records), length), now=time)
        play(again, left(steps, after, records))
        assert again.outcome() == expected, f"after record {records} of {len(ends)}"
        again.close()


@pytest.mark.parametrize("name", MODELS)
def test_every_record_gives_the_state_of_the_engine_at_that_time(name: str, tmp_path: Path) -> None:
    content, steps = MODELS[name]
    definitions = model(*content.replace("</process><process", "</process>\0<process").split("\0"))
    whole = Recorded(definitions, tmp_path / "whole", {"n": 0})
    states: dict[int, Any] = {}
    settled = whole.recorder.settled

    def note() -> None:
        settled()
        engine = whole.node.engine
        states[whole.records] = None if engine.cancelling else json.loads(json.dumps(snapshot(engine, dump=dump)))

    whole.node.engine.settled = note
    play(whole, [Until(0), *steps])
    whole.close()
    found = read_segment(*(tmp_path / "whole").glob("journal-*"))
    node, load = whole.node, StoredValues(whole.node.mission).load
    for records, state in states.items():
        if state is not None:
            again = restore_engine(state_at(found, records), node.engine.program, node.host, dict, load)
            assert json.loads(json.dumps(snapshot(again, dump=dump))) == state
    assert len(states) > 1


def resumed(content: str, tmp_path: Path) -> Recorded:
    """A run that has crashed at second 1, and goes on."""
    first = Recorded(model(content), tmp_path)
    first.simulation.run(1)
    first.close()
    return Recorded(model(content), tmp_path, now=SECOND)


def test_what_a_script_awaits_is_looked_at_when_all_have_started_again(tmp_path: Path) -> None:
    awaits, tries = "await until(lambda: tries == 2)", "tries = globals().get('tries', 0) + 1\nawait sleep(60)"
    both = gateway("parallel", "g") + script("b", tries) + script("a", awaits) + user("u") + path("s g a u")
    first = start() + script("zero", "tries = 0") + both.replace("s_g", "zero_g").replace('"s"', '"zero"')
    run = resumed(first + path("s zero") + path("g b"), tmp_path).simulation.run(1.5)
    assert run.instances[0].waiting == ["b", "u"]


def test_until_the_restored_state_is_written_as_a_whole_the_old_one_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written: list[str] = []
    for name in ("append", "begin_segment"):
        before = getattr(Journal, name)
        monkeypatch.setattr(
            Journal, name, lambda *given, before=before, name=name: (written.append(name), before(*given))
        )
    recovered = start("hs", "<signalEventDefinition/>", interrupting=False).replace('"hs"', '"hs" name="~/recovered"')
    back = handler("h", recovered + script("k", "n = 1") + path("hs k"))
    content = start() + user("u") + back + path("s u")
    assert resumed(content, tmp_path).visits()["k"] == 1
    assert written == ["begin_segment", "append", "begin_segment"]


def test_a_task_waits_for_a_person_since_it_first_did(tmp_path: Path) -> None:
    definitions = model(start() + catch("c", timer("PT2S")) + user("u") + end() + path("s c u e"))
    for now in (0, 15, 22):
        run = Recorded(definitions, tmp_path, now=now * SECOND)
        if not now:
            run.simulation.run(until=15)
        (wait,) = run.node.waiting_tokens()
        assert (wait.element, wait.since) == ("u", 2 * SECOND)
        run.close()


def test_an_element_that_completed_often_is_counted_after_the_end_too(tmp_path: Path) -> None:
    loop = start() + script("zero", "n = 0") + script("a", "n += 1") + gateway("exclusive", "x", default="x_e") + end()
    content = loop + path("s zero a x e") + flow("x", "a", "n < 300")
    assert resumed(content, tmp_path).visits()["a"] == 300


def test_variables_that_begin_with_two_underscores_are_not_stored(tmp_path: Path) -> None:
    run = resumed(start() + script("a", "__number = 1\n__items = [1]\nx = 1") + user("u") + path("s a u"), tmp_path)
    run.close()
    (values,) = [each["set"]["values"] for each in read_segment(*tmp_path.glob("journal-*")).records()]
    assert values == {"0 x": 1}


@pytest.mark.parametrize("depth", [1_500, 5_000])
def test_a_value_that_is_nested_too_deeply_is_lost_alone(tmp_path: Path, depth: int) -> None:
    deep = script("a", f"x, y = [], 1\nfor n in range({depth}): x = [x]")
    run = resumed(start() + deep + user("u") + path("s a u"), tmp_path)
    assert run.simulation.instances[0].variables == {"x": None, "y": 1, "n": depth - 1}
    (values,) = [each["set"]["values"] for each in read_segment(*tmp_path.glob("journal-*")).records()]
    assert values == {"0 x": None, "0 y": 1, "0 n": depth - 1}


@pytest.mark.parametrize("value", ["[[10**5000]]", "int", "[len, heappush]"])
def test_numbers_of_any_length_and_what_scripts_are_given_survive_a_crash(value: str, tmp_path: Path) -> None:
    first = script("a", f"from heapq import heappush\nx = {value}\nz = 10**5000")
    run = resumed(
        start() + first + user("u") + script("b", f"same = x == {value}, z == 10**5000") + path("s a u b"), tmp_path
    )
    run.simulation.complete("u")
    assert run.simulation.instances[0].variables["same"] == (True, True)


def test_a_token_in_a_loop_over_what_cannot_be_stored_goes_on(tmp_path: Path) -> None:
    each = '<multiInstanceLoopCharacteristics camunda:collection="x" camunda:elementVariable="i" isSequential="true"/>'
    loop = sub("p", each + start("ps") + user("u") + script("k", "seen += [i]") + end("pe") + path("ps u k pe"))
    deep = script("a", "x, seen = 1, []\nfor n in range(3000): x = [x]\nx = [x, 2]")
    run = resumed(start() + deep + loop + path("s a p"), tmp_path)
    play(run, [done("u"), done("u")])
    assert run.simulation.instances[0].variables["seen"][1:] == [2]
    assert run.simulation.instances[0].status == "completed"


@pytest.mark.parametrize(
    ("value", "what"),
    [
        ("new Date(0)", "a value of type Date"), ("{a: [new Map()]}", "a value of type Map"),
        ("new Set()", "a value of type Set"), ("/a/", "a value of type RegExp"), ("10n", "a value of type bigint"),
        ("[undefined]", "a value of type undefined"), ("[-0]", "a negative zero"),
        ("[1, , 3]", "an array with holes or names"), ("new (class P {})()", "a value of type P"),
        ("new (class { static get name() { throw 1 } })()", "an object that refuses to be read"),
        ("{a: [1, 'x', null, true, NaN, {b: 0.5}]}", ""),
    ],
)  # fmt: skip
def test_a_value_of_javascript_that_json_lacks_is_reported_once(value: str, what: str, tmp_path: Path) -> None:
    text = f"this.environment.variables.x = {value}; next()"
    tasks = (script("a", text) + script("b", text)).replace('"python"', '"javascript"')
    run = Recorded(model(start() + tasks + user("u") + path("s a b u")), tmp_path)
    run.simulation.run(1)
    run.close()
    said = f"variable x changes if the engine ends: {what} of JavaScript is stored as plain data"
    assert [event.detail for event in run.simulation.reports] == ([said] if what else [])


def test_values_that_become_equal_ones_of_another_type_are_stored(tmp_path: Path) -> None:
    each = '<multiInstanceLoopCharacteristics camunda:collection="x" camunda:elementVariable="i" isSequential="true"/>'
    loop = sub("p", each + start("ps") + user("u") + script("k", "seen += [i]") + end("pe") + path("ps u k pe"))
    change = (
        script("a", "import re\nn, m, x, seen = 1, [1.0], [[2], [0], re.A], []"),
        script("b", "n, m[0], x[1][0] = True, 1, False"),
    )
    content = start() + change[0] + gateway("parallel", "g") + loop + user("w") + change[1] + path("s a g p")
    run = Recorded(model(content + path("g w b")), tmp_path)
    play(run, [Until(1), done("w"), Until(1)])
    run.close()
    run = Recorded(model(content + path("g w b")), tmp_path, now=SECOND)
    play(run, [done("u"), done("u")])
    assert repr(run.simulation.instances[0].variables) == (
        "{'n': True, 'm': [1], 'x': [[2], [False], re.ASCII], 'seen': [[2], [False]]}"
    )
