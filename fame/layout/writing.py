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
_LABEL, _PARTS = (BPMNDI, "BPMNLabel"), ((BPMNDI, "BPMNShape"), (BPMNDI, "BPMNEdge"))
_OWN = {("", name) for name in ("id", "bpmnElement", "isHorizontal", "isExpanded", "isMarkerVisible")}


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
    planes: list[Tag | None] = [part for one in diagrams for part in one.children if part.name == (BPMNDI, "BPMNPlane")]
    kept: list[Tag] = diagrams
    if again:  # what is drawn goes, and so do diagrams of what is no longer drawn apart
        of = {_shown(one): one for one in reversed(planes) if one is not None}
        planes = [of.get(element) for element in new.planes]
        kept = [one.parent for one in planes if one is not None and one.parent is not None]
        gone = [one for one in diagrams if one not in kept]
        gone += [part for one in planes if one is not None for part in one.children if part.name in _PARTS]
        edits += [(_blank_before(text, one.start), one.end, "") for one in gone]
    lost = {node for tag, node in zip(tags, elements, strict=True) if tag in diagrams and tag not in kept}
    taken = Counter({id: 1 for one in elements if (id := one.get("id")) and lost.isdisjoint(one.iterancestors())})
    edits += _edits(old, new, elements, taken, text, root, planes, line, again=again)
    for begin, end, changed in sorted(edits, reverse=True):
        text = text[:begin] + changed + text[end:]
    return text.encode(encoding, "xmlcharrefreplace")


def _edits(
    old: Definitions,
    new: Definitions,
    elements: Sequence[Node],
    taken: Counter[str],
    text: str,
    root: Tag,
    planes: Sequence[Tag | None],
    line: str,
    *,
    again: bool,
) -> Iterator[tuple[int, int, str]]:
    """The shapes and edges that are new, for the `planes` there are and as new diagrams."""
    known = {} if again else {shape.element: shape.bounds for shape in old.shapes}
    drawn = set(known) | (set() if again else {edge.element for edge in old.edges})
    diagrams = ""
    for place, element in enumerate(new.planes):
        shapes = [one for one in new.shapes if one.plane == place and one.element not in drawn]
        edges = [one for one in new.edges if one.plane == place and one.element not in drawn]
        plane = planes[place] if place < len(planes) else None
        if plane is not None:
            writer = _Writer({prefix or None: uri for prefix, uri in plane.prefixes.items()}, taken, line, text)
            writer.old = {_shown(one): one for one in plane.children if again and one.name in _PARTS}
            yield from _closed(text, plane, writer.parts(shapes, edges), line)
            boxes = _bounds(plane)
            for shape in new.shapes:
                if shape.plane == place and known.get(shape.element, shape.bounds) != shape.bounds:
                    box = boxes[shape.element]
                    yield box.start, box.end, f"<{writer.bounds(shape.bounds)}/>"
        elif element in taken and (again or place >= len(old.planes)):  # else of a process that is embedded as text
            diagrams += _Writer(elements[0].nsmap, taken, line, text).diagram(element, place, shapes, edges)
    yield from _closed(text, root, diagrams, line)


def _shown(tag: Tag) -> str:
    """The id of what a plane, shape or edge shows."""
    shown = tag.attributes.get(("", "bpmnElement"))
    return shown.value.strip().rpartition(":")[2] if shown is not None else ""


def _bounds(plane: Tag) -> dict[str, Tag]:
    """The bounds of each shape of a plane, by its element."""
    found = dict[str, Tag]()
    for shape in (one for one in plane.children if one.name == (BPMNDI, "BPMNShape")):
        box = next((one for one in shape.children if one.name == (DC, "Bounds")), None)
        if box is not None:
            found.setdefault(_shown(shape), box)
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
    """Writes the parts of a diagram with the prefixes that hold where they are put; `taken` are the ids of the file.

    Of the `old` parts of the diagram, by element, colours stay, and what else is no place.
    """

    def __init__(self, prefixes: Mapping[str | None, str], taken: Counter[str], line: str, text: str) -> None:
        self.taken, self.line, self.declared = taken, line, ""
        self.old: dict[str, Tag] = {}
        self._text, self._prefixes = text, prefixes
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
        yield from self._label(shape.label, self.old.get(shape.element))
        yield f"</{self.names[BPMNDI]}BPMNShape>"

    def _edge(self, edge: Edge) -> Iterator[str]:
        yield self._tag("BPMNEdge", edge.element, "")
        for x, y in edge.waypoints:
            yield f'  <{self.names[DI]}waypoint x="{number(x)}" y="{number(y)}" />'
        yield from self._label(edge.label, self.old.get(edge.element))
        yield f"</{self.names[BPMNDI]}BPMNEdge>"

    def _tag(self, kind: str, element: str, attributes: str) -> str:
        old = self.old.get(element)
        known = old.attributes.get(("", "id")) if old is not None else None
        id = quoteattr(known.value) if known is not None else f'"{self._id(element + "_di")}"'
        name = f"id={id} bpmnElement={quoteattr(element)}{attributes}{self._others(old)}"
        return f"<{self.names[BPMNDI]}{kind}{self.declared} {name}>"

    def _others(self, old: Tag | None) -> str:
        """The attributes of an old part that tell no place, such as colours, where their prefixes hold."""
        found = ""
        for (uri, name), one in old.attributes.items() if old is not None else ():
            written = self._text[one.start : one.end].strip()
            prefix = re.split(r"[\s=]", written)[0].rpartition(":")[0]
            if ("", name) not in _OWN and (not uri or self._prefixes.get(prefix) == uri):
                found += f" {written}"
        return found

    def _label(self, label: Bounds | None, part: Tag | None) -> Iterator[str]:
        old = next((one for one in part.children if one.name == _LABEL), None) if part is not None else None
        opening = f"  <{self.names[BPMNDI]}BPMNLabel{self._others(old)}"
        if label is not None:
            yield f"{opening}>"
            yield f"    <{self.bounds(label)} />"
            yield f"  </{self.names[BPMNDI]}BPMNLabel>"
        elif old is not None:
            yield f"{opening} />"

    def _id(self, wanted: str) -> str:
        """An id that the file does not have, as bpmn-moddle allows it."""
        stem = re.sub(r"[^\w.-]", "_", wanted, flags=re.ASCII)
        stem = stem if re.match(r"[A-Za-z_]", stem) else f"_{stem}"
        return invented_id(stem, self.taken)
