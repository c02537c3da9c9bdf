"""What `fame check` calls an error: every kind of model that fails."""

from pathlib import Path

import pytest
from bpmn_text import document, process
from check_drawing import (
    BOOL,
    SIGNALS,
    START,
    VECTOR,
    alone,
    call,
    catch,
    checked,
    choice,
    ends,
    event,
    flow,
    flows,
    row,
    script,
    service,
    team,
    throw,
    timer,
    told,
)

from fame.bpmn.library import Library
from fame.bpmn.model import Expression
from fame.check import check
from fame.scripting.languages import parse_expression
from fame.text import NAMES


def taking(source: str) -> str:
    """A catching event ``c`` that sets a variable to a part of its message."""
    output = f'<camunda:inputOutput><camunda:outputParameter name="x">{source}</camunda:outputParameter>'
    event = catch("c", type="geometry_msgs/msg/PointStamped")
    return event.replace("</extensionElements>", f"{output}</camunda:inputOutput></extensionElements>")


ERRORS = {
    "a script that is not valid Python": (
        row(script("x = (1")),
        "t: not valid Python: '(' was never closed: `x = (1`",
    ),
    "an unknown value of retry": (
        row(service(service="pour", type="std_srvs/srv/Trigger", retry="Never")),
        "t: property retry='Never': expected safe, never or ask",
    ),
    "a condition that is not valid Python": (
        START + choice("g", 'default="g-b"') + ends("a", "b") + flows("s g", "g b") + flow("g", "a", "x = 1"),
        "g: not valid Python: invalid syntax",
    ),
    "a script that drops what it should await": (
        row(script("sleep(2)")),
        "t: sleep(...) does nothing unless it is awaited: await sleep(",
    ),
    "an element that is not executed": (
        row('<businessRuleTask id="t"/>'),
        "t: business rules are not executed: decide with a gateway or a script task",
    ),
    "two none start events": (
        '<startEvent id="a"/><startEvent id="b"/>' + ends("e") + flows("a e", "b e"),
        "b: P has 2 none start events; expected at most one",
    ),
    "an event-based gateway that leads to a task": (
        START + '<eventBasedGateway id="g"/>' + script("x = 1") + ends("e") + flows("s g t e"),
        "g: leads to t: expected a catching event or a receive task",
    ),
    "two types of one topic": (
        row(throw("a", type=BOOL), catch("b", type=VECTOR)),
        f'b: topic /done has type {VECTOR} here, but "done" (a) says {BOOL}: a topic has one type',
    ),
    "a script with another type of a topic": (
        row(catch("a", type=BOOL), script('robot.publish("/done", "std_msgs/msg/String", data="x")')),
        f't: topic /done has type std_msgs/msg/String here, but "done" (a) says {BOOL}: a topic has one type',
    ),
    "a topic that no middleware makes": (
        row(script('robot.publish("/has a/b!", "std_msgs/msg/Empty")')),
        "t: /has a/b! is not a valid ROS 2 topic name: expected ASCII letters, digits and _, not starting with a digit",
    ),
    "two names that become one topic": (
        row('<intermediateThrowEvent id="a" name="has arrived"><signalEventDefinition/></intermediateThrowEvent>'
            '<intermediateThrowEvent id="b" name="has arrived!"><signalEventDefinition/></intermediateThrowEvent>'),
        "b: the name 'has arrived!' and that of \"has arrived\" (a), 'has arrived', are the same topic /has_arrived: "
        "expected names that differ in letters and digits, or one name",
    ),
    "a script with another name of the topic of an event": (
        row(throw("a"), script('signal("done!")')),
        "t: the name 'done!' and that of \"done\" (a), 'done', are the same topic /done: "
        "expected names that differ in letters and digits, or one name",
    ),
    "a name without a Latin letter": (
        row(script('signal("\u5230\u8fbe")')),
        "t: '\u5230\u8fbe' has no Latin letter to make a topic of: write a topic as its name, such as /order_received",
    ),
    "a payload and no type": (
        row(throw("a", payload="true"), catch("b")),
        "a: topic /done has a payload but no type: set property type on one of its events",
    ),
    "a type that nobody knows": (
        row(throw("a", type="geometry_msgs/msg/Vektor3")),
        "a: type geometry_msgs/msg/Vektor3: there is no such message type; did you mean geometry_msgs/msg/Vector3",
    ),
    "a type in a script that nobody knows": (
        row(script('robot.publish("led", "std_msgs/msg/Colour")')),
        "t: type std_msgs/msg/Colour: there is no such message type",
    ),
    "a constant of another type": (
        row(throw("a", type=VECTOR, payload="{x: fast}")),
        f"a: the payload does not fit: {VECTOR}: x: expected a number, got 'fast'",
    ),
    "a field that the type does not have": (
        row(throw("a", type=VECTOR, payload="{x: 1, w: 2}")),
        f"a: the payload does not fit: {VECTOR}: w: there is no such field; those of {VECTOR} are x, y, z",
    ),
    "a text where the fields of a message belong": (
        row(script("v = 1"), throw("a", type=VECTOR, payload="x: ${v}, y: ${v}")),
        f"a: the payload does not fit: {VECTOR}: "
        f"expected {VECTOR} or a mapping with x, y, z, got 'x: ${{v}}, y: ${{v}}'",
    ),
    "a computed field that the type does not have": (
        row(script("v = 1"), throw("a", type="geometry_msgs/msg/Twist", payload="{linear: {w: ${v}}}")),
        "a: the payload does not fit: geometry_msgs/msg/Twist: linear.w: there is no such field; "
        f"those of {VECTOR} are x, y, z",
    ),
    "a mapping of a field that the message does not have": (
        row(taking("${msg.pont.x}")),
        "c: reads what is not in the message: geometry_msgs/msg/PointStamped: pont.x: there is no such field; "
        "those of geometry_msgs/msg/PointStamped are header, point",
    ),
    "a mapping of a field that a part of the message does not have": (
        row(taking("${msg.point.u + 1}")),
        "c: reads what is not in the message: geometry_msgs/msg/PointStamped: point.u: there is no such field; "
        "those of geometry_msgs/msg/Point are x, y, z",
    ),
    "a script that publishes a field that the type does not have": (
        row(script('robot.publish("led", "std_msgs/msg/ColorRGBA", red=level)\nlevel = 1')),
        "t: what is published does not fit: std_msgs/msg/ColorRGBA: red: there is no such field; "
        "those of std_msgs/msg/ColorRGBA are r, g, b, a",
    ),
    "a script that publishes a constant of another type": (
        row(script('robot.publish("led", "std_msgs/msg/ColorRGBA", r="red")')),
        "t: what is published does not fit: std_msgs/msg/ColorRGBA: r: expected a number, got 'red'",
    ),
    "a payload that is no YAML": (
        row(throw("a", type=VECTOR, payload="{x: [1}")),
        "a: not valid YAML or JSON: expected ',' or ']', but got '}' at letter 7: {x: [1}",
    ),
    "a ROS service of a type that nobody knows": (
        row(service(service="arm", type="std_srvs/srv/Tigger")),
        "t: type std_srvs/srv/Tigger: there is no such service type; did you mean std_srvs/srv/Trigger",
    ),
    "a request that does not fit its service": (
        row(service(service="a", type="std_srvs/srv/SetBool", payload="{on: 1}")),
        "t: the payload does not fit: std_srvs/srv/SetBool_Request: on: there is no such field; "
        "those of std_srvs/srv/SetBool_Request are data",
    ),
    "a constant number of instances below 0": (
        row('<userTask id="t"><multiInstanceLoopCharacteristics><loopCardinality>-1</loopCardinality>'
            '</multiInstanceLoopCharacteristics></userTask>'),
        "t: expected a whole number from 0 on as cardinality, got -1",
    ),
    "an invalid duration": (
        row(timer("intermediateCatchEvent", "timeDuration", "2s")),
        "w: timer duration: '2s' is not an ISO 8601 duration such as PT1.5S, PT10M or P1DT12H",
    ),
    "an invalid date": (
        row(timer("intermediateCatchEvent", "timeDate", "tomorrow")),
        "w: timer date: 'tomorrow' is not an ISO 8601 date and time such as 2026-01-31T12:00:00Z",
    ),
    "an invalid cycle": (
        timer("startEvent", "timeCycle", "R0/PT1S") + ends("e") + flows("w e"),
        "w: timer cycle: 'R0/PT1S' never repeats: give R1 or more, or R for without end",
    ),
    "a process that calls itself without end": (
        row(script("x = 1"), call("again", "P")),
        "again: P calls itself endlessly: every path through it leads to such a call",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("content", "expected"), ERRORS.values(), ids=ERRORS.keys())
def test_it_is_an_error(content: str, expected: str) -> None:
    assert any(line.startswith(expected) for line in told(alone(content), "error")), told(alone(content))


def test_a_call_that_leads_nowhere_is_an_error_that_says_where_it_was_looked_for(tmp_path: Path) -> None:
    found = checked(alone(row(call("c", "Jump"))), library=Library([tmp_path]))
    (error,) = (one for one in found if one.level == "error")
    assert error.element == "c"
    places = f"{tmp_path}, ., library, the built-in library"
    assert error.text == f"called element 'Jump': found neither a process of this file nor Jump.bpmn in {places}"


def test_a_called_element_with_a_name_that_no_file_can_have_is_nowhere_too() -> None:
    (error,) = told(alone('<callActivity id="c" calledElement="' + 300 * "x" + '"/>'), "error")
    assert "found neither a process of this file" in error


def test_folders_below_the_working_directory_are_told_from_there_on(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine").mkdir()
    (tmp_path / "m.bpmn").write_text(alone(row(call("c", "Jump"))))
    (error,) = (one for one in check(tmp_path / "m.bpmn", library=Library(tmp_path / "mine")) if one.level == "error")
    assert error.text.endswith("nor Jump.bpmn in mine, ., library, the built-in library")


@pytest.mark.parametrize("called", ["goto", "Go To", "GoTo.bpmn", "GoToo"])
def test_a_called_element_that_is_misspelt_is_told_with_its_right_name(called: str) -> None:
    (error,) = (one for one in checked(alone(row(call("c", called)))) if one.level == "error")
    assert error.text.endswith("; did you mean 'GoTo'?")


def test_all_errors_are_told_not_only_the_first() -> None:
    text = alone(
        row(
            script("x = (1", "t1"),
            '<serviceTask id="t2" camunda:class="org.example.Grip"/>',
            call("t3", "Nowhere"),
            '<businessRuleTask id="t4"/>',
            script("y = )", "t5"),
            timer("intermediateCatchEvent", "timeDuration", "soon"),
            throw("t6", type="no_msgs/msg/Type"),
            '<sendTask id="t7"/>',
        )
    )
    elements = [one.element for one in checked(text) if one.level == "error"]
    assert elements == ["t1", "t2", "t3", "t4", "t5", "w", "t6", "t7"]


def test_errors_in_event_sub_processes_are_told_beside_others() -> None:
    handler = f'<subProcess id="h" triggeredByEvent="true">{script("x = (1", "inner")}</subProcess>'
    elements = [one.element for one in checked(alone(row(script("y = )")) + handler)) if one.level == "error"]
    assert elements == ["t", "h", "inner"]


def test_of_a_process_that_is_refused_all_over_it_is_said_that_not_all_is_told() -> None:
    found = checked(alone(row(*(f'<businessRuleTask id="t{n}"/>' for n in range(120)))))
    assert sum(one.level == "error" for one in found) == 100
    assert "P: 100 of its elements are invalid: the check of this process stops here" in [
        f"{one.element}: {one.text}" for one in found
    ]
    some = checked(alone(row(*(f'<businessRuleTask id="t{n}"/>' for n in range(90)))))
    assert not any("no more are looked for" in one.text for one in some)


def test_what_is_refused_brings_no_other_error_with_it() -> None:
    text = alone(START + '<eventBasedGateway id="g"/><receiveTask id="t"/>' + ends("e") + flows("s g t e"))
    assert told(text, "error") == ["t: a receive task needs a message"]


GREEDY = "count(for i in 1..1000000000 return i)"


@pytest.mark.parametrize(
    "text",
    [
        GREEDY,
        f"x + {GREEDY}",
        f"{GREEDY} + x",
        f"2 * {GREEDY} > x + 1",
        f"if x > 1 then x else {GREEDY}",
        f"for y in x return y + {GREEDY}",
        f"max(x, {GREEDY})",
        f"x[item > {GREEDY}]",
        f"{{a: x, b: {GREEDY}}}.a",
        "x + count(for i in 1..1000, j in 1..1000 return i + j)",
        "x in (1, count((for i in 1..1000000000 return i)[item > 3]))",
        "(function(a) count(for i in 1..1000000000 return i + a))(3) - x",
    ],
)
def test_a_constant_part_that_takes_too_long_to_compute_is_an_error(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fame.scripting.budget.DEFAULT", 10_000)
    (error,) = (
        one for one in checked(alone(row(script(text.replace("<", "&lt;"), format="feel")))) if one.level == "error"
    )
    assert "t: cannot be computed: an expression took more than 1000 loop passes" in str(error)


@pytest.mark.parametrize(
    "text",
    [
        "x + count(for i in 1..10 return i)",
        "count(for i in 1..x return count(for j in 1..i return i))",
        "count(for i in 1..10 return x)",
        "count(for x in 1..10 return x) + x",
        "for i in 1..10 return (for j in i..10 return i + x)",
    ],
)
def test_what_depends_on_a_variable_is_not_computed(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fame.scripting.budget.DEFAULT", 1_000)
    assert [one for one in checked(alone(row(script(text, format="feel")))) if one.level == "error"] == []


def test_the_constant_parts_of_an_expression_are_the_largest() -> None:
    """Each is tried once: it is not tried again inside another one."""
    for text, values in {
        "sum([1, 2]) + sum([3]) + x": [6],
        "x + sum([1, 2]) + sum([3])": [3, 3],
        "x * (sum([1, 2]) + sum([3]))": [6],
        "sum([sum([1]), sum([x])])": [1],
        "for i in [1, 2] return i + x + sum([2])": [2],
        "1 + 2 + x": [],
        "sum([1])": [1],
    }.items():
        parts = parse_expression(Expression(text, "feel")).constants
        assert [part({}) for part in parts] == values, text


def test_an_error_names_the_line_of_the_script() -> None:
    (error,) = (one for one in checked(alone(row(script("x = 1\ny = 2\nz = (")))) if one.level == "error")
    assert str(error) == "bad.bpmn:6: error: t: not valid Python: '(' was never closed: `z = (`"


def test_errors_of_called_files_are_told_with_their_file(tmp_path: Path) -> None:
    broken = process(row(script("x = (1"), '<task id="plain"/>')).replace('id="P"', 'id="Walk"')
    (tmp_path / "Walk.bpmn").write_text(broken)
    (tmp_path / "Run.bpmn").write_text("<definitions")
    found = checked(alone(row(call("c", "Walk"), call("d", "Run"))), library=Library([tmp_path]))
    errors = [one for one in found if one.level == "error"]
    assert [Path(one.file).name for one in errors] == ["Walk.bpmn", "Run.bpmn"]
    assert errors[0].element == "t"
    assert not any(one.level == "note" and one.file != "bad.bpmn" for one in found)


def test_a_called_process_that_cannot_be_entered_is_an_error() -> None:
    callee = f'<process id="Q">{event("startEvent", "qs", "done")}{ends("qe")}{flows("qs qe")}</process>'
    text = process(row(call("c", "Q")), callee + SIGNALS)
    assert told(text, "error") == ["Q: has no none start event, so it cannot be called or entered"]


def test_pools_that_no_robot_can_be_found_for_are_errors() -> None:
    others = '<participant id="X" processRef="gone"/><participant id="Y" name="rex" processRef="P1"/>'
    assert told(team(row(), pools=others), "error") == [
        "X: the pool's process is 'gone': the file has no such process",
        "Y: two pools have the name 'rex' (upper and lower case are the same)",
    ]


def test_a_pool_that_no_ros_robot_can_be_named_like_is_a_warning() -> None:
    others = '<participant id="X" name="My Robot" processRef="P1"/>'
    expected = f"X: /My Robot is not a valid ROS 2 namespace: expected {NAMES}"
    assert expected in told(team(row(), pools=others), "warning")


def test_a_file_of_black_boxes_has_nothing_to_run() -> None:
    text = document('<collaboration id="C"><participant id="B" name="crowd"/></collaboration>')
    assert told(text, "error") == [": nothing to run: its pools are black boxes: crowd"]
    assert str(checked(text)[0]) == "bad.bpmn: error: nothing to run: its pools are black boxes: crowd"


def test_a_robots_own_topic_has_one_type_in_all_that_the_robot_does() -> None:
    callee = f'<process id="Q">{row(catch("b", "odom", type=BOOL, scope="robot"), mark="2")}</process>'
    text = process(row(catch("a", "odom", type=VECTOR, scope="robot"), call("c", "Q")), callee + SIGNALS)
    expected = f'b: topic ~/odom has type {BOOL} here, but "odom" (a) says {VECTOR}: a topic has one type'
    assert told(text, "error") == [expected]


def test_robots_own_topics_of_two_robots_may_differ() -> None:
    one, other = catch("a", "odom", type=VECTOR, scope="robot"), catch("b", "odom", type=BOOL, scope="robot")
    assert told(team(row(one), row(other, mark="2"))) == []
