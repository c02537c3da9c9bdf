"""Reads what a diagram has to show out of a BPMN document: boxes, nested as they are drawn, and links between them.

Everything is taken from the XML, not from the model: elements that cannot be executed are drawn, too. Groups are left
out, since only a drawing says what is in them; so are conversations and choreographies.
"""

from __future__ import annotations

from collections.abc import Iterator

from fame.bpmn.draw.style import SIZE, SMALL
from fame.bpmn.draw.svg import LINE_HEIGHT, text_width, wrap
from fame.bpmn.model import Bounds
from fame.bpmn.reader.xml import BPMN, Node, children, local_name, resolve, text_of
from fame.dataclasses import dataclass, field

_B = f"{{{BPMN}}}"
BODIES = ("subProcess", "transaction", "adHocSubProcess")
DATA = ("dataObjectReference", "dataStoreReference")
ARTIFACTS = (*DATA, "textAnnotation")
_LINKS = ("sequenceFlow", "messageFlow", "association", "dataInputAssociation", "dataOutputAssociation")
LABEL_GAP = 5.0
"""Between a shape and its label (px)."""
_LABEL_WIDTH, _NOTE_WIDTH = 90.0, 140.0
_EVENT, _GATEWAY, _TASK, _DATA, _STORE = (36.0, 36.0), (50.0, 50.0), (100.0, 80.0), (36.0, 50.0), (50.0, 50.0)


@dataclass(slots=True, eq=False)
class LayoutBox:
    """A shape to be placed: a pool, lane, flow node, data object or annotation. Lengths in px.

    x, y        its centre
    label       the box of its label, relative to the centre; `label_size` its width and height, (0, 0) without a label
    children    of a pool, process or sub-process: what is drawn in it
    lanes       of a pool or process: its lanes; of a lane: those in it
    lane        id of the innermost lane that it is in
    host        of a boundary event: the activity that it is attached to; of an artifact: the box that it is about
    guests      boundary events attached to it
    artifacts   data objects and annotations that are placed above it
    reach       how far it extends from its centre with all that belongs to it: left, up, right, down
    rises, falls  a message flow goes up or down from it
    placed      the file has its place
    """

    id: str
    kind: str
    name: str = ""
    width: float = 0.0
    height: float = 0.0
    x: float = 0.0
    y: float = 0.0
    label: Bounds | None = None
    label_size: tuple[float, float] = (0.0, 0.0)
    parent: LayoutBox | None = None
    children: list[LayoutBox] = field(default_factory=list)
    lanes: list[LayoutBox] = field(default_factory=list)
    lane: str = ""
    host: LayoutBox | None = None
    guests: list[LayoutBox] = field(default_factory=list)
    artifacts: list[LayoutBox] = field(default_factory=list)
    reach: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    by_event: bool = False
    rises: bool = False
    falls: bool = False
    expanded: bool = False
    placed: bool = False

    @property
    def bounds(self) -> Bounds:
        """Its box."""
        return Bounds(self.x - self.width / 2, self.y - self.height / 2, self.width, self.height)

    @property
    def label_bounds(self) -> Bounds | None:
        """The box of its label, where it stands; None without a label."""
        label = self.label
        return None if label is None else Bounds(self.x + label.x, self.y + label.y, label.width, label.height)

    def inner(self) -> Iterator[LayoutBox]:
        """Yield what is drawn inside, at any depth, but lanes."""
        for child in self.children:
            yield child
            yield from child.inner()

    def around(self) -> Iterator[LayoutBox]:
        """Yield the sub-processes and the pool that it is in, the innermost first."""
        box = self.parent
        while box is not None:
            yield box
            box = box.parent

    def move(self, x: float, y: float) -> None:
        """Move it with all that belongs to it."""
        self.x, self.y = self.x + x, self.y + y
        for box in (*self.children, *self.lanes):
            box.move(x, y)


@dataclass(slots=True, eq=False)
class LayoutLink:
    """A flow or association. `waypoints` are empty until it is routed; an end can be another link."""

    id: str
    kind: str
    source: LayoutBox | LayoutLink
    target: LayoutBox | LayoutLink
    name: str = ""
    directed: bool = True
    waypoints: list[tuple[float, float]] = field(default_factory=list)
    label: Bounds | None = None


@dataclass(slots=True)
class Plane:
    """A diagram: the id of the element that it shows, its pools (or the one process), and artifacts outside of them."""

    element: str
    frames: list[LayoutBox]
    loose: list[LayoutBox]


@dataclass(slots=True)
class DiagramContent:
    """What the diagrams of a file have to show; `boxes` are all, by id."""

    planes: list[Plane]
    links: list[LayoutLink]
    boxes: dict[str, LayoutBox]


def read_content(root: Node) -> DiagramContent:
    """Return what is to be drawn of a document in which every element has an id."""
    boxes: dict[str, LayoutBox] = {}
    processes = {id: _scope(one, boxes) for one in children(root, "process") if (id := one.get("id"))}
    planes = []
    for collaboration in children(root, "collaboration"):
        pools = [_pool(one, processes, boxes) for one in children(collaboration, "participant")]
        planes.append(Plane(collaboration.get("id", ""), pools, _artifacts(collaboration, boxes)))
    planes += [Plane(id, [box], []) for id, box in processes.items() if id in boxes]
    content = DiagramContent([plane for plane in planes if plane.frames], [], boxes)
    _attach(root, boxes)
    content.links = list(_links(root, boxes))
    _host_artifacts(content)
    return content


def label_lines(name: str, width: float = _LABEL_WIDTH) -> list[str]:
    """Break the name beside a shape or flow into lines."""
    return wrap(name, width, SMALL) if name.strip() else []


def label_size(name: str, width: float = _LABEL_WIDTH) -> tuple[float, float]:
    """Return width and height of a label (px); (0, 0) for an empty name."""
    lines = label_lines(name, width)
    return (round(max(text_width(line, SMALL) for line in lines)) + 2.0, 14.0 * len(lines)) if lines else (0.0, 0.0)


def _scope(element: Node, boxes: dict[str, LayoutBox]) -> LayoutBox:
    """A process or sub-process with what is in it."""
    box = LayoutBox(element.get("id", ""), local_name(element), element.get("name", ""), expanded=True)
    box.by_event = element.get("triggeredByEvent") in ("true", "1")
    boxes[box.id] = box
    for child in element.iterchildren(f"{_B}*"):
        made = _scope(child, boxes) if local_name(child) in BODIES else _leaf(child)
        if made is not None:
            made.parent = box
            boxes[made.id] = made
            box.children.append(made)
    box.lanes = [lane for lanes in children(element, "laneSet") for lane in _lanes(lanes, boxes)]
    return box


def _leaf(element: Node) -> LayoutBox | None:
    kind, name = local_name(element), element.get("name", "")
    if kind == "textAnnotation":
        name = "\n".join(text_of(inner) for inner in children(element, "text"))
        lines = wrap(name, _NOTE_WIDTH - 20, SIZE) or [""]
        width = min(max(max(text_width(line, SIZE) for line in lines) + 20, 60), 300)
        return LayoutBox(element.get("id", ""), kind, name, round(width), round(len(lines) * SIZE * LINE_HEIGHT) + 12)
    size = _size(kind)
    if size is None:
        return None
    box = LayoutBox(element.get("id", ""), kind, name, *size)
    if size != _TASK:
        box.label_size = label_size(f"{name}\n[{state}]" if (state := _state(element)) else name)
    return box


def _size(kind: str) -> tuple[float, float] | None:
    if kind.endswith("Event"):
        return _EVENT
    if kind.endswith("Gateway"):
        return _GATEWAY
    if kind in DATA:
        return _STORE if kind == "dataStoreReference" else _DATA
    return _TASK if kind.endswith(("Task", "task")) or kind == "callActivity" else None


def _state(element: Node) -> str:
    return next((one.get("name", "") for one in children(element, "dataState")), "")


def _lanes(holder: Node, boxes: dict[str, LayoutBox]) -> list[LayoutBox]:
    """The lanes of a set; what is in them gets to know it, the innermost last."""
    found = []
    for lane in children(holder, "lane"):
        box = LayoutBox(lane.get("id", ""), "lane", lane.get("name", ""))
        boxes[box.id] = box
        for reference in children(lane, "flowNodeRef"):
            if (node := resolve(boxes, text_of(reference))) is not None:
                node.lane = box.id
        box.lanes = [one for lanes in children(lane, "childLaneSet") for one in _lanes(lanes, boxes)]
        found.append(box)
    return found


def _pool(element: Node, processes: dict[str, LayoutBox], boxes: dict[str, LayoutBox]) -> LayoutBox:
    """A pool; it takes the content of its process, unless another pool has it already."""
    pool = LayoutBox(element.get("id", ""), "participant", element.get("name", ""))
    process = resolve(processes, element.get("processRef"))
    if process is not None and boxes.pop(process.id, None) is not None:
        pool.children, pool.lanes, pool.expanded = process.children, process.lanes, True
        for child in pool.children:
            child.parent = pool
    boxes[pool.id] = pool
    return pool


def _artifacts(element: Node, boxes: dict[str, LayoutBox]) -> list[LayoutBox]:
    made = [box for one in element.iterchildren(f"{_B}*") if local_name(one) in ARTIFACTS and (box := _leaf(one))]
    boxes.update((box.id, box) for box in made)
    return made


def _attach(root: Node, boxes: dict[str, LayoutBox]) -> None:
    """Attach boundary events to the activities of their scope."""
    for element in root.iter(f"{_B}boundaryEvent"):
        event, host = boxes.get(element.get("id", "")), resolve(boxes, element.get("attachedToRef"))
        if event is not None and host is not None and host.parent is event.parent and event.parent is not None:
            event.host = host
            host.guests.append(event)


def _links(root: Node, boxes: dict[str, LayoutBox]) -> Iterator[LayoutLink]:
    """The links whose ends are drawn; associations last, since they can end at flows."""
    ends: dict[str, LayoutBox | LayoutLink] = dict(boxes)
    found = sorted(root.iter(*(f"{_B}{kind}" for kind in _LINKS)), key=lambda one: local_name(one) == "association")
    for element in found:
        references = _ends(element)
        source, target = (resolve(ends, reference) for reference in references)
        if source is None or target is None or (source is target and local_name(element) != "sequenceFlow"):
            continue
        kind = local_name(element)
        directed = kind != "association" or element.get("associationDirection", "None") != "None"
        link = LayoutLink(element.get("id", ""), kind, source, target, element.get("name", ""), directed)
        if kind != "association":
            ends[link.id] = link
        yield link


def _ends(element: Node) -> tuple[str, str]:
    kind, holder = local_name(element), element.getparent()
    if kind not in ("dataInputAssociation", "dataOutputAssociation"):
        return element.get("sourceRef", ""), element.get("targetRef", "")
    while holder is not None and not holder.get("id"):
        holder = holder.getparent()
    own = holder.get("id", "") if holder is not None else ""
    name = "sourceRef" if kind == "dataInputAssociation" else "targetRef"
    other = next((text_of(one) for one in children(element, name)), "")
    return (other, own) if name == "sourceRef" else (own, other)


def _host_artifacts(content: DiagramContent) -> None:
    """Let each data object and annotation stand above the first flow node that it is linked to."""
    for link in content.links:
        for artifact, about in ((link.source, link.target), (link.target, link.source)):
            node = about.source if isinstance(about, LayoutLink) else about
            if not isinstance(artifact, LayoutBox) or not isinstance(node, LayoutBox) or artifact.kind not in ARTIFACTS:
                continue
            if artifact.host is None and node.kind not in ARTIFACTS and (host := _host(artifact, node)) is not None:
                artifact.host = host
                host.artifacts.append(artifact)
                _adopt(content, artifact, host.parent)


def _host(artifact: LayoutBox, node: LayoutBox) -> LayoutBox | None:
    """What an artifact stands above: a node of its own scope, which the one that it is about may be inside of."""
    inside = next((box for box in (node, *node.around()) if box.parent is artifact.parent is not None), node)
    inside = inside.host if inside.host is not None else inside
    return inside if inside.parent is not None else None


def _adopt(content: DiagramContent, box: LayoutBox, parent: LayoutBox | None) -> None:
    """Draw an artifact of a collaboration in the pool or sub-process of what it is about."""
    if parent is not None and box.parent is None:
        for plane in content.planes:
            plane.loose = [one for one in plane.loose if one is not box]
        parent.children.append(box)
        box.parent = parent
