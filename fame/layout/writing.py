"""Puts a diagram into a file as text, so that everything else stays as it is, byte by byte.

New shapes and edges go into the plane that the file has for them, new diagrams to its end, in the terms of Camunda
Modeler. An element without an id that is drawn gets one, since shapes refer to ids. The places are found by expat.
"""

from __future__ import annotations

import codecs
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

from fame.bpmn.draw.svg import number
from fame.bpmn.model import Bounds, Definitions, Edge, Shape
from fame.bpmn.reader.xml import BPMNDI, DC, DI, Node, invented_id
from fame.dataclasses import dataclass, field
from fame.errors import ModelError
from fame.layout.content import BODIES

_BOMS = ((codecs.BOM_UTF8, "utf-8"), (codecs.BOM_UTF16_LE, "utf-16-le"), (codecs.BOM_UTF16_BE, "utf-16-be"))
_TAG = re.compile(rb"""<([^\s/>]+)(?:\s+[^\s=]+\s*=\s*(?:"[^"]*"|'[^']*'))*\s*(/?)>""")
_SEPARATOR = "\n"
"""Between namespace and name; a namespace cannot have one."""
_USUAL = {BPMNDI: "bpmndi", DC: "dc", DI: "di"}


@dataclass(slots=True)
class _Places:
    """Where things are in a file: start tags in document order; begin and end of diagrams; start and end tag of planes;
    the bounds of shapes, by the number of the plane and the element."""

    tags: list[int] = field(default_factory=list)
    diagrams: list[tuple[int, int]] = field(default_factory=list)
    planes: list[tuple[int, int]] = field(default_factory=list)
    bounds: dict[tuple[int, str], int] = field(default_factory=dict)
    end: int = 0


def put_into_file(
    old: Definitions, new: Definitions, elements: Sequence[Node], unnamed: Iterable[int], *, again: bool
) -> bytes:
    """Return the file of a model with the diagram that a laid out model has besides.

    `elements` are those of the file in its order, `unnamed` the places of those that have no id there. `again` replaces
    the diagrams that there are. Raises ModelError if the file cannot be written in its encoding.
    """
    root = elements[0]
    bom, codec = next(((bom, codec) for bom, codec in _BOMS if old.source.startswith(bom)), (b"", ""))
    codec = codec or root.getroottree().docinfo.encoding or "utf-8"
    try:
        text = old.source[len(bom) :].decode(codec)
        kept = text.encode(codec) == old.source[len(bom) :]
    except (LookupError, UnicodeError):
        kept = False
    if not kept:
        raise ModelError(f"expected a file in UTF-8 or another encoding of Python, got {codec}", file=old.file)
    source = text.encode()
    places = _places(source)
    line = "\r\n" if b"\r\n" in source else "\n"
    edits: list[tuple[int, int, str]] = []
    drawn = {*new.planes, *(shape.element for shape in new.shapes), *(edge.element for edge in new.edges)}
    for place in unnamed:
        id, found = elements[place].get("id"), _TAG.match(source, places.tags[place])
        edits += [(found.end(1), found.end(1), f" id={quoteattr(id)}")] if id in drawn and id and found else []
    if again:
        edits += [(_blank_before(source, begin), end, "") for begin, end in places.diagrams]
    edits += _edits(old, new, elements, source, places, line, again=again)
    for begin, end, changed in sorted(edits, reverse=True):
        source = source[:begin] + changed.encode() + source[end:]
    return bom + source.decode().encode(codec, "xmlcharrefreplace")


def _edits(
    old: Definitions,
    new: Definitions,
    elements: Sequence[Node],
    source: bytes,
    places: _Places,
    line: str,
    *,
    again: bool,
) -> Iterator[tuple[int, int, str]]:
    """The shapes and edges that are new, for the planes there are and as new diagrams."""
    known = {} if again else {shape.element: shape.bounds for shape in old.shapes}
    drawn = set(known) | (set() if again else {edge.element for edge in old.edges})
    nodes = [one for one in elements if one.tag == f"{{{BPMNDI}}}BPMNPlane"][: 0 if again else len(places.planes)]
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
            begin, end = places.planes[plane]
            yield from _closed(source, begin, end, writer.parts(shapes, edges), line)
            for shape in new.shapes:
                if shape.plane == plane and known.get(shape.element, shape.bounds) != shape.bounds:
                    at = places.bounds[plane, shape.element]
                    found = _TAG.match(source, at)
                    yield at, found.end() if found else at, f"<{writer.bounds(shape.bounds)}/>"
        elif element in taken and (again or plane >= len(old.planes)):  # else of a process that is embedded as text
            diagrams += writer.diagram(element, plane, shapes, edges)
    if diagrams:
        yield from _closed(source, 0, places.end, diagrams, line)


def _closed(source: bytes, begin: int, end: int, content: str, line: str) -> Iterator[tuple[int, int, str]]:
    """Put content before an end tag; an element that is empty gets one."""
    found = _TAG.match(source, begin) if begin else None
    if not content:
        return
    if found and found[2]:
        yield found.end() - 2, found.end(), f">{line}{content}    </{found[1].decode()}>"
    else:
        start = _blank_before(source, end)
        gap = source[start:end].decode()
        yield start, end, line + content.removesuffix(line) + (gap if "\n" in gap else line)


def _blank_before(source: bytes, place: int) -> int:
    return len(source[:place].rstrip(b" \t\r\n"))


def _places(source: bytes) -> _Places:
    found, opened, parser = _Places(), list[int](), expat.ParserCreate("utf-8", _SEPARATOR)
    shown = [""]

    def start(name: str, attributes: Mapping[str, str]) -> None:
        found.tags.append(parser.CurrentByteIndex)
        opened.append(parser.CurrentByteIndex)
        if name == f"{BPMNDI}{_SEPARATOR}BPMNShape":
            shown[0] = attributes.get("bpmnElement", "").strip().rpartition(":")[2]
        elif name == f"{DC}{_SEPARATOR}Bounds" and len(opened) == 5:
            found.bounds.setdefault((len(found.planes), shown[0]), parser.CurrentByteIndex)

    def end(name: str) -> None:
        at, begin = parser.CurrentByteIndex, opened.pop()
        if name == f"{BPMNDI}{_SEPARATOR}BPMNPlane" and len(opened) == 2:
            found.planes.append((begin, at))
        elif name == f"{BPMNDI}{_SEPARATOR}BPMNDiagram" and len(opened) == 1:
            closing = _TAG.match(source, begin)
            empty = closing is not None and closing[2]
            found.diagrams.append((begin, closing.end() if closing and empty else source.index(b">", at) + 1))
        elif not opened:
            found.end = at

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.Parse(source, True)
    return found


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
