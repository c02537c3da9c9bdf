"""What `fame check` finds: every kind of bad model, and nothing in the good ones."""

from __future__ import annotations

import io
import re
from pathlib import Path

import pytest
from bpmn_text import document, extensions, process, properties
from gallery import gallery

from fame.bpmn import read, read_text
from fame.bpmn.model import Definitions
from fame.check import Finding, check, parts_of_one_mission, summary
from fame.check.findings import arranged
from fame.cli import main
from fame.errors import UnavailableError
from fame.library import Library
from fame.splitter import split

ROOT = Path(__file__).parent.parent
MODELS = sorted((ROOT / "models").rglob("*.bpmn"))
SIGNALS = "".join(f'<signal id="S_{name}" name="{name}"/>' for name in ("done", "found", "log", "odom"))
ERROR = '<error id="E" name="lost" errorCode="lost"/>' + "".join(
    f'<error id="E_{code}" name="{code}" errorCode="{code}"/>' for code in ("lost", "script", "unreachabel")
)


# ---- drawing ---------------------------------------------------------------------------------------------------------


def checked(text: str, *, strict: bool = False, library: Library | None = None) -> list[Finding]:
    """The findings about a file."""
    return check(read_text(text, file="bad.bpmn"), strict=strict, library=library)


def told(text: str, *levels: str, strict: bool = False) -> list[str]:
    """What is found in a file: ``element: text``, of these levels, errors and warnings if none is named."""
    found = checked(text, strict=strict)
    return [f"{one.element}: {one.text}" for one in found if one.level in (levels or ("error", "warning"))]


def flow(source: str, target: str, condition: str = "") -> str:
    """A sequence flow, its id made of those of its ends."""
    inside = f"<conditionExpression>{condition}</conditionExpression>" if condition else ""
    return f'<sequenceFlow id="{source}-{target}" sourceRef="{source}" targetRef="{target}">{inside}</sequenceFlow>\n'


def flows(*chains: str) -> str:
    """Sequence flows through elements in a row: ``"s a b e"``."""
    pairs = [pair for chain in chains for pair in zip(chain.split(), chain.split()[1:], strict=False)]
    return "".join(flow(source, target) for source, target in pairs)


def row(*elements: str, mark: str = "") -> str:
    """A start ``s``, the elements, and an end ``e``, one after the other. `mark` makes other ids of these."""
    ids = [element.partition('id="')[2].partition('"')[0] for element in elements]
    drawn = "\n".join([f'<startEvent id="s{mark}"/>', *elements, f'<endEvent id="e{mark}"/>'])
    return f"{drawn}\n{flows(' '.join([f's{mark}', *ids, f'e{mark}']))}"


def script(text: str, id: str = "t", format: str = "python") -> str:
    """A script task."""
    return f'<scriptTask id="{id}" scriptFormat="{format}"><script>{text}</script></scriptTask>'


def event(tag: str, id: str, signal: str, inside: str = "", after: str = "") -> str:
    """A signal event."""
    return f'<{tag} id="{id}" name="{signal}">{inside}<signalEventDefinition signalRef="S_{signal}"/>{after}</{tag}>'


def throw(id: str, signal: str = "done", **said: str) -> str:
    """An intermediate throw."""
    return event("intermediateThrowEvent", id, signal, properties(**said))


def catch(id: str, signal: str = "done", into: str = "", **said: str) -> str:
    """An intermediate catch; `into` is the data object that it fills."""
    output = f'<dataOutputAssociation id="{id}-{into}"><targetRef>{into}</targetRef></dataOutputAssociation>'
    inside = properties(**said) + (output if into else "")
    return event("intermediateCatchEvent", id, signal, inside)


def data(id: str, **values: str) -> str:
    """A data object with its variables."""
    inside = properties(**values)
    return f'<dataObjectReference id="{id}" name="{id}" dataObjectRef="{id}_o">{inside}</dataObjectReference>'


def reading(id: str, object: str, text: str = "pass") -> str:
    """A script task with an input association."""
    association = (
        f'<property id="{id}_p" name="__targetRef_placeholder"/><dataInputAssociation id="{id}-{object}">'
        f"<sourceRef>{object}</sourceRef><targetRef>{id}_p</targetRef></dataInputAssociation>"
    )
    return f'<scriptTask id="{id}">{association}<script>{text}</script></scriptTask>'


def filling(id: str, object: str, text: str) -> str:
    """A script task with an output association."""
    output = f'<dataOutputAssociation id="{id}-{object}"><targetRef>{object}</targetRef></dataOutputAssociation>'
    return f'<scriptTask id="{id}">{output}<script>{text}</script></scriptTask>'


def service(**said: str) -> str:
    """A service task."""
    return f'<serviceTask id="t">{properties(**said)}</serviceTask>'


def timer(tag: str, kind: str, text: str, attributes: str = "") -> str:
    """A timer event ``w``."""
    inside = f"<timerEventDefinition><{kind}>{text}</{kind}></timerEventDefinition>"
    return f'<{tag} id="w" {attributes}>{inside}</{tag}>'


def caught_at(activity: str, code: str) -> str:
    """An error boundary event ``b``, and an end ``be``."""
    inside = f'<errorEventDefinition errorRef="E_{code}"/>'
    return f'<boundaryEvent id="b" attachedToRef="{activity}">{inside}</boundaryEvent>{ends("be")}{flow("b", "be")}'


def alone(content: str) -> str:
    """A file with one process and no pool."""
    return process(content, SIGNALS + ERROR)


def team(*contents: str, pools: str = "") -> str:
    """A collaboration: pools REX, DINGO ... with processes P1, P2 ..."""
    names = ("REX", "DINGO", "DRONE")
    drawn = "".join(
        f'<participant id="Pool{n}" name="{names[n - 1]}" processRef="P{n}"/>' for n in range(1, len(contents) + 1)
    )
    bodies = "".join(f'<process id="P{n}">\n{content}\n</process>\n' for n, content in enumerate(contents, 1))
    return document(f'<collaboration id="C">{drawn}{pools}</collaboration>\n{bodies}{SIGNALS}{ERROR}')


def choice(id: str, attributes: str = "") -> str:
    """An exclusive gateway."""
    return f'<exclusiveGateway id="{id}" {attributes}/>'


def parallel(id: str) -> str:
    """A parallel gateway."""
    return f'<parallelGateway id="{id}"/>'


def ends(*ids: str) -> str:
    """None end events."""
    return "".join(f'<endEvent id="{id}"/>' for id in ids)


def call(id: str, called: str, inside: str = "") -> str:
    """A call activity."""
    return f'<callActivity id="{id}" calledElement="{called}">{inside}</callActivity>'


VECTOR, BOOL = "geometry_msgs/msg/Vector3", "std_msgs/msg/Bool"
START = '<startEvent id="s"/>'

# ---- errors ----------------------------------------------------------------------------------------------------------

ERRORS = {
    "a script that is not Python": (
        row(script("x = (1")),
        "t: not Python: '(' was never closed: `x = (1`",
    ),
    "a condition that is not Python": (
        START + choice("g", 'default="g-b"') + ends("a", "b") + flows("s g", "g b") + flow("g", "a", "x = 1"),
        "g: not Python: invalid syntax",
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
        "b: P has 2 none start events; one can begin it",
    ),
    "an event-based gateway that leads to a task": (
        START + '<eventBasedGateway id="g"/>' + script("x = 1") + ends("e") + flows("s g t e"),
        "g: leads to t, which is no catching event or receive task",
    ),
    "two types of one topic": (
        row(throw("a", type=BOOL), catch("b", type=VECTOR)),
        f"b: topic /done has type {VECTOR} here, but a says {BOOL}: a topic has one type",
    ),
    "a script with another type of a topic": (
        row(catch("a", type=BOOL), script('robot.publish("/done", "std_msgs/msg/String", data="x")')),
        f"t: topic /done has type std_msgs/msg/String here, but a says {BOOL}: a topic has one type",
    ),
    "a payload and no type": (
        row(throw("a", payload="true"), catch("b")),
        "a: topic /done has a payload and no type: give one of its events property type",
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
        f"a: the payload does not fit: {VECTOR}: x: found 'fast', expected a number",
    ),
    "a field that the type does not have": (
        row(throw("a", type=VECTOR, payload="{x: 1, w: 2}")),
        f"a: the payload does not fit: {VECTOR}: w: there is no such field; those of {VECTOR} are x, y, z",
    ),
    "a text where the fields of a message belong": (
        row(script("v = 1"), throw("a", type=VECTOR, payload="x: ${v}, y: ${v}")),
        f"a: the payload does not fit: {VECTOR}: found 'x: ${{v}}, y: ${{v}}', "
        f"expected {VECTOR} or a mapping with x, y, z",
    ),
    "a computed field that the type does not have": (
        row(script("v = 1"), throw("a", type="geometry_msgs/msg/Twist", payload="{linear: {w: ${v}}}")),
        "a: the payload does not fit: geometry_msgs/msg/Twist: linear.w: there is no such field; "
        f"those of {VECTOR} are x, y, z",
    ),
    "a script that publishes a field that the type does not have": (
        row(script('robot.publish("led", "std_msgs/msg/ColorRGBA", red=level)\nlevel = 1')),
        "t: what is published does not fit: std_msgs/msg/ColorRGBA: red: there is no such field; "
        "those of std_msgs/msg/ColorRGBA are r, g, b, a",
    ),
    "a script that publishes a constant of another type": (
        row(script('robot.publish("led", "std_msgs/msg/ColorRGBA", r="red")')),
        "t: what is published does not fit: std_msgs/msg/ColorRGBA: r: found 'red', expected a number",
    ),
    "a payload that is no YAML": (
        row(throw("a", type=VECTOR, payload="{x: [1}")),
        "a: neither YAML nor JSON: expected ',' or ']', but got '}' at letter 7: {x: [1}",
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
    "a duration that is none": (
        row(timer("intermediateCatchEvent", "timeDuration", "2s")),
        "w: timer duration: '2s' is not an ISO 8601 duration such as PT1.5S, PT10M or P1DT12H",
    ),
    "a date that is none": (
        row(timer("intermediateCatchEvent", "timeDate", "tomorrow")),
        "w: timer date: 'tomorrow' is not an ISO 8601 date and time such as 2026-01-31T12:00:00Z",
    ),
    "a cycle that is none": (
        timer("startEvent", "timeCycle", "R0/PT1S") + ends("e") + flows("w e"),
        "w: timer cycle: 'R0/PT1S' repeats never: give R1 or more, or R for without end",
    ),
    "a process that calls itself without end": (
        row(script("x = 1"), call("again", "P")),
        "again: P calls itself without end: every way through it meets such a call",
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
    assert error.text == f"called element 'Jump' is no process of this file, nor Jump.bpmn in {places}"


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
    assert "P: 100 of its elements are refused: no more are looked for" in [
        f"{one.element}: {one.text}" for one in found
    ]
    some = checked(alone(row(*(f'<businessRuleTask id="t{n}"/>' for n in range(90)))))
    assert not any("no more are looked for" in one.text for one in some)


def test_what_is_refused_brings_no_other_error_with_it() -> None:
    text = alone(START + '<eventBasedGateway id="g"/><receiveTask id="t"/>' + ends("e") + flows("s g t e"))
    assert told(text, "error") == ["t: a receive task needs a message"]


def test_an_error_names_the_line_of_the_script() -> None:
    (error,) = (one for one in checked(alone(row(script("x = 1\ny = 2\nz = (")))) if one.level == "error")
    assert str(error) == "bad.bpmn:6: error: t: not Python: '(' was never closed: `z = (`"


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
    others = '<participant id="X" processRef="P1"/><participant id="Y" name="rex" processRef="P1"/>'
    assert told(team(row(), pools=others), "error") == [
        "X: the pool has no name; name it like the robot that plays it",
        "Y: there are two pools 'rex' (case does not count)",
    ]


def test_a_pool_that_no_ros_robot_can_be_named_like_is_a_warning() -> None:
    right = "letters, digits and _ would be right, not beginning with a digit"
    others = '<participant id="X" name="My Robot" processRef="P1"/>'
    assert f"X: ROS 2 refuses the namespace /My Robot: {right}" in told(team(row(), pools=others), "warning")


def test_a_file_of_black_boxes_has_nothing_to_run() -> None:
    text = document('<collaboration id="C"><participant id="B" name="crowd"/></collaboration>')
    assert told(text, "error") == [": nothing to run: its pools are black boxes: crowd"]
    assert str(checked(text)[0]) == "bad.bpmn: error: nothing to run: its pools are black boxes: crowd"


def test_a_robots_own_topic_has_one_type_in_all_that_the_robot_does() -> None:
    callee = f'<process id="Q">{row(catch("b", "odom", type=BOOL, scope="robot"), mark="2")}</process>'
    text = process(row(catch("a", "odom", type=VECTOR, scope="robot"), call("c", "Q")), callee + SIGNALS)
    assert told(text, "error") == [f"b: topic ~/odom has type {BOOL} here, but a says {VECTOR}: a topic has one type"]


def test_robots_own_topics_of_two_robots_may_differ() -> None:
    one, other = catch("a", "odom", type=VECTOR, scope="robot"), catch("b", "odom", type=BOOL, scope="robot")
    assert told(team(row(one), row(other, mark="2"))) == []


# ---- warnings --------------------------------------------------------------------------------------------------------

BRANCHES = ends("a", "b")
WARNINGS = {
    "a script that is ready for a message that does not fit": (
        row(script('try:\n    robot.publish("led", "std_msgs/msg/ColorRGBA", red=1.0)\nexcept Exception:\n    pass')),
        "t: what is published does not fit: std_msgs/msg/ColorRGBA: red: there is no such field; "
        "those of std_msgs/msg/ColorRGBA are r, g, b, a",
    ),
    "an element that nothing leads to": (
        row(script("x = 1")) + script("y = 1", "lost"),
        "lost: is never reached: no flow leads here from a start",
    ),
    "a part that nothing leads to": (
        row(script("x = 1")) + script("y = 1", "lost") + ends("after") + flows("lost after"),
        "lost: is never reached, nor what follows it (1): no flow leads here from a start",
    ),
    "a circle that nothing leads to": (
        row(script("x = 1")) + script("y = 1", "c1") + script("y = 1", "c2") + flows("c1 c2 c1"),
        "c1: is never reached, nor what follows it (1): no flow leads here from a start",
    ),
    "an element that nothing follows": (
        START + parallel("g") + script("x = 1") + ends("e") + flows("s g t", "g e"),
        "t: nothing follows it, though other flows lead to an end event",
    ),
    "a gateway that nothing follows": (
        START + choice("g") + flows("s g"),
        "g: has no way out: the token ends here",
    ),
    "a choice without a default": (
        row(script("x = 1")) + choice("g") + BRANCHES + flows("s g") + flow("g", "a", "x") + flow("g", "b", "not x"),
        "g: has no way out if none of its conditions is true: mark one of its flows as the default",
    ),
    "a choice with a flow that has no condition": (
        row(script("x = 1")) + choice("g") + BRANCHES + flows("s g", "g a") + flow("g", "b", "x"),
        "g-a: has no condition, so g always takes it: give it one, or mark it as the default",
    ),
    "a choice with a default and a flow that has no condition": (
        row(script("x = 1")) + choice("g", 'default="g-b"') + BRANCHES + flows("s g", "g a", "g b"),
        "g-a: has no condition, so g always takes it: give it one, or mark it as the default",
    ),
    "a condition in quotes": (
        row(script("x = 1")) + choice("g", 'default="g-b"') + BRANCHES + flows("s g", "g b")
        + flow("g", "a", "'x > 3'"),
        "g-a: its condition is a text, always true: 'x > 3' without its quotes would be right",
    ),
    "a property that is spelt with a capital": (
        row(throw("a", "done", Type=BOOL)),
        "a: its property 'Type' has no effect: did you mean 'type'?",
    ),
    "a default flow with a condition": (
        row(script("x = 1")) + choice("g", 'default="g-b"') + BRANCHES + flows("s g") + flow("g", "a", "x")
        + flow("g", "b", "x"),
        "g-b: is the default flow: its condition is never asked",
    ),
    "a condition that leaves a parallel gateway": (
        row(script("x = 1")) + parallel("g") + BRANCHES + flows("s g", "g a") + flow("g", "b", "x"),
        "g-b: its condition is never asked: g takes no conditions",
    ),
    "a parallel join of an exclusive choice": (
        START + script("x = 1", "a") + script("x = 2", "b") + choice("g", 'default="g-b"') + parallel("j") + ends("e")
        + flows("s g b j e", "a j") + flow("g", "a", "1 > 0"),
        "j: waits for 2 flows from g, which takes only one: it may wait for ever",
    ),
    "an exclusive merge of parallel flows": (
        START + script("x = 1", "a") + script("x = 2", "b") + parallel("g") + choice("m") + ends("e")
        + flows("s g a m e", "g b m"),
        "m: is reached 2 times from g, and what follows it as often: a parallel gateway would wait for all",
    ),
    "a cycle that fires once": (
        row(timer("intermediateCatchEvent", "timeCycle", "R/PT1S")),
        "w: only the first time of its cycle counts, since it fires once: a duration says so",
    ),
    "a cycle on an interrupting boundary event": (
        row(script("x = 1")) + timer("boundaryEvent", "timeCycle", "R/PT1S", 'attachedToRef="t"') + flows("w e"),
        "w: only the first time of its cycle counts, since it fires once: a duration says so",
    ),
    "a signal that ROS cannot name": (
        row('<intermediateCatchEvent id="a" name="weed found"><signalEventDefinition/></intermediateCatchEvent>'),
        "a: ROS 2 refuses the topic /weed found: letters, digits and _ would be right, not beginning with a digit",
    ),
    "a topic of the robot without a type": (
        row(catch("a", "odom", scope="robot")),
        "a: no event says the type of the robot's topic ~/odom: it has to be known",
    ),
    "a data object filled by a topic without a type": (
        data("d", x="${x}", y="${y}") + row(catch("a", into="d")),
        "a: no event says the type of topic /done, so it carries std_msgs/msg/Empty, which has nothing for x, y",
    ),
    "a data object with names that the message does not have": (
        data("d", width="${width}") + row(catch("a", into="d", type=VECTOR)),
        f"a: {VECTOR} has no field for width: name them like its fields (x, y, z), or <field>_...",
    ),
    "a data object that nothing is connected to": (
        data("d", speed="0.5") + row(script("x = 1")),
        "d: no element is connected to it, so that nothing ever sets speed",
    ),
    "a variable that nothing sets": (
        row(script("target_x = 1"), script("y = target_z", "t2")),
        "t2: reads `target_z`, which nothing sets; did you mean `target_x`?",
    ),
    "a payload of what nothing sets": (
        row(throw("a", type=VECTOR, payload="{x: ${speed}}")),
        "a: reads `speed`, which nothing sets",
    ),
    "a condition on what nothing sets": (
        row(script("x = 1")) + choice("g", 'default="g-b"') + BRANCHES + flows("s g", "g b") + flow("g", "a", "low"),
        "g-a: reads `low`, which nothing sets",
    ),
    "a constant of Python where it is written small": (
        START + script("x = 1") + choice("g", 'default="g-b"') + BRANCHES + flows("s t g b")
        + flow("g", "a", "${x == True}"),
        "g-a: reads `True`, which nothing sets; here it is true",
    ),
    "a constant of other languages in Python": (
        row(script("x = true")),
        "t: reads `true`, which nothing sets; in Python it is True",
    ),
    "a name that only Python has": (
        row(throw("a", type="std_msgs/msg/Float64", payload="${math.pi}")),
        "a: reads `math`, which nothing sets; math is of Python: plain Python, without ${ }, knows it",
    ),
    "JavaScript in Python": (
        row(script("console.log(1)")),
        "t: reads `console`, which nothing sets; a script in JavaScript has format javascript",
    ),
    "an arrow to a data object that should come from it": (
        data("d", x="4") + row(filling("t", "d", "y = x")),
        "d: sets x when t has ended, which reads it: an arrow from it sets it before",
    ),
    "a decimal comma": (
        data("d", x="4,5") + row(reading("t", "d", "y = x")),
        "d: x is the text '4,5': the number is 4.5",
    ),
    "a sleep that blocks": (
        row(script("import time\ntime.sleep(1)")),
        "t: time.sleep holds up all that the robot does: await sleep(...)",
    ),
    "an error that is misspelt where it is caught": (
        row(script("x_goal, y_goal = 1, 1"), call("GoTo", "GoTo")) + caught_at("GoTo", "unreachabel"),
        "b: catches error 'unreachabel', which nothing in GoTo throws; did you mean 'unreachable'?",
    ),
    "an error that another activity throws": (
        row(script("raise BpmnError('spilt')")) + caught_at("t", "lost"),
        "b: catches error 'lost', which nothing in t throws; it throws spilt",
    ),
    "a timer of what nothing sets": (
        row(timer("intermediateCatchEvent", "timeDuration", "PT${pause}S")),
        "w: reads `pause`, which nothing sets",
    ),
    "a variable that hides the interface of scripts": (
        row(script("robot = 3")),
        "t: sets a variable `robot`, which hides robot of the script interface: name it otherwise",
    ),
    "a topic whose variable hides the interface of scripts": (
        row(catch("a", "log")),
        "a: sets a variable `log`, which hides log of the script interface: name it otherwise",
    ),
    "a script in JavaScript that never says next": (
        row(script("this.environment.variables.x = 1;", format="javascript")),
        "t: never calls next(), so it fails when it has run: next() completes a script",
    ),
    "a message that fills variables by their names": (
        row(script("next();", format="javascript"), catch("a", "found", type="geometry_msgs/msg/Vector3"))
        + data("goal", x_goal="${x_goal}"),
        "a: fills `x_goal` with field x, by the name alone: connect the event with the data object",
    ),
    "a process that calls itself without end, in time": (
        row(timer("intermediateCatchEvent", "timeDuration", "PT1S"), call("again", "P")),
        "again: P calls itself without end: every way through it meets such a call",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("content", "expected"), WARNINGS.values(), ids=WARNINGS.keys())
def test_it_is_a_warning(content: str, expected: str) -> None:
    assert expected in told(alone(content), "warning")


def test_a_signal_that_nobody_catches_is_a_warning_where_the_file_has_all_robots() -> None:
    one, other = row(throw("a")), row(catch("b", "found"), mark="2")
    assert told(team(one, other)) == [
        "a: throws /done, which nobody in bad.bpmn catches",
        "b: waits for /found, which nobody in bad.bpmn throws",
    ]
    assert told(team(one, row(catch("b"), mark="2"))) == []


def test_a_signal_that_is_spelt_in_two_ways_is_told_with_the_other_spelling() -> None:
    spelt = '<signal id="S_Done" name="Done"/></definitions>'
    text = team(row(throw("a", "Done")), row(catch("b"), mark="2")).replace("</definitions>", spelt)
    assert told(text) == [
        "a: throws /Done, which nobody in bad.bpmn catches; did you mean /done?",
        "b: waits for /done, which nobody in bad.bpmn throws; did you mean /Done?",
    ]


def test_it_is_a_note_where_others_may_be_at_the_other_end() -> None:
    expected = ["a: throws /done, which nobody in bad.bpmn catches"]
    for text in (alone(row(throw("a"))), team(row(throw("a")), pools='<participant id="X" name="crowd"/>')):
        assert told(text) == []
        assert [line for line in told(text, "note") if line.startswith("a")] == expected


def test_a_script_in_javascript_may_try_a_type_that_nobody_knows() -> None:
    makes = 'node.createPublisher("geometry_msgs/msg/Vektor3", "v")'
    said = "t: type geometry_msgs/msg/Vektor3: there is no such message type; did you mean geometry_msgs/msg/Vector3"
    for text, level in ((makes, "error"), (f"try {{ {makes} }} catch (e) {{}}", "warning")):
        (found,) = told(alone(row(script(f"{text}; next()", format="js"))), level)
        assert found.startswith(said)


def test_scripts_are_at_the_ends_of_topics_too() -> None:
    sends = row(script('signal("done")'), script('await receive("/found")', "t2"))
    assert told(team(sends, row(catch("a"), throw("b", "found"), mark="2"))) == []


def test_the_topics_of_a_robot_are_its_drivers_affair() -> None:
    own = row(throw("a", "odom", scope="robot", type=BOOL, payload="true"))
    assert told(team(own, row(mark="2"))) == []


def test_what_the_reader_notes_is_passed_on() -> None:
    label = '<intermediateThrowEvent id="a" name="other">' + extensions(f'<ros:message type="{BOOL}"/>')
    text = alone(row(label + '<signalEventDefinition signalRef="S_done"/></intermediateThrowEvent>'))
    assert told(text) == ["a: the topic is 'done', the name of the signal, not the label 'other'"]


def test_an_interrupting_handler_of_the_originals_models_is_a_warning() -> None:
    start = event("startEvent", "hs", "done")
    handler = f'<subProcess id="h" triggeredByEvent="true">{start}{ends("he")}{flows("hs he")}</subProcess>'
    text = alone(row(script("next()", format="javascript")) + handler)
    expected = (
        "h: ends what its scope was doing; the original FaMe went on with it afterwards: "
        "property semantics=original on the process does that"
    )
    assert expected in told(text)
    original = text.replace('isExecutable="true" >\n', f'isExecutable="true">\n{properties(semantics="original")}')
    assert original != text
    assert expected not in told(original)
    assert expected not in told(alone(row(script("x = 1")) + handler))


def test_a_language_that_is_not_installed_is_a_warning(monkeypatch: pytest.MonkeyPatch) -> None:
    def compile_script(*arguments: object, **named: object) -> object:
        raise UnavailableError("t: JavaScript is not installed: pip install it")

    monkeypatch.setattr("fame.check.compiling.compile_script", compile_script)
    expected = "t: cannot be checked: JavaScript is not installed: pip install it"
    assert told(alone(row(script("next()", format="javascript")))) == [expected]


# ---- variables -------------------------------------------------------------------------------------------------------

CALLEE = (
    f'<process id="Q">{data("goal", x_goal="${x_goal}")}{row(reading("q", "goal", "y = x_goal"), mark="2")}</process>'
)


def calling(inside: str = "", before: str = "ready = True") -> str:
    """A pool whose process calls Q, which needs x_goal."""
    return team(row(script(before), call("c", "Q", inside))).replace("<signal", f"{CALLEE}<signal", 1)


def test_a_called_process_gets_the_variables_of_its_caller() -> None:
    assert told(calling()) == ["c: Q reads `x_goal`, which nothing sets"]
    assert told(calling(before="x_goal = 1")) == []


def test_a_behaviour_called_by_a_process_that_declares_nothing_lacks_its_inputs() -> None:
    found = checked(process(row(call("c", "GoTo"))), library=Library([ROOT / "models" / "library"]))
    assert [str(one.text) for one in found] == [
        f"GoTo reads `{name}`, which nothing sets" for name in ("x_goal", "y_goal")
    ]


MONITORED = {
    "joint_monitor": ["joint_monitor reads `model`, which nothing sets"],
    "adm_operate": ["adm_operate needs `model`, which nothing sets"],
    "Record": ["Record needs `configuration`, which nothing sets", "Record needs `output`, which nothing sets"],
}


@pytest.mark.parametrize("called", MONITORED)
def test_a_monitoring_unit_that_is_called_lacks_what_it_cannot_do_without(called: str) -> None:
    assert told(team(row(call("c", called)))) == [f"c: {text}" for text in MONITORED[called]]
    assert told(team(row(script("model = configuration = output = 'x'"), call("c", called)))) == []


def test_what_a_monitoring_unit_gives_is_set() -> None:
    learnt = row(script("config = 'l.yaml'"), call("c", "adm_learn"), script("x = classifier", "u"))
    assert told(team(learnt)) == []
    assert told(team(learnt.replace("x = classifier", "x = score"))) == ["u: reads `score`, which nothing sets"]


def test_a_called_process_with_a_mapping_gets_what_that_names() -> None:
    given = extensions('<camunda:in source="x" target="x_goal"/>')
    other = extensions('<camunda:in source="x" target="y_goal"/>')
    everything = extensions('<camunda:in variables="all"/>')
    assert told(calling(given, "x = 1")) == []
    assert told(calling(given)) == ["c: reads `x`, which nothing sets"]
    assert told(calling(everything, "x_goal = 1")) == []
    assert told(calling(everything)) == ["c: Q reads `x_goal`, which nothing sets: give it in the mapping"]
    assert told(calling(other, "x = x_goal = 1")) == [
        "c: Q reads `x_goal`, which nothing sets; did you mean `y_goal`?",
    ]


def test_a_process_without_a_pool_is_given_what_its_data_objects_declare() -> None:
    text = data("goal", x_goal="${x_goal}") + row(reading("t", "goal", "y = x_goal"))
    assert told(alone(text)) == []
    assert told(team(text)) == ["t: reads `x_goal`, which nothing sets"]
    assert told(alone(row(script("y = x_goal")))) == ["t: reads `x_goal`, which nothing sets"]


def test_a_data_object_sets_its_values_where_it_is_connected() -> None:
    text = data("area", x_min="0.5", x_max="${x_min + 1}") + row(reading("t", "area", "y = x_max - x_min"))
    assert told(team(text)) == []


def test_a_caught_message_sets_what_it_fills() -> None:
    plain = row(catch("a", type=BOOL), script("y = done"))
    filled = data("d", x_weed="${x_weed}") + row(catch("a", type=VECTOR, into="d"), script("y = x_weed"))
    assert told(team(plain)) == []
    assert told(team(filled)) == []
    assert told(team(filled.replace("y = x_weed", "y = done"))) == ["t: reads `done`, which nothing sets"]


def test_where_people_set_variables_nothing_is_said_of_them() -> None:
    assert told(team(row('<userTask id="u"/>', script("y = answer")))) == []


def test_strict_makes_what_a_payload_lacks_an_error() -> None:
    text = alone(row(throw("a", type=VECTOR, payload="{x: ${speed}}"), script("y = pace")))
    assert told(text, "error") == []
    assert told(text, "error", strict=True) == ["a: reads `speed`, which nothing sets"]


# ---- what is not blamed ----------------------------------------------------------------------------------------------

GUARD = '<boundaryEvent id="w" attachedToRef="{}"><errorEventDefinition/></boundaryEvent>'
FINE = {
    "a recursion with a way out": (
        START + choice("g", 'default="g-e"') + call("again", "P") + script("n = 1") + ends("e")
        + flows("s t g e", "again e") + flow("g", "again", "n > 0")
    ),
    "a recursion that a script ends": row(script('raise BpmnError("enough")'), call("again", "P")),
    "a recursion with a way past by a boundary event": (
        row(script("x = 1"), call("again", "P")) + GUARD.format("t") + flows("w e")
    ),
    "a recursion that ends where no condition is true": (
        START + script("n = 1") + call("again", "P") + ends("e") + flows("s t", "again e") + flow("t", "again", "n > 0")
    ),
    "a parallel join of parallel flows": (
        START + parallel("g") + script("x = 1", "a") + script("x = 2", "b") + parallel("j") + ends("e")
        + flows("s g a j e", "g b j")
    ),
    "an exclusive merge of a choice": (
        START + choice("g", 'default="g-b"') + script("x = 1", "a") + script("x = 2", "b") + choice("m") + ends("e")
        + flows("s g b m e", "a m") + flow("g", "a", "1 > 0")
    ),
    "a loop": (
        START + choice("m") + script("x = 1") + choice("g", 'default="g-m"') + ends("e")
        + flows("s m t g m") + flow("g", "e", "x")
    ),
    "links": (
        START + '<intermediateThrowEvent id="a"><linkEventDefinition name="l"/></intermediateThrowEvent>'
        '<intermediateCatchEvent id="b"><linkEventDefinition name="l"/></intermediateCatchEvent>' + ends("e")
        + flows("s a", "b e")
    ),
    "a cycle that goes on beside its activity": (
        row('<userTask id="t"/>') + ends("x")
        + timer("boundaryEvent", "timeCycle", "R/PT1S", 'attachedToRef="t" cancelActivity="false"') + flows("w x")
    ),
    "a flow that starts without a start event": script("x = 1") + script("y = x", "t2") + flows("t t2"),
    "an event sub-process": (
        row(catch("a")) + '<subProcess id="h" triggeredByEvent="true">'
        + event("startEvent", "hs", "found") + ends("he") + flows("hs he") + "</subProcess>"
    ),
    "a payload of computed values": row(
        script("v = [1, 2]"), throw("a", type="geometry_msgs/msg/Pose", payload="{position: {x: ${v[0]}}}")
    ),
    "results of a script in a data object": data("d", x="${x}") + row(filling("t", "d", "x = 1")),
    "an error that a script throws": row(script("raise BpmnError('lost')")) + caught_at("t", "lost"),
    "an error of whatever code": row(script("raise BpmnError(codes[0])\ncodes = []")) + caught_at("t", "lost"),
    "an exception": row(script("x = 1 / 0")) + caught_at("t", "script"),
    "an error of a service": row(service(service="a", type="std_srvs/srv/Trigger")) + caught_at("t", "lost"),
    "an error inside": (
        row('<subProcess id="p">' + row(script("raise BpmnError('lost')"), mark="2") + "</subProcess>")
        + caught_at("p", "lost")
    ),
    "an activity that a boundary event leads on from": (
        START + script("await until(lambda: False)") + ends("e") + flows("s t", "w e")
        + timer("boundaryEvent", "timeDuration", "PT1S", 'attachedToRef="t"')
    ),
    "a number made of two": row(script("v = 1"), throw("a", type="std_msgs/msg/Int32", payload="${v}${v}")),
    "a wrapper's payload": row(script("v = 1"), throw("a", type="std_msgs/msg/Float64", payload="${v}")),
    "a computed list": row(
        script("v = 1"),
        throw("a", type="std_msgs/msg/Float64MultiArray", payload="{data: [1, ${v}], layout: {dim: [{size: ${v}}]}}"),
    ),
    "a computed time": row(script("v = 1"), timer("intermediateCatchEvent", "timeDuration", "PT${v}S")),
    "a time that is an expression": row(script("v = 'PT1S'"), timer("intermediateCatchEvent", "timeDuration", "${v}")),
    "a type on one event alone": row(throw("a", payload="true"), catch("b", type=BOOL)),
    "a script that takes a topic as it is": row(script('x = robot.latest("odom")')),
    "a script that hides a builtin": row(catch("a", "found"), script("range = 3")),
}  # fmt: skip


@pytest.mark.parametrize("content", FINE.values(), ids=FINE.keys())
def test_it_is_not_blamed(content: str) -> None:
    assert told(alone(content)) == []


# ---- notes -----------------------------------------------------------------------------------------------------------

NOTES = {
    "a script task without a script": (row('<scriptTask id="t"/>'), "t: has no script: it completes at once"),
    "a plain task": (row('<task id="t"/>'), "t: a plain task does nothing: it completes at once"),
    "a user task": (
        row('<userTask id="t"/>'),
        "t: a user task is outside of the elements that the guidelines select (G2)",
    ),
    "an embedded sub-process": (
        row(f'<subProcess id="t">{row(mark="2")}</subProcess>'),
        "t: an embedded sub-process is outside of the elements that the guidelines select (G2)",
    ),
    "an inclusive gateway": (
        row('<inclusiveGateway id="t"/>'),
        "t: an inclusive gateway is outside of the elements that the guidelines select (G2)",
    ),
    "a message event": (
        row('<intermediateThrowEvent id="t" name="m"><messageEventDefinition/></intermediateThrowEvent>'),
        "t: a message event is outside of the elements that the guidelines select (G2)",
    ),
    "a service task": (
        row('<serviceTask id="t" implementation="grip"/>'),
        "t: needs the service 'grip' where it runs: Simulation(services=...)",
    ),
    "a condition on what no data object declares": (
        row(script("low = 1")) + choice("g", 'default="g-b"') + BRANCHES + flows("s g", "g b") + flow("g", "a", "low"),
        "g-a: decides by `low`, which no data object declares (G4)",
    ),
    "a payload of what no data object declares": (
        row(script("v = 1"), throw("a", type=VECTOR, payload="{x: ${v}}")),
        "a: sends `v`, which no data object declares (G4)",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("content", "expected"), NOTES.values(), ids=NOTES.keys())
def test_it_is_a_note(content: str, expected: str) -> None:
    assert expected in told(alone(content), "note")


def test_message_flows_and_black_boxes_are_notes() -> None:
    pools = '<participant id="X" name="crowd"/><messageFlow id="M" sourceRef="Pool1" targetRef="X"/>'
    assert told(team(row(), pools=pools), "note") == [
        "X: is a black box: no robot plays it, and its signals come from elsewhere",
        "M: message flows have no effect: robots talk by signals, which are matched by name (G3)",
    ]


def test_two_pools_that_do_the_same_are_a_note() -> None:
    one = data("d", x="1") + row(reading("a", "d", "y = x"))
    other = one.replace('id="', 'id="o_').replace('Ref="', 'Ref="o_').replace("Ref>", "Ref>o_").replace("o_</", "</")
    expected = "Pool2: does the same as pool REX: one multi-instance pool stands for all such robots (G1)"
    assert expected in told(team(one, other), "note")
    assert expected not in told(team(one, other.replace("y = x", "y = -x")), "note")


# ---- the whole -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("model", MODELS, ids=lambda file: file.stem)
def test_the_models_that_come_with_fame_have_no_error_and_no_warning(model: Path) -> None:
    assert [str(one) for one in check(read(model)) if one.level != "note"] == []


def test_a_file_with_everything_is_checked_to_its_end() -> None:
    found = check(read_text(gallery(), file="gallery.bpmn"))
    assert {one.level for one in found} == {"error", "warning", "note"}
    assert len(set(found)) == len(found)
    assert all(one.file == "gallery.bpmn" and "\n" not in str(one) for one in found)


def test_findings_come_in_the_order_of_the_file_and_once() -> None:
    first, second = Finding("note", "a", "m.bpmn", 2), Finding("error", "b", "m.bpmn", 2)
    third, other = Finding("error", "c", "m.bpmn", 7), Finding("error", "d", "lib.bpmn", 1)
    assert arranged([other, third, first, third, second], ["m.bpmn", "lib.bpmn"]) == [second, first, third, other]


def test_a_summary_counts_by_level() -> None:
    found = checked(alone(row(script("x = (1"), '<task id="a"/>', '<task id="b"/>')))
    assert summary(found) == "1 error, 2 notes"
    assert summary([]) == "nothing found"


def test_a_finding_is_one_line() -> None:
    assert str(Finding("warning", "no way out", "m.bpmn", 12, "g")) == "m.bpmn:12: warning: g: no way out"
    assert str(Finding("note", "no pool", "m.bpmn")) == "m.bpmn: note: no pool"
    assert str(Finding("note", "no pool")) == "note: no pool"


@pytest.mark.parametrize("text", [text for table in (ERRORS, WARNINGS, NOTES) for _, text in table.values()])
def test_the_documentation_shows_it(text: str) -> None:
    assert text.partition(": ")[2] in (ROOT / "docs" / "checks.md").read_text("utf-8")


# ---- several files ---------------------------------------------------------------------------------------------------


def parts(*contents: str) -> list[Definitions]:
    """The files of a split mission."""
    return [
        read_text(part.source.decode(), file=part.filename)
        for part in split(read_text(team(*contents), file="whole.bpmn"))
    ]


def told_of(files: list[Definitions]) -> list[str]:
    """What is found in files that are given together."""
    return [
        str(one) for mission in parts_of_one_mission(files) for file in mission for one in check(file, team=mission)
    ]


TALK = (row(throw("a", type=BOOL)), row(catch("b", type=BOOL), mark="2"))


def test_the_parts_of_a_mission_hear_each_other() -> None:
    rex, dingo = parts(*TALK)
    assert any("throws /done, which nobody in REX.bpmn catches" in text for text in told_of([rex]))
    assert told_of([rex, dingo]) == []


def test_what_no_part_hears_is_a_note_since_others_may_not_have_been_given() -> None:
    found = told_of(parts(row(throw("a", type=BOOL)), row(catch("b", "found", type=BOOL), mark="2")))
    assert [text.partition(": ")[2] for text in found] == [
        "note: a: throws /done, which nobody in the 2 files of the mission catches",
        "note: b: waits for /found, which nobody in the 2 files of the mission throws",
    ]


def test_two_types_of_one_topic_in_two_parts_are_an_error_of_the_second() -> None:
    rex, dingo = parts(*TALK)
    edited = read_text(dingo.source.decode().replace(BOOL, VECTOR), file="DINGO.bpmn")
    (found,) = told_of([rex, edited])
    assert found.startswith("DINGO.bpmn:")
    assert found.endswith(f"error: b: topic /done has type {VECTOR} here, but a says {BOOL}: a topic has one type")


def test_files_of_other_missions_and_other_splits_of_the_same_are_apart() -> None:
    rex, dingo = parts(*TALK)
    again, whole = parts(*TALK)[0], read_text(team(*TALK), file="whole.bpmn")
    other = read_text(rex.source.decode().replace('collaboration id="C"', 'collaboration id="D"'), file="other.bpmn")
    library = read_text(alone(row(script("x = 1"))), file="library.bpmn")
    found = parts_of_one_mission([rex, whole, other, again, library, dingo])
    assert [[file.file for file in mission] for mission in found] == [
        ["REX.bpmn", "DINGO.bpmn"], ["whole.bpmn"], ["other.bpmn"], ["REX.bpmn"], ["library.bpmn"],
    ]  # fmt: skip


def test_what_the_reader_notes_at_many_places_is_told_at_the_first() -> None:
    tasks = [
        script("pass", f"t{n}").replace("<scriptTask", '<scriptTask camunda:asyncBefore="true"') for n in (1, 2, 3)
    ]
    notes = told(alone(row(*tasks)), "note")
    assert notes == ["t1: camunda:asyncBefore has no effect, here and in 2 more places"]
    assert told(alone(row(tasks[0])), "note") == ["t1: camunda:asyncBefore has no effect"]


# ---- the command -----------------------------------------------------------------------------------------------------


def test_a_model_comes_from_stdin(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    text = alone(row(script("x = (1")))
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(text.encode())))
    assert main(["check", "-"]) == 1
    assert re.match(r"<stdin>:\d: error: t: not Python", capsys.readouterr().out)


NO_MODELS = {
    "notes.txt": (b"take milk", 1, "notes.txt:1: error: not well-formed XML: "),
    "empty.bpmn": (b"", 1, "empty.bpmn:1: error: not well-formed XML: "),
    "model.zip": (b"PK\x03\x04and so on", 1, "model.zip: error: is a zip archive: take the .bpmn file out of it"),
    "folder": (None, 2, "folder: is a folder; its files would be right: "),
    "gone.bpmn": (None, 2, "gone.bpmn: there is no such file"),
}


@pytest.mark.parametrize("name", NO_MODELS)
def test_what_is_no_model_is_told_in_one_line(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content, code, said = NO_MODELS[name]
    (tmp_path / "folder").mkdir()
    if content is not None:
        (tmp_path / name).write_bytes(content)
    assert main(["check", str(tmp_path / name)]) == code
    out, err = capsys.readouterr()
    assert said in (out if code == 1 else err)
    assert (out + err).count("\n") == (2 if code == 1 else 1)


def test_thousands_of_findings_are_all_told_and_counted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "many.bpmn"
    path.write_text(alone(row(*(f'<manualTask id="t{n}"/>' for n in range(2000)))))
    assert main(["check", str(path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert (len(lines), lines[-1]) == (2001, "2000 notes")
