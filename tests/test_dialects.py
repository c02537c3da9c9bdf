"""Dialects: what the extension elements of FaMe's three generations and of Camunda 7 and 8 mean."""

from html import escape
from pathlib import Path
from typing import Any

import pytest
from bpmn_text import body_of, document, extensions, node_of, notes_of, process, properties, refused

from fame.bpmn import read, read_text
from fame.bpmn.model import (
    Assignment,
    Body,
    CallActivity,
    DataObject,
    Definitions,
    ErrorDefinition,
    Event,
    Expression,
    FormField,
    IoMapping,
    MessageDefinition,
    MultiInstance,
    SignalDefinition,
    Task,
    Topic,
)
from fame.bpmn.model.forms import unfit_value
from fame.bpmn.reader.expressions import flow_mapping, flow_sequence
from fame.bpmn.split import split
from fame.scripting import compile_expression
from fame.view.forms import task_fields, topic_fields

HOSPITAL = Path(__file__).parent / "hospital" / "hospital.bpmn"
ROOTS = '<signal id="S" name="weed_found"/><message id="M" name="order"/><error id="E" errorCode="lost"/>'
SIGNAL = '<signalEventDefinition signalRef="S"/>'


def topic_of(inside: str, tag: str = "endEvent", name: str = "", definition: str = SIGNAL) -> Topic:
    """The topic of an event with these extensions."""
    label = f'name="{name}"' if name else ""
    node = node_of(f'<{tag} id="e" {label}>{inside}{definition}</{tag}>', ROOTS)
    assert isinstance(node, Event)
    (found,) = node.definitions
    assert isinstance(found, SignalDefinition | MessageDefinition)
    return found.topic


def task_of(inside: str, tag: str = "serviceTask", attributes: str = "") -> Task:
    """A task with these extensions."""
    node = node_of(f'<{tag} id="t" name="Do" {attributes}>{inside}</{tag}>', ROOTS)
    assert isinstance(node, Task)
    return node


def call_of(inside: str, attributes: str = "") -> CallActivity:
    """A call activity with these extensions."""
    node = node_of(f'<callActivity id="c" {attributes}>{inside}</callActivity>')
    assert isinstance(node, CallActivity)
    return node


def payload(text: str) -> Expression:
    """A payload in line 3."""
    return Expression(text, "payload", 3)


# ---- the form of the paper (G1), and FAME's own names ----------------------------------------------------------------


def test_type_and_payload_are_properties_of_a_signal_event() -> None:
    said = properties(type="geometry_msgs/msg/Vector3", payload="{x: ${x_weed}, y: 1}")
    topic = topic_of(said)
    assert (topic.qualified, topic.type) == ("/weed_found", "geometry_msgs/msg/Vector3")
    assert topic.payload == payload("{x: ${x_weed}, y: 1}")


def test_a_payload_without_value_sends_defaults() -> None:
    assert topic_of(properties(type="std_msgs/msg/Bool", payload="")).payload is None


def test_a_catch_has_no_payload() -> None:
    said = properties(type="std_msgs/msg/Bool", payload="true")
    assert topic_of(said, "intermediateCatchEvent").payload is None


def test_a_type_may_lack_its_middle_part() -> None:
    assert topic_of(properties(type=" std_msgs/Bool ")).type == "std_msgs/msg/Bool"


def test_queue_scope_and_qos_are_properties_too() -> None:
    said = properties(queue="3", scope="robot", qos_reliability="best_effort", qos_depth="5", qos_deadline="0.5")
    topic = topic_of(said, "intermediateCatchEvent")
    assert (topic.queue, topic.private, topic.qualified) == (3, True, "~/weed_found")
    assert dict(topic.qos) == {"reliability": "best_effort", "depth": "5", "deadline": "0.5"}


def test_properties_without_a_meaning_are_kept() -> None:
    node = node_of(f'<endEvent id="e">{properties(type="std_msgs/msg/Bool", colour="red")}{SIGNAL}</endEvent>', ROOTS)
    assert dict(node.properties) == {"colour": "red"}


def test_type_on_what_is_no_topic_is_a_property_like_any_other() -> None:
    assert dict(node_of(f'<task id="t">{properties(type="x")}</task>').properties) == {"type": "x"}


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("type", "Vector3", "type='Vector3': expected pkg/msg/Type"),
        ("queue", "abc", "queue='abc': expected a whole number, 0 or more"),
        ("queue", "-1", "queue='-1': expected a whole number, 0 or more"),
        ("scope", "galaxy", "scope='galaxy': expected robot"),
        ("qos_reliability", "maybe", "qos.reliability='maybe': expected best_effort or reliable"),
        ("qos_depth", "0", "qos.depth='0': expected a whole number, 1 or more"),
        ("qos_deadline", "soon", "qos.deadline='soon': expected a time in seconds"),
        ("qos_speed", "1", "unknown QoS policy 'speed': expected one of history, reliability"),
    ],
)
def test_a_bad_value_is_an_error_that_says_what_is_right(name: str, value: str, said: str) -> None:
    error = refused(process(f'<endEvent id="e">{properties(**{name: value})}{SIGNAL}</endEvent>', ROOTS))
    assert error.text.startswith(said)
    assert (error.element, error.line) == ("e", 3)


def test_resume_must_be_true_or_false() -> None:
    error = refused(process(f'<subProcess id="s" triggeredByEvent="true">{properties(resume="perhaps")}</subProcess>'))
    assert error.text == "property resume='perhaps': expected true or false"


@pytest.mark.parametrize(
    ("policy", "code", "meaning"),
    [
        ("history", "0", "keep_last"),
        ("history", "1", "keep_all"),
        ("reliability", "0", "best_effort"),
        ("reliability", "1", "reliable"),
        ("durability", "0", "transient_local"),
        ("durability", "1", "volatile"),
        ("liveliness", "0", "automatic"),
        ("liveliness", "1", "manual_by_topic"),
    ],
)
def test_the_codes_of_the_original_are_policies(policy: str, code: str, meaning: str) -> None:
    assert topic_of(properties(**{f"qos_{policy}": code})).qos[policy] == meaning
    assert topic_of(extensions(f'<qos:policy {policy}="{code}"/>')).qos[policy] == meaning


def test_the_topic_is_the_signals_name_where_the_label_differs_and_a_note_says_so() -> None:
    said = properties(type="std_msgs/msg/Bool")
    text = process(f'<endEvent id="e" name="weed found!">{said}{SIGNAL}</endEvent>', ROOTS)
    definitions = read_text(text)
    assert notes_of(definitions) == ["the topic is 'weed_found', the name of the signal, not the label 'weed found!'"]
    assert definitions.notes[0].level == "note"
    original = read_text(text.replace(said, extensions('<ros:message type="std_msgs/msg/Bool"/>')))
    assert original.notes[0].level == "warning"


def test_each_definition_of_an_event_may_say_its_own_type() -> None:
    own = f'<signalEventDefinition signalRef="S">{properties(type="std_msgs/msg/Bool")}</signalEventDefinition>'
    both = own + '<messageEventDefinition messageRef="M"/>'
    node = node_of(f'<startEvent id="e">{properties(type="std_msgs/msg/String")}{both}</startEvent>', ROOTS)
    assert isinstance(node, Event)
    types = [one.topic.type for one in node.definitions if isinstance(one, SignalDefinition | MessageDefinition)]
    assert types == ["std_msgs/msg/Bool", "std_msgs/msg/String"]


# ---- the oldest form (G0) --------------------------------------------------------------------------------------------


def oldest(*values: str) -> str:
    """A list of type and payload under the name of a topic."""
    written = "".join(f"<camunda:value>{value}</camunda:value>" for value in values)
    items = f'<camunda:inputParameter name="cmd_vel"><camunda:list>{written}</camunda:list></camunda:inputParameter>'
    return extensions(f"<camunda:inputOutput>{items}</camunda:inputOutput>")


def test_the_oldest_form_names_the_topic_by_its_parameter() -> None:
    topic = topic_of(oldest("geometry_msgs/msg/Twist", '{"linear": {"x": ${v}}}'), name="drive")
    assert (topic.name, topic.type) == ("cmd_vel", "geometry_msgs/msg/Twist")
    assert topic.payload == payload('{"linear": {"x": ${v}}}')
    caught = topic_of(oldest("geometry_msgs/msg/Twist"), "intermediateCatchEvent")
    assert (caught.name, caught.type, caught.payload) == ("cmd_vel", "geometry_msgs/msg/Twist", None)


def test_a_list_of_other_things_is_a_variable() -> None:
    task = task_of(oldest("1", "${b}", "left, right"))
    assert task.io == IoMapping((Assignment("cmd_vel", payload('[1, ${b}, "left, right"]')),))


# ---- the web modeler (G2) --------------------------------------------------------------------------------------------


def test_the_web_modelers_messages() -> None:
    said = (
        '<ros:message type="geometry_msgs/msg/Vector3"/><ros:payload><ros:parameter name="x:" value="${x_target}"/>'
        '<ros:parameter name="y:" value="1.0"/><ros:parameter name="z" value=""/></ros:payload>'
    )
    topic = topic_of(extensions(said))
    assert (topic.type, topic.payload) == ("geometry_msgs/msg/Vector3", payload("{x: ${x_target}, y: 1.0}"))


def test_the_web_modelers_policies_are_merged_and_stray_attributes_mean_nothing() -> None:
    said = '<qos:policy reliability="1" type="x" value="y"/><qos:policy leaseDuration="5" is_output="true"/>'
    assert dict(topic_of(extensions(said)).qos) == {"reliability": "reliable", "lease_duration": "5"}


def test_policies_without_a_value_say_nothing() -> None:
    said = '<qos:policy reliability="" durability="1"/><qos:policy history=" "/>'
    assert dict(topic_of(extensions(said)).qos) == {"durability": "volatile"}
    assert dict(topic_of(properties(qos_depth="", qos_history="1")).qos) == {"history": "keep_all"}


def test_the_web_modelers_data() -> None:
    said = '<data:parameters><data:parameter name="x_target:" value="${x_target}"/></data:parameters>'
    body = body_of(
        f'<dataObjectReference id="d" dataObjectRef="o">{extensions(said)}</dataObjectReference><dataObject id="o"/>'
    )
    assert body.data_objects[0].values == (("x_target", Expression("${x_target}", "value", 3)),)


def test_the_web_modelers_services() -> None:
    task = task_of(
        extensions(
            '<ros:service name="tello_action" type="tello_msgs/srv/TelloAction"/><ros:payload data="{cmd: up}"/>'
        )
    )
    assert task.operation == "tello_action"
    assert task.topic is not None
    assert (task.topic.type, task.topic.payload) == ("tello_msgs/srv/TelloAction", payload("{cmd: up}"))


INNER = '<bpmn2:process id="GoTo"><bpmn2:task id="{}"/></bpmn2:process><bpmndi:BPMNDiagram id="D"/>'


def embedding(id: str, task: str) -> str:
    """A call activity that has its process inside."""
    text = escape(INNER.format(task), quote=True)
    return f'<callActivity id="{id}">{extensions(f"""<callActivity:process process="{text}"/>""")}</callActivity>'


def test_an_embedded_process_is_one_of_the_files_and_called_by_its_id() -> None:
    definitions = read_text(process(embedding("c", "inner")))
    assert [one.id for one in definitions.processes] == ["P", "GoTo"]
    assert definitions.processes[1].body.nodes[0].id == "inner"
    call = definitions.processes[0].body.nodes[0]
    assert isinstance(call, CallActivity)
    assert call.called == "GoTo"


def test_two_embedded_processes_of_one_id_are_one_if_they_are_equal_else_two() -> None:
    same = read_text(process(embedding("c", "inner") + embedding("d", "inner")))
    assert [one.id for one in same.processes] == ["P", "GoTo"]
    definitions = read_text(process(embedding("c", "inner") + embedding("d", "other")))
    assert [one.id for one in definitions.processes] == ["P", "GoTo", "GoTo_2"]
    calls = [node.called for node in definitions.processes[0].body.nodes if isinstance(node, CallActivity)]
    assert calls == ["GoTo", "GoTo_2"]


def test_a_broken_embedded_process_is_an_error_of_its_call_activity() -> None:
    inside = '<callActivity:process process="&lt;bpmn2:process id="/>'
    error = refused(process(f'<callActivity id="c">{extensions(inside)}</callActivity>'))
    assert error.element == "c"
    assert "its embedded process cannot be read: " in error.text


# ---- Camunda 7 -------------------------------------------------------------------------------------------------------


def test_parameters_are_mappings() -> None:
    said = (
        '<camunda:inputOutput><camunda:inputParameter name="speed">0.8</camunda:inputParameter>'
        '<camunda:inputParameter name="goal">goal_${n}</camunda:inputParameter>'
        '<camunda:inputParameter name="map"><camunda:map><camunda:entry key="x">${x}</camunda:entry></camunda:map>'
        '</camunda:inputParameter><camunda:inputParameter name="s"><camunda:script scriptFormat="javascript">1 + 1'
        '</camunda:script></camunda:inputParameter><camunda:outputParameter name="done">${ok}</camunda:outputParameter>'
        "</camunda:inputOutput>"
    )
    assert task_of(extensions(said)).io == IoMapping(
        (
            Assignment("speed", Expression("0.8", "value", 3)),
            Assignment("goal", Expression("goal_${n}", "template", 3)),
            Assignment("map", payload("{x: ${x}}")),
            Assignment("s", Expression("1 + 1", "javascript", 3)),
        ),
        (Assignment("done", Expression("${ok}", "juel", 3)),),
    )


def parameter(content: str) -> str:
    inside = f'<inputOutput><inputParameter name="p">{content}</inputParameter></inputOutput>'
    return extensions(inside.replace("<", "<camunda:").replace("<camunda:/", "</camunda:"))


@pytest.mark.parametrize(
    ("content", "text"),
    [
        ("<map><entry key='a'><list><value>1</value><value>2</value></list></entry></map>", "{a: [1, 2]}"),
        ("<list><list><value>${x}</value></list><value>3</value></list>", "[[${x}], 3]"),
        ("<list><map><entry key='a'><map/></entry></map></list>", "[{a: {}}]"),
    ],
)
def test_lists_and_maps_may_be_nested(content: str, text: str) -> None:
    io = task_of(parameter(content)).io
    assert io is not None
    assert io.inputs == (Assignment("p", payload(text)),)


@pytest.mark.parametrize(
    "content",
    [
        "<list><script>1+2</script></list>",
        "<map><entry key='a'><value>1</value><value>2</value></entry></map>",
        "<list><value>1</value></list><list><value>2</value></list>",
    ],
)
def test_what_a_parameter_cannot_hold_is_refused(content: str) -> None:
    error = refused(process(f'<scriptTask id="t">{parameter(content)}<script>pass</script></scriptTask>'))
    assert "expected text, or one" in error.text


def test_what_goes_into_and_out_of_a_call() -> None:
    call = call_of(
        extensions(
            '<camunda:in source="x_target" target="x_goal"/><camunda:in sourceExpression="${y + 1}" target="y_goal"/>'
            '<camunda:out variables="all"/>'
        ),
        'calledElement="GoTo"',
    )
    inputs = (
        Assignment("x_goal", Expression("x_target", "python", 3)),
        Assignment("y_goal", Expression("${y + 1}", "juel", 3)),
    )
    assert call.io == IoMapping(inputs, (), False, True)
    assert call_of("", 'calledElement="GoTo"').io is None


def test_outputs_of_a_catch_are_its_explicit_mapping() -> None:
    said = (
        '<camunda:inputOutput><camunda:outputParameter name="x">${msg.vector.x}</camunda:outputParameter>'
        "</camunda:inputOutput>"
    )
    takes = (Assignment("x", Expression("${msg.vector.x}", "juel", 3)),)
    assert topic_of(extensions(said), "startEvent").takes == takes
    task = task_of(extensions(said), "receiveTask", 'messageRef="M"')
    assert task.topic is not None
    assert (task.topic.takes, task.io) == (takes, None)


def test_what_a_thrown_signal_copies_is_its_payload() -> None:
    copies = extensions('<camunda:in source="x_weed" target="x"/><camunda:in sourceExpression="${2 * y}" target="y"/>')
    thrown = f'<signalEventDefinition signalRef="S">{copies}</signalEventDefinition>'
    assert topic_of("", definition=thrown).payload == payload("{x: ${x_weed}, y: ${2 * y}}")


def test_a_multi_instance_over_a_collection() -> None:
    for collection, language in (("tractors", "python"), ("${field.tractors}", "juel")):
        task = task_of(
            f'<multiInstanceLoopCharacteristics camunda:collection="{collection}" camunda:elementVariable="t"/>'
        )
        assert isinstance(task.loop, MultiInstance)
        assert task.loop.collection is not None
        assert (task.loop.collection.language, task.loop.element_variable) == (language, "t")


def test_results_topics_and_expressions_of_service_tasks() -> None:
    external = task_of("", attributes='camunda:type="external" camunda:topic="mow"')
    assert external.operation == "mow"
    computed = task_of("", attributes='camunda:expression="${x + 1}" camunda:resultVariable="y"')
    assert (computed.script, computed.result_variable) == (Expression("${x + 1}", "juel", 3), "y")


def test_a_ros_service_may_be_named_by_properties() -> None:
    task = task_of(properties(service="tello_action", type="tello_msgs/srv/TelloAction", payload="{cmd: land}"))
    assert task.topic == Topic("tello_action", "tello_msgs/srv/TelloAction", payload("{cmd: land}"))
    assert task.operation == "tello_action"


def test_send_tasks_have_payloads_and_receive_tasks_queues() -> None:
    sent = task_of(properties(type="std_msgs/msg/String", payload="hi"), "sendTask")
    assert sent.topic == Topic("Do", "std_msgs/msg/String", payload("hi"))
    received = task_of(properties(queue="2"), "receiveTask", 'messageRef="M"')
    assert received.topic == Topic("order", queue=2)


def test_variables_that_take_what_was_caught() -> None:
    caught = '<errorEventDefinition errorRef="E" camunda:errorCodeVariable="code" camunda:errorMessageVariable="why"/>'
    node = node_of(f'<boundaryEvent id="b" attachedToRef="t">{caught}</boundaryEvent><task id="t"/>', ROOTS)
    assert isinstance(node, Event)
    expected = ErrorDefinition(code="lost", code_variable="code", message_variable="why", line=3)
    assert node.definitions == (expected,)


@pytest.mark.parametrize(
    ("tag", "attributes", "inside", "said"),
    [
        ("serviceTask", 'camunda:class="com.acme.Mower"', "", "Java class com.acme.Mower"),
        ("sendTask", 'camunda:delegateExpression="${bean}"', "", "delegate expression ${bean}"),
        ("businessRuleTask", 'camunda:decisionRef="dish"', "", "DMN decision dish"),
        ("scriptTask", 'camunda:resource="classpath://a.py"', "", "resource classpath://a.py"),
        ("serviceTask", "", "<camunda:connector/>", "connector"),
        (
            "serviceTask",
            "",
            '<zeebe:taskDefinition type="io.camunda:http-json:1"/>',
            "connector io.camunda:http-json:1",
        ),
        ("businessRuleTask", "", '<zeebe:calledDecision decisionId="dish"/>', "DMN decision dish"),
    ],
)
def test_what_cannot_run_is_refused_by_name_but_read(tag: str, attributes: str, inside: str, said: str) -> None:
    assert said in task_of(extensions(inside), tag, attributes).refused


def test_what_has_no_effect_is_noted() -> None:
    text = process(
        '<userTask id="t" camunda:assignee="ann" camunda:formKey="f" camunda:asyncBefore="true" '
        'camunda:modelerTemplate="x">'
        + extensions('<camunda:formData/><camunda:executionListener class="a.B" event="start"/>')
        + "</userTask>"
    )
    definitions = read_text(text)
    assert notes_of(definitions) == [
        "camunda:asyncBefore has no effect",
        "camunda:executionListener is not run: FAME has no listeners",
    ]
    assert {note.element for note in definitions.notes} == {"t"}


@pytest.mark.parametrize(
    ("attributes", "inside", "said"),
    [
        ('camunda:candidateUzers="ann"', "", "camunda:candidateUzers is not read; did you mean candidateUsers?"),
        (
            'camunda:calledElementBinding="version"',
            "",
            "camunda:calledElementBinding='version' has no effect: the process that is there is called, in any version",
        ),
        (
            "",
            '<camunda:in variables="all" local="true"/>',
            "local of camunda:in has no effect: variables of enclosing scopes count, too",
        ),
    ],
)
def test_what_would_mean_something_else_is_a_warning(attributes: str, inside: str, said: str) -> None:
    text = process(f'<callActivity id="c" calledElement="P" {attributes}>{extensions(inside)}</callActivity>')
    assert [(note.level, note.text) for note in read_text(text).notes] == [("warning", said)]


def test_names_that_are_right_get_no_warning() -> None:
    attributes = 'camunda:type="external" camunda:topic="go" camunda:historyTimeToLive="1" camunda:exclusive="true"'
    assert notes_of(read_text(process(f'<serviceTask id="t" {attributes}/>'))) == []


@pytest.mark.parametrize(
    ("people", "users", "expressions"),
    [
        ("alice,${boss}", ("alice",), ["${boss}"]),
        ("${f(a, b)}, bob, #{c}", ("bob",), ["${f(a, b)}", "#{c}"]),
        ("mr-${name}", (), ["mr-${name}"]),
        ("=a, b", (), ["=a, b"]),
    ],
)
def test_an_expression_among_people_is_left_out_with_a_warning(
    people: str, users: tuple[str, ...], expressions: list[str]
) -> None:
    definitions = read_text(process(f'<userTask id="t" camunda:candidateUsers="{people}"/>'))
    (task,) = definitions.processes[0].body.nodes
    assert isinstance(task, Task)
    assert task.human is not None
    assert task.human.users == users
    text = "candidateUsers={!r} has no effect: expected names, not an expression"
    assert notes_of(definitions) == [text.format(expression) for expression in expressions]


def test_who_may_complete_a_task_and_its_form_are_read_in_both_dialects() -> None:
    field = '<camunda:formField id="force" label="Force" type="long" defaultValue="5"><camunda:validation>'
    limits = '<camunda:constraint name="required"/><camunda:constraint name="max" config="9"/>'
    data = extensions(f"<camunda:formData>{field}{limits}</camunda:validation></camunda:formField></camunda:formData>")
    seven = task_of(data, "userTask", 'camunda:assignee="ann" camunda:candidateGroups="nurse, doctor"').human
    assert (seven.users, seven.groups) == (("ann",), ("nurse", "doctor"))
    assert seven.form == (FormField(key="force", label="Force", kind="integer", required=True, most=9.0, default=5.0),)
    people = '<zeebe:assignmentDefinition candidateUsers="bob"/><zeebe:formDefinition formId="elsewhere"/>'
    eight = task_of(extensions(people), "userTask").human
    assert (eight.users, eight.groups, eight.linked) == (("bob",), (), "elsewhere")


def test_the_form_that_a_task_is_linked_to_is_read_from_its_file() -> None:
    hospital = read(HOSPITAL)
    (plan,) = (node for node in hospital.processes[0].body.nodes if node.id == "Plan_Round")
    assert isinstance(plan, Task)
    kinds = [field.kind for field in plan.human.form]
    assert kinds == ["note", "select", "integer", "checkbox", "date", "radio", "text", "other"]
    assert plan.human.form[-1].label == "Papers: FAME does not draw fields of type filepicker"


def test_a_form_in_a_file_beside_the_model_is_drawn_like_an_embedded_one_and_goes_with_the_pool() -> None:
    hospital = read(HOSPITAL)
    assert door_of(hospital).human.linked == "Form_Door"
    kinds = ["note", "radio", "integer"]
    assert [field["kind"] for field in task_fields(door_of(hospital), None, hospital)] == kinds
    (lift,) = (pool for pool in split(hospital) if pool.name == "Lift")
    assert [field.kind for field in door_of(read(lift.source)).human.form] == kinds
    alone = read(HOSPITAL.read_bytes(), file="elsewhere/hospital.bpmn")
    (note,) = task_fields(door_of(alone), None, alone)
    assert note["label"] == "Its form Form_Door is in no .form file beside the model, and not embedded."


@pytest.mark.parametrize(
    "text", ["{", "[]", '"Form_Door"', '{"id": "Form_Door"}', '{"id": "Form_Door", "components": 1}']
)
def test_a_form_that_cannot_be_read_is_named(tmp_path: Path, text: str) -> None:
    (tmp_path / "hospital.bpmn").write_bytes(HOSPITAL.read_bytes())
    (tmp_path / "door.form").write_text(text)
    hospital = read(tmp_path / "hospital.bpmn")
    (note,) = task_fields(door_of(hospital), None, hospital)
    assert (note["kind"], note["label"][:19]) == ("other", "Its form Form_Door ")


def test_a_task_without_a_form_asks_for_the_variables_of_the_data_objects_that_it_writes() -> None:
    task = Task(id="t", kind="user", data_outputs=("Load",))
    values = [(name, Expression(text)) for name, text in (("weight", "2.5"), ("fragile", "true"), ("place", "shelf"))]
    body = Body(nodes=(task,), flows=(), data_objects=(DataObject(id="Load", values=tuple(values)),))
    fields = task_fields(task, body, Definitions(file="x", source=b""))
    assert [(field["key"], field["kind"]) for field in fields] == [
        ("weight", "number"), ("fragile", "checkbox"), ("place", "value"),
    ]  # fmt: skip


def test_the_fields_of_a_message_have_units() -> None:
    topic = Topic(name="way", type="geometry_msgs/msg/Twist")
    ((field, *_),) = topic_fields([Event(id="e", place="throw", definitions=(SignalDefinition(topic=topic),))]).values()
    assert field == {"key": "linear.x", "label": "linear.x", "kind": "number", "unit": "m/s"}


def door_of(hospital: Definitions) -> Task:
    (door,) = (node for one in hospital.processes for node in one.body.walk() if node.id == "Lift_Door")
    assert isinstance(door, Task)
    return door


@pytest.mark.parametrize(
    ("inside", "said"),
    [
        (
            "<camunda:inputOutput><camunda:inputParameter>1</camunda:inputParameter></camunda:inputOutput>",
            "has no name",
        ),
        ('<camunda:in source="x"/>', "needs target and source"),
        ('<camunda:in source="not a name" target="x"/>', "expected the name of a variable"),
        ('<zeebe:ioMapping><zeebe:input source="=x"/></zeebe:ioMapping>', "a zeebe:input has no target"),
    ],
)
def test_mappings_that_say_too_little_are_errors(inside: str, said: str) -> None:
    error = refused(process(f'<callActivity id="c" calledElement="P">{extensions(inside)}</callActivity>'))
    assert said in error.text
    assert error.element == "c"


# ---- Camunda 8 -------------------------------------------------------------------------------------------------------


def test_the_mappings_of_camunda_8() -> None:
    said = (
        '<zeebe:taskDefinition type="mow" retries="3"/><zeebe:ioMapping><zeebe:input source="=field.x" target="x"/>'
        '<zeebe:input source="fast" target="speed"/><zeebe:output source="=ok" target="done"/></zeebe:ioMapping>'
        '<zeebe:taskHeaders><zeebe:header key="unit" value="m"/></zeebe:taskHeaders>'
    )
    task = task_of(extensions(said))
    inputs = (
        Assignment("x", Expression("field.x", "feel", 3)),
        Assignment("speed", Expression("fast", "value", 3)),
    )
    assert task.io == IoMapping(inputs, (Assignment("done", Expression("ok", "feel", 3)),))
    assert (task.operation, dict(task.properties)) == ("mow", {"unit": "m"})


def test_a_target_of_camunda_8_may_be_a_field_of_a_variable() -> None:
    said = (
        '<zeebe:ioMapping><zeebe:input source="=a" target="job.id"/><zeebe:input source="fast" target="job.how.speed"/>'
        '<zeebe:output source="=b" target="cargo.state"/></zeebe:ioMapping>'
    )
    io = task_of(extensions(said)).io
    assert io is not None
    (job,), (cargo,) = io.inputs, io.outputs
    variables = {"a": 1, "b": "full", "cargo": {"kept": True}, "job": {"hidden": True}}
    assert (job.target, compile_expression(job.source)(variables)) == ("job", {"id": 1, "how": {"speed": "fast"}})
    assert (cargo.target, compile_expression(cargo.source)(variables)) == ("cargo", {"kept": True, "state": "full"})


@pytest.mark.parametrize(
    ("source", "value"), [("5", 5), ("-1.5", -1.5), ("true", True), ("5 m", "5 m"), ("=a // of the caller", 1)]
)
def test_a_field_has_the_value_that_a_variable_would_have(source: str, value: Any) -> None:
    """Also where others are put into the same variable after it."""
    more = '<zeebe:input source="=2" target="job.more"/>'
    said = f'<zeebe:input source="{source}" target="job.id"/>{more}<zeebe:input source="{source}" target="plain"/>'
    io = task_of(extensions(f"<zeebe:ioMapping>{said}</zeebe:ioMapping>")).io
    assert io is not None
    job, plain = (compile_expression(one.source)({"a": 1}) for one in io.inputs)
    assert (job, plain) == ({"id": value, "more": 2}, value)


@pytest.mark.parametrize(
    ("attributes", "io"),
    [
        ("", IoMapping((), (), True, True)),
        ('propagateAllChildVariables="false"', IoMapping((), (), True, False)),
        ('propagateAllParentVariables="false"', IoMapping((), (), False, True)),
    ],
)
def test_the_calls_of_camunda_8(attributes: str, io: IoMapping) -> None:
    call = call_of(extensions(f'<zeebe:calledElement processId="GoTo" {attributes}/>'))
    assert (call.called, call.io) == ("GoTo", io)
    computed = call_of(extensions('<zeebe:calledElement processId="=behaviour"/>'))
    assert computed.called_expression == Expression("behaviour", "feel", 3)


def test_the_loops_and_scripts_of_camunda_8() -> None:
    loop = extensions(
        '<zeebe:loopCharacteristics inputCollection="=points" inputElement="point" '
        'outputCollection="seen" outputElement="=s"/>'
    )
    script = extensions('<zeebe:script expression="=a + b" resultVariable="sum"/>')
    inside = f"{script}<multiInstanceLoopCharacteristics>{loop}</multiInstanceLoopCharacteristics>"
    task = task_of(inside, "scriptTask")
    assert (task.script, task.result_variable) == (Expression("a + b", "feel", 3), "sum")
    assert task.loop == MultiInstance(
        collection=Expression("points", "feel", 3),
        element_variable="point",
        output_collection="seen",
        output_element=Expression("s", "feel", 3),
        line=3,
    )


def test_messages_of_camunda_8_are_correlated_by_their_key() -> None:
    root = (
        f'<message id="M" name="order">{extensions("""<zeebe:subscription correlationKey="=order_id"/>""")}</message>'
    )
    catch = '<intermediateCatchEvent id="e"><messageEventDefinition messageRef="M"/></intermediateCatchEvent>'
    node = node_of(catch, root)
    assert isinstance(node, Event)
    (definition,) = node.definitions
    assert isinstance(definition, MessageDefinition)
    assert definition.keys == (("order_id", Expression("${msg.order_id}", "juel", 3)),)


def test_properties_of_camunda_8_are_properties() -> None:
    said = extensions('<zeebe:properties><zeebe:property name="type" value="std_msgs/msg/Bool"/></zeebe:properties>')
    assert topic_of(said).type == "std_msgs/msg/Bool"


# ---- all of them -----------------------------------------------------------------------------------------------------


def test_dialects_are_found_by_namespace_whatever_the_prefix() -> None:
    text = document(
        f'<process id="P"><endEvent id="e">{properties(type="std_msgs/msg/Bool")}{SIGNAL}</endEvent></process>{ROOTS}'
    )
    node: Any = (
        read_text(text.replace("camunda:", "activiti:").replace("xmlns:camunda", "xmlns:activiti"))
        .processes[0]
        .body.nodes[0]
    )
    assert node.definitions[0].topic.type == "std_msgs/msg/Bool"


def test_lists_and_maps_become_flow_style_yaml() -> None:
    assert flow_sequence(["1", "${a}", "{b: 2}", "x, y", ""]) == '[1, ${a}, {b: 2}, "x, y", ""]'
    assert flow_mapping([("a b", "1"), ("c", "it's")]) == '{"a b": 1, c: "it\'s"}'


@pytest.mark.parametrize(
    ("field", "value", "wrong"),
    [
        (FormField(key="a", kind="number", most=1234567), 9e9, "expected a number of 1234567 or less"),
        (FormField(key="a", kind="integer", least=-1234567.5, most=0), 1, "a whole number from -1234567.5 to 0"),
        (FormField(key="a", kind="select", options=((1, "one"),)), True, "expected one of 1"),
        (FormField(key="a", kind="select", options=((1, "one"),)), 1, ""),
    ],
)
def test_a_value_that_does_not_fit_is_told_the_exact_bounds(field: FormField, value: object, wrong: str) -> None:
    told = unfit_value([field], {"a": value})
    assert wrong in told
    assert bool(told) is bool(wrong)
