"""A stand of an airport as a mission: six robots in five pools bring an aircraft there, serve it, push it back."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

from bpmn_text import document

from fame.scenario import Scenario

LIBRARY = Path(__file__).parent.parent / "models" / "library"
POOLS = {
    "Tower": ["start", "work Clear the Taxiway 2", "throw park", "catch parked", "throw serve", "catch fuelled",
              "throw push_back", "end"],
    "Tug": ["on park", "go To the Stand 9 4", "throw parked", "catch push_back", "go Push Back 4 4", "end"],
    "Stairs": ["on serve", "go To the Door 8 5.5", "work Raise 2", "throw stairs_ready", "go Home 1 6", "end"],
    "Fueler": ["on stairs_ready", "go To the Wing 8 2.5", "work Fuel 4", "throw fuelled", "go Home 1 1", "end"],
    "Baggage": ["on serve", "side", "go To the Hold 6 side", "work Unload 3", "go Home 2 side", "end"],
}  # fmt: skip
"""The steps of each pool: what it waits for, does, and throws; `go` has a place (m), `work` a time (s). `side` is the
place of each of several robots."""
WIDE = ("go", "work", "side")
SIGNALS = sorted({step.split()[1] for steps in POOLS.values() for step in steps if step.startswith("throw")})
WORLD = """
model: airport.bpmn
library: [{library}]
world:
  size: [12, 7]
  obstacles:
    - {{name: aircraft, at: [10.5, 4], size: [1.5, 0.8]}}
  robots:
    Tug: {{type: car, at: [1, 4]}}
    Stairs: {{type: car, at: [1, 6]}}
    Fueler: {{type: car, at: [1, 1]}}
    Baggage_1: {{type: car, at: [2, 2]}}
    Baggage_2: {{type: car, at: [2, 5]}}
computers: [Tower]
seed: 1
"""


def airport(folder: Path, *, every: int = 0, duration: float = 120) -> Scenario:
    """The mission, written to a folder; with an aircraft `every` so many seconds, or one alone."""
    (folder / "airport.bpmn").write_text(model(every), encoding="utf-8")
    (folder / "airport.yaml").write_text(WORLD.format(library=LIBRARY), encoding="utf-8")
    return Scenario.load(folder / "airport.yaml", duration=duration)


def model(every: int) -> str:
    """The collaboration, drawn: a pool below the other."""
    pools, processes, shapes = [], [], []
    for number, (pool, steps) in enumerate(POOLS.items()):
        if every and steps[0] == "start":
            steps = [f"every {every}", *steps[1:]]
        several = '<participantMultiplicity minimum="2" maximum="2"/>' if pool == "Baggage" else ""
        pools.append(f'<participant id="{pool}" name="{pool}" processRef="P_{pool}">{several}</participant>')
        ids = [f"{pool}_{place}" for place in range(len(steps))]
        flows = [*pairwise(ids)]
        nodes = [node(id, step) for id, step in zip(ids, steps, strict=True)]
        nodes += [f'<sequenceFlow id="F_{one}" sourceRef="{one}" targetRef="{other}"/>' for one, other in flows]
        processes.append(f'<process id="P_{pool}" isExecutable="true">{"".join(nodes)}</process>')
        top = 180 * number
        shapes.append(shape(pool, 0, top, 60 + 140 * len(steps), 150, ' isHorizontal="true"'))
        for place, (id, step) in enumerate(zip(ids, steps, strict=True)):
            wide, high = (100, 80) if step.split()[0] in WIDE else (36, 36)
            shapes.append(shape(id, 110 + 140 * place - wide / 2, top + 75 - high / 2, wide, high))
        for place, (one, _) in enumerate(flows):
            points = "".join(
                f'<di:waypoint x="{110 + 140 * place + away}" y="{top + 75}"/>'
                for away in (edge(steps[place]), 140 - edge(steps[place + 1]))
            )
            shapes.append(f'<bpmndi:BPMNEdge id="E_{one}" bpmnElement="F_{one}">{points}</bpmndi:BPMNEdge>')
    signals = "".join(f'<signal id="Signal_{name}" name="{name}"/>' for name in SIGNALS)
    drawn = f'<bpmndi:BPMNPlane id="Plane" bpmnElement="C">{"".join(shapes)}</bpmndi:BPMNPlane>'
    return document(
        f'{signals}<collaboration id="C">{"".join(pools)}</collaboration>{"".join(processes)}'
        f'<bpmndi:BPMNDiagram id="D">{drawn}</bpmndi:BPMNDiagram>'
    )


def node(id: str, step: str) -> str:
    """The element of a step."""
    kind, _, what = step.partition(" ")
    signal = f'<signalEventDefinition signalRef="Signal_{what}"/>'
    match kind:
        case "start":
            return f'<startEvent id="{id}" name="begin"/>'
        case "every":
            cycle = f"<timerEventDefinition><timeCycle>R/PT{what}S</timeCycle></timerEventDefinition>"
            return f'<startEvent id="{id}" name="each {what} s">{cycle}</startEvent>'
        case "on":
            return f'<startEvent id="{id}" name="{what}">{signal}</startEvent>'
        case "throw":
            return f'<intermediateThrowEvent id="{id}" name="{what}">{signal}</intermediateThrowEvent>'
        case "catch":
            return f'<intermediateCatchEvent id="{id}" name="{what}">{signal}</intermediateCatchEvent>'
        case "work":
            name, _, seconds = what.rpartition(" ")
            script = f"<script>print('{name}'); await sleep({seconds})</script>"
            return f'<scriptTask id="{id}" name="{name}" scriptFormat="python">{script}</scriptTask>'
        case "side":
            script = "<script>side = 2 + 3 * robot.name.endswith('2')</script>"
            return f'<scriptTask id="{id}" name="Choose a Side" scriptFormat="python">{script}</scriptTask>'
        case "go":
            name, x, y = what.rsplit(" ", 2)
            given = f'<camunda:in sourceExpression="{x}" target="x_goal"/>'
            given += f'<camunda:in {"source" if y == "side" else "sourceExpression"}="{y}" target="y_goal"/>'
            inside = f"<extensionElements>{given}</extensionElements>"
            return f'<callActivity id="{id}" name="{name}" calledElement="GoTo">{inside}</callActivity>'
    return f'<endEvent id="{id}" name="done"/>'


def shape(id: str, x: float, y: float, wide: float, high: float, attributes: str = "") -> str:
    """Where an element is drawn."""
    bounds = f'<dc:Bounds x="{x}" y="{y}" width="{wide}" height="{high}"/>'
    return f'<bpmndi:BPMNShape id="S_{id}" bpmnElement="{id}"{attributes}>{bounds}</bpmndi:BPMNShape>'


def edge(step: str) -> int:
    """How far the side of a shape is from its middle."""
    return 50 if step.split()[0] in WIDE else 18
