"""Reads the diagram interchange of a file: where its elements are drawn, with the colours of bpmn.io and the standard.

A shape or edge that cannot be drawn is a note of the model: the process runs without it.
"""

from __future__ import annotations

from fame.bpmn.model import Bounds, Edge, Note, Shape
from fame.bpmn.reader.context import Context, boolean_attribute
from fame.bpmn.reader.xml import BPMNDI, DC, DI, Node, attributes, line_of, local_name, resolve
from fame.dataclasses import dataclass, field
from fame.text import as_number

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
    diagrams = Diagrams()
    for diagram in root.iterchildren(f"{{{BPMNDI}}}BPMNDiagram"):
        for plane in diagram.iterchildren(f"{{{BPMNDI}}}BPMNPlane"):
            number = len(diagrams.planes)
            shown = resolve(context.elements, plane.get("bpmnElement"))
            diagrams.planes.append(shown.get("id", "") if shown is not None else "")
            for drawn in plane:
                if drawn.tag == _SHAPE or drawn.tag == _EDGE:
                    _read(context, drawn, number, diagrams)
    return diagrams


def _read(context: Context, drawn: Node, plane: int, diagrams: Diagrams) -> None:
    reference = drawn.get("bpmnElement")
    shown = resolve(context.elements, reference)
    shown = context.find_in_file(drawn, reference) if shown is None else shown
    if shown is None:
        what = f"{reference!r}: the file has no such element" if reference else "something without a bpmnElement"
        context.note(drawn, f"the diagram shows {what}", "warning")
    elif drawn.tag == _SHAPE:
        shape = _shape(context, drawn, plane, shown)
        diagrams.shapes += [shape] if shape is not None else []
    else:
        edge = _edge(context, drawn, plane, shown)
        diagrams.edges += [edge] if edge is not None else []


def _shape(context: Context, drawn: Node, plane: int, shown: Node) -> Shape | None:
    bounds = label = None
    for part in drawn:
        if part.tag == _BOUNDS:
            bounds = _bounds(context, part)
        elif part.tag == _LABEL:
            label = _label(context, part)
    colours = len(attributes(drawn)) > 2
    if bounds is None:
        _note(context, drawn, "the shape has no bounds, so it is not drawn")
        return None
    return Shape(
        element=shown.get("id", ""),
        bounds=bounds,
        label=label,
        horizontal=boolean_attribute(context, drawn, "isHorizontal", True),
        expanded=boolean_attribute(context, drawn, "isExpanded"),
        marker_visible=boolean_attribute(context, drawn, "isMarkerVisible"),
        kind=local_name(shown),
        plane=plane,
        stroke=_colour(drawn, _STROKES) if colours else "",
        fill=_colour(drawn, _FILLS) if colours else "",
        name=shown.get("name", ""),
        band=drawn.get("participantBandKind", ""),
    )


def _edge(context: Context, drawn: Node, plane: int, shown: Node) -> Edge | None:
    points, label = [], None
    for part in drawn:
        if part.tag == _WAYPOINT:
            point = _point(context, part)
            points += [point] if point is not None else []
        elif part.tag == _LABEL:
            label = _label(context, part)
    if len(points) < 2:
        _note(context, drawn, "the edge has fewer than two way points, so it is not drawn")
        return None
    kind = local_name(shown)
    return Edge(
        element=shown.get("id", ""),
        waypoints=tuple(points),
        label=label,
        kind=kind,
        plane=plane,
        stroke=_colour(drawn, _STROKES) if len(attributes(drawn)) > 2 else "",
        directed=kind != "association" or shown.get("associationDirection", "None") != "None",
    )


def _label(context: Context, element: Node) -> Bounds | None:
    bounds = element.find(_BOUNDS)
    return _bounds(context, bounds) if bounds is not None else None


def _bounds(context: Context, element: Node) -> Bounds | None:
    x, y, width, height = (as_number(element.get(name) or "0") for name in ("x", "y", "width", "height"))
    if not -_FAR < x + y + width + height < _FAR:
        _note(context, element, f"bounds {', '.join(map(str, element.values()))}: expected four numbers")
        return None
    return Bounds(x, y, width, height)


def _point(context: Context, element: Node) -> tuple[float, float] | None:
    x, y = (as_number(element.get(name) or "0") for name in ("x", "y"))
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
