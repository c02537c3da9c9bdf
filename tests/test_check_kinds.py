"""What `fame check` knows of the values of variables: messages that overwrite others, payloads that cannot fit."""

import pytest
from check_drawing import BOOL, VECTOR, alone, call, catch, data, reading, row, script, team, throw, told

PATH, NUMBER = "nav_msgs/msg/Path", "std_msgs/msg/Float64"
OTHERWISE = "give the event a mapping or the signal another name"


def sending(*before: str, payload: str = "{x: ${v}}", type: str = VECTOR) -> str:
    """Elements, and then a payload that they compute."""
    return row(*before, throw("a", type=type, payload=payload))


WARNINGS = {
    "a signal that overwrites a number": (
        row(script("done = 0"), catch("a"), script("done += 1", "t2")),
        f"a: fills `done` with a std_msgs/msg/Empty, but t sets it to a number: {OTHERWISE}",
    ),
    "a truth that overwrites a number": (
        row(script("done = 0"), catch("a", type=BOOL)),
        f"a: fills `done` with true or false, but t sets it to a number: {OTHERWISE}",
    ),
    "a message that is read as a number": (
        row(catch("a", type=PATH), script("x = done + 1")),
        f"a: fills `done` with a {PATH}, but t computes with it as a number: {OTHERWISE}",
    ),
    "a text in a field of numbers": (
        sending(script("v = 'fast'")),
        f"a: the payload does not fit: {VECTOR}: x: expected a number, got 'fast'",
    ),
    "a list in a field of numbers": (
        sending(script("v = [1.0]")),
        f"a: the payload does not fit: {VECTOR}: x: expected a number, got a list",
    ),
    "a message of another type": (
        sending(catch("b", "found", type=VECTOR), payload="${found}", type=BOOL),
        f"a: the payload does not fit: {BOOL}: data: expected true or false, got a {VECTOR}",
    ),
}


@pytest.mark.parametrize(("content", "expected"), WARNINGS.values(), ids=WARNINGS.keys())
def test_it_is_a_warning(content: str, expected: str) -> None:
    assert told(alone(content)) == [expected]


FINE = {
    "a signal that sets what a script cleared": row(script("done = False"), catch("a", type=BOOL)),
    "a number that a script began": row(script("done = 0"), catch("a", type=NUMBER), script("x = done + 1", "t2")),
    "a message that was none before": row(script("done = None"), catch("a", type=PATH)),
    "a message that a data object takes": (
        data("d", x="${x}") + row(script("done = 0"), catch("a", into="d", type=VECTOR))
    ),
    "a message whose field is computed with": row(catch("a", type=VECTOR), script("x = done.x + 1")),
    "a message that is compared": row(catch("a", type=PATH), script("x = done != None")),
    "a variable that is computed": row(script("done = int('1') if 1 else later()\ndef later(): pass"), catch("a")),
    "a number as a text": sending(script("v = '1.5'")),
    "a number in one of two cases": sending(script("v = []\nv = 3")),
    "a value that a function gives": sending(script("def f(): return 1\nv = f()")),
    "a value of a loop": sending(script("v = ''\nfor v in range(3): pass")),
    "a text that is made of others": sending(script("v = f'{1}'")),
    "a field of a message": sending(catch("b", "found", type=VECTOR), payload="${found.x}", type=NUMBER),
    "a message of the same type": sending(catch("b", "found", type=VECTOR), payload="${found}"),
    "a value that a caller may give": data("d", v="fast") + sending(reading("t", "d", "x = v")),
}


@pytest.mark.parametrize("content", FINE.values(), ids=FINE.keys())
def test_it_is_not_blamed(content: str) -> None:
    assert told(alone(content)) == []


def test_a_data_object_of_a_pool_says_what_it_sets() -> None:
    expected = f"a: the payload does not fit: {VECTOR}: x: expected a number, got 'fast'"
    assert expected in told(team(data("d", v="fast") + sending(reading("t", "d", "x = v"))))
    assert told(team(data("d", v="0.5") + sending(reading("t", "d", "x = v")))) == []


def test_where_people_set_variables_nothing_is_said_of_payloads() -> None:
    assert told(alone(sending(script("v = 'fast'"), '<userTask id="u"/>'))) == []


def test_a_called_process_with_variables_of_its_own_overwrites_nothing() -> None:
    mapping = '<extensionElements><camunda:in source="x" target="x"/></extensionElements>'
    inner = f'<process id="Q">{row(script("done = 0", "q"), mark="2")}</process>'
    text = alone(row(script("x = 1"), call("c", "Q", mapping), catch("a", type=BOOL)))
    assert told(text.replace("</process>", f"</process>{inner}", 1)) == []
    shared = text.replace(mapping, "").replace("</process>", f"</process>{inner}", 1)
    assert told(shared) == [f"a: fills `done` with true or false, but q sets it to a number: {OTHERWISE}"]
