"""The diagram interchange: where everything is drawn."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from fame.bpmn.context import Context, boolean, find
from fame.bpmn.model import Bounds, Edge, Shape
from fame.bpmn.xml import BPMNDI, DC, DI, Node, attributes, line_of, local
from fame.errors import ModelError

_SHAPE, _EDGE, _LABEL = f"{{{BPMNDI}}}BPMNShape", f"{{{BPMNDI}}}BPMNEdge", f"{{{BPMNDI}}}BPMNLabel"
_BOUNDS, _WAYPOINT = f"{{{DC}}}Bounds", f"{{{DI}}}waypoint"
_FAR = 1e9
"""No drawing is that large; NaN and infinity are not less than it either."""
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
    """What the diagrams of a file show."""

    planes: list[str] = field(default_factory=list)
    shapes: list[Shape] = field(default_factory=list)
    edges: list[Edge] = field(default_factory=list)


def read_diagrams(context: Context, root: Node) -> Diagrams:
    """All diagrams of a file that is read otherwise. What shows nothing that there is gets a note."""
    found = Diagrams()
    for plane in root.iterchildren(f"{{{BPMNDI}}}BPMNDiagram"):
        for surface in plane.iterchildren(f"{{{BPMNDI}}}BPMNPlane"):
            number = len(found.planes)
            shown = find(context.elements, surface.get("bpmnElement"))
            found.planes.append(shown.get("id", "") if shown is not None else "")
            for one in surface:
                if one.tag == _SHAPE or one.tag == _EDGE:
                    _read(context, one, number, found)
    return found


def _read(context: Context, one: Node, plane: int, found: Diagrams) -> None:
    shown = find(context.elements, one.get("bpmnElement"))
    if shown is None:
        context.note(one, f"the diagram shows {one.get('bpmnElement')!r}, which the file does not have", "warning")
    elif one.tag == _SHAPE:
        found.shapes.append(_shape(context, one, plane, shown))
    else:
        found.edges.append(_edge(context, one, plane, shown))


def _shape(context: Context, one: Node, plane: int, shown: Node) -> Shape:
    bounds = label = None
    for part in one:
        if part.tag == _BOUNDS:
            bounds = _bounds(context, part)
        elif part.tag == _LABEL:
            label = _label(context, part)
    colours = len(attributes(one)) > 2
    if bounds is None:
        raise _error(context, one, "the shape has no bounds")
    return Shape(
        element=shown.get("id", ""),
        bounds=bounds,
        label=label,
        horizontal=boolean(context, one, "isHorizontal", True),
        expanded=boolean(context, one, "isExpanded"),
        marker_visible=boolean(context, one, "isMarkerVisible"),
        kind=local(shown),
        plane=plane,
        stroke=_colour(one, _STROKES) if colours else "",
        fill=_colour(one, _FILLS) if colours else "",
    )


def _edge(context: Context, one: Node, plane: int, shown: Node) -> Edge:
    points, label = [], None
    for part in one:
        if part.tag == _WAYPOINT:
            points.append(_point(context, part))
        elif part.tag == _LABEL:
            label = _label(context, part)
    if len(points) < 2:
        raise _error(context, one, "the edge has fewer than two way points")
    kind = local(shown)
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


def _bounds(context: Context, element: Node) -> Bounds:
    get = element.get
    try:
        x, y = float(get("x") or 0), float(get("y") or 0)
        width, height = float(get("width") or 0), float(get("height") or 0)
    except ValueError:
        x = y = width = height = math.nan
    if not -_FAR < x + y + width + height < _FAR:
        raise _error(context, element, f"bounds {', '.join(map(str, element.values()))}: expected four numbers")
    return Bounds(x, y, width, height)


def _point(context: Context, element: Node) -> tuple[float, float]:
    try:
        x, y = float(element.get("x") or 0), float(element.get("y") or 0)
    except ValueError:
        x = y = math.nan
    if not -_FAR < x + y < _FAR:
        raise _error(context, element, f"way point {', '.join(map(str, element.values()))}: expected two numbers")
    return x, y


def _colour(element: Node, names: tuple[str, ...]) -> str:
    return next((element.get(name, "") for name in names if element.get(name)), "")


def _error(context: Context, element: Node, text: str) -> ModelError:
    holder: Node | None = element
    while holder is not None and holder.get("bpmnElement") is None:
        holder = holder.getparent()
    shown = holder.get("bpmnElement", "") if holder is not None else ""
    return ModelError(f"diagram: {text}", file=context.file, line=line_of(element), element=shown)
