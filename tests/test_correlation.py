"""The property ``correlate`` of an element that receives a message (docs/correlation.md)."""

from itertools import pairwise
from pathlib import Path

import pytest
from bpmn_text import document, properties

from fame.bpmn import read_text
from fame.bpmn.conversion import convert
from fame.bpmn.split import split
from fame.check import check
from fame.check.explain import readings
from fame.clock import SECOND
from fame.middleware.messages import create
from fame.scenario import Scenario
from fame.simulation import Simulation

TYPE = "diagnostic_msgs/msg/KeyValue"
PICKED = '<messageEventDefinition messageRef="Picked"/>'


def catching(kind: str, correlate: str = "order_id = key", **more: str) -> str:
    said = properties(type=TYPE, correlate=correlate, **more)
    if kind == "receive":
        return f'<receiveTask id="c" messageRef="Picked">{said}</receiveTask>'
    if kind == "definition":
        inside = PICKED.replace("/>", f">{said}</messageEventDefinition>")
        return f'<intermediateCatchEvent id="c">{inside}</intermediateCatchEvent>'
    return f'<intermediateCatchEvent id="c">{said}{PICKED}</intermediateCatchEvent>'


def flow(*ids: str) -> str:
    return "".join(f'<sequenceFlow id="{a}_{b}" sourceRef="{a}" targetRef="{b}"/>' for a, b in pairwise(ids))


def team(kind: str) -> str:
    """A depot with two orders at a time, and a robot that answers the second one first."""
    several = '<multiInstanceLoopCharacteristics camunda:collection="${[1, 2]}" camunda:elementVariable="n"/>'
    number = '<scriptTask id="n"><script>order_id = f"order {n}"</script></scriptTask>'
    done = '<scriptTask id="d"><script>log(f"{order_id}: {Picked.value}")</script></scriptTask>'
    orders = (
        f'<subProcess id="p">{properties()}{several}{number}{catching(kind)}{done}{flow("n", "c", "d")}</subProcess>'
    )
    sent = "".join(
        f'<sendTask id="a{n}" messageRef="Picked">'
        f"{properties(type=TYPE, payload=f'{{key: order {n}, value: {what}}}')}</sendTask>"
        for n, what in ((2, "pears"), (1, "apples"), (3, "plums"))
    )
    wait = '<scriptTask id="w"><script>await sleep(1)</script></scriptTask>'
    return document(
        '<message id="Picked" name="Picked"/><collaboration id="C">'
        '<participant id="D" name="Depot" processRef="depot"/>'
        '<participant id="R" name="Picker" processRef="picker"/></collaboration>'
        f'<process id="depot" isExecutable="true"><startEvent id="s"/>{orders}{flow("s", "p")}</process>'
        f'<process id="picker" isExecutable="true"><startEvent id="t"/>{wait}{sent}'
        f"{flow('t', 'w', 'a2', 'a1', 'a3')}</process>"
    )


@pytest.mark.parametrize("kind", ["receive", "catch"])
def test_each_instance_takes_its_own_message(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "team.bpmn"
    path.write_text(team(kind))
    result = Scenario.load(path, duration=5).run()
    told = [event.detail for event in result.reports if event.robot == "Depot"]
    assert sorted(told) == ["order 1: apples", "order 2: pears"]
    assert result.messages == ["Depot: 1 message on /Picked reached it, and no event took it"]


@pytest.mark.parametrize("kind", ["receive", "catch"])
def test_its_part_of_the_split_file_does_likewise(kind: str) -> None:
    part = next(one for one in split(read_text(team(kind))) if one.name == "Depot")
    run = Simulation(read_text(part.source.decode())).run()
    for number, value in ((2, "pears"), (3, "plums"), (1, "apples")):
        run.signal("Picked", {"key": f"order {number}", "value": value})
    assert sorted(event.detail for event in run.reports) == ["order 1: apples", "order 2: pears"]


@pytest.mark.parametrize(
    ("correlate", "keys"),
    [
        ("order_id", [("order_id", "${msg.order_id}")]),
        ("order_id = key", [("order_id", "${msg.key}")]),
        ("order.id", [("order.id", "${msg.id}")]),
        ("order_id=key, robot = header.frame_id", [("order_id", "${msg.key}"), ("robot", "${msg.header.frame_id}")]),
    ],
)
def test_a_key_names_a_variable_and_a_field(correlate: str, keys: list[tuple[str, str]]) -> None:
    for kind in ("receive", "catch", "definition"):
        model = read_text(team(kind).replace("order_id = key", correlate))
        node = model.processes[0].body.nodes[1].body.nodes[1]  # type: ignore[union-attr]
        found = node.keys if kind == "receive" else node.definitions[0].keys  # type: ignore[union-attr]
        assert [(name, source.text) for name, source in found] == keys


def texts(content: str) -> list[str]:
    return [f"{one.level}: {one.text}" for one in check(read_text(content)) if "orrelat" in one.text]


def test_what_is_wrong_with_a_key_is_told() -> None:
    assert texts(team("catch").replace("order_id = key", "order_id")) == [
        f"error: correlates by order_id, but {TYPE} has no field order_id: it receives nothing"
    ]
    (found,) = texts(team("receive").replace("order_id = key", "=order"))
    assert found == "error: correlate='=order': expected variables of the process, or variable = field of the message"
    wrong = (
        team("catch")
        .replace("<collaboration", '<signal id="S" name="s"/><collaboration')
        .replace('<messageEventDefinition messageRef="Picked"/>', '<signalEventDefinition signalRef="S"/>')
    )
    text = "its property 'correlate' has no effect: only an element that receives a message correlates it"
    assert texts(wrong) == [f"warning: {text}"]
    thrown = team("definition").replace("intermediateCatchEvent", "intermediateThrowEvent")
    assert texts(thrown) == [f"warning: {text}"]
    assert texts(team("catch")) == []


def test_it_is_explained() -> None:
    assert any(one.text.endswith("correlates order_id = ${msg.key}") for one in readings(read_text(team("catch"))))


def test_messages_that_match_nothing_are_noted_for_each_topic() -> None:
    """A message on another topic does not make the first one forgotten."""
    said = properties(type=TYPE, correlate="order_id = key")
    waits = "".join(
        f'<receiveTask id="take_{name}" messageRef="{name}">{said}</receiveTask>' for name in ("pears", "plums")
    )
    text = document(
        '<message id="pears" name="pears"/><message id="plums" name="plums"/>'
        '<collaboration id="C"><participant id="D" name="Depot" processRef="depot"/></collaboration>'
        '<process id="depot" isExecutable="true"><startEvent id="s"/><scriptTask id="n">'
        f'<script>order_id = "order 1"</script></scriptTask><parallelGateway id="g"/>{waits}'
        f"{flow('s', 'n', 'g', 'take_pears')}{flow('g', 'take_plums')}</process>"
    )
    robot = Simulation(read_text(text)).run(1).node
    for topic in ("/pears", "/plums"):
        robot.deliver(topic, create(TYPE, {"key": "order 2", "value": ""}))
    waiting = [wait for ends in robot.engine.listeners.values() for wait in ends]
    misses = {wait.node.id: robot.waiting.last_miss(wait) for wait in waiting}
    assert misses == dict.fromkeys(("take_pears", "take_plums"), (SECOND, "its correlation keys do not match"))


@pytest.mark.parametrize("order_id", [7, 7.5, 1e-7, True, "7"])
def test_a_key_sent_as_text_equals_the_number_that_it_was(order_id: object) -> None:
    key = create(TYPE, {"key": order_id}).key
    assert isinstance(key, str)
    model = document(
        '<message id="Picked" name="Picked"/><process id="P" isExecutable="true"><startEvent id="s"/>'
        f"{catching('catch')}{flow('s', 'c')}</process>"
    )
    run = Simulation(read_text(model), variables={"order_id": order_id}).run()
    assert run.signal("Picked", {"key": "8"}).instances[0].status == "running"
    assert run.signal("Picked", {"key": key}).instances[0].status == "completed"


def key_of_camunda_8(key: str) -> str:
    said = f'<extensionElements><zeebe:subscription correlationKey="{key}"/></extensionElements>'
    return document(
        f'<message id="Picked" name="Picked">{said}</message><process id="P" isExecutable="true"><startEvent id="s"/>'
        f'<receiveTask id="c" messageRef="Picked">{properties(type=TYPE)}</receiveTask>{flow("s", "c")}</process>'
    )


@pytest.mark.parametrize(
    "key", ["=orders[1].key", "=key + 1", "=&quot;a&quot; + key", "=string(key)", "key", "=true", "=null"]
)
def test_a_key_of_camunda_8_that_is_computed_is_refused_where_it_counts(key: str) -> None:
    (found,) = check(read_text(key_of_camunda_8(key)))
    assert (found.level, found.element) == ("error", "c")
    assert "expected a variable of the process or a field of one, as =order_id" in found.text
    assert convert(read_text(key_of_camunda_8(key))) == read_text(key_of_camunda_8(key)).source


@pytest.mark.parametrize("key", ["=order.key", "= order.key ", "${order.key}"])
def test_a_key_of_camunda_8_that_is_a_field_correlates(key: str) -> None:
    run = Simulation(read_text(key_of_camunda_8(key)), variables={"order": {"key": "a"}}).run()
    assert run.signal("Picked", {"key": "b"}).instances[0].status == "running"
    assert run.signal("Picked", {"key": "a"}).instances[0].status == "completed"
