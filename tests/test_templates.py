"""Element templates for Camunda Modeler: valid, up to date, and read as what they say in a model made with them."""

import json
import subprocess
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import pytest
from bpmn_text import body_of, extensions, node_of, process

from fame.bpmn.model import CallActivity, Event, SignalDefinition
from fame.check.element_templates import COMMON, fields_of, of_camunda8, payload_of, templates
from fame.check.library import behaviours
from fame.cli import main
from fame.errors import ModelError
from fame.middleware import messages, typesystem
from fame.properties import parse
from fame.scenario import Scenario
from fame.scripting import compile_expression

FOLDER = Path(__file__).parent.parent / "models" / "templates"
MADE = templates(behaviours())
ALL = {template["id"]: template for found in MADE.values() for template in found}
VALIDATE = """
const validator = require('@bpmn-io/element-templates-validator');
const found = JSON.parse(require('node:fs').readFileSync(0, 'utf-8'));
const { valid, results } = validator[`validateAll${process.argv[1] ?? ''}`](found);
console.log(JSON.stringify({ valid, count: results.length, errors: results.flatMap(one => one.errors || []) }));
"""


def applied(template: dict[str, Any], **values: str) -> str:
    """The extension elements that the modeler writes for a template, with some of the fields filled in."""
    written = ""
    for entry in template["properties"]:
        binding = entry["binding"]
        if binding["type"] == "camunda:property":
            value = values.get(binding["name"], entry["value"])
            written += f"<camunda:property name={quoteattr(binding['name'])} value={quoteattr(value)}/>"
    return extensions(f"<camunda:properties>{written}</camunda:properties>")


def thrown(template: dict[str, Any], **values: str) -> Any:
    """The topic of an event that was made with it."""
    tag = "intermediateThrowEvent" if template["id"].startswith("fame.publish") else "intermediateCatchEvent"
    event = f'<{tag} id="e" name="done">{applied(template, **values)}<signalEventDefinition/></{tag}>'
    node = node_of(event)
    assert isinstance(node, Event)
    (definition,) = node.definitions
    assert isinstance(definition, SignalDefinition)
    return definition.topic


def test_the_files_in_the_tree_are_what_the_command_writes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["templates", "-o", str(tmp_path), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)["files"]
    assert sorted(told) == sorted(path.stem for path in FOLDER.glob("*.json")) == sorted(MADE)
    for name, path in told.items():
        same = Path(path).read_text() == (FOLDER / f"{name}.json").read_text()
        assert same, "run: fame templates -o models/templates"


def test_own_types_and_topics_of_robots_have_templates_of_their_own() -> None:
    robots = [("odom", "nav_msgs/msg/Odometry", True), ("cmd_vel", "geometry_msgs/msg/Twist", False)]
    made = templates([], ["sensor_msgs/msg/Range"], robots)
    own = {template["id"]: template for found in made.values() for template in found}
    assert "radiation_type" in own["fame.publish.sensor_msgs.Range"]["properties"][1]["value"]
    assert own["fame.receive"]["properties"][0]["choices"][0]["value"] == "sensor_msgs/msg/Range"
    odometry = thrown(own["fame.robot.receive.odom.Odometry"], queue="2")
    assert (odometry.type, odometry.qualified, odometry.queue) == ("nav_msgs/msg/Odometry", "~/done", 2)
    speed = node_of(f'<intermediateThrowEvent id="e" name="cmd_vel">{applied(own["fame.robot.publish.cmd_vel.Twist"])}'
                    "<signalEventDefinition/></intermediateThrowEvent>")  # fmt: skip
    assert isinstance(speed, Event)
    ((topic, throws),) = speed.topics()
    assert throws
    assert topic.payload is not None
    assert "linear" in topic.payload.text


@pytest.mark.parametrize(("what", "type"), [("service", "std_srvs/srv/Trigger"), ("action", "nav2_msgs/action/Wait")])
def test_a_service_task_calls_what_its_template_says(what: str, type: str) -> None:
    made = ALL[f"fame.{what}"]
    node = node_of(f'<serviceTask id="e">{applied(made, **{what: "ask", "type": type, "payload": ""})}</serviceTask>')
    assert node.service is not None
    assert (node.service.name, node.service.type) == ("ask", type)


def test_the_command_takes_message_types_of_a_folder(tmp_path: Path) -> None:
    (tmp_path / "herd_msgs" / "msg").mkdir(parents=True)
    (tmp_path / "herd_msgs" / "msg" / "Cow.msg").write_text("float64 weight\n")
    assert main(["templates", "-o", str(tmp_path / "made"), "--types", str(tmp_path / "herd_msgs")]) == 0
    assert "fame.publish.herd_msgs.Cow" in (tmp_path / "made" / "publish.json").read_text()


def test_every_template_has_what_the_schema_asks_for() -> None:
    assert len(ALL) == sum(len(found) for found in MADE.values())
    for template in ALL.values():
        assert template["name"]
        assert template["appliesTo"]
        for entry in template["properties"]:
            assert entry["type"] in ("String", "Text", "Hidden", "Dropdown")
            assert entry["binding"]["type"] in ("camunda:property", "property")
            if entry["type"] == "Dropdown":
                assert entry["value"] in [choice["value"] for choice in entry["choices"]]


@pytest.mark.parametrize("kind", ["StartEvent", "BoundaryEvent", "IntermediateThrowEvent", "EndEvent"])
def test_no_template_has_a_deadline_where_nothing_waits(kind: str, tmp_path: Path) -> None:
    tag, host = kind[0].lower() + kind[1:], ' attachedToRef="t"' if kind == "BoundaryEvent" else ""
    made = applied(ALL["fame.deadline"], deadline="PT5S")
    event = f'<{tag} id="e" name="go"{host}>{made}<signalEventDefinition signalRef="g"/></{tag}>'
    (tmp_path / "m.bpmn").write_text(process(f'<task id="t"/>{event}', '<signal id="g" name="go"/>'))
    with pytest.raises(ModelError, match="a deadline says nothing here"):
        Scenario.load(tmp_path / "m.bpmn")
    assert not {f"bpmn:{kind}", "bpmn:Event"} & {*ALL["fame.deadline"]["appliesTo"]}
    assert f"bpmn:{kind}" in ALL["fame.requirement"]["appliesTo"]


@pytest.fixture
def validating(node_modules: Path) -> list[str]:
    """The command that validates what it is given."""
    return ["env", f"NODE_PATH={node_modules}", "node", "-e", VALIDATE]


@pytest.mark.parametrize("camunda_8", [False, True])
def test_the_validator_of_the_modeler_accepts_them(validating: list[str], camunda_8: bool) -> None:
    found = [made for one in ALL.values() for made in (of_camunda8(one) if camunda_8 else [one])]
    assert validated(validating, found, "Zeebe" * camunda_8) == {"valid": True, "count": len(found), "errors": []}


def test_the_validator_does_not_accept_everything(validating: list[str]) -> None:
    (first, *_) = ALL.values()
    assert not validated(validating, [first | {"appliesTo": "everything"}])["valid"]


def validated(validating: list[str], found: list[dict[str, Any]], of: str = "") -> Any:
    done = subprocess.run([*validating, of], input=json.dumps(found), capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


@pytest.mark.parametrize("type", COMMON)
def test_a_type_is_published_with_its_fields_at_their_defaults(type: str) -> None:
    topic = thrown(ALL[f"fame.publish.{type.replace('/msg/', '.')}"])
    assert (topic.qualified, topic.type) == ("/done", type)
    value = compile_expression(topic.payload)({}) if topic.payload else None
    assert messages.to_mapping(messages.create(type, value)) == messages.to_mapping(messages.create(type))


def test_every_field_is_in_the_payload_but_for_times(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(typesystem, "_definitions", dict(typesystem._table()))
    assert payload_of("geometry_msgs/msg/Vector3") == "{x: 0.0, y: 0.0, z: 0.0}"
    assert payload_of("geometry_msgs/msg/PointStamped") == "{header: {frame_id: ''}, point: {x: 0.0, y: 0.0, z: 0.0}}"
    assert (payload_of("std_msgs/msg/Bool"), payload_of("std_msgs/msg/Empty")) == ("false", "")
    messages.register("string number 1e3\nstring state free", "template_msgs/msg/Version")
    assert payload_of("template_msgs/msg/Version") == "{number: '1e3', state: free}"  # a text, as in the type


def test_a_type_is_chosen_from_those_there_are() -> None:
    for id in ("fame.publish", "fame.receive"):
        (types,) = [entry for entry in ALL[id]["properties"] if entry["binding"]["name"] == "type"]
        names = [choice["value"] for choice in types["choices"]]
        assert len(names) == len(set(names)) > 80
        assert set(names) <= set(messages.types())
        assert "nav_msgs/msg/Odometry" in names


def test_a_topic_is_received_as_the_fields_say() -> None:
    topic = thrown(ALL["fame.receive"], type="nav_msgs/msg/Odometry", queue="3", scope="robot")
    assert (topic.qualified, topic.type, topic.queue) == ("~/done", "nav_msgs/msg/Odometry", 3)
    assert dict(topic.qos) == {"reliability": "reliable", "durability": "volatile"}
    assert thrown(ALL["fame.receive"]).queue == 0


def test_a_message_is_sent_to_the_robot_that_the_field_names() -> None:
    filled = applied(ALL["fame.send"], type="geometry_msgs/msg/Point", payload="{x: ${x}}", to="${closest}")
    task = node_of(f'<sendTask id="t" messageRef="m">{filled}</sendTask>', '<message id="m" name="order"/>')
    assert task.topic is not None
    assert task.topic.to is not None
    assert (task.topic.qualified, task.topic.to.text) == ("/order", "${closest}")
    assert "bpmn:ReceiveTask" in ALL["fame.receive"]["appliesTo"]


def test_a_data_object_takes_the_fields_of_a_message() -> None:
    assert fields_of("geometry_msgs/msg/Vector3") == ("x", "y", "z")
    assert fields_of("geometry_msgs/msg/Twist") == ()  # linear.x and angular.x have one name
    assert fields_of("std_msgs/msg/String") == ()
    assert "fame.fields.geometry_msgs.Vector3" in ALL


def test_the_data_of_a_behaviour_are_its_inputs() -> None:
    template = ALL["fame.inputs.GoTo"]
    drawn = f'<dataObjectReference id="d" dataObjectRef="o">{applied(template, x_goal="4.5")}</dataObjectReference>'
    (item,) = body_of(f'{drawn}<dataObject id="o"/>').data_objects
    assert [(name, value.text) for name, value in item.values] == [("x_goal", "4.5"), ("y_goal", "")]


def test_a_deadline_and_a_property_are_drawn_with_a_template() -> None:
    node = node_of(f'<userTask id="u">{applied(ALL["fame.deadline"], deadline="PT5S", requirement="R1")}</userTask>')
    assert dict(node.properties) == {"deadline": "PT5S", "requirement": "R1"}
    (entry,) = ALL["fame.property"]["properties"]
    assert entry["binding"] == {"type": "property", "name": "text"}
    name, _, sentence = entry["value"].partition(": ")
    assert name == "property NAME"
    assert parse(sentence).sentence == sentence


@pytest.mark.parametrize("behaviour", behaviours(), ids=lambda one: one.name)
def test_a_behaviour_is_called_by_the_name_that_it_has(behaviour: Any) -> None:
    template = ALL[f"fame.call.{behaviour.name}"]
    said = {entry["binding"]["name"]: entry["value"] for entry in template["properties"]}
    assert template["elementType"] == {"value": "bpmn:CallActivity"}
    node = node_of(f'<callActivity id="c" name="{said["name"]}" calledElement="{said["calledElement"]}"/>')
    assert isinstance(node, CallActivity)
    assert (node.called, node.label) == (behaviour.name, behaviour.label)
