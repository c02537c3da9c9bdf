"""Models without a diagram are laid out: nothing overlaps, no flow goes through a shape, the file stays as it is."""

from __future__ import annotations

import json
import os
import re
import runpy
import subprocess
from collections.abc import Iterator
from itertools import combinations, pairwise
from pathlib import Path
from random import Random

import pytest
from bpmn_text import document, process
from collaborations import text_of, varied
from drawn_models import FEATURES, drawn_model
from lxml import etree

import fame
from fame.bpmn import read_bytes, read_text
from fame.bpmn.draw.svg import crosses, overlap
from fame.bpmn.model import Bounds, Definitions, Shape
from fame.bpmn.reader.document import read_tree
from fame.bpmn.reader.xml import BPMN, BPMNDI, parse
from fame.cli import main
from fame.dataclasses import replace
from fame.errors import ModelError
from fame.layout import add_diagram, lay_out
from fame.testing.coverage import Coverage, html_report
from fame.view.catalogue import Catalogue

ROOT = Path(__file__).parent.parent
LAYOUTS = runpy.run_path(str(ROOT / "docs" / "layouts.py"))
PICTURES, picture = LAYOUTS["PICTURES"], LAYOUTS["picture"]
SHIPPED = sorted({*ROOT.glob("models/**/*.bpmn"), *ROOT.glob("examples/**/*.bpmn")})
OTHERS = sorted(path for path in (ROOT / "tests" / "other_tools").iterdir() if path.suffix in (".bpmn", ".xml"))
READABLE = [path for path in OTHERS if path.stem not in ("beta", "xpdl", "choreography")]
"""Those with processes of BPMN 2.0."""
BODIES = ("subProcess", "transaction", "adHocSubProcess")
FRAMES = (*BODIES, "participant", "lane")


def without_diagram(source: bytes) -> bytes:
    """The file without its drawings."""
    root = etree.fromstring(source)
    for diagram in root.findall(f"{{{BPMNDI}}}BPMNDiagram"):
        root.remove(diagram)
    return etree.tostring(root)


class Measured:
    """Where the elements of a drawn model are: what is in what, by id."""

    def __init__(self, model: Definitions) -> None:
        self.model = model
        self.root = parse(model.source, model.file)
        read_tree(self.root, model.source, model.file)  # gives ids to elements without one
        self.elements = {str(one.get("id")): one for one in self.root.iter(f"{{{BPMN}}}*")}
        self.shapes = {shape.element: shape for shape in model.shapes}
        self.parents = dict(self._parents())

    def _parents(self) -> Iterator[tuple[str, str]]:
        pools = {one.process: one.id for one in reversed(self.model.participants)}
        for element in self.root.iter(f"{{{BPMN}}}*"):
            around = element.getparent()
            if element.get("id") in self.shapes and around is not None:
                home = str(around.get("id"))
                yield str(element.get("id")), pools.get(home, home)

    def around(self, id: str) -> list[str]:
        """What an element is in, the innermost first."""
        found = []
        while id := self.parents.get(id, ""):
            found.append(id)
        return found

    def host(self, id: str) -> str:
        """The activity that a boundary event is attached to."""
        reference = self.elements[id].get("attachedToRef", "")
        return reference if reference in self.shapes else reference.rpartition(":")[2]

    def solid(self) -> list[Shape]:
        """The shapes that nothing is drawn in."""
        return [one for one in self.model.shapes if one.kind not in FRAMES or (not one.expanded and one.kind in BODIES)]


def holds(outer: Bounds, inner: Bounds) -> bool:
    ends = inner.x + inner.width <= outer.x + outer.width and inner.y + inner.height <= outer.y + outer.height
    return outer.x <= inner.x and outer.y <= inner.y and ends


def smaller(box: Bounds, by: float = 1.0) -> Bounds:
    return Bounds(box.x + by, box.y + by, max(box.width - 2 * by, 0.1), max(box.height - 2 * by, 0.1))


def defects(model: Definitions) -> list[str]:
    """Everything that is wrong with a drawing."""
    found = []
    for plane in range(len(model.planes)):
        one = on_plane(model, plane)
        found += [*_overlaps(one), *_outside(one), *_through(one), *_loose_ends(one)]
    return found


def on_plane(model: Definitions, plane: int) -> Measured:
    """One diagram of a file."""
    shapes = tuple(one for one in model.shapes if one.plane == plane)
    edges = tuple(one for one in model.edges if one.plane == plane)
    return Measured(replace(model, shapes=shapes, edges=edges))


def _overlaps(seen: Measured) -> Iterator[str]:
    """Shapes and labels that cover each other."""
    solid = seen.solid()
    frames = [one for one in seen.model.shapes if one.kind in FRAMES and one not in solid]
    boxes = [(one.element, one.bounds) for one in solid]
    labels = [(f"label of {one.element}", one.label) for one in (*seen.model.shapes, *seen.model.edges) if one.label]
    for (a, box), (b, other) in combinations([*boxes, *labels], 2):
        attached = seen.host(a) == b or seen.host(b) == a if a in seen.shapes and b in seen.shapes else False
        if overlap(smaller(box, 0.1), other) and not attached:
            yield f"{a} on {b}"
    for a, b in combinations(frames, 2):
        if overlap(smaller(a.bounds), b.bounds) and not (holds(a.bounds, b.bounds) or holds(b.bounds, a.bounds)):
            yield f"{a.element} on {b.element}"
    for a in frames:
        for b, box in boxes:
            inside = a.element in seen.around(b) or a.kind == "lane" or seen.shapes[b].kind == "textAnnotation"
            if overlap(smaller(box), a.bounds) and not inside and seen.host(b) != a.element:
                yield f"{b} in {a.element}"


def _outside(seen: Measured) -> Iterator[str]:
    """What is not inside of its parent, boundary events that are not on the border of their host."""
    lanes = {str(ref.text).strip(): str(ref.getparent().get("id")) for ref in seen.root.iter(f"{{{BPMN}}}flowNodeRef")}
    for shape in seen.model.shapes:
        parents = [*seen.around(shape.element)[:1], lanes.get(shape.element, "")]
        for parent in [seen.shapes[one] for one in parents if one in seen.shapes]:
            for box in (shape.bounds, shape.label) if shape.kind != "participant" else ():
                if box is not None and not holds(parent.bounds, box):
                    yield f"{shape.element} outside of {parent.element}"
        if shape.kind == "boundaryEvent" and (host := seen.shapes.get(seen.host(shape.element))) is not None:
            middle = shape.bounds.y + shape.bounds.height / 2
            if abs(middle - host.bounds.y - host.bounds.height) > 0.5 or not (
                host.bounds.x <= shape.bounds.x and shape.bounds.x + 36 <= host.bounds.x + host.bounds.width
            ):
                yield f"{shape.element} not on the border of {host.element}"


def _through(seen: Measured) -> Iterator[str]:
    """Flows that go through a shape or label."""
    labels = [(f"label of {one.element}", one.label) for one in (*seen.model.shapes, *seen.model.edges) if one.label]
    for edge in seen.model.edges:
        link = seen.elements[edge.element]
        own = {str(link.get(name)) for name in ("sourceRef", "targetRef")}
        own |= {one.rpartition(":")[2] for one in own}
        if edge.kind.startswith("data"):
            own.add(next(str(one.get("id")) for one in link.iterancestors() if one.get("id") in seen.shapes))
        inside = own | {outer for end in own for outer in seen.around(end)}
        for shape in seen.model.shapes:
            skip = shape.kind in ("participant", "lane") or shape.element in inside - own
            box = smaller(shape.bounds, 2)
            if not skip and any(crosses(box, *line) for line in pairwise(edge.waypoints)):
                yield f"{edge.element} through {shape.element}"
        for name, label in labels:
            if any(crosses(smaller(label), *line) for line in pairwise(edge.waypoints)):
                yield f"{edge.element} through {name}"


def _loose_ends(seen: Measured) -> Iterator[str]:
    """Flows that do not begin and end at a border, and those that are not drawn at right angles."""
    for edge in seen.model.edges:
        if edge.kind in ("sequenceFlow", "messageFlow") and any(
            a[0] != b[0] and a[1] != b[1] for a, b in pairwise(edge.waypoints)
        ):
            yield f"{edge.element} is slanted"


@pytest.mark.long_but("cookbook/*", "other_tools/*", "models/[c-s]*")
@pytest.mark.parametrize("path", [*SHIPPED, *READABLE], ids=lambda path: f"{path.parent.name}/{path.stem}")
def test_a_model_without_a_diagram_is_laid_out_without_overlaps(path: Path) -> None:
    source = without_diagram(fame.read(path).source)
    assert defects(lay_out(read_bytes(source, file=path.name))) == []


GENERATED = 50


@pytest.mark.long_but("0", "1", "2")
@pytest.mark.parametrize("seed", range(GENERATED))
def test_a_generated_collaboration_is_laid_out_without_overlaps(seed: int) -> None:
    robots, options = varied(seed)
    assert defects(lay_out(read_text(text_of(robots, **options)))) == []


@pytest.mark.long_but("0", "1")
@pytest.mark.parametrize("seed", range(30))
def test_a_model_that_cannot_be_executed_is_laid_out_without_overlaps(seed: int) -> None:
    random = Random(seed)
    source = drawn_model(random.sample(list(FEATURES), random.randint(2, 9)), random)
    assert defects(lay_out(read_bytes(source), again=True)) == []


def test_the_measure_sees_what_is_wrong() -> None:
    model = lay_out(fame.read(ROOT / "models" / "convoy.bpmn"), again=True)
    by_id = {shape.element: shape.bounds for shape in model.shapes}
    task, host = by_id["Activity_TakeLane"], by_id["Activity_Barrier"]

    def moved(id: str, bounds: Bounds) -> list[str]:
        changed = tuple(replace(one, bounds=bounds) if one.element == id else one for one in model.shapes)
        return defects(replace(model, shapes=changed))

    assert "Activity_TakeLane on Activity_ToLine" in moved("Activity_ToLine", task)
    assert "Activity_ToLine in Activity_Barrier" in moved("Activity_ToLine", host)
    assert "Flow_TakeLane_ToLine through Event_There" in moved("Event_There", Bounds(task.x + 110, task.y, 36, 80))
    assert "Event_There outside of Participant_Car" in moved("Event_There", Bounds(0, 0, 36, 36))
    late = by_id["Event_Late"]
    assert "Event_Late not on the border of Activity_Barrier" in moved("Event_Late", replace(late, y=late.y - 9))
    bent = tuple(replace(one, waypoints=((0.0, 0.0), (9.0, 9.0))) for one in model.edges)
    assert "Flow_TakeLane_ToLine is slanted" in defects(replace(model, edges=bent))


# ---- how it looks ----------------------------------------------------------------------------------------------------


def middles(model: Definitions) -> dict[str, tuple[float, float]]:
    """The middle of each shape, by id."""
    boxes = [(shape.element, shape.bounds) for shape in model.shapes]
    return {id: (box.x + box.width / 2, box.y + box.height / 2) for id, box in boxes}


def flow(source: str, target: str) -> str:
    return f'<sequenceFlow id="{source}_{target}" sourceRef="{source}" targetRef="{target}"/>'


def test_the_main_path_is_straight_and_a_short_branch_runs_below_it() -> None:
    nodes = '<startEvent id="s"/><exclusiveGateway id="g"/><task id="a"/><task id="b"/><task id="c"/><endEvent id="e"/>'
    flows = flow("s", "g") + flow("g", "c") + flow("g", "a") + flow("a", "b") + flow("b", "e") + flow("c", "e")
    model = lay_out(read_text(process(nodes + flows)))
    at = middles(model)
    assert len({at[id][1] for id in "sgabe"}) == 1
    assert at["c"][1] == at["a"][1] + 110
    assert [at[id][0] for id in "sgabe"] == sorted(at[id][0] for id in "sgabe")
    bends = {edge.element: len(edge.waypoints) - 2 for edge in model.edges}
    assert bends == {"s_g": 0, "g_a": 0, "a_b": 0, "b_e": 0, "g_c": 1, "c_e": 2}


def test_the_way_out_of_a_boundary_event_does_not_move_the_main_path() -> None:
    nodes = '<startEvent id="s"/><task id="t"/><task id="h"/><task id="i"/><task id="j"/><endEvent id="e"/>'
    event = '<boundaryEvent id="b" attachedToRef="t"><timerEventDefinition/></boundaryEvent>'
    flows = [flow("s", "t"), flow("t", "e"), flow("b", "h"), flow("h", "i"), flow("i", "j"), flow("j", "e")]
    at = middles(lay_out(read_text(process(nodes + event + "".join(flows)))))
    assert at["s"][1] == at["t"][1] == at["e"][1] < at["h"][1] == at["i"][1] == at["j"][1]


def test_pools_with_messages_are_neighbours_and_labels_make_room_for_them() -> None:
    pools = "".join(f'<participant id="{name}" name="{name}" processRef="P{name}"/>' for name in "ABC")
    ends = '<messageFlow id="m" sourceRef="sC" targetRef="tA"/>'
    processes = "".join(
        f'<process id="P{name}"><endEvent id="s{name}" name="send"><messageEventDefinition/></endEvent>'
        f'<startEvent id="t{name}" name="take"><messageEventDefinition/></startEvent></process>'
        for name in "ABC"
    )
    model = lay_out(read_text(document(f'<collaboration id="K">{pools}{ends}</collaboration>{processes}')))
    assert defects(model) == []
    at = middles(model)
    order = sorted("ABC", key=lambda pool: at[pool][1])
    assert abs(order.index("A") - order.index("C")) == 1
    labels = {shape.element: shape.label for shape in model.shapes}
    upper, lower = ("tA", "sC") if at["A"][1] < at["C"][1] else ("sC", "tA")
    assert labels[upper] is not None
    assert labels[lower] is not None
    assert labels[upper].y < at[upper][1]  # the message leaves below
    assert labels[lower].y > at[lower][1]


def test_a_note_about_a_flow_is_linked_to_the_flow() -> None:
    note = '<textAnnotation id="n"><text>slow</text></textAnnotation>'
    link = '<association id="l" sourceRef="n" targetRef="s_t"/>'
    model = lay_out(read_text(process('<startEvent id="s"/><task id="t"/>' + flow("s", "t") + note + link)))
    assert defects(model) == []
    edges = {edge.element: edge.waypoints for edge in model.edges}
    (start, y), (end, _) = edges["s_t"]
    x, height = edges["l"][-1]
    assert start < x < end
    assert height == y


def test_nodes_are_in_their_lanes_at_any_depth() -> None:
    lanes = (
        '<laneSet id="L"><lane id="l1"><flowNodeRef>a</flowNodeRef></lane><lane id="l2"><childLaneSet id="M">'
        '<lane id="l3"><flowNodeRef>b</flowNodeRef></lane><lane id="l4"><flowNodeRef>c</flowNodeRef></lane>'
        "</childLaneSet></lane></laneSet>"
    )
    nodes = '<task id="a"/><task id="b"/><task id="c"/>' + flow("c", "b") + flow("b", "a")
    pool = '<collaboration id="C"><participant id="p" processRef="P"/></collaboration>'
    model = lay_out(read_text(document(f'{pool}<process id="P">{lanes}{nodes}</process>')))
    assert defects(model) == []
    boxes = {shape.element: shape.bounds for shape in model.shapes}
    assert all(holds(boxes[lane], boxes[node]) for lane, node in (("l1", "a"), ("l3", "b"), ("l4", "c"), ("l2", "b")))
    assert boxes["l1"].y + boxes["l1"].height == boxes["l2"].y == boxes["l3"].y
    assert boxes["l1"].x == boxes["l2"].x == boxes["p"].x + 30 == boxes["l3"].x - 30


@pytest.mark.long_but("compensation")
@pytest.mark.parametrize("name", PICTURES)
def test_a_picture_of_the_documentation_is_that_of_the_layout(name: str) -> None:
    kept = ROOT / "docs" / "images" / f"layout_{name}.svg"
    assert kept.read_text(encoding="utf-8") == picture(name), "python docs/layouts.py draws it"


# ---- diagrams that lack something ------------------------------------------------------------------------------------


def lacking(source: bytes, random: Random) -> tuple[bytes, set[str]]:
    """A file without the shapes of up to three elements, with all that is in them or leads to them; their ids."""
    root = etree.fromstring(source)
    elements = {str(one.get("id")): one for one in root.iter(f"{{{BPMN}}}*")}
    shapes = [str(one.get("bpmnElement")) for one in root.iter(f"{{{BPMNDI}}}BPMNShape")]
    gone: set[str] = set()
    for id in random.sample(shapes, min(len(shapes), random.randint(1, 3))):
        whole = elements.get(elements[id].get("processRef", ""), elements[id])
        gone |= {id, *(str(one.get("id")) for one in whole.iter(f"{{{BPMN}}}*"))}
    for one in list(root.iter(f"{{{BPMNDI}}}BPMNShape", f"{{{BPMNDI}}}BPMNEdge")):
        shown, around = elements[str(one.get("bpmnElement"))], one.getparent()
        ends = {shown.get("id"), shown.get("sourceRef"), shown.get("targetRef"), shown.get("attachedToRef")}
        ends |= {inner.text for inner in shown} | {shown.getparent().get("id")}  # type: ignore[union-attr]
        if around is not None and ends & gone:
            around.remove(one)
    return etree.tostring(root), gone


@pytest.mark.long_but("*-0")
@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("path", sorted((ROOT / "models").glob("*.bpmn")), ids=lambda path: path.stem)
def test_what_has_a_place_keeps_it_and_what_has_none_is_placed_where_there_is_room(path: Path, seed: int) -> None:
    source, gone = lacking(path.read_bytes(), Random(seed))
    old = read_bytes(source, file=path.name)
    new = read_bytes(add_diagram(old), file=path.name)
    there = {shape.element: shape for shape in new.shapes}
    frames = {shape.element for shape in old.shapes if shape.kind in FRAMES}
    assert [one for one in old.shapes if there[one.element] != one and one.element not in frames] == []
    assert set(old.edges) <= set(new.edges)
    drawn = {one.element for one in (*fame.read(path).shapes, *fame.read(path).edges)}
    assert drawn - {one.element for one in (*new.shapes, *new.edges)} == set()
    assert gone
    assert set(defects(new)) - set(defects(old) if old.shapes else ()) == set()


def drawn(content: str, **shapes: tuple[int, int, int, int]) -> Definitions:
    """A process with shapes: id -> x, y, width, height; a sub-process is open if it has more than 110 px."""
    parts = "".join(
        f'<bpmndi:BPMNShape id="{id}_di" bpmnElement="{id}" isExpanded="{str(width > 110).lower()}">'
        f'<dc:Bounds x="{x}" y="{y}" width="{width}" height="{height}"/></bpmndi:BPMNShape>'
        for id, (x, y, width, height) in shapes.items()
    )
    plane = f'<bpmndi:BPMNPlane id="p" bpmnElement="P">{parts}</bpmndi:BPMNPlane>'
    return read_text(document(f'<process id="P">{content}</process><bpmndi:BPMNDiagram>{plane}</bpmndi:BPMNDiagram>'))


def test_lanes_that_are_not_drawn_divide_their_pool_around_what_is_drawn() -> None:
    sets = "".join(f'<lane id="l{one}"><flowNodeRef>{one}</flowNodeRef></lane>' for one in "abc")
    nodes = '<task id="a"/><task id="b"/><task id="c"/>' + flow("a", "b") + flow("b", "c")
    pool = '<collaboration id="P"><participant id="p" processRef="Q"/></collaboration>'
    old = drawn("", p=(100, 100, 600, 420), a=(200, 110, 100, 80), b=(200, 210, 100, 80)).source.decode()
    old = old.replace('<process id="P"></process>', f'{pool}<process id="Q"><laneSet>{sets}</laneSet>{nodes}</process>')
    new = read_bytes(add_diagram(read_text(old)))
    boxes = {one.element: one.bounds for one in new.shapes}
    assert boxes["p"] == Bounds(100, 100, 600, 420)
    assert [(boxes[lane].y, boxes[lane].height) for lane in ("la", "lb", "lc")] == [(100, 110), (210, 170), (380, 140)]
    assert all(holds(boxes[f"l{one}"], boxes[one]) for one in "abc")
    assert defects(new) == []


@pytest.mark.parametrize("ends", ["/>", " />", "></dc:Bounds>", "> </dc:Bounds >"])
def test_a_frame_without_room_grows(ends: str) -> None:
    content = f'<subProcess id="u"><task id="t"/><task id="new"/>{flow("t", "new")}</subProcess>'
    old = drawn(content, u=(100, 100, 160, 120), t=(130, 120, 100, 80)).source.decode()
    old = old.replace('"/></bpmndi:BPMNShape>', f'"{ends}</bpmndi:BPMNShape>')
    new = read_bytes(add_diagram(read_text(old)))
    assert defects(new) == []
    boxes = {one.element: one.bounds for one in new.shapes}
    assert boxes["t"] == Bounds(130, 120, 100, 80)
    assert (boxes["u"].x, boxes["u"].y) == (100, 100)


def test_what_a_collapsed_sub_process_has_inside_gets_a_plane_of_its_own() -> None:
    new = read_bytes(add_diagram(drawn('<subProcess id="u"><task id="t"/></subProcess>', u=(100, 100, 100, 80))))
    assert new.planes == ("P", "u")
    assert [(one.element, one.plane) for one in new.shapes] == [("u", 0), ("t", 1)]


# ---- the file --------------------------------------------------------------------------------------------------------

BEFORE = f"""<?xml version="1.0" encoding="{{}}"?>\r
<!-- kept --><d:definitions xmlns:d="{BPMN}" xmlns:dc="http://elsewhere" xmlns:my="http://mine" my:note="Ä">
  <d:process id="P"><d:startEvent id="s" name="Größe"/><d:sequenceFlow sourceRef="s" targetRef="t"/>
    <d:task id="t" ><my:thing>  <![CDATA[<&]]></my:thing></d:task></d:process>
</d:definitions >
<!-- kept, too -->"""


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16", "iso-8859-1", "us-ascii"])
def test_only_the_diagram_is_added_to_the_file(encoding: str) -> None:
    source = BEFORE.format(encoding).encode(encoding, "xmlcharrefreplace")
    text = add_diagram(read_bytes(source)).decode(encoding)
    start, end = text.index("\n  <bpmndi:BPMNDiagram "), text.index("</bpmndi:BPMNDiagram>") + 21
    without = text[:start].removesuffix("\r") + text[end:]
    assert without.replace(' id="sequenceFlow_3"', "", 1).encode(encoding) == source
    laid_out = read_bytes(text.encode(encoding))
    assert [shape.element for shape in laid_out.shapes] == ["s", "t"]
    assert [edge.element for edge in laid_out.edges] == ["sequenceFlow_3"]


def test_a_complete_file_stays_as_it_is() -> None:
    model = fame.read(ROOT / "models" / "agriculture.bpmn")
    assert add_diagram(model) == model.source


def test_everything_is_laid_out_again_if_asked_to() -> None:
    model = fame.read(ROOT / "models" / "convoy.bpmn")
    again = read_bytes(add_diagram(model, again=True), file=model.file)
    assert again.shapes == lay_out(read_bytes(without_diagram(model.source))).shapes != model.shapes
    assert again.processes == model.processes


def test_colours_labels_and_ids_of_a_diagram_stay_when_it_is_laid_out_again() -> None:
    named = 'xmlns:color="urn:colour" id="D" name="Plan"'
    old = drawn(
        '<task id="t"/><startEvent id="s" name="go"/>' + flow("s", "t"), t=(500, 500, 100, 80), s=(1, 1, 36, 36)
    )
    text = old.source.decode().replace("<bpmndi:BPMNDiagram>", f"<bpmndi:BPMNDiagram {named}><!-- why -->")
    text = text.replace('bpmnElement="t"', 'bpmnElement="t" color:fill="#f00"').replace(' id="p"', ' id="Pl"')
    text = text.replace('height="36"/>', 'height="36"/><bpmndi:BPMNLabel labelStyle="L"/>')
    new = add_diagram(read_text(text), again=True).decode()
    assert text.partition("<bpmndi:BPMNShape")[0].rstrip() == new.partition("<bpmndi:BPMNShape")[0].rstrip()
    (task,) = re.findall('<bpmndi:BPMNShape[^>]*bpmnElement="t"[^>]*>', new)
    assert 'color:fill="#f00"' in task
    assert re.findall("<bpmndi:BPMNLabel[^>]*>", new) == ['<bpmndi:BPMNLabel labelStyle="L">']
    assert read_text(new).shapes == lay_out(read_bytes(without_diagram(old.source))).shapes


READ = """
const { BpmnModdle } = require("bpmn-moddle"), fs = require("fs");
Promise.all(process.argv.slice(1).map(async (file) => {
    const { warnings } = await new BpmnModdle().fromXML(fs.readFileSync(file, "utf8"));
    return [file, warnings.map((one) => one.message.replace(/\\s+(line|column): \\d+/g, ""))];
})).then((all) => console.log(JSON.stringify(Object.fromEntries(all))));
"""


def test_bpmn_moddle_opens_a_laid_out_file_without_warnings(node_modules: Path, tmp_path: Path) -> None:
    """None more than of the file before, unless it has ids that bpmn-moddle refuses."""
    sources = [fame.read(path).source for path in [*SHIPPED, *READABLE]]
    sources += [text_of(robots, **options).encode() for robots, options in map(varied, range(GENERATED))]
    names = []
    for number, source in enumerate(sources):
        text = etree.tostring(etree.fromstring(source), encoding="UTF-8")  # bpmn-moddle reads no other
        for name, content in (("old", without_diagram(text)), ("new", add_diagram(read_bytes(without_diagram(text))))):
            names.append(f"{number}_{name}.bpmn")
            (tmp_path / names[-1]).write_bytes(content)
    environment = {**os.environ, "NODE_PATH": str(node_modules)}
    done = subprocess.run(
        ["node", "-e", READ, *names], cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
    )
    said = json.loads(done.stdout)
    refused = [number for number in range(len(sources)) if "illegal ID" in str(said[f"{number}_old.bpmn"])]
    assert len(refused) == 6
    numbers = [number for number in range(len(sources)) if number not in refused]
    assert [number for number in numbers if said[f"{number}_new.bpmn"] != said[f"{number}_old.bpmn"]] == []
    assert sum(not said[f"{number}_new.bpmn"] for number in numbers) > 100


def test_the_same_file_gives_the_same_diagram() -> None:
    model = fame.read(ROOT / "models" / "sabotage.bpmn")
    assert add_diagram(model, again=True) == add_diagram(model, again=True)


def test_the_command_adds_a_diagram(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    old, new = tmp_path / "old.bpmn", tmp_path / "new.bpmn"
    old.write_text(process('<startEvent id="s"/>'), encoding="utf-8")
    assert main(["layout", str(old), "-o", str(new)]) == 0
    assert capsys.readouterr().out == f"{new}\n"
    assert [shape.kind for shape in fame.read(new).shapes] == ["startEvent"]
    assert main(["layout", str(old), "-o", str(tmp_path / "new.svg")]) == 2
    assert "expected a file with the ending .bpmn or .xml, got '.svg'" in capsys.readouterr().err
    old.write_text(process(""), encoding="utf-8")
    assert main(["layout", str(old), "-o", str(new)]) == 2
    error = f"fame: error: {old}: expected a pool, or a process with a flow node to draw\n"
    assert capsys.readouterr().err == error


def test_more_elements_than_anybody_reads_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fame.layout._MOST", 2)
    with pytest.raises(ModelError, match="expected at most 2 elements to lay out, got 3"):
        lay_out(read_text(process('<startEvent id="s"/><task id="t"/>')))


def test_the_page_and_the_report_of_coverage_show_a_model_without_a_diagram() -> None:
    model = read_text(process('<startEvent id="s"/><task id="t"/>' + flow("s", "t")))
    (drawing,) = Catalogue([model]).drawings
    assert drawing.boxes.keys() == {"s", "t"}
    assert drawing.lines.keys() == {"s_t"}
    report = html_report(Coverage(_files={"m.bpmn": model}, _processes={("m.bpmn", model.processes[0].id): None}))
    assert '<g id="s_t">' in report
    assert "has no diagram" not in report


def test_parts_of_a_split_file_get_a_diagram(tmp_path: Path) -> None:
    file = tmp_path / "team.bpmn"
    file.write_bytes(without_diagram((ROOT / "examples" / "cookbook" / "orders" / "mission.bpmn").read_bytes()))
    assert main(["split", str(file), "-o", str(tmp_path / "parts")]) == 0
    for part in (tmp_path / "parts").iterdir():
        model = fame.read(part)
        own = [shape for shape in model.shapes if shape.kind == "participant"]
        assert defects(on_plane(model, own[0].plane).model) == []
