"""Reads the diagram interchange: shapes, edges and labels."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from fame.bpmn.model import Bounds, Edge, Note, Shape
from fame.bpmn.reader.context import Context, boolean_attribute
from fame.bpmn.reader.xml import BPMNDI, DC, DI, Node, attributes, line_of, local_name, resolve

_SHAPE, _EDGE, _LABEL = f"{{{BPMNDI}}}BPMNShape", f"{{{BPMNDI}}}BPMNEdge", f"{{{BPMNDI}}}BPMNLabel"
_BOUNDS, _WAYPOINT = f"{{{DC}}}Bounds", f"{{{DI}}}waypoint"
_FAR = 1e9
"""Larger coordinates are invalid, as are NaN and infinity."""
_STROKES = (
    "{http://www.omg.org/spec/BPMN/non-normative/color/1.0}border-color",
    "{http://bpmn.io/schema/bpmn/biocolor/1.0}stroke",
)
_FILLS = (
    "{http://www.omg.org/spec/BPMN/non-normative/color/1.0}background-color",
    "{http://bpmn.io/schema/bpmn/biocolor/1.0}fill",
)


@dataclass(slots=True)
class Diagrams:
    """The shapes and edges of all diagrams of a file."""

    planes: list[str] = field(default_factory=list)
    shapes: list[Shape] = field(default_factory=list)
    edges: list[Edge] = field(default_factory=list)


def read_diagrams(context: Context, root: Node) -> Diagrams:
    """Read all diagrams, after all other elements. Invalid shapes and edges get a note."""
    found = Diagrams()
    for plane in root.iterchildren(f"{{{BPMNDI}}}BPMNDiagram"):
        for surface in plane.iterchildren(f"{{{BPMNDI}}}BPMNPlane"):
            number = len(found.planes)
            shown = resolve(context.elements, surface.get("bpmnElement"))
            found.planes.append(shown.get("id", "") if shown is not None else "")
            for one in surface:
                if one.tag == _SHAPE or one.tag == _EDGE:
                    _read(context, one, number, found)
    return found


def _read(context: Context, one: Node, plane: int, found: Diagrams) -> None:
    reference = one.get("bpmnElement")
    shown = resolve(context.elements, reference)
    shown = context.find_in_file(one, reference) if shown is None else shown
    if shown is None:
        what = f"{reference!r}: the file has no such element" if reference else "something without a bpmnElement"
        context.note(one, f"the diagram shows {what}", "warning")
    elif one.tag == _SHAPE:
        shape = _shape(context, one, plane, shown)
        found.shapes += [shape] if shape is not None else []
    else:
        edge = _edge(context, one, plane, shown)
        found.edges += [edge] if edge is not None else []


def _shape(context: Context, one: Node, plane: int, shown: Node) -> Shape | None:
    bounds = label = None
    for part in one:
        if part.tag == _BOUNDS:
            bounds = _bounds(context, part)
        elif part.tag == _LABEL:
            label = _label(context, part)
    colours = len(attributes(one)) > 2
    if bounds is None:
        _note(context, one, "the shape has no bounds, so it is not drawn")
        return None
    return Shape(
        element=shown.get("id", ""),
        bounds=bounds,
        label=label,
        horizontal=boolean_attribute(context, one, "isHorizontal", True),
        expanded=boolean_attribute(context, one, "isExpanded"),
        marker_visible=boolean_attribute(context, one, "isMarkerVisible"),
        kind=local_name(shown),
        plane=plane,
        stroke=_colour(one, _STROKES) if colours else "",
        fill=_colour(one, _FILLS) if colours else "",
        name=shown.get("name", ""),
        band=one.get("participantBandKind", ""),
    )


def _edge(context: Context, one: Node, plane: int, shown: Node) -> Edge | None:
    points, label = [], None
    for part in one:
        if part.tag == _WAYPOINT:
            point = _point(context, part)
            points += [point] if point is not None else []
        elif part.tag == _LABEL:
            label = _label(context, part)
    if len(points) < 2:
        _note(context, one, "the edge has fewer than two way points, so it is not drawn")
        return None
    kind = local_name(shown)
    return Edge(
        element=shown.get("id", ""),
        waypoints=tuple(points),
        label=label,
        kind=kind,
        plane=plane,
        stroke=_colour(one, _STROKES) if len(attributes(one)) > 2 else "",
        directed=kind != "association" or shown.get("associationDirection", "None") != "None",
    )


def _label(context: Context, element: Node) -> Bounds | None:
    bounds = element.find(_BOUNDS)
    return _bounds(context, bounds) if bounds is not None else None


def _bounds(context: Context, element: Node) -> Bounds | None:
    get = element.get
    try:
        x, y = float(get("x") or 0), float(get("y") or 0)
        width, height = float(get("width") or 0), float(get("height") or 0)
    except ValueError:
        x = y = width = height = math.nan
    if not -_FAR < x + y + width + height < _FAR:
        _note(context, element, f"bounds {', '.join(map(str, element.values()))}: expected four numbers")
        return None
    return Bounds(x, y, width, height)


def _point(context: Context, element: Node) -> tuple[float, float] | None:
    try:
        x, y = float(element.get("x") or 0), float(element.get("y") or 0)
    except ValueError:
        x = y = math.nan
    if not -_FAR < x + y < _FAR:
        _note(context, element, f"way point {', '.join(map(str, element.values()))}: expected two numbers")
        return None
    return x, y


def _colour(element: Node, names: tuple[str, ...]) -> str:
    return next((element.get(name, "") for name in names if element.get(name)), "")


def _note(context: Context, element: Node, text: str) -> None:
    holder: Node | None = element
    while holder is not None and holder.get("bpmnElement") is None:
        holder = holder.getparent()
    shown = holder.get("bpmnElement", "") if holder is not None else ""
    context.notes.append(Note("warning", f"diagram: {text}", shown, line_of(element)))
