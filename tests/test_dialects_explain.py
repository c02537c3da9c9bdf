"""``fame check --explain``: what a foreign file was read as, and each habit of its tool on which it relies."""

import json
from html import escape
from pathlib import Path

import pytest
from bpmn_text import document, extensions, process, properties

from fame.bpmn import read_text
from fame.bpmn.library import Library
from fame.bpmn.model import Expression
from fame.check.explain import ReadingDetail, ReadingKind, readings
from fame.cli import main
from fame.scripting import effects_of

MODELS = Path(__file__).parent / "models"
ROOTS = '<signal id="S" name="weed_found"/><signal id="N"/>'
SIGNAL = '<signalEventDefinition signalRef="S"/>'
VECTOR = "geometry_msgs/msg/Vector3"
OBJECT = '<dataObject id="o"/><dataObjectReference id="d" dataObjectRef="o">{}</dataObjectReference>'
OUTPUT = '<dataOutputAssociation id="a"><targetRef>d</targetRef></dataOutputAssociation>'


def kinds_read(content: str, kind: ReadingKind, root: str = ROOTS, attributes: str = "") -> list[tuple[str, str]]:
    """(element, text) of the readings of one kind."""
    found = readings(read_text(process(content, root, attributes), file="m.bpmn"))
    return [(one.element, one.text) for one in found if one.kind == kind]


def script(text: str, tag: str = "scriptTask") -> str:
    """A script task in JavaScript."""
    return f'<{tag} id="t" scriptFormat="javascript"><script><![CDATA[{text}]]></script></{tag}>'


# ---- topics, data, calls ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (f'<endEvent id="e">{properties(type=VECTOR, payload="{x: 1}")}{SIGNAL}</endEvent>',
         f"throws /weed_found, {VECTOR}, payload {{x: 1}}"),
        (f'<endEvent id="e">{properties(type=VECTOR, payload="")}{SIGNAL}</endEvent>',
         f"throws /weed_found, {VECTOR}, a message of default values"),
        (f'<endEvent id="e">{SIGNAL}</endEvent>',
         "throws /weed_found, std_msgs/msg/Empty (not declared), a message of default values"),
        (f'<startEvent id="e">{properties(type=VECTOR)}{SIGNAL}</startEvent>',
         f"catches /weed_found, {VECTOR}, into weed_found"),
        (f'<startEvent id="e">{properties(type=VECTOR)}{OUTPUT}{SIGNAL}</startEvent>'
         + OBJECT.format(properties(x_weed="", y="")), f"catches /weed_found, {VECTOR}, x_weed = x, y = y"),
        (f'<startEvent id="e">{properties(type=VECTOR)}{OUTPUT}{SIGNAL}</startEvent>'
         + OBJECT.format(properties(width="")), f"catches /weed_found, {VECTOR}, nothing for width"),
        ('<serviceTask id="e">' + extensions('<ros:service name="tello" type="std_srvs/srv/SetBool"/>'
         '<ros:payload data="{data: true}"/>') + "</serviceTask>",
         "calls the service tello, std_srvs/srv/SetBool, request {data: true}"),
    ],
)  # fmt: skip
def test_it_says_what_is_sent_and_where_fields_go(content: str, text: str) -> None:
    assert kinds_read(content, "topic") == [("e", text)]


def test_a_type_that_another_event_says_is_told_with_that() -> None:
    said, silent = (
        f'<endEvent id="e">{properties(type=VECTOR)}{SIGNAL}</endEvent>',
        f'<startEvent id="s">{SIGNAL}</startEvent>',
    )
    assert ("s", f"catches /weed_found, {VECTOR} (declared elsewhere), into weed_found") in kinds_read(
        said + silent, "topic"
    )


def test_it_says_what_scripts_do_with_topics() -> None:
    text = "const n = this.environment.variables.ros_node;\nn.createPublisher('std_msgs/msg/Bool', 'led'); next();"
    assert kinds_read(script(text), "topic") == [("t", "its script publishes ~/led, std_msgs/msg/Bool")]


def test_it_says_which_services_scripts_ask() -> None:
    text = "this.environment.variables.ros_node.createClient('std_srvs/srv/SetBool', 'light'); next();"
    assert kinds_read(script(text), "topic") == [("t", "its script calls the service light, std_srvs/srv/SetBool")]


def test_it_says_which_variables_a_data_object_holds() -> None:
    held = OBJECT.format(properties(x_min="0.0", x_goal=""))
    assert kinds_read(held, "data") == [("d", "holds x_min = 0.0, x_goal")]


def test_it_says_where_each_called_process_was_found(tmp_path: Path) -> None:
    (tmp_path / "Fly.bpmn").write_text(process('<startEvent id="s"/>'))
    inner = escape('<bpmn2:process id="Turn"><bpmn2:startEvent id="i"/></bpmn2:process>', quote=True)
    embedded = extensions(f'<callActivity:process process="{inner}"/>')
    calls = f'<callActivity id="a" calledElement="Q"/><callActivity id="b">{embedded}</callActivity>'
    calls += '<callActivity id="c" calledElement="Fly"/><callActivity id="d" calledElement="Swim"/>'
    definitions = read_text(process(calls, '<process id="Q"><startEvent id="q"/></process>'), file="m.bpmn")
    found = {one.element: one.text for one in readings(definitions, library=Library([tmp_path])) if one.kind == "call"}
    assert found["a"] == "calls process Q of this file"
    assert found["b"] == "calls process Turn, which is embedded in it"
    assert found["c"] == f"calls process P of {tmp_path / 'Fly.bpmn'}, the only one of Fly.bpmn"
    assert found["d"].startswith("calls nothing: called element 'Swim': found neither a process of this file")


def test_it_says_in_which_language_a_text_is_written() -> None:
    flows = "".join(
        f'<sequenceFlow id="{id}" sourceRef="s" targetRef="t"><conditionExpression {language}>{text}'
        "</conditionExpression></sequenceFlow>"
        for id, language, text in (
            ("f", "", "=x > 1"),
            ("g", "", "${x > 1}"),
            ("h", 'language="js"', "1"),
            ("i", "", "x > 1"),
        )
    )
    assert kinds_read(f'<startEvent id="s"/><task id="t"/>{flows}', "script") == [
        ("f", "condition in FEEL: x > 1"),
        ("g", "condition in Camunda 7, ${...}: ${x > 1}"),
        ("h", "condition in JavaScript: 1"),
    ]


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("fame_g0", "has lists of type and payload (FaMe G0), Camunda 7 (FaMe G1, FAME)"),
        ("fame_g1", "has Camunda 7 (FaMe G1, FAME)"),
        ("fame_g2", "has FaMe's web modeler (G2)"),
        ("camunda8", "has Camunda 8"),
    ],
)
def test_it_says_whose_form_a_file_has(name: str, text: str) -> None:
    path = MODELS / "dialects" / f"{name}.bpmn"
    first = readings(read_text(path.read_text(), file=str(path)))[0]
    assert first == ReadingDetail("form", text, str(path))


# ---- quirks ----------------------------------------------------------------------------------------------------------

LIST = f"<camunda:list><camunda:value>{VECTOR}</camunda:value></camunda:list>"
OLDEST = (
    f'<camunda:inputOutput><camunda:inputParameter name="drive">{LIST}</camunda:inputParameter></camunda:inputOutput>'
)


@pytest.mark.parametrize(
    ("content", "quirks"),
    [
        (f'<endEvent id="e" name="Weed!">{properties(type=VECTOR)}{SIGNAL}</endEvent>',
         ["the topic is 'weed_found', the name of the signal, not the label 'Weed!'"]),
        ('<endEvent id="e" name="weed"><signalEventDefinition signalRef="N"/></endEvent>',
         ["the signal has no name: the topic is the label 'weed'"]),
        ('<endEvent id="e" name="weed"><signalEventDefinition signalRef="Gone"/></endEvent>',
         ["the file has no signal 'Gone': the topic is the label 'weed'"]),
        (f'<endEvent id="e">{extensions(OLDEST)}{SIGNAL}</endEvent>',
         ["topic, type and payload are those of the input parameter 'drive'"]),
        (f'<endEvent id="e">{extensions("""<ros:payload><ros:parameter name="x:" value="1"/></ros:payload>""")}{SIGNAL}'
         "</endEvent>", ["the parameter 'x:' is 'x'"]),
        (f'<endEvent id="e">{extensions("""<qos:policy reliability="0"/>""")}{SIGNAL}</endEvent>',
         ["quality of service reliability=0 is reliability best_effort"]),
        (script("this.environment.variables.x = 1;"), ["never calls next()"]),
        (script("const n = this.environment.variables.node; next();"), ["uses node for ros_node"]),
        (script("const { ros_node: n } = this.environment.variables; next();"), []),
        (f'<startEvent id="e">{properties(type=VECTOR)}{SIGNAL}</startEvent>' + script("next();")
         + OBJECT.format(properties(x_goal="${x_goal}")),
         ["fills x_goal with field x because the names are alike: no data object is connected"]),
    ],
)  # fmt: skip
def test_it_names_the_habits_on_which_a_file_relies(content: str, quirks: list[str]) -> None:
    assert [text for _, text in kinds_read(content, "quirk")] == quirks


def test_topics_by_label_are_said_too() -> None:
    said = f'{properties(topics="labels")}<endEvent id="e" name="Weed">{SIGNAL}</endEvent>'
    text = "the topic is the label 'Weed', not the name of the signal 'weed_found' (topics=labels)"
    assert kinds_read(said, "quirk") == [("e", text)]


HANDLER = '<subProcess id="h" triggeredByEvent="true"><startEvent id="i"{}>' + SIGNAL + "</startEvent></subProcess>"


def test_it_names_each_place_that_semantics_original_changes() -> None:
    gentle = HANDLER.replace('"h"', '"g"').replace('"i"', '"j"').format(' isInterrupting="false"')
    text = "ends its scope; with semantics=original the scope is suspended and resumes afterwards"
    assert kinds_read(HANDLER.format("") + gentle, "semantics") == [("h", text)]
    said = properties(semantics="original") + HANDLER.format("")
    assert kinds_read(said, "semantics") == [("h", "suspends its scope, which resumes afterwards (semantics=original)")]


# ---- the words of a script -------------------------------------------------------------------------------------------

ENV = "const env = this.environment.variables; "


@pytest.mark.parametrize(
    ("text", "reads", "writes", "is_open"),
    [
        ("const env = this.environment.variables; env.x = env.y + 1; // env.z", "y", "x", False),
        ("const { x, y: other } = this.environment.variables; log('environment.variables.z')", "x y", "", False),
        ("const self = this; setTimeout(() => { self.environment.variables.a += 1; })", "a", "a", False),
        ("const self = this; f(self)", "", "", True),
        ("let self = this; self = g(); self.environment.variables.a = 1", "", "a", True),
        ("environment.variables.k++; delete environment.variables.m", "k", "k m", False),
        ("if (this.environment.variables.a == null || `${this.environment.variables.b}`) {}", "a b", "", False),
        ("Object.assign(this.environment.variables, {a: 1})", "", "", True),
        ("const { variables } = this.environment; variables.x = 1", "", "", True),
        ("const env = this.environment.variables; env[name] = 1", "", "", True),
        (ENV + r"""if (/["'`]/.test(env.a)) { env.b = 1; } env.s = 'x';""", "a", "b s", False),
        (ENV + r"""env.x = env.a.replace(/[/]\//, ''); env.n = env.m / 2 / 3;""", "a m", "x n", False),
        (ENV + "env.s = `{ ${JSON.stringify({a: env.x})}`;", "x", "s", False),
        (ENV + "env.s = `a ${env.x + `b`}`;", "", "s", True),
        (ENV + "const {a, ...rest} = env;", "", "", True),
        (ENV + "const {[k]: v} = env;", "", "", True),
        (ENV + "({a: env.x} = env)", "x", "x", True),
        (ENV + "const {x = 'a', y: z = 2,} = env;", "x y", "", False),
        (ENV + "[env.x, env.y] = [env.y, 3]; const [z] = [env.z]; env.l[env.i] = 1;", "x y z l i", "x y", False),
        (ENV + "({a: env.x, b: [env.y]} = env.z); for ({a: env.k} of []) {}", "x y z k", "x y k", False),
        (ENV + "for (env.i of []) {} for (env.k in {}) {}", "i k", "i k", False),
        (ENV + "++env.x; env.y ??= 5; env.z ||= 1; env.w &&= 1; env.v >>>= 1", "x y z w v", "x y z w v", False),
        (ENV + "(env.x) = 1; if (env.y) next()", "y", "x", False),
        ("const e$ = this.environment.variables; e$.x = e$.y", "y", "x", False),
        ("const x = this.environment.variables\n  .x; x.y = 1", "x", "", False),
    ],
)  # fmt: skip
def test_the_variables_that_a_script_names_are_known(text: str, reads: str, writes: str, is_open: bool) -> None:
    found = effects_of(Expression(text, "javascript"), script=True)
    assert (found.reads, found.sets, found.open) == (frozenset(reads.split()), frozenset(writes.split()), is_open)


def test_a_topic_in_a_comment_is_none_and_a_variable_named_next_is_no_call() -> None:
    text = "// ros_node.createPublisher('std_msgs/msg/Bool', 'gone')\nn.createPublisher('std_msgs/msg/Bool', 'here')"
    found = effects_of(Expression(text, "javascript", 10), script=True)
    assert [(topic.name, topic.line) for topic in found.topics] == [("here", 11)]
    assert kinds_read(script("this.environment.variables.next = 1;"), "quirk") == [("t", "never calls next()")]


# ---- the command -----------------------------------------------------------------------------------------------------


def test_the_command_says_it_before_its_findings(capsys: pytest.CaptureFixture[str]) -> None:
    path = MODELS / "dialects" / "fame_g0.bpmn"
    assert main(["check", "--explain", str(path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith(f"{path}: form: has lists")
    assert f"{path}:20: call: Measure_It: calls process Measure of this file" in lines
    assert lines[-1] == "2 notes"


def test_as_json_the_readings_stand_beside_the_findings(capsys: pytest.CaptureFixture[str]) -> None:
    path = str(MODELS / "dialects" / "fame_g2.bpmn")
    assert main(["check", "--explain", "--json", path]) == 0
    told = json.loads(capsys.readouterr().out)
    assert {"kind": "quirk", "text": "the parameter 'x:' is 'x'", "file": path, "line": 31, "element": "Tell"} in told[
        "readings"
    ]
    assert main(["check", "--json", path]) == 0
    assert "readings" not in json.loads(capsys.readouterr().out)


def test_a_file_that_cannot_be_read_is_a_finding_as_ever(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "broken.bpmn"
    path.write_text(document("<process id=>"))
    assert main(["check", "--explain", str(path)]) == 1
    assert ": error: " in capsys.readouterr().out
