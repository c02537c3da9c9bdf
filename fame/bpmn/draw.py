"""Draws a model as its diagram interchange says, as SVG; with the path of a run on it, if given.

One drawing function for each kind of thing (`_SHAPES`), each giving SVG text. Containers come first, then flows, then
what stands on them; every diagram of the file is drawn, the first on top.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from fame.bpmn import icons
from fame.bpmn.icons import Ink
from fame.bpmn.model import (
    Activity,
    Bounds,
    CallActivity,
    DataObject,
    Definitions,
    Edge,
    Element,
    Event,
    Gateway,
    MultiInstance,
    Participant,
    SequenceFlow,
    Shape,
    SubProcess,
    Task,
)
from fame.bpmn.svg import (
    FONT,
    LINE_HEIGHT,
    arrow,
    corners,
    fitted,
    lettering,
    middle,
    moved,
    number,
    polyline,
    tag,
    text_width,
    towards,
    wrap,
)
from fame.errors import ModelError

INK, PAPER = "#22242a", "#ffffff"
VISITED, VISITED_PAPER = "#1a7f37", "#e3f4e6"
SIZE, SMALL = 12.0, 11.0
"""Of lettering, in pixels: in boxes, beside things."""
MARGIN = 12.0


@dataclass(slots=True)
class _Picture:
    """What the drawing functions look things up in."""

    elements: dict[str, Element] = field(default_factory=dict)
    visits: Mapping[str, int] = field(default_factory=dict)

    def ink(self, shape: Shape | Edge) -> Ink:
        fill = shape.fill if isinstance(shape, Shape) else ""
        if self.visits.get(shape.element):
            return VISITED, VISITED_PAPER
        return shape.stroke or INK, fill or PAPER


def draw(definitions: Definitions, visited: Iterable[str] | Mapping[str, int] = ()) -> str:
    """The diagrams of a file as one SVG document.

    `visited` are ids of elements and flows, as often as they were visited, or how often each was: they are drawn in
    green with their number. Raises ModelError if the file has no diagram.
    """
    if not definitions.shapes:
        raise ModelError("the file has no diagram: open it in a modeler and save it", file=definitions.file)
    visits = visited if isinstance(visited, Mapping) else Counter(visited)
    picture = _Picture({one.id: one for one in _elements(definitions)}, visits)
    parts: list[str] = []
    width, top = 0.0, MARGIN
    for plane in sorted({shape.plane for shape in definitions.shapes}):
        shapes = [shape for shape in definitions.shapes if shape.plane == plane]
        edges = [edge for edge in definitions.edges if edge.plane == plane]
        frame = _frame(shapes, edges)
        if parts:
            title = picture.elements.get(definitions.planes[plane])
            parts.append(lettering([title.label if title else ""], MARGIN, top, size=14, fill=INK, anchor="start"))
            top += 28
        parts.append(moved(MARGIN - frame.x, top - frame.y, *_plane(picture, shapes, edges)))
        width, top = max(width, frame.width), top + frame.height + 2 * MARGIN
    size = number(width + 2 * MARGIN), number(top - MARGIN)
    paper = tag("rect", width="100%", height="100%", fill=PAPER)
    namespace = {"xmlns": "http://www.w3.org/2000/svg", "viewBox": f"0 0 {size[0]} {size[1]}", "font_family": FONT}
    return tag("svg", paper, *parts, width=size[0], height=size[1], **namespace) + "\n"


def _elements(definitions: Definitions) -> Iterable[Element]:
    yield from (*definitions.processes, *definitions.participants, *definitions.message_flows, *definitions.artifacts)
    for process in definitions.processes:
        yield from process.lanes
        bodies = [process.body]
        for body in bodies:
            yield from (*body.nodes, *body.flows, *body.data_objects)
            bodies += [node.body for node in body.nodes if isinstance(node, SubProcess)]


def _frame(shapes: Sequence[Shape], edges: Sequence[Edge]) -> Bounds:
    """What everything fits in."""
    labels = [shape.label for shape in shapes] + [edge.label for edge in edges]
    boxes = [one.bounds for one in shapes] + [label for label in labels if label is not None]
    points = [point for edge in edges for point in edge.waypoints]
    lefts, tops = [box.x for box in boxes] + [x for x, _ in points], [box.y for box in boxes] + [y for _, y in points]
    rights = [box.x + box.width for box in boxes] + [x for x, _ in points]
    bottoms = [box.y + box.height for box in boxes] + [y for _, y in points]
    return Bounds(min(lefts), min(tops), max(rights) - min(lefts), max(bottoms) - min(tops))


def _plane(picture: _Picture, shapes: Sequence[Shape], edges: Sequence[Edge]) -> list[str]:
    frames = [
        shape for shape in shapes if shape.kind in ("participant", "lane") or (shape.expanded and _is_body(shape))
    ]
    frames.sort(key=lambda shape: -shape.bounds.width * shape.bounds.height)
    others = [shape for shape in shapes if shape not in frames]
    others.sort(key=lambda shape: shape.kind == "boundaryEvent")
    parts = [_shape(picture, shape) for shape in frames]
    parts += [_edge(picture, edge) for edge in edges]
    parts += [_shape(picture, shape) for shape in others]
    parts += [_edge_label(picture, edge) for edge in edges]
    parts += [_count(picture, shape) for shape in shapes]
    return [part for part in parts if part]


def _is_body(shape: Shape) -> bool:
    return shape.kind in ("subProcess", "transaction", "adHocSubProcess")


# ---- shapes ----------------------------------------------------------------------------------------------------------


def _shape(picture: _Picture, shape: Shape) -> str:
    element = picture.elements.get(shape.element)
    draws = _SHAPES.get(shape.kind, _activity)
    if element is None:
        return ""
    return tag("g", draws(picture, shape, element), id=element.id)


def _box(bounds: Bounds, ink: Ink, width: float = 2, radius: float = 0, dashes: str = "") -> str:
    return tag(
        "rect",
        x=bounds.x,
        y=bounds.y,
        width=bounds.width,
        height=bounds.height,
        rx=radius or None,
        fill=ink[1],
        stroke=ink[0],
        stroke_width=width,
        stroke_dasharray=dashes,
    )


def _shrunk(bounds: Bounds, by: float) -> Bounds:
    return Bounds(bounds.x + by, bounds.y + by, bounds.width - 2 * by, bounds.height - 2 * by)


def _pool(picture: _Picture, shape: Shape, element: Element) -> str:
    bounds, ink = shape.bounds, picture.ink(shape)
    if shape.kind == "lane" and ink[1] == PAPER:
        ink = ink[0], "none"
    marks = ""
    if isinstance(element, Participant) and element.multi_instance:
        x, y = bounds.x + bounds.width / 2 - 7, bounds.y + bounds.height - 18
        marks = moved(x, y, icons.marker("parallel", ink))
    if isinstance(element, Participant) and not element.process:
        return _box(bounds, ink, 1.5) + _centred(element.name, bounds, ink) + marks
    band = 30.0
    if shape.horizontal:
        line = f"M{number(bounds.x + band)} {number(bounds.y)}v{number(bounds.height)}"
    else:
        line = f"M{number(bounds.x)} {number(bounds.y + band)}h{number(bounds.width)}"
    rule = tag("path", d=line, stroke=ink[0], stroke_width=1.5) if shape.kind == "participant" else ""
    return _box(bounds, ink, 1.5) + rule + _banner(element.name, shape, band, ink) + marks


def _banner(name: str, shape: Shape, band: float, ink: Ink) -> str:
    """The name of a pool or lane in its band: upright if the pool stands, read from below if it lies."""
    bounds = shape.bounds
    if not shape.horizontal:
        return _centred(name, Bounds(bounds.x, bounds.y, bounds.width, band), ink)
    turned = Bounds(-bounds.height / 2, -band / 2, bounds.height, band)
    x, y = number(bounds.x + band / 2), number(bounds.y + bounds.height / 2)
    return tag("g", _centred(name, turned, ink), transform=f"translate({x} {y}) rotate(-90)")


def _centred(name: str, bounds: Bounds, ink: Ink, room: float = 12) -> str:
    """A name in the middle of a box."""
    lines = wrap(name, max(bounds.width - room, 10), SIZE)
    top = bounds.y + (bounds.height - len(lines) * SIZE * LINE_HEIGHT) / 2
    return lettering(lines, bounds.x + bounds.width / 2, max(top, bounds.y), size=SIZE, fill=_letters(ink))


def _letters(ink: Ink) -> str:
    return INK if ink[0] == VISITED else ink[0]


def _activity(picture: _Picture, shape: Shape, element: Element) -> str:
    bounds, ink = shape.bounds, picture.ink(shape)
    open_body = isinstance(element, SubProcess) and shape.expanded
    by_event = isinstance(element, SubProcess) and element.triggered_by_event
    box = _box(bounds, ink, 5 if isinstance(element, CallActivity) else 2, 10, "1 5" if by_event else "")
    if isinstance(element, SubProcess) and element.kind == "transaction":
        box += _box(_shrunk(bounds, 3), ink, 1.5, 8)
    markers = _markers(shape, element, ink)
    if open_body:
        lines = wrap(element.name, bounds.width - 20, SIZE)
        name = lettering(lines, bounds.x + bounds.width / 2, bounds.y + 6, size=SIZE, fill=_letters(ink))
    else:
        room = Bounds(bounds.x, bounds.y, bounds.width, bounds.height - (10 if markers else 0))
        name = _centred(element.name, room, ink)
    icon = icons.task(element.kind, ink) if isinstance(element, Task) else ""
    return box + (moved(bounds.x + 6, bounds.y + 6, icon) if icon else "") + name + markers


def _markers(shape: Shape, element: Element, ink: Ink) -> str:
    kinds: list[str] = []
    if isinstance(element, Activity):
        if element.for_compensation:
            kinds.append("compensation")
        if isinstance(element.loop, MultiInstance):
            kinds.append("sequential" if element.loop.sequential else "parallel")
        elif element.loop is not None:
            kinds.append("loop")
    if isinstance(element, SubProcess) and element.kind == "adhoc":
        kinds.append("adhoc")
    if isinstance(element, CallActivity) or (isinstance(element, SubProcess) and not shape.expanded):
        kinds.append("collapsed")
    bounds = shape.bounds
    left = bounds.x + bounds.width / 2 - 9 * len(kinds) + 2
    y = bounds.y + bounds.height - 19
    return "".join(moved(left + 18 * place, y, icons.marker(kind, ink)) for place, kind in enumerate(kinds))


def _event(picture: _Picture, shape: Shape, element: Element) -> str:
    if not isinstance(element, Event):
        return ""
    bounds, ink = shape.bounds, picture.ink(shape)
    x, y, radius = bounds.x + bounds.width / 2, bounds.y + bounds.height / 2, bounds.width / 2
    throws = element.place in ("throw", "end")
    dashes = "6 4" if not element.interrupting and element.place in ("start", "boundary") else ""
    widths = {"end": [(radius - 1, 4.0)], "start": [(radius, 2.0)]}
    rings = widths.get(element.place, [(radius, 1.5), (radius - 3.5, 1.5)])
    circles = [
        tag("circle", cx=x, cy=y, r=r, fill=ink[1], stroke=ink[0], stroke_width=width, stroke_dasharray=dashes)
        for r, width in rings
    ]
    icon = icons.trigger(_trigger(element), ink, throws)
    scale = bounds.width / 36
    inside = moved(x - 18 * scale, y - 18 * scale, icon, scale=scale) if icon else ""
    return "".join(circles) + inside + _label_beside(shape, element, ink)


def _trigger(event: Event) -> str:
    if len(event.definitions) > 1:
        return "parallel_multiple" if event.parallel else "multiple"
    return type(event.definitions[0]).__name__.removesuffix("Definition").lower() if event.definitions else ""


def _gateway(picture: _Picture, shape: Shape, element: Element) -> str:
    if not isinstance(element, Gateway):
        return ""
    bounds, ink = shape.bounds, picture.ink(shape)
    x, y, w, h = bounds.x + bounds.width / 2, bounds.y + bounds.height / 2, bounds.width / 2, bounds.height / 2
    points = corners([(x, y - h), (x + w, y), (x, y + h), (x - w, y)])
    diamond = tag("polygon", points=points, fill=ink[1], stroke=ink[0], stroke_width=2, stroke_linejoin="round")
    sign = icons.gateway(element.kind, ink, shape.marker_visible)
    inside = moved(x, y, sign, scale=bounds.width / 50) if sign else ""
    return diamond + inside + _label_beside(shape, element, ink)


def _data(picture: _Picture, shape: Shape, element: Element) -> str:
    bounds, ink = shape.bounds, picture.ink(shape)
    x, y, w, h = bounds.x, bounds.y, bounds.width, bounds.height
    if shape.kind == "dataStoreReference":
        return _store(bounds, ink) + _label_beside(shape, element, ink)
    fold = min(10, w / 3)
    page = [(x, y), (x + w - fold, y), (x + w, y + fold), (x + w, y + h), (x, y + h)]
    corner = [(x + w - fold, y), (x + w - fold, y + fold), (x + w, y + fold)]
    style = {"stroke": ink[0], "stroke_width": 2, "stroke_linejoin": "round"}
    drawn = tag("polygon", points=corners(page), fill=ink[1], **style)
    drawn += tag("polyline", points=corners(corner), fill="none", **style)
    if isinstance(element, DataObject) and element.collection:
        drawn += moved(x + w / 2 - 7, y + h - 18, icons.marker("parallel", ink))
    if shape.kind in ("dataInput", "dataOutput"):
        filled = shape.kind == "dataOutput"
        drawn += moved(x + 1, y + 1, icons.trigger("link", ink, filled), scale=0.5)
    return drawn + _label_beside(shape, element, ink, _with_state(element))


def _with_state(element: Element) -> str:
    state = element.state if isinstance(element, DataObject) else ""
    return f"{element.name}\n[{state}]" if state else element.name


def _store(bounds: Bounds, ink: Ink) -> str:
    x, y, w, h = bounds.x, bounds.y, bounds.width, bounds.height
    lid = min(h / 6, 10)
    arc = f"{number(w / 2)} {number(lid)} 0 0"
    barrel = f"M{number(x)} {number(y + lid)}A{arc} 1 {number(x + w)} {number(y + lid)}V{number(y + h - lid)}"
    barrel += f"A{arc} 1 {number(x)} {number(y + h - lid)}Z"
    rims = "".join(
        f"M{number(x)} {number(y + lid * level)}A{arc} 0 {number(x + w)} {number(y + lid * level)}"
        for level in (1, 1.7, 2.4)
    )
    drawn = tag("path", d=barrel, fill=ink[1], stroke=ink[0], stroke_width=2)
    return drawn + tag("path", d=rims, fill="none", stroke=ink[0], stroke_width=2)


def _annotation(picture: _Picture, shape: Shape, element: Element) -> str:
    bounds, ink = shape.bounds, picture.ink(shape)
    bracket = f"M{number(bounds.x + 10)} {number(bounds.y)}h-10v{number(bounds.height)}h10"
    lines = wrap(element.name, max(bounds.width - 10, 30), SIZE)
    letters = lettering(lines, bounds.x + 6, bounds.y + 4, size=SIZE, fill=_letters(ink), anchor="start")
    return tag("path", d=bracket, fill="none", stroke=ink[0], stroke_width=2) + letters


def _group(picture: _Picture, shape: Shape, element: Element) -> str:
    stroke, _ = picture.ink(shape)
    box = _box(shape.bounds, (stroke, "none"), 1.5, 10, "10 6 0 6")
    if shape.label is None:
        bounds = shape.bounds
        lines = wrap(element.name, bounds.width, SMALL)
        return box + lettering(lines, bounds.x + bounds.width / 2, bounds.y + 4, size=SMALL, fill=stroke)
    return box + _label_beside(shape, element, (stroke, PAPER))


def _label_beside(shape: Shape, element: Element, ink: Ink, name: str = "") -> str:
    """A name outside of its shape: where the diagram says, else below."""
    name = name or element.name
    bounds = shape.bounds
    if shape.label is not None and shape.label.width > 0:
        label = shape.label
        lines = fitted(name, label, SMALL)
        return lettering(lines, label.x + label.width / 2, label.y, size=SMALL, fill=_letters(ink), halo=True)
    lines = wrap(name, 90, SMALL)
    x, y = bounds.x + bounds.width / 2, bounds.y + bounds.height + 4
    return lettering(lines, x, y, size=SMALL, fill=_letters(ink), halo=True)


def _count(picture: _Picture, shape: Shape) -> str:
    """How often it was visited, at its upper right corner."""
    visits = picture.visits.get(shape.element, 0)
    if not visits or shape.kind in ("participant", "lane"):
        return ""
    return _badge(str(visits), shape.bounds.x + shape.bounds.width, shape.bounds.y)


def _badge(content: str, x: float, y: float) -> str:
    width = max(16.0, text_width(content, 10) + 9)
    pill = tag("rect", x=x - width / 2, y=y - 8, width=width, height=16.0, rx=8, fill=VISITED, stroke=PAPER)
    return pill + lettering([content], x, y - 6, size=10, fill=PAPER)


_SHAPES: Mapping[str, Callable[[_Picture, Shape, Element], str]] = {
    "participant": _pool,
    "lane": _pool,
    "startEvent": _event,
    "intermediateCatchEvent": _event,
    "intermediateThrowEvent": _event,
    "boundaryEvent": _event,
    "endEvent": _event,
    "exclusiveGateway": _gateway,
    "inclusiveGateway": _gateway,
    "parallelGateway": _gateway,
    "eventBasedGateway": _gateway,
    "complexGateway": _gateway,
    "dataObjectReference": _data,
    "dataObject": _data,
    "dataStoreReference": _data,
    "dataInput": _data,
    "dataOutput": _data,
    "textAnnotation": _annotation,
    "group": _group,
}
"""Tag -> how it is drawn; all others are activities."""


# ---- edges -----------------------------------------------------------------------------------------------------------


def _edge(picture: _Picture, edge: Edge) -> str:
    ink = picture.ink(edge)
    style = {"fill": "none", "stroke": ink[0], "stroke_linecap": "round", "stroke_linejoin": "round"}
    if edge.kind == "sequenceFlow":
        content = _sequence_flow(picture, edge, ink, style)
    elif edge.kind == "messageFlow":
        content = _message_flow(edge, ink, style)
    else:
        line = tag("path", d=polyline(edge.waypoints), stroke_width=2, stroke_dasharray="0 5", **style)
        head = tag("polyline", points=corners(arrow(edge.waypoints, 8, 9)), stroke_width=1.5, **style)
        content = line + (head if edge.directed else "")
    return tag("g", content, id=edge.element)


def _sequence_flow(picture: _Picture, edge: Edge, ink: Ink, style: Mapping[str, str]) -> str:
    points = list(edge.waypoints)
    width = 2.5 if ink[0] == VISITED else 1.5
    head = tag("polygon", points=corners(arrow(points)), fill=ink[0], stroke=ink[0], stroke_linejoin="round")
    line = polyline([*points[:-1], towards(points[-1], points[-2], 4)])
    drawn = tag("path", d=line, stroke_width=width, **style) + head
    flow = picture.elements.get(edge.element)
    source = picture.elements.get(flow.source) if isinstance(flow, SequenceFlow) else None
    if isinstance(flow, SequenceFlow) and isinstance(source, Activity | Gateway) and source.default == flow.id:
        x, y = towards(points[0], points[1], 10)
        side = arrow([points[0], (x, y)], 6, 10)
        drawn += tag(
            "polyline", points=corners([side[0], (2 * x - side[0][0], 2 * y - side[0][1])]), stroke_width=1.5, **style
        )
    elif isinstance(flow, SequenceFlow) and flow.condition is not None and isinstance(source, Activity):
        half, end = towards(points[0], points[1], 8), towards(points[0], points[1], 16)
        sides = arrow([points[0], half], 0.01, 8)
        diamond = [points[0], sides[0], end, sides[2]]
        drawn += tag("polygon", points=corners(diamond), **{**style, "fill": PAPER})
    return drawn


def _message_flow(edge: Edge, ink: Ink, style: Mapping[str, str]) -> str:
    line = tag("path", d=polyline(edge.waypoints), stroke_width=1.5, stroke_dasharray="10 8", **style)
    start = tag("circle", cx=edge.waypoints[0][0], cy=edge.waypoints[0][1], r=3.5, fill=PAPER, stroke=ink[0])
    return line + start + tag("polygon", points=corners(arrow(edge.waypoints)), **{**style, "fill": PAPER})


def _edge_label(picture: _Picture, edge: Edge) -> str:
    element = picture.elements.get(edge.element)
    name = element.name if element is not None else ""
    visits = picture.visits.get(edge.element, 0)
    x, y = middle(edge.waypoints)
    drawn = _badge(str(visits), x, y) if visits > 1 else ""
    if name and edge.label is not None and edge.label.width > 0:
        label = edge.label
        lines = fitted(name, label, SMALL)
        return drawn + lettering(lines, label.x + label.width / 2, label.y, size=SMALL, fill=INK, halo=True)
    return drawn + (lettering(wrap(name, 90, SMALL), x, y - 16, size=SMALL, fill=INK, halo=True) if name else "")
