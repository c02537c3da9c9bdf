"""Writing: a file comes out as it went in, and a pool comes out as a file of its own."""

from dataclasses import replace
from pathlib import Path

import pytest
from bpmn_text import document, extensions, notes_of, properties
from gallery import gallery
from lxml import etree

from fame.bpmn import extract_process, read, read_bytes, read_text, topic_table, write
from fame.bpmn.library import Find, Library
from fame.bpmn.model import CallActivity, Definitions, Event, Process, SignalDefinition
from fame.errors import ModelError

MODELS = Path(__file__).parent.parent / "models"
STRANGE = b"""<?xml version="1.0" encoding="ISO-8859-1"?>
<!-- drawn by \xe4nne -->
<?tool keep this?>
<semantic:definitions xmlns:semantic="http://www.omg.org/spec/BPMN/20100524/MODEL" xmlns:v="http://vendor"
    xmlns:modeler="http://camunda.org/schema/modeler/1.0" modeler:executionPlatform="Camunda Platform">
  <semantic:process id="P" v:colour="red">
    <semantic:extensionElements><v:meta>kept</v:meta></semantic:extensionElements>
    <semantic:scriptTask id="t"><semantic:script><![CDATA[x = 1 < 2]]></semantic:script></semantic:scriptTask>
  </semantic:process>
</semantic:definitions>
"""


# ---- write -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("source", [STRANGE, gallery().encode()])
def test_reading_and_writing_loses_nothing(source: bytes, tmp_path: Path) -> None:
    definitions = read_bytes(source, file="a.bpmn")
    assert write(definitions, tmp_path / "out.bpmn") == source
    assert replace(read(tmp_path / "out.bpmn"), file="a.bpmn") == definitions


def test_a_model_that_was_changed_in_python_is_not_written_wrong() -> None:
    definitions = read_bytes(STRANGE)
    with pytest.raises(ModelError, match="change the file instead"):
        write(replace(definitions, processes=()))
    with pytest.raises(ModelError, match="change the file instead"):
        write(Definitions(file="", source=b""))


def test_a_place_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="cannot be written: No such file or directory"):
        write(read_bytes(STRANGE), tmp_path / "nowhere" / "out.bpmn")


# ---- extract_process -------------------------------------------------------------------------------------------------

MISSION = document(
    """
<collaboration id="C">
  <participant id="Pool_A" name="REX" processRef="A"/>
  <participant id="Pool_B" name="DINGO" processRef="B"><participantMultiplicity/></participant>
  <messageFlow id="Flow_M" sourceRef="Pool_A" targetRef="Pool_B"/>
  <textAnnotation id="Note_A"><text>beside A</text></textAnnotation>
  <textAnnotation id="Note_B"><text>beside B</text></textAnnotation>
  <association id="Link_A" sourceRef="Call" targetRef="Note_A"/>
</collaboration>
<process id="A" isExecutable="true">
  <!-- why -->
  <laneSet id="Lanes"><lane id="Lane_A" name="lane"><flowNodeRef>Call</flowNodeRef></lane></laneSet>
  <startEvent id="StartEvent_1"/>
  <sequenceFlow id="Flow_1" sourceRef="StartEvent_1" targetRef="Call"/>
  <callActivity id="Call" calledElement="GoTo"/>
  <sequenceFlow id="Flow_2" sourceRef="Call" targetRef="Throw"/>
  <endEvent id="Throw"><documentation>tells</documentation><signalEventDefinition signalRef="Signal_1"/></endEvent>
  <boundaryEvent id="Lost" attachedToRef="Call"><errorEventDefinition errorRef="Error_1"/></boundaryEvent>
</process>
<process id="B"><startEvent id="Catch">"""
    + properties(type="geometry_msgs/msg/Vector3")
    + """<signalEventDefinition signalRef="Signal_1"/></startEvent></process>
<signal id="Signal_1" name="target_found" structureRef="Item_1"/>
<signal id="Signal_2" name="unused"/>
<itemDefinition id="Item_1"/>
<error id="Error_1" errorCode="lost"/>
<bpmndi:BPMNDiagram id="Diagram_1"><bpmndi:BPMNPlane id="Plane_1" bpmnElement="C">"""
    + "".join(
        f'<bpmndi:BPMNShape id="{id}_di" bpmnElement="{id}"><dc:Bounds x="{x}" y="{y}" width="{width}" height="50"/>'
        "</bpmndi:BPMNShape>"
        for id, x, y, width in (
            ("Pool_A", 0, 0, 500),
            ("Lane_A", 30, 0, 470),
            ("StartEvent_1", 50, 10, 36),
            ("Call", 100, 10, 100),
            ("Note_A", 300, 10, 100),
            ("Pool_B", 0, 100, 500),
            ("Catch", 50, 110, 36),
            ("Note_B", 300, 110, 100),
        )
    )
    + """<bpmndi:BPMNEdge id="Flow_1_di" bpmnElement="Flow_1"><di:waypoint x="86" y="25"/><di:waypoint x="100" y="25"/>
</bpmndi:BPMNEdge><bpmndi:BPMNEdge id="Flow_M_di" bpmnElement="Flow_M"><di:waypoint x="9" y="50"/>
<di:waypoint x="9" y="100"/></bpmndi:BPMNEdge></bpmndi:BPMNPlane></bpmndi:BPMNDiagram>"""
)
LIBRARY = """<?xml version="1.0" encoding="UTF-8"?>
<bpmn2:definitions xmlns:bpmn2="http://www.omg.org/spec/BPMN/20100524/MODEL" xmlns:c="http://camunda.org/schema/1.0/bpmn"
  xmlns:di="http://www.omg.org/spec/BPMN/20100524/DI" xmlns:dc="http://www.omg.org/spec/DD/20100524/DC"
  xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" id="Library">
  <bpmn2:process id="{id}">
    <bpmn2:startEvent id="StartEvent_1"><bpmn2:outgoing>Flow_1</bpmn2:outgoing></bpmn2:startEvent>
    <bpmn2:sequenceFlow id="Flow_1" sourceRef="StartEvent_1" targetRef="Wait">
      <bpmn2:conditionExpression xsi:type="bpmn2:tFormalExpression">x</bpmn2:conditionExpression></bpmn2:sequenceFlow>
    <bpmn2:intermediateCatchEvent id="Wait"><bpmn2:signalEventDefinition signalRef="Signal_1"/>
    </bpmn2:intermediateCatchEvent>
    <bpmn2:callActivity id="Inner" calledElement="{calls}"/>
  </bpmn2:process>
  <bpmn2:signal id="Signal_1" name="odom"/>
  <di:BPMNDiagram id="Diagram_1"><di:BPMNPlane id="Plane_1" bpmnElement="{id}">
    <di:BPMNShape id="Wait_di" bpmnElement="Wait"><dc:Bounds x="0" y="0" width="36" height="36"/></di:BPMNShape>
  </di:BPMNPlane></di:BPMNDiagram>
</bpmn2:definitions>"""
GO_TO = read_text(LIBRARY.format(id="Process_1", calls="Turn"), file="GoTo.bpmn")
TURN = read_text(LIBRARY.format(id="Process_1", calls=""), file="Turn.bpmn")


def found_in(**files: Definitions) -> Find:
    """Finds the only process of each of these files by the name of the file, else one of the caller's file."""

    def find(home: Definitions, call: CallActivity) -> tuple[Definitions, Process] | None:
        there = files.get(call.called)
        process = home.process(call.called)
        return (there, there.processes[0]) if there is not None else (home, process) if process is not None else None

    return find


CALLED = found_in(GoTo=GO_TO, Turn=TURN)


def extracted(process: str, text: str = MISSION, **options: object) -> Definitions:
    """One pool of the mission, read back."""
    definitions = read_text(text, file="mission.bpmn")
    types = {use.name: use.type for use in topic_table(definitions).values()}
    xml = extract_process(definitions, process, topic_types=types, **{"find": CALLED, **options})  # type: ignore[arg-type]
    return read_bytes(xml, file=f"{process}.bpmn")


def test_an_extracted_file_has_one_pool_its_process_and_what_that_calls() -> None:
    robot = extracted("A")
    assert [(pool.name, pool.process) for pool in robot.participants] == [("REX", "A")]
    assert [process.id for process in robot.processes] == ["A", "Process_1", "Process_1_2"]
    assert robot.message_flows == ()
    called = ("has a condition, but leaves StartEvent_1_2", "has a condition, but leaves StartEvent_1_3")
    assert [note for note in notes_of(robot) if not note.startswith(called)] == []


def test_calls_name_the_processes_as_they_are_called_in_the_new_file() -> None:
    robot = extracted("A")
    calls = {
        node.id: node.called
        for process in robot.processes
        for node in process.body.walk()
        if isinstance(node, CallActivity)
    }
    assert calls == {"Call": "Process_1", "Inner": "Process_1_2", "Inner_2": ""}


def test_ids_that_are_taken_get_a_number_and_references_follow() -> None:
    go_to = extracted("A").processes[1].body
    assert [node.id for node in go_to.nodes] == ["StartEvent_1_2", "Wait", "Inner"]
    assert (go_to.flows[0].source, go_to.flows[0].target) == ("StartEvent_1_2", "Wait")
    assert go_to.nodes[0].outgoing == (go_to.flows[0].id,)


def test_signals_of_one_id_and_two_names_stay_two() -> None:
    robot = extracted("A")
    names = [
        definition.topic.name
        for process in robot.processes
        for node in process.body.walk()
        if isinstance(node, Event)
        for definition in node.definitions
        if isinstance(definition, SignalDefinition)
    ]
    assert names == ["target_found", "odom", "odom"]


def test_the_type_that_another_pool_says_is_written_into_the_event() -> None:
    throw = next(node for node in extracted("A").processes[0].body.nodes if node.id == "Throw")
    assert isinstance(throw, Event)
    assert isinstance(throw.definitions[0], SignalDefinition)
    assert throw.definitions[0].topic.type == "geometry_msgs/msg/Vector3"
    assert throw.documentation == "tells"


def test_only_what_is_referred_to_comes_along() -> None:
    xml = extract_process(read_text(MISSION), "A", find=CALLED)
    root = etree.fromstring(xml)
    ids = [one.get("id") for one in root if one.tag.endswith(("signal", "error", "itemDefinition"))]
    assert ids == ["Signal_1", "Item_1", "Error_1", "Signal_1_2", "Signal_1_3"]
    assert b"<!-- why -->" in xml


def test_the_drawing_of_the_pool_and_of_what_it_calls_comes_along() -> None:
    robot = extracted("A")
    assert robot.planes == ("C", "Process_1", "Process_1_2")
    shown = [(shape.plane, shape.element) for shape in robot.shapes]
    own = [(0, id) for id in ("Pool_A", "Lane_A", "StartEvent_1", "Call", "Note_A")]
    assert shown == [*own, (1, "Wait"), (2, "Wait_2")]
    assert [edge.element for edge in robot.edges] == ["Flow_1"]
    assert [artifact.id for artifact in robot.artifacts] == ["Note_A"]


def test_the_pool_may_get_another_name_and_stays_what_it_is() -> None:
    robot = extracted("B", name="DINGO_1")
    assert [(pool.name, pool.multi_instance) for pool in robot.participants] == [("DINGO_1", True)]
    assert [process.id for process in robot.processes] == ["B"]


def test_a_name_picks_the_pool_where_two_have_the_process() -> None:
    text = MISSION.replace('name="DINGO" processRef="B"', 'name="DINGO" processRef="A"')
    assert extracted("A", text, name="DINGO").participants[0].id == "Pool_B"
    assert extracted("A", text).participants[0].id == "Pool_A"


def test_a_process_of_the_same_file_that_is_called_comes_along_once() -> None:
    text = MISSION.replace('calledElement="GoTo"', 'calledElement="B"')
    robot = extracted("A", text)
    assert [process.id for process in robot.processes] == ["A", "B"]
    assert [pool.name for pool in robot.participants] == ["REX"]
    root = etree.fromstring(robot.source)
    assert [one.get("id") for one in root if one.tag.endswith("signal")] == ["Signal_1"]


def test_files_without_a_name_are_told_apart() -> None:
    library = read_text(LIBRARY.format(id="GoTo", calls=""))
    robot = read_bytes(extract_process(read_text(MISSION), "A", find=found_in(GoTo=library)))
    assert [process.id for process in robot.processes] == ["A", "GoTo"]


def test_a_process_that_calls_itself_is_no_trouble() -> None:
    robot = extracted("A", MISSION.replace('calledElement="GoTo"', 'calledElement="A"'))
    assert [process.id for process in robot.processes] == ["A"]


def test_an_embedded_process_becomes_one_of_the_file() -> None:
    inner = "&lt;bpmn2:process id=&quot;Hop&quot;&gt;&lt;bpmn2:task id=&quot;hop&quot;/&gt;&lt;/bpmn2:process&gt;"
    call = f'<callActivity id="Call">{extensions(f"""<callActivity:process process="{inner}"/>""")}</callActivity>'
    robot = extracted("A", MISSION.replace('<callActivity id="Call" calledElement="GoTo"/>', call))
    assert [process.id for process in robot.processes] == ["A", "Hop"]


def test_a_process_without_a_pool_is_extracted_without_one() -> None:
    definitions = extracted("Process_1", LIBRARY.format(id="Process_1", calls=""))
    assert (definitions.participants, definitions.planes) == ((), ("Process_1",))


def test_types_of_several_topics_of_one_event_are_written_into_its_definitions() -> None:
    both = '<signalEventDefinition signalRef="S"/><signalEventDefinition signalRef="T"/>'
    roots = '<signal id="S" name="s"/><signal id="T" name="t"/>'
    definitions = read_text(document(f'<process id="P"><startEvent id="e">{both}</startEvent></process>{roots}'))
    xml = extract_process(definitions, "P", topic_types={"/s": "std_msgs/msg/Bool", "/t": "std_msgs/msg/String"})
    event = read_bytes(xml).processes[0].body.nodes[0]
    assert isinstance(event, Event)
    types = [one.topic.type for one in event.definitions if isinstance(one, SignalDefinition)]
    assert types == ["std_msgs/msg/Bool", "std_msgs/msg/String"]


def test_ids_that_the_reader_makes_stay_what_they_are() -> None:
    definitions = read_text(document('<process><startEvent/>\n<task id="t"/></process>'))
    (process,) = definitions.processes
    robot = read_bytes(extract_process(definitions, process.id)).processes[0]
    assert robot.id == process.id == "process_2"
    assert [node.id for node in robot.body.nodes] == [node.id for node in process.body.nodes] == ["startEvent_2", "t"]


def test_a_process_that_is_not_there_is_named_with_those_that_are() -> None:
    with pytest.raises(ModelError, match=r"mission\.bpmn: the file has no process 'X'; its processes are: A, B"):
        extracted("X")


def test_extracting_twice_gives_the_same() -> None:
    once = extracted("A")
    again = extract_process(once, "A")
    assert replace(read_bytes(again, file="A.bpmn"), source=b"") == replace(once, source=b"")


def test_the_missions_of_the_project_come_apart() -> None:
    definitions = read(MODELS / "ground_vehicles.bpmn")
    for pool in definitions.participants:
        robot = read_bytes(extract_process(definitions, pool.process, name=pool.name, find=Library().find))
        assert [one.name for one in robot.participants] == [pool.name]
        assert topic_table(robot)
