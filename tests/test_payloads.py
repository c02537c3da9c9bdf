"""Payloads of events and properties of data objects: values go in as values."""

from typing import Any

import pytest

import fame
from fame.bpmn import read_text
from fame.bpmn.model import Expression
from fame.engine import UNDEFINED
from fame.errors import ModelError
from fame.scripting import compile_expression
from fame.scripting.languages import MISSING
from fame.scripting.substitution import is_text
from tests.bpmn_text import process, properties


def payload(text: str, /, **variables: Any) -> Any:
    return compile_expression(Expression(text, "payload", 1))(variables)


def prop(text: str, /, **variables: Any) -> Any:
    return compile_expression(Expression(text, "value", 1))(variables)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("{x: ${a}, y: ${b}}", {"x": 1.5, "y": "two"}),
        ('{"x": ${a}, "y": "${b}"}', {"x": 1.5, "y": "two"}),
        ("{x: '${a}'}", {"x": 1.5}),
        ('{x: "pre ${b} post", y: pre ${a}}', {"x": "pre two post", "y": "pre 1.5"}),
        ("{linear: {x: ${a + 1}}, angular: {z: 0}}", {"linear": {"x": 2.5}, "angular": {"z": 0}}),
        ("{data: [1, ${a}, {x: ${c}}]}", {"data": [1, 1.5, {"x": [1, 2]}]}),
        ("${b}", "two"),
        ("${c}", [1, 2]),
        ("  ${a}  ", 1.5),
        ("hello ${b}!", "hello two!"),
        ("true", True),
        ("false", False),
        ('"true"', "true"),
        ("12", 12),
        ("1e3", 1000.0),
        ("on", "on"),
        ("1:30", "1:30"),
        ("010", 10),
        ("2024-01-01", "2024-01-01"),
        ("null", None),
        ("", None),
        ("   ", None),
        ("it's: a text", "it's: a text"),
        ("{y: 1, n: 2, on: off}", {"y": 1, "n": 2, "on": "off"}),
        ('{\n\t"x": 1,\n\t"y": ${a}\n}', {"x": 1, "y": 1.5}),
        ("{a: \"x\ty\",\tb: it's\t, c: 'p\tq'}", {"a": "x\ty", "b": "it's", "c": "p\tq"}),
        ("{x: ${ {'k': {'}': 3}}.k['}'] }}", {"x": 3}),
        ("{x: #{a}}", {"x": 1.5}),
        ("={x: a, y: b, p: {q: c[1]}}", {"x": 1.5, "y": "two", "p": {"q": 1}}),
        ("=[a, 2 * a]", [1.5, 3.0]),
        ("= a > 1", True),
        ('{"x":${a},"y":${b}}', {"x": 1.5, "y": "two"}),
        ("[]", []),
        ("{}", {}),
        ('"quoted" and more', '"quoted" and more'),
    ],
)
def test_a_payload_gives(text: str, expected: Any) -> None:
    result = payload(text, a=1.5, b="two", c=[1, 2])
    assert result == expected
    assert type(result) is type(expected)


def test_a_value_is_inserted_as_a_value_whatever_letters_it_is_made_of() -> None:
    evil = 'x", "y": 1}, ${b} {[\n# '
    assert payload('{"text": "${t}", list: [${t}]}', t=evil, b=1) == {"text": evil, "list": [evil]}
    assert payload("a ${t} b", t=evil) == f"a {evil} b"


def test_a_name_that_is_not_set_leaves_its_field_out_and_is_reported() -> None:
    said: list[tuple[str, ...]] = []
    names = {"__builtins__": {MISSING: lambda *of: said.append(tuple(map(str, of)))}}
    text = Expression("{x: ${a}, p: {y: ${b}, z: 1}, t: 'n ${b}'}", "payload")
    evaluate = compile_expression(text, element="Task_1")
    assert evaluate({"a": 1, **names}) == {"x": 1, "p": {"z": 1}}
    assert said == [
        ("Task_1", "payload field p.y", "`b` is not set"),
        ("Task_1", "payload field t", "`b` is not set"),
    ]
    assert evaluate({"a": 1, "b": 2}) == {"x": 1, "p": {"y": 2, "z": 1}, "t": "n 2"}


def test_a_list_without_one_of_its_elements_is_left_out() -> None:
    assert payload("{data: [1, ${missing}, 3], n: 1}") == {"n": 1}


def test_a_whole_payload_that_is_not_set_is_undefined() -> None:
    assert payload("${closest}") is UNDEFINED
    assert payload("is ${closest}") is UNDEFINED


def test_what_is_null_in_a_feel_payload_is_left_out_and_reported() -> None:
    said: list[str] = []
    names = {"__builtins__": {MISSING: lambda element, field, error: said.append(f"{field}: {error}")}}
    evaluate = compile_expression(Expression("={x: a, p: {y: b + 1, z: 1}}", "payload"))
    assert evaluate({"a": 1, **names}) == {"x": 1, "p": {"z": 1}}
    assert said == ["payload field p.y: is null"]
    assert payload("=missing") is UNDEFINED
    assert payload("={x: [a, b], p: [{y: b, z: 1}], n: [a]}", a=1) == {"p": [{"z": 1}], "n": [1]}


def test_a_value_with_a_key_that_is_given_twice_is_refused() -> None:
    with pytest.raises(ModelError, match="a key is given twice"):
        prop("{x: 1, x: 2}")


def test_a_value_in_quotes_is_no_text_for_certain() -> None:
    assert [is_text(text) for text in ('"${x}"', "'${x}'", "${x}", "{a: ${x}}")] == [False] * 4
    assert all(map(is_text, ("at ${x}", '"at ${x}"', "${x}${y}")))


@pytest.mark.parametrize(("text", "reason"), [("{x: ${a}}", "`a` is not set"), ("={x: a}", "is null")])
def test_a_missing_field_is_reported_once_or_refused_if_strict(text: str, reason: str) -> None:
    content = properties(type="geometry_msgs/msg/Point", payload=text)
    event = f'<endEvent id="e">{content}<signalEventDefinition signalRef="S"/></endEvent>'
    flow = '<startEvent id="s"/><sequenceFlow id="f" sourceRef="s" targetRef="e"/>'
    definitions = read_text(process(flow + event, root='<signal id="S" name="point"/>'), file="m.bpmn")
    for _ in range(2):  # the second simulation has the program of the first, and its own reports
        simulation = fame.Simulation(definitions).run()
        simulation.start()
        assert [one.detail for one in simulation.run().reports] == [f"payload field x: {reason}; left at its default"]
    strict = fame.Simulation(definitions, strict=True).run()
    assert f"payload field x: {reason}" in str(strict.instances[0].error)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("{x: 1", "not valid YAML or JSON"),
        ("{x: ${a}", "not valid YAML or JSON"),
        ("{x: ${a + }}", "expected a value, got the end"),
        ("{x: ${a}, y: ${b", "no closing brace"),
        ("{x:${a}}", "before a value there is a space"),
        ("{x: !!python/name:os.system }", "not valid YAML or JSON"),
        ("{x: 1, p: {y: 2, y: 3}}", "a key is given twice"),
        ("[&a 1, *a]", r"not valid YAML or JSON: an alias \(\*a\)"),
    ],
)
def test_a_wrong_payload_is_refused_when_it_is_compiled(text: str, complaint: str) -> None:
    with pytest.raises(ModelError, match=complaint) as caught:
        compile_expression(Expression(text, "payload", 4), file="m.bpmn", element="Throw_1")
    assert (caught.value.line, caught.value.element) == (4, "Throw_1")


def test_the_line_of_a_complaint_is_that_of_the_expression_inside() -> None:
    with pytest.raises(ModelError) as caught:
        compile_expression(Expression("{\n x: ${a},\n y: ${+}\n}", "payload", 10))
    assert caught.value.line == 12


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("0", 0),
        ("-2.5", -2.5),
        ("true", True),
        ("REX", "REX"),
        ('"5"', "5"),
        ("${x * 2}", 6),
        ("=x * 2", 6),
        ("robot_${x}", "robot_3"),
        ("[[0, 0], [${x}, 1]]", [[0, 0], [3, 1]]),
        ("[not yaml", "[not yaml"),
        ("null", None),
        ("", UNDEFINED),
        ("${y}", UNDEFINED),
        ("${y.z}", UNDEFINED),
    ],
)
def test_a_property_of_a_data_object_gives(text: str, expected: Any) -> None:
    assert prop(text, x=3) == expected


def test_a_literal_list_is_a_new_one_each_time() -> None:
    evaluate = compile_expression(Expression("[]", "value"))
    first = evaluate({})
    first.append(1)
    assert evaluate({}) == []
