"""``fame convert``: a file of any dialect in the current form, which means and does the same."""

import json
import os
import re
import shutil
import subprocess
from html import escape
from pathlib import Path

import pytest
from bpmn_text import extensions, process, properties
from test_dialects import ROOTS, SIGNAL, oldest
from test_dialects_run import DIALECTS, FAR, MODELS, NEAR, run
from test_other_tools import FILES

import fame
from fame.bpmn import read_bytes, read_text
from fame.bpmn.conversion import convert
from fame.bpmn.model import Definitions
from fame.bpmn.reader.dialects import dialects_of
from fame.bpmn.reader.xml import BPMN, DC, parse
from fame.bpmn.split import extract_process, split
from fame.cli import main
from fame.errors import ModelError
from fame.robot import Event
from fame.scenario import Scenario

ALL = sorted({*DIALECTS, *(MODELS / "javascript").glob("*.bpmn")})
OTHERS = sorted({*(MODELS / "formats").rglob("*.bpmn"), *(MODELS / "unusual").rglob("*.bpmn")})
FOREIGN = ("ros:", "data:", "qos:", "callActivity:", "zeebe:", "<camunda:list>", "flowable:", "activiti:")


def converted(content: str, root: str = "", attributes: str = "") -> str:
    """A converted file with one process; it can be read, and converting it again changes nothing."""
    source = convert(read_text(process(content, root, attributes), file="m.bpmn"))
    again = read_bytes(source, file="m.bpmn")
    assert convert(again) == source
    return source.decode()


def meaning(definitions: Definitions) -> list[object]:
    """All that a run depends on, without lines; how prefixes count has a test of its own."""
    told = map(repr, (*definitions.processes, *definitions.participants))
    return [re.sub(r"line=\d+|by_prefix=\w+", "", text) for text in told]


def same(content: str, root: str = "", attributes: str = "") -> str:
    """As `converted`, where the model stays the same but for its lines."""
    text = converted(content, root, attributes)
    assert meaning(read_text(text)) == meaning(read_text(process(content, root, attributes)))
    return text


# ---- runs ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", DIALECTS, ids=lambda path: path.stem)
def test_a_converted_model_runs_to_the_same_log(path: Path, tmp_path: Path) -> None:
    new = tmp_path / path.name
    new.write_bytes(convert(fame.read(path)))
    for weed in (FAR, NEAR):
        assert run(new, weed).log == run(path, weed).log


def test_a_converted_mission_runs_to_the_same_log(tmp_path: Path) -> None:
    for path in (MODELS / "javascript").iterdir():
        shutil.copy(path, tmp_path)
        if path.suffix == ".bpmn":
            (tmp_path / path.name).write_bytes(convert(fame.read(path)))
    logs: list[list[Event]] = []
    for folder in (MODELS / "javascript", tmp_path):
        logs.append([])
        Scenario.load(folder / "agriculture.yaml", duration=12).run(observer=logs[-1].append)
    assert len(logs[0]) > 100
    assert [(event.time, event.robot, event.element, event.what) for event in logs[1]] == [
        (event.time, event.robot, event.element, event.what) for event in logs[0]
    ]


@pytest.mark.parametrize("path", ALL, ids=lambda path: path.stem)
def test_converting_twice_is_converting_once_and_nothing_foreign_is_left(path: Path) -> None:
    once = convert(fame.read(path))
    assert convert(read_bytes(once, file=str(path))) == once
    assert set(dialects_of(parse(once, str(path)))) <= {"Camunda 7 (FaMe G1, FAME)"}
    assert not any(f"<{word.lstrip('<')}".encode() in once for word in FOREIGN)


def test_a_file_in_the_current_form_stays_as_it_is() -> None:
    for path in (MODELS.parent.parent / "models").rglob("*.bpmn"):
        definitions = fame.read(path)
        assert convert(definitions) == definitions.source


@pytest.mark.parametrize("path", [*FILES, *OTHERS], ids=lambda path: path.name)
def test_strangers_files_are_converted_to_what_means_the_same(path: Path) -> None:
    try:
        definitions = fame.read(path)
    except ModelError:
        return
    again = read_bytes(convert(definitions), file=str(path))
    assert meaning(again) == meaning(definitions)


# ---- what becomes of each form ---------------------------------------------------------------------------------------


def test_the_oldest_form_gets_the_signal_that_it_named_by_a_parameter() -> None:
    text = same(
        f'<endEvent id="e" name="drive">{oldest("geometry_msgs/msg/Twist", "{linear: {x: 1}}")}{SIGNAL}</endEvent>',
        ROOTS,
    )
    assert '<signal id="Signal_cmd_vel" name="cmd_vel"/>' in text
    assert 'name="payload" value="{linear: {x: 1}}"' in text
    assert "inputOutput" not in text


def test_the_web_modelers_elements_become_properties() -> None:
    said = (
        '<ros:message type="geometry_msgs/msg/Vector3"/><qos:policy reliability="0"/><qos:policy leaseDuration="5"/>'
        '<ros:payload><ros:parameter name="x:" value="${x}"/><ros:parameter name="y:" value=""/></ros:payload>'
    )
    text = same(f'<endEvent id="e">{extensions(said)}{SIGNAL}</endEvent>', ROOTS)
    for name, value in (("payload", "{x: ${x}}"), ("qos.reliability", "best_effort"), ("qos.lease_duration", "5")):
        assert f'<camunda:property name="{name}" value="{value}"/>' in text


def test_the_web_modelers_data_and_services_become_properties() -> None:
    held = extensions('<data:parameters><data:parameter name="x:" value="${x}"/></data:parameters>')
    service = extensions(
        '<ros:service name="tello_action" type="tello_msgs/srv/TelloAction"/><ros:payload data="{cmd: up}"/>'
    )
    text = same(
        f'<dataObjectReference id="d" dataObjectRef="o">{held}</dataObjectReference><dataObject id="o"/>'
        f'<serviceTask id="t">{service}</serviceTask>'
    )
    assert '<camunda:property name="service" value="tello_action"/>' in text


def test_an_embedded_process_becomes_one_of_the_file() -> None:
    def call(id: str, text: str) -> str:
        inner = f'<bpmn2:process id="Go"><bpmn2:startEvent id="in"/><bpmn2:task id="{text}"/></bpmn2:process>'
        embedded = extensions(f'<callActivity:process process="{escape(inner)}"/>')
        return f'<callActivity id="{id}">{embedded}</callActivity>'

    text = converted(call("c", "a") + call("d", "b"))
    processes = read_text(text).processes
    assert [(one.id, [node.id for node in one.body.nodes]) for one in processes] == [
        ("P", ["c", "d"]), ("Go", ["in", "a"]), ("Go_2", ["in_2", "b"]),
    ]  # fmt: skip
    assert 'calledElement="Go_2"' in text


TYPE = "{http://www.w3.org/2001/XMLSchema-instance}type"
DRAWN = (
    '<bpmn2:process id="Go"><bpmn2:startEvent id="in"/></bpmn2:process><bpmndi:BPMNDiagram id="D"><bpmndi:BPMNPlane '
    'id="L" bpmnElement="Go"><bpmndi:BPMNShape id="in_di" bpmnElement="in"><dc:Bounds x="1" y="2" width="36" '
    'height="36"/></bpmndi:BPMNShape></bpmndi:BPMNPlane></bpmndi:BPMNDiagram>'
)


def test_the_drawing_of_an_embedded_process_comes_along() -> None:
    embedded = extensions(f'<callActivity:process process="{escape(DRAWN, quote=True)}"/>')
    content = f'<startEvent id="in"/><callActivity id="c">{embedded}</callActivity>'
    for definitions in (read_text(process(content)), read_text(same(content))):
        assert [(shape.element, shape.bounds.x) for shape in definitions.shapes] == [("in_2", 1.0)]
        assert definitions.planes == ("Go",)


def test_the_types_in_an_embedded_process_keep_their_namespace() -> None:
    typed = '<bpmn2:conditionExpression xsi:type="bpmn2:tFormalExpression">x</bpmn2:conditionExpression>'
    flow = f'<bpmn2:task id="t"/><bpmn2:sequenceFlow id="f" sourceRef="in" targetRef="t">{typed}</bpmn2:sequenceFlow>'
    point = '<bpmndi:BPMNEdge id="e" bpmnElement="f"><di:waypoint xsi:type="dc:Point" x="1" y="2"/></bpmndi:BPMNEdge>'
    inner = DRAWN.replace("</bpmn2:process>", f"{flow}</bpmn2:process>").replace(
        "<bpmndi:BPMNShape", f"{point}<bpmndi:BPMNShape"
    )
    embedded = extensions(f'<callActivity:process process="{escape(inner, quote=True)}"/>')
    source = process(f'<startEvent id="s"/><callActivity id="c">{embedded}</callActivity>')
    for text in (convert(read_text(source)), extract_process(read_text(source), "P")):
        root = parse(text, "")
        types = [(one.nsmap.get(prefix or None), name) for one in root.iter() for value in [one.get(TYPE)] if value
                 for prefix, _, name in [value.rpartition(":")]]  # fmt: skip
        assert types == [(BPMN, "tFormalExpression"), (DC, "Point")]


def test_a_part_of_a_split_file_keeps_the_rule_of_prefixes() -> None:
    pools = "".join(f'<participant id="{id}_pool" name="{id}" processRef="{id}"/>' for id in "PQ")
    script = '<scriptTask id="t" scriptFormat="javascript"><script>next();</script></scriptTask>'
    text = process(
        script, f'<collaboration id="C">{pools}</collaboration><process id="Q"><startEvent id="s"/></process>'
    )
    parts = {part.name: read_bytes(part.source).processes[0] for part in split(read_text(text))}
    assert (parts["P"].by_prefix, parts["Q"].by_prefix) == (True, True)


def test_a_topic_named_by_its_label_gets_a_signal() -> None:
    text = same('<endEvent id="e" name="all done"><signalEventDefinition/></endEvent>')
    assert '<signal id="Signal_all_done" name="all done"/>' in text
    labels = properties(topics="labels")
    said = f'<endEvent id="e" name="seen">{SIGNAL}</endEvent><receiveTask id="t" name="call" messageRef="M"/>'
    text = same(labels + said, ROOTS)
    assert "labels" not in text
    assert '<signal id="Signal_seen" name="seen"/>' in text
    assert '<message id="Message_call" name="call"/>' in text


def test_mappings_calls_loops_and_scripts_of_camunda_8_find_their_form() -> None:
    mapped = '<zeebe:input source="=a.b" target="x"/><zeebe:output source="=y" target="z"/>'
    mapping = f"<zeebe:ioMapping>{mapped}</zeebe:ioMapping>"
    called = f'<zeebe:calledElement processId="Q" propagateAllChildVariables="false"/>{mapping}'
    loop = (
        '<zeebe:loopCharacteristics inputCollection="=ps" inputElement="p" outputCollection="out" outputElement="=s"/>'
    )
    header = '<zeebe:taskHeaders><zeebe:header key="unit" value="m"/></zeebe:taskHeaders>'
    task = f'<zeebe:taskDefinition type="mow" retries="3"/>{header}'
    text = same(
        f'<callActivity id="c">{extensions(called)}</callActivity>'
        f'<scriptTask id="s">{extensions("""<zeebe:script expression="=a + b" resultVariable="sum"/>""")}'
        f"<multiInstanceLoopCharacteristics>{extensions(loop)}</multiInstanceLoopCharacteristics></scriptTask>"
        f'<serviceTask id="t">{extensions(task + mapping)}</serviceTask>'
    )
    assert '<camunda:in variables="all"/>' in text
    assert "<script>=a + b</script>" in text
    assert 'camunda:topic="mow"' in text


def test_a_call_of_camunda_8_that_shares_nothing_is_kept_since_no_other_form_says_so() -> None:
    called = (
        '<zeebe:calledElement processId="Q" propagateAllChildVariables="false" propagateAllParentVariables="false"/>'
    )
    assert "zeebe:calledElement" in same(f'<callActivity id="c">{extensions(called)}</callActivity>')


def test_mappings_of_camunda_8_that_see_earlier_ones_are_kept_since_no_other_form_says_so() -> None:
    mapped = '<zeebe:input source="=1" target="x"/><zeebe:input source="=x + 1" target="y"/>'
    text = same(f'<scriptTask id="s">{extensions(f"<zeebe:ioMapping>{mapped}</zeebe:ioMapping>")}</scriptTask>')
    assert "zeebe:ioMapping" in text


def test_the_key_of_a_message_becomes_a_correlation_property() -> None:
    key = extensions('<zeebe:subscription correlationKey="=order_id"/>')
    catch = '<intermediateCatchEvent id="e"><messageEventDefinition messageRef="M"/></intermediateCatchEvent>'
    text = same(catch, f'<message id="M" name="order">{key}</message>')
    assert "correlationProperty" in text


def test_what_is_refused_or_unknown_is_kept() -> None:
    said = '<zeebe:taskDefinition type="io.camunda:http-json:1"/><zeebe:assignmentDefinition assignee="ann"/>'
    text = same(f'<serviceTask id="t">{extensions(said)}</serviceTask>')
    assert "io.camunda:http-json:1" in text
    assert "assignmentDefinition" in text


def test_the_rule_of_prefixes_is_written_down_where_the_looks_do_not_tell_it_any_more() -> None:
    held = properties(x_goal="")
    said = (
        f'<startEvent id="e">{extensions("""<ros:message type="geometry_msgs/msg/Vector3"/>""")}{SIGNAL}</startEvent>'
    )
    text = converted(
        f'{said}<dataObjectReference id="d" dataObjectRef="o">{held}</dataObjectReference><dataObject id="o"/>', ROOTS
    )
    assert '<camunda:property name="fields" value="prefix"/>' in text
    assert read_text(text).processes[0].by_prefix


def test_the_platform_is_kept_but_for_one_that_has_no_such_form() -> None:
    modeler = 'xmlns:modeler="http://camunda.org/schema/modeler/1.0" modeler:executionPlatform="{}"'
    seven = process(f'<endEvent id="e">{oldest("std_msgs/msg/Bool")}{SIGNAL}</endEvent>', ROOTS)
    seven = seven.replace("<definitions ", f"<definitions {modeler.format('Camunda Platform')} ")
    assert b'executionPlatform="Camunda Platform"' in convert(read_text(seven))
    eight = (MODELS / "dialects" / "camunda8.bpmn").read_text()
    assert b'executionPlatform="Camunda Platform"' in convert(read_text(eight))


# ---- semantics -------------------------------------------------------------------------------------------------------

HANDLER = '<subProcess id="h" triggeredByEvent="true"><startEvent id="i">' + SIGNAL + "</startEvent></subProcess>"


def test_it_sets_the_semantics_of_processes_that_have_event_sub_processes() -> None:
    definitions = read_text(process(HANDLER, f'{ROOTS}<process id="Q"/>'))
    source = convert(definitions, semantics="original")
    assert [one.semantics for one in read_bytes(source).processes] == ["original", "standard"]
    back = convert(read_bytes(source), semantics="standard")
    assert [one.semantics for one in read_bytes(back).processes] == ["standard", "standard"]
    assert convert(definitions) == definitions.source


# ---- the command, and who else reads it ------------------------------------------------------------------------------


def test_the_command_writes_the_file_and_names_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    old, new = MODELS / "dialects" / "fame_g2.bpmn", tmp_path / "new" / "g2.bpmn"
    assert main(["convert", str(old), "-o", str(new)]) == 0
    assert capsys.readouterr().out == f"{new}\n"
    assert new.read_bytes() == convert(fame.read(old))
    assert main(["convert", str(new), "-o", str(new), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"status": "completed", "file": str(new), "changed": False}


def test_a_file_that_cannot_be_read_is_not_converted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    old, new = tmp_path / "old.bpmn", tmp_path / "new.bpmn"
    old.write_text("<definitions/>")
    assert main(["convert", str(old), "-o", str(new)]) == 2
    assert "the root is <definitions>" in capsys.readouterr().err
    assert not new.exists()


READ = """
const { BpmnModdle } = require("bpmn-moddle"), fs = require("fs");
const camunda = require("camunda-bpmn-moddle/resources/camunda.json");
Promise.all(process.argv.slice(1).map(async (file) => {
    const { warnings } = await new BpmnModdle({ camunda }).fromXML(fs.readFileSync(file, "utf8"));
    if (warnings.length) throw new Error(`${file}: ${warnings.map((one) => one.message).join()}`);
})).catch((error) => { console.error(error.message); process.exit(1); });
"""


def test_converted_files_are_readable_by_bpmn_js(node_modules: Path, tmp_path: Path) -> None:
    for path in (*ALL, *OTHERS):
        if path.stem != "language_unknown":
            (tmp_path / f"{path.parent.name}_{path.name}").write_bytes(convert(fame.read(path)))
    files = [str(path) for path in sorted(tmp_path.iterdir())]
    path = {**os.environ, "NODE_PATH": str(node_modules)}
    done = subprocess.run(["node", "-e", READ, *files], env=path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


# ---- files that other tools or hands have touched --------------------------------------------------------------------

ODD = {
    "comments in parameters": extensions(
        '<ros:message type="std_msgs/msg/String"/>'
        '<ros:payload><!-- x --><ros:parameter name="data:" value="a"/></ros:payload>'
    ),
    "comments in properties": extensions(
        '<zeebe:properties><!-- x --><zeebe:property name="type" value="std_msgs/msg/String"/></zeebe:properties>'
    ),
    "two holders": extensions('<ros:message type="std_msgs/msg/String"/>')
    + extensions('<ros:payload><ros:parameter name="data:" value="a"/></ros:payload>'),
}


@pytest.mark.parametrize("said", ODD.values(), ids=ODD.keys())
def test_comments_and_a_second_holder_of_extensions_do_no_harm(said: str) -> None:
    text = same(f'<endEvent id="e" name="weed">{said}{SIGNAL}</endEvent>', ROOTS)
    assert "std_msgs/msg/String" in text
    assert "<ros:" not in text
    assert "<zeebe:" not in text


def test_a_mapping_from_nothing_can_be_read_again() -> None:
    inside = extensions(
        '<zeebe:calledElement processId="Q"/><zeebe:ioMapping><zeebe:input target="x"/></zeebe:ioMapping>'
    )
    assert 'sourceExpression="=null"' in converted(f'<callActivity id="c">{inside}</callActivity>', '<process id="Q"/>')


def test_a_script_of_camunda_8_where_no_script_can_be_stays_away() -> None:
    text = converted(extensions('<zeebe:script expression="=1" resultVariable="x"/>') + '<startEvent id="s"/>')
    assert "<script>" not in text
