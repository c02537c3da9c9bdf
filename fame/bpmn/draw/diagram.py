"""Draws the diagram interchange of a model as SVG, with the path of a run on it if given.

Pools, lanes and open sub-processes come first, then flows, then the shapes that stand on them. All diagrams of a file
are drawn, one below the other. A file without a diagram is laid out.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from types import MappingProxyType

from fame.bpmn.draw.shapes import draw_shape, name_beside, placeholder
from fame.bpmn.draw.style import (
    BACKGROUND,
    INK,
    OUTCOMES,
    SMALL,
    Ink,
    Picture,
    Tally,
    badge,
    badges,
    badges_width,
    is_visited,
    legend,
)
from fame.bpmn.draw.svg import (
    FONT,
    Label,
    Point,
    along,
    arrow,
    corners,
    number,
    place_labels,
    point_towards,
    polyline,
    tag,
    text_lines,
    text_width,
    translated,
)
from fame.bpmn.model import (
    Activity,
    Bounds,
    Definitions,
    Edge,
    Element,
    ElementOutcome,
    FlowNode,
    SequenceFlow,
    Shape,
    SubProcess,
)
from fame.dataclasses import dataclass, replace
from fame.errors import ModelError, UnavailableError
from fame.rooms import LAY_OUT, load

Box = tuple[float, float, float, float]

MARGIN = 12.0
_PARTS = (0.5, 0.35, 0.65, 0.25, 0.75, 0.15, 0.85)
"""Where on a flow its number may be, the best place first."""
BADGE = 10.0
"""How far badges extend beyond the corner of their shape (px)."""


def draw(
    definitions: Definitions,
    visited: Iterable[str] | Mapping[str, int] | Mapping[str, Tally] = (),
    *,
    words: Mapping[ElementOutcome, str] = MappingProxyType({}),
    notes: Sequence[str] = (),
) -> str:
    """Return the diagrams of a file as one SVG document.

    `visited` shows a run: ids of elements and flows, once for each completion; id -> number of completions; or id ->
    number of executions with each outcome (`fame.log.reading`). Each outcome is shown by a colour, a symbol and a
    number. `words` name outcomes in the legend; `notes` are lines of text below it. Raises ModelError if there is
    nothing to draw.
    """
    definitions = with_diagram(definitions)
    picture = _picture(definitions, _tallies(visited))
    parts: list[str] = []
    width, top = 0.0, MARGIN
    for shown, shapes, edges in _content(definitions, picture):
        if parts:
            title = picture.elements[shown].label if shown in picture.elements else ""
            parts.append(text_lines([title], MARGIN, top, size=14, fill=INK, anchor="start"))
            width, top = max(width, text_width(title, 14)), top + 28
        frame = _frame(picture, shapes, edges)
        parts.append(translated(MARGIN - frame.x, top - frame.y, *_plane(picture, shapes, edges)))
        width, top = max(width, frame.width), top + frame.height + 2 * MARGIN
    tallies = [picture.visits.get(shape.element, {}) for shape in definitions.shapes]
    present = [outcome for outcome in OUTCOMES if any(tally.get(outcome) for tally in tallies)]
    if present:
        explained, wide = legend({outcome: words.get(outcome, outcome) for outcome in present}, MARGIN, top)
        parts.append(explained)
        width, top = max(width, wide), top + 2 * MARGIN
    for note in notes:
        parts.append(text_lines([note], MARGIN, top - 7, size=11, fill=INK, anchor="start"))
        width, top = max(width, text_width(note, 11)), top + 1.5 * MARGIN
    return _document(width + 2 * MARGIN, top - MARGIN, parts)


@dataclass(frozen=True, slots=True)
class Drawing:
    """One diagram of a file, as SVG of its own. Lengths in px of that SVG.

    element  the id of the element that the diagram shows
    boxes    id -> x, y, width and height of its shape
    lines    id -> the points of its flow or association
    frames   ids of pools, lanes and open sub-processes: other shapes are drawn inside
    """

    element: str
    svg: str
    width: float
    height: float
    boxes: Mapping[str, Box]
    lines: Mapping[str, Sequence[Point]]
    frames: Sequence[str]


def draw_planes(definitions: Definitions) -> list[Drawing]:
    """Return each diagram of a file as a drawing of its own, without a run. Raises ModelError if there is nothing to
    draw."""
    definitions = with_diagram(definitions)
    picture = _picture(definitions, {})
    found = []
    for shown, shapes, edges in _content(definitions, picture):
        frame = _frame(picture, shapes, edges)
        left, top = MARGIN - frame.x, MARGIN - frame.y
        size = frame.width + 2 * MARGIN, frame.height + 2 * MARGIN
        boxes = {
            shape.element: (shape.bounds.x + left, shape.bounds.y + top, shape.bounds.width, shape.bounds.height)
            for shape in shapes
        }
        lines = {edge.element: [(x + left, y + top) for x, y in edge.waypoints] for edge in edges}
        svg = _document(*size, [translated(left, top, *_plane(picture, shapes, edges))])
        frames = [shape.element for shape in shapes if _is_frame(shape)]
        found.append(Drawing(shown, svg, *size, boxes, lines, frames))
    return found


def with_diagram(definitions: Definitions) -> Definitions:
    """Return a model with its diagram, or laid out if the file has none. Raises ModelError if it cannot be."""
    if definitions.shapes:
        return definitions
    if (found := definitions.made.get(LAY_OUT)) is None:
        try:
            found = definitions.made[LAY_OUT] = load(LAY_OUT)(definitions)
        except UnavailableError as error:
            text = f"the file has no diagram (BPMNDI): draw it in a modeler; {error}"
            raise ModelError(text, file=definitions.file) from None
    laid_out: Definitions = found
    return laid_out


def is_drawable(definitions: Definitions) -> bool:
    """Return whether a model has a diagram, or can be laid out."""
    try:
        return bool(with_diagram(definitions).shapes)
    except ModelError:
        return False


def _picture(definitions: Definitions, tallies: Mapping[str, Tally]) -> Picture:
    """The tables of a drawing, without labels."""
    elements = {shape.element: placeholder(shape) for shape in definitions.shapes}
    elements.update((one.id, one) for one in _elements(definitions))
    return Picture(elements, tallies)


def _content(definitions: Definitions, picture: Picture) -> Iterator[tuple[str, list[Shape], list[Edge]]]:
    """The element that each diagram shows, its shapes and its edges. Sets the labels of the picture to those of it."""
    for plane, shown in enumerate(definitions.planes):
        shapes = _with_open_subprocesses(picture, [shape for shape in definitions.shapes if shape.plane == plane])
        edges = [edge for edge in definitions.edges if edge.plane == plane]
        if shapes:
            picture.labels = _labels(picture, shapes, edges)
            yield shown, shapes, edges


def _tallies(visited: Iterable[str] | Mapping[str, int] | Mapping[str, Tally]) -> dict[str, Tally]:
    """Outcomes by id. Plain counts are completions."""
    counts = visited if isinstance(visited, Mapping) else Counter(visited)
    return {id: {"completed": count} if isinstance(count, int) else count for id, count in counts.items()}


def _labels(picture: Picture, shapes: Sequence[Shape], edges: Sequence[Edge]) -> dict[str, Label]:
    """The names beside shapes and flows."""
    known = picture.elements
    names = {shape.element: name_beside(shape, known[shape.element]) for shape in shapes}
    names |= {edge.element: known[edge.element].name for edge in edges if edge.element in known}
    return place_labels(shapes, edges, names, (shape.element for shape in shapes if _is_frame(shape)), SMALL)


def _document(width: float, height: float, parts: Iterable[str]) -> str:
    size = number(width), number(height)
    paper = tag("rect", width="100%", height="100%", fill=BACKGROUND)
    namespace = {"xmlns": "http://www.w3.org/2000/svg", "viewBox": f"0 0 {size[0]} {size[1]}", "font_family": FONT}
    return tag("svg", paper, *parts, width=size[0], height=size[1], **namespace) + "\n"


def _elements(definitions: Definitions) -> Iterable[Element]:
    yield from (*definitions.processes, *definitions.participants, *definitions.message_flows, *definitions.artifacts)
    for process in definitions.processes:
        yield from process.lanes
        yield from process.body.elements()


def _with_open_subprocesses(picture: Picture, shapes: Sequence[Shape]) -> list[Shape]:
    """The shapes, where sub-processes whose content is on the same plane are expanded."""
    ids_on_plane = {shape.element for shape in shapes}
    found = []
    for shape in shapes:
        element = picture.elements.get(shape.element)
        inside = element.body.nodes if isinstance(element, SubProcess) else ()
        is_open = shape.expanded or any(node.id in ids_on_plane for node in inside)
        found.append(replace(shape, expanded=True) if is_open and not shape.expanded else shape)
    return found


def _frame(picture: Picture, shapes: Sequence[Shape], edges: Sequence[Edge]) -> Bounds:
    """The box around everything; numbers may extend into the margin."""
    boxes = [shape.bounds for shape in shapes] + [label.box for label in picture.labels.values()]
    numbers = [box for box in (_counts_box(picture, shape) for shape in shapes) if box is not None]
    boxes += [Bounds(box.x + BADGE, box.y + 8, box.width - 2 * BADGE, box.height - 16) for box in numbers]
    points = [point for edge in edges for point in edge.waypoints]
    lefts, tops = [box.x for box in boxes] + [x for x, _ in points], [box.y for box in boxes] + [y for _, y in points]
    rights = [box.x + box.width for box in boxes] + [x for x, _ in points]
    bottoms = [box.y + box.height for box in boxes] + [y for _, y in points]
    return Bounds(min(lefts), min(tops), max(rights) - min(lefts), max(bottoms) - min(tops))


def _plane(picture: Picture, shapes: Sequence[Shape], edges: Sequence[Edge]) -> list[str]:
    frames = [shape for shape in shapes if _is_frame(shape)]
    frames.sort(key=lambda shape: -shape.bounds.width * shape.bounds.height)
    others = [shape for shape in shapes if not _is_frame(shape)]
    others.sort(key=lambda shape: shape.kind == "boundaryEvent" or bool(shape.band))
    parts = [draw_shape(picture, shape) for shape in frames]
    parts += [draw_edge(picture, edge) for edge in edges]
    parts += [draw_shape(picture, shape) for shape in others]
    parts += [draw_edge_label(picture, edge) for edge in edges]
    parts += [_counts(picture, shape) for shape in shapes]
    return [part for part in parts if part]


def _is_frame(shape: Shape) -> bool:
    """Whether other shapes are drawn inside."""
    bodies = ("subProcess", "transaction", "adHocSubProcess", "subChoreography")
    holds = shape.kind in ("participant", "lane", "group") and not shape.band
    return holds or (shape.expanded and shape.kind in bodies)


def _counts(picture: Picture, shape: Shape) -> str:
    """The number of executions with each outcome."""
    box = _counts_box(picture, shape)
    return badges(picture.visits[shape.element], box.x + box.width, box.y + 8) if box is not None else ""


def _counts_box(picture: Picture, shape: Shape) -> Bounds | None:
    """The box of these numbers, at the corner where they cover no name, the upper right one first; None without any."""
    tally = picture.visits.get(shape.element, {})
    if shape.kind in ("participant", "lane") or not any(tally.values()):
        return None
    box, width = shape.bounds, badges_width(tally)
    rights = (box.x + box.width + BADGE, box.x - BADGE + width)
    spots = [Bounds(right - width, y - 8, width, 16) for y in (box.y, box.y + box.height) for right in rights]
    return min(spots, key=lambda spot: _covered(picture, spot))


def _covered(picture: Picture, box: Bounds) -> float:
    """How much of the names beside shapes and flows a box covers (square px)."""
    return sum(
        max(0.0, min(box.x + box.width, name.x + name.width) - max(box.x, name.x))
        * max(0.0, min(box.y + box.height, name.y + name.height) - max(box.y, name.y))
        for name in (label.box for label in picture.labels.values())
    )


def draw_edge(picture: Picture, edge: Edge) -> str:
    """Return a flow or association without its name, in a group with the id of the element."""
    ink = picture.ink(edge)
    style = {"fill": "none", "stroke": ink[0], "stroke_linecap": "round", "stroke_linejoin": "round"}
    if edge.kind == "sequenceFlow":
        content = _sequence_flow(picture, edge, ink, style)
    elif edge.kind == "messageFlow":
        content = _message_flow(edge, ink, style)
    elif edge.kind == "conversationLink":
        content = "".join(
            tag("path", d=polyline(edge.waypoints), **{**style, "stroke": colour}, stroke_width=width)
            for colour, width in ((ink[0], 5), (BACKGROUND, 2))
        )
    else:
        line = tag("path", d=polyline(edge.waypoints), stroke_width=2, stroke_dasharray="0 5", **style)
        head = tag("polyline", points=corners(arrow(edge.waypoints, 8, 9)), stroke_width=1.5, **style)
        content = line + (head if edge.directed else "")
    return tag("g", content, id=edge.element)


def _sequence_flow(picture: Picture, edge: Edge, ink: Ink, style: Mapping[str, str]) -> str:
    points = list(edge.waypoints)
    width = 2.5 if is_visited(ink) else 1.5
    head = tag("polygon", points=corners(arrow(points)), fill=ink[0], stroke=ink[0], stroke_linejoin="round")
    line = polyline([*points[:-1], point_towards(points[-1], points[-2], 4)])
    drawn = tag("path", d=line, stroke_width=width, **style) + head
    flow = picture.elements.get(edge.element)
    if not isinstance(flow, SequenceFlow):
        return drawn
    source = picture.elements.get(flow.source)
    if isinstance(source, FlowNode) and source.default == flow.id:
        x, y = point_towards(points[0], points[1], 10)
        side = arrow([points[0], (x, y)], 6, 10)
        drawn += tag(
            "polyline", points=corners([side[0], (2 * x - side[0][0], 2 * y - side[0][1])]), stroke_width=1.5, **style
        )
    elif flow.condition is not None and isinstance(source, Activity):
        half, end = point_towards(points[0], points[1], 8), point_towards(points[0], points[1], 16)
        sides = arrow([points[0], half], 0.01, 8)
        diamond = [points[0], sides[0], end, sides[2]]
        drawn += tag("polygon", points=corners(diamond), **{**style, "fill": BACKGROUND})
    return drawn


def _message_flow(edge: Edge, ink: Ink, style: Mapping[str, str]) -> str:
    line = tag("path", d=polyline(edge.waypoints), stroke_width=1.5, stroke_dasharray="10 8", **style)
    start = tag("circle", cx=edge.waypoints[0][0], cy=edge.waypoints[0][1], r=3.5, fill=BACKGROUND, stroke=ink[0])
    return line + start + tag("polygon", points=corners(arrow(edge.waypoints)), **{**style, "fill": BACKGROUND})


def draw_edge_label(picture: Picture, edge: Edge) -> str:
    """Return the name of an edge, and how often it was taken, if more than once."""
    visits = picture.visits.get(edge.element, {}).get("completed", 0)
    if visits < 2:
        return picture.label(edge.element)
    width = badges_width({"completed": visits})
    spots = [along(edge.waypoints, part) for part in _PARTS]
    x, y = min(spots, key=lambda spot: _covered(picture, Bounds(spot[0] - width / 2, spot[1] - 8, width, 16)))
    return badge(str(visits), x, y) + picture.label(edge.element)
