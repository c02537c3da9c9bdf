"""Puts a diagram into a file as text, so that everything else stays as it is, byte by byte.

New shapes and edges go into the plane that the file has for them, new diagrams to its end, in the terms of Camunda
Modeler. An element without an id that is drawn gets one, since shapes refer to ids.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from xml.sax.saxutils import quoteattr

from fame.bpmn.draw.svg import number
from fame.bpmn.model import Bounds, Definitions, Edge, Shape
from fame.bpmn.reader.xml import BPMNDI, DC, DI, Node, invented_id
from fame.bpmn.tags import Tag, decoded, read_tags, written_name
from fame.layout.content import BODIES

_USUAL = {BPMNDI: "bpmndi", DC: "dc", DI: "di"}


def put_into_file(
    old: Definitions, new: Definitions, elements: Sequence[Node], unnamed: Iterable[int], *, again: bool
) -> bytes:
    """Return the file of a model with the diagram that a laid out model has besides.

    `elements` are those of the file in its order, `unnamed` the places of those that have no id there. `again` replaces
    the diagrams that there are. Raises ModelError if the file cannot be written in its encoding.
    """
    text, encoding = decoded(old.source, old.file)
    root = read_tags(text, old.file)
    tags, diagrams = list(root.walk()), [one for one in root.children if one.name == (BPMNDI, "BPMNDiagram")]
    line = "\r\n" if "\r\n" in text else "\n"
    edits: list[tuple[int, int, str]] = []
    drawn = {*new.planes, *(shape.element for shape in new.shapes), *(edge.element for edge in new.edges)}
    for place in unnamed:
        id = elements[place].get("id")
        if id and id in drawn:
            end = tags[place].start + 1 + len(written_name(text, tags[place]))
            edits.append((end, end, f" id={quoteattr(id)}"))
    if again:
        edits += [(_blank_before(text, one.start), one.end, "") for one in diagrams]
    planes = [one for diagram in diagrams for one in diagram.children if one.name == (BPMNDI, "BPMNPlane")]
    edits += _edits(old, new, elements, text, root, [] if again else planes, line, again=again)
    for begin, end, changed in sorted(edits, reverse=True):
        text = text[:begin] + changed + text[end:]
    return text.encode(encoding, "xmlcharrefreplace")


def _edits(
    old: Definitions,
    new: Definitions,
    elements: Sequence[Node],
    text: str,
    root: Tag,
    planes: Sequence[Tag],
    line: str,
    *,
    again: bool,
) -> Iterator[tuple[int, int, str]]:
    """The shapes and edges that are new, for the `planes` there are and as new diagrams."""
    known = {} if again else {shape.element: shape.bounds for shape in old.shapes}
    drawn = set(known) | (set() if again else {edge.element for edge in old.edges})
    nodes = [one for one in elements if one.tag == f"{{{BPMNDI}}}BPMNPlane"][: len(planes)]
    gone = {
        one for one in elements if again and any(f"{{{BPMNDI}}}BPMNDiagram" == up.tag for up in one.iterancestors())
    }
    taken = Counter({id: 1 for one in elements if (id := one.get("id")) and one not in gone})
    diagrams = ""
    for plane, element in enumerate(new.planes):
        shapes = [one for one in new.shapes if one.plane == plane and one.element not in drawn]
        edges = [one for one in new.edges if one.plane == plane and one.element not in drawn]
        writer = _Writer((nodes[plane] if plane < len(nodes) else elements[0]).nsmap, taken, line)
        if plane < len(nodes):
            yield from _closed(text, planes[plane], writer.parts(shapes, edges), line)
            boxes = _bounds(planes[plane])
            for shape in new.shapes:
                if shape.plane == plane and known.get(shape.element, shape.bounds) != shape.bounds:
                    box = boxes[shape.element]
                    yield box.start, box.end, f"<{writer.bounds(shape.bounds)}/>"
        elif element in taken and (again or plane >= len(old.planes)):  # else of a process that is embedded as text
            diagrams += writer.diagram(element, plane, shapes, edges)
    yield from _closed(text, root, diagrams, line)


def _bounds(plane: Tag) -> dict[str, Tag]:
    """The bounds of each shape of a plane, by its element."""
    found = dict[str, Tag]()
    for shape in (one for one in plane.children if one.name == (BPMNDI, "BPMNShape")):
        shown = shape.attributes.get(("", "bpmnElement"))
        box = next((one for one in shape.children if one.name == (DC, "Bounds")), None)
        if shown is not None and box is not None:
            found.setdefault(shown.value.strip().rpartition(":")[2], box)
    return found


def _closed(text: str, tag: Tag, content: str, line: str) -> Iterator[tuple[int, int, str]]:
    """Put content before an end tag; an element that is empty gets one."""
    if content and tag.is_empty:
        yield tag.end - 2, tag.end, f">{line}{content}    </{written_name(text, tag)}>"
    elif content:
        start = _blank_before(text, tag.close)
        gap = text[start : tag.close]
        yield start, tag.close, line + content.removesuffix(line) + (gap if "\n" in gap else line)


def _blank_before(text: str, place: int) -> int:
    return len(text[:place].rstrip(" \t\r\n"))


class _Writer:
    """Writes the parts of a diagram with the prefixes that hold where they are put; `taken` are the ids of the file."""

    def __init__(self, prefixes: Mapping[str | None, str], taken: Counter[str], line: str) -> None:
        self.taken, self.line, self.declared = taken, line, ""
        self.names: dict[str, str] = {}
        for uri, usual in _USUAL.items():
            prefix = next((prefix for prefix, known in prefixes.items() if known == uri), "")
            if prefix == "":
                prefix = next(name for name in (usual, f"fame_{usual}") if name not in prefixes)
                self.declared += f' xmlns:{prefix}="{uri}"'
            self.names[uri] = f"{prefix}:" if prefix else ""

    def diagram(self, element: str, plane: int, shapes: Sequence[Shape], edges: Sequence[Edge]) -> str:
        """Return a whole diagram."""
        di, line = self.names[BPMNDI], self.line
        own, inner = self._id(f"BPMNDiagram_{plane + 1}"), self._id(f"BPMNPlane_{plane + 1}")
        declared, self.declared = self.declared, ""
        return (
            f'  <{di}BPMNDiagram{declared} id="{own}">{line}    <{di}BPMNPlane id="{inner}" '
            f"bpmnElement={quoteattr(element)}>{line}{self.parts(shapes, edges)}    </{di}BPMNPlane>{line}"
            f"  </{di}BPMNDiagram>{line}"
        )

    def parts(self, shapes: Sequence[Shape], edges: Sequence[Edge]) -> str:
        """Return shapes and edges, one below the other."""
        lines = [line for one in shapes for line in self._shape(one)]
        lines += [line for one in edges for line in self._edge(one)]
        return "".join(f"      {line}{self.line}" for line in lines)

    def bounds(self, box: Bounds) -> str:
        """Return the inside of a tag of bounds."""
        x, y, width, height = map(number, (box.x, box.y, box.width, box.height))
        return f'{self.names[DC]}Bounds x="{x}" y="{y}" width="{width}" height="{height}"'

    def _shape(self, shape: Shape) -> Iterator[str]:
        attributes = ' isHorizontal="true"' if shape.kind in ("participant", "lane") else ""
        attributes += f' isExpanded="{str(shape.expanded).lower()}"' if shape.kind in BODIES else ""
        attributes += ' isMarkerVisible="true"' if shape.marker_visible else ""
        yield self._tag("BPMNShape", shape.element, attributes)
        yield f"  <{self.bounds(shape.bounds)} />"
        yield from self._label(shape.label)
        yield f"</{self.names[BPMNDI]}BPMNShape>"

    def _edge(self, edge: Edge) -> Iterator[str]:
        yield self._tag("BPMNEdge", edge.element, "")
        for x, y in edge.waypoints:
            yield f'  <{self.names[DI]}waypoint x="{number(x)}" y="{number(y)}" />'
        yield from self._label(edge.label)
        yield f"</{self.names[BPMNDI]}BPMNEdge>"

    def _tag(self, kind: str, element: str, attributes: str) -> str:
        name = f'id="{self._id(element + "_di")}" bpmnElement={quoteattr(element)}{attributes}'
        return f"<{self.names[BPMNDI]}{kind}{self.declared} {name}>"

    def _label(self, label: Bounds | None) -> Iterator[str]:
        if label is not None:
            di = self.names[BPMNDI]
            yield f"  <{di}BPMNLabel>"
            yield f"    <{self.bounds(label)} />"
            yield f"  </{di}BPMNLabel>"

    def _id(self, wanted: str) -> str:
        """An id that the file does not have, as bpmn-moddle allows it."""
        stem = re.sub(r"[^\w.-]", "_", wanted, flags=re.ASCII)
        stem = stem if re.match(r"[A-Za-z_]", stem) else f"_{stem}"
        return invented_id(stem, self.taken)
