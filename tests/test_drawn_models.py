"""Models that are drawn and cannot be executed yet: read, drawn, converted, split, checked with all faults at once."""

from collections.abc import Callable
from contextlib import suppress
from random import Random

import pytest
from bpmn_text import document, process
from drawn_models import FEATURES, drawn_model
from lxml import etree

import fame
from fame.bpmn import read_bytes, read_text
from fame.bpmn.conversion import convert
from fame.bpmn.draw.diagram import draw
from fame.bpmn.model import Definitions
from fame.bpmn.split import split
from fame.check import check
from fame.errors import FameError, ModelError

FILES = 60


def errors_of(definitions: Definitions) -> list[str]:
    return sorted(finding.text for finding in check(definitions) if finding.level == "error")


@pytest.mark.parametrize("name", FEATURES)
def test_whatever_is_drawn_can_be_read_drawn_and_written_and_is_refused_when_compiled(name: str) -> None:
    definitions = read_bytes(drawn_model([name], Random(1)), file="drawn.bpmn")
    refused = FEATURES[name].refused
    assert etree.fromstring(draw(definitions)) is not None
    errors = [text for text in errors_of(definitions) if "the file has no such process" not in text]
    assert [refused in text for text in errors] == [True] * bool(refused)
    if refused:
        with pytest.raises(ModelError, match=r"^drawn\.bpmn:\d+: ") as caught:
            fame.Simulation(definitions, "P0")
        assert refused in caught.value.text
    else:
        fame.Simulation(definitions, "P0", services={"ask": lambda variables: None})


@pytest.mark.parametrize("seed", range(FILES))
def test_files_of_many_features_are_read_drawn_converted_split_and_checked(seed: int) -> None:
    handle(seed)


def handle(seed: int) -> None:
    """Do all that can be done with a file of some features."""
    random = Random(seed)
    names = random.sample(list(FEATURES), random.randrange(1, 9))
    definitions = read_bytes(drawn_model(names, random), file="drawn.bpmn")
    assert etree.fromstring(draw(definitions)) is not None
    errors = errors_of(definitions)
    for name in names:
        refused = FEATURES[name].refused
        assert not refused or any(refused in text for text in errors), name
    again = read_bytes(convert(definitions), file="drawn.bpmn")
    assert errors_of(again) == errors
    assert etree.fromstring(draw(again)) is not None
    for doing in (_split, *(_compiling(one.id) for one in definitions.processes)):
        with suppress(FameError):  # with its reason; a traceback is something else
            doing(definitions)


def _split(definitions: Definitions) -> None:
    for part in split(definitions):
        alone = read_bytes(part.source, file="part.bpmn")
        whole = definitions.process(part.process_id)
        assert whole is not None
        assert {fault.text for fault in alone.processes[0].faults} == {fault.text for fault in whole.faults}
        assert etree.fromstring(draw(alone)) is not None
        check(alone)


def _compiling(process: str) -> Callable[[Definitions], object]:
    return lambda definitions: fame.Simulation(definitions, process)


def test_all_faults_are_told_at_once_and_the_first_of_them_refuses_a_run() -> None:
    names = ["a timer without a time", "a script in Groovy", "a multi-instance", "a flow to nothing"]
    content = "\n".join(FEATURES[name].content.replace("{n}", str(place)) for place, name in enumerate(names))
    definitions = read_text(process(f'<startEvent id="s"/>\n{content}'), file="drawn.bpmn")
    found = [(one.element, one.line) for one in check(definitions) if one.level == "error"]
    assert found == [("c0", 4), ("t1", 5), ("t2", 6), ("f3", 7)]
    with pytest.raises(ModelError, match=r"drawn\.bpmn:5: t1: language 'groovy'"):
        fame.Simulation(definitions)


@pytest.mark.parametrize("name", FEATURES)
def test_whatever_is_drawn_can_be_split(name: str) -> None:
    pools = '<participant id="a" name="A" processRef="P"/><participant id="b" name="B" processRef="Q"/>'
    feature = FEATURES[name]
    text = document(
        f'<collaboration id="C">{pools}</collaboration>{feature.root}<process id="P">{feature.content}</process>'
        '<process id="Q"><startEvent id="s"/></process>'
    )
    definitions = read_text(text.replace("{n}", "0"), file="drawn.bpmn")
    parts = split(definitions)
    assert [part.name for part in parts] == ["A", "B"]
    assert errors_of(read_bytes(parts[0].source)) == errors_of(definitions)


def test_nothing_doubtful_is_said_of_an_element_that_has_a_fault() -> None:
    condition = '<conditionExpression language="groovy">q</conditionExpression></sequenceFlow>'
    text = process(
        f"""<startEvent id="s"/><exclusiveGateway id="g"/><userTask id="a"/><scriptTask id="b" scriptFormat="ruby">
        <script>x</script></scriptTask><sequenceFlow id="f" sourceRef="s" targetRef="g"/>
        <sequenceFlow id="x" sourceRef="g" targetRef="a">{condition}
        <sequenceFlow id="y" sourceRef="g" targetRef="b">{condition}"""
    )
    found = [(finding.level, finding.element) for finding in check(read_text(text))]
    assert [pair for pair in found if pair[1] in "xyb"] == [("error", "b"), ("error", "x"), ("error", "y")]


# ---- names -----------------------------------------------------------------------------------------------------------


def test_a_signal_without_a_name_is_the_topic_of_its_id() -> None:
    text = process(
        '<startEvent id="s"/><sequenceFlow id="f" sourceRef="s" targetRef="e"/>'
        '<endEvent id="e"><signalEventDefinition signalRef="Signal_1"/></endEvent>'
        '<subProcess id="h" triggeredByEvent="true"><startEvent id="c" isInterrupting="false">'
        '<signalEventDefinition signalRef="Signal_1"/></startEvent></subProcess>',
        '<signal id="Signal_1"/>',
    )
    sim = fame.Simulation(read_text(text))
    sim.run()
    assert sim.instances[0].visits["c"] == 1


def test_a_pool_without_a_name_is_called_by_its_id() -> None:
    pools = '<participant id="Pool_1" processRef="P"/><participant id="Pool_2" name="REX" processRef="Q"/>'
    text = document(
        f'<collaboration id="C">{pools}</collaboration><process id="P"><startEvent id="s"/></process>'
        '<process id="Q"><startEvent id="t"/></process>'
    )
    parts = split(read_text(text))
    assert [part.name for part in parts] == ["Pool_1", "REX"]
    assert read_bytes(parts[0].source).participants[0].label == "Pool_1"
    sim = fame.Simulation(read_text(text), "Pool_1")
    sim.run()
    assert sim.instances[0].visits["s"] == 1


def test_a_data_item_whose_name_is_no_variables_goes_by_its_id() -> None:
    text = process(
        '<startEvent id="s"/><sequenceFlow id="f" sourceRef="s" targetRef="t"/><scriptTask id="t"><script>'
        "out_1 = 2 * in_1</script><multiInstanceLoopCharacteristics><loopDataInputRef>data</loopDataInputRef>"
        '<loopDataOutputRef>results</loopDataOutputRef><inputDataItem id="in_1" name="input item"/>'
        '<outputDataItem id="out_1" name="output item"/></multiInstanceLoopCharacteristics></scriptTask>'
    )
    sim = fame.Simulation(read_text(text), variables={"data": [1, 2, 3], "results": None})
    sim.run()
    assert sim.instances[0].variables["results"] == [2, 4, 6]


# ---- data stores -----------------------------------------------------------------------------------------------------

STORE = (
    '<dataStoreReference id="store" name="Stock"><extensionElements><camunda:properties><camunda:property name="stock" '
    'value="5"/></camunda:properties></extensionElements></dataStoreReference>'
)


def reads(store: str) -> str:
    inward = f'<dataInputAssociation id="i_{store}"><sourceRef>store</sourceRef></dataInputAssociation>'
    return (
        f'<startEvent id="s_{store}"/><sequenceFlow id="f_{store}" sourceRef="s_{store}" targetRef="t_{store}"/>'
        f'<scriptTask id="t_{store}">{inward}<script>left = stock - 1</script></scriptTask>'
    )


@pytest.mark.parametrize("name", ["A", "B"])
def test_a_data_store_of_two_pools_is_one_of_each_robots_own_also_in_the_parts(name: str) -> None:
    pools = '<participant id="a" name="A" processRef="P"/><participant id="b" name="B" processRef="Q"/>'
    text = document(
        f'<collaboration id="C">{pools}</collaboration><process id="P">{reads("p")}{STORE}</process>'
        f'<process id="Q">{reads("q")}</process>'
    )
    definitions = read_text(text)
    assert errors_of(definitions) == []
    (part,) = (part for part in split(definitions) if part.name == name)
    for model in (definitions, read_bytes(part.source)):
        sim = fame.Simulation(model, name)
        sim.run()
        assert sim.instances[0].variables["left"] == 4


# ---- what has no effect is drawn all the same ------------------------------------------------------------------------


def test_conversations_and_choreographies_are_drawn() -> None:
    shape = '<bpmndi:BPMNShape bpmnElement="{}" {}><dc:Bounds x="{}" y="0" width="80" height="60"/></bpmndi:BPMNShape>'
    shapes = [("cv", ""), ("CS", ""), ("CT", ""), ("CP", 'participantBandKind="top_initiating"'), ("M", "")]
    drawn = "".join(shape.format(id, more, 100 * place) for place, (id, more) in enumerate(shapes))
    edge = '<bpmndi:BPMNEdge bpmnElement="cl"><di:waypoint x="0" y="0"/><di:waypoint x="9" y="9"/></bpmndi:BPMNEdge>'
    text = document(
        '<collaboration id="C"><participant id="a" name="A"/><conversation id="cv" name="Talk"/><conversationLink '
        'id="cl" sourceRef="a" targetRef="cv"/></collaboration><message id="M" name="Letter"/><choreography id="CH">'
        '<participant id="CP" name="Buyer"/><startEvent id="CS" name="Begin"/><choreographyTask id="CT" name="Order"/>'
        f'</choreography><bpmndi:BPMNDiagram><bpmndi:BPMNPlane bpmnElement="C">{drawn}{edge}</bpmndi:BPMNPlane>'
        "</bpmndi:BPMNDiagram>"
    )
    definitions = read_text(text)
    assert [note.text for note in definitions.notes] == ["<choreography> has no effect"]
    picture = etree.fromstring(draw(definitions))
    names = {"".join(group.itertext()) for group in picture.iter("{*}g") if group.get("id")}
    assert names == {"Talk", "Begin", "Order", "Buyer", "Letter", ""}
