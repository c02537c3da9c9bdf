"""Flow nodes, data and pools: every element of a file, as the model has it."""

import pytest
from bpmn_text import body_of, document, node_of, process, properties, refused

from fame.bpmn import read_text
from fame.bpmn.model import CallActivity, Expression, Gateway, MultiInstance, StandardLoop, SubProcess, Task


def test_flows_give_incoming_and_outgoing_in_document_order_whatever_the_nodes_list() -> None:
    body = body_of(
        '<task id="a"><outgoing>wrong</outgoing></task><task id="b"/>'
        '<sequenceFlow id="f2" sourceRef="a" targetRef="b"/><sequenceFlow id="f1" sourceRef="a" targetRef="b"/>'
    )
    assert body.nodes[0].outgoing == body.nodes[1].incoming == ("f2", "f1")
    assert body.nodes[0].incoming == ()


def test_a_condition_and_a_default_flow_are_read() -> None:
    body = body_of(
        '<exclusiveGateway id="g" default="no"/><task id="t"/>'
        '<sequenceFlow id="yes" name="yes" sourceRef="g" targetRef="t">\n'
        '<conditionExpression xsi:type="tFormalExpression">x &gt; 1</conditionExpression></sequenceFlow>'
        '<sequenceFlow id="no" sourceRef="g" targetRef="t"/>'
    )
    gateway = body.nodes[0]
    assert isinstance(gateway, Gateway)
    assert (gateway.kind, gateway.default) == ("exclusive", "no")
    assert body.flows[0].condition == Expression("x > 1", "python", 4)
    assert body.flows[1].condition is None


@pytest.mark.parametrize(
    ("tag", "kind"),
    [
        ("exclusiveGateway", "exclusive"),
        ("inclusiveGateway", "inclusive"),
        ("parallelGateway", "parallel"),
        ("eventBasedGateway", "event"),
        ("complexGateway", "complex"),
    ],
)
def test_every_gateway_is_read(tag: str, kind: str) -> None:
    node = node_of(f'<{tag} id="g" gatewayDirection="Diverging"/>')
    assert isinstance(node, Gateway)
    assert node.kind == kind


def test_what_only_some_gateways_have() -> None:
    complex_one = node_of(
        '<complexGateway id="g"><activationCondition>count &gt; 2</activationCondition></complexGateway>'
    )
    assert isinstance(complex_one, Gateway)
    assert complex_one.activation == Expression("count > 2", "python", 3)
    starts = node_of('<eventBasedGateway id="g" instantiate="true" eventGatewayType="Parallel"/>')
    assert isinstance(starts, Gateway)
    assert (starts.instantiate, starts.all_events) == (True, True)


@pytest.mark.parametrize(
    ("tag", "kind"),
    [
        ("task", "plain"),
        ("userTask", "user"),
        ("manualTask", "manual"),
        ("scriptTask", "script"),
        ("serviceTask", "service"),
        ("sendTask", "send"),
        ("receiveTask", "receive"),
        ("businessRuleTask", "business_rule"),
    ],
)
def test_every_task_is_read(tag: str, kind: str) -> None:
    node = node_of(f'<{tag} id="t" name="Do it"/>')
    assert isinstance(node, Task)
    assert (node.kind, node.name, node.topic) == (kind, "Do it", None)


def test_business_rules_are_refused_by_name() -> None:
    node = node_of('<businessRuleTask id="t"/>')
    assert isinstance(node, Task)
    assert "business rules are not executed" in node.refused


def test_a_script_knows_the_line_of_its_first_line_and_loses_its_indent() -> None:
    node = node_of(
        '<scriptTask id="t">\n  <script><![CDATA[\n\n    if x < 1:\n        x = 2\n  ]]></script></scriptTask>'
    )
    assert isinstance(node, Task)
    assert node.script == Expression("if x < 1:\n    x = 2", "python", 6)


def test_a_script_in_one_line_stands_where_its_element_stands() -> None:
    node = node_of('<scriptTask id="t"\n  scriptFormat="python">\n  <script>x = 1</script></scriptTask>')
    assert isinstance(node, Task)
    assert node.script == Expression("x = 1", "python", 5)


def test_send_and_receive_tasks_are_topics_of_their_message() -> None:
    message = '<message id="M" name="order"/>'
    for tag in ("sendTask", "receiveTask"):
        node = node_of(f'<{tag} id="t" name="label" messageRef="M" instantiate="false"/>', message)
        assert isinstance(node, Task)
        assert node.topic is not None
        assert node.topic.name == "order"


def test_a_service_task_names_its_operation_by_the_standard_too() -> None:
    interface = '<interface id="I"><operation id="O" name="take_off"/></interface>'
    for attributes in ('operationRef="O"', 'implementation="take_off"'):
        node = node_of(f'<serviceTask id="t" {attributes}/>', interface)
        assert isinstance(node, Task)
        assert node.operation == "take_off"
    plain = node_of('<serviceTask id="t" implementation="##WebService"/>')
    assert isinstance(plain, Task)
    assert plain.operation == ""


def test_a_call_activity_names_what_it_calls() -> None:
    node = node_of('<callActivity id="c" calledElement="GoTo" isForCompensation="true"/>')
    assert isinstance(node, CallActivity)
    assert (node.called, node.called_expression, node.for_compensation) == ("GoTo", None, True)
    computed = node_of('<callActivity id="c" calledElement="${behaviour}"/>')
    assert isinstance(computed, CallActivity)
    assert (computed.called, computed.called_expression) == ("", Expression("${behaviour}", "juel", 3))


def test_a_called_element_may_be_a_qualified_name() -> None:
    node = node_of('<callActivity id="c" xmlns:tns="http://fame" calledElement="tns:GoTo"/>')
    assert isinstance(node, CallActivity)
    assert node.called == "GoTo"


@pytest.mark.parametrize(
    ("xml", "kind"),
    [
        ("<subProcess {}>", "embedded"),
        ('<subProcess {} triggeredByEvent="true">', "event"),
        ("<transaction {}>", "transaction"),
        ("<adHocSubProcess {}>", "adhoc"),
    ],
)
def test_sub_processes_hold_a_body_of_their_own(xml: str, kind: str) -> None:
    end = xml.split()[0].replace("<", "</").rstrip(">") + ">"
    node = node_of(xml.format('id="sub"') + '<startEvent id="s"/>' + end)
    assert isinstance(node, SubProcess)
    assert (node.kind, node.triggered_by_event) == (kind, kind == "event")
    assert [inner.id for inner in node.body.nodes] == ["s"]


def test_an_ad_hoc_sub_process_has_order_and_completion() -> None:
    node = node_of(
        '<adHocSubProcess id="a" ordering="Sequential" cancelRemainingInstances="false"><task id="t"/>'
        "<completionCondition>done</completionCondition></adHocSubProcess>"
    )
    assert isinstance(node, SubProcess)
    assert (node.sequential, node.cancel_remaining, node.completion) == (True, False, Expression("done", "python", 3))


def test_walk_meets_every_node_at_every_depth() -> None:
    body = body_of('<subProcess id="a"><subProcess id="b"><task id="c"/></subProcess></subProcess><task id="d"/>')
    assert [node.id for node in body.walk()] == ["a", "b", "c", "d"]


def test_sub_processes_may_be_64_deep_and_no_deeper() -> None:
    opened, closed = "".join(f'<subProcess id="s{depth}">' for depth in range(240)), "</subProcess>" * 240
    assert len(list(body_of(opened[: opened.index('<subProcess id="s64"')] + "</subProcess>" * 64).walk())) == 64
    assert "s64: expected at most 64 sub-processes inside each other" in str(refused(process(opened + closed)))


def test_loops_are_read() -> None:
    multi = node_of(
        '<task id="t"><multiInstanceLoopCharacteristics isSequential="true"><loopCardinality>3</loopCardinality>'
        "<completionCondition>${found}</completionCondition></multiInstanceLoopCharacteristics></task>"
    )
    assert isinstance(multi, Task)
    assert isinstance(multi.loop, MultiInstance)
    assert (multi.loop.sequential, multi.loop.cardinality) == (True, Expression("3", "python", 3))
    assert multi.loop.completion == Expression("${found}", "juel", 3)
    standard = node_of(
        '<task id="t"><standardLoopCharacteristics testBefore="true" loopMaximum="5">'
        "<loopCondition>x &lt; 3</loopCondition>"
        "</standardLoopCharacteristics></task>"
    )
    assert isinstance(standard, Task)
    assert standard.loop == StandardLoop(
        condition=Expression("x < 3", "python", 3), test_before=True, maximum=5, line=3
    )


def test_a_multi_instance_may_take_its_items_from_a_data_object_as_the_standard_says() -> None:
    node = node_of(
        '<task id="t"><ioSpecification><dataInput id="in" name="in"/><inputSet/><outputSet/></ioSpecification>'
        '<dataInputAssociation id="a"><sourceRef>ref</sourceRef><targetRef>in</targetRef></dataInputAssociation>'
        "<multiInstanceLoopCharacteristics><loopDataInputRef>in</loopDataInputRef>"
        "<loopDataOutputRef>ref2</loopDataOutputRef>"
        '<inputDataItem id="i" name="point"/><outputDataItem id="o" name="seen"/>'
        "</multiInstanceLoopCharacteristics></task>"
        '<dataObjectReference id="ref" name="points" dataObjectRef="d"/><dataObject id="d"/>'
        '<dataObjectReference id="ref2" name="results" dataObjectRef="d2"/><dataObject id="d2"/>'
    )
    assert isinstance(node, Task)
    assert isinstance(node.loop, MultiInstance)
    assert node.loop.collection == Expression("points", "python", 3)
    assert (node.loop.element_variable, node.loop.output_collection) == ("point", "results")
    assert node.loop.output_element == Expression("seen", "python", 3)


# ---- data ------------------------------------------------------------------------------------------------------------


DATA = (
    '<dataObjectReference id="ref" name="Weed Position" dataObjectRef="obj">'
    '<dataState name="fresh"/>{}</dataObjectReference>'
)
OBJECT = '<dataObject id="obj" isCollection="true"/>'


def test_a_data_object_reference_holds_variables() -> None:
    body = body_of(DATA.format(properties(x_weed="${x_weed}", y_weed="1.5")) + OBJECT)
    (data,) = body.data_objects
    assert data.names == ("x_weed", "y_weed")
    assert data.values[1][1] == Expression("1.5", "value", 3)
    assert (data.id, data.name, data.state, data.collection) == ("ref", "Weed Position", "fresh", True)


def test_associations_name_the_data_objects_that_a_node_reads_and_writes() -> None:
    node = node_of(
        '<task id="t"><property id="p" name="__targetRef_placeholder"/>'
        '<dataInputAssociation id="i"><sourceRef>ref</sourceRef><targetRef>p</targetRef></dataInputAssociation>'
        '<dataOutputAssociation id="o"><targetRef>obj</targetRef></dataOutputAssociation></task>'
        + DATA.format("")
        + OBJECT
    )
    assert (node.data_inputs, node.data_outputs) == (("ref",), ("ref",))


def test_associations_may_go_through_an_io_specification() -> None:
    node = node_of(
        '<task id="t"><ioSpecification><dataInput id="in"/><dataOutput id="out"/><inputSet/><outputSet/>'
        "</ioSpecification>"
        '<dataInputAssociation id="i"><sourceRef>store</sourceRef><targetRef>in</targetRef></dataInputAssociation>'
        '<dataOutputAssociation id="o"><sourceRef>out</sourceRef><targetRef>ref</targetRef>'
        "</dataOutputAssociation></task>"
        '<dataStoreReference id="store" name="map"/>' + DATA.format("") + OBJECT
    )
    assert (node.data_inputs, node.data_outputs) == (("store",), ("ref",))


def test_a_task_in_a_sub_process_may_use_the_data_of_the_process() -> None:
    body = body_of(
        '<subProcess id="sub"><task id="t"><dataInputAssociation id="i"><sourceRef>ref</sourceRef>'
        "</dataInputAssociation>"
        "</task></subProcess>" + DATA.format("") + OBJECT
    )
    assert list(body.walk())[1].data_inputs == ("ref",)


def test_properties_and_inputs_of_a_process_are_variables() -> None:
    body = body_of('<ioSpecification><dataInput id="i" name="speed"/></ioSpecification><property id="p" name="count"/>')
    assert [(one.kind, one.names) for one in body.data_objects] == [("property", ("count",)), ("input", ("speed",))]


def test_assignments_of_associations_are_mappings() -> None:
    node = node_of(
        '<task id="t"><dataInputAssociation id="i"><sourceRef>ref</sourceRef><targetRef>in</targetRef>'
        "<assignment><from>x + 1</from><to>y</to></assignment></dataInputAssociation>"
        '<ioSpecification><dataInput id="in" name="y"/></ioSpecification></task>' + DATA.format("") + OBJECT
    )
    assert isinstance(node, Task)
    assert node.io is not None
    assert [(one.target, one.source.text) for one in node.io.inputs] == [("y", "x + 1")]


def test_a_compensation_event_is_associated_with_its_handler_whichever_way_it_was_drawn() -> None:
    for ends in ('sourceRef="e" targetRef="h"', 'sourceRef="h" targetRef="e"'):
        body = body_of(
            '<boundaryEvent id="e" attachedToRef="t"><compensateEventDefinition/></boundaryEvent><task id="t"/>'
            f'<task id="h" isForCompensation="true"/><association id="a" associationDirection="One" {ends}/>'
        )
        assert body.associations == (("e", "h"),)


# ---- collaborations --------------------------------------------------------------------------------------------------


def test_pools_are_robots_and_a_marker_makes_them_many() -> None:
    definitions = read_text(
        document(
            '<collaboration id="C"><participant id="a" name="DRONE" processRef="A"/><participant id="b" name="TRACTOR" '
            'processRef="tns:B"><participantMultiplicity/></participant><participant id="c" name="outside"/>'
            '<messageFlow id="m" name="order" sourceRef="c" targetRef="t"/></collaboration>'
            '<process id="A"><task id="t"/></process><process id="B"/>'
        )
    )
    seen = [(one.name, one.process, one.multi_instance) for one in definitions.participants]
    assert seen == [("DRONE", "A", False), ("TRACTOR", "B", True), ("outside", "", False)]
    assert [(one.name, one.source, one.target) for one in definitions.message_flows] == [("order", "c", "t")]


def test_lanes_are_kept_at_any_depth() -> None:
    text = process(
        '<laneSet id="l"><lane id="a" name="outer"><flowNodeRef>t</flowNodeRef><childLaneSet id="m"><lane id="b"/>'
        '</childLaneSet></lane></laneSet><task id="t"/>'
    )
    assert [one.id for one in read_text(text).processes[0].lanes] == ["a", "b"]


def test_artifacts_have_their_text() -> None:
    text = document(
        '<process id="P"><textAnnotation id="n"><text>why &amp; how</text></textAnnotation>'
        '<group id="g" categoryValueRef="v"/>'
        '<association id="a" sourceRef="n" targetRef="n"/></process><category id="k">'
        '<categoryValue id="v" value="field"/></category>'
    )
    assert [(one.kind, one.name) for one in read_text(text).artifacts] == [
        ("annotation", "why & how"),
        ("group", "field"),
    ]


def test_process_properties_mean_something() -> None:
    definitions = read_text(process(properties(instances="2", semantics="original", version="7")))
    assert (definitions.processes[0].instances, definitions.processes[0].semantics) == (2, "original")
    assert dict(definitions.processes[0].properties) == {"version": "7"}


def test_resume_is_a_property_of_an_event_sub_process() -> None:
    node = node_of(f'<subProcess id="s" triggeredByEvent="true">{properties(resume="true")}</subProcess>')
    assert isinstance(node, SubProcess)
    assert node.resume


def test_documentation_is_read() -> None:
    assert node_of('<task id="t"><documentation> Why. </documentation></task>').documentation == "Why."
