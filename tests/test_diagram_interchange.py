"""The diagram interchange: where things are drawn."""

import pytest
from bpmn_text import document, notes_of

from fame.bpmn import read_text


def diagram(content: str, element: str = "P") -> str:
    """A process with a task and this drawing."""
    return document(
        f'<process id="P"><task id="t"/></process><bpmndi:BPMNDiagram id="D">'
        f'<bpmndi:BPMNPlane id="L" bpmnElement="{element}">'
        f"{content}</bpmndi:BPMNPlane></bpmndi:BPMNDiagram>"
    )


def test_shapes_are_read_with_bounds_labels_and_colours() -> None:
    definitions = read_text(
        diagram(
            '<bpmndi:BPMNShape id="x" bpmnElement="t" isExpanded="true" '
            'xmlns:bioc="http://bpmn.io/schema/bpmn/biocolor/1.0" '
            'bioc:stroke="#0d4372" bioc:fill="#bbdefb"><dc:Bounds x="1" y="2.5" width="100" height="80"/>'
            "<bpmndi:BPMNLabel>"
            '<dc:Bounds x="3" y="4" width="5" height="6"/></bpmndi:BPMNLabel></bpmndi:BPMNShape>'
        )
    )
    (shape,) = definitions.shapes
    assert (shape.element, shape.kind, shape.expanded, shape.plane) == ("t", "task", True, 0)
    assert (shape.bounds.y, shape.bounds.width, shape.stroke, shape.fill) == (2.5, 100, "#0d4372", "#bbdefb")
    assert shape.label is not None
    assert shape.label.height == 6
    assert definitions.planes == ("P",)


def test_a_shape_of_nothing_is_a_note() -> None:
    definitions = read_text(diagram('<bpmndi:BPMNShape id="x" bpmnElement="gone"><dc:Bounds/></bpmndi:BPMNShape>'))
    assert notes_of(definitions) == ["the diagram shows 'gone': the file has no such element"]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ('<bpmndi:BPMNShape bpmnElement="t"/>', "no bounds"),
        ('<bpmndi:BPMNShape bpmnElement="t"><dc:Bounds x="left" y="1"/></bpmndi:BPMNShape>', "expected four numbers"),
        ('<bpmndi:BPMNShape bpmnElement="t"><dc:Bounds x="nan" y="1"/></bpmndi:BPMNShape>', "expected four numbers"),
        ('<bpmndi:BPMNEdge bpmnElement="t"><di:waypoint x="1" y="1"/></bpmndi:BPMNEdge>', "fewer than two way points"),
    ],
)
def test_what_cannot_be_drawn_is_left_out_with_a_warning(content: str, said: str) -> None:
    definitions = read_text(diagram(content))
    warnings = [(note.element, note.level) for note in definitions.notes if said in note.text]
    assert warnings == [("t", "warning")]
    assert definitions.shapes == definitions.edges == ()
