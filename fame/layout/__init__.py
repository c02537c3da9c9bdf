"""Lays out models whose file has no diagram, or a part of one: `lay_out` for the model, `add_diagram` for the file.

::

    content     what is to be drawn, out of the XML
    layers      the nodes of a scope in columns and rows (Sugiyama)
    arrange     sub-processes, lanes, pools, labels of nodes, from the inside out
    routing     shortest ways at right angles
    connect     the ways of all links, and labels of flows
    writing     the diagram as text, put into the file

Nothing is random, and nothing depends on the order of sets: the same file gives the same diagram.
"""

from __future__ import annotations

from fame.bpmn.model import Definitions, Edge, Shape
from fame.bpmn.reader.document import read_bytes, read_tree
from fame.bpmn.reader.xml import Node, parse
from fame.dataclasses import replace
from fame.errors import ModelError
from fame.layout.arrange import arrange
from fame.layout.completion import complete
from fame.layout.connect import box_of, connect
from fame.layout.content import (
    BODIES,
    DiagramContent,
    LayoutBox,
    read_content,
)
from fame.layout.writing import put_into_file

_MOST = 2_000
"""Elements: more would take minutes, and nobody reads the picture."""


def lay_out(definitions: Definitions, *, again: bool = False) -> Definitions:
    """Return a model with a diagram of everything: what has a place keeps it, unless it is to be laid out `again`.

    Raises ModelError if it has nothing to draw.
    """
    return _laid_out(definitions, again)[0]


def add_diagram(definitions: Definitions, *, again: bool = False) -> bytes:
    """As `lay_out`, for the file: nothing else is changed in it, but that elements without an id get one."""
    model, elements, unnamed = _laid_out(definitions, again)
    source = put_into_file(definitions, model, elements, unnamed, again=again)
    read_bytes(source, file=definitions.file)
    return source


def _laid_out(definitions: Definitions, again: bool) -> tuple[Definitions, list[Node], list[int]]:
    """The model with its diagram, the elements of the file in order, and the places of those without an id there."""
    root = parse(definitions.source, definitions.file)
    elements = list(root.iter("*"))
    unnamed = [place for place, element in enumerate(elements) if not element.get("id")]
    read_tree(root, definitions.source, definitions.file)
    content = read_content(root)
    if not any(frame.kind == "participant" or frame.children for plane in content.planes for frame in plane.frames):
        raise ModelError("expected a pool, or a process with a flow node to draw", file=definitions.file)
    if len(content.boxes) > _MOST:
        text = f"expected at most {_MOST:,} elements to lay out, got {len(content.boxes):,}: draw it in a modeler"
        raise ModelError(text, file=definitions.file)
    if definitions.shapes and not again:
        complete(content, definitions)
    else:
        arrange(content)
    connect(content)
    planes = tuple(plane.element for plane in content.planes)
    shapes, edges = _shapes(content), _edges(content)
    if not again:
        bounds = {shape.element: shape.bounds for shape in shapes}
        old = [replace(shape, bounds=bounds.get(shape.element, shape.bounds)) for shape in definitions.shapes]
        known = {shape.element for shape in old} | {edge.element for edge in definitions.edges}
        shapes = old + [shape for shape in shapes if shape.element not in known]
        edges = [*definitions.edges, *(edge for edge in edges if edge.element not in known)]
    model = replace(definitions, shapes=tuple(shapes), edges=tuple(edges), planes=planes)
    return model, elements, unnamed


def _shapes(content: DiagramContent) -> list[Shape]:
    found = []
    for number, plane in enumerate(content.planes):
        for frame in plane.frames:
            found += [_shape(frame, number)] if frame.kind == "participant" else []
            found += [_shape(lane, number) for lane in _lanes(frame) if lane.width]
            found += [_shape(box, number) for box in frame.inner()]
        found += [_shape(box, number) for box in plane.loose]
    return found


def _lanes(box: LayoutBox) -> list[LayoutBox]:
    return [one for lane in box.lanes for one in (lane, *_lanes(lane))]


def _shape(box: LayoutBox, plane: int) -> Shape:
    return Shape(
        element=box.id,
        bounds=box.bounds,
        label=box.label_bounds,
        expanded=box.expanded and box.kind in BODIES,
        marker_visible=box.kind == "exclusiveGateway",
        kind=box.kind,
        plane=plane,
        name=box.name,
    )


def _edges(content: DiagramContent) -> list[Edge]:
    planes = {}
    for number, plane in enumerate(content.planes):
        for box in [one for frame in plane.frames for one in (frame, *frame.inner())] + plane.loose:
            planes[box] = number
    found = []
    for link in content.links:
        if link.waypoints:
            at, points = planes[box_of(link.source)], tuple(link.waypoints)
            found.append(Edge(link.id, points, link.label, link.kind, at, directed=link.directed))
    return found
