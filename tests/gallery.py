"""A file that has everything FAME knows, drawn in rows: for the tests of writing and drawing."""

from __future__ import annotations

from dataclasses import dataclass, field

from bpmn_text import document

_INSIDE = {"timer": "<timeDuration>PT1S</timeDuration>", "conditional": "<condition>x &gt; 1</condition>"}
_PLACES = {
    "startEvent": ["", "message", "timer", "conditional", "signal"],
    "intermediateCatchEvent": ["message", "timer", "conditional", "signal", "link"],
    "intermediateThrowEvent": ["", "message", "signal", "escalation", "compensate", "link"],
    "endEvent": ["", "message", "signal", "error", "escalation", "compensate", "cancel", "terminate"],
}
_TASKS = ["task", "userTask", "manualTask", "scriptTask", "serviceTask", "sendTask", "receiveTask", "businessRuleTask"]
_GATEWAYS = ["exclusiveGateway", "parallelGateway", "inclusiveGateway", "eventBasedGateway", "complexGateway"]
_MULTI = "multiInstanceLoopCharacteristics"
_LOOPS = [
    "<standardLoopCharacteristics/>",
    f"<{_MULTI}><loopCardinality>3</loopCardinality></{_MULTI}>",
    f'<{_MULTI} isSequential="true"><loopCardinality>3</loopCardinality></{_MULTI}>',
]
_POOLS = """
<collaboration id="C">
  <participant id="Pool" name="DRONE &amp; co" processRef="P"><participantMultiplicity/></participant>
  <participant id="Box" name="black box"/>
  <messageFlow id="M1" name="order" sourceRef="Box" targetRef="task"/>
</collaboration>"""


@dataclass
class _Drawing:
    """A process being drawn."""

    elements: list[str] = field(default_factory=list)
    shapes: list[str] = field(default_factory=list)

    def put(self, xml: str, box: tuple[int, int, int, int], attributes: str = "") -> None:
        """An element, drawn at x, y with width and height. Its id is the first in `xml`."""
        self.elements.append(xml)
        self.show(xml.partition('id="')[2].partition('"')[0], box, attributes)

    def show(self, id: str, box: tuple[int, int, int, int], attributes: str = "") -> None:
        """Only its shape."""
        bounds = '<dc:Bounds x="{}" y="{}" width="{}" height="{}"/>'.format(*box)
        shape = f'<bpmndi:BPMNShape id="{id}_di" bpmnElement="{id}" {attributes}>{bounds}</bpmndi:BPMNShape>'
        self.shapes.append(shape)

    def line(self, id: str, *points: tuple[int, int]) -> None:
        """An edge."""
        way = "".join(f'<di:waypoint x="{x}" y="{y}"/>' for x, y in points)
        self.shapes.append(f'<bpmndi:BPMNEdge id="{id}_di" bpmnElement="{id}">{way}</bpmndi:BPMNEdge>')


def definition(kind: str) -> str:
    """An event definition."""
    attributes = {"signal": 'signalRef="Signal_1"', "link": 'name="jump"'}.get(kind, "")
    return f"<{kind}EventDefinition {attributes}>{_INSIDE.get(kind, '')}</{kind}EventDefinition>" if kind else ""


def gallery() -> str:
    """The file: a pool with everything, a black box, a sub-process with a diagram of its own."""
    drawing = _Drawing()
    wide = 'isHorizontal="true"'
    drawing.show("Pool", (130, 80, 1200, 740), wide)
    drawing.show("Lane", (160, 80, 1170, 740), wide)
    drawing.show("Box", (130, 860, 1200, 60), wide)
    _events(drawing)
    _activities(drawing)
    _others(drawing)
    _edges(drawing)
    lanes = '<laneSet id="LaneSet"><lane id="Lane" name="lane"/></laneSet>'
    hidden = _Drawing()
    hidden.show("hidden", (0, 0, 100, 80))
    return document(
        f'{_POOLS}<process id="P">{lanes}{"".join(drawing.elements)}</process><signal id="Signal_1" name="weed_found"/>'
        f'<bpmndi:BPMNDiagram id="D1"><bpmndi:BPMNPlane id="Plane1" bpmnElement="C">{"".join(drawing.shapes)}'
        '</bpmndi:BPMNPlane></bpmndi:BPMNDiagram><bpmndi:BPMNDiagram id="D2"><bpmndi:BPMNPlane id="Plane2" '
        f'bpmnElement="elsewhere">{"".join(hidden.shapes)}</bpmndi:BPMNPlane></bpmndi:BPMNDiagram>'
    )


def _events(drawing: _Drawing) -> None:
    for row, (tag, kinds) in enumerate(_PLACES.items()):
        for column, kind in enumerate(kinds):
            name = kind or "none"
            xml = f'<{tag} id="{tag}_{name}" name="{name}">{definition(kind)}</{tag}>'
            drawing.put(xml, (220 + 80 * column, 100 + 80 * row, 36, 36))
    both = definition("signal") + definition("message")
    drawing.put(f'<startEvent id="multiple" name="multiple">{both}</startEvent>', (620, 100, 36, 36))
    all_of = f'<intermediateCatchEvent id="all" name="all" parallelMultiple="true">{both}</intermediateCatchEvent>'
    drawing.put(all_of, (620, 180, 36, 36))


def _activities(drawing: _Drawing) -> None:
    for column, tag in enumerate(_TASKS):
        drawing.put(f'<{tag} id="{tag}" name="{tag} &lt;1&gt;"/>', (220 + 130 * column, 420, 100, 80))
    for column, loop in enumerate(_LOOPS):
        xml = f'<task id="loop_{column}" name="a name that is so long that it needs lines">{loop}</task>'
        drawing.put(xml, (220 + 130 * column, 540, 100, 80))
    drawing.put('<callActivity id="call" name="call" calledElement="P"/>', (610, 540, 100, 80))
    drawing.put('<task id="handler" name="handler" isForCompensation="true"/>', (740, 540, 100, 80))
    drawing.put('<subProcess id="collapsed" name="collapsed"/>', (870, 540, 100, 80))
    drawing.put('<transaction id="transaction" name="transaction"/>', (1000, 540, 160, 80), 'isExpanded="true"')
    drawing.put('<adHocSubProcess id="adhoc" name="ad hoc"/>', (1180, 540, 100, 80))
    inner = f'<startEvent id="inner" isInterrupting="false">{definition("signal")}</startEvent>'
    handler = f'<subProcess id="on_signal" name="on signal" triggeredByEvent="true">{inner}</subProcess>'
    drawing.put(handler, (720, 660, 200, 120), 'isExpanded="true"')
    drawing.show("inner", (750, 700, 36, 36))
    for column, (kind, cancels) in enumerate((("timer", "false"), ("error", "true"))):
        attached = f'attachedToRef="{_TASKS[column]}" cancelActivity="{cancels}"'
        xml = f'<boundaryEvent id="on_{kind}" {attached}>{definition(kind)}</boundaryEvent>'
        drawing.put(xml, (280 + 130 * column, 482, 36, 36))
    drawing.elements.append('<subProcess id="elsewhere" name="Drawn elsewhere"><task id="hidden"/></subProcess>')


def _others(drawing: _Drawing) -> None:
    for column, tag in enumerate(_GATEWAYS):
        box = (220 + 90 * column, 660, 50, 50)
        drawing.put(f'<{tag} id="{tag}" name="which?"/>', box, 'isMarkerVisible="true"')
    data = '<dataObjectReference id="data" name="weed position" dataObjectRef="DataObject"/>'
    drawing.put(data, (960, 660, 36, 50))
    drawing.elements.append('<dataObject id="DataObject" isCollection="true"/>')
    drawing.put('<dataStoreReference id="store" name="store"/>', (1040, 660, 50, 50))
    note = '<textAnnotation id="note"><text>a text annotation &amp; more</text></textAnnotation>'
    drawing.put(note, (1140, 660, 120, 50))
    drawing.put('<group id="group"/>', (940, 640, 170, 130))


def _edges(drawing: _Drawing) -> None:
    condition = "<conditionExpression>x &gt; 1</conditionExpression>"
    first = f'<sequenceFlow id="F1" name="if so" sourceRef="task" targetRef="userTask">{condition}</sequenceFlow>'
    drawing.elements.append(first)
    drawing.elements.append('<sequenceFlow id="F2" sourceRef="userTask" targetRef="manualTask"/>')
    drawing.elements.append('<association id="A1" sourceRef="businessRuleTask" targetRef="note"/>')
    drawing.line("F1", (320, 460), (350, 460))
    drawing.line("F2", (450, 460), (480, 460))
    drawing.line("A1", (1180, 500), (1180, 660))
    drawing.line("M1", (240, 860), (240, 500))
